"""Each cause of a vibration is named where it alone is at work, in recordings by a simulator that shares nothing with the package.

The joint.yaml is a few percent off, as files are. Where nothing listed is at work, nothing is named.
"""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.record import Record
from gainroom.identification.recorded_oscillation import RecordedOscillation
from gainroom.report.diagnosis_text import advice
from gainroom.simulation.oscillation import Vibration
from gainroom.studies.diagnosis import Diagnosis, diagnose
from gainroom.studies.vibration_causes import _quantisation
from gainroom.system.system import System
from independent.joint_run import Drive, Joint, Law, Outer, Run, Setup, limit, run

TICK, STEP = 1e-3, 2e-5
LOOSE = Setup(Joint(0.12, 0.27, 8000.0, 1.5), Drive(4800.0, 0.9, 1.75e-3), Law(400.0, 17.7), TICK, step=STEP, noise=0.2 * STEP)
"""A joint whose gains may be 2.5 times as high."""
SETUP = replace(LOOSE, drive=replace(LOOSE.drive, delay=LOOSE.delay))
TO_LIMIT = limit(SETUP)
RATIO = 9.0


def described(setup: Setup = SETUP) -> System:
    """What a joint.yaml says: 4 % off, the gear ratio given."""
    joint, drive, law = setup.joint, setup.drive, setup.law
    source = gr.ElasticJoint(1.03 * joint.motor_inertia, 0.97 * joint.link_inertia, 1.04 * joint.stiffness, joint.damping)
    control = gr.PID(law.kp, law.ki, law.kd) if law.ki else gr.PD(law.kp, law.kd)
    given = gr.Drive(drive.bandwidth, drive.damping_ratio, 0.96 * setup.delay)
    return System.of_joint(source, given, control, sample_time=setup.tick, entered={"gear_ratio": RATIO})


def recorded(made: Run, every: int = 1) -> Record:
    columns = {name: made.columns[name][::every] for name in ("target_torque", "actual_torque", "motor_position", "reference")}
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(columns["reference"]))
    columns["actual_torque"] = columns["actual_torque"] + noise
    return Record(made.setup.tick * every * np.arange(len(noise)), columns, made.setup.tick * every)


def judged(setup: Setup, made: Run, every: int = 1) -> Diagnosis:
    return diagnose(recorded(made, every), described(setup))


def time(seconds: float) -> np.ndarray:
    return TICK * np.arange(round(seconds / TICK))


def step(seconds: float, size: float = 0.05) -> np.ndarray:
    return np.where(time(seconds) < 0.2, 0.0, size)


def named(found: Diagnosis) -> str | None:
    assert found.vibrates
    return None if found.cause is None else found.cause.name


@pytest.mark.parametrize(
    ("hz", "shape"),
    [
        (1.7, np.sin),
        (0.9, lambda turn: np.maximum(np.sin(turn), 0.0) ** 2),  # pushes of a gait
        (3.1, lambda turn: np.sin(turn) + 0.4 * np.sin(2 * turn + 1)),
        (6.0, lambda turn: np.sign(np.sin(turn))),
    ],
)
def test_a_torque_from_outside(hz: float, shape):
    """On the link. No notch is advised, which at that frequency would take the loop's own phase."""
    made = run(SETUP, step(6.0), outside=5.0 * shape(2 * np.pi * hz * time(6.0)))
    found = judged(SETUP, made)
    assert named(found) == "external_torque"
    assert not any("put a notch" in text for text in advice(found))
    assert named(diagnose(recorded(made))) in ("external_torque", None)  # without the file


def test_what_begins_in_the_middle_of_a_log_does_not_grow():
    """A torque from outside that is switched on: its swing grows to its size, and no more."""
    outside = 5.0 * np.sin(2 * np.pi * 2 * time(6.0)) * (time(6.0) > 3)
    assert named(judged(SETUP, run(SETUP, step(6.0), outside=outside))) == "external_torque"


@pytest.mark.parametrize(("periods", "speeds"), [(4, (1.0, 2.1)), (12, (0.6, -0.25, 1.1)), (1, (2.0, 4.5))])
def test_torque_that_comes_with_the_turning(periods: int, speeds: tuple[float, ...]):
    """So many periods per turn of the motor: the frequency is that of the speed, whichever way it turns."""
    wanted = TICK * np.cumsum(np.repeat(speeds, 3000))
    order = periods * RATIO
    found = judged(SETUP, run(replace(SETUP, ripple=(4.0, order, 0.3)), wanted, bound=100.0))
    assert named(found) == "torque_ripple"
    assert found.predicted is not None
    assert found.predicted.order == pytest.approx(periods, rel=0.02)


