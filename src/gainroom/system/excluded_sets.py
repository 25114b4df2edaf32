"""Excluded sets around −1: the sets of the complex plane that a requirement keeps L(jω) out of.

A gain margin g excludes the segment [−g, −1/g], a phase margin φ the arc |L| = 1, |arg(−L)| ≤ φ, a ceiling on |a S + b|, S = 1/(1 + L), a
disk: around −1 for a peak sensitivity, further left for a peak complementary sensitivity. A set answers three questions: which kd it
excludes on lines kp = const (analysis/excluded_region.py), whether a box of frequencies and parameters keeps L clear of it
(analysis/range_proof.py), and how far a value of L is from it.
"""

import cmath
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .linear.arrays import Booleans, Complexes, Floats

ROUND_OFF = 1e-6
"""Relative tolerance of every comparison with a requirement: a margin short by no more is met.

Gains placed exactly on a requirement return with round-off of the search and of dB and degrees below 1e-8; the tolerance grants 1e-5 dB or
2e-5° of 30°, which is not measurable.
"""


@dataclass(frozen=True)
class Branch:
    """Function (kp, A, B) → (kd, inside) for L = kp A + kd B: the kd that puts L on the curve (axis, circle) that the set is a part of.

    inside   True where kd is finite and L is then in the set itself
    """

    solve: Callable[[Floats, Complexes, Complexes], tuple[Floats, Booleans]]
    paired: bool = False  # the equation is quadratic and this is one of two solutions

    def __call__(self, kp: Floats, a: Complexes, b: Complexes) -> tuple[Floats, Booleans]:
        """Solution kd and its validity for arrays kp, A, B of one shape."""
        return self.solve(kp, a, b)


class GainLines(Protocol):
    """Lines kp = const in the gain plane, on which a curve or disk in the plane of L becomes intervals of kd."""

    def swept(self, branches: Sequence[Branch], ends: Sequence[complex]) -> list[Any]:
        """Intervals of kd excluded by a curve in the plane of L, with end points `ends`."""
        ...

    def at_ends(self, low: float, high: float) -> list[Any]:
        """Intervals of kd for which L is real and in [low, high] at the ends of the frequency range, where L is real."""
        ...

    def shadow(self, center: float, radius: float) -> list[Any]:
        """Intervals of kd excluded by the disk |L − center| < radius."""
        ...


class Boxes(Protocol):
    """Bounds of L over n boxes: log|L| in [log_low, log_high], arg L at least `apart()` away from arg(−1); arrays (n,)."""

    @property
    def log_low(self) -> Floats: ...

    @property
    def log_high(self) -> Floats: ...

    def apart(self) -> Floats: ...


class ExcludedSet(ABC):
    """Set in the plane of L that contains −1 and that L(jω) must avoid."""

    @abstractmethod
    def on(self, lines: GainLines) -> list[Any]:
        """Excluded kd, as the intervals that `lines` returns."""

    @abstractmethod
    def clear(self, boxes: Boxes) -> Booleans:
        """(n,) True where a box does not intersect the set, within ROUND_OFF."""

    @abstractmethod
    def distance(self, value: Complexes) -> Floats:
        """Distance of each L from the set in ln L, for a disk relative to its radius; negative inside a disk."""

    @property
    def smallest(self) -> float:
        """Least |L| of the set."""
        return 1.0


@dataclass(frozen=True)
class Segment(ExcludedSet):
    """Segment [−g, −1/g] for g = `factor`; the point −1 for g = 1."""

    factor: float

    def on(self, lines: GainLines) -> list[Any]:
        factor = self.factor

        def solve(kp: Floats, a: Complexes, b: Complexes) -> tuple[Floats, Booleans]:
            with np.errstate(divide="ignore", invalid="ignore"):
                kd = -kp * a.imag / b.imag
                value = kp * a.real + kd * b.real
            return kd, np.isfinite(kd) & (value >= -factor) & (value <= -1 / factor)

        return lines.swept([Branch(solve)], [-factor, -1.0, -1 / factor]) + lines.at_ends(-factor, -1 / factor)

    def clear(self, boxes: Boxes) -> Booleans:
        reach = math.log(self.factor) * (1 - ROUND_OFF)
        return (boxes.apart() > 0) | (boxes.log_low > reach) | (boxes.log_high < -reach)

    def distance(self, value: Complexes) -> Floats:
        apart, log = _polar(value)
        return np.hypot(apart, np.maximum(log - math.log(self.factor), 0.0))

    @property
    def smallest(self) -> float:
        return 1 / self.factor


