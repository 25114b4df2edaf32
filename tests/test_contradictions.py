"""Channels that contradict each other are named with the factor between them; those that do not are left alone."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification import Record, identify_gains
from gainroom.identification.contradictions import encoders_apart, require_consistent
from gainroom.report.identified_text import gains_answer
from refusals import assert_refused

TICK, COUNT = 1e-3, 6000
TIME = TICK * np.arange(COUNT)
ANGLE = 0.3 * np.sin(11 * TIME) + 0.1 * np.sin(47 * TIME)
RATE = 3.3 * np.cos(11 * TIME) + 4.7 * np.cos(47 * TIME)
TORQUE = np.cumsum(np.random.default_rng(0).normal(size=COUNT + 50))
NOISE = 0.02 * np.random.default_rng(1).normal(size=COUNT)
TARGET, LATE = TORQUE[50:], TORQUE[45:-5]


def record(**channels: np.ndarray) -> Record:
    return Record(TIME, channels, TICK)


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ({"motor_position": np.degrees(ANGLE), "motor_velocity": RATE}, ["motor_position changes 57.3", "180/π, degrees"]),
        ({"link_position": ANGLE, "link_velocity": RATE / (2 * math.pi)}, ["link_velocity", "2π, revolutions"]),
        ({"motor_position": ANGLE, "motor_velocity": RATE * 30 / math.pi}, ["0.105 times", "rpm"]),
        ({"motor_position": ANGLE, "motor_velocity": -RATE}, ["-1 times", "sign"]),
        ({"motor_position": 100 * ANGLE, "motor_velocity": RATE}, ["100", "side of the gearbox"]),
        ({"target_torque": 1e3 * TARGET, "actual_torque": LATE + NOISE}, ["0.001", "1000, milli"]),
        ({"target_torque": TARGET, "actual_torque": -LATE}, ["-1 times"]),
        ({"target_torque": LATE, "actual_torque": TARGET + NOISE}, ["5 ms ahead", "exchange"]),
    ],
)
def test_what_cannot_be_is_named(channels: dict, words: list[str]):
    assert_refused(lambda: require_consistent(record(**channels)), words)


@pytest.mark.parametrize(
    "channels",
    [
        {"motor_position": ANGLE, "motor_velocity": RATE},
        {"motor_position": ANGLE, "motor_velocity": np.roll(RATE, 3)},  # filtered
        {"motor_position": np.round(ANGLE, 1), "motor_velocity": RATE},  # an encoder too coarse for a rate
        {"motor_position": 0 * ANGLE, "motor_velocity": RATE},
        {"target_torque": TARGET, "actual_torque": LATE + NOISE},
        {"target_torque": TARGET, "actual_torque": 0.7 * LATE},
        {"target_torque": TARGET, "actual_torque": np.clip(LATE, -10, 10)},
        {"target_torque": TARGET, "actual_torque": TARGET},
        {"target_torque": np.sin(7 * TIME), "actual_torque": np.sin(7 * (TIME - 2e-3)) + NOISE},
        {"target_torque": 0 * TARGET, "actual_torque": LATE},
        {"target_torque": TARGET, "actual_torque": 1e3 * np.random.default_rng(5).normal(size=COUNT)},
    ],
)
def test_what_may_be_is_left_alone(channels: dict):
    require_consistent(record(**channels))


RATES = (RATE - RATE.mean()) / RATE.std()


def alike(correlation: float) -> np.ndarray:
    """A column of that correlation with RATES, and of slope 1 on it."""
    other = np.cos(311 * TIME)
    other -= other.mean()
    other -= (other @ RATES) / (RATES @ RATES) * RATES
    return RATES + math.sqrt(1 / correlation**2 - 1) / other.std() * other


def quiet_or_refused(channels: dict[str, np.ndarray]) -> str:
    try:
        require_consistent(record(**channels))
    except gr.GainroomError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("factor", "refused"), [(0.45, True), (0.55, False), (1.9, False), (2.1, True), (-0.9, True)])
def test_twice_is_what_filters_and_torque_constants_are_off_by(factor: float, refused: bool):
    """Of rates, torques and encoders alike: beyond a half and twice, or turned round, something is wrong."""
    assert bool(quiet_or_refused({"motor_position": factor * ANGLE, "motor_velocity": RATE})) == refused
    assert bool(quiet_or_refused({"target_torque": TARGET, "actual_torque": factor * LATE})) == refused
    assert bool(encoders_apart(np.column_stack([ANGLE, factor * ANGLE]))) == refused


@pytest.mark.parametrize(("correlation", "judged"), [(0.93, False), (0.97, True)])
def test_columns_that_hardly_go_together_tell_no_factor(correlation: float, judged: bool):
    said = quiet_or_refused({"target_torque": alike(correlation), "actual_torque": 3 * RATES})
    assert bool(said) == judged


@pytest.mark.parametrize(("off", "named"), [(1.02, True), (1 / 1.02, True), (1.045, False), (1 / 1.045, False)])
def test_a_factor_is_named_where_it_is_the_one(off: float, named: bool):
    """2 % off is 2π, 4.5 % off is not."""
    assert ("2π" in quiet_or_refused({"motor_position": 2 * math.pi * off * ANGLE, "motor_velocity": RATE})) == named


@pytest.mark.parametrize(("rows", "seen"), [(90, True), (120, False)])
def test_a_torque_is_looked_for_a_tenth_of_a_second_away(rows: int, seen: bool):
    """One that is 90 ms ahead is found there; at 120 ms the two are not taken for the same."""
    torque = np.cumsum(np.random.default_rng(3).normal(size=COUNT + 200))
    torque -= np.convolve(torque, np.full(101, 1 / 101), "same")  # without slow parts, which go together at any distance
    said = quiet_or_refused({"target_torque": torque[:COUNT], "actual_torque": torque[rows : COUNT + rows]})
    assert ("exchange the two columns" in said) == seen


def test_gains_that_leave_torque_unexplained_are_not_said_to_be_applied():
    """A feed-forward torque beside kp = 100: what is fitted is not what the firmware applies, and the answer does not say that it is."""
    feed = 10 * np.sin(29 * TIME)
    channels = {"reference": 0 * ANGLE, "motor_position": ANGLE, "target_torque": -100 * ANGLE}
    assert gains_answer(identify_gains(record(**channels))).sentence.startswith("The firmware applies kp = 100 N·m/rad")
    answer = gains_answer(identify_gains(record(**{**channels, "target_torque": feed - 100 * ANGLE}))).sentence
    assert answer.startswith("Not adequate: kp and kd explain")
    assert "applies" not in answer
