"""Logs that no joint with a linear spring made, and logs that say too little: neither comes back as a confident wrong answer."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.joint import identify_joint
from gainroom.identification.record import Record
from independent.chain import Chain, multisine, record
from refusals import assert_refused

TICK, COUNT = 1e-3, 8000
TWO = Chain(np.array([0.2, 0.8]), np.array([1e4]), np.array([2.0]), 1.0, 0.2, bandwidth=2000.0, resolution=7.7e-6)
THREE = replace(TWO, inertia=np.array([0.2, 0.3, 0.5]), stiffness=np.array([1e4, 6e3]), damping=np.array([2.0, 2.0]))


@dataclass(frozen=True)
class TwoJoints(Chain):
    """The link of `TWO` and a second joint, which its own controller holds, push each other: an inertia of 0.3 kg m² between them."""

    def slope(self, x: list[float], demand: float) -> list[float]:
        position, velocity, torque, rate = x[:3], np.array(x[3:6]), x[6], x[7]
        spring = 1e4 * (position[0] - position[1]) + 2 * (velocity[0] - velocity[1])
        friction = np.array([1.0, 0.2, 0.0]) * np.tanh(velocity / self.softness)
        force = np.array([torque - spring, spring, -60 * position[2] - 12 * velocity[2]]) - friction
        inertia, w = np.array([[0.2, 0, 0], [0, 0.8, 0.3], [0, 0.3, 0.6]]), self.bandwidth
        loop = [rate, w * w * (demand - torque) - 2 * self.damping_ratio * w * rate]
        return [*velocity, *np.linalg.solve(inertia, force), *loop]


def closed(chain: Chain, torque: np.ndarray, slow: float = 0.4) -> dict[str, np.ndarray]:
    """A closed loop on slow motion [rad], with a feed-forward torque (m,)."""
    reference, before = slow * np.sin(2 * np.pi * 0.3 * np.arange(COUNT) * TICK), [0.0]

    def command(k: int, reading: float) -> float:
        error = reference[k] - reading
        rate, before[0] = (error - before[0]) / TICK, error
        return 40 * error + 9 * rate + torque[k]

    return record(chain, command, COUNT, TICK, 3, 4)


def broad(low: float = 10.0, high: float = 60.0) -> np.ndarray:
    return 10 * multisine(np.geomspace(low, high, 50), COUNT, TICK, 0)


def log(columns: dict[str, np.ndarray], *names: str, tick: float = TICK) -> Record:
    names = names or ("target_torque", "actual_torque", "motor_position")
    return Record(np.arange(COUNT) * tick, {name: columns[name] for name in names}, tick)


@pytest.fixture(scope="module")
def two() -> dict[str, np.ndarray]:
    return closed(TWO, broad())


@pytest.mark.slow
@pytest.mark.parametrize("torque", ["target_torque", "actual_torque"])
def test_one_torque_is_enough(two, torque):
    """What the other torque would say of the current loop is fitted: the residuals say that the model is right; K and inertias to 0.3 %."""
    found = identify_joint(log(two, torque, "motor_position"))
    assert found.adequate
    for name, value in {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 1e4}.items():
        assert found.parameters[name].value == pytest.approx(value, rel=0.003)
        assert abs(found.parameters[name].value - value) < 1.7 * found.parameters[name].half_width


@pytest.mark.slow
@pytest.mark.parametrize("turned", [("target_torque", "actual_torque"), ("motor_position",)])
def test_a_wrong_sign_is_named(two, turned):
    wrong = two | {name: -two[name] for name in turned}
    assert_refused(lambda: identify_joint(log(wrong)), ["joint:", "goes against", "turn the sign"])


@pytest.mark.slow
def test_the_link_s_position_for_the_motor_s_is_refused(two):
    wrong = two | {"motor_position": two["link_position"]}
    assert_refused(lambda: identify_joint(log(wrong)), ["joint:", "look whether the position is that of the motor"])


@pytest.mark.slow
def test_a_wrong_rate_shows_where_the_drive_is_known(two):
    """A delay of 3 ms in a log that is 0.8 times as long as it was. Nothing else can tell: time is no physical unit of its own here."""
    found = identify_joint(log(two, "target_torque", "motor_position", tick=0.8 * TICK), gr.Drive(2000.0, 0.9, 3e-3))
    assert not found.adequate


@pytest.mark.slow
def test_a_position_that_is_read_every_other_tick_is_seen(two):
    wrong = two | {"motor_position": np.repeat(two["motor_position"][::2], 2)}
    assert not identify_joint(log(wrong)).adequate


@pytest.mark.population
@pytest.mark.parametrize(
    "chain",
    [
        pytest.param(replace(TWO, hardening=1e8), id="spring that hardens by 1.3 times its stiffness"),
        pytest.param(replace(TWO, limit=12.0), id="torque limited for a quarter of the time"),
        pytest.param(TwoJoints(np.ones(3), np.ones(2), np.ones(2), bandwidth=2000.0), id="two joints"),
        pytest.param(THREE, id="third mass"),
    ],
)
@pytest.mark.parametrize("names", [("target_torque", "actual_torque", "motor_position"), ("target_torque", "motor_position")])
def test_another_model_is_seen_in_the_residuals(chain, names):
    columns = closed(chain, broad(6, 70) if chain is THREE else broad())
    assert verdict(log(columns, *names)) == "inadequate"


def verdict(record: Record) -> str:
    """A refusal of the model counts as one."""
    try:
        return "adequate" if identify_joint(record).adequate else "inadequate"
    except gr.GainroomError as error:
        return "inadequate" if "explains the motion" in str(error) else str(error)


TIME = np.arange(COUNT) * TICK


@pytest.mark.slow
@pytest.mark.parametrize(
    ("torque", "slow", "words"),
    [
        pytest.param(2 * np.sin(np.pi * TIME), 0.4, ["record a multisine or chirp"], id="slow"),
        pytest.param(0.03 * broad(), 0.0, ["larger torque"], id="below friction"),
        pytest.param(10 * np.sin(40 * np.pi * TIME), 0.4, ["record a multisine or chirp"], id="one sine", marks=pytest.mark.population),
        pytest.param(0 * TIME, 0.0, ["larger torque"], id="at rest", marks=pytest.mark.population),
    ],
)
def test_too_little_excitation_is_refused(torque, slow, words):
    columns = closed(TWO, torque, slow)
    assert_refused(lambda: identify_joint(log(columns)), ["joint:", *words])
