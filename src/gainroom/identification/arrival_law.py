"""Laws of the moments at which commands arrive within their ticks, with two parameters each, and their effect on the current loop.

A command leaves at a tick and arrives D ticks later. From one grid point to the next, a tick on, the current loop's state changes by the
command that was held and by what a change of it adds, which arrived some part of a tick before; mean and covariance of that are taken by
Gauss's quadrature over the law. With a demand torque the grid is the rows, and the demand shows in which tick a command arrived. Without
one the grid points are the last moments at which commands can arrive: each row is read between two of them, and where the law reaches
over a row, it is not known in that row whether its command has arrived.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..system.linear.arrays import Floats, Integers
from .arrivals import Arrivals
from .current_loop import Data, held

NODES, WEIGHTS = (values for values in np.polynomial.legendre.leggauss(6))
DEVIATION = (np.log(0.02), 2.0)  # of log σ: mean and deviation
STILLEST, STILL = -9.0, -14.0  # log of the least deviation; beside a fast loop, where a ten-thousandth of a tick makes torque
BESIDE = 0.1  # ticks before a row: as soon behind the row before, as far as noise lets a log say
PLACE = (0.5, 0.5)  # of φ
EVEN = 0.07  # of the law's width: where the share of the commands that arrived in one tick puts its edge, for an even, Gaussian or skew law
START = 0.1, 0.9  # widths from which the search for a law over two ticks starts
HICCUP = 0.03  # of the arrivals
WIDEST = 0.5  # ticks to either side, beyond which windows of commands overlap
ROOT = 3**0.5  # half-width of an even law over its deviation


@dataclass(frozen=True)
class Known:
    """Commands that a law knows: `data.command`, acting at each row's grid point, and its changes (m, q) by kind of arrival."""

    data: Data
    changes: Floats


@dataclass(frozen=True)
class Window:
    """Distribution of the arrivals of one kind within their tick, as n weighted moments.

    places     (n,) before the grid point [ticks]; readings (n,) before the row's reading, 0 where after it
    weights    (n,) sum 1
    """

    places: Floats
    readings: Floats
    weights: Floats

    def moments(self, speed: float, damping: float) -> tuple[Floats, Floats]:
        """Mean (3,) and covariance (3, 3) of the effect of a unit change on the state (τ, τ̇/ω) at the grid point and on the reading."""
        values = np.stack([*held(speed, damping, self.places)[:2], held(speed, damping, self.readings)[0]])
        mean = values @ self.weights
        rest = values - mean[:, None]
        return mean, (self.weights * rest) @ rest.T


class Law(Protocol):
    """Law of arrivals with two parameters (2,), their starting point, and their `prior` (2, 2): mean and information."""

    prior: Floats
    bounds: tuple[float, float]  # of the first parameter
    stillest: float  # log of the least deviation

    def start(self, delay: float) -> Floats:
        """Starting point near a mean delay [ticks], as near as the observed arrivals allow."""
        ...

    def known(self, point: Floats) -> Known:
        """Known command of each row, see Known."""
        ...

    def windows(self, point: Floats) -> tuple[float, list[Window]]:
        """Moment within the tick, 0 to 1, at which a row is read, and the distribution of arrivals of each kind."""
        ...

    def edges(self, point: Floats) -> list[tuple[float, float]]:
        """Pairs (value, side): values of the first parameter near `point` with which commands arrive exactly at a row.

        They arrive before the row for values beyond it on `side`: 1, larger; −1, smaller.

        Empty where no parameter says so.
        """
        ...

    def rows(self, point: Floats) -> Floats:
        """Means (2,) of D and of the age of the command that acts if all arrived exactly at a row [ticks]."""
        ...

    def means(self, point: Floats) -> Floats:
        """Mean of D, mean age of the command that acts, standard deviation of D, and that within its tick, (4,) [ticks]."""
        ...


def _even(low: float, high: float) -> tuple[Floats, Floats]:
    """Nodes and weights of a uniform law."""
    return (low + high) / 2 + (high - low) / 2 * NODES, WEIGHTS / 2


def _half(point: Floats, stillest: float) -> float:
    """Half the width of an even law [ticks], from its log deviation."""
    return float(min(ROOT * np.exp(np.clip(point[1], stillest, 1)), WIDEST))


def _prior(*knowledge: tuple[float, float]) -> Floats:
    mean, deviation = np.array(knowledge).T
    return np.stack([mean, 1 / deviation**2])


