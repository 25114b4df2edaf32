"""The peak gain of a stable sampled system: the largest σ_max of its transfer matrix over the unit circle.

A level γ above σ_max(d) is reached at z = e^{jθ} exactly where z is an eigenvalue of a symplectic pencil made from the system and γ
(Boyd, Balakrishnan and Kabamba 1989; Bruinsma and Steinbuch 1990). Without one on the circle no peak is above the level, however narrow;
else the system is above it on some interval between neighbours of them, whose middles give the next level. A pencil's eigenvalue that
round-off puts on the circle costs a look in vain, and one that is taken off it would have to be moved by more than NEAR.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.linear.state_space import StateSpace
from ._mu import balanced

LEVEL = 1e-9  # relative height above the highest known σ_max at which the peak is sought: the error that is left
NEAR = 1e-4  # distance of |eigenvalue| from 1 that counts as on the circle: a peak just below a level has them √LEVEL beside it
SCALED = 1e-4  # likewise of a scaled peak: half of what is left to a loop with one path
MOST_INTERVALS = 60  # intervals of the circle, each with its D, after which a scaled peak counts as not proved
ROUNDS = 40  # most levels tried; each takes the peak's error to less than its square root
DIRECT = 150  # rows of a matrix up to which its singular values, or a pencil's eigenvalues, are computed by the most exact way
SLOWEST = 1e-8  # [rad] least angle on the circle that is examined, beside 0


@dataclass(frozen=True)
class PeakGain:
    """Peak gain of a sampled system: the largest σ_max, at e^{jθ}, θ = `angle` in [0, π], and the input (m,) that has it there.

    certified   True: no σ_max on the circle exceeds it by more than LEVEL of it; of a scaled one, by more than SCALED
    """

    height: float
    angle: float
    input: Complexes
    certified: bool


@dataclass(frozen=True)
class OnCircle:
    """A system x ↦ a x + b u, y = c x + d u with real matrices, ready for its transfer matrix on the unit circle."""

    system: StateSpace
    triangle: Complexes
    left: Complexes
    right: Complexes

    @classmethod
    def of(cls, system: StateSpace) -> "OnCircle":
        """Balanced system with its Schur form, with which the transfer matrix at a point is a back-substitution."""
        from scipy.linalg import matrix_balance, schur

        found: Any = matrix_balance(system.a, permute=False)
        units = np.diag(found[1])
        even = StateSpace(found[0], system.b / units[:, None], system.c * units, system.d)
        found = schur(even.a, output="complex")
        return cls(even, found[0], even.c @ found[1], found[1].conj().T @ even.b)

    def at(self, angle: float) -> Complexes:
        """The transfer matrix at e^{j angle}."""
        from scipy.linalg import solve_triangular

        if not len(self.triangle):
            return self.system.d.astype(complex)
        return self.left @ solve_triangular(np.exp(1j * angle) * np.eye(len(self.triangle)) - self.triangle, self.right) + self.system.d

    def height(self, angle: float) -> float:
        """σ_max of the transfer matrix at e^{j angle}."""
        return strongest(self.at(angle))[0]

    def angles(self) -> Floats:
        """Angles in [0, π] from which the search for the peak starts: 0, π, beside every pole, and some between."""
        poles: Complexes = np.diag(self.triangle)
        beside = np.abs(np.angle(poles[np.abs(poles) > 0.1]))
        return np.unique(np.clip(np.concatenate([[0.0, np.pi], beside, np.geomspace(1e-3, 3.0, 12)]), 0.0, np.pi))

    def reached(self, level: float) -> Floats:
        """Angles in [0, π] at which a singular value may be `level`, which none of d is: all at which one is, and perhaps others."""
        from scipy.linalg import eigvals

        a, b, c, d = self.system.a, self.system.b, self.system.c, self.system.d
        size = len(a)
        inside = np.linalg.solve(level**2 * np.eye(d.shape[1]) - d.T @ d, np.hstack([d.T @ c, b.T]))
        moved = a + b @ inside[:, :size]
        into, out = b @ inside[:, size:], c.T @ (c + d @ inside[:, :size])
        units = np.sqrt(max(np.abs(out).max(), 1e-300) / max(np.abs(into).max(), 1e-300))  # makes state and adjoint state of like size
        nothing, eye = np.zeros_like(a), np.eye(size)
        left, right = np.block([[moved, nothing], [-out / units, eye]]), np.block([[eye, -into * units], [nothing, moved.T]])
        if size <= DIRECT:
            found: Complexes = eigvals(left, right)
        else:  # a bilinear map of them, a fifth of the time; less exact where one lies at −1
            mapped = np.linalg.eigvals(np.linalg.solve(left + right, left - right))
            with np.errstate(divide="ignore", invalid="ignore"):
                found = (1 + mapped) / (1 - mapped)
        return np.unique(np.abs(np.angle(found[np.isfinite(found) & (np.abs(np.abs(found) - 1) < NEAR)])))


def peak_gain(system: StateSpace) -> PeakGain:
    """Peak gain of x ↦ a x + b u, y = c x + d u, whose eigenvalues that input and output see are all inside the unit circle."""
    circle = OnCircle.of(system)
    known = [(circle.height(angle), angle) for angle in circle.angles().tolist()]
    best = polished(circle.height, known)
    floor = float(np.linalg.norm(system.d, 2)) if system.d.size else 0.0  # σ_max at infinity, never above the peak
    if not system.a.size or not np.any(system.b) or not np.any(system.c):
        return PeakGain(floor, 0.0, strongest(system.d)[1], certified=True)
    for _ in range(ROUNDS):
        level = max(best[0], floor) * (1 + LEVEL)
        try:
            edges = circle.reached(level)
        except np.linalg.LinAlgError:
            break
        edges = np.concatenate([[SLOWEST], edges[edges > SLOWEST], [np.pi]])
        looks = [(circle.height(angle), angle) for angle in ((edges[1:] + edges[:-1]) / 2).tolist()]
        if max(looks)[0] <= level:
            return PeakGain(*best, strongest(circle.at(best[1]))[1], certified=True)
        best = polished(circle.height, looks)
    return PeakGain(*best, strongest(circle.at(best[1]))[1], certified=False)


@dataclass(frozen=True)
class _Scaled:
    """D M D⁻¹ on the circle, M (m, m) the transfer matrix and D = e^x one positive number for all signals of a block (n,)."""

    system: StateSpace
    block: Integers
    circle: OnCircle

    @property
    def size(self) -> int:
        """Number n of blocks of signals."""
        return int(self.block.max()) + 1

    def scaled(self, matrix: Complexes, x: Floats) -> Complexes:
        """Scaled matrix D M D⁻¹, D = e^x per block."""
        return matrix * np.exp(x[self.block][:, None] - x[self.block])

    def balanced(self, angle: float) -> tuple[float, Floats]:
        """σ_max at e^{j angle} with the scaling x (n,) that minimises the Frobenius norm, and that x."""
        matrix = self.circle.at(angle)
        blocks = np.zeros((self.size, self.size))
        np.add.at(blocks, (self.block[:, None], self.block[None, :]), np.abs(matrix) ** 2)
        x = balanced(np.sqrt(blocks)[None].astype(complex))[0]
        return strongest(self.scaled(matrix, x))[0], x

    def least(self, angle: float, start: Floats | None = None) -> tuple[float, Floats]:
        """Least σ_max over scalings x (n,), and that x: ln σ_max is convex in x, and falls from `start`."""
        from scipy.optimize import minimize

        matrix = self.circle.at(angle)

        def height(x: Floats) -> tuple[float, Floats]:
            moved = self.scaled(matrix, x)
            size, right = strongest(moved)
            slope = np.bincount(self.block, np.abs(moved @ right / size) ** 2 - np.abs(right) ** 2, self.size)
            return math.log(size), slope

        start = self.balanced(angle)[1] if start is None else start
        found = minimize(height, start, jac=True, method="BFGS", options={"gtol": 1e-8, "maxiter": 40})
        return min(((math.exp(height(x)[0]), x) for x in (start, found.x)), key=lambda one: one[0])

    def below(self, level: float, angle: float, x: Floats, low: float, high: float) -> tuple[float, float]:
        """Interval about `angle` in [low, high] on which σ_max with scaling x, below `level` at `angle`, provably stays below."""
        by = np.exp(x[self.block])
        system = self.system
        edges = OnCircle.of(StateSpace(system.a, system.b / by, by[:, None] * system.c, self.scaled(system.d, x))).reached(level)
        return max([low, *edges[edges < angle]]), min([high, *edges[edges > angle]])


def scaled_peak_gain(system: StateSpace, block: Integers) -> PeakGain:
    """Highest σ_max of D M D⁻¹ over frequency, with the best D at each: one positive number per `block` of signals (m,), 0 to n − 1.

    It bounds the structured singular value for a full complex factor per block (Packard and Doyle 1993). Certified: the circle is covered
    by intervals on each of which, for some D, σ_max exceeds it by no more than SCALED of it.
    """
    loops = _Scaled(system, np.unique(block, return_inverse=True)[1], OnCircle.of(system))
    looks = sorted(((*loops.balanced(angle), angle) for angle in loops.circle.angles().tolist()), key=lambda one: -one[0])
    known = sorted(one[2] for one in looks)

    def peak(angle: float) -> tuple[float, float, Floats]:
        at = int(np.searchsorted(known, angle))
        start = loops.least(angle)[1]
        beside = [(loops.least(one, start)[0], one) for one in known[max(at - 1, 0) : at + 2]]
        _, angle = polished(lambda one: loops.least(one, start)[0], beside)
        return (found := loops.least(angle))[0], angle, found[1]

    height, place, x = peak(looks[0][2])
    open_ = [(SLOWEST, math.pi, place, x)]
    for _ in range(MOST_INTERVALS):
        if not open_:
            break
        low, high, angle, with_x = open_.pop()
        near, far = loops.below(height * (1 + SCALED), angle, with_x, low, high)
        for first, last in ((low, near), (far, high)):
            if last - first <= SLOWEST:
                continue
            middle = (first + last) / 2
            value, there = loops.balanced(middle)
            if value > height:
                value, there = loops.least(middle, there)
            if value > height:
                known = sorted([*known, middle])
                height, place, x = max((height, place, x), (value, middle, there), peak(middle), key=lambda one: one[0])
            open_.append((first, last, middle, there))
    return PeakGain(height, place, strongest(loops.scaled(loops.circle.at(place), x))[1], certified=not open_)


def strongest(matrix: Complexes) -> tuple[float, Complexes]:
    """σ_max of a square matrix and the input (m,) of length 1 that it belongs to; of a large one by Lanczos' method, from below."""
    if len(matrix) <= DIRECT:
        return _by_svd(matrix)
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

    adjoint = matrix.conj().T.copy()
    square = LinearOperator(matrix.shape, matvec=lambda x: adjoint @ (matrix @ x), dtype=complex)  # type: ignore[call-arg]
    try:
        _, vectors = eigsh(square, 1, v0=np.ones(len(matrix), dtype=complex), ncv=40)
    except ArpackNoConvergence:  # many are alike
        return _by_svd(matrix)
    return float(np.linalg.norm(matrix @ vectors[:, 0])), vectors[:, 0]