@dataclass(frozen=True)
class Arc(ExcludedSet):
    """Arc |L| = 1, |arg(−L)| ≤ `angle` [rad]."""

    angle: float

    def on(self, lines: GainLines) -> list[Any]:
        return lines.swept([self._branch(sign) for sign in (-1.0, 1.0)], [-cmath.exp(1j * self.angle), -cmath.exp(-1j * self.angle)])

    def _branch(self, sign: float) -> Branch:
        def solve(kp: Floats, a: Complexes, b: Complexes) -> tuple[Floats, Booleans]:
            kd, real = on_circle(kp, a, b, 0.0, 1.0, sign)
            with np.errstate(invalid="ignore"):
                return kd, real & (np.abs(np.angle(-(kp * a + kd * b))) <= self.angle)

        return Branch(solve, paired=True)

    def clear(self, boxes: Boxes) -> Booleans:
        return (boxes.log_low > 0) | (boxes.log_high < 0) | (boxes.apart() >= self.angle * (1 - ROUND_OFF))

    def distance(self, value: Complexes) -> Floats:
        apart, log = _polar(value)
        return np.hypot(np.maximum(apart - self.angle, 0.0), log)


@dataclass(frozen=True)
class Disk(ExcludedSet):
    """Disk |L − center| < radius, center on the negative real axis."""

    center: float
    radius: float

    @classmethod
    def of_ceiling(cls, ceiling: float, slope: float, offset: float) -> "Disk":
        """Disk where |a S + b| > `ceiling`, S = 1/(1 + L), a = `slope`, b = `offset`, for ceilings above |b| (Apollonius)."""
        beyond = ceiling - offset**2 / ceiling
        return cls(-(ceiling - offset * (slope + offset) / ceiling) / beyond, abs(slope) / beyond)

    def on(self, lines: GainLines) -> list[Any]:
        return lines.shadow(self.center, self.radius)

    def clear(self, boxes: Boxes) -> Booleans:
        far, cosine = -self.center, np.cos(np.minimum(boxes.apart(), math.pi))
        low, high = (np.exp(np.clip(log, -300, 300)) for log in (boxes.log_low, boxes.log_high))
        size = np.clip(far * cosine, low, high)
        distance = np.sqrt(np.maximum(0.0, far**2 + size**2 - 2 * far * size * cosine))
        return distance >= self.radius * (1 - ROUND_OFF)

    def distance(self, value: Complexes) -> Floats:
        return np.abs(value - self.center) / self.radius - 1

    @property
    def smallest(self) -> float:
        return -self.center - self.radius


def on_circle(kp: Floats, a: Complexes, b: Complexes, offset: float, radius: float, sign: float) -> tuple[Floats, Booleans]:
    """One of the two kd with |offset + kp A + kd B| = radius (chosen by `sign`), and where it exists."""
    with np.errstate(invalid="ignore"):  # on a pole of A and B nothing is defined, and nothing exists
        rest = offset + kp * a
        across = rest * b.conj()
        size = np.abs(b) ** 2
        discriminant = size * radius**2 - across.imag**2  # not half² − size (|rest|² − radius²), which cancels
        real = discriminant >= 0
        return (-across.real + sign * np.sqrt(np.where(real, discriminant, 0.0))) / size, real


def _polar(value: Complexes) -> tuple[Floats, Floats]:
    """Polar coordinates |arg(−L)| and |ln|L|| of L about −1."""
    with np.errstate(all="ignore"):
        return np.abs(np.angle(-value)), np.abs(np.log(np.abs(value)))
