"""Fig. 6: the delay between target and demand torque, read from a log of torque steps of 0 to about 11 N m at 0.5 ms."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..arrays import Floats, Integers
from ..simulation import Response, Scenario, simulate
from .joints import SAMPLE_TIME, TESTBED
from .virtual import loop_of_testbed, virtual_testbed

TORQUE = 11.0  # [N m] about where the figure's steps end
BUS_TICKS, JITTER_TICKS = 5.0, 1.0  # printed: 4 to 6 ticks
STEPS, HELD = 100, 16  # torque steps, and ticks between them: longer than any delay


def torque_steps() -> Response:
    """The torque switched on and off on the joint with its output fixed, as it was for measuring K; no control."""
    loop = loop_of_testbed(0.0, 0.0, BUS_TICKS * SAMPLE_TIME, replace(TESTBED, link_inertia=math.inf))
    on = np.repeat(np.arange(STEPS + 1) % 2, HELD)[:, None]
    bed = replace(virtual_testbed(loop, JITTER_TICKS * SAMPLE_TIME, whole_ticks=True), gravity=0.0)
    return simulate(bed, Scenario(0.0, (len(on) - 1) * SAMPLE_TIME, feedforward=TORQUE * on))


def delays_in(columns: Mapping[str, Floats]) -> Integers:
    """Ticks from each change of `target_torque` (k, 1) until `demand_torque` is what the target has become."""
    target, demand = columns["target_torque"][:, 0], columns["demand_torque"][:, 0]
    changes = np.flatnonzero(np.diff(target)) + 1
    found = []
    for begin, end in zip(changes, [*changes[1:], len(target)], strict=True):
        there = np.flatnonzero(demand[begin:end] == target[begin])
        if len(there):
            found.append(there[0])
    return np.array(found, dtype=int)