class Unseen:
    """Law of arrivals for a log without demand torque: D is uniform about its mean. Parameters: mean and log deviation of D [ticks]."""

    def __init__(self, target: Data) -> None:
        self.target = target
        self.prior, self.bounds = _prior((0.0, np.inf), DEVIATION), (0.0, np.inf)
        self._known: dict[int, Known] = {}
        self.stillest = STILLEST

    def start(self, delay: float) -> Floats:
        return np.array([delay, DEVIATION[0]])

    def _whole(self, point: Floats) -> int:
        return max(int(np.floor(point[0] + _half(point, self.stillest))), 0)

    def known(self, point: Floats) -> Known:
        whole = self._whole(point)
        if whole not in self._known:
            data = acting(self.target, np.arange(len(self.target.command)) - whole)
            self._known[whole] = Known(data, np.diff(data.command, prepend=data.command[0])[:, None])
        return self._known[whole]

    def windows(self, point: Floats) -> tuple[float, list[Window]]:
        half, whole = _half(point, self.stillest), self._whole(point)
        first, last = point[0] - half, point[0] + half
        middle = float(np.clip(whole, first, last))
        parts = [_even(first, middle), _even(middle, last)]
        delays = np.concatenate([nodes for nodes, _ in parts])
        sizes = np.array([middle - first, last - middle]) / (last - first)
        weights = np.concatenate([size * weights for size, (_, weights) in zip(sizes, parts, strict=True)])
        return whole - last + 1, [Window(last - delays, np.maximum(whole - delays, 0.0), weights)]

    def rows(self, point: Floats) -> Floats:
        return np.full(2, max(float(np.ceil(point[0])), 1.0))

    def edges(self, point: Floats) -> list[tuple[float, float]]:
        row = max(float(np.ceil(point[0])), 1.0)
        return [(row, -1.0), (row + 1, -1.0)][: 2 if row - point[0] < BESIDE else 1]

    def means(self, point: Floats) -> Floats:
        deviation = _half(point, self.stillest) / ROOT
        return np.array([point[0], point[0], deviation, deviation])


class _Seen:
    """Base of the laws for logs whose demand torque shows in which tick each command arrives."""

    def __init__(self, seen: Arrivals, target: Floats, acting: Data) -> None:
        self.seen = seen
        self.stillest = STILLEST
        self._known = Known(acting, seen.changes(target, acting.command))

    def known(self, point: Floats) -> Known:
        return self._known

    def rows(self, point: Floats) -> Floats:
        return np.array([self.seen.mean, self.seen.ticks.mean()])


class Phase(_Seen):
    """Law of arrivals seen to the tick, all at one place within it, as on a bus that is read once a tick; parameters φ and log deviation.

    φ is the part of a tick from arrival to row. Rare ticks are hiccups, in which commands arrive at any place.
    """

    def __init__(self, seen: Arrivals, target: Floats, acting: Data) -> None:
        super().__init__(seen, target, acting)
        self.usual = seen.shares >= HICCUP
        self.prior, self.bounds = _prior(PLACE, DEVIATION), (0.0, 1.0)

    def start(self, delay: float) -> Floats:
        return np.array([self.seen.mean - delay, DEVIATION[0]])

    def windows(self, point: Floats) -> tuple[float, list[Window]]:
        half = _half(point, self.stillest)
        laws = {True: _even(point[0] - half, point[0] + half), False: _even(0.0, 1.0)}
        return 1.0, [Window(laws[usual][0], *laws[usual]) for usual in self.usual.tolist()]

    def edges(self, point: Floats) -> list[tuple[float, float]]:
        return [(0.0, 1.0)]

    def means(self, point: Floats) -> Floats:
        seen, within = self.seen, _half(point, self.stillest) / ROOT
        places = np.where(self.usual, point[0], 0.5)
        kinds = np.clip(seen.ticks - seen.first, 0, len(places) - 1)
        sooner = places[kinds].mean()
        return np.array([seen.mean - seen.shares @ places, seen.ticks.mean() - sooner, np.hypot(seen.deviation, within), within])


