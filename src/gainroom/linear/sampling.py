"""Exact sampling of a scalar transfer function behind a zero-order hold and a fraction of a tick of delay.

With G(s) = Σ r_i/(s − p_i), a torque that is u_{k−1} for the first f T_s of a tick and u_k for the rest gives

    G(z) = Σ r_i (b_i z + c_i) / (z (z − E_i)),
    E_i = e^{p_i T_s},  b_i = (e^{p_i (1−f) T_s} − 1)/p_i,  c_i = (E_i − e^{p_i (1−f) T_s})/p_i.

The numerator is a small difference of large terms (a plant that falls off as 1/s⁵ loses 15 digits at 2 kHz), so it is formed in extended
precision; its zeros are then good to the last digit of a double.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import GainroomError
from .arrays import Complexes
from .transfer_function import Factored

DIGITS = 90
APART = 22  # coinciding poles (the two integrators among them) are moved apart by 1e-22/T_s: far below a double, far above DIGITS
FARTHEST = 1e-20  # a zero at |z| beyond 1/FARTHEST changes no digit of the response: its factor is a constant
FASTEST = 50.0  # growth rate of a pole times the tick: e^50 exceeds what a double resolves, let alone what a controller can hold


def sample(system: Factored, sample_time: float, fraction: float = 0.0) -> Factored:
    """`system` (continuous, strictly proper, its delay left aside) sampled at T_s [s] with `fraction` in [0, 1) of a tick of delay.

    Cached: the same joint is studied with many gains. Raises GainroomError where it topples within a small part of a tick.
    """
    rate = float(np.max(system.poles.real, initial=0.0))
    if rate * sample_time > FASTEST:
        raise GainroomError(f"loop: grows by itself at {rate:.3g}/s, too fast to be sampled every {1e3 * sample_time:g} ms")
    zeros, poles = (tuple(np.asarray(roots, dtype=complex).tolist()) for roots in (system.zeros, system.poles))
    return _sampled(zeros, poles, float(system.gain), float(sample_time), fraction)


Roots = tuple[complex, ...]


@lru_cache(64)
def _partial_fractions(zeros: Roots, poles: Roots, gain: float, sample_time: float) -> list[tuple[Any, Any, Any, list]]:
    """For each p_i that is not a conjugate: p_i, E_i, r_i and Π_{j≠i} (z − E_j), highest power first; the same at every delay."""
    from mpmath import mp, mpf

    with mp.workdps(DIGITS):
        step = mpf(sample_time)
        places: list = []
        for pole in poles:
            place = mp.mpmathify(pole)
            while any(abs(place - other) * step < mpf(10) ** -APART for other in places):
                place += mpf(10) ** -APART / step
            places.append(place)
        grown = [mp.exp(place * step) for place in places]
        everything = [mpf(1)]
        for factor in grown:
            everything = _times(everything, [1, -factor])
        found = []
        for k, place in enumerate(places):
            if place.imag < 0:
                continue
            residue = mpf(gain)
            for zero in zeros:
                residue *= place - mp.mpmathify(zero)
            for j, other in enumerate(places):
                if j != k:
                    residue /= place - other
            found.append((place, grown[k], residue, _without(everything, grown[k])))
        return found


@lru_cache(256)
def _sampled(zeros: Roots, poles: Roots, gain: float, sample_time: float, fraction: float) -> Factored:
    from mpmath import mp, mpf

    with mp.workdps(DIGITS):
        step, late = mpf(sample_time), mpf(fraction)
        numerator = [mpf(0)] * (len(poles) + (1 if fraction else 0))
        for pole, grown, residue, others in _partial_fractions(zeros, poles, gain, sample_time):
            partial = mp.exp(pole * (1 - late) * step) if fraction else grown
            now = (partial - 1) / pole if pole else step * (1 - late)
            before = (grown - partial) / pole if pole else step * late
            row = _times(others, [residue * now, residue * before] if fraction else [residue * now])
            # a conjugate's row adds the same real part once more
            share = 2 if pole.imag > 0 else 1
            numerator = [total + share * entry.real for total, entry in zip(numerator, row, strict=True)]
        while len(numerator) > 1 and abs(numerator[0]) < FARTHEST * abs(numerator[1]):
            del numerator[0]  # a delay just under a whole tick has a zero next to infinity
        roots = _roots(numerator)
        size = numerator[0] * step ** (len(roots) - len(poles) - (1 if fraction else 0))
        places = [(root - 1) / step for root in roots]
        zeros_v = np.array([float(place.real) for place in places]) + 1j * np.array([float(place.imag) for place in places])
        poles_v = np.expm1(np.array(poles, dtype=complex) * sample_time) / sample_time
        if fraction:
            poles_v = np.append(poles_v, -1 / sample_time)
        return Factored(_conjugate(zeros_v), poles_v, float(size), 0.0, sample_time)


def _times(first: list, second: list) -> list:
    """Product of two polynomials, highest power first."""
    product = [0] * (len(first) + len(second) - 1)
    for i, left in enumerate(first):
        for j, right in enumerate(second):
            product[i + j] += left * right
    return product


def _without(polynomial: list, root) -> list:
    """`polynomial` divided by (z − root), one of its roots."""
    quotient = polynomial[:1]
    for coefficient in polynomial[1:-1]:
        quotient.append(coefficient + root * quotient[-1])
    return quotient


def _roots(polynomial: list) -> list:
    """Roots of a real polynomial: found in double precision, polished by Newton in extended precision.

    Aberth's form of Newton's step separates roots that lie close together.
    """
    from mpmath import mpc, mpf, polyroots

    starts = _starts(polynomial)
    gaps = np.abs(starts[:, None] - starts[None, :]) + np.where(np.eye(len(starts)), np.inf, 0.0)
    crowded = np.min(gaps, axis=1, initial=np.inf) < 1e-2 * np.abs(starts)
    # A real root stays real and a pair stays a pair, so neither needs all of complex arithmetic.
    roots = [mpc(root.real, root.imag) if root.imag else mpf(root.real) for root in starts.tolist()]
    partner = {k: int(np.argmin(np.abs(starts - root.conj()))) for k, root in enumerate(starts) if root.imag > 0}
    for _ in range(60):
        largest = mpf(0)
        for k, root in enumerate(roots):
            if starts[k].imag < 0:
                continue
            value, slope = polynomial[0], mpf(0)
            for coefficient in polynomial[1:]:
                slope = slope * root + value
                value = value * root + coefficient
            if value == 0:
                continue
            push = slope / value
            if crowded[k]:
                push -= sum(1 / (root - other) for j, other in enumerate(roots) if j != k and root != other)
            move = 1 / push if push else mpf(10) ** -8 * (abs(root) + 1)  # a standstill between equal starts: step aside
            roots[k] = root - move
            if k in partner:
                roots[partner[k]] = mpc(roots[k].real, -roots[k].imag)
            largest = max(largest, abs(move) / (abs(root) + mpf(10) ** -30))
        if largest < mpf(10) ** -15:  # the next step would be of the order of its square
            break
    if _are_all(roots, polynomial):
        return roots
    # starts too near each other: from scratch, a hundred times slower
    return polyroots(polynomial[::-1], maxsteps=500, extraprec=600, asc=True)


def _starts(polynomial: list) -> Complexes:
    """Roots in double precision; one far beyond all others, which would cost those their digits, is divided out first."""
    far: list[complex] = []
    sizes = [abs(value) for value in polynomial]
    if len(sizes) > 2 and sizes[1] * sizes[1] > 100 * sizes[0] * (sizes[1] + max(sizes[2:])):  # beyond 100 of Cauchy's bound of the rest
        root = -polynomial[1] / polynomial[0]
        for _ in range(6):
            value, slope = polynomial[0], 0
            for coefficient in polynomial[1:]:
                slope = slope * root + value
                value = value * root + coefficient
            root -= value / slope
        far, polynomial = [complex(root)], _without(polynomial, root)
    return np.append(np.array(far, dtype=complex), np.roots([float(value / polynomial[0]) for value in polynomial]))


def _are_all(roots: list, polynomial: list) -> bool:
    """Whether `roots` are those of `polynomial`, each as often as it is one."""
    from mpmath import mp, mpf

    product = [polynomial[0]]
    for root in roots:
        product = _times(product, [1, -root])
    return all(abs(here - there) <= mpf(10) ** -25 * mp.fsum(map(abs, polynomial)) for here, there in zip(product, polynomial, strict=True))


def _conjugate(roots: Complexes) -> Complexes:
    """`roots` made exactly closed under conjugation."""
    real = np.abs(roots.imag) <= 1e-14 * np.abs(roots)
    upper = roots[(roots.imag > 0) & ~real]
    return np.concatenate([roots[real].real.astype(complex), upper, upper.conj()])
