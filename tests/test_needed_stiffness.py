"""How stiff gearboxes must be: against gain limits that other formulas give, gearbox by gearbox, all the way from soft to stiff."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.linalg import expm

import gainroom as gr
from gainroom.cli import main
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.report.number_format import rounded_up
from gainroom.studies.needed_stiffness import NeededStiffness, needed_stiffness
from gainroom.studies.state import State

LEG = Path(__file__).parents[1] / "examples" / "robot.xml"
MARGIN = 2.0
USUAL = gr.Requirements(gain_margin=MARGIN)
DAMPING_RATIO = 0.05


def continuous_limit(joint: gr.ElasticJoint, kp: float, kd: float, delay: float) -> float:
    """The smallest g with g L(jω) = −1, L in closed form: gains near 0 are stable, so that no root has crossed below it."""
    omega = np.geomspace(1e-2, 1e5, 60_001)
    s = 1j * omega
    J, load = joint.motor_inertia, joint.link_inertia
    spring = 1 / (joint.stiffness + joint.damping * s)
    plant = (load * s**2 * spring + 1) / (s**2 * (J * load * s**2 * spring + J + load))
    loop = (kp + kd * s) * np.exp(-s * delay) * plant
    crosses = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0) & (loop.real[:-1] < 0))
    share = loop.imag[crosses] / (loop.imag[crosses] - loop.imag[crosses + 1])
    return float(np.min(-1 / (loop.real[crosses] + share * np.diff(loop.real)[crosses])))


def sampled_stable(joint: gr.ElasticJoint, kp: float, kd: float, ticks: int, step: float) -> bool:
    """The eigenvalues of one tick: torque held, `ticks` of delay in a row of registers, velocity by backward difference."""
    J, load, K, B = joint.motor_inertia, joint.link_inertia, joint.stiffness, joint.damping
    a = np.array([[0, 1, 0, 0], [-K / J, -B / J, K / J, B / J], [0, 0, 0, 1], [K / load, B / load, -K / load, -B / load]])
    b = np.array([[0], [1 / J], [0], [0]])
    if math.isinf(K):
        a, b = np.array([[0.0, 1], [0, 0]]), np.array([[0], [1 / (J + load)]])
    whole = expm(step * np.block([[a, b], [np.zeros((1, len(a) + 1))]]))
    size = len(a)
    tick = np.zeros((size + 1 + ticks, size + 1 + ticks))  # plant, position one tick ago, torques on their way
    tick[:size, :size] = whole[:size, :size]
    tick[size, 0] = 1.0
    law = np.zeros(size + 1 + ticks)
    law[0], law[size] = -(kp + kd / step), kd / step
    if ticks:
        tick[:size, -1] = whole[:size, size]
        tick[size + 1] = law
        tick[np.arange(size + 2, size + 1 + ticks), np.arange(size + 1, size + ticks)] = 1.0
    else:
        tick[:size] += np.outer(whole[:size, size], law)
    return bool(np.abs(np.linalg.eigvals(tick)).max() < 1)


def has_margin(joint: gr.ElasticJoint, kp: float, kd: float, delay: float, step: float | None, margin: float = MARGIN) -> bool:
    """No factor from 1 to `margin` makes it vibrate."""
    if step is None:
        return continuous_limit(joint, kp, kd, delay) >= margin
    return all(sampled_stable(joint, g * kp, g * kd, round(delay / step), step) for g in np.geomspace(1, margin, 9))


def of_joint(joint: gr.ElasticJoint, kp: float, kd: float, delay: float, step: float | None) -> NeededStiffness | None:
    system = gr.System.of_joint(joint, gr.Drive(bandwidth=math.inf, damping_ratio=1.0, delay=delay), gr.PD(kp, kd), "motor", step, USUAL)
    state = State(system, "", "", system.source.linearize())
    return needed_stiffness(system, [state], DAMPING_RATIO)


def population(count: int) -> list[tuple]:
    """Joints that are safe with rigid gearboxes, in continuous time and at ticks of 1 and 2 ms."""
    random, found = np.random.default_rng(11), []
    dipping = gr.ElasticJoint(motor_inertia=0.022775422538024823, link_inertia=0.09776622198884694)
    found.append((dipping, 7.414983052977981, 1.1501975246093556, 3e-3, 1e-3))  # 1.989 between two looks with more than 2
    while len(found) < count:
        step = (None, 1e-3, 2e-3)[len(found) % 3]
        inertia, load = 10 ** random.uniform(-2.5, 0.5), 10 ** random.uniform(-0.7, 1.5)
        delay = (step or 1e-3) * int(random.integers(0 if step else 1, 5))
        kd = inertia * (1 + load) * 10 ** random.uniform(0.5, 2.5)
        kp = kd * 10 ** random.uniform(0, 1.3)
        rigid = gr.ElasticJoint(motor_inertia=inertia, link_inertia=inertia * load)
        if has_margin(rigid, kp, kd, delay, step, 1.02 * MARGIN) and kd > 0:
            found.append((rigid, kp, kd, delay, step))
    return found


def geared(rigid: gr.ElasticJoint, resonance: float) -> gr.ElasticJoint:
    inertia = rigid.motor_inertia
    return gr.ElasticJoint(inertia, rigid.link_inertia, inertia * resonance**2, 2 * DAMPING_RATIO * inertia * resonance)


SHARE = pytest.mark.parametrize("count", [13, pytest.param(30, marks=pytest.mark.population)])


@pytest.mark.slow
@SHARE
def test_what_is_needed_is_safe_all_stiffer_gearboxes_are_and_a_little_softer_is_not(count: int):
    """Of a population, scanned in steps of 3.5 % of Ω, which no search knows of. The last digit of a limit may differ: 1e-3 of it."""
    softer_unsafe = 0
    for rigid, kp, kd, delay, step in population(count):
        found = of_joint(rigid, kp, kd, delay, step)
        assert found is not None
        assert found.least is not None
        least = found.least
        assert least.stiffness[0] == pytest.approx(rigid.motor_inertia * least.resonance**2)
        assert least.damping[0] == pytest.approx(2 * DAMPING_RATIO * math.sqrt(least.stiffness[0] * rigid.motor_inertia))
        for resonance in least.resonance * np.geomspace(1, 60, 120):
            assert has_margin(geared(rigid, resonance), kp, kd, delay, step, MARGIN * (1 - 1e-3)), (rigid, kp, kd, delay, step, resonance)
        if found.unsafe is not None:
            softer_unsafe += 1
            assert found.unsafe.resonance < least.resonance <= 1.0051 * found.unsafe.resonance * 1.1**12
            assert not has_margin(geared(rigid, found.unsafe.resonance), kp, kd, delay, step)
        else:
            assert least.stiffness[0] == pytest.approx(kp)  # as soft as the gains themselves
    assert softer_unsafe >= 0.3 * count  # or this shows nothing


@pytest.mark.slow
@SHARE
def test_every_look_is_right(count: int):
    """Each with its limit in closed form, safe or not, also where it is not stable."""
    for rigid, kp, kd, delay, step in population(count):
        if step is not None:
            continue
        found = of_joint(rigid, kp, kd, delay, step)
        assert found is not None
        for look in found.looks:
            truth = continuous_limit(geared(rigid, look.resonance), kp, kd, delay)
            assert look.gain_limit == pytest.approx(truth, rel=1e-3)
            assert look.safe == (look.gain_limit >= MARGIN)


MOTOR = 0.05
GAINS = {".*": {"kp": 200, "kd": 8, "motor_inertia": MOTOR}}
ALIKE = ("--delay-ms", "2", "--rate-hz", "1000", "--gains", "alike.yaml")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("alike.yaml").write_text(yaml.safe_dump(GAINS), "utf-8")


def asked(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, dict]:
    status = main(["audit", str(LEG), *options, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_typed_again_what_is_needed_is_safe_and_the_next_softer_is_not(capsys: pytest.CaptureFixture[str]):
    """Of `audit --json`; all motors are alike, so that one number is needed of all gearboxes."""
    status, told = asked(capsys, *ALIKE)
    needed = told["needed_stiffness"]
    assert (status, told["safe"], told["requirements_met"]) == (3, False, True)
    assert len({joint["stiffness"] for joint in needed["joints"]}) == 1
    first = needed["joints"][0]
    softer = next(look for look in needed["looks"] if not look["safe"])
    for stiffness, damping, safe in (
        (first["stiffness"], first["damping"], True),
        (softer["stiffness_low"], 2 * DAMPING_RATIO * MOTOR * softer["resonance_rad_s"], False),
    ):
        _, again = asked(capsys, *ALIKE, "--stiffness", repr(stiffness), "--damping", repr(damping))
        assert again["requirements_met"] is safe
        assert again["needed_stiffness"] is None  # it has been told
    alone = min(joint["gain_limit"] for joint in again["joints"])
    assert min(again["gain_limit"], alone) == pytest.approx(softer["gain_limit"], rel=1e-9)


@pytest.mark.slow
def test_the_stiffness_that_holds_rounded_up_holds(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """What the answer has, rounded up and typed for each joint, is safe: K, and B = 2 ζ √(K J)."""
    _, told = asked(capsys, "--delay-ms", "0.5", "--rate-hz", "2000")
    stiffness = [joint["stiffness"] for joint in told["needed_stiffness"]["joints"]]
    factor = 2 * told["needed_stiffness"]["damping_ratio"]
    rows = {}
    for joint, needed in zip(told["joints"], stiffness, strict=True):
        typed, inertia = rounded_up(needed), joint["motor_inertia"]
        own = {name: joint[name] for name in ("kp", "kd", "motor_inertia")}
        rows[joint["name"]] = own | {"stiffness": typed, "damping": factor * math.sqrt(typed * inertia)}
    gains = tmp_path / "gains.yaml"
    gains.write_text(yaml.safe_dump(rows), "utf-8")
    status, again = asked(capsys, "--delay-ms", "0.5", "--rate-hz", "2000", "--gains", str(gains))
    assert (status, again["safe"]) == (0, True)


@pytest.mark.slow
@pytest.mark.parametrize("options", [("--delay-ms", "2"), ("--delay-ms", "0.5", "--stiffness", "50000", "--damping", "20")])
def test_nothing_is_needed_of_unsafe_gains_or_known_gearboxes(capsys: pytest.CaptureFixture[str], options: tuple[str, ...]):
    assert asked(capsys, *options)[1]["needed_stiffness"] is None


@pytest.mark.slow
def test_more_damping_needs_less_stiffness_and_the_ratio_is_stated(capsys: pytest.CaptureFixture[str]):
    softest = {}
    for ratio in ("0.02", "0.3"):
        _, told = asked(capsys, *ALIKE, "--damping-ratio", ratio)
        assert told["needed_stiffness"]["damping_ratio"] == float(ratio)
        assert any(f"a damping ratio ζ of {ratio} (--damping-ratio)" in text for text in told["assumptions"])
        softest[ratio] = told["needed_stiffness"]["joints"][0]["stiffness"]
    assert softest["0.3"] < softest["0.02"]


@pytest.mark.slow
def test_a_robot_in_several_states_stays_safe_however_stiff_its_gearboxes():
    """A biped, in flight and on one foot: gain limits at stiffnesses that no search knows of, up to where rigid ones are as good."""
    Path("alike.yaml").write_text('".*": {kp: 2000, kd: 100, motor_inertia: 1}', "utf-8")
    options = AuditOptions(2.0, contacts=("left_sole",), posture=(".*_knee=0.6",))
    system = audited("gainroom:biped.urdf", Path("alike.yaml"), options).system
    system = replace(system, requirements=USUAL)
    states = [State(system, *names, system.source.linearize(*names)) for names in system.source.states]
    found = needed_stiffness(system, states, DAMPING_RATIO)
    assert found is not None
    assert found.least is not None
    for resonance in found.least.resonance * np.geomspace(1, 100, 90):
        for state in states:
            geared = replace(state.model, stiffness=np.full(12, resonance**2), damping=np.full(12, 2 * DAMPING_RATIO * resonance))
            limit = gr.gain_limit(system.loop(geared))
            assert limit.stable
            assert limit.gain >= 0.99 * MARGIN, (state.contact, resonance)
    assert found.unsafe is not None
