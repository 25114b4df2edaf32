"""The spectrum of a short log, line by line: beside a response in closed form, beside noise alone, and where averages are too coarse."""

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.frequency_response import differenced_response, fine_response, frequency_response
from gainroom.identification.joint import identify_joint
from gainroom.identification.record import Record
from independent.chain import Chain, multisine, record
from refusals import assert_refused

TICK = 1e-3


def cut_out(joint: gr.ElasticJoint, rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Torque and position (rows,) out of a longer periodic motion, exact by its Fourier series: both ends have a part of their own."""
    period = 8 * rows
    lines = np.arange(1, int(25 * period * TICK))  # to 25 Hz
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=len(lines)))
    compliance = np.zeros_like(spectrum)
    compliance[lines] = joint.plant().response(2j * np.pi * lines / (period * TICK), "motor")[:, 0, 0]
    torque, position = np.fft.irfft(spectrum, period), np.fft.irfft(compliance * spectrum, period)
    return torque[rows : 2 * rows] / torque.std(), position[rows : 2 * rows] / torque.std()


@pytest.mark.parametrize("rows", [3000, 4001, 6000])
def test_it_is_the_joint_s_where_averages_are_too_coarse(rows: int):
    """Resonance at 7.1 Hz, antiresonance at 5 Hz. A pole d lines away leaves (4/d)³ of a response that is taken for a parabola over 4."""
    joint = gr.ElasticJoint(0.1, 0.1, 100.0, 0.2)
    torque, position = cut_out(joint, rows, rows)
    fine, coarse = fine_response(torque, position, TICK), frequency_response(torque, position, TICK)
    away = np.min(np.abs(fine.omega[:, None] - [joint.resonance, joint.antiresonance]), axis=1) * rows * TICK / (2 * np.pi)
    lines = fine.omega * rows * TICK / (2 * np.pi)
    used = fine.excited & (fine.omega < 2 * np.pi * 24) & (away > 5) & (lines > 5)  # line 0 has lost its mean
    error = np.abs(fine.response[used] / differenced_response(joint, fine.omega[used], TICK) - 1)
    assert np.all(error < (4 / away[used]) ** 3)
    assert np.median(error) < 1e-3  # far away, where 12 lines make 0.04
    assert fine.frequencies > 1.5 * coarse.frequencies


def test_noise_is_no_excitation():
    """Of unrelated noise the share of its power that three of six free lines explain is as Beta(3, 3): above 0.965 in 4 of 10,000 lines."""
    rng = np.random.default_rng(0)
    torque, position = rng.standard_normal(20_000), np.cumsum(np.cumsum(rng.standard_normal(20_000))) * 1e-6
    for instrument in (None, rng.standard_normal(20_000)):
        found = fine_response(torque, position, TICK, instrument)
        assert np.mean(found.excited) < 0.002


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inertia", "stiffness", "seconds"), [((0.1, 0.15), 90.0, 4.0), ((0.05, 0.03), 40.0, 5.0), ((0.3, 0.6), 900.0, 3.0)]
)
def test_a_short_log_of_a_slow_resonance_tells_its_joint(inertia, stiffness, seconds):
    """7 Hz in 4 s, 7 Hz in 5 s, 10 Hz in 3 s: averages show 4 to 9 frequencies. Inertias and stiffness to 2 %, intervals of 99.9 %."""
    rows = int(seconds / TICK)
    motor, link = inertia
    resonance = (stiffness * (1 / motor + 1 / link)) ** 0.5
    chain = Chain(inertia, [stiffness], [0.03 * stiffness / resonance], 0.05, 0.01, bandwidth=2000.0, resolution=5e-6)
    high = resonance / np.pi
    torque = 2 * multisine(np.geomspace(high / 5, high, 40), rows, TICK, 1)
    columns = record(chain, lambda k, reading: torque[k] - 0.5 * reading, rows, TICK, 2, 4)
    log = Record(np.arange(rows) * TICK, {name: columns[name] for name in ("target_torque", "actual_torque", "motor_position")}, TICK)
    assert frequency_response(log.channels["target_torque"], log.channels["motor_position"], TICK).frequencies < 12
    found = identify_joint(log)
    assert found.adequate
    for name, value in {"motor_inertia": motor, "link_inertia": link, "stiffness": stiffness}.items():
        assert found.parameters[name].value == pytest.approx(value, rel=0.02)
        assert abs(found.parameters[name].value - value) < 1.7 * found.parameters[name].half_width


@pytest.mark.slow
def test_what_is_too_short_is_told_to_be_longer():
    chain = Chain([0.1, 0.15], [90.0], [0.1], 0.05, bandwidth=2000.0)
    torque = 2 * multisine(np.geomspace(3, 14, 40), 2000, TICK, 1)
    columns = record(chain, lambda k, reading: torque[k], 2000, TICK, 2, 4)
    log = Record(np.arange(2000) * TICK, {name: columns[name] for name in ("target_torque", "motor_position")}, TICK)
    assert_refused(lambda: identify_joint(log), ["frequencies; 12 are needed", "record a multisine or chirp", "for longer than 2 s"])
