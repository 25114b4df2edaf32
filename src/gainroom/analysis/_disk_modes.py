"""Bounds of S − T between frequencies: the modes of n loops closed without delay, and expansions whose remainders they bound.

Let G be the loop without its pure delays E = diag(e^{−jωT_i}) (in sampled time: without whole ticks), L = G E, and
N = G (I + R G)⁻¹ = Σ c_i b_iᵀ/(v − p_i): the modes of the loops closed without delay through a diagonal R > 0. Then

    S − T = E⁻¹ X Y⁻¹ E,    X = I − (R + E) N,    Y = I − (R − E) N,

where nothing is infinite at ω = 0: integrators only make N = R⁻¹ there. R is near I; that it differs from joint to joint parts the modes
of equal joints, whose eigenvectors would otherwise come out as any mixture.

About the middle of an interval X Y⁻¹ is expanded to second order in ω; what is left out is bounded mode by mode, with the distance of
p_i from the interval for |v − p_i|. A quadratic in ω stays inside the hull of its Bernstein coefficients, so its norm stays below the
largest of theirs. With D held this bounds σ_max(D (S − T) D⁻¹) on the whole interval. Beyond the last interval N is bounded by its
expansion in 1/s.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..linear.arrays import Complexes, Floats, Integers
from ..linear.state_space import StateSpace, split_delay
from ..system.loop import Loop
from ._mu import balanced, largest, scaled

AGREEMENT = 1e-6  # of the modes with the state space that they come from, relative
SPREAD = 0.1  # of R about I
NEAREST = 1e-100  # distance of a pole on the boundary [1/s]
LOST = float(np.sqrt(np.finfo(float).eps))  # of the fastest pole: below, one that nearly coincides with another is round-off
SLOW = 1e-5  # of the fastest pole: where round-off moves poles that coincide twice or three times at 0
UNSEEN = 1e-10  # of an output: what round-off leaves of motions that it does not see
LEAST_SHARE = 1e-3  # of N that a motion makes at rest, for it to count
ORDER = 4  # of the expansion of N in 1/s: current loops make N fall with the third power of s


@dataclass(frozen=True)
class Modes:
    """N = Σ c_i b_iᵀ/(v − p_i), E and R.

    poles p (m,), into b (m, n), out c (n, m), delays (n,) [s], share (n,) the diagonal of R, sample_time [s] (0: continuous)
    """

    poles: Complexes
    into: Complexes
    out: Complexes
    delays: Floats
    share: Floats
    sample_time: float

    @property
    def last(self) -> float:
        """The highest frequency [rad/s]."""
        return math.pi / self.sample_time if self.sample_time else math.inf

    @property
    def fastest(self) -> float:
        """The largest |p| [1/s]."""
        return float(np.abs(self.poles).max(initial=0.0)) or 1.0

    @property
    def lost(self) -> bool:
        """Whether a motion counts of which round-off, which moves poles that nearly coincide by its root, leaves no digit."""
        sizes = np.abs(self.poles)
        slow = (sizes < LOST * self.fastest) & (sizes > 0)
        share = np.linalg.norm(self.out, axis=0) * np.linalg.norm(self.into, axis=1)
        return bool(np.any(share[slow] > LEAST_SHARE * sizes[slow]))

    def frequencies(self, count: int) -> Floats:
        """0, then `count` frequencies [rad/s] from below the slowest mode to beyond the fastest."""
        sizes, fastest = np.abs(self.poles), self.fastest
        slowest = float(sizes[sizes > 1e-9 * fastest].min(initial=fastest))
        return np.append(0.0, np.geomspace(0.1 * slowest, min(10 * fastest, self.last), count))

    def variable(self, omega: Floats) -> Complexes:
        """v at ω (k,)."""
        return _variable(omega, self.sample_time)

    def matrices(self, omega: Floats) -> Complexes:
        """X Y⁻¹ (k, n, n): S − T up to the phases of E, which no bound of μ feels."""
        response = 1 / (self.variable(omega)[:, None] - self.poles)
        modes = (self.out * response[:, None, :]) @ self.into
        delayed = np.exp(-1j * omega[:, None] * self.delays)[:, :, None] * modes
        rest = np.eye(len(self.delays)) - self.share[:, None] * modes
        return np.linalg.solve((rest + delayed).swapaxes(1, 2), (rest - delayed).swapaxes(1, 2)).swapaxes(1, 2)

    def distances(self, low: Floats, high: Floats) -> Floats:
        """(k, m) the least |v − p| for ω in [low, high] (k,)."""
        center, across = self.poles.imag, np.abs(self.poles.real)
        if self.sample_time:
            z = 1 + self.sample_time * self.poles
            center, across = np.angle(z) / self.sample_time, np.abs(1 - np.abs(z)) / self.sample_time
        ends = [np.abs(self.variable(end)[:, None] - self.poles) for end in (low, high)]
        least = np.where((center > low[:, None]) & (center < high[:, None]), across, np.minimum(*ends))
        return np.maximum(least, NEAREST)

    def end(self, height: float) -> float:
        """ω beyond which σ_max(D (S − T) D⁻¹) < `height`, for some D, whatever the phases of E; in continuous time.

        With t ≥ ‖D N D⁻¹‖ and r = t/(1 − ‖R‖ t) ≥ ‖D L D⁻¹‖, σ_max ≤ (1 + r)/(1 − r). N = Σ_k m_k/s^(k+1) with m_k = Σ c_i p_i^k b_iᵀ,
        and a remainder after ORDER terms.
        """
        r = (height - 1) / (height + 1)
        allowed = r / (1 + self.share.max() * r)
        omega = self.fastest * 2.0 ** np.arange(-6, 40, 0.25)
        x = balanced(self.matrices(np.array([self.fastest])))
        out, into = self.out * np.exp(x[0])[:, None], self.into * np.exp(-x[0])
        terms = [_norm(((out * self.poles**k) @ into)[None])[0] / omega ** (k + 1) for k in range(ORDER)]
        sizes = np.linalg.norm(out, axis=0) * np.linalg.norm(into, axis=1)
        distance = np.where(self.poles.imag > omega[:, None], np.abs(self.poles.real), np.abs(1j * omega[:, None] - self.poles))
        rest = np.sum((np.abs(self.poles) / omega[:, None]) ** ORDER * sizes / np.maximum(distance, NEAREST), axis=1)
        below = sum(terms) + rest < allowed
        return float(omega[np.argmax(below)]) if below.any() else math.inf


@dataclass(frozen=True)
class Opened:
    """The loops opened at the motor torques, L = G E: G (n, n) a state space, delays (n,) [s], sample_time [s] (0: continuous)."""

    system: StateSpace
    delays: Floats
    sample_time: float

    def response(self, omega: Floats) -> Complexes:
        """L at ω (k,): (k, n, n)."""
        return self.system.at(_variable(omega, self.sample_time)) * np.exp(-1j * omega[:, None] * self.delays)[:, None, :]

    def modes(self) -> Modes:
        """The modes of the loops closed without delay. Defective ones are wrong: `agrees` detects them."""
        system, size = self.system, len(self.delays)
        share = 1 + SPREAD * np.linspace(-1, 1, size)
        closed = _without_drift(replace(system, a=system.a - (system.b * share) @ system.c))
        poles, vectors = np.linalg.eig(closed.a)
        try:
            into = np.linalg.solve(vectors, closed.b)
        except np.linalg.LinAlgError:  # parallel eigenvectors
            into = np.zeros(closed.b.shape)
        return Modes(poles, into, closed.c @ vectors, self.delays, share, self.sample_time)

    def agrees(self, modes: Modes, omega: Floats) -> bool:
        """Whether the modes give back S − T at ω (k,)."""
        eye, lag = np.eye(len(self.delays)), np.exp(-1j * omega[:, None] * self.delays)
        direct = 2 * np.linalg.inv(eye + self.response(omega)) - eye
        x = balanced(direct)
        with np.errstate(all="ignore"):  # NaN and infinity agree with nothing
            error = scaled(modes.matrices(omega) - lag[:, :, None] * direct / lag[:, None, :], x)
            return bool(np.all(_norm(error) <= AGREEMENT * _norm(scaled(direct, x))))


def _without_drift(system: StateSpace) -> StateSpace:
    """The same transfer matrix without the slow motions that no output sees: joints that no gain holds drift at 0.

    Round-off parts such double poles by its root and makes their eigenvectors parallel. The space that the slow poles span together is
    known to all digits, and so is whether an output sees it.
    """
    sizes = np.abs(np.linalg.eigvals(system.a))
    if not np.any(sizes <= SLOW * sizes.max(initial=0.0)):
        return system
    import scipy.linalg  # takes a fifth of a second

    a, by = scipy.linalg.matrix_balance(system.a, permute=False)
    scale = np.diag(by)
    b, c = system.b / scale[:, None], system.c * scale
    for slow in (SLOW * sizes.max(initial=0.0), LOST * sizes.max(initial=0.0)):
        if not np.any(sizes <= slow):
            break
        triangular, basis = scipy.linalg.schur(a, output="complex", sort=lambda pole, slow=slow: abs(pole) <= slow)[:2]
        count, seen = int(np.count_nonzero(np.abs(np.diag(triangular)) <= slow)), c @ basis
        if np.all(np.linalg.norm(seen[:, :count], axis=1) <= UNSEEN * np.linalg.norm(seen, axis=1)):
            return StateSpace(triangular[count:, count:], (basis.conj().T @ b)[count:], seen[:, count:], system.d)
    return system


def opened_at_torques(loop: Loop) -> Opened:
    """A loop of several joints; in sampled time E holds the whole ticks."""
    if loop.sample_time is None:
        assert loop.open_loop is not None
        system, delays = loop.open_loop, np.zeros(loop.size) if loop.delays is None else loop.delays
    else:
        assert loop.parts is not None
        step = loop.sample_time
        ticks, fractions = split_delay([drive.delay for drive in loop.parts.drives], step)
        rest = [replace(drive, delay=step * part) for drive, part in zip(loop.parts.drives, fractions.tolist(), strict=True)]
        shorter = replace(loop, parts=replace(loop.parts, drives=tuple(rest))).open_loop
        assert shorter is not None
        system, delays = shorter, step * ticks
    return Opened(StateSpace(system.a, system.b, loop.gain * system.c, loop.gain * system.d), delays, loop.sample_time or 0.0)


def _variable(omega: Floats, sample_time: float) -> Complexes:
    """v at ω (k,)."""
    if not sample_time:
        return 1j * omega
    half = 0.5 * omega * sample_time
    return np.exp(1j * half) * (2j / sample_time) * np.sin(half)


@dataclass(frozen=True)
class Expansion:
    """X Y⁻¹ = M0 + M1 δ + M2 δ² + … about the middles of k intervals, and what bounds the rest.

    middle, half     (k,) [rad/s]
    longest, most    delay [s], entry of R
    matrices         M0, M1, M2, each (k, n, n)
    modes, below     N Y⁻¹ to second order, and the first two terms of Y(δ) Y⁻¹ − I
    out, rows, rest  (n, m) |c_i|², (k, m, n) |b_iᵀ Y⁻¹|², and (k, m) how far 1/(v − p_i) may be from its expansion, over h³
    """

    middle: Floats
    half: Floats
    longest: float
    most: float
    matrices: tuple[Complexes, Complexes, Complexes]
    modes: tuple[Complexes, Complexes, Complexes]
    below: tuple[Complexes, Complexes]
    out: Floats
    rows: Floats
    rest: Floats

    def bounds(self, which: Integers, x: Floats, enough: float) -> tuple[Floats, Floats]:
        """What σ_max(D X Y⁻¹ D⁻¹), D = e^x, stays below on the intervals `which`, and the part of it that is left over from the expansion.

        (k,) each. Where a rough bound is below `enough` it is left at that.
        """
        h, ratio = self.half[which], np.exp(x[:, :, None] - x[:, None, :])
        u0, u1, u2 = (_norm(part[which] * ratio) * h**power for power, part in enumerate(self.modes))
        y1, y2 = (_norm(part[which] * ratio) * h ** (power + 1) for power, part in enumerate(self.below))
        at_0, at_1, at_2 = (part[which] * ratio * (h**power)[:, None, None] for power, part in enumerate(self.matrices))
        m0, m1, m2 = largest(at_0), _norm(at_1), _norm(at_2)
        sizes = np.sqrt(np.exp(2 * x) @ self.out) * np.sqrt((self.rows[which] @ np.exp(-2 * x)[:, :, None])[:, :, 0])
        modes = h**3 * np.sum(sizes * self.rest[which], axis=1)
        # E = E0 (1 − jδT − δ²T²/2 + r), |r| ≤ (hT)³/6; products of third order and beyond
        turn = h * self.longest
        r = (1 + self.most) * modes + turn**3 / 6 * (u0 + u1 + u2) + turn * u2 + turn**2 / 2 * (u1 + u2)
        wrong = r + m1 * y2 + m2 * y1 + m2 * y2 + (m0 + m1 + m2) * r
        smallest_gain = 1 - y1 - y2 - r  # ‖(Y(δ) Y⁻¹)⁻¹‖ ≤ 1/smallest_gain
        rest = np.where(smallest_gain > 0, wrong / np.where(smallest_gain > 0, smallest_gain, 1.0), np.inf)
        height = m0 + m1 + m2
        close = np.flatnonzero((height + rest > enough) & np.isfinite(rest))
        if len(close):
            b0, b1, b2 = at_0[close], at_1[close], at_2[close]
            height[close] = np.maximum(np.maximum(largest(b0 - b1 + b2), largest(b0 + b1 + b2)), largest(b0 - b2))
        return height + rest, rest


def expanded(modes: Modes, low: Floats, high: Floats) -> Expansion:
    """The expansions about the middles of [low, high] (k,)."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    step, v = modes.sample_time, modes.variable(middle)
    rate = (1j + 1j * step * v)[:, None]  # dv/dω; d²v/dω² = j T_s dv/dω
    response = 1 / (v[:, None] - modes.poles)
    terms = (response, -rate * response**2, rate**2 * response**3 - 0.5j * step * rate * response**2)
    n0, n1, n2 = ((modes.out * term[:, None, :]) @ modes.into for term in terms)
    delays, share, lag = modes.delays[:, None], modes.share[:, None], np.exp(-1j * middle[:, None] * modes.delays)[:, :, None]
    inverse = np.linalg.inv(np.eye(len(delays)) - (share - lag) * n0)
    n0, n1, n2 = n0 @ inverse, n1 @ inverse, n2 @ inverse
    e0, e1, e2 = lag * n0, lag * (n1 - 1j * delays * n0), lag * (n2 - 1j * delays * n1 - 0.5 * delays**2 * n0)  # E N Y⁻¹
    y1, y2 = e1 - share * n1, e2 - share * n2
    m0 = inverse - share * n0 - e0
    m1 = -share * n1 - e1 - m0 @ y1
    m2 = -share * n2 - e2 - m1 @ y1 - m0 @ y2
    # 1/(v − p) is a geometric series in (v − v0)/(v0 − p); in sampled time v − v0 is not quite proportional to δ
    size = np.abs(response)
    rest = size**3 * (1 / modes.distances(low, high) + step) + step**2 / 6 * size**2
    rows = np.abs(modes.into @ inverse) ** 2
    return Expansion(
        middle,
        half,
        float(modes.delays.max()),
        float(modes.share.max()),
        (m0, m1, m2),
        (n0, n1, n2),
        (y1, y2),
        np.abs(modes.out) ** 2,
        rows,
        rest,
    )


def _norm(matrices: Complexes) -> Floats:
    """A cheap upper bound of σ_max (k,): the Frobenius norm, or the mean of the row and column sum norms."""
    size = np.abs(matrices)
    return np.minimum(np.sqrt(np.sum(size**2, axis=(1, 2))), np.sqrt(size.sum(axis=1).max(axis=1) * size.sum(axis=2).max(axis=1)))
