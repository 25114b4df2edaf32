"""Limits in many postures, begun one from the other: against gain_limit posture by posture, and independent counts of roots."""

import math
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.margin_record import NUDGE
from gainroom.analysis.modal_loop import ModalLoop
from gainroom.analysis.proved_limit import posture_limits, proved_limit
from gainroom.files.robot_yaml import load_robot_system
from gainroom.robot.linearize import linearize
from gainroom.studies.sweep.limits import StateLimits, configurations
from gainroom.system.modes import posture_modes
from gainroom.system.plant import Plant
from gainroom.system.system import System
from independent.machine import unstable
from machines import Pair, limbs, paired
from robot_files import ROBOT, SOLO, write_arm, written

BIPED = files("gainroom") / "files" / "examples" / "biped.yaml"
POPULATION, SHARE, POSTURES = 1200, 3, 5
PROVED = 1 - NUDGE
"""Of a crossing: up to there it is proved."""


def inertias(rng: np.random.Generator, count: int, size: int, rank: int | None = None) -> np.ndarray:
    mixing = rng.normal(size=(count, size, rank or size))
    return mixing @ mixing.swapaxes(1, 2) * rng.uniform(0.1, 10)


@pytest.mark.parametrize("rank", [None, 2])
@pytest.mark.parametrize("rigid", [False, True])
def test_the_modes_of_all_postures_are_the_response(rank, rigid):
    """Four times `inexact`, which is what the core allows for, bounds the distance from the solved response, resonances included."""
    for seed in range(6):
        rng = np.random.default_rng([seed, 2])
        size = int(rng.integers(2, 9))
        w, inertia = inertias(rng, 4, size, rank), rng.uniform(0.1, 2, size)
        stiffness = np.full(size, math.inf) if rigid else rng.uniform(3e3, 3e4, size)
        damping = np.zeros(size) if rigid else rng.uniform(1e-5, 1e-3) * stiffness
        found = posture_modes(w, inertia, stiffness, damping)
        assert found is not None
        for k in range(len(w)):
            rates = np.abs(found.poles[k])
            s = 1j * np.concatenate([np.geomspace(0.3, 3e4, 50), rates, 1.01 * rates])
            terms = 1 / ((s[:, None] - found.poles[k]) * (s[:, None] - found.partners[k]))
            seen = found.rigid[k] / s[:, None, None] ** 2 + (found.shapes[k].T * terms[:, None]) @ found.shapes[k]
            right = Plant(w[k], inertia, stiffness, damping).response(s, "motor")
            off = np.abs(seen - right).max(axis=(1, 2)) / np.abs(right).max(axis=(1, 2))
            assert off.max() <= 4 * found.inexact[k] + 1e-13  # the solved response itself is no better
            assert found.inexact[k] < 1e-7


def test_other_joints_have_no_common_modes():
    w = np.eye(3)[None]
    ones = np.ones(3)
    assert posture_modes(w, ones, 1e4 * ones, np.array([1.0, 1.0, 2.0])) is None
    assert posture_modes(w, ones, np.array([1e4, 1e4, math.inf]), ones) is None
    assert posture_modes(w, ones, 1e4 * ones, 0 * ones) is None


def test_a_mode_whose_poles_are_as_good_as_one_is_not_used():
    """A single joint with B = 2 √(K/(W + 1/J)) is critically damped."""
    found = posture_modes(np.ones((1, 1, 1)), np.ones(1), np.array([1e4]), np.array([2 * math.sqrt(1e4 / 2)]))
    assert found is not None
    assert np.isinf(found.inexact[0])


@pytest.mark.parametrize("number", range(SHARE))
def test_limits_of_near_equal_limbs(number):
    assert_limits(number)


@pytest.mark.population
def test_limits_of_the_population():
    """No limit is wrong, and nine of ten that can be proved one by one are proved in a row."""
    proved, asked = np.sum([assert_limits(number) for number in range(POPULATION)], axis=0)
    assert proved > 0.9 * asked


