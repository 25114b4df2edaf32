"""Delays from set-point and position, kd on velocity or on its error, with viscous friction, against a simulation of its own."""

import math

import numpy as np
import pytest

from gainroom.identification import identify_setpoint_delay, setpoint_delay
from gainroom.identification.record import Record
from gainroom.identification.setpoint_delay import SetpointDelay
from identified import holds

TICK, INERTIA, KP, KD = 1e-3, 0.5, 800.0, 20.0


def moved(rate_of_error: bool, loop: int, command: int, viscous: float, noise: float = 2e-6, seed: int = 1, count: int = 10_000) -> Record:
    """A 1 kHz PD on one inertia, exact from tick to tick; torque `loop` ticks late, of a set-point `command` ticks old."""
    rng, time = np.random.default_rng(seed), TICK * np.arange(count)
    decay = math.exp(-viscous / INERTIA * TICK)
    moved_by = TICK**2 / 2 / INERTIA if viscous == 0 else (TICK - (1 - decay) * INERTIA / viscous) / viscous
    coasted, pushed = (TICK, TICK / INERTIA) if viscous == 0 else ((1 - decay) * INERTIA / viscous, (1 - decay) / viscous)
    frequencies = np.array([0.5, 1.3, 2.9, 5.3, 9.1, 14.0])
    reference = (0.2 / frequencies * np.sin(2 * np.pi * np.outer(time, frequencies) + rng.uniform(0, 6, 6))).sum(axis=1) * np.clip(
        time, 0, 1
    )
    position, torque, x, v, error, y = np.zeros(count), np.zeros(count), 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        y_before, before = y, error
        y = x + noise * rng.standard_normal()
        error = (reference[k - command] if k >= command else 0.0) - y
        torque[k] = KP * error + KD * ((error - before) if rate_of_error else (y_before - y)) / TICK
        acting, position[k] = torque[k - loop] if k >= loop else 0.0, y
        x, v = x + coasted * v + moved_by * acting, decay * v + pushed * acting
    return Record(time, {"reference": reference, "motor_position": position}, TICK)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_of_error", "loop", "command", "viscous"),
    [(True, 2, 0, 0.8), (True, 5, 3, 0.8), (True, 5, 0, 0.0), (True, 2, 1, 4.0), (False, 5, 0, 0.8), (False, 2, 4, 4.0)],
)
def test_both_laws_tell_both_delays(rate_of_error, loop, command, viscous):
    """With kd on the error's rate and 0.8 N m s/rad of viscous friction, 2 and 0 ticks were once 1.094 and 1.002, told and sure of it."""
    found = identify_setpoint_delay(moved(rate_of_error, loop, command, viscous), TICK)
    assert holds(found.loop, TICK * loop)
    assert holds(found.command, TICK * command)
    assert holds(found.total, TICK * (loop + command))
    assert found.loop.low <= found.loop.value <= found.loop.high
    assert found.rate_of_error == rate_of_error
    assert not found.confounded
    if rate_of_error:  # there viscous friction is unlike anything else
        assert found.loop.half_width < 0.1 * TICK


def all_hold(found: SetpointDelay, loop: int, command: int) -> bool:
    return all(holds(each, TICK * ticks) for each, ticks in ((found.loop, loop), (found.command, command), (found.total, loop + command)))


@pytest.mark.slow
def test_the_search_does_not_end_beside_the_maximum():
    """Its own law ended at 33 and 36 ticks, and the other law, with a sum of 7.59 ± 0.04, was taken for the log's."""
    found = identify_setpoint_delay(moved(False, 4, 3, 0.64, 4.5e-6, 42), TICK)
    assert not found.rate_of_error
    assert not found.confounded
    assert all_hold(found, 4, 3)


@pytest.mark.slow
def test_the_sum_is_over_both_laws_where_both_are_likely(monkeypatch):
    """The law that is wrong here puts the sum at 9.2 ticks: were both likely, the sum could be either's, and loop and command any part."""
    log = moved(False, 2, 7, 0.0, 2.1e-6, 20)
    one = identify_setpoint_delay(log, TICK)  # once 9.2, as its own law ended at −1.4 and 10.6
    monkeypatch.setattr(setpoint_delay, "UNLIKELY", math.inf)
    both = identify_setpoint_delay(log, TICK)
    assert not one.rate_of_error
    assert not one.confounded
    assert all_hold(one, 2, 7)
    assert all_hold(both, 2, 7)
    assert one.total.high < 9.1 * TICK
    assert both.total.low == one.total.low
    assert 9.2 * TICK < both.total.high < 9.3 * TICK
    assert both.confounded
    assert both.loop.high == both.command.high == both.total.high
    assert [setpoint_delay.EITHER_LAW in found.warnings for found in (one, both)] == [False, True]
    assert f"9.00 ticks ({both.total.low / TICK:.2f} to {both.total.high / TICK:.2f})" in both.warnings[0]


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_intervals_hold_under_both_laws(capsys):
    """60 draws of law, delays, friction, and noise up to 1e-4 rad: at least 95 of 100 intervals of each delay hold."""
    inside, told = [], 0
    for index in range(60):
        rng = np.random.default_rng([20171117, 7, index])
        loop, command, viscous = int(rng.integers(1, 7)), int(rng.integers(0, 8)), float(rng.choice([0.0, rng.uniform(0, 5)]))
        record = moved(bool(index % 2), loop, command, viscous, float(np.exp(rng.uniform(np.log(1e-6), np.log(1e-4)))), index)
        found = identify_setpoint_delay(record, TICK)
        told += not found.confounded
        inside.append([holds(found.loop, TICK * loop), holds(found.command, TICK * command), holds(found.total, TICK * (loop + command))])
    coverage = np.mean(inside, axis=0)
    with capsys.disabled():
        print(f"\n60 logs: coverage of loop, command and total {coverage}, told {told}")
    assert np.all(coverage >= 0.95)
    assert told >= 45