class Spread(_Seen):
    """Law of arrivals seen to the tick, spread over several ticks; parameters: shift of the first edge over the width, and log width.

    In every tick D is even. An even law's edges follow from the shares of its first and last tick; the shift is how far they are from that.
    """

    def __init__(self, seen: Arrivals, target: Floats, acting: Data) -> None:
        super().__init__(seen, target, acting)
        self.shares, self.bounds = seen.shares, (-0.5, 0.5)
        inner = float(self.shares[1:-1].sum())
        self.between = len(self.shares) - 2
        sampled = (self.shares[0] * self.shares[-1] / len(seen.ticks)) ** 0.5
        wide = (np.log(2 * ROOT) + DEVIATION[0], DEVIATION[1]) if not self.between else (np.log(self.between / inner), 2 * EVEN)
        self.prior = _prior((0.0, float(np.hypot(EVEN, sampled))), wide)

    def start(self, delay: float) -> Floats:
        if self.between:
            return np.array([0.0, self.prior[0, 1]])
        first, last = self.shares
        width = 2 * (delay - self.seen.first) / (last - first) if last != first else 0.5
        return np.array([0.0, np.log(np.clip(width, *START))])

    def _ends(self, point: Floats) -> tuple[float, float]:
        """Fractions, 0 to 1, of the first and of the last tick in which commands may arrive."""
        ends = self.shares[[0, -1]] / (self.shares[0] + self.shares[-1])
        width = float(np.exp(np.clip(point[1], -9, 3)))
        outer = max(width - self.between, 1e-3)
        first, last = outer * ends[0] + point[0] * width, outer * ends[1] - point[0] * width
        return float(np.clip(first, 1e-4, 1.0)), float(np.clip(last, 1e-4, 1.0))

    def _bounds(self, point: Floats) -> Floats:
        """Lower and upper bound (q, 2) of D in each tick [ticks], counted from the tick before the first."""
        first, last = self._ends(point)
        count = len(self.shares)
        bounds = np.column_stack([np.arange(count), np.arange(1, count + 1)]).astype(float)
        bounds[0, 0], bounds[-1, 1] = 1 - first, count - 1 + last
        return bounds

    def _arriving(self, point: Floats) -> tuple[Floats, Floats]:
        """Moments (q, n) [ticks] at which commands come to act, counted from the tick before the first, and their weights, by tick.

        Where a later command comes first it takes an earlier one's place: P(X > x) = Π P(D > x − i).
        """
        bounds = self._bounds(point)
        nodes = np.stack([_even(low, high)[0] for low, high in bounds])
        knots, law = np.concatenate([bounds[:, 0], bounds[-1:, 1]]), np.concatenate([[0.0], np.cumsum(self.shares)])
        later = nodes[..., None] - np.arange(len(self.shares))
        survival = 1 - np.interp(later, knots, law)
        tick = np.clip(np.searchsorted(knots, later, side="right") - 1, 0, len(self.shares) - 1)
        density = np.where((later > knots[0]) & (later < knots[-1]), (self.shares / np.diff(knots))[tick], 0.0)
        others = np.stack([np.delete(survival, i, axis=-1).prod(axis=-1) for i in range(len(self.shares))], axis=-1)
        weights = WEIGHTS * np.maximum((density * others).sum(axis=-1), 1e-12)
        return nodes, weights / weights.sum(axis=1, keepdims=True)

    def windows(self, point: Floats) -> tuple[float, list[Window]]:
        nodes, weights = self._arriving(point)
        places = np.arange(1, len(nodes) + 1)[:, None] - nodes
        return 1.0, [Window(place, place, weight) for place, weight in zip(places, weights, strict=True)]

    def edges(self, point: Floats) -> list[tuple[float, float]]:
        return []  # where in its ticks it is the shares tell, with the loop's help

    def means(self, point: Floats) -> Floats:
        seen, bounds = self.seen, self._bounds(point)
        middles, widths = bounds.mean(axis=1), np.diff(bounds)[:, 0]
        early = np.arange(1, len(bounds) + 1) - middles
        nodes, weights = self._arriving(point)
        sooner = np.arange(1, len(nodes) + 1) - (nodes * weights).sum(axis=1)
        kinds = np.clip(seen.ticks - seen.first, 0, len(bounds) - 1)
        mean = self.shares @ middles
        deviation = (self.shares @ (middles**2 + widths**2 / 12) - mean**2) ** 0.5
        within = self.shares @ widths / 12**0.5
        return np.array([seen.mean - self.shares @ early, seen.ticks.mean() - sooner[kinds].mean(), deviation, within])


def acting(data: Data, rows: Integers) -> Data:
    """Data with the commands of those rows, if data.command is the target; after a gap the command is unknown until a later one acts."""
    age = np.arange(len(rows)) - rows
    return Data(data.command[np.maximum(rows, 0)], data.torque, np.maximum(data.run_length - age, 0))
