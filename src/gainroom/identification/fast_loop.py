"""Delays that a log allows if its rows can hardly follow the current loop, without prior knowledge of current loops.

A command that arrives u ticks before a row has made the share c(ω u) of its change there and c(ω (1 + u)) in the row after, ω = ω_c T_s.
Once the second is 1 as far as the log shows, the rows depend on ω u alone: a faster loop and a command that arrives later, up to the row's
very moment, make the same rows. Of an infinitely fast loop the first share is 1, too, and the rows depend on the delay rounded up only.

What is known of current loops' speed (current_loop.SPEED), from which the search starts, would then decide, and always for a slow loop and
a short delay. So it counts for nothing here: allowed is all that is not much less likely than the best (profile likelihood). And as no
current loop is of second order to the last, what is below a thousandth of the torque's deviation tells nothing.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats
from .allowed_delays import UNLIKELY, temper
from .arrival_fit import LAW, ArrivalLikelihood, Fit
from .estimate import FREEDOM, quantile

FAST = 2.5  # ω from which on what a loop does between two rows is hardly seen
LIMIT = 80.0  # ω: a loop that has settled within a tenth of a tick stands for all faster ones
SETTLED = 6.0  # ω u from which on a change is complete to a hundredth
SUDDEN = -13.0  # log of the jitter's deviation [ticks] from which the limit is searched
FLOOR = 0.004  # ticks: what no log tells
STEPS = 0.005, 0.06  # ticks between delays that are tried, from the first on
MOST_STEPS = 60
BEFORE, USUAL = (0.25, 0.75, 0.97), 5.0  # ticks before a row, and ω, from which further tops are searched
FIRST_ITERATIONS, ITERATIONS = 4, 12
HOPELESS = 0.05  # of minus twice the log likelihood per row: what these first ones may be worse than the best
AGREED = 0.25  # of a standard error: where this and the fit are that near, the fit does not rest on what is usual


@dataclass(frozen=True)
class FastLoop:
    """Delays that the log allows, as (2,) mean of D and mean age of the command that acts [ticks].

    mean, low, high   (2,)
    lag        low and high of D + 2ζ/ω [ticks]
    speeds     low and high of ω; high inf: the log bounds the delay to a tick at best
    uneven     as Fit.uneven, where it is most likely
    """

    mean: Floats
    low: Floats
    high: Floats
    lag: tuple[float, float]
    speeds: tuple[float, float]
    uneven: float


@dataclass(frozen=True)
class _Place:
    """Point of largest likelihood with one parameter fixed, and its cost (minus twice the log likelihood)."""

    point: Floats
    cost: float


def fast_loop(likelihood: ArrivalLikelihood, top: Fit, sharp: bool) -> FastLoop | None:
    """Delays allowed near `top`; None if its own interval, of a `sharp` fit or not, covers them."""
    spread, edges = temper(top), likelihood.law.edges(top.point)
    bound, rough = UNLIKELY * spread, likelihood.of_any_speed(LAW)  # a loop of any speed has three parameters less than one that is fitted
    if not edges:
        return _whole_tick(rough, top, rough.maximum(top.point)[1] + bound)
    best = _tops(rough, top, edges)[0]
    limits = [limit for edge, side in edges if (limit := _limit(rough, best, edge, side, bound)) is not None]
    least = min(each.cost for each in (best, *limits))
    limits = [limit for limit in limits if limit.cost < least + bound]
    if limits:
        return _of_any_speed(rough, [best, *limits], limits, least + bound, spread)
    free = likelihood.of_any_speed()
    tops = _tops(free, top, edges)
    moved = abs(float(free.law.means(tops[0].point[:2])[0] - top.means[0]))
    if top.speed < FAST or (sharp and moved < max(AGREED * top.error(top.slopes[0]), FLOOR / 4)):
        return None
    highest = tops[0].cost + quantile(FREEDOM) ** 2 * spread
    return _of_any_speed(free, [each for each in tops if each.cost < highest], [], highest, spread)


def _tops(free: ArrivalLikelihood, top: Fit, edges: list[tuple[float, float]]) -> list[_Place]:
    """Maxima of the likelihood, the best one first: near `top`, and near commands that arrive sooner or later before the rows."""
    starts = [top.point]
    for edge, side in edges:
        for before in BEFORE:
            starts.append(top.point.copy())
            starts[-1][[0, 2]] = edge + side * before, math.log(USUAL)
    return sorted((_Place(*free.maximum(start, None, ITERATIONS)) for start in starts), key=lambda place: place.cost)


def _of_any_speed(free: ArrivalLikelihood, starts: list[_Place], limits: list[_Place], highest: float, spread: float) -> FastLoop:
    """Range of the delays whose cost is at most `highest`, from `starts` to both sides; with `limits` also those of a loop without lag."""
    found = {float(place.point[0]): place for start in starts for side in (-1.0, 1.0) for place in _marched(free, start, side, highest)}
    allowed = [found[first] for first in sorted(found)]
    means = np.array([free.law.means(place.point[:2])[:2] for place in allowed])
    loops = np.array([free.loop(place.point)[:2] for place in allowed])
    ends, lags, usual = means, means[:, 0] + 2 * loops[:, 1] / loops[:, 0], free.law.means(starts[0].point[:2])[:2]
    if limits:  # commands may arrive at the row's very moment
        last = np.array([free.law.rows(limit.point) for limit in limits])
        ends, lags = np.vstack([means, last]), np.concatenate([lags, means[:, 0], last[:, 0]])  # and without lag of its own
        weights = np.exp(-0.5 * (np.array([place.cost for place in allowed]) - highest) / spread) * np.abs(np.gradient(means[:, 0]))
        usual = weights @ means / weights.sum()
    speeds = float(loops[:, 0].min()), math.inf if limits else float(loops[:, 0].max())
    return FastLoop(usual, ends.min(axis=0), ends.max(axis=0), (float(lags.min()), float(lags.max())), speeds, free.uneven(starts[0].point))


def _whole_tick(free: ArrivalLikelihood, top: Fit, highest: float) -> FastLoop | None:
    """Delays over a whole tick, for a loop too fast to tell where in it commands arrive; None if such a loop costs more than `highest`."""
    found = _Place(*free.maximum(top.point, (2, math.log(LIMIT)), ITERATIONS))
    if found.cost > highest:
        return None
    high = free.law.rows(top.point)
    return FastLoop(high - 0.5, high - 1, high, (float(high[0]) - 1, float(high[0])), (top.speed, math.inf), top.uneven)


def _limit(free: ArrivalLikelihood, near: _Place, edge: float, side: float, bound: float) -> _Place | None:
    """Best point of a loop of nearly infinite speed whose commands arrive just before `edge`, so that as much of them shows as at `near`.

    None where that is far from likely.
    """
    held, found = (2, math.log(LIMIT)), []
    share = float(np.exp(near.point[2])) * max(side * (near.point[0] - edge), 0.0)
    for product in {min(share, SETTLED), SETTLED}:
        start = near.point.copy()
        start[:3] = edge + side * product / LIMIT, min(start[1], SUDDEN), held[1]
        place = _Place(*free.maximum(start, held, FIRST_ITERATIONS))
        if place.cost < near.cost + bound + HOPELESS * len(free.used):
            found.append(_Place(*free.maximum(place.point, held, ITERATIONS)))
    if not found:
        return None
    best = min(found, key=lambda place: place.cost)
    return best if -FLOOR < side * (best.point[0] - edge) < 1 else None  # else it is another row's


def _marched(free: ArrivalLikelihood, start: _Place, side: float, highest: float) -> list[_Place]:
    """Points from a start to one side of the law's first parameter, as far as their cost is at most `highest`."""
    places, (low, high), step = [start], free.law.bounds, STEPS[0]
    for _ in range(MOST_STEPS):
        before = places[-1]
        first = float(np.clip(before.point[0] + side * step, low, high))
        whole = (np.floor(side * before.point[0] + 2 * FLOOR) + 1) * side - side * FLOOR
        if side * first > side * whole:  # beyond a whole tick another row sees the command: looked at just before it
            first = float(whole)
        place = _at(free, before, first)
        if place.cost > highest:
            return [*places, *_between(free, before, place, highest)]
        places.append(place)
        if first in (low, high):
            break
        step = min(2 * step, STEPS[1])
    return places


def _at(free: ArrivalLikelihood, near: _Place, first: float) -> _Place:
    return _Place(*free.maximum(_moved(free, near.point, first), (0, first), ITERATIONS))


def _between(free: ArrivalLikelihood, inside: _Place, outside: _Place, highest: float) -> list[_Place]:
    """Allowed points between `inside`, which is allowed, and `outside`, by halving; last the innermost point that is not allowed."""
    found = []
    while abs(outside.point[0] - inside.point[0]) > FLOOR:
        middle = _at(free, inside, float(inside.point[0] + outside.point[0]) / 2)
        if middle.cost < highest:
            inside = middle
            found.append(middle)
        else:
            outside = middle
    return [*found, _Place(np.append(outside.point[0], inside.point[1:]), highest)]


def _moved(free: ArrivalLikelihood, point: Floats, first: float) -> Floats:
    """Starting point with another `first` parameter, and a loop speed with which as much of a command shows at the row as before."""
    start = point.copy()
    edge, side = free.law.edges(point)[0]
    before, after = (max(side * (value - edge), FLOOR) for value in (point[0], first))
    start[0], start[2] = first, point[2] - np.log(after / before)
    return start
