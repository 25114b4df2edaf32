"""Unstable roots of F(s) = Dn(s) + N(s) e^{-sT}, one joint under PD with an exact delay.

`count_unstable` follows Walton and Marshall (IEE Proc. D 134, 1987): at T = 0 the roots are those of a polynomial,
counted by Routh in exact fractions; a root can reach the imaginary axis only at the finitely many ω > 0 with
|Dn(jω)| = |N(jω)|, there it crosses to the right if |Dn|² − |N|² rises with ω and to the left if it falls,
whatever the delay, so the count at T is the count at 0 plus what has crossed. Nothing is sampled.
`count_unstable_mikhailov` and `roots_in_box` are second opinions by the argument principle.
"""

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise, zip_longest

import mpmath
import numpy as np

from .joint import PDJoint, add, multiply, polynomials

DIGITS = 40  # of the crossing frequencies and angles
RESOLUTION = 1e-20  # [rad] a crossing nearer than this to the asked delay is not decided; rounding is near 1e-35


class UndecidedError(ArithmeticError):
    """The loop is on its stability boundary as nearly as this check can tell."""


def count_unstable(joint: PDJoint) -> int:
    """Number of closed-loop roots with Re s > 0, multiplicity included. Raises UndecidedError on the boundary."""
    denominator, plant_numerator, controller = polynomials(joint, Fraction)
    return count_unstable_zeros(denominator, multiply(plant_numerator, controller), joint.delay)


def count_unstable_with(joint: PDJoint, controller_numerator: list[float], controller_denominator: list[float]) -> int:
    """The same with another controller D(s) in place of kp + kd s: ascending coefficients."""
    denominator, numerator, _ = polynomials(joint, Fraction)
    denominator = multiply(denominator, [Fraction(c) for c in controller_denominator])
    return count_unstable_zeros(denominator, multiply(numerator, [Fraction(c) for c in controller_numerator]), joint.delay)


def count_unstable_zeros(denominator: list[Fraction], numerator: list[Fraction], delay: float) -> int:
    """Zeros of denominator(s) + numerator(s) e^{-s delay} with Re s > 0; ascending coefficients, retarded type."""
    count = _routh_count(add(denominator, numerator))
    if delay == 0:
        return count
    with mpmath.workdps(DIGITS):
        for omega, direction in _axis_crossings(denominator, numerator):
            s = mpmath.mpc(0, omega)
            angle = mpmath.arg(-_value(numerator, s) / _value(denominator, s)) % (2 * mpmath.pi)
            turns = (omega * mpmath.mpf(delay) - angle) / (2 * mpmath.pi)
            if abs(turns - mpmath.nint(turns)) < RESOLUTION:
                raise UndecidedError(f"a root lies on the imaginary axis at {float(omega)} rad/s")
            count += 2 * direction * max(0, int(mpmath.floor(turns)) + 1)
    return count


def _routh_count(ascending: list[Fraction]) -> int:
    """Sign changes in the first column of the Routh array, in exact arithmetic; from the roots where it degenerates."""
    descending = list(reversed(ascending))
    while descending[0] == 0:
        descending.pop(0)
    upper, lower = descending[0::2], descending[1::2]
    first_column = [upper[0]]
    while lower:
        if lower[0] == 0:
            return _root_count(descending)
        first_column.append(lower[0])
        quotient = upper[0] / lower[0]
        below = [a - quotient * b for a, b in zip_longest(upper[1:], lower[1:], fillvalue=Fraction(0))]
        upper, lower = lower, below
    return sum(a * b < 0 for a, b in pairwise(first_column))


