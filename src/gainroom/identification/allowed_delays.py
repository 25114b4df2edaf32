"""Delays that a log allows: the likelihood along the delay, with all other parameters refitted at each.

A fit's standard error speaks of the likelihood at its top. Along the delay that is not enough: just below a whole number of ticks a row
sees the very beginning of a step response, just above it does not, so that the likelihood falls steeply to one side and hardly to the
other, and it may have several tops. What lies between is weighed by its likelihood, which is tempered where the noise is not as modelled.
"""

from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats
from .arrival_fit import ArrivalLikelihood, Fit
from .estimate import CONFIDENCE, FREEDOM, quantile

UNLIKELY = 12.0  # of minus twice the log likelihood, below the best
MOST_POINTS = 24  # to each side of a top
STEPS = 0.004, 0.12  # ticks: least and largest between two points
RISE = 0.5, 2.0  # of minus twice the log likelihood between two points: less, and the next is farther; more, and it is nearer
FINE = 2001  # points of the distribution


@dataclass(frozen=True)
class Allowed:
    """Delays (n,) [ticks], each with its evidence (a cost, see Fit) and the width of the law's first parameter that it stands for.

    values (n, 2)   mean of D, mean age of the command that comes to act
    """

    values: Floats
    costs: Floats
    widths: Floats


def allowed_delays(likelihood: ArrivalLikelihood, tops: list[Fit]) -> Allowed:
    """Delays around each of several maxima, as far as they are no more than UNLIKELY worse than the best."""
    points: dict[float, tuple[Floats, float]] = {}
    spread = temper(min(tops, key=lambda fit: fit.cost))
    for top in sorted(tops, key=lambda fit: fit.cost):
        first = float(np.clip(top.point[0], *likelihood.law.bounds))
        least = min((cost for _, cost in points.values()), default=np.inf)
        if top.evidence > least + UNLIKELY * spread or (points and min(points) <= first <= max(points)):
            continue
        points[first] = likelihood.pinned(top.point, first)
        for side in (-1.0, 1.0):
            _march(likelihood, points, first, side, spread, top)
    places = np.array(sorted(points))
    values = np.array([likelihood.law.means(points[place][0][:2])[:2] for place in places])
    costs = np.array([points[place][1] for place in places]) / spread
    return Allowed(values, costs, np.gradient(places) if len(places) > 1 else np.ones(1))


def gaussian(fit: Fit) -> Allowed:
    """Delays that a fit allows by its standard error alone."""
    places = np.linspace(-3.5, 3.5, 57)
    errors = np.array([fit.error(fit.slopes[which]) for which in (0, 1)])
    return Allowed(fit.means[:2] + places[:, None] * errors, fit.evidence + places**2, np.full(len(places), 0.125 * fit.sharp[0, 0] ** 0.5))


def temper(fit: Fit) -> float:
    """Factor by which the variance of the delay exceeds that of noise as modelled, at least 1."""
    return max((fit.error(fit.slopes[0]) ** 2) / float(fit.slopes[0] @ fit.sharp @ fit.slopes[0]), 1.0)


def _march(
    likelihood: ArrivalLikelihood, points: dict[float, tuple[Floats, float]], first: float, side: float, spread: float, top: Fit
) -> None:
    """Adds points on one side of `first`, until one is too unlikely or no delay."""
    low, high = likelihood.law.bounds
    place, (point, cost) = first, points[first]
    step = float(np.clip(0.5 * top.sharp[0, 0] ** 0.5, *STEPS))
    slope = np.zeros(len(point))
    for _ in range(MOST_POINTS):
        new = float(np.clip(place + side * step, low, high))
        if new in points or cost > min(each for _, each in points.values()) + UNLIKELY * spread:
            return
        try:
            found, worse = likelihood.pinned(point + slope * (new - place), new)
        except np.linalg.LinAlgError:
            return
        slope = (found - point) / (new - place)
        rise = abs(worse - cost)
        place, point, cost = new, found, worse
        points[new] = found, worse
        step = float(np.clip(step * (2.0 if rise < RISE[0] else 0.5 if rise > RISE[1] else 1.0), *STEPS))


def spread_over(allowed: list[Allowed], which: int, late: float) -> tuple[float, float, float]:
    """Mean, low and high end of the 95 % interval over all laws, each delay with a further standard error `late` [ticks].

    Delays at an end that are hardly less likely than the best are in it: many are whole ticks, where the likelihood falls to one side only.
    """
    values = np.concatenate([each.values[:, which] for each in allowed])
    costs = np.concatenate([each.costs for each in allowed])
    weights = np.concatenate([each.widths for each in allowed]) * np.exp(-0.5 * (costs - costs.min()))
    weights = weights / weights.sum()
    from scipy.special import ndtr

    line = np.linspace(values.min() - 4 * late, values.max() + 4 * late, FINE)
    total = ndtr((line[:, None] - values) / late) @ weights
    tail = (1 - CONFIDENCE) / 2
    alike = values[costs < costs.min() + quantile(FREEDOM) ** 2]
    low, high = np.interp([tail, 1 - tail], total, line)
    return float(weights @ values), float(min(low, alike.min())), float(max(high, alike.max()))
