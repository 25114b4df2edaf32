"""Gains that a firmware applies, and the stiffness of a locked output, against what the logs were made with."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.gains import factors, identify_gains
from gainroom.identification.record import Record
from gainroom.identification.stiffness import identify_stiffness
from gainroom.simulation import Friction, Scenario, Testbed, simulate
from identified import coverage_bounds, gains_case, holds, joint_case
from refusals import assert_refused

WHOLE, SHARE, TICK = 100, 8, 1e-3


def test_an_exact_law_gives_its_gains_back():
    """Torque computed here from position and set-point, 30 e + 2 ė, a tick late: to a thousandth, what the ends leave."""
    rng = np.random.default_rng(0)
    time = np.arange(6000) * TICK
    reference = sum(0.1 * np.sin(2 * np.pi * f * time + p) for f, p in zip(rng.uniform(0.3, 4, 6), rng.uniform(0, 6, 6), strict=True))
    position = 0.7 * np.roll(reference, 30) + 0.05 * np.sin(11 * time)
    error = reference - position
    torque = np.roll(30 * error + 2 * np.diff(error, prepend=error[0]) / TICK, 1) + 0.4
    part = slice(100, 5900)
    columns = {"reference": reference[part], "motor_position": position[part], "target_torque": torque[part]}
    found = identify_gains(Record(time[part], columns, TICK))
    assert found.kp.value == pytest.approx(30, rel=1e-3)
    assert found.kd.value == pytest.approx(2, rel=1e-3)
    assert found.lag == pytest.approx(TICK, rel=0.03)
    assert found.rate_of_error
    assert found.offset == pytest.approx(0.4, abs=0.05)  # of some 10 N m; velocity's mean over the record is not quite 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kp", "kd", "names"),
    [
        (1.0, 1.0, []),
        (2 * math.pi, 2 * math.pi, ["2π: revolutions taken for radians"] * 2),
        (1e4, 1e4, ["gear²: gains act on the rotor's side"] * 2),
        (100.0, 1.0, ["gear: position or torque on the rotor's side"]),
        (1.0, 180 / math.pi, ["180/π: degrees taken for radians"]),
        (1.7, 1.0, []),  # no unit does that
    ],
)
def test_wrong_units_are_named_by_their_factor(kp, kd, names):
    case = gains_case(1)
    found = identify_gains(case.record, kp=case.truth["kp"] / kp, kd=case.truth["kd"] / kd, gear_ratio=100.0)
    assert [error.name for error in found.unit_errors] == names


def test_factors_differ_by_more_than_what_counts_as_the_same():
    values = np.sort(list(factors(50.0).values()))
    assert np.all(values[1:] / values[:-1] > 1.1)


def test_what_says_nothing_is_refused():
    time, still = np.arange(1000) * TICK, np.zeros(1000)
    moving = np.sin(5 * time)
    for columns, words in (
        ({"motor_position": moving, "target_torque": moving}, ["needs reference"]),
        ({"reference": moving, "motor_position": moving, "target_torque": still}, ["target_torque does not change"]),
        ({"reference": still, "motor_position": still, "target_torque": moving}, ["differ by 0 rad"]),
        (
            {"reference": moving, "motor_position": 0.5 * moving, "target_torque": np.random.default_rng(0).standard_normal(1000)},
            ["explain", "look at signs"],
        ),
    ):
        assert_refused(lambda columns=columns: identify_gains(Record(time, columns, TICK)), words)


@pytest.mark.slow
def test_share_of_the_population():
    """Within 2 %."""
    for index in range(SHARE):
        case = gains_case(index)
        found = identify_gains(case.record)
        assert found.kp.value == pytest.approx(case.truth["kp"], rel=0.02)
        assert found.kd.value == pytest.approx(case.truth["kd"], rel=0.02)


def pd_loop(step: int, count: int = 8000) -> Record:
    """Every `step`th row of a 1 kHz PD of 800 and 20 on an inertia of 0.5 kg m² that is moved exactly from tick to tick, 2 ticks late."""
    rng, inertia, friction = np.random.default_rng(1), 0.5, 0.8
    decay = math.exp(-friction / inertia * TICK)
    time, frequencies = TICK * np.arange(count), np.array([0.5, 1.3, 2.9, 5.3, 9.1, 14.0])
    reference = (0.2 / frequencies * np.sin(2 * np.pi * np.outer(time, frequencies) + np.arange(6))).sum(axis=1) * np.clip(time, 0, 1)
    position, torque, x, v, before = np.zeros(count), np.zeros(count), 0.0, 0.0, 0.0
    for k in range(count):
        position[k] = x + 2e-6 * rng.standard_normal()
        error = reference[k] - position[k]
        torque[k] = 800 * error + 20 * (error - before) / TICK
        before, ahead = error, (torque[k - 2] if k >= 2 else 0.0) / friction
        x, v = x + ahead * TICK + (v - ahead) * (1 - decay) * inertia / friction, ahead + (v - ahead) * decay
    rows = slice(None, None, step)
    columns = {"reference": reference[rows], "motor_position": position[rows], "target_torque": torque[rows]}
    return Record(time[rows], columns, step * TICK)


@pytest.mark.parametrize("step", [1, 2, 4])
def test_gains_of_a_log_that_is_slower_than_its_loop_are_warned_of(step):
    """Every second row says kd = 19.624 ± 0.001 for 20, half a tick ahead of the positions: the difference over two ticks is another."""
    found = identify_gains(pd_loop(step))
    warned = [text for text in found.warnings if f"rows come every {step} ms" in text]
    assert bool(warned) == (step > 1)
    assert step > 1 or holds(found.kd, 20)
    assert all("kd" in text and "log every tick" in text for text in warned)


def test_a_log_without_torque_is_told_which_ones_there_could_be():
    log = pd_loop(1)
    still = Record(log.time, {name: log.channels[name] for name in ("reference", "motor_position")}, TICK)
    assert_refused(lambda: identify_gains(still), ["needs target_torque, demand_torque or actual_torque"])
    assert identify_gains(log).torque == "target_torque"


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_whole_population(capsys):
    """Within 2 % on 100 logs; both gains 2π off are named every time."""
    errors, inside, named = [], [], 0
    for index in range(WHOLE):
        case = gains_case(index)
        kp, kd = case.truth["kp"], case.truth["kd"]
        found = identify_gains(case.record, kp / (2 * math.pi), kd / 1e4, 100.0)
        errors.append((found.kp.value / kp - 1, found.kd.value / kd - 1))
        inside.append((holds(found.kp, kp), holds(found.kd, kd)))
        named += [error.name[:3] for error in found.unit_errors] == ["2π:", "gea"]
    largest, coverage = np.abs(errors).max(axis=0), np.mean(inside, axis=0)
    with capsys.disabled():
        print(f"\n{WHOLE} logs: kp within {largest[0]:.4f}, kd within {largest[1]:.4f}, coverage {coverage}, named {named}")
    assert np.all(largest < 0.02)
    assert named == WHOLE
    assert np.all(coverage >= coverage_bounds(WHOLE)[0])


def locked(stiffness: float, coulomb: float, seconds: float = 20.0, step: float = 7.7e-6, cubic: float = 0.0) -> Record:
    """The testbed with its output fixed, loaded slowly back and forth; `cubic`: this test's own spring instead, without dynamics."""
    time = np.arange(int(seconds / TICK)) * TICK
    torque = 20 * np.sin(2 * np.pi * 0.2 * time)
    if cubic:
        deflection = np.linspace(-4e-3, 4e-3, 4001)
        position = np.interp(torque, stiffness * deflection + cubic * deflection**3, deflection)
        return Record(time, {"actual_torque": torque, "motor_position": step * np.round(position / step)}, TICK)
    joint = gr.ElasticJoint(0.2, math.inf, stiffness, 5.0)
    loop = gr.build_loop(joint, gr.Drive(2000.0, 0.9, 2e-3), gr.PD(0.0, 0.0), sample_time=TICK)
    friction = Friction(coulomb, 1.2 * coulomb, 0.001) if coulomb else Friction()
    run = simulate(Testbed(loop, motor_friction=friction, motor_resolution=step), Scenario(0.0, time[-1], feedforward=torque[:, None]))
    rng = np.random.default_rng(0)
    actual = run.actual_torque[:, 0] + 0.05 * rng.standard_normal(len(run.time))
    return Record(run.time, {"actual_torque": actual, "motor_position": run.motor_reading[:, 0]}, TICK)