def _root_count(descending: list[Fraction]) -> int:
    """Roots of a polynomial to the right of the imaginary axis, found in extended precision."""
    with mpmath.workdps(DIGITS):
        scale = _frequency_scale(descending[::-1])
        ascending = [_mpf(c * scale**i) for i, c in enumerate(reversed(descending))]
        roots = _roots(ascending, 400)
        if any(abs(r.real) < mpmath.mpf(10) ** (-DIGITS // 2) * abs(r) for r in roots):
            raise UndecidedError("a root lies on the imaginary axis at zero delay")
        return sum(r.real > 0 for r in roots)


def _axis_crossings(denominator: list[Fraction], numerator: list[Fraction]) -> list[tuple[mpmath.mpf, int]]:
    """(ω > 0, direction ±1) where |Dn(jω)|² − |N(jω)|² = 0, a polynomial in x = ω²."""
    difference = add(_squared_modulus(denominator), [-c for c in _squared_modulus(numerator)])
    while difference[-1] == 0:
        difference.pop()
    scale = _frequency_scale(difference)
    coefficients = [_mpf(c * scale**i) for i, c in enumerate(difference)]
    largest = max(abs(c) for c in coefficients)
    roots = _roots([c / largest for c in coefficients], 200)
    crossings = []
    for x in roots:
        if x.real <= 0 or abs(x.imag) > mpmath.mpf(10) ** (-DIGITS // 2) * abs(x):
            continue
        slope = sum(i * c * x.real ** (i - 1) for i, c in enumerate(coefficients) if i)
        crossings.append((mpmath.sqrt(x.real * scale), 1 if slope > 0 else -1))
    return crossings


def _roots(ascending: list[mpmath.mpf], extraprec: int) -> list[mpmath.mpc]:
    """All roots in extended precision, begun at those of double precision where that leads to all of them: three times faster."""
    options = {"maxsteps": 500, "extraprec": extraprec, "asc": True}
    starts = np.roots([float(c) for c in reversed(ascending)])
    if len(starts) == len(ascending) - 1 and np.all(np.isfinite(starts)):
        # apart from each other and from the real axis, on which a pair that belongs beside it would be stuck
        apart = [mpmath.mpc(root) * mpmath.mpc(1, 1e-7 * (1 + k)) for k, root in enumerate(starts.tolist())]
        try:
            roots = mpmath.polyroots(ascending, roots_init=apart, **{**options, "maxsteps": 50})
        except mpmath.NoConvergence:
            return mpmath.polyroots(ascending, **options)
        product = [ascending[-1]]  # of all factors: none was found twice for another
        for root in roots:
            product = [below - root * above for below, above in zip([0, *product], [*product, 0], strict=True)]
        if all(abs(a - b) <= mpmath.mpf(10) ** (5 - DIGITS) * max(map(abs, ascending)) for a, b in zip(product, ascending, strict=True)):
            return roots
    return mpmath.polyroots(ascending, **options)


def _squared_modulus(polynomial: list[Fraction]) -> list[Fraction]:
    """|p(jω)|² as a polynomial in ω²: p(s) p(−s) with s² = −ω²."""
    mirrored = [c if i % 2 == 0 else -c for i, c in enumerate(polynomial)]
    return [c if i % 2 == 0 else -c for i, c in enumerate(multiply(polynomial, mirrored)[0::2])]


def _frequency_scale(polynomial: list[Fraction]) -> Fraction:
    """A power of two near the geometric mean of the roots, so that coefficients stay near one."""
    lowest = next(i for i, c in enumerate(polynomial) if c != 0)
    span = len(polynomial) - 1 - lowest
    ratio = abs(polynomial[lowest] / polynomial[-1])
    return Fraction(2) ** round(float(mpmath.log(_mpf(ratio), 2)) / max(span, 1))


def _mpf(value: Fraction) -> mpmath.mpf:
    return mpmath.mpf(value.numerator) / value.denominator


def _value(polynomial: list[Fraction], s: mpmath.mpc) -> mpmath.mpc:
    return mpmath.polyval([_mpf(c) for c in polynomial], s, asc=True)


def characteristic(joint: PDJoint) -> Callable[[np.ndarray], np.ndarray]:
    """F(s) in double precision, vectorised."""
    denominator, plant_numerator, controller = polynomials(joint)
    numerator = multiply(plant_numerator, controller)

    def value(s: np.ndarray) -> np.ndarray:
        return np.polyval(denominator[::-1], s) + np.polyval(numerator[::-1], s) * np.exp(-s * joint.delay)

    return value


def count_unstable_mikhailov(joint: PDJoint) -> int:
    """The same count from the turning of F(jω): Δarg = (n/2 − unstable) π for a retarded F of degree n."""
    denominator, plant_numerator, controller = polynomials(joint)
    numerator = multiply(plant_numerator, controller)
    degree = max(i for i, c in enumerate(denominator) if c != 0)
    poles = np.abs(np.roots(denominator[::-1]))
    fast = 10 * max(poles.max(), 1.0)
    while abs(np.polyval(numerator[::-1], 1j * fast)) > 0.1 * abs(np.polyval(denominator[::-1], 1j * fast)):
        fast *= 2
    omega = np.concatenate([[0.0], np.geomspace(1e-9 * fast, 1e4 * fast, 4000)])
    if joint.delay:
        omega = np.unique(np.concatenate([omega, np.arange(0, fast, 0.3 / joint.delay)]))
    turn = _turning(characteristic(joint), 1j * omega)
    return round((degree - 2 * turn / np.pi) / 2)


def _turning(function: Callable[[np.ndarray], np.ndarray], path: np.ndarray) -> float:
    """Change of argument along a path of points, halving steps until each turns by less than 0.5 rad [rad]."""
    values = function(path)
    total = 0.0
    start, end, at_start, at_end = path[:-1], path[1:], values[:-1], values[1:]
    for _ in range(60):
        angle = np.angle(at_end / at_start)
        middle = (start + end) / 2
        at_middle = function(middle)
        smooth = np.abs(angle) < 0.5
        smooth &= np.abs(np.angle(at_middle / at_start)) < 0.5
        total += angle[smooth].sum()
        coarse = ~smooth
        if not coarse.any():
            return total
        start, end = np.concatenate([start[coarse], middle[coarse]]), np.concatenate([middle[coarse], end[coarse]])
        at_start, at_end = (
            np.concatenate([at_start[coarse], at_middle[coarse]]),
            np.concatenate([at_middle[coarse], at_end[coarse]]),
        )
    raise UndecidedError("the path passes through a root")


def roots_in_box(function: Callable[[np.ndarray], np.ndarray], low: complex, high: complex) -> np.ndarray:
    """All zeros of an entire function inside a rectangle, by halving it along its longer side and counting windings.

    Sorted by falling real part. No zero may lie on the lines of division (shift the box if it does).
    """
    corners = np.array([low, complex(high.real, low.imag), high, complex(low.real, high.imag), low])
    edges = [np.linspace(a, b, 200) for a, b in pairwise(corners)]
    count = round(sum(_turning(function, edge) for edge in edges) / (2 * np.pi))
    if count == 0:
        return np.array([], dtype=complex)
    width, height = high.real - low.real, high.imag - low.imag
    if count == 1:
        root = _secant(function, (low + high) / 2, 1e-3 * complex(width, height))
        if low.real < root.real < high.real and low.imag < root.imag < high.imag:
            return np.array([root])
    share = 0.4871  # off the middle, so that no symmetry of the roots meets a line of division
    if width >= height:
        cut = low.real + share * width
        halves = (low, complex(cut, high.imag)), (complex(cut, low.imag), high)
    else:
        cut = low.imag + share * height
        halves = (low, complex(high.real, cut)), (complex(low.real, cut), high)
    found = np.concatenate([roots_in_box(function, *half) for half in halves])
    return found[np.argsort(-found.real)]


def _secant(function: Callable[[np.ndarray], np.ndarray], guess: complex, step: complex) -> complex:
    a, b = guess, guess + step
    at_a, at_b = complex(function(np.asarray(a))), complex(function(np.asarray(b)))
    for _ in range(60):
        if at_b == at_a:
            break
        a, b, at_a = b, b - at_b * (b - a) / (at_b - at_a), at_b
        at_b = complex(function(np.asarray(b)))
        if abs(b - a) < 1e-15 * abs(b):
            break
    return b