@pytest.mark.parametrize(("gap", "share"), [(2e-3, 0.6), (8e-3, 0.6), (8e-4, 0.65)])
def test_a_gap_in_the_gear(gap: float, share: float):
    """The motor alone takes less gain than the motor with its link, where the gear is stiff: it vibrates within the gap."""
    stiff = replace(SETUP, joint=replace(SETUP.joint, stiffness=150_000.0, damping=30.0), law=Law(200.0, 9.0))
    setup = replace(stiff, law=stiff.law.scaled(share * limit(stiff)))
    made, calm = (run(replace(setup, joint=joint), step(3.0, 6 * gap)) for joint in (replace(setup.joint, gap=gap), setup.joint))
    assert np.ptp(made.last) > 10 * np.ptp(calm.last)
    assert named(judged(setup, made)) == "backlash"


@pytest.mark.parametrize("every", [8, 10, 13])
def test_a_log_slower_than_the_vibration(every: int):
    """The loop is 20 % beyond its limit; the log folds its frequency."""
    setup = replace(SETUP, law=SETUP.law.scaled(1.2 * TO_LIMIT), drive=replace(SETUP.drive, target_limit=20.0))
    made = run(setup, step(6.0))
    turn = np.abs(np.fft.rfft(made.last - made.last.mean()))
    true = float(np.argmax(turn)) / (len(made.last) * TICK)
    assert true > 0.5 / (every * TICK)
    found = judged(setup, made, every)
    assert named(found) == "aliasing"
    assert found.predicted is not None
    assert found.predicted.alias is not None
    assert found.predicted.alias.frequency == pytest.approx(2 * np.pi * true, rel=0.01)
    file = gr.gain_limit(described(setup).loop()).gain  # of the file's loop, which is some percent off
    assert found.factor == pytest.approx(min(file, 1.0) / found.required, rel=1e-6)
    assert file == pytest.approx(1 / 1.2, rel=0.1)


@pytest.mark.parametrize(
    ("rate", "gain", "kind"),
    [(50, 3.0, "policy"), (20, 2.0, "policy"), (25, 0.5, "integral")],
)
def test_a_set_point_that_answers_the_joint(rate: int, gain: float, kind: str):
    """The goal rests; the loop around the joint's swings within what it may ask for."""
    every = round(1 / rate / TICK)
    setup = replace(SETUP, outer=Outer(every, 2 * every, gain, 0.0, 0.0, 0.08, kind))
    made = run(setup, step(6.0, 0.06))
    assert np.ptp(made.last) > 0.02
    assert named(judged(setup, made)) == "outer_loop"


@pytest.mark.slow
@pytest.mark.parametrize(("hz", "held"), [(2.0, 1), (4.0, 20)])
def test_a_set_point_that_is_commanded_is_no_vibration(hz: float, held: int):
    """The same swings, from a generator; with harmonics, as a gait has them."""
    at = time(4.0)[::held].repeat(held)[:4000]
    for wanted in (0.06 * np.sin(2 * np.pi * hz * at), 0.05 * np.sin(2 * np.pi * hz * at) + 0.02 * np.sin(4 * np.pi * hz * at + 1)):
        assert not judged(SETUP, run(SETUP, wanted)).vibrates


@pytest.mark.parametrize("target", [True, False])
@pytest.mark.parametrize("over", [1.15, 1.33])
def test_gains_that_a_torque_limit_holds_are_told_by_what_it_leaves(target: bool, over: float):
    """The gains are the file's, and the factor that is advised is from the limit of the loop that runs, not of the file's.

    By the spectral radius of the sampled loop; beside the fundamental the torque has harmonics of some percent.
    """
    bound = {"target_limit": 22.0} if target else {"limit": 22.0}
    setup = replace(SETUP, law=SETUP.law.scaled(over * TO_LIMIT), drive=replace(SETUP.drive, **bound))
    found = judged(setup, run(setup, step(4.0)))
    assert named(found) == "gain_limit"
    assert found.predicted is not None
    assert found.predicted.applied == 1.0
    assert found.factor == pytest.approx(1 / over / found.required, rel=0.02)


def test_what_no_evidence_supports_is_unknown():
    """A torque from outside at 35 Hz, where the delayed controller no longer brakes: no structure that resonates is named."""
    for hz in (25.0, 35.0):
        found = judged(SETUP, run(SETUP, step(4.0), outside=20.0 * np.sin(2 * np.pi * hz * time(4.0))))
        assert named(found) in (None, "external_torque")
        assert all(cause.likelihood < 0.7 for cause in found.causes if cause.name not in ("external_torque", "unknown"))


@pytest.mark.parametrize("steps", [1.0, 20.0])
@pytest.mark.parametrize(("state", "growth"), [("growing", 0.5), ("decaying", -0.5)])
def test_what_grows_or_decays_speaks_against_encoder_steps(steps: float, state: str, growth: float):
    """A limit cycle of an encoder's steps keeps its size; that one does is no evidence by itself."""

    def evidence(state: str, growth: float) -> dict[str, float]:
        seen = RecordedOscillation(Vibration(200.0, growth, steps * STEP), state, "motor_position", slice(0, 1000), {}, STEP)
        return {one.name: one.weight for one in _quantisation(seen, None)}

    kept, changing = evidence("sustained", 0.0), evidence(state, growth)
    assert "growth" not in kept
    assert changing["growth"] < 0
    assert {name: weight for name, weight in changing.items() if name != "growth"} == kept
