"""Filters of a controller, continuous or mapped to sampled time: low-pass on the velocity, notches and biquads, and the integrator.

Polynomials are in v: s, or δ = (z − 1)/T_s in sampled time, to which Tustin's rule maps a filter, exact at its own frequency: of a
biquad that of its poles.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import GainroomError, require_positive
from .linear.arrays import Complexes, Floats
from .linear.transfer_function import Factored, ratio

Ratio = tuple[Floats, Floats]
FILTERS = ("velocity_filter", "notches", "biquads")
"""Fields of a controller, and keys of `control` in files, that hold filters."""


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


class Filter:
    """A filter of order 1 or 2 that Tustin's rule maps to sampled time."""

    def polynomials(self, sample_time: float | None) -> Ratio:
        """Numerator and denominator in v. Raises GainroomError for a frequency that is not below half the sample rate."""
        raise NotImplementedError

    def coefficients(self, sample_time: float) -> tuple[float, float, float, float, float]:
        """Coefficients (b0, b1, b2, a1, a2) of y[k] = b0 x[k] + b1 x[k−1] + b2 x[k−2] − a1 y[k−1] − a2 y[k−2]. Raises GainroomError.

        They have lost (ω T_s)² of their digits; of order 1, b2 and a2 are 0.
        """
        num, den = self.polynomials(sample_time)
        order = len(den) - 1
        b, a = (_in_z(np.pad(each, (order + 1 - len(each), 0)), sample_time) for each in (num, den))
        b0, b1, b2, _, a1, a2 = (float(each / a[0]) for poly in (b, a) for each in np.pad(poly, (0, 2 - order)))
        return b0, b1, b2, a1, a2


@dataclass(frozen=True)
class LowPass(Filter):
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
class Biquad(Filter):
    """Second-order filter ((s² + 2ζ₁ω₁ s + ω₁²)/ω₁²) / ((s² + 2ζ₂ω₂ s + ω₂²)/ω₂²), with gain 1 at rest and (ω₂/ω₁)² at high frequency.

    zero_frequency   ω₁ [rad/s]
    zero_damping     ζ₁; 0 blocks ω₁ entirely
    pole_frequency   ω₂ [rad/s], at which Tustin's rule is exact; sampled, ω₁ therefore comes out as (2/T_s) atan(ω₁/ω₂ tan(ω₂T_s/2))
    pole_damping     ζ₂
    """

    zero_frequency: float
    zero_damping: float
    pole_frequency: float
    pole_damping: float

    def __post_init__(self) -> None:
        require_positive("biquad", "zero_frequency", self.zero_frequency, "rad/s")
        require_positive("biquad", "zero_damping", self.zero_damping, zero=True)
        require_positive("biquad", "pole_frequency", self.pole_frequency, "rad/s")
        require_positive("biquad", "pole_damping", self.pole_damping)

    def polynomials(self, sample_time: float | None) -> Ratio:
        """Numerator and denominator in v. Raises GainroomError unless both frequencies are below half the sample rate."""
        return self._polynomials(sample_time, "biquad pole_frequency", "biquad zero_frequency")

    def _polynomials(self, sample_time: float | None, poles: str, zeros: str) -> Ratio:
        """Numerator and denominator in v; `poles` and `zeros` name the frequencies in messages."""
        w, ratio = self.pole_frequency, (self.pole_frequency / self.zero_frequency) ** 2
        _require_below_half(self.zero_frequency, sample_time, zeros)
        num = ratio * np.array([1.0, 2 * self.zero_damping * self.zero_frequency, self.zero_frequency**2])
        return _tustin(num, np.array([1.0, 2 * self.pole_damping * w, w * w]), w, sample_time, poles)


@dataclass(frozen=True)
class Notch(Filter):
    """Notch filter (s² + depth·width·ω s + ω²) / (s² + width·ω s + ω²), the biquad of equal frequencies.

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

    def biquad(self) -> Biquad:
        """The same filter as a biquad."""
        return Biquad(self.frequency, self.depth * self.width / 2, self.frequency, self.width / 2)

    def polynomials(self, sample_time: float | None) -> Ratio:
        """Numerator and denominator in v. Raises GainroomError unless the frequency is below half the sample rate."""
        return self.biquad()._polynomials(sample_time, "notch frequency", "notch frequency")


@lru_cache(256)
def filtered_velocity(velocity_filter: LowPass | None, sample_time: float | None) -> Ratio:
    """Velocity V in v: backward difference (sampled) or s (continuous), times the filter."""
    num, den = (np.ones(1), np.ones(1)) if velocity_filter is None else velocity_filter.polynomials(sample_time)
    difference = np.ones(1) if sample_time is None else np.array([sample_time, 1.0])
    return np.append(num, 0.0), np.convolve(difference, den)


@lru_cache(256)
def filter_product(filters: tuple[Notch | Biquad, ...], sample_time: float | None) -> Factored:
    """Product N of notches and biquads in v."""
    product = ratio([1.0], [1.0], sample_time)
    for one in filters:
        product = product * ratio(*one.polynomials(sample_time), sample_time)
    return product


def integrator(sample_time: float | None) -> Ratio:
    """Integrator I in v: 1/s, or backward Euler (1 + T_s δ)/δ."""
    return (np.ones(1) if sample_time is None else np.array([sample_time, 1.0])), np.array([1.0, 0.0])


def _tustin(num: Floats, den: Floats, center: float, sample_time: float | None, name: str) -> Ratio:
    """`num`/`den` in s, mapped to δ by Tustin's rule exact at the frequency `center` [rad/s]; unchanged in continuous time."""
    if sample_time is None:
        return num, den
    _require_below_half(center, sample_time, name)
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


def _require_below_half(frequency: float, sample_time: float | None, name: str) -> None:
    """Raise GainroomError unless a frequency [rad/s] is below half the sample rate."""
    if sample_time is not None and frequency * sample_time >= math.pi:
        raise GainroomError(f"{name} {frequency:g} rad/s must be below half the sample rate, {math.pi / sample_time:g} rad/s")


def _in_z(polynomial: Floats, sample_time: float) -> Floats:
    """Polynomial in δ = (z − 1)/T_s as one in z, by Horner's rule."""
    value = polynomial[:1]
    for coefficient in polynomial[1:]:
        value = np.convolve(value, [1.0, -1.0]) / sample_time
        value[-1] += coefficient
    return value
