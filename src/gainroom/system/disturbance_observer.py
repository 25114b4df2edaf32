"""The law of a PD controller with a disturbance observer as zeros, poles and gain in x = T_s δ = z − 1, where slow roots keep their digits.

With Q = g² (2 + x)²/(x + 2g)², Tustin's rule of a low-pass filter with both poles at the bandwidth, and D = x/((1 + x) T_s):

    (C + Q J D²)/(1 − Q z^−n) = N(x) (1 + x)^(n−2) / (x H(x))
    N = kp (1 + x)² (x + 2g)² + kd/T_s x (1 + x) (x + 2g)² + J/T_s² g² x² (2 + x)²
    H = ((1 + x)ⁿ − 1)/x (x + 2g)² + (1 − g)((1 + g) x + 4g)

The pole at x = 0 is exact: the observer is an integrator. N and H have no negative coefficients, so none is a difference.
"""

import math
from functools import lru_cache

import numpy as np

from ..errors import GainroomError
from .linear.arrays import Complexes, Floats
from .linear.transfer_function import Factored, polynomial_roots

MOST_TICKS = 1000
"""Most ticks of delay that an observer holds, as a sampled loop."""
POLISHED, NEARBY = 6, 1e-3  # steps of Newton on a root, and the largest that counts, relative to the root
SMALL = 0.1  # size of zⁿ below which it is told from 0 rather than from 1


@lru_cache(256)
def observed_disturbance(kp: float, kd: float, inertia: float, bandwidth: float, ticks: int, sample_time: float) -> Factored:
    """Transfer function (C + Q J D²)/(1 − Q z^−ticks), gains in SI. Raises GainroomError for a bandwidth beyond half the sample rate."""
    half = bandwidth * sample_time / 2
    if half >= math.pi / 2:
        raise GainroomError(
            f"DisturbanceObserver: bandwidth {bandwidth:g} rad/s must be below half the sample rate, {math.pi / sample_time:g} rad/s"
        )
    tangent = math.tan(half)
    g = tangent / (1 + tangent)
    lag, late = np.array([1.0, 2 * g]), np.array([1.0, 1.0])
    square = np.polymul(lag, lag)
    numerator = kp * np.polymul(np.polymul(late, late), square)
    numerator = np.polyadd(numerator, kd / sample_time * np.polymul(np.polymul([1.0, 0.0], late), square))
    numerator = np.polyadd(numerator, inertia / sample_time**2 * g**2 * np.polymul([1.0, 0.0, 0.0], [1.0, 4.0, 4.0]))
    zeros, gain = polynomial_roots(numerator), float(numerator[np.flatnonzero(numerator)[0]]) if np.any(numerator) else 0.0
    if not gain:
        return Factored(np.zeros(0, dtype=complex), np.zeros(0, dtype=complex), 0.0, 0.0, sample_time)
    poles = np.append(_poles(g, ticks), 0.0)
    whole = np.full(abs(ticks - 2), -1.0 + 0j)
    zeros, poles = (np.append(zeros, whole), poles) if ticks > 2 else (zeros, np.append(poles, whole))
    leading = 1.0 if ticks else 1 - g**2  # of H, and gain of N's largest power; N falls short of it by none
    # in x the law is gain/leading · Π(x − zeros)/Π(x − poles); δ = x/T_s
    scale = sample_time ** (len(zeros) - len(poles))
    return Factored(zeros / sample_time, poles / sample_time, gain / leading * scale, 0.0, sample_time)


def _poles(g: float, ticks: int) -> Complexes:
    """Roots of H in x."""
    # ((1 + x)ⁿ − 1)/x, highest power first; of a long delay, roots of its companion matrix and those of z agree to what Newton needs
    chain = np.array([float(math.comb(ticks, k)) for k in range(ticks, 0, -1)])
    square = np.array([1.0, 4 * g, 4 * g * g])
    rest = (1 - g) * np.array([1 + g, 4 * g])
    if ticks <= 12:
        roots = polynomial_roots(np.polyadd(np.polymul(chain, square) if ticks else np.zeros(1), rest))
    else:
        roots = _roots_in_z(g, ticks)
    return _polished(roots, g, ticks)


def _roots_in_z(g: float, ticks: int) -> Complexes:
    """Roots in x of a long delay, from the polynomial in z: (z − p)² zⁿ − g² (z + 1)² without its root 1."""
    p = 1 - 2 * g
    inner: Floats = np.zeros(ticks + 3)
    inner[:3] = 1.0, -2 * p, p * p
    inner[-3:] -= g * g * np.array([1.0, 2.0, 1.0])
    quotient = np.cumsum(inner)[:-1]  # synthetic division by z − 1
    return polynomial_roots(quotient) - 1


def _polished(roots: Complexes, g: float, ticks: int) -> Complexes:
    """`roots` of H by Newton on a form of x H that has no difference of near numbers there: near z = 1, and where zⁿ is small."""
    upper = roots[roots.imag >= 0].astype(complex)
    for _ in range(POLISHED):
        late = (1 + upper) ** ticks  # zⁿ
        grown = np.where(np.abs(late) < SMALL, late - 1, np.expm1(ticks * np.log1p(upper)))
        lag = upper + 2 * g
        near = grown * lag**2 + upper * (1 - g) * ((1 + g) * upper + 4 * g)
        far = late * lag**2 - g**2 * (2 + upper) ** 2
        value = np.where(np.abs(late) < SMALL, far, near)
        slope = ticks * late / (1 + upper) * lag**2 + 2 * late * lag - 2 * g**2 * (2 + upper)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = value / slope
        upper = np.where(np.abs(step) < NEARBY * np.abs(upper), upper - step, upper)
    upper = np.where(np.abs(upper.imag) <= 1e-14 * np.abs(upper), upper.real, upper).astype(complex)
    pairs = upper[upper.imag > 0]
    return np.concatenate([upper[upper.imag == 0], pairs, pairs.conj()])
