"""Controllers other than PD as ratios of polynomials, in s or in z (ascending coefficients).

Sampled: backward difference, backward Euler integral; filters and notches by Tustin's rule, exact at their own
frequency.
"""

from math import tan

import numpy as np
from numpy.polynomial.polynomial import polyadd, polymul

Ratio = tuple[np.ndarray, np.ndarray]


def derivative(sample_time: float | None) -> Ratio:
    """s, or (z − 1)/(T_s z)."""
    if sample_time is None:
        return np.array([0.0, 1.0]), np.ones(1)
    return np.array([-1.0, 1.0]), np.array([0.0, sample_time])


def integral(sample_time: float | None) -> Ratio:
    """1/s, or T_s z/(z − 1)."""
    above, below = derivative(sample_time)
    return below, above


def gain(value: float) -> Ratio:
    return np.array([value]), np.ones(1)


def times(*factors: Ratio) -> Ratio:
    above, below = np.ones(1), np.ones(1)
    for num, den in factors:
        above, below = polymul(above, num), polymul(below, den)
    return above, below


def plus(first: Ratio, *others: Ratio) -> Ratio:
    """The sum, over one denominator if they share it."""
    above, below = first
    for num, den in others:
        if len(den) == len(below) and np.array_equal(den, below):
            above = polyadd(above, num)
        else:
            above, below = polyadd(polymul(above, den), polymul(num, below)), polymul(below, den)
    return above, below


def mapped(analog: Ratio, frequency: float, sample_time: float | None) -> Ratio:
    """Tustin's rule, s → ω/tan(ωT_s/2) · (z − 1)/(z + 1); the analog one in continuous time."""
    if sample_time is None:
        return analog
    rate = frequency / tan(frequency * sample_time / 2)
    degree = max(len(p) for p in analog) - 1

    def substitute(polynomial: np.ndarray) -> np.ndarray:
        total = np.zeros(1)
        for power, coefficient in enumerate(polynomial):
            term = np.array([coefficient * rate**power])
            for k in range(degree):
                term = polymul(term, [-1.0, 1.0] if k < power else [1.0, 1.0])
            total = polyadd(total, term)
        return total

    return substitute(analog[0]), substitute(analog[1])


def low_pass(bandwidth: float, order: int, damping_ratio: float) -> Ratio:
    """ω/(s + ω), or ω²/(s² + 2ζω s + ω²)."""
    if order == 1:
        return np.array([bandwidth]), np.array([bandwidth, 1.0])
    return np.array([bandwidth**2]), np.array([bandwidth**2, 2 * damping_ratio * bandwidth, 1.0])


def notch(frequency: float, width: float, depth: float) -> Ratio:
    """(s² + depth·width·ω s + ω²)/(s² + width·ω s + ω²)."""
    spread = width * frequency
    return np.array([frequency**2, depth * spread, 1.0]), np.array([frequency**2, spread, 1.0])


def response(controller: Ratio, omega: np.ndarray, sample_time: float | None) -> np.ndarray:
    """D(jω) or D(e^{jωT_s})."""
    variable = 1j * omega if sample_time is None else np.exp(1j * omega * sample_time)
    above, below = (np.polynomial.polynomial.polyval(variable, p) for p in controller)
    return above / below
