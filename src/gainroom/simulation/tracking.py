"""Tracking performance of a run: error, overshoot, settling time."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..system.linear.arrays import Floats
from .run_record import STEADY_SHARE

SETTLED = 0.02  # relative to the move: the usual band of the settling time


@dataclass(frozen=True)
class Tracking:
    """Tracking performance of the measured value; each (n,), in its unit: rad, and m for tasks in space.

    rms, peak       of x_d − x over the whole run
    steady_state    mean of x_d − x over the last tenth of the run
    overshoot       largest excess over where it is sent, relative to the move from the initial x; nan without a move. Of the link, where
                    it is known: over where it comes to rest, the mean over the last tenth, as a gearbox that carries a load stays turned
    settling_time   from the reference's first change until x stays within 2 % of that move around the final reference, and the link
                    around its rest, for at least a tenth of the rows judged [s]; inf where it does not settle, nan without a move
    """

    rms: Floats
    peak: Floats
    steady_state: Floats
    overshoot: Floats
    settling_time: Floats


class TrackedRun(Protocol):
    """Run of k ticks with its reference, each (k, m)."""

    @property
    def time(self) -> Floats: ...
    @property
    def reference(self) -> Floats: ...
    @property
    def error(self) -> Floats: ...


def track(response: TrackedRun, until: float = math.inf, links: Floats | None = None) -> Tracking:
    """Tracking performance of a run, completed or not.

    until   start of a later disturbance [s]: overshoot and settling time are those before it; nan for a settling time that it cuts short
    links   (k, m) positions of the links, where channels are joints
    """
    error = response.error
    last = max(1, round(STEADY_SHARE * len(error)))
    rows = max(1, int(np.searchsorted(response.time, until)))
    arrivals = [_arrival(response, joint, rows, None if links is None else links[:rows, joint]) for joint in range(error.shape[1])]
    over, settled = np.transpose(arrivals)
    return Tracking(
        rms=np.sqrt(np.mean(error**2, axis=0)),
        peak=np.abs(error).max(axis=0),
        steady_state=error[-last:].mean(axis=0),
        overshoot=over,
        settling_time=settled,
    )


def _arrival(response: TrackedRun, joint: int, rows: int, link: Floats | None) -> tuple[float, float]:
    """Overshoot and settling time of one joint within the first `rows`, with its `link` (rows,) where that is known."""
    reference = response.reference[:rows, joint]
    position = reference - response.error[:rows, joint]
    sides = [(position, float(reference[-1]))]
    if link is not None:
        sides.append((link, float(link[-max(1, round(STEADY_SHARE * rows)) :].mean())))
    if any(target == side[0] for side, target in sides) or reference[-1] == position[0]:
        return math.nan, math.nan
    beyond = [(side - target) / (target - side[0]) for side, target in sides]  # −1 at the start, 0 at the target
    overshoot = max(0.0, float(beyond[-1].max()))
    arrived = [_settled(one) for one in beyond]
    if None in arrived:
        return overshoot, math.nan if rows < len(response.time) else math.inf
    begin = response.time[_departure(reference)]
    return overshoot, max(0.0, float(response.time[max(one for one in arrived if one is not None)] - begin))


def _departure(reference: Floats) -> int:
    """Row at which `reference` (k,) begins to change: a jump at its own row, a smooth start one row before."""
    moved = np.flatnonzero(reference != reference[0])
    if not len(moved):
        return 0
    first = int(moved[0])
    way = np.abs(reference[first : first + 2] - reference[first - 1])
    jumps = len(way) < 2 or way[1] - way[0] < way[0]
    return first if jumps else first - 1


def _settled(beyond: Floats) -> int | None:
    """Row from which `beyond` (k,) stays within 2 %; None where too few rows are left to be sure of it."""
    outside = np.flatnonzero(~(np.abs(beyond) <= SETTLED))
    arrived = int(outside[-1]) + 1 if len(outside) else 0
    return arrived if len(beyond) - arrived >= STEADY_SHARE * len(beyond) else None


@dataclass(frozen=True)
class Swing:
    """How a position comes to rest after a step at t = 0.

    peak            largest distance from the start, in the position's unit
    rest            where it rests, in the position's unit; nan where it does not
    overshoot       largest excess over the rest, relative to it; nan where there is none to speak of
    settling_time   until it stays within 2 % [s]: of its rest, or of its peak where there is no overshoot; inf where it does not in
                    the record, nan of what does not come to rest
    """

    peak: float
    rest: float
    overshoot: float
    settling_time: float


def swing(time: Floats, position: Floats, rest: float, returns: bool = False) -> Swing:
    """Swing of `position` (k,) over `time` (k,) to its `rest`; `returns`: it comes back so far that an overshoot says nothing."""
    peak = float(np.abs(position).max())
    way = peak if returns else rest
    if not math.isfinite(way) or way == 0:
        return Swing(peak, rest, math.nan, math.nan)
    beyond = (position - rest) / way
    arrived = _settled(beyond)
    overshoot = math.nan if returns else max(0.0, float(beyond.max()))
    return Swing(peak, rest, overshoot, math.inf if arrived is None else float(time[arrived]))
