"""Fig. 6: the delay between target and demand torque, read from a log of torque steps of 0 to about 11 N m at 0.5 ms."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from ..linear.arrays import Floats, Integers
from ..simulation import Response, Scenario, simulate
from .joints import SAMPLE_TIME, TESTBED
from .picture import Curve, CurvePicture, Panel
from .row import Row, compare, within
from .virtual import loop_of_testbed, virtual_testbed

TORQUE = 11.0  # [N m] about where the figure's steps end
BUS_TICKS, JITTER_TICKS = 5.0, 1.0  # printed: 4 to 6 ticks
STEPS, HELD = 100, 16  # torque steps, and ticks between them: longer than any delay


SHOWN = (0.015, 0.045)  # [s] of the picture


def rows() -> list[Row]:
    """The delays, and that the actual torque arrives."""
    run = torque_steps()
    ticks = delays_in(run.columns())
    known = (
        f"Read from the log of {len(ticks)} steps on the virtual testbed, whose bus is given the paper's delay (5 ± 1 ticks): that the "
        "log shows it, not a second measurement."
    )
    target, actual = run.target_torque[:, 0], run.actual_torque[:, 0]
    last = np.arange(HELD - 1, len(target), HELD)  # the last tick of every step
    return [
        compare("fig6.least_delay_ticks", BUS_TICKS - JITTER_TICKS, float(ticks.min()), "ticks", 0.0, f"The shortest. {known}", "4"),
        compare("fig6.most_delay_ticks", BUS_TICKS + JITTER_TICKS, float(ticks.max()), "ticks", 0.0, f"The longest. {known}", "6"),
        within("fig6.mean_delay_ms", 2.0, 3.0, 1e3 * SAMPLE_TIME * float(ticks.mean()), "ms", f"The paper: about 2 to 3 ms. {known}"),
        compare(
            "fig6.torque_left_over_nm",
            0.0,
            float(np.abs(actual[last] - target[last]).max()),
            "N m",
            0.01 * TORQUE,
            f"What the actual torque still lacks {HELD - 1} ticks after a step, at most; the figure shows it there. "
            "Tolerance: 1 % of the step.",
        ),
    ]


def pictures() -> list[CurvePicture]:
    """Two steps of the figure."""
    run = torque_steps()
    kept = (run.time >= SHOWN[0]) & (run.time <= SHOWN[1])
    time = 1e3 * run.time[kept]
    named = (("target", run.target_torque, 22.0), ("demand", run.demand_torque, 24.0), ("actual", run.actual_torque, 34.0))
    curves = tuple(Curve("", time, values[kept, 0], at) for _, values, at in named)
    curves = tuple(replace(curve, label=name) for curve, (name, _, _) in zip(curves, named, strict=True))
    caption = (
        "The torque steps between 0 and 11 N m with the output fixed; one row per tick of 0.5 ms. The demand is the target 4 to 6 ticks "
        "late, another delay every time; the actual torque follows the demand within the current loop's half a millisecond."
    )
    panel = Panel("torque [N m]", (-1.5, 14.0), curves)
    title = "Fig. 6. Target, demand and actual torque: the delay, step by step"
    return [CurvePicture("fig6", title, caption, "time [ms]", (1e3 * SHOWN[0], 1e3 * SHOWN[1]), (panel,), logarithmic=False)]


@cache
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
