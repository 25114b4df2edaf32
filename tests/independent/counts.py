"""Unstable roots of one joint's closed loop under any controller, with any delay and any phase added, continuous or sampled.

The characteristic function is Dn(s) + N(s) e^{−sT − jφ}, or in z Dn + N z^{−m} e^{−jφ} for m whole ticks. Roots meet the stability boundary
only where |Dn| = |N|, at the zeros of one real polynomial (in ω², or in 4 sin²(ωT_s/2)), all of which are found; there they
cross outwards where |Dn/N| rises with ω and inwards where it falls, whatever T, m and φ are. So the count follows
from that at T = 0 or m = 0, and from how often ωT ± φ has passed arg(−N/Dn) (Walton and Marshall, IEE Proc. D 134, 1987; for
z with the turns at z = −1, where delays make poles of their own). Everything in DIGITS digits; nothing is sampled over frequency.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, zip_longest

import mpmath
import numpy as np

from . import sampled
from .delay_roots import UndecidedError
from .joint import PDJoint, add, multiply, polynomials

DIGITS = 100  # sampling 0.5 Hz every 0.1 ms leaves differences of 1e-43 of the terms; 50 more are for the verdict
SAME = mpmath.mpf(10) ** -30  # nearer than this to the boundary nothing is decided


@dataclass(frozen=True)
class Controlled:
    """`joint` (its kp and kd aside) under D = N Σ g V^a I^b, for `terms` ((a, b), g): V the filtered rate, I the integral, N the notches.

    low_pass: (bandwidth, order, damping ratio); notches: (frequency, width, depth); sample_time None: continuous.
    """

    joint: PDJoint
    terms: tuple[tuple[tuple[int, int], float], ...]
    low_pass: tuple[float, int, float] | None = None
    notches: tuple[tuple[float, float, float], ...] = ()
    sample_time: float | None = None

    def scaled(self, factor: float) -> "Controlled":
        return replace(self, terms=tuple((powers, gain * factor) for powers, gain in self.terms))

    def later(self, delay: float) -> "Controlled":
        return replace(self, joint=replace(self.joint, delay=self.joint.delay + delay))


def controller(loop: Controlled) -> tuple[list, list]:
    """D as (numerator, denominator), ascending mpf coefficients in s or z."""
    step = None if loop.sample_time is None else mpmath.mpf(loop.sample_time)
    rate = ([mpmath.mpf(0), mpmath.mpf(1)], [mpmath.mpf(1)]) if step is None else ([mpmath.mpf(-1), mpmath.mpf(1)], [mpmath.mpf(0), step])
    integral = rate[1], rate[0]
    if loop.low_pass:
        bandwidth, order, damping = loop.low_pass
        w = mpmath.mpf(bandwidth)
        analog = ([w], [w, 1]) if order == 1 else ([w * w], [w * w, 2 * mpmath.mpf(damping) * w, 1])
        rate = _times(rate, _mapped(analog, w, step))
    most = [max(powers[k] for powers, _ in loop.terms) for k in (0, 1)]
    above = [mpmath.mpf(0)]
    for powers, gain in loop.terms:
        part = [mpmath.mpf(gain)]
        for power, highest, (num, den) in zip(powers, most, (rate, integral), strict=True):
            if highest:
                part = multiply(part, num if power else den)
        above = add(above, part)
    below = [mpmath.mpf(1)]
    for highest, (_, den) in zip(most, (rate, integral), strict=True):
        if highest:
            below = multiply(below, den)
    both = above, below
    for frequency, width, depth in loop.notches:
        w = mpmath.mpf(frequency)
        spread = mpmath.mpf(width) * w
        both = _times(both, _mapped(([w * w, mpmath.mpf(depth) * spread, 1], [w * w, spread, 1]), w, step))
    return both


def _times(first: tuple[list, list], second: tuple[list, list]) -> tuple[list, list]:
    return multiply(first[0], second[0]), multiply(first[1], second[1])


def _mapped(analog: tuple[list, list], frequency, step) -> tuple[list, list]:
    """Tustin's rule with `frequency` kept."""
    if step is None:
        return analog
    rate, degree = frequency / mpmath.tan(frequency * step / 2), len(analog[1]) - 1
    mapped = []
    for polynomial in analog:
        total = [mpmath.mpf(0)]
        for power, coefficient in enumerate(polynomial):
            term = [coefficient * rate**power]
            for k in range(degree):
                term = multiply(term, [-1, 1] if k < power else [1, 1])
            total = add(total, term)
        mapped.append(total)
    return mapped[0], mapped[1]


