"""Filters of a controller, continuous or mapped to sampled time: low-pass on the velocity, notches, and the integrator.

Polynomials are in v: s, or δ = (z − 1)/T_s in sampled time, to which Tustin's rule maps a filter, exact at its own frequency.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import GainroomError, require_positive
from .linear.arrays import Complexes, Floats
from .linear.transfer_function import Factored, ratio

Ratio = tuple[Floats, Floats]


def value_of(ratio: Ratio, v: Complexes) -> Complexes:
    """Ratio of polynomials, numerator over denominator, at complex v of any shape."""
    return _horner(ratio[0], v) / _horner(ratio[1], v)


def _horner(coefficients: Floats, v: Complexes) -> Complexes:
    """Polynomial at v by Horner's rule; np.polyval took a tenth of a response's time."""
    first, *others = coefficients.tolist()
    value = np.full(v.shape, first, dtype=complex)
    for coefficient in others:
        value = value * v + coefficient
    return value


@dataclass(frozen=True)
class LowPass:
    """Low-pass filter on the velocity: order 1, ω/(s + ω); order 2, ω²/(s² + 2ζω s + ω²). bandwidth ω [rad/s]."""

    bandwidth: float
    order: int = 1
    damping_ratio: float = math.sqrt(0.5)

    def __post_init__(self) -> None:
        require_positive("velocity filter", "bandwidth", self.bandwidth, "rad/s")
        require_positive("velocity filter", "damping_ratio", self.damping_ratio)
        if self.order not in (1, 2) or isinstance(self.order, bool):
            raise GainroomError(f"velocity filter: order {self.order!r} must be 1 or 2")

    def polynomials(self, sample_time: float | None) -> Ratio:
        """Numerator and denominator in v."""
        w = self.bandwidth
        if self.order == 1:
            return _tustin(np.array([w]), np.array([1.0, w]), w, sample_time, "velocity filter bandwidth")
        return _tustin(np.array([w * w]), np.array([1.0, 2 * self.damping_ratio * w, w * w]), w, sample_time, "velocity filter bandwidth")


@dataclass(frozen=True)
class Notch:
    """Notch filter (s² + depth·width·ω s + ω²) / (s² + width·ω s + ω²).

    frequency   ω, where the notch is deepest [rad/s]
    width       w of a full notch (depth 0), whose half-power points lie at ω (√(1 + (w/2)²) ± w/2); 0.5: about a third of an
                octave to either side
    depth       gain at ω: 0 blocks it entirely
    """

    frequency: float
    width: float = 0.5
    depth: float = 0.1

    def __post_init__(self) -> None:
        require_positive("notch", "frequency", self.frequency, "rad/s")
        require_positive("notch", "width", self.width)
        require_positive("notch", "depth", self.depth, zero=True)

    def polynomials(self, sample_time: float | None) -> Ratio:
        """Numerator and denominator in v."""
        w, damping = self.frequency, self.width * self.frequency
        return _tustin(np.array([1.0, self.depth * damping, w * w]), np.array([1.0, damping, w * w]), w, sample_time, "notch frequency")


@lru_cache(256)
def filtered_velocity(velocity_filter: LowPass | None, sample_time: float | None) -> Ratio:
    """Velocity V in v: backward difference (sampled) or s (continuous), times the filter."""
    num, den = (np.ones(1), np.ones(1)) if velocity_filter is None else velocity_filter.polynomials(sample_time)
    difference = np.ones(1) if sample_time is None else np.array([sample_time, 1.0])
    return np.append(num, 0.0), np.convolve(difference, den)


@lru_cache(256)
def notch_product(notches: tuple[Notch, ...], sample_time: float | None) -> Factored:
    """Product N of the notches in v."""
    product = ratio([1.0], [1.0], sample_time)
    for notch in notches:
        product = product * ratio(*notch.polynomials(sample_time), sample_time)
    return product


def integrator(sample_time: float | None) -> Ratio:
    """Integrator I in v: 1/s, or backward Euler (1 + T_s δ)/δ."""
    return (np.ones(1) if sample_time is None else np.array([sample_time, 1.0])), np.array([1.0, 0.0])


def _tustin(num: Floats, den: Floats, center: float, sample_time: float | None, name: str) -> Ratio:
    """`num`/`den` in s, mapped to δ by Tustin's rule exact at the frequency `center` [rad/s]; unchanged in continuous time."""
    if sample_time is None:
        return num, den
    if center * sample_time >= math.pi:
        raise GainroomError(f"{name} {center:g} rad/s must be below half the sample rate, {math.pi / sample_time:g} rad/s")
    warp = math.tan(center * sample_time / 2) / (center * sample_time / 2)
    # s = δ / (warp (1 + T_s δ/2)); multiply through by the denominator's power.
    degree = len(den) - 1
    below = np.array([sample_time / 2, 1.0]) * warp
    mapped = []
    for poly in (num, den):
        total = np.zeros(1)
        for coefficient, power in zip(poly, range(len(poly) - 1, -1, -1), strict=True):
            part = np.full(1, coefficient)
            for _ in range(power):
                part = np.polymul(part, [1.0, 0.0])
            for _ in range(degree - power):
                part = np.polymul(part, below)
            total = np.polyadd(total, part)
        mapped.append(total)
    return mapped[0], mapped[1]