def _by_svd(matrix: Complexes) -> tuple[float, Complexes]:
    _, values, right = np.linalg.svd(matrix)
    return float(values[0]), right[0].conj()


def polished(height: Callable[[float], float], known: list[tuple[float, float]]) -> tuple[float, float]:
    """The highest of samples (height, angle), and the peak between its neighbours."""
    from scipy.optimize import minimize_scalar

    by_angle = sorted(known, key=lambda one: one[1])
    at = by_angle.index(max(by_angle))
    low, high = by_angle[max(at - 1, 0)][1], by_angle[min(at + 1, len(by_angle) - 1)][1]
    if not high > low:
        return by_angle[at]
    found: Any = minimize_scalar(lambda angle: -height(angle), bounds=(low, high), method="bounded", options={"xatol": 1e-7 * (high - low)})
    return max(by_angle[at], (-float(found.fun), float(found.x)))


def without(system: StateSpace, resting: Callable[[complex], bool], unseen: float = 1e-9) -> StateSpace:
    """`system` without those eigenvalues of a that rest on the circle, where input or output does not see them: equal transfer matrix.

    Unchanged where they are seen. `resting` is True for such an eigenvalue; `unseen` is the relative size that counts as 0.
    """
    from scipy.linalg import schur, solve_sylvester

    found: Any = schur(system.a, output="real", sort=lambda real, imag: resting(complex(real, imag)))
    triangle, basis, count = found
    if not count:
        return system
    first, rest = slice(0, count), slice(count, None)
    mixed = solve_sylvester(triangle[first, first], -triangle[rest, rest], -triangle[first, rest])
    into, out = basis.T @ system.b, system.c @ basis
    seen, driven = out[:, first], into[first] - mixed @ into[rest]
    sizes = np.linalg.norm(out) * np.linalg.norm(into)
    if any(np.linalg.norm(seen @ np.linalg.matrix_power(triangle[first, first], k) @ driven) > unseen * sizes for k in range(count)):
        return system
    return replace(system, a=triangle[rest, rest], b=into[rest], c=out[:, rest] + seen @ mixed)
