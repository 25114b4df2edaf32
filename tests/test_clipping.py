"""Rows of a limited torque are found whatever limits it, and smooth or held torques are left alone; what is left tells the gains."""

import numpy as np
import pytest

from gainroom.files.joint_yaml import parse_joint
from gainroom.identification import Record, identify_gains
from gainroom.identification.clipping import limited_rows
from gainroom.report.diagnosis_text import warnings
from gainroom.studies.diagnosis import diagnose
from refusals import assert_refused

TICK, COUNT, STEP = 1e-3, 6000, 2e-5
TIME = TICK * np.arange(COUNT)
KP, KD = 700.0, 12.0


def smooth(seed: int, low: float = 1.0, high: float = 60.0) -> np.ndarray:
    """Of unit deviation."""
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 30)
    values = np.sin(2 * np.pi * np.outer(TIME, np.geomspace(low, high, 30)) + phases).sum(axis=1)
    return values / values.std()


POSITION = STEP * np.round((0.02 * smooth(1, 0.5, 25.0)) / STEP)
REFERENCE = 0.03 * np.sin(2 * np.pi * 0.7 * TIME)
ERROR = REFERENCE - POSITION
LAW = KP * ERROR - KD * np.diff(POSITION, prepend=POSITION[0]) / TICK
SIZE = float(LAW.std())
COOLING = SIZE * np.linspace(1.4, 0.8, COUNT)
NOISE = 0.01 * SIZE * np.random.default_rng(3).standard_normal(COUNT)


def followed(wanted: np.ndarray, most: float) -> np.ndarray:
    """A torque that goes after `wanted` by at most `most` per row."""
    made = wanted.copy()
    for row in range(1, len(made)):
        made[row] = made[row - 1] + np.clip(wanted[row] - made[row - 1], -most, most)
    return made


def record(torque: np.ndarray, name: str = "target_torque") -> Record:
    return Record(TIME, {"reference": REFERENCE, "motor_position": POSITION, name: torque}, TICK)


FAST = float(np.quantile(np.abs(np.diff(LAW)), 0.8))
LIMITS = {
    "two sides": (np.clip(LAW, -SIZE, SIZE), np.abs(LAW) >= SIZE),
    "one side": (np.minimum(LAW, 0.8 * SIZE), LAW >= 0.8 * SIZE),
    "other limits": (np.clip(LAW, -0.7 * SIZE, 1.3 * SIZE), (LAW <= -0.7 * SIZE) | (LAW >= 1.3 * SIZE)),
    "as it gets hot": (np.clip(LAW, -COOLING, COOLING), np.abs(LAW) >= COOLING),
    "rate": (followed(LAW, FAST), followed(LAW, FAST) != LAW),
    "dead zone": (np.where(np.abs(LAW) < 0.4 * SIZE, 0.0, LAW), np.abs(LAW) < 0.4 * SIZE),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_limited_rows_are_found_and_the_others_tell_the_gains(name: str):
    """The law is exact in the rows that are left, so that its gains come back to rounding; with all rows they are 1.5 % off at least."""
    torque, truth = LIMITS[name]
    found = limited_rows(record(torque), "target_torque")
    assert len(found.kinds) == 1
    # Runs shorter than four rows of a dead zone or a rate are not told from chance.
    assert np.mean(found.rows == truth) > (0.99 if found.bounded else 0.9)
    fit = identify_gains(record(torque))
    assert fit.kp.value == pytest.approx(KP, rel=2e-3 if found.bounded else 0.02)
    assert fit.kd.value == pytest.approx(KD, rel=2e-3 if found.bounded else 0.02)
    assert [text for text in fit.warnings if "are left out" in text]
    columns = np.column_stack([ERROR, -np.diff(POSITION, prepend=POSITION[0]) / TICK])
    whole = np.linalg.lstsq(columns, torque, rcond=None)[0]
    assert np.abs(whole / [KP, KD] - 1).max() > 0.015


@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (-np.inf, 0.8), (-0.7, 1.3)])
def test_bounds_are_told_through_noise(low: float, high: float):
    """To the noise; where no bound is reached none is told."""
    found = limited_rows(record(np.clip(LAW, low * SIZE, high * SIZE) + NOISE, "actual_torque"), "actual_torque")
    for value, truth in ((found.low, low), (found.high, high)):
        assert np.isnan(value) if np.isinf(truth) else value == pytest.approx(truth * SIZE, abs=0.01 * SIZE)


