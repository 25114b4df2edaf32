"""The torque line against the current loop's differential equation, integrated for itself, and against what a delay means."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from gainroom.errors import GainroomError
from gainroom.simulation.torque_line import TorqueLine
from gainroom.system.drive import Drive

TICK = 5e-4
DRIVES = (Drive(4000.0, 0.9, 2e-3), Drive(900.0, 0.4, 2.174e-3), Drive(math.inf, 0.9, 0.7e-3), Drive(3000.0, 1.2, 0.0), Drive())


def commands(count: int):
    return np.random.default_rng(1).normal(0.0, 20.0, (count, len(DRIVES)))


def command_at(sent, joint: int, time: float) -> float:
    """What the current loop of a joint is told at `time`, read straight from the definition of a delay."""
    tick = math.floor((time - DRIVES[joint].delay) / TICK + 1e-9)
    return sent[tick, joint] if tick >= 0 else 0.0


def integrated(sent, joint: int, times):
    """∫τ dt at `times`, by a general-purpose solver from switch to switch."""
    drive = DRIVES[joint]
    end = times[-1]
    switches = np.unique(np.round(np.concatenate([times, drive.delay + TICK * np.arange(len(sent)), [0.0]]), 15))
    switches = switches[switches <= end]
    state = np.zeros(3)
    found = {0.0: 0.0}
    for start, stop in pairwise(switches):
        held = command_at(sent, joint, (start + stop) / 2)
        if drive.is_ideal:
            state[2] += held * (stop - start)
        else:
            w = drive.bandwidth
            rates = lambda t, x, w=w, held=held: [x[1], w * w * (held - x[0]) - 2 * drive.damping_ratio * w * x[1], x[0]]  # noqa: E731
            state = solve_ivp(rates, (start, stop), state, rtol=1e-11, atol=1e-12).y[:, -1]
        found[stop] = state[2]
    return np.array([found[min(found, key=lambda known: abs(known - time))] for time in times])


@pytest.mark.parametrize("substeps", [1, 2, 5])
def test_means_are_those_of_the_delayed_current_loop(substeps):
    sent = commands(14)
    line = TorqueLine(DRIVES, TICK, substeps)
    means = np.concatenate([line.tick(row).copy() for row in sent])
    step = TICK / substeps
    edges = np.concatenate([[0.0], (np.arange(len(means)) + 0.5) * step])
    for joint in range(len(DRIVES)):
        # The first step's mean reaches half a step before the start, where all was at rest.
        expected = np.diff(integrated(sent, joint, edges)) / step
        assert_allclose(means[:, joint], expected, atol=1e-7)  # the solver's own accuracy, times 1/h


def test_at_rest_it_stays():
    line = TorqueLine(DRIVES, TICK, 3)
    start = np.arange(5.0)
    line.rest(start)
    for _ in range(20):
        assert_allclose(line.tick(start), np.tile(start, (3, 1)), atol=1e-12)
    assert_allclose(line.torque, start, atol=1e-12)


def test_commands_are_cut_to_the_limit():
    line = TorqueLine(DRIVES, TICK, 2, limit=[10.0, 10.0, 10.0, 10.0, math.inf])
    for _ in range(200):
        line.tick(np.array([25.0, -25.0, 9.0, 11.0, 25.0]))
    assert_allclose(line.torque, [10.0, -10.0, 9.0, 10.0, 25.0], rtol=1e-9)


def test_refusals():
    with pytest.raises(GainroomError, match="torque limit 0 N·m must be > 0"):
        TorqueLine(DRIVES, TICK, 2, limit=0.0)
    with pytest.raises(GainroomError, match="substeps 0 must be a whole number >= 1"):
        TorqueLine(DRIVES, TICK, 0)
