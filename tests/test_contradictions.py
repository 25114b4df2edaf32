"""Channels that contradict each other are named with the factor between them; those that do not are left alone."""

import math

import numpy as np
import pytest

from gainroom.identification import Record, identify_gains
from gainroom.identification.contradictions import require_consistent
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


def test_gains_that_leave_torque_unexplained_are_not_said_to_be_applied():
    """A feed-forward torque beside kp = 100: what is fitted is not what the firmware applies, and the answer does not say that it is."""
    feed = 10 * np.sin(29 * TIME)
    channels = {"reference": 0 * ANGLE, "motor_position": ANGLE, "target_torque": -100 * ANGLE}
    assert gains_answer(identify_gains(record(**channels))).sentence.startswith("The firmware applies kp = 100 N·m/rad")
    answer = gains_answer(identify_gains(record(**{**channels, "target_torque": feed - 100 * ANGLE}))).sentence
    assert answer.startswith("Not adequate: kp and kd explain")
    assert "applies" not in answer
