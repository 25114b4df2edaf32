"""The torque that an encoder's steps make: closed forms, the integral over frequency, a simulation, and what keeps it."""

import math
from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from gainroom.files.joint_yaml import parse_joint
from gainroom.system.requirements import NOISE_SHARE, REQUIREMENTS
from gainroom.system.torque_noise import torque_noise, torque_per_count
from independent.joint import PDJoint
from independent.varying_delay import PARTS, Sampled

COUNT = 2 * math.pi / 2**14
"""Step of an encoder with 14 bits [rad]."""
ELBOW = PDJoint(0.448, 0.35, 900.0, 0.0, 628.0, 37.9, delay=3e-3, bandwidth=4000.0)


def built(one: PDJoint, tick: float | None, step: float = COUNT) -> gr.Loop:
    joint = gr.ElasticJoint(one.motor_inertia, one.link_inertia, one.stiffness, one.damping)
    return gr.build_loop(joint, gr.Drive(one.bandwidth, one.damping_ratio, one.delay, step), gr.PD(one.kp, one.kd), sample_time=tick)


def test_a_count_at_1_khz():
    """kp q + kd q/T_s: kd 37.9 at 1 kHz makes 14.5 N·m of one count, kp 628 another 0.24."""
    found = torque_per_count(built(ELBOW, 1e-3))
    assert found == pytest.approx(628.0 * COUNT + 37.9 * COUNT / 1e-3, rel=1e-12)
    assert found == pytest.approx(14.5 + 0.24, abs=0.05)


def test_gains_too_small_to_matter_to_the_loop():
    """The noise is then that of the controller alone: u_k = −(kp + kd/T) n_k + kd/T n_{k−1}."""
    one, tick = replace(ELBOW, kp=0.05, kd=1e-3, link_inertia=3.5e4, motor_inertia=4.48e4, stiffness=9e7), 1e-3
    kd = one.kd / tick
    expected = COUNT / math.sqrt(12) * math.hypot(one.kp + kd, kd)
    # a loop this slow (0.001 rad/s) lets the position follow the noise hardly at all: its share is of the order of ω T
    assert torque_noise(built(one, tick)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("tick", [1e-3, 2.5e-4])
def test_it_is_the_integral_over_frequency(tick: float):
    """With the midpoint rule on a grid far finer than the widest peak's width, for parts and for a return ratio without them."""
    loop = built(ELBOW, tick)
    count = 200_000
    omega = (np.arange(count) + 0.5) * math.pi / count / tick
    assert loop.control is not None
    back = loop.control.response(omega) / (1 + loop.response(omega))
    expected = COUNT / math.sqrt(12) * math.sqrt(np.mean(np.abs(back) ** 2))
    assert torque_noise(loop) == pytest.approx(expected, rel=1e-6)
    assert torque_noise(replace(loop, parts=None)) == pytest.approx(expected, rel=1e-6)


def simulated(loop: Sampled, step: float, ticks: int, runs: int, seed: int, quantised: bool) -> float:
    """Standard deviation of the torque command, from equations of motion: white noise on the position, or a position that is counted.

    Counted positions move: the joint follows two sines, by many counts per tick; the torque is compared with that of exact positions.
    """
    rng, one, (phi, gamma) = np.random.default_rng(seed), loop.joint, loop.matrices()
    state, before = np.zeros((2, 6, runs)), np.zeros((2, runs))
    late = loop.steps // PARTS
    assert late * PARTS == loop.steps
    sent, squares, kept = np.zeros((late + 1, 2, runs)), 0.0, 0
    start = rng.uniform(0, 1, runs)
    for k in range(ticks):
        seen, target = state[:, 0].copy(), 0.0
        if quantised:
            target = 0.3 * np.sin(2 * np.pi * (1.3e-3 * k + start)) + 0.2 * np.sin(2 * np.pi * (3.71e-3 * k + 7 * start))
            seen[1] = step * np.round(seen[1] / step)
        else:
            seen[1] += rng.normal(0.0, step / math.sqrt(12), runs)
        sent[k % (late + 1)] = one.kp * (target - seen) - one.kd * (seen - before) / loop.tick
        before = seen
        if k > ticks // 5:
            difference = sent[k % (late + 1), 1] - sent[k % (late + 1), 0]
            squares, kept = squares + float((difference**2).sum()), kept + runs
        acting = sent[(k - late) % (late + 1)] if k >= late else np.zeros((2, runs))
        for _ in range(PARTS):
            state = np.einsum("ij,ajr->air", phi, state) + gamma[None, :, None] * acting[:, None]
    return math.sqrt(squares / kept)


@pytest.mark.parametrize("quantised", [False, True])
def test_a_long_simulation(quantised: bool):
    """64 runs of 4,000 ticks: 200,000 samples, correlated over some tens of ticks, hence a deviation known to 1 % or better."""
    one = replace(ELBOW, damping=1.0)
    found = simulated(Sampled(one, 1e-3), COUNT, 4000, 64, 5, quantised)
    # counted: where the motion turns, errors of neighbouring samples are alike for a while
    assert torque_noise(built(one, 1e-3)) == pytest.approx(found, rel=0.05 if quantised else 0.01)


def test_coupled_joints_with_an_encoder_each():
    """Uncoupled joints have what each has alone, and a finer encoder of one less of its own."""
    drives = [gr.Drive(4000.0, 0.9, 2e-3, COUNT), gr.Drive(4000.0, 0.9, 2e-3, COUNT / 4)]
    alone = [torque_noise(gr.build_loop(gr.ElasticJoint(0.5, inertia, 1e4, 1.0), drive, gr.PD(800.0, 30.0), sample_time=1e-3))[0]
             for drive, inertia in zip(drives, (2.0, 0.4), strict=True)]  # fmt: skip
    plant = gr.Plant(np.diag([1 / 2.0, 1 / 0.4]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 1.0))
    assert torque_noise(gr.build_loop(plant, drives, gr.PD(800.0, 30.0), sample_time=1e-3)) == pytest.approx(alone, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"tick": None}, "needs a sample rate"), ({"step": 0.0}, "needs the resolution of the encoders")],
)
def test_what_is_not_known(change: dict, message: str):
    loop = built(ELBOW, **{"tick": 1e-3, **change})
    for ask in (torque_noise, torque_per_count):
        with pytest.raises(gr.GainroomError, match=message):
            ask(loop)
    found = gr.margins(loop)
    assert math.isnan(REQUIREMENTS["torque_noise"].value(found))