@dataclass(frozen=True)
class Boundary:
    """Where roots of Dn + N e^{−sT} can cross, and how many are unstable before any delay."""

    loop: Controlled
    below: list = field(repr=False)
    above: list = field(repr=False)
    ticks: int

    @classmethod
    def of(cls, loop: Controlled) -> "Boundary":
        with mpmath.workdps(DIGITS):
            above, below = controller(loop)
            if loop.sample_time is None:
                plant, numerator, _ = polynomials(replace(loop.joint, kp=0.0, kd=0.0), mpmath.mpf)
                return cls(loop, multiply(plant, below), multiply(numerator, above), 0)
            ticks, _ = sampled.delay_ticks(loop.joint, loop.sample_time)
            plant, older, newer = sampled._sampled_plant(replace(loop.joint, kp=0.0, kd=0.0), loop.sample_time)
            zero = mpmath.mpf(0)
            held = add([*older], [zero, *newer])
            return cls(loop, multiply([zero, *plant], below), multiply(held, above), ticks)

    def count(self, delay: float = 0.0, phase: float = 0.0) -> int:
        """Unstable roots with `delay` more (continuous; of sampled loops see Controlled.later) and a constant lag `phase` [rad]."""
        with mpmath.workdps(DIGITS):
            step = self.loop.sample_time
            total = self.ticks if step is not None else mpmath.mpf(self.loop.joint.delay) + mpmath.mpf(delay)
            unstable = self._at_rest + (self.ticks if step is not None and self._turns_at_the_end else 0)
            if total == 0 and phase == 0:
                return unstable
            for omega, direction, angle in self._crossings:
                for lag in (omega * total + mpmath.mpf(phase), omega * total - mpmath.mpf(phase)):
                    turns = (lag - angle) / (2 * mpmath.pi)
                    if abs(turns - mpmath.nint(turns)) < SAME:
                        raise UndecidedError("a root lies on the boundary")
                    unstable += direction * (int(mpmath.floor(turns)) + 1)
            return unstable

    @cached_property
    def _at_rest(self) -> int:
        """Unstable roots of Dn + N."""
        together = add(self.below, self.above)
        return _routh(together) if self.loop.sample_time is None else _outside(together)

    @cached_property
    def _turns_at_the_end(self) -> bool:
        """Whether |N| > |Dn| at z = −1."""
        below, above = (abs(mpmath.polyval(p, mpmath.mpf(-1), asc=True)) for p in (self.below, self.above))
        return above > below

    @cached_property
    def _crossings(self) -> list:
        """(ω or θ, direction, arg(−N/Dn) in [0, 2π)) of every |Dn| = |N|."""
        square = _squared_in_s if self.loop.sample_time is None else _squared_in_z
        difference = add(square(self.below), [-c for c in square(self.above)])
        highest = mpmath.inf if self.loop.sample_time is None else mpmath.mpf(4)
        while difference[-1] == 0 or abs(difference[-1] * highest) < SAME**2 * abs(difference[-2]):
            difference.pop()  # a root far beyond 4, from zeros next to z = 0 and to infinity
        found = []
        for x in _positive_roots(difference, highest):
            sampled_too = self.loop.sample_time is not None
            omega = 2 * mpmath.asin(mpmath.sqrt(x) / 2) if sampled_too else mpmath.sqrt(x)
            point = mpmath.expj(omega) if sampled_too else mpmath.mpc(0, omega)
            slope = mpmath.polyval([k * c for k, c in enumerate(difference)][1:], x, asc=True)
            values = [mpmath.polyval(p, point, asc=True) for p in (self.above, self.below)]
            found.append((omega, 1 if slope > 0 else -1, mpmath.arg(-values[0] / values[1]) % (2 * mpmath.pi)))
        return found


def _squared_in_s(polynomial: list) -> list:
    """|p(jω)|² in powers of ω²."""
    mirrored = [-c if k % 2 else c for k, c in enumerate(polynomial)]
    return [-c if k % 2 else c for k, c in enumerate(multiply(polynomial, mirrored)[0::2])]


def _squared_in_z(polynomial: list) -> list:
    """|p(e^{jθ})|² in powers of y = 2 − 2 cos θ: z^k + z^{−k} is a polynomial in y."""
    size = len(polynomial)
    zero = mpmath.mpf(0)
    before, now = [mpmath.mpf(2)], [mpmath.mpf(2), mpmath.mpf(-1)]
    total = [sum(c * c for c in polynomial)]
    for k in range(1, size):
        weight = sum(polynomial[i] * polynomial[i + k] for i in range(size - k))
        total = add(total, [weight * c for c in now])
        before, now = now, add(multiply(now, [mpmath.mpf(2), mpmath.mpf(-1)]), [-c for c in before] or [zero])
    return total