def assert_limits(number: int) -> tuple[int, int]:
    """Limbs in postures far apart, one after the other, against the proof of each alone and an independent count on both sides of one.

    How many are proved, of how many that can be.
    """
    rng = np.random.default_rng([number, 77])
    pair = limbs(4244, number)
    machine = replace(pair.machine, damping=rng.uniform(2e-5, 4e-4) * pair.machine.stiffness)
    modal = ModalLoop.of(of(pair, machine).loop)
    core = None if modal is None else posture_limits(modal)
    if core is None:
        return 0, 0
    shapes = [np.eye(pair.loop.size) + 0.3 * rng.normal(size=2 * (pair.loop.size,)) for _ in range(POSTURES)]
    w = np.array([shape @ machine.inverse_inertia @ shape.T for shape in shapes])
    stacks = posture_modes(w, machine.motor_inertia, machine.stiffness, machine.damping)
    assert stacks is not None
    answers = core.run(*stacks)
    done = asked = 0
    for k, (inverse, proved, (gain, omega, joint)) in enumerate(zip(w, answers[0][:, 0], answers[1], strict=True)):
        at = of(pair, replace(machine, inverse_inertia=inverse))
        alone = proved_limit(at.loop)
        asked += alone is not None
        if not proved:
            continue
        done += 1
        if math.isinf(gain):
            assert unstable(at.scaled(1e3).machine) == 0
            continue
        if k == 1 + number % (POSTURES - 1):  # not the first, which is begun from nothing; one alone, as counts take long
            for share in (0.1, 0.9, 1 - NUDGE):
                assert unstable(at.scaled(share * gain).machine) == 0
            assert unstable(at.scaled((1 + NUDGE) * gain).machine) > 0
        value = np.linalg.eigvals(at.loop.scaled(gain).response(np.array([omega]))[0])
        assert np.abs(value + 1).min() < 1e-8
        if alone is not None:
            assert gain == pytest.approx(alone.gain, rel=NUDGE)  # crossings of equal limbs that are closer count as one
        assert 0 <= joint < pair.loop.size
    return done, asked


def of(pair: Pair, machine) -> Pair:
    return paired(machine, pair.loop.parts.controller, pair.kind)


def random_angles(body, count: int, seed: int = 0) -> np.ndarray:
    low, high = np.maximum(body.lower, -math.pi), np.minimum(body.upper, math.pi)
    return low + (high - low) * np.random.default_rng(seed).random((count, body.size))


def alone(system, angles, contact: str):
    """gain_limit of every posture."""
    robot = system.source
    return [
        gr.gain_limit(system.loop(linearize(robot.body, robot.actuators, q, robot.contacts[contact])))
        for q in configurations(robot.body, angles)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["double", "left", "flight"])
def test_a_biped_in_random_postures(contact):
    """Every limit is proved, and that of gain_limit, to 1e-9; the joint is the one that moves most. Of unstable gains it is below 1."""
    system = load_robot_system(BIPED)
    angles = random_angles(system.source.body, 12)
    for factor in (1.0, 20.0):
        pd = system.control.controller
        scaled = system.with_controller(replace(pd, kp=factor * pd.kp, kd=factor * pd.kd))
        found = StateLimits(scaled, contact).limits(angles)
        assert found.certified.all()
        assert not found.lower.any()
        for k, limit in enumerate(alone(scaled, angles, contact)):
            assert found.gain[k] == pytest.approx(limit.gain * PROVED, rel=1e-9)
            assert found.frequency[k] == pytest.approx(limit.frequency, rel=1e-6)
            if abs(np.sort(np.abs(limit.mode))[-2] - 1) > 1e-3:
                assert found.joint[k] == np.argmax(np.abs(limit.mode))


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["double", "left", "flight"])
def test_no_limit_lies_above_the_one_that_is_computed_alone(contact):
    """Begun one from the other they are no more than 2e-6 below the crossing that gain_limit finds from nothing, and never above it.

    Both crossings are true ones, so both are at or above the lowest, and both proofs end 1e-6 below: they differ by 1e-6 at most.
    """
    system = load_robot_system(BIPED)
    angles = random_angles(system.source.body, 150, 7)
    found = StateLimits(system, contact).limits(angles)
    assert found.certified.all()
    share = found.gain / [limit.gain for limit in alone(system, angles, contact)]
    assert share.max() <= 1
    assert share.min() >= 1 - 2 * NUDGE


