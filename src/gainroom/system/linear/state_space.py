"""State-space systems in the variable v (s, or δ = (z − 1)/T_s), and exact sampling behind a hold and a delay."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...errors import GainroomError
from ...native import _core
from .arrays import Complexes, Floats, Integers, distinct
from .transfer_function import Factored, paired

CANCELLED = 1e-13  # relative distance of a zero from a pole below which both are one
NEAR_DELAYS, LOOKED = 0.05, 60
"""Size |z| of roots that may be those of whole ticks of delay; frequencies at which that is decided."""
IN_CACHE = 250_000  # entries of all matrices that are solved at a time: more would leave the processor's cache


@dataclass(frozen=True)
class StateSpace:
    """State-space system v x = a x + b u, y = c x + d u; shapes (m, m), (m, inputs), (outputs, m), (outputs, inputs)."""

    a: Floats
    b: Floats
    c: Floats
    d: Floats

    @classmethod
    def gain(cls, d: Floats) -> "StateSpace":
        """Static system y = d u, without states."""
        d = np.atleast_2d(np.asarray(d, dtype=float))
        return cls(np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((d.shape[0], 0)), d)

    def __matmul__(self, first: "StateSpace") -> "StateSpace":
        """Series connection: `first`, then self."""
        return StateSpace(
            np.block([[first.a, np.zeros((len(first.a), len(self.a)))], [self.b @ first.c, self.a]]),
            np.vstack([first.b, self.b @ first.d]),
            np.hstack([self.d @ first.c, self.c]),
            self.d @ first.d,
        )

    def __add__(self, other: "StateSpace") -> "StateSpace":
        """Parallel connection: one input, outputs added."""
        return StateSpace(_block_diagonal(self.a, other.a), np.vstack([self.b, other.b]), np.hstack([self.c, other.c]), self.d + other.d)

    def repeated(self, count: int) -> "StateSpace":
        """Block-diagonal system of `count` equal copies."""
        eye = np.eye(count)
        return StateSpace(*(np.kron(eye, part) for part in (self.a, self.b, self.c, self.d)))

    def between(self, inputs: Integers, outputs: Integers) -> "StateSpace":
        """System restricted to the given inputs and outputs, in the given order."""
        return StateSpace(self.a, self.b[:, inputs], self.c[outputs], self.d[np.ix_(outputs, inputs)])

    def stacked(self, other: "StateSpace") -> "StateSpace":
        """The system with more outputs: those of `other`, a system of the same states and inputs."""
        return StateSpace(self.a, self.b, np.vstack([self.c, other.c]), np.vstack([self.d, other.d]))

    def beside(self, other: "StateSpace") -> "StateSpace":
        """Block-diagonal system of both, inputs and outputs stacked."""
        return StateSpace(*(_block_diagonal(getattr(self, name), getattr(other, name)) for name in "abcd"))

    @cached_property
    def lead(self) -> int:
        """Number of leading states that no later state acts on (current loops before a plant).

        0 where splitting would not halve the work.
        """
        size = len(self.a)
        if size < 2:
            return 0
        reached = np.where(np.any(self.a, axis=1), size - np.argmax(self.a[:, ::-1] != 0, axis=1), 0)  # (size,) one past the last that acts
        leads = [k for k, last in enumerate(np.maximum.accumulate(reached).tolist(), start=1) if last <= k < size]
        best = min(leads, key=lambda k: k**3 + (size - k) ** 3, default=0)
        return best if best**3 + (size - best) ** 3 < 0.5 * size**3 else 0

    def at(self, v: Complexes) -> Complexes:
        """Transfer matrix (k, outputs, inputs) at complex v (k,)."""
        v = np.asarray(v, dtype=complex)
        rows = max(1, IN_CACHE // max(1, len(self.a)) ** 2)
        if len(v) > rows:
            return np.concatenate([self.at(v[k : k + rows]) for k in range(0, len(v), rows)])
        first, rest = slice(0, self.lead), slice(self.lead, None)
        pushed = np.broadcast_to(self.b[rest].astype(complex), (len(v), *self.b[rest].shape))
        moved = np.zeros((len(v), 0, self.b.shape[1]))
        if self.lead:
            moved = np.linalg.solve(
                self._resolvent(v, first), np.broadcast_to(self.b[first].astype(complex), (len(v), *self.b[first].shape))
            )
            pushed = pushed + self.a[rest, first] @ moved
        return self.c[:, first] @ moved + self.c[:, rest] @ np.linalg.solve(self._resolvent(v, rest), pushed) + self.d

    def _resolvent(self, v: Complexes, part: slice) -> Complexes:
        block = self.a[part, part]
        result = np.empty((len(v), *block.shape), dtype=complex)
        result[:] = 0.0 - block
        diagonal = np.arange(len(block))
        result[:, diagonal, diagonal] += v[:, None]
        return result


def _block_diagonal(first: Floats, second: Floats) -> Floats:
    result = np.zeros((first.shape[0] + second.shape[0], first.shape[1] + second.shape[1]))
    result[: first.shape[0], : first.shape[1]] = first
    result[first.shape[0] :, first.shape[1] :] = second
    return result


def realize(system: Factored) -> StateSpace:
    """A proper scalar transfer function (its delay left aside) as a chain of first- and second-order sections."""
    if system.relative_degree < 0:
        raise GainroomError(f"a system with {len(system.zeros)} zeros and {len(system.poles)} poles is improper and has no state space")
    chain = StateSpace.gain(np.array([[system.gain]]))
    numerators = _quadratics(system.zeros)
    for denominator in sorted(_quadratics(system.poles), key=len, reverse=True):
        # The longest numerator that fits, and of those the nearest in natural frequency, keeps the sections well scaled.
        fitting = [k for k, poly in enumerate(numerators) if len(poly) <= len(denominator)]
        best = min(fitting, key=lambda k: (-len(numerators[k]), abs(numerators[k][-1] - denominator[-1])), default=-1)
        numerator = numerators.pop(best) if fitting else np.ones(1)
        chain = _section(numerator, denominator) @ chain
    if numerators:
        raise GainroomError(f"a system with zeros {system.zeros} and poles {system.poles} could not be split into real sections")
    return chain


def _quadratics(roots: Complexes) -> list[Floats]:
    """Real polynomials of order 2 (and at most one of order 1) whose product has the given roots."""
    pairs = [np.array([1.0, -2 * root.real, abs(root) ** 2]) for root in roots if root.imag > 0]
    reals = sorted((root.real for root in roots if root.imag == 0), key=abs)
    while len(reals) > 1:
        first, second = reals.pop(), reals.pop()
        pairs.append(np.array([1.0, -(first + second), first * second]))
    return pairs + [np.array([1.0, -root]) for root in reals]


def _section(numerator: Floats, denominator: Floats) -> StateSpace:
    """State space of numerator/denominator, order ≤ 2 and monic denominator, states scaled to the natural frequency."""
    order = len(denominator) - 1
    num = np.concatenate([np.zeros(order + 1 - len(numerator)), numerator])
    feedthrough = num[0]
    rest = num[1:] - feedthrough * denominator[1:]
    if order == 1:
        return StateSpace(np.array([[-denominator[1]]]), np.ones((1, 1)), rest[None, :1], np.array([[feedthrough]]))
    size = math.sqrt(abs(denominator[2])) or abs(denominator[1]) or 1.0
    a = np.array([[0.0, size], [-denominator[2] / size, -denominator[1]]])
    return StateSpace(a, np.array([[0.0], [1.0]]), np.array([[rest[1] / size, rest[0]]]), np.array([[feedthrough]]))


def split_delay(delays: ArrayLike, sample_time: float) -> tuple[Integers, Floats]:
    """Whole ticks, and the remaining fraction of a tick in [0, 1), of delays [s]; shapes as `delays`.

    A remainder within rounding of a whole tick is 0: 4.0 ms / 0.5 ms is not a whole number in floating point.
    """
    delays = np.asarray(delays, dtype=float)
    whole, fraction = _core.split_delays(delays.ravel(), sample_time).T.reshape(2, *delays.shape)
    return whole.astype(int), fraction


def hold(system: StateSpace, delays: Floats, sample_time: float) -> StateSpace:
    """`system` (continuous, strictly proper) behind a zero-order hold and one delay per input, sampled exactly, in v = δ.

    delays (inputs,) [s]: any value; the part beyond whole ticks changes the torque between samples (Åström and Wittenmark, Computer-
    Controlled Systems, sec. 2.3), whole ticks become a chain of 1/(1 + T_s δ) = 1/z. The states of `system` come last.
    """
    states, inputs = system.b.shape
    ticks, fraction = split_delay(delays, sample_time)
    total = sample_time * np.block([[system.a, system.b], [np.zeros((inputs, states + inputs))]])

    def over(part: float) -> tuple[Floats, Floats]:
        both = grown(total * part)
        both[: system.lead, system.lead : states] = 0.0  # round-off
        return both[:states, :states], both[:states, states:]

    growth, whole = over(1.0)
    now, before = whole.copy(), np.zeros_like(whole)
    for value in distinct(fraction[fraction > 0]):
        after, late = over(1 - value)
        columns = fraction == value
        now[:, columns] = late[:, columns]
        earlier = over(value)[1][:, columns]
        before[:, columns] = earlier + after @ earlier
    a = growth / sample_time
    plain = StateSpace(a, now / sample_time, system.c, system.d)
    late = np.flatnonzero(fraction)
    if len(late):
        # Inputs that change between samples enter twice: now, and with their value of one tick ago.
        both = StateSpace(a, np.hstack([now, before[:, late]]) / sample_time, system.c, np.zeros((len(system.c), inputs + len(late))))
        tick = _ticks(1, sample_time).repeated(len(late))
        pick = np.eye(inputs)[late]
        split = StateSpace(tick.a, tick.b @ pick, np.vstack([np.zeros((inputs, len(late))), tick.c]), np.vstack([np.eye(inputs), 0 * pick]))
        plain = both @ split
    chain = StateSpace.gain(np.zeros((0, 0)))
    for count in ticks:
        chain = chain.beside(_ticks(count, sample_time))
    return plain @ chain


PADE = (64764752532480000, 32382376266240000, 7771770303897600, 1187353796428800, 129060195264000, 10559470521600, 670442572800)
PADE += (33522128640, 1323241920, 40840800, 960960, 16380, 182, 1)
REACH = 5.37  # 1-norm up to which the approximant of order 13 has all digits


def grown(matrix: Floats) -> Floats:
    """Matrix function e^X − I of X (m, m), accurate relative to each column: slow and drifting states keep digits that I + small loses.

    Padé approximant of order 13 and squaring, 1 + E(2X) = (1 + E(X))², as for the exponential (Higham, SIAM J. Matrix Anal. Appl. 26,
    2005).
    """
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(matrix, permute=False, separate=True)
    halvings = max(0, math.ceil(math.log2(max(float(np.abs(balanced).sum(axis=0).max(initial=0.0)), 1e-300) / REACH)))
    x = balanced / 2.0**halvings
    powers = [np.eye(len(x)), x @ x]
    powers += [powers[1] @ powers[1]]
    powers += [powers[2] @ powers[1]]

    def polynomial(of: tuple[int, ...]) -> Floats:
        low = sum(PADE[k] * power for k, power in zip(of[:4], powers, strict=True))
        return low + powers[3] @ sum(PADE[k] * power for k, power in zip(of[4:], powers[1:], strict=True))

    odd, even = x @ polynomial((1, 3, 5, 7, 9, 11, 13)), polynomial((0, 2, 4, 6, 8, 10, 12))
    result = np.linalg.solve(even - odd, 2 * odd)
    for _ in range(halvings):
        result = 2 * result + result @ result
    return scale[:, None] * result / scale


def _ticks(count: int, sample_time: float) -> StateSpace:
    """State space of `count` ticks of delay, each 1/(1 + T_s δ)."""
    if count == 0:
        return StateSpace.gain(np.eye(1))
    a = (np.eye(count, k=-1) - np.eye(count)) / sample_time
    return StateSpace(a, np.eye(count, 1) / sample_time, np.eye(1, count, count - 1), np.zeros((1, 1)))


def zeros_of(system: StateSpace) -> Complexes:
    """Finite zeros of a system with one input and one output: from its pencil (Emami-Naeini and Van Dooren 1982), then Newton."""
    from scipy.linalg import eig

    states = len(system.a)
    size = max(np.abs(system.a).max(initial=0.0), 1.0)
    into, out = np.abs(system.b).max(initial=0.0) or 1.0, np.abs(system.c).max(initial=0.0) or 1.0
    pencil = np.block([[system.a / size, system.b / into], [system.c / out, system.d * size / (into * out)]])
    weight = np.zeros_like(pencil)
    weight[:states, :states] = np.eye(states)
    values: Any = eig(pencil, weight, right=False, homogeneous_eigvals=True)
    alpha, beta = values
    finite = np.abs(beta) > 1e-14 * np.abs(alpha)
    roots = alpha[finite] / beta[finite] * size
    roots = roots[roots.imag >= 0]
    poles = np.linalg.eigvals(system.a)
    cancelled = np.abs(roots[:, None] - poles).min(axis=1, initial=np.inf) <= CANCELLED * np.abs(roots)
    as_placed: Complexes = roots[cancelled]
    roots: Complexes = roots[~cancelled]  # on a pole the response has no value that Newton could use
    for _ in range(4):
        resolvent = roots[:, None, None] * np.eye(states) - system.a
        once = np.linalg.solve(resolvent, np.broadcast_to(system.b.astype(complex), (len(roots), states, 1)))
        value, slope = (system.c @ once)[:, 0, 0] + system.d[0, 0], -(system.c @ np.linalg.solve(resolvent, once))[:, 0, 0]
        step = value / slope
        # Newton may only polish: a step that leaves the neighbourhood belongs to a zero that the pencil places better.
        roots = np.where(np.abs(step) < 1e-3 * np.abs(roots), roots - step, roots)
    roots = np.concatenate([roots, as_placed])
    roots.imag[np.abs(roots.imag) <= 1e-12 * np.abs(roots)] = 0.0
    return paired(roots)


def factored(system: StateSpace, poles: Complexes, sample_time: float | None) -> Factored:
    """Transfer function of a scalar system: its zeros, the given poles, and a gain matched at a point away from both.

    Of a sampled system zeros and poles near z = 0 may be the delays of whole ticks, of which eigenvalues leave a ring: m of them are only
    known to the m-th root of round-off. They are put at 0 where that brings the response nearer to the system's.
    """
    zeros = zeros_of(system)
    # Matched where the response is large: far up a roll-off the state space gives it as a small difference of large numbers.
    slowest = np.abs(poles)[poles != 0].min(initial=np.inf)
    probe = 0.7j * (slowest if np.isfinite(slowest) else 1.0)
    if sample_time is None:
        return _matched(system, zeros, poles, probe, None)
    probe = np.expm1(probe * sample_time) / sample_time
    looked = np.expm1(1j * np.geomspace(1e-3, 1.0, LOOKED) * math.pi * (1 - 1e-6)) / sample_time
    right = system.at(looked)[:, 0, 0]

    def off(found: Factored) -> float:
        shape = np.prod((looked[:, None] - found.zeros), axis=1) / np.prod(looked[:, None] - found.poles, axis=1)
        return float(np.abs(found.gain * shape - right).max() / np.abs(right).max())

    every = [
        _matched(system, above, below, probe, sample_time)
        for above in (zeros, _at_whole_ticks(zeros, sample_time))
        for below in (poles, _at_whole_ticks(poles, sample_time))
    ]
    return min(every, key=off)


def _matched(system: StateSpace, zeros: Complexes, poles: Complexes, probe: complex, sample_time: float | None) -> Factored:
    """Transfer function with these zeros and poles whose gain is that of `system` at `probe`."""
    shape = np.prod(probe - zeros) / np.prod(probe - poles)
    gain = system.at(np.array([probe]))[0, 0, 0] / shape
    return Factored(zeros, poles, float(gain.real), 0.0, sample_time)


def _at_whole_ticks(roots: Complexes, sample_time: float) -> Complexes:
    """`roots` in δ with those near z = 0 at it."""
    return np.where(np.abs(1 + sample_time * roots) < NEAR_DELAYS, -1 / sample_time, roots)