def _positive_roots(polynomial: list, highest) -> list:
    """Every root in (0, highest) of a real polynomial (ascending): told apart by Sturm's theorem, then polished by Newton's method."""
    kept = polynomial[next(k for k, c in enumerate(polynomial) if c != 0) :]
    if len(kept) < 2:
        return []
    scale = abs(kept[0] / kept[-1]) ** (mpmath.mpf(1) / (len(kept) - 1))
    kept = [c * scale**k for k, c in enumerate(kept)]
    chain = _sturm(kept)

    def changes(x) -> int:
        signs = [s for p in chain if (s := mpmath.sign(mpmath.polyval(p, x, asc=True)))]
        return sum(a != b for a, b in pairwise(signs))

    largest = max(abs(c) for c in kept)
    low, high = abs(kept[0]) / (2 * largest), min(2 * largest / abs(kept[-1]), highest / scale)  # Cauchy's bounds
    guesses = np.roots([float(c) for c in reversed(kept)])
    waiting, roots = [(low, high, changes(low), changes(high))], []
    while waiting:
        low, high, before, after = waiting.pop()
        if before == after:
            continue
        if before - after == 1:
            near = [float(g.real) for g in guesses if low < g.real < high and abs(g.imag) < 1e-3 * abs(g)]
            root = _stepped(kept, mpmath.mpf(near[0])) if len(near) == 1 else None
            roots.append((root or _polished(kept, low, high)) * scale)
            continue
        middle = mpmath.sqrt(low * high)
        if high / low - 1 < SAME:
            raise UndecidedError("a double root")
        inside = changes(middle)
        waiting += [(low, middle, before, inside), (middle, high, inside, after)]
    return roots


def _sturm(polynomial: list) -> list[list]:
    chain = [polynomial, [k * c for k, c in enumerate(polynomial)][1:]]
    while len(chain[-1]) > 1:
        rest, divisor = list(chain[-2]), chain[-1]
        while len(rest) >= len(divisor):
            factor, shift = rest[-1] / divisor[-1], len(rest) - len(divisor)
            rest = [c - factor * divisor[k - shift] if k >= shift else c for k, c in enumerate(rest[:-1])]
        size = max((abs(c) for c in rest), default=0)
        if size == 0:
            break
        chain.append([-c / size for c in rest])
    return chain


def _stepped(polynomial: list, x):
    """The root to which Newton's method goes at once from x, with a change of sign around it; None where there is no such thing."""
    derivative = [k * c for k, c in enumerate(polynomial)][1:]
    for _ in range(8):
        value, slope = (mpmath.polyval(p, x, asc=True) for p in (polynomial, derivative))
        move = value / slope if slope else x
        x -= move
        if abs(move) > 1e-3 * abs(x):
            return None
        if abs(move) < SAME * abs(x):
            ends = [mpmath.sign(mpmath.polyval(polynomial, x * (1 + side * SAME), asc=True)) for side in (-1, 1)]
            return x if ends[0] * ends[1] < 0 else None
    return None


def _polished(polynomial: list, low, high):
    """The one root in (low, high)."""
    slope = [k * c for k, c in enumerate(polynomial)][1:]
    rising = mpmath.polyval(polynomial, low, asc=True) < 0
    x = mpmath.sqrt(low * high)
    for step in range(400):
        value = mpmath.polyval(polynomial, x, asc=True)
        if (value < 0) == rising:
            low = x
        else:
            high = x
        steep = mpmath.polyval(slope, x, asc=True)
        further = x - value / steep if steep else low
        if value == 0 or abs(further - x) < mpmath.mpf(10) ** (-DIGITS // 2) * x:
            return further
        narrow = high / low < 1.01  # from there on Newton converges, or else bisection goes on
        x = further if narrow and low < further < high and step % 8 else mpmath.sqrt(low * high)
    raise UndecidedError("a root that could not be told apart")


def _routh(ascending: list) -> int:
    """Sign changes in the first column of the Routh array."""
    descending = list(reversed(ascending))
    while descending[0] == 0:
        descending.pop(0)
    upper, lower = descending[0::2], descending[1::2]
    column = [upper[0]]
    while lower:
        if lower[0] == 0:
            raise UndecidedError("a root may lie on the boundary without delay")
        column.append(lower[0])
        quotient = upper[0] / lower[0]
        upper, lower = lower, [a - quotient * b for a, b in zip_longest(upper[1:], lower[1:], fillvalue=mpmath.mpf(0))]
    return sum(a * b < 0 for a, b in pairwise(column))


def _outside(ascending: list) -> int:
    """Zeros outside the unit circle (Schur and Cohn; Henrici, Applied and Computational Complex Analysis I, theorem 6.8b)."""
    polynomial, sign, inside = list(ascending), 1, 0
    while polynomial[-1] == 0:
        polynomial.pop()
    degree = len(polynomial) - 1
    while len(polynomial) > 1:
        first, last = polynomial[0], polynomial[-1]
        difference = first * first - last * last
        if abs(difference) < SAME * (first * first + last * last):
            raise UndecidedError("a root may lie on the boundary without delay")
        sign *= 1 if difference > 0 else -1
        inside += sign < 0
        polynomial = [first * a - last * b for a, b in zip(polynomial, reversed(polynomial), strict=True)][:-1]
        largest = max(abs(c) for c in polynomial)
        polynomial = [c / largest for c in polynomial]
    return degree - inside
