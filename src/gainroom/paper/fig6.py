"""Fig. 6: the delay between target and demand torque, read from a log of torque steps of 0 to about 11 N·m at 0.5 ms.

First as the paper reads it, step by step; then as `gainroom identify delay` does, from the log's file.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from ..identification import TorqueDelay, identify_delay
from ..simulation import Run, Scenario, simulate
from ..system.linear.arrays import Floats, Integers
from .joints import DRIVE, SAMPLE_TIME, TESTBED
from .picture import Curve, Mark, Panel, Picture
from .row import Row, compare, within
from .virtual_testbed import TORQUES, logged, loop_of_testbed, virtual_testbed, with_interval

TORQUE = 11.0  # [N m] about where the figure's steps end
BUS_TICKS, JITTER_TICKS = 5.0, 1.0  # printed: 4 to 6 ticks
STEPS, HELD = 100, 16  # torque steps, and ticks between them: longer than any delay
SHOWN = (0.015, 0.045)  # [s] of the picture
MARKED = 12.6  # [N m] height of the picture's bar


def rows() -> Iterator[Row]:
    """The delays, and that the actual torque arrives."""
    run = torque_steps()
    ticks = delays_in(run.columns())
    known = (
        f"Read from the log of {len(ticks)} steps on the virtual testbed, whose bus is given the paper's delay (5 ± 1 ticks): that the "
        "log shows it, not a second measurement."
    )
    least, most, mean = float(ticks.min()), float(ticks.max()), 1e3 * SAMPLE_TIME * float(ticks.mean())
    yield compare("fig6.least_delay_ticks", BUS_TICKS - JITTER_TICKS, least, "ticks", 0.0, f"The shortest. {known}", "4")
    yield compare("fig6.most_delay_ticks", BUS_TICKS + JITTER_TICKS, most, "ticks", 0.0, f"The longest. {known}", "6")
    yield within("fig6.mean_delay_ms", 2.0, 3.0, mean, "ms", f"The paper: about 2 to 3 ms. {known}")
    last = slice(HELD - 1, None, HELD)  # the last tick of every step
    lacking = float(np.abs(run.actual_torque[last, 0] - run.target_torque[last, 0]).max())
    note = f"Largest error of the actual torque {HELD - 1} ticks after a step; the figure shows it there. Tolerance: 1 % of the step."
    yield compare("fig6.torque_left_over_nm", 0.0, lacking, "N·m", 0.01 * TORQUE, note)
    yield from _identified_rows()


def _identified_rows() -> Iterator[Row]:
    """Rows for the identification of the same log."""
    found = identified()
    known = "From target, demand and noisy actual torque of the virtual testbed's log, written to a file and read from it."
    assert found.bandwidth is not None
    least, most = BUS_TICKS - JITTER_TICKS, BUS_TICKS + JITTER_TICKS
    for name, value, unit, low, high in (
        ("delay_ticks", found.ticks, "ticks", least, most),
        ("delay_ms", found.delay.scaled(1e3), "ms", 2.0, 3.0),
    ):
        note = f"The mean over the commands; the virtual bus is given {BUS_TICKS:g} ± {JITTER_TICKS:g} ticks. {known}"
        yield with_interval(within(f"fig6.identified.{name}", low, high, value.value, unit, note), value)
    spread = np.percentile(found.jitter.ticks, [0, 100])
    for name, printed, value in (("least", least, spread[0]), ("most", most, spread[1])):
        yield compare(f"fig6.identified.{name}_delay_ticks", printed, value, "ticks", 0.0, f"Of single commands. {known}", f"{printed:g}")
    note = f"The current loop's, inferred from Fig. 9, which the virtual drive is given. Tolerance: 2 %. {known}"
    tolerance = 0.02 * DRIVE.bandwidth
    row = compare("fig6.identified.bandwidth_rad_s", DRIVE.bandwidth, found.bandwidth.value, "rad/s", tolerance, note)
    yield with_interval(row, found.bandwidth)


def pictures() -> Iterator[Picture]:
    """Two steps of the figure."""
    run = torque_steps()
    shown = (run.time >= SHOWN[0]) & (run.time <= SHOWN[1])
    curves = [Curve(name, 1e3 * run.time[shown], getattr(run, f"{name}_torque")[shown, 0]) for name in ("target", "demand", "actual")]
    found = identified().delay.scaled(1e3)
    begins = 1e3 * run.time[shown][1:][np.diff(run.target_torque[shown, 0]) > 0]
    marks = tuple(Mark(begin + found.value, MARKED, stem=0.0) for begin in begins)
    named = f"identified delay, {found.value:.3g} ms ({found.low:.3f} to {found.high:.3f})"
    bars = np.ravel([(begin, begin + found.value, math.nan) for begin in begins])
    curves.append(Curve(named, bars, np.where(np.isnan(bars), math.nan, MARKED)))
    caption = (
        "The torque steps between 0 and 11 N·m with the output fixed; one row per tick of 0.5 ms. The demand is the target 4 to 6 ticks "
        "late, another delay every time; the actual torque follows the demand within the current loop's half a millisecond. "
        f"The bars are the mean delay, identified from the whole log of {STEPS} steps; in brackets its 95 % interval."
    )
    title = "Fig. 6. Target, demand and actual torque: the delay, step by step"
    yield Picture(
        title, caption, "time [ms]", (1e3 * SHOWN[0], 1e3 * SHOWN[1]), (Panel("torque [N·m]", (-1.5, 14.0), tuple(curves), marks),)
    )


@cache
def torque_steps() -> Run:
    """The torque switched on and off on the joint with its output fixed, as it was for measuring K; no control."""
    loop = loop_of_testbed(0.0, 0.0, BUS_TICKS * SAMPLE_TIME, replace(TESTBED, link_inertia=math.inf))
    on = np.repeat(np.arange(STEPS + 1) % 2, HELD)[:, None]
    bed = replace(virtual_testbed(loop, JITTER_TICKS * SAMPLE_TIME, whole_ticks=True), gravity=0.0)
    return simulate(bed, Scenario(0.0, (len(on) - 1) * SAMPLE_TIME, feedforward=TORQUE * on))


@cache
def identified() -> TorqueDelay:
    """The delay in that run's log."""
    return identify_delay(logged(torque_steps(), *TORQUES))


def delays_in(columns: Mapping[str, Floats]) -> Integers:
    """Ticks from each change of `target_torque` (k, 1) until `demand_torque` is what the target has become."""
    target, demand = columns["target_torque"][:, 0], columns["demand_torque"][:, 0]
    changes = np.flatnonzero(np.diff(target)) + 1
    arrivals = [np.flatnonzero(demand[k:end] == target[k]) for k, end in zip(changes, [*changes[1:], len(target)], strict=True)]
    return np.array([found[0] for found in arrivals if len(found)], dtype=int)