@pytest.mark.parametrize(("stiffness", "coulomb"), [(1e4, 1.0), (3e4, 0.0), (4e3, 2.0)])
def test_a_locked_output_shows_stiffness_and_hysteresis(stiffness, coulomb):
    """K within 1 %, and the hysteresis 2F/K within a tenth: static friction is a fifth larger where the joint has just turned."""
    found = identify_stiffness(locked(stiffness, coulomb))
    assert found.stiffness.value == pytest.approx(stiffness, rel=0.01)
    assert found.hysteresis.value == pytest.approx(2 * coulomb / stiffness, rel=0.1, abs=0.02 / stiffness * 20)
    assert not found.warnings


def test_a_progressive_spring_is_called_one():
    """Slope 1e4 + 3 · 2e8 θ²; at the ends, 1.9 mrad, that is a fifth more."""
    found = identify_stiffness(locked(1e4, 0.0, cubic=2e8))
    assert "not linear" in found.warnings[0]
    assert found.hardening.value > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 3, 8, 12])
def test_a_link_that_moves_is_not_a_locked_output(index):
    """Torque goes into its inertia; with its encoder, its motion is seen, and without, that no spring explains the torque."""
    log = joint_case(index).record
    without = Record(log.time, {name: values for name, values in log.channels.items() if name != "link_position"}, log.sample_time)
    assert_refused(lambda: identify_stiffness(without), ["stiffness:", "fix"])
    if log.has("link_position"):
        assert_refused(lambda: identify_stiffness(log), ["link_position moves by", "fix the output"])


def test_a_stiffness_that_cannot_be_told_is_refused():
    log = locked(1e4, 1.0, 5.0)
    still = Record(log.time, log.channels | {"motor_position": np.zeros(len(log.time))}, TICK)
    assert_refused(lambda: identify_stiffness(still), ["spans 0 rad", "larger torque"])
    once = Record(log.time[:1000], {name: values[:1000] for name, values in log.channels.items()}, TICK)
    assert_refused(lambda: identify_stiffness(once), ["one way only"])