def test_at_a_limit_no_root_has_crossed():
    """Counted independently of every proof: roots of the biped's loop at the limit that is kept, and just above."""
    system = load_robot_system(BIPED)
    robot = system.source
    angles = random_angles(robot.body, 3, 8)
    found = StateLimits(system, "left").limits(angles)
    for q, gain in zip(configurations(robot.body, angles), found.gain.tolist(), strict=True):
        loop = system.loop(linearize(robot.body, robot.actuators, q, robot.contacts["left"]))
        assert gr.is_stable(loop.scaled(gain))
        assert not gr.is_stable(loop.scaled(gain * (1 + 3 * NUDGE)))


def test_the_same_wherever_and_in_whatever_company():
    """A batch gives the same bytes again; parts of it the same numbers, to the digits of a root that is polished."""
    system = load_robot_system(BIPED)
    angles = random_angles(system.source.body, 40, 3)
    one, two = StateLimits(system, "left"), StateLimits(system, "left")
    whole, again = one.limits(angles), two.limits(angles)
    assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))
    parts = np.concatenate([two.limits(angles[:13]).gain, two.limits(angles[13:]).gain])
    assert parts == pytest.approx(whole.gain, rel=1e-12)


ARMS = {
    "sampled": lambda text: text,
    "rigid": lambda text: text.replace("stiffness: 8000.0, damping: 4.0", ""),
    "one rigid joint": lambda text: text.replace("damping: 4.0}", "damping: 4.0}\n  elbow: {stiffness: .inf}").replace(
        "sample_rate_hz: 2000, ", ""
    ),
    "unlike gearboxes": lambda text: text.replace("damping: 4.0}", "damping: 4.0}\n  elbow: {stiffness: 3000.0}"),
    "friction": lambda text: text.replace("damping: 4.0", "damping: 4.0, viscous: 0.3").replace("viscous", "motor_viscous"),
    "gravity": lambda text: text.replace("base: fixed", "base: fixed, gravity_stiffness: true"),
    "no damping": lambda text: text.replace("damping: 4.0", "damping: 0.0").replace("sample_rate_hz: 2000, ", ""),
    "tasks": lambda text: text.replace("feedback: motor, sample_rate_hz: 2000, kp: 400.0, kd: 30.0", "space: task, feedback: motor"),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ARMS)
def test_every_kind_of_robot_has_its_limits(tmp_path, kind):
    """Proved in a row or asked one by one: the numbers are those of gain_limit."""
    system = load_robot_system(write_arm(tmp_path, ARMS[kind](ROBOT)))
    robot = system.source
    angles = random_angles(robot.body, 12, 5)
    found = StateLimits(system, "free").limits(angles)
    for k, q in enumerate(configurations(robot.body, angles)):
        try:
            limit = gr.gain_limit(system.loop(linearize(robot.body, robot.actuators, q, (), gravity=bool(robot.gravity))))
        except gr.GainroomError:
            assert np.isnan(found.gain[k])
            assert not found.certified[k]
            continue
        assert found.gain[k] == pytest.approx(limit.gain * PROVED, rel=1e-9)
        assert found.lower[k] == pytest.approx(limit.lower_gain * (1 + NUDGE), rel=1e-9)


@pytest.mark.slow
def test_a_quadruped_on_point_feet(tmp_path):
    system = load_robot_system(written(tmp_path, SOLO))
    angles = random_angles(system.source.body, 20)
    found = StateLimits(system, "all").limits(angles)
    for k, limit in enumerate(alone(system, angles, "all")):
        assert found.gain[k] == pytest.approx(limit.gain * PROVED, rel=1e-9)


def test_postures_are_those_of_the_body(tmp_path):
    body = load_robot_system(written(tmp_path, SOLO)).source.body
    angles = random_angles(body, 5)
    for q, values in zip(configurations(body, angles), angles, strict=True):
        assert np.array_equal(q, body.configuration(dict(zip(body.joint_names, values.tolist(), strict=True))))


def test_what_is_refused(tmp_path):
    system = load_robot_system(BIPED)
    with pytest.raises(gr.GainroomError, match="contact 'hands' is not one of double, left, right, flight"):
        StateLimits(system, "hands")
    joint = gr.ElasticJoint(1.0, 1.0, 1e4, 1.0)
    with pytest.raises(gr.GainroomError, match="a sweep needs a robot"):
        StateLimits(System.of_joint(joint, gr.Drive(delay=1e-3), gr.PD(1.0, 1.0)), "")
