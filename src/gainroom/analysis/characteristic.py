"""The characteristic matrix of a closed loop, M(s) = sI − A + B e^{−sT} C, and its roots by eigenvalues.

Delay lines of the n delayed channels are discretised on Chebyshev points (Breda, Maset and Vermiglio 2005); of sampled loops they are
states.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Complexes, Floats
from ..system.loop import Loop

RESOLUTION = 1e-13  # error of a root, relative to the largest element of the state matrix
SINGULAR = 1e-13  # relative to the largest singular value: smaller ones are 0
AT_REST = 1e-3  # [1/s] largest size of a root that may be 0, where all else is fast
SILENT = 1e-10  # coupling between controller and motion, relative to the gains, below which no gain acts on it
NODES, NODES_PER_RADIAN = 12, 1.0
"""Chebyshev points of a delay line for roots within |s| T: interpolation of e^{−sT} errs by (e|s|T/4n)ⁿ, below 1e-10."""


def roots_within(loop: Loop, most: float) -> Complexes:
    """Closed-loop roots s (m,) [1/s], all with |s| ≤ `most` [1/s] and some beyond; sampled loops: ln(z)/T_s of every root.

    They are eigenvalues. Delays of continuous loops are on enough Chebyshev points for e^{−sT} to ten digits up to |s| = `most`.
    """
    loop.require_one_path("a root in s")
    system = characteristic(loop)
    turns = most * float(system.delays.max(initial=0.0))
    nodes = 0 if loop.sample_time is not None or not turns else math.ceil(NODES + NODES_PER_RADIAN * turns)
    found: Complexes = np.linalg.eigvals(system.collocated(nodes)).astype(complex)
    if loop.sample_time is None:
        return found
    z = 1 + loop.sample_time * found
    return np.log(z[z != 0]) / loop.sample_time


def growth_rate(roots: Complexes, sample_time: float | None) -> Floats:
    """Growth rate Re s [1/s] of roots (m,) in v: v itself is s in continuous time, (z − 1)/T_s in sampled time."""
    with np.errstate(divide="ignore"):
        return roots.real if sample_time is None else np.log(np.abs(1 + sample_time * roots)) / sample_time


def characteristic(loop: Loop) -> "Characteristic":
    """Characteristic matrix of a loop with a state space: build_loop's, and of LTI systems."""
    assert loop.open_loop is not None
    delays = np.zeros(loop.size) if loop.delays is None else loop.delays
    return Characteristic(loop.open_loop.a, loop.open_loop.b, loop.gain * loop.open_loop.c, loop.gain * loop.open_loop.d, delays)


@dataclass(frozen=True)
class Characteristic:
    """Closed loop x' = a x + b u(t − T), u = −(c x + d u(t − T)) of n channels with a delay T each; of a sampled loop v replaces s."""

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delays: Floats

    def matrix(self, s: complex) -> tuple[Complexes, Complexes]:
        """Characteristic matrix M(s) and its derivative dM/ds; det M = 0 at the closed-loop roots."""
        lag = np.exp(-s * self.delays)
        inner = np.linalg.inv(np.eye(len(lag)) + self.d * lag)  # columns of d scaled: d E
        passed = lag[:, None] * inner
        change = -(self.delays * lag)[:, None] * inner + passed @ (self.d * (self.delays * lag)) @ inner
        eye = np.eye(len(self.a))
        return s * eye - self.a + self.b @ passed @ self.c, eye + self.b @ change @ self.c

    @property
    def at_rest(self) -> float:
        """Size |s| [1/s] below which a root counts as 0: a double root at 0 is known to the square root of round-off alone."""
        return min(math.sqrt(RESOLUTION) * float(np.abs(self.a).max(initial=1.0)), AT_REST)

    def unmoved(self, sample_time: float | None) -> Complexes:
        """Roots on the stability boundary, Im ≥ 0, that no gain moves: open-loop poles that are unobservable or uncontrollable."""
        poles: Complexes = np.linalg.eigvals(self.a).astype(complex)
        poles[np.abs(poles) <= self.at_rest] = 0.0
        ringing = np.abs(growth_rate(poles, sample_time)) <= 1e-9 * np.abs(poles)
        found = [pole for pole in set(poles[ringing & (poles.imag >= 0)].tolist()) if self._is_unmoved(pole)]
        return np.array(found, dtype=complex)

    def _is_unmoved(self, pole: complex) -> bool:
        """True if some motion of this open-loop pole is unobservable or uncontrollable for the controller (Hautus test)."""
        left, sizes, right = np.linalg.svd(self.a - pole * np.eye(len(self.a)))
        null = sizes <= SINGULAR * sizes[0]
        return bool(null.any()) and (_loses(self.c, right[null].conj().T) or _loses(self.b.T, left[:, null].conj()))

    def without(self, unmoved: Complexes, starts: Complexes) -> Complexes:
        """Those of `starts` that are not, within round-off, among the roots `unmoved`."""
        reach = np.maximum(self.at_rest, 1e-9 * np.abs(unmoved))
        return starts[np.all(np.abs(starts[:, None] - unmoved) > reach, axis=1)]

    def collocated(self, nodes: int) -> Floats:
        """Matrix whose eigenvalues approximate the closed-loop roots: every delay is discretised on `nodes` + 1 Chebyshev points.

        Without delays it is the closed-loop matrix itself, and the eigenvalues are exact.
        """
        states, lines = len(self.a), np.flatnonzero(self.delays > 0)
        direct = np.flatnonzero(self.delays == 0)
        size = states + nodes * len(lines)
        # Rows over [x, lines]: the signal of each channel that arrives at the plant.
        arriving = np.zeros((len(self.delays), size))
        for place, line in enumerate(lines):
            arriving[line, states + (place + 1) * nodes - 1] = 1.0
        sent = -np.hstack([self.c, np.zeros((len(self.delays), size - states))]) - self.d[:, lines] @ arriving[lines]
        if len(direct):
            block = self.d[np.ix_(direct, direct)]
            arriving[direct] = np.linalg.solve(np.eye(len(direct)) + block, sent[direct])
            sent = sent - self.d[:, direct] @ arriving[direct]
        result = np.zeros((size, size))
        result[:states] = self.b @ arriving
        result[:states, :states] += self.a
        if len(lines):
            differentiation = _chebyshev(nodes)
            for place, line in enumerate(lines):
                rows = slice(states + place * nodes, states + (place + 1) * nodes)
                scaled = differentiation * (2 / self.delays[line])
                result[rows, rows] = scaled[1:, 1:]
                result[rows] += np.outer(scaled[1:, 0], sent[line])
        return result


def _loses(matrix: Floats, motions: Complexes) -> bool:
    """True where `matrix` maps some combination of the motions, orthonormal columns, to nothing."""
    sizes = np.linalg.svd(matrix @ motions, compute_uv=False)
    return motions.shape[1] > len(sizes) or bool(sizes[-1] <= SILENT * np.linalg.norm(matrix))


def _chebyshev(nodes: int) -> Floats:
    """Differentiation matrix (nodes+1)² on cos(πj/nodes), from 1 (now) to −1 (one delay ago). Trefethen, Spectral Methods, ch. 6."""
    points = np.cos(np.pi * np.arange(nodes + 1) / nodes)
    weights = np.append(2.0, np.append(np.ones(nodes - 1), 2.0)) * (-1.0) ** np.arange(nodes + 1)
    gaps = points[:, None] - points[None, :] + np.eye(nodes + 1)
    matrix = np.outer(weights, 1 / weights) / gaps
    return matrix - np.diag(matrix.sum(axis=1))
