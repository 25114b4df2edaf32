"""Discs of complex numbers that contain a quantity and its slopes everywhere in a box of parameters; many boxes at once, in numpy.

A Ball holds, for n boxes, the disc (mid, rad) of everything that a quantity can be in each, and by parameter the disc of everything
that its slope can be, times half the box's width. Sums, products and inverses of discs contain every sum, product and inverse of their
members (Gargantini and Henrici 1972). Where a disc that is inverted contains 0 the result is not finite, which the caller looks for.
A number has the radius 0.0, a float; what is made of numbers alone is one, and nothing is computed for its radius.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..system.linear.arrays import Floats

Disc = tuple[Any, Any]
"""(mid, rad), (n,) each, or (m, n); rad 0.0: numbers."""


def is_number(rad: Any) -> bool:
    """Whether a disc with this radius is one number for each box."""
    return isinstance(rad, float) and rad == 0.0


def times(first: Disc, second: Disc) -> Disc:
    """Disc of all products."""
    (a, reach_a), (b, reach_b) = first, second
    if is_number(reach_b):
        return a * b, 0.0 if is_number(reach_a) else reach_a * np.abs(b)
    if is_number(reach_a):
        return a * b, np.abs(a) * reach_b
    return a * b, np.abs(a) * reach_b + reach_a * (np.abs(b) + reach_b)


def plus(first: Disc, second: Disc) -> Disc:
    """Disc of all sums."""
    return first[0] + second[0], first[1] + second[1]


def inverse(disc: Disc) -> Disc:
    """Disc of all inverses; not finite where 0 is in `disc`."""
    mid, rad = disc
    least_square = np.abs(mid) ** 2 - rad**2
    least_square = np.where(least_square > 0, least_square, np.nan)
    return np.conj(mid) / least_square, 0.0 if is_number(rad) else rad / least_square


def turned(disc: Disc) -> Disc:
    """Disc of all e^{jx} for real x."""
    mid, rad = disc
    return np.exp(1j * mid), 2 * np.sin(np.minimum(rad, np.pi) / 2)


@dataclass(frozen=True)
class Ball:
    """One quantity in n boxes: its disc, and by parameter that of its slope times half the box's width."""

    disc: Disc
    slopes: dict[int, Disc] = field(default_factory=dict)

    @classmethod
    def parameter(cls, index: int, low: Floats, high: Floats) -> "Ball":
        """Parameter number `index`, between `low` and `high` (n,)."""
        mid, half = 0.5 * (low + high), 0.5 * (high - low)
        return cls((mid, half), {index: (half, 0.0)})

    def __mul__(self, other: "Ball | complex | Floats") -> "Ball":
        if not isinstance(other, Ball):
            return Ball(times(self.disc, (other, 0.0)), {i: times(slope, (other, 0.0)) for i, slope in self.slopes.items()})
        slopes = {i: times(slope, other.disc) for i, slope in self.slopes.items()}
        for i, slope in other.slopes.items():
            part = times(self.disc, slope)
            slopes[i] = plus(slopes[i], part) if i in slopes else part
        return Ball(times(self.disc, other.disc), slopes)

    __rmul__ = __mul__

    def __add__(self, other: "Ball | complex | Floats") -> "Ball":
        if not isinstance(other, Ball):
            return Ball(plus(self.disc, (other, 0.0)), self.slopes)
        slopes = dict(self.slopes)
        for i, slope in other.slopes.items():
            slopes[i] = plus(slopes[i], slope) if i in slopes else slope
        return Ball(plus(self.disc, other.disc), slopes)

    __radd__ = __add__

    def __sub__(self, other: "Ball") -> "Ball":
        return self + -1.0 * other

    def inverse(self) -> "Ball":
        """1/x."""
        value = inverse(self.disc)
        change = times((-1.0, 0.0), times(value, value))
        return Ball(value, {i: times(change, slope) for i, slope in self.slopes.items()})

    def root(self) -> "Ball":
        """√x of a real x > 0."""
        mid, rad = self.disc
        low, high = np.sqrt(np.maximum(mid - rad, 0.0)), np.sqrt(mid + rad)
        value = (0.5 * (low + high), 0.0 if is_number(rad) else 0.5 * (high - low))
        change = times((0.5, 0.0), inverse(value))
        return Ball(value, {i: times(change, slope) for i, slope in self.slopes.items()})

    def turned(self) -> "Ball":
        """e^{jx} of a real x."""
        value = turned(self.disc)
        change = times((1j, 0.0), value)
        return Ball(value, {i: times(change, slope) for i, slope in self.slopes.items()})

    def plain(self) -> "Ball":
        """The quantity without its slopes."""
        return Ball(self.disc)

    def log_slopes(self) -> dict[int, Disc]:
        """Slopes of log x."""
        below = inverse(self.disc)
        return {i: times(slope, below) for i, slope in self.slopes.items()}

    def sizes(self) -> tuple[Floats, Floats]:
        """Least and largest |x|."""
        mid, rad = self.disc
        return np.maximum(np.abs(mid) - rad, 0.0), np.abs(mid) + rad


def gathered(first: dict[int, Disc], second: dict[int, Disc]) -> dict[int, Disc]:
    """Sum of two sets of slopes."""
    total = dict(first)
    for i, slope in second.items():
        total[i] = plus(total[i], slope) if i in total else slope
    return total


def constant(value: float, count: int) -> Ball:
    """A quantity that is the same in all `count` boxes."""
    return Ball((np.full(count, value, dtype=float), 0.0))
