"""Current loops that are fast beside the rows of the log: what such a log can tell, and intervals that hold."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.delay import TorqueDelay, identify_delay
from gainroom.identification.record import Record
from identified import holds
from independent.fast_drive import multisine, steps, torque

TICK, WHOLE = 1e-3, 200


def log(delay: float, speed: float, noise: float, seed: int = 1, count: int = 5000, damping: float = 0.8, demand: bool = False) -> Record:
    """A multisine up to a fifth of the tick rate, and what an independent drive makes of it; noise of the torque's deviation."""
    rng = np.random.default_rng(seed)
    target = 5 * multisine(count, 0.2, rng)
    actual = torque(target, delay, speed, damping)
    columns = {"target_torque": target, "actual_torque": actual + noise * 5 * rng.standard_normal(count)}
    if demand:
        columns["demand_torque"] = torque(target, delay, math.inf)
    return Record(np.arange(count) * TICK, columns, TICK)


def test_rows_of_an_infinitely_fast_loop_depend_on_whole_ticks_alone():
    """The independent drive: every delay in (2, 3] ticks makes the same rows, and any other differs."""
    target = multisine(400, 0.2, np.random.default_rng(0))
    rows = [torque(target, delay, math.inf) for delay in (2.0, 2.01, 2.5, 3.0, 3.01)]
    assert np.array_equal(rows[1], rows[2])
    assert np.array_equal(rows[1], rows[3])
    assert not np.allclose(rows[0], rows[1])
    assert not np.allclose(rows[3], rows[4])


@pytest.mark.slow
@pytest.mark.parametrize("demand", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.002, 0.02])
@pytest.mark.parametrize("delay", [2.05, 2.5, 3.0])
def test_of_an_infinitely_fast_loop_the_delay_is_bounded_to_a_tick(delay, noise, demand):
    """Told 2.18 ± 0.03 ticks before, whichever of them was true."""
    found = identify_delay(log(delay, math.inf, noise, demand=demand))
    assert found.confounded
    assert found.ticks.low <= 2.0 + 1e-9
    assert found.ticks.high >= 3.0 - 1e-9
    assert found.ticks.high - found.ticks.low < 1.2  # one tick, and what noise adds
    assert abs(found.ticks.value - 2.5) < 0.15
    assert found.lag is not None
    assert holds(found.lag, TICK * delay)
    assert found.bandwidth is not None
    assert math.isinf(found.bandwidth.high)
    assert any("faster than the log's rows" in warning for warning in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [20.0, 12.0, 8.0])
def test_the_interval_of_a_fast_loop_holds(speed):
    """2.307 (2.300 to 2.315), 2.616 (2.608 to 2.624) and 2.747 (2.716 to 2.777) ticks before."""
    found = identify_delay(log(2.8, speed, 0.0))
    assert holds(found.ticks, 2.8)
    assert found.lag is not None
    assert holds(found.lag, TICK * (2.8 + 1.6 / speed))
    assert found.bandwidth is not None
    assert found.bandwidth.low <= speed / TICK <= found.bandwidth.high


@pytest.mark.parametrize("speed", [1.0, 3.0, 5.0])
def test_a_loop_that_the_rows_can_follow_is_told(speed):
    found = identify_delay(log(2.8, speed, 0.002))
    assert not found.confounded
    assert holds(found.ticks, 2.8)
    assert found.ticks.half_width < 0.05
    assert found.bandwidth is not None
    assert math.isfinite(found.bandwidth.high)


def draw(index: int) -> tuple[Record, float, float]:
    """A log, its delay [ticks] and speed: 0.3 to 8 ticks, 300 to 30 000 rad/s and inf at 1 kHz; noise of 0.05 to 5 %; steps, multisine."""
    rng = np.random.default_rng([20171117, 6, index])
    delay = float(rng.integers(1, 9)) if rng.random() < 0.3 else float(rng.uniform(0.3, 8.0))
    speed = math.inf if rng.random() < 0.25 else float(np.exp(rng.uniform(np.log(0.3), np.log(30.0))))
    damping, noise, count = float(rng.uniform(0.5, 1.2)), float(np.exp(rng.uniform(np.log(5e-4), np.log(0.05)))), 4000
    target = steps(count, rng, int(rng.integers(8, 30))) if rng.random() < 0.5 else multisine(count, float(rng.uniform(0.05, 0.3)), rng)
    columns = {"target_torque": target, "actual_torque": torque(target, delay, speed, damping) + noise * rng.standard_normal(count)}
    if rng.random() < 0.3:
        columns["demand_torque"] = torque(target, delay, math.inf)
    return Record(np.arange(count) * TICK, columns, TICK), delay, speed


def outcome(index: int) -> tuple[TorqueDelay, float, float] | None:
    """None: refused."""
    record, delay, speed = draw(index)
    try:
        return identify_delay(record), delay, speed
    except gr.GainroomError:
        return None


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_intervals_hold_whatever_the_current_loop(capsys):
    """At least 95 of 100 hold: bounds of a tick hold always, and those of slower loops nearly so."""
    found = [each for each in map(outcome, range(WHOLE)) if each is not None]
    inside = np.array([holds(each.ticks, delay) for each, delay, _ in found])
    lag = np.array([holds(each.lag, TICK * (delay + (2 * 0.8 / speed if math.isinf(speed) else 0))) if math.isinf(speed) else True
                    for each, delay, speed in found if each.lag is not None])  # fmt: skip
    fast = np.array([speed > 6 for *_, speed in found])
    told = np.array([not each.confounded for each, *_ in found])
    errors = np.abs([each.ticks.value - delay for each, delay, _ in found])
    with capsys.disabled():
        print(
            f"\n{len(found)} of {WHOLE}: coverage {inside.mean():.3f}, fast {inside[fast].mean():.3f}, slow {inside[~fast].mean():.3f}; ",
            end="",
        )
        print(
            f"told {told.mean():.3f}, fast {told[fast].mean():.3f}, slow {told[~fast].mean():.3f}; largest error {errors[told].max():.3f}"
        )
    assert inside.mean() >= 0.95
    assert inside[fast].mean() >= 0.95
    assert lag.mean() >= 0.95
    assert np.mean(errors[told] < 0.1) >= 0.97
    assert len(found) >= 0.9 * WHOLE