@pytest.mark.parametrize(
    "torque",
    [
        LAW,
        LAW + NOISE,
        0.05 * SIZE * np.round(20 * np.sin(2 * np.pi * 0.5 * TIME)),  # tops that rounding makes flat
        np.round(LAW, 1),
        np.repeat(LAW[::20], 20)[:COUNT],  # a policy's command, held
        np.repeat(LAW[::4], 4)[:COUNT],
        SIZE * np.sin(2 * np.pi * 5 * TIME),
        np.repeat(np.random.default_rng(1).uniform(-SIZE, SIZE, 101), 60)[:COUNT],
    ],
    ids=["law", "noise", "rounded sine", "rounded", "held 20", "held 4", "sine", "steps"],
)
def test_what_no_limit_made_is_left_alone(torque: np.ndarray):
    assert not limited_rows(record(torque), "target_torque").kinds


def test_a_held_command_that_is_cut_stands_at_one_level():
    held = np.clip(np.repeat(LAW[::20], 20)[:COUNT], -SIZE, SIZE)
    found = limited_rows(record(held), "target_torque")
    assert found.kinds == ("bound",)
    assert (found.low, found.high) == pytest.approx((-SIZE, SIZE))


def test_a_joint_at_rest_is_not_at_a_limit():
    """Its torque is constant, and the largest of the log."""
    rest = TIME > 3.0
    channels = {"reference": 0 * TIME, "motor_position": np.where(rest, POSITION[3000], POSITION)}
    torque = np.where(rest, 1.1 * np.abs(LAW[:3001]).max(), LAW)
    assert not limited_rows(Record(TIME, channels | {"target_torque": torque}, TICK), "target_torque").kinds


def test_torque_at_its_limit_all_the_time_tells_no_gains():
    torque = np.clip(LAW, -0.05 * SIZE, 0.05 * SIZE)
    assert_refused(lambda: identify_gains(record(torque)), ["target_torque is limited in", "record smaller or slower motion"])


def limit_cycle(kp: float, kd: float, low: float, high: float) -> Record:
    """A sampled PD on an inertia of 0.5 kg m² with viscous friction, moved exactly from tick to tick, its cut torque 4 ticks late."""
    inertia, friction, count = 0.5, 0.8, 3000
    decay, x, v, before = np.exp(-friction / inertia * TICK), 1e-3, 0.0, 0.0
    position, torque = np.zeros(count), np.zeros(count)
    for row in range(count):
        position[row] = STEP * np.round(x / STEP)
        error = -position[row]
        torque[row] = np.clip(kp * error + kd * (error - before) / TICK, low, high)
        before, ahead = error, (torque[row - 4] if row >= 4 else 0.0) / friction
        x, v = x + ahead * TICK + (v - ahead) * (1 - decay) * inertia / friction, ahead + (v - ahead) * decay
    rows = slice(count // 4, None)
    channels = {"reference": np.zeros(count), "motor_position": position, "target_torque": torque}
    return Record(TICK * np.arange(count)[rows], {name: values[rows] for name, values in channels.items()}, TICK)


@pytest.mark.parametrize("factor", [1.0, 0.5, 1.6])
@pytest.mark.parametrize(("low", "high"), [(-6.0, 6.0), (-4.0, 9.0)])
def test_a_vibration_at_the_torque_limit_tells_the_gains_as_they_are(low: float, high: float, factor: float):
    """The log's gains over the file's, of which a limited swing shows less: to a thousandth."""
    kp, kd = 9000.0, 220.0
    record = limit_cycle(kp, kd, low, high)
    text = (
        "joint: {motor_inertia: 0.25, link_inertia: 0.25, stiffness: rigid}\n"
        "drive: {bandwidth: .inf, delay_ms: 4}\n"
        f"control: {{type: pd, kp: {kp / factor}, kd: {kd / factor}, feedback: motor, sample_rate_hz: 1000}}\n"
        "limits: {gain_margin_db: 6}\n"
    )
    found = diagnose(record, parse_joint(text, "joint.yaml"))
    assert found.vibrates
    assert found.predicted is not None
    assert found.predicted.applied == pytest.approx(factor, rel=1e-3)
    assert [line for line in warnings(found) if "tell no gains" in line]
