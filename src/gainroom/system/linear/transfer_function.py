"""A scalar transfer function as zeros, poles, gain and exact delay; continuous or sampled in one form.

The variable is v = s in continuous time, and v = δ = (z − 1)/T_s in sampled time (the delta operator: Middleton and Goodwin 1990).
δ → s as T_s → 0, so both cases share every formula, and roots near z = 1 keep their digits.

    L(v) = gain · Π (v − zeros) / Π (v − poles) · e^{−sT}
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from numpy.typing import ArrayLike

from ...errors import GainroomError
from ...native import _core
from .arrays import Complexes, Floats

FASTEST = 50.0  # growth rate of a pole times the tick: e^50 exceeds what a double resolves, let alone what a controller can hold
POLISHED, NEARBY = 4, 1e-3  # steps of Newton on the roots of a sum, and the largest of a root that counts, relative to it
_NO_ROOTS = np.zeros(0, dtype=complex)


@dataclass(frozen=True)
class Factored:
    """Scalar transfer function.

    zeros, poles   complex arrays, closed under conjugation, in v [1/s]
    gain           real
    delay          T [s]; in sampled time a whole number of sample times
    sample_time    T_s [s]; None: continuous
    """

    zeros: Complexes
    poles: Complexes
    gain: float
    delay: float = 0.0
    sample_time: float | None = None

    def __mul__(self, other: "Factored") -> "Factored":
        if self.sample_time != other.sample_time:
            raise GainroomError(f"sample times {self.sample_time} and {other.sample_time} of two systems in one loop must agree")
        return Factored(
            np.concatenate([self.zeros, other.zeros]),
            np.concatenate([self.poles, other.poles]),
            self.gain * other.gain,
            self.delay + other.delay,
            self.sample_time,
        )

    @property
    def is_one(self) -> bool:
        """True for the identity system."""
        return not len(self.zeros) and not len(self.poles) and self.gain == 1 and self.delay == 0

    def scaled(self, factor: float) -> "Factored":
        """Transfer function with its gain multiplied by `factor`."""
        return Factored(self.zeros, self.poles, self.gain * factor, self.delay, self.sample_time)

    def at(self, s: ArrayLike) -> Complexes:
        """Value at complex s [1/s] (any shape); in sampled time at z = e^{s T_s}."""
        s = np.asarray(s, dtype=complex)
        return _core.response(self.zeros, self.poles, self.gain, self.delay, self.sample_time or 0.0, s.ravel()).reshape(s.shape)

    def response(self, omega: ArrayLike) -> Complexes:
        """Frequency response at `omega` [rad/s] (any shape); the small angle to the nearest axis as ω → 0 is accurate to all digits."""
        omega = np.asarray(omega, dtype=float)
        return self._turned(omega, self.at(1j * omega))

    def response_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """Frequency response at `omega` (k,) and its derivative by ω, accurate as `response`."""
        rough, slope = _core.response_and_slope(self.zeros, self.poles, self.gain, self.delay, self.sample_time or 0.0, omega)
        value = self._turned(omega, rough)
        return value, (slope if value is rough else np.divide(slope * value, rough, out=slope, where=rough != 0))

    def _turned(self, omega: Floats, value: Complexes) -> Complexes:
        """`value` at jω with its phase recomputed from real roots and conjugate pairs, where ω is far below all complex pairs.

        A product of numbers near either axis keeps the digits of their angles to it, however small; with one complex root, whose factor is
        near none, round-off of 1e-16 stays in it. But (v − p)(v − p̄) = |p|² (1 + v (v − 2 Re p)/|p|²).
        """
        limit, pairs, others = self._pairs
        near = (omega != 0) & (np.abs(omega) < limit)
        if not np.any(near):
            return value
        v = 1j * omega[near]
        phase = others.at(v)
        if self.sample_time is not None:
            v = np.expm1(v * self.sample_time) / self.sample_time
        for root, power in pairs:
            phase = phase * (1 + v * (v - 2 * root.real) / abs(root) ** 2) ** power
        turned = value.copy()
        turned[near] = np.abs(value[near]) * phase / np.abs(phase)
        return turned

    @cached_property
    def _pairs(self) -> "tuple[float, list[tuple[complex, int]], Factored]":
        """Frequency far below all complex pairs, one root and exponent (±1) per pair, and the system without pairs."""
        pairs = [(root, power) for roots, power in ((self.zeros, 1), (self.poles, -1)) for root in roots[roots.imag > 0].tolist()]
        limit = 0.1 * min((abs(root) for root, _ in pairs), default=0.0)
        return limit, pairs, replace(self, zeros=self.zeros[self.zeros.imag == 0], poles=self.poles[self.poles.imag == 0])

    @property
    def reduced(self) -> "Factored":
        """Transfer function with common zeros and poles at v = 0 cancelled."""
        pairs = min(np.count_nonzero(self.zeros == 0), np.count_nonzero(self.poles == 0))
        if not pairs:
            return self
        zeros, poles = (np.delete(roots, np.flatnonzero(roots == 0)[:pairs]) for roots in (self.zeros, self.poles))
        return replace(self, zeros=zeros, poles=poles)

    @property
    def relative_degree(self) -> int:
        """Relative degree: poles minus zeros."""
        return len(self.poles) - len(self.zeros)

    @property
    def unstable_poles(self) -> int:
        """Number of poles right of the imaginary axis (outside the unit circle); poles on it are not counted."""
        return int(np.count_nonzero(growth(self.poles, self.sample_time) > 0))


def growth(roots: Complexes, sample_time: float | None) -> Floats:
    """Growth rate of each root in v: positive where it grows, negative where it decays, 0 on the boundary within round-off."""
    rate = roots.real.copy()
    if sample_time is not None:
        rate += np.abs(roots) ** 2 * sample_time / 2  # (|z|² − 1) / 2 T_s with z = 1 + T_s v, without cancellation
    rate[np.abs(rate) <= 1e-13 * np.abs(roots)] = 0.0
    return rate


def polynomial_roots(coefficients: ArrayLike) -> Complexes:
    """Roots of a real polynomial, highest power first; exact zeros stay exact, quadratics are solved without cancellation."""
    return _roots(_without_leading_zeros(coefficients))


def _roots(poly: list[float]) -> Complexes:
    if not poly:
        raise GainroomError("a transfer function with a zero polynomial has no roots")
    trimmed = list(poly)
    while trimmed[-1] == 0:
        trimmed.pop()
    zeros = len(poly) - len(trimmed)
    if len(trimmed) == 2:
        return np.array([0.0] * zeros + [-trimmed[1] / trimmed[0]], dtype=complex)
    at_zero = np.zeros(zeros, dtype=complex)
    if len(trimmed) == 1:
        return at_zero
    if len(trimmed) == 3:
        a, b, c = np.array(trimmed)
        discriminant = b * b - 4 * a * c
        if discriminant < 0:
            root = complex(-b, math.sqrt(-discriminant)) / (2 * a)
            return np.append(at_zero, [root, root.conjugate()])
        half = -(b + math.copysign(math.sqrt(discriminant), b)) / 2
        return np.append(at_zero, [half / a, c / half])
    # Time scaled so that the coefficients are of like size: the companion matrix is then well balanced.
    scale = abs(trimmed[-1] / trimmed[0]) ** (1 / (len(trimmed) - 1))
    roots = np.roots(trimmed * scale ** np.arange(len(trimmed) - 1, -1, -1.0)).astype(complex) * scale
    roots.real[np.abs(roots.real) < 1e-14 * np.abs(roots)] = 0.0
    return np.append(at_zero, paired(roots))


def _without_leading_zeros(coefficients: ArrayLike) -> list[float]:
    return _begun(np.asarray(coefficients, dtype=float).ravel().tolist())


def _begun(poly: list[float]) -> list[float]:
    """Coefficients without leading zeros."""
    if poly and poly[0] != 0:
        return poly
    first = next((k for k, one in enumerate(poly) if one != 0), len(poly))
    return poly[first:]


def paired(roots: Complexes) -> Complexes:
    """`roots` made exactly closed under conjugation."""
    upper = roots[roots.imag > 0]
    return np.concatenate([roots[roots.imag == 0], upper, upper.conj()])


def ratio(numerator: ArrayLike, denominator: ArrayLike, sample_time: float | None = None) -> Factored:
    """Transfer function of two polynomials in v, highest power first."""
    num, den = _without_leading_zeros(numerator), _without_leading_zeros(denominator)
    if not len(num):
        return Factored(_NO_ROOTS, _roots(den), 0.0, 0.0, sample_time)
    zeros, poles = _roots(num), _roots(den)
    return Factored(zeros, poles, num[0] / den[0], 0.0, sample_time)


def polynomials_times(numerators: Floats, shared: Factored) -> list[Factored]:
    """Transfer functions of the polynomials `numerators` (m, k) in v, highest power first, times `shared`, whose poles are reused."""
    found, poles, later = [], shared.poles, shared.zeros
    for num in map(_begun, numerators.tolist()):
        zeros = _roots(num) if num else _NO_ROOTS
        zeros = np.concatenate([zeros, later]) if len(later) else zeros
        found.append(Factored(zeros, poles, num[0] * shared.gain if num else 0.0, shared.delay, shared.sample_time))
    return found


def total(parts: Sequence[Factored]) -> Factored:
    """Sum of transfer functions with the same delay, not empty: its zeros are the roots of the sum of the numerators.

    Poles that not all have come to those that all have. The roots are polished on the numerators as products, which keeps the digits that
    coefficients of a high order lose.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    if any((one.delay, one.sample_time) != (first.delay, first.sample_time) for one in parts):
        raise GainroomError("a sum of transfer functions needs the same delay and sample time in each")
    if any(not np.array_equal(one.poles, first.poles) for one in parts):
        parts = _over_all_poles(parts)
        first = parts[0]
    shared, apart = _shared(parts)
    numerator = reduce(np.polyadd, (one.gain * np.real(np.poly(zeros)) for one, zeros in zip(parts, apart, strict=True)))
    begun = _begun(np.atleast_1d(numerator).tolist())
    if not begun:
        return replace(first, zeros=_NO_ROOTS, gain=0.0)
    roots = _roots(begun)
    for _ in range(POLISHED):
        value = slope = np.zeros(len(roots), dtype=complex)
        for one, zeros in zip(parts, apart, strict=True):
            factors = roots[:, None] - zeros
            value = value + one.gain * np.prod(factors, axis=1)
            for k in range(len(zeros)):
                slope = slope + one.gain * np.prod(np.delete(factors, k, axis=1), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = value / slope
        roots = np.where(np.abs(step) < NEARBY * np.abs(roots), roots - step, roots)  # a longer one would leave for another root
    roots = np.where(np.abs(roots.imag) <= 1e-14 * np.abs(roots), roots.real, roots).astype(complex)
    return replace(first, zeros=np.concatenate([paired(roots), shared]), gain=begun[0])


def _over_all_poles(parts: Sequence[Factored]) -> list[Factored]:
    """`parts` with the poles of all, each pole as often as one has it at most; what one lacks it has as a zero, too."""
    every: Counter[complex] = Counter()
    for one in parts:
        every |= Counter(one.poles.tolist())
    poles = np.array([*every.elements()], dtype=complex)
    found = []
    for one in parts:
        lacking = np.array([*(every - Counter(one.poles.tolist())).elements()], dtype=complex)
        found.append(replace(one, zeros=np.concatenate([one.zeros, lacking]), poles=poles))
    return found


def _shared(parts: Sequence[Factored]) -> tuple[Complexes, list[Complexes]]:
    """Zeros that all `parts` have, and those that each has besides."""
    shared, apart = [], [one.zeros.tolist() for one in parts]
    for root in parts[0].zeros.tolist():
        if all(root in zeros for zeros in apart):
            shared.append(root)
            for zeros in apart:
                zeros.remove(root)
    return np.array(shared, dtype=complex), [np.array(zeros, dtype=complex) for zeros in apart]


def sample(system: Factored, sample_time: float, fraction: float = 0.0) -> Factored:
    """`system` (continuous, strictly proper, its delay left aside) sampled at T_s [s] with `fraction` in [0, 1) of a tick of delay.

    The sampling is exact, behind a zero-order hold; native/include/gainroom/sampling.hpp has the formulas, and why they need 96 digits.
    Raises GainroomError if a pole grows by more than e^50 within a tick, or if the coefficients span too many orders of magnitude.
    """
    rate = float(np.max(system.poles.real, initial=0.0))
    if rate * sample_time > FASTEST:
        raise GainroomError(f"loop: grows by itself at {rate:.3g}/s, too fast to be sampled every {1e3 * sample_time:g} ms")
    zeros, poles, gain = _core.sample(system.zeros, system.poles, system.gain, sample_time, fraction)
    if not len(poles):
        raise GainroomError(f"loop: cannot be sampled every {1e3 * sample_time:g} ms: its values are too many orders of magnitude apart")
    return Factored(zeros, poles, gain, 0.0, sample_time)