FILE = """\
joint: {motor_inertia: 0.448, link_inertia: 0.35, stiffness: 900, damping: 1.0}
drive: {bandwidth: 4000, delay_ms: 3}
control: {type: pd, feedback: motor, kp: 628, kd: 37.9, sample_rate_hz: 1000}
"""


def test_a_file_s_encoder():
    """From the scenario or the drive; without limits 2 % of the peak torque is allowed, where that is known."""
    plain = parse_joint(FILE, "joint.yaml")
    assert plain.drives[0].resolution == 0
    assert plain.requirements == gr.Requirements.usual()
    counted = parse_joint(FILE + "scenario: {motor_resolution: 3.83e-4, link_resolution: 1.0e-5, torque_limit: 120}\n", "joint.yaml")
    assert counted.drives[0].resolution == 3.83e-4
    assert counted.requirements.needed == {**gr.Requirements.usual().needed, "torque_noise": NOISE_SHARE * 120}
    asked = FILE.replace("delay_ms: 3", "delay_ms: 3, encoder_resolution: 1e-4") + "limits: {peak_sensitivity: 2, torque_noise: 3}\n"
    found = parse_joint(asked, "joint.yaml")
    assert found.drives[0].resolution == 1e-4
    assert found.requirements.needed == {"peak_sensitivity": 2.0, "torque_noise": 3.0}


@pytest.mark.slow
def test_recommended_gains_keep_it():
    joint, drive = gr.ElasticJoint(0.448, 0.35, 900.0, 0.0), gr.Drive(4000.0, 0.9, 3e-3, COUNT)
    required = gr.Requirements(**{**gr.Requirements.usual().needed, "torque_noise": 3.0})
    for asked, least, most in ((gr.Requirements.usual(), 5.0, 20.0), (required, 2.9, 3.0)):
        found = gr.recommend_pd(joint, drive, asked, sample_time=1e-3)
        assert found is not None
        noise = float(torque_noise(gr.build_loop(joint, drive, found.controller, sample_time=1e-3))[0])
        assert least < noise <= most * (1 + 1e-6)


def test_many_gains_at_once():
    """In a region of gains it is judged for all kd of a line together: as for each alone."""
    joint, drive = gr.ElasticJoint(0.448, 0.35, 900.0, 0.0), gr.Drive(4000.0, 0.9, 3e-3, COUNT)
    for law in (gr.PD(1.0, 1.0), gr.PID(1.0, 2.0, 1.0, velocity_filter=gr.LowPass(600.0)), gr.PPI(10.0, 1.0, 4.0)):
        region = gr.pd_region(joint, drive, torque_noise=3.0, sample_time=1e-3, controller=law)
        (low, high), *_ = region.columns(300.0)[0].tolist()
        inside = [
            torque_noise(gr.build_loop(joint, drive, law.from_plane(300.0, kd), sample_time=1e-3))[0]
            for kd in (0.5 * (low + high), high * (1 - 1e-5), high * (1 + 1e-5))
        ]
        assert inside[0] < inside[1] < 3.0 < inside[2]
        assert inside[1] == pytest.approx(3.0, rel=1e-4)
