"""The modes of n loops closed without delay, from which the core bounds S − T between frequencies (disk_modes.hpp).

Let G be the loop without its pure delays E = diag(e^{−jωT_i}) (in sampled time: without whole ticks), L = G E, and
N = G (I + R G)⁻¹ = Σ c_i b_iᵀ/(v − p_i): the modes of the loops closed without delay through a diagonal R > 0. With them S − T, its
expansions in ω and their remainders follow in closed form.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..native import _core
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.state_space import StateSpace, split_delay
from ..system.loop import Loop
from ._mu import balanced, scaled

AGREEMENT = 1e-6  # largest relative difference between S − T from the modes and S − T from the state space
SPREAD = 0.1  # R's diagonal lies between 1 − SPREAD and 1 + SPREAD, all different, so that equal joints have no defective modes
LOST = float(np.sqrt(np.finfo(float).eps))  # share of the fastest pole below which two poles that nearly coincide are round-off
SLOW = 1e-5  # share of the fastest pole up to which round-off moves double and triple poles at 0
UNSEEN = 1e-10  # share of an output that round-off leaves of a mode that the output does not see
LEAST_SHARE = 1e-3  # least part of N(ω = 0) that a mode has to make for its round-off to matter


@dataclass(frozen=True)
class ClosedModes:
    """Modes of the loops closed without delay: N = Σ c_i b_iᵀ/(v − p_i), the delays E and the diagonal R of the closed loops.

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
        """True if a slow mode that contributes to N at rest is round-off: nearly equal poles are known to the root of round-off alone."""
        sizes = np.abs(self.poles)
        slow = (sizes < LOST * self.fastest) & (sizes > 0)
        share = np.linalg.norm(self.out, axis=0) * np.linalg.norm(self.into, axis=1)
        return bool(np.any(share[slow] > LEAST_SHARE * sizes[slow]))

    def frequencies(self, count: int) -> Floats:
        """0, then `count` frequencies [rad/s] from below the slowest mode to beyond the fastest."""
        sizes, fastest = np.abs(self.poles), self.fastest
        slowest = float(sizes[sizes > 1e-9 * fastest].min(initial=fastest))
        return np.append(0.0, np.geomspace(0.1 * slowest, min(10 * fastest, self.last), count))

    @cached_property
    def core(self) -> _core.DiskModes:
        """Object of the core that holds these modes and bounds S − T between frequencies."""
        return _core.DiskModes(self.poles, self.into, np.ascontiguousarray(self.out.T), self.delays, self.share, self.sample_time)

    def matrices(self, omega: Floats) -> Complexes:
        """S − T (k, n, n) at ω (k,), up to the phases of E, which no bound of μ feels; NaN where it is not finite."""
        size = len(self.delays)
        return self.core.matrices(np.ascontiguousarray(omega)).reshape(-1, size, size)


@dataclass(frozen=True)
class OpenedLoop:
    """The loops opened at the motor torques, L = G E: G (n, n) a state space, delays (n,) [s], sample_time [s] (0: continuous)."""

    system: StateSpace
    delays: Floats
    sample_time: float

    def response(self, omega: Floats) -> Complexes:
        """L at ω (k,): (k, n, n)."""
        return self.system.at(_variable(omega, self.sample_time)) * np.exp(-1j * omega[:, None] * self.delays)[:, None, :]

    def modes(self) -> ClosedModes:
        """The modes of the loops closed without delay. Defective ones are wrong: `agrees` detects them."""
        system, size = self.system, len(self.delays)
        share = 1 + SPREAD * np.linspace(-1, 1, size)
        closed = replace(system, a=system.a - (system.b * share) @ system.c)
        poles, vectors = np.linalg.eig(closed.a)
        if np.any(np.abs(poles) <= SLOW * np.abs(poles).max(initial=0.0)):
            closed = _without_drift(closed, np.abs(poles))
            poles, vectors = np.linalg.eig(closed.a)
        try:
            into = np.linalg.solve(vectors, closed.b)
        except np.linalg.LinAlgError:  # parallel eigenvectors
            into = np.zeros(closed.b.shape)
        poles, into, out = poles.astype(complex), into.astype(complex), (closed.c @ vectors).astype(complex)
        second = 1 + np.flatnonzero((np.imag(poles[:-1]) > 0) & (poles[1:] == poles[:-1].conj()))
        into[second] = into[second - 1].conj()  # to the last digit, so that the core may sum the two as one
        return ClosedModes(poles, into, out, self.delays, share, self.sample_time)

    def agrees(self, modes: ClosedModes, omega: Floats) -> bool:
        """True if S − T from the modes and from the state space differ by at most AGREEMENT at every `omega` (k,) [rad/s]."""
        eye, lag = np.eye(len(self.delays)), np.exp(-1j * omega[:, None] * self.delays)
        direct = 2 * np.linalg.inv(eye + self.response(omega)) - eye
        x = balanced(direct)
        with np.errstate(all="ignore"):  # NaN and infinity agree with nothing
            error = scaled(modes.matrices(omega) - lag[:, :, None] * direct / lag[:, None, :], x)
            sizes = np.linalg.norm(scaled(direct, x), axis=(1, 2))
            return bool(np.all(np.linalg.norm(error, axis=(1, 2)) <= AGREEMENT * sizes))


def _without_drift(system: StateSpace, sizes: Floats) -> StateSpace:
    """`system` without those slow modes that no output sees, such as joints that no gain holds and that drift at 0: equal transfer matrix.

    `sizes` are the magnitudes of its poles [1/s].
    Round-off parts such double poles by its root and makes their eigenvectors parallel. The space that the slow poles span together is
    known to all digits, and so is whether an output sees it.
    """
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


def opened_at_torques(loop: Loop) -> OpenedLoop:
    """Return ratio G E of several joints, opened at the motor torques; for a sampled loop E holds the whole ticks of delay, G the rest."""
    if loop.sample_time is None:
        assert loop.open_loop is not None
        system, delays = loop.open_loop, np.zeros(loop.size) if loop.delays is None else loop.delays
    else:
        assert loop.parts is not None
        step = loop.sample_time
        ticks, fractions = split_delay(loop.parts.delays, step)
        rest = [replace(drive, delay=step * part) for drive, part in zip(loop.parts.drives, fractions.tolist(), strict=True)]
        shorter = replace(loop, parts=replace(loop.parts, drives=tuple(rest))).open_loop
        assert shorter is not None
        system, delays = shorter, step * ticks
    return OpenedLoop(StateSpace(system.a, system.b, loop.gain * system.c, loop.gain * system.d), delays, loop.sample_time or 0.0)


def _variable(omega: Floats, sample_time: float) -> Complexes:
    """Frequency variable v (k,) on the stability boundary at `omega` (k,) [rad/s]: jω, or (e^{jωT} − 1)/T of a loop sampled every T."""
    if not sample_time:
        return 1j * omega
    half = 0.5 * omega * sample_time
    return np.exp(1j * half) * (2j / sample_time) * np.sin(half)
