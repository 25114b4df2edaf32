"""The motion of a plant as a sum over its modes, with the motors free.

P_M = M₀/s² + Σ_k φ_k φ_kᵀ/((s − λ_k)(s − μ_k)), with real φ: a resonance has μ = λ̄, a motion that gravity topples two real poles. Where
the dampers couple the modes, Σ_k φ_k φ_kᵀ/(s − λ_k) over all poles of the quadratic eigenproblem stands in the place of the sum, with
complex φ (Tisseur and Meerbergen 2001).
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .linear.apart import eigensystem
from .linear.arrays import Complexes, Floats, diagonals

AT_REST = 1e-13  # relative to the largest ω²: smaller ones may be motions without a spring, off 0 by round-off
ALONE = 1e-12  # relative to the largest modal damping: less coupling between modes is round-off
SHARP = 0.1  # damping ratio of resonances that samples may miss
SAME = 1e-6  # relative distance of two poles that count as equal
ROUNDING = 4e-16  # relative round-off of a matrix with exact entries
LIGHT = 0.1  # 2ζ: where damping is more, it does not count
APART = 1e-3  # relative distance of the two poles of one mode that count as equal


class Corners(NamedTuple):
    """Rough corner frequencies of a response in s, for placing samples: each resonance by its upper pole, and real poles."""

    poles: Complexes
    zeros: Complexes

    @property
    def every(self) -> Complexes:
        return np.concatenate(self)


@dataclass(frozen=True)
class Modes:
    """Modal form M₀ (n, n), φ (m, n), λ (m,), μ (m,) of a response; μ empty: every pole stands alone and φ is complex.

    `inexact` bounds the relative error of the sum.
    """

    rigid: Floats | Complexes
    shapes: Complexes
    poles: Complexes
    partners: Complexes
    inexact: float = 0.0

    def response(self, s: Complexes) -> Complexes:
        """Response P_M (k, n, n) at complex s (k,)."""
        away = s[:, None] - self.poles
        terms = 1 / (away * (s[:, None] - self.partners) if len(self.partners) else away)
        return self.rigid / s[:, None, None] ** 2 + (self.shapes.T * terms[:, None]) @ self.shapes

    @property
    def at_rest(self) -> Complexes:
        """Coefficients (m,) of φ_k φ_kᵀ at s = 0."""
        return 1 / (self.poles * self.partners) if len(self.partners) else -1 / self.poles

    @property
    def compliance(self) -> Floats:
        """Static compliance (n, n): P_M at s = 0 without the rigid-body part M₀/s²."""
        return ((self.shapes.T * self.at_rest) @ self.shapes).real

    def along(self, directions: Floats) -> "Modes":
        """Modal form of Y P Yᵀ, Y = `directions` (r, n)."""
        return replace(self, rigid=directions @ self.rigid @ directions.T, shapes=self.shapes @ directions.T)

    def twofold(self, measured: Floats, torque: Floats) -> "Modes":
        """Modal form of [S, jA; −jA, S], S and A the symmetric and antisymmetric part of Y P X; Y = `measured` (r, n), X = `torque` (n, r).

        With u = Y φ, w = Xᵀ φ, û = (u, −ju) and ŵ = (w, jw) a mode adds ½ (û ŵᵀ + ŵ ûᵀ), which is that of ½ (û + ŵ) and of ½ j (û − ŵ).
        """
        rigid, left, right = measured @ self.rigid @ torque, self.shapes @ measured.T, self.shapes @ torque
        even, odd = (rigid + rigid.T) / 2, (rigid - rigid.T) / 2
        left, right = np.hstack([left, -1j * left]), np.hstack([right, 1j * right])
        return replace(
            self,
            rigid=np.block([[even, 1j * odd], [-1j * odd, even]]),
            shapes=np.vstack([left + right, 1j * (left - right)]) / 2,
            poles=np.tile(self.poles, 2),
            partners=np.tile(self.partners, 2),
        )


def modes_of(mass: Floats, damping: Floats, stiffness: Floats, position: Floats) -> Modes | None:
    """Modal form of M η̈ + D η̇ + K η = Fᵀ τ, with output F η, F = `position` (n, m); matrices symmetric, M > 0.

    None for m = 0, where a motion without a spring is damped, and where a mode has two poles that are equal within APART.
    """
    if not len(mass):
        return None
    squares, vectors = undamped(mass, stiffness)
    free = np.abs(squares) <= AT_REST * np.abs(squares).max()
    moved = position @ vectors
    damping = vectors.T @ damping @ vectors
    damping = (damping + damping.T) / 2  # to the last digit: far above a slow swing its two poles cancel
    scale = np.abs(np.diagonal(damping)).max(initial=0.0)
    if np.abs(damping[free]).max(initial=0.0) > ALONE * scale:
        return None
    rigid, shapes = moved[:, free] @ moved[:, free].T, moved[:, ~free].T.astype(complex)
    squares, damping = squares[~free], damping[np.ix_(~free, ~free)]
    own, partners = np.diagonal(damping), np.zeros(0, dtype=complex)
    if np.abs(damping - np.diag(own)).max(initial=0.0) <= ALONE * scale:
        root = np.sqrt(own**2 / 4 - squares + 0j)
        poles, partners = -own / 2 + root, -own / 2 - root
        if np.any(np.abs(root) < APART * np.abs(poles)):
            return None
    else:
        poles, parts = _quadratic(squares, damping)
        shapes = parts @ shapes
    return Modes(rigid, shapes, poles, partners)


class ModeStacks(NamedTuple):
    """Modes of one robot in k postures: M₀ (k, n, n), real φ (k, m, n), λ and μ (k, m), relative error bound of each sum (k,)."""

    rigid: Floats
    shapes: Floats
    poles: Complexes
    partners: Complexes
    inexact: Floats


def posture_modes(inverse_inertia: Floats, motor_inertia: Floats, stiffness: Floats, damping: Floats) -> ModeStacks | None:
    """Modes in k postures of joints all rigid, or all elastic with damping proportional to stiffness.

    W (k, n, n), others (n,), as in Plant.

    The gearboxes' twists δ = θ − q obey δ̈ + (W + J⁻¹)(K δ + B δ̇) = J⁻¹ τ. With B = T K and S = K^½ (W + J⁻¹) K^½ = U Λ Uᵀ the motors
    have φ = J⁻¹ K^½ U Λ^(−½), λ and μ are the roots of s² + TΛ s + Λ, and M₀ = W (I + J W)⁻¹. An error dS of S moves the sum by
    |dS| |(Λ (1 + jωT) − ω²)⁻¹| of itself at most, which bounds `inexact`. It is infinite where a mode's poles are as good as one.

    None for other joints, and without damping.
    """
    size, count = len(motor_inertia), len(inverse_inertia)
    rigid = np.linalg.solve(np.eye(size) + inverse_inertia * motor_inertia, inverse_inertia)
    rigid = (rigid + rigid.swapaxes(1, 2)) / 2
    if np.all(np.isinf(stiffness)):
        none = np.zeros((count, 0), dtype=complex)
        return ModeStacks(rigid, np.zeros((count, 0, size)), none, none, np.full(count, ROUNDING * size))
    ratio = damping / stiffness
    if not (np.all(np.isfinite(stiffness)) and ratio[0] > 0 and np.all(np.abs(ratio - ratio[0]) <= ALONE * ratio[0])):
        return None
    root = np.sqrt(stiffness)
    twist = root[:, None] * (inverse_inertia + np.diag(1 / motor_inertia)) * root
    squares, vectors = np.linalg.eigh(twist)
    natural = np.sqrt(squares)
    shapes = ((root / motor_inertia)[:, None] * vectors / natural[:, None, :]).swapaxes(1, 2)
    own = ratio[0] * squares
    apart = np.sqrt(own**2 / 4 - squares + 0j)
    largest = squares[:, -1]
    off = np.linalg.norm((vectors * squares[:, None, :]) @ vectors.swapaxes(1, 2) - twist, axis=(1, 2))
    off += largest * np.linalg.norm(vectors.swapaxes(1, 2) @ vectors - np.eye(size), axis=(1, 2)) + ROUNDING * size * largest
    inexact = off / (squares[:, 0] * np.minimum(LIGHT, ratio[0] * natural[:, 0]))
    inexact[np.any(np.abs(apart) < APART * natural, axis=1)] = np.inf
    return ModeStacks(rigid, np.ascontiguousarray(shapes), -own / 2 + apart, -own / 2 - apart, inexact)


def undamped(mass: Floats, stiffness: Floats) -> tuple[Floats, Floats]:
    """Undamped modes: ω² (m,), rising, and v (m, m) with K v = ω² M v, vᵀMv = 1, for M > 0 and the symmetric part of K."""
    root = np.linalg.cholesky(mass)
    half = np.linalg.solve(root, (stiffness + stiffness.T) / 2)
    squares, vectors = eigensystem(np.linalg.solve(root, half.T))
    return squares, np.linalg.solve(root.T, vectors)


def rough_poles(mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
    """Approximate poles: −δ + jω of each oscillating mode with its own damping, then real poles; none at 0.

    Damping that couples two modes shifts both by about c²/(4 |ω − ω'|), which between lightly damped joints exceeds the width of a
    resonance. Then oscillating poles are computed exactly, so that no sharp resonance is missed between samples.
    """
    squares, shapes = undamped(mass, stiffness)
    coupling = shapes.T @ damping @ shapes
    still = np.abs(squares) <= AT_REST * np.abs(squares).max(initial=0.0)
    slow = _real_poles(np.where(still, 0.0, squares), np.diagonal(coupling) / 2)
    oscillates = (squares > 0) & ~still
    omega, rate = np.sqrt(squares[oscillates]), np.diagonal(coupling)[oscillates] / 2
    found = -rate + 1j * omega
    apart = np.maximum(np.abs(found[:, None] - found), 1e-3 * rate)
    moved = np.square(coupling[np.ix_(oscillates, oscillates)]) / np.where(apart > 0, 4 * apart, np.inf)
    np.fill_diagonal(moved, 0.0)
    sharp = rate < SHARP * omega
    if not np.any(moved.sum(axis=1)[sharp] > 0.1 * rate[sharp]):
        return np.concatenate([found, slow])
    inverse, size = np.linalg.inv(mass), len(mass)
    exact = np.linalg.eigvals(np.block([[np.zeros((size, size)), np.eye(size)], [-inverse @ stiffness, -inverse @ damping]]))
    exact = exact[(exact.imag > 0) & (np.abs(exact) ** 2 > AT_REST * np.abs(squares).max())]
    return np.concatenate([exact, found[~sharp], slow])


def _real_poles(squares: Floats, rate: Floats) -> Floats:
    """Real nonzero roots of s² + 2 rate s + squares: motions that gravity topples, or that dampers bring to rest."""
    rate = np.where(rate > ALONE * rate.max(initial=0.0), rate, 0.0)
    real = squares <= rate**2
    further = -rate[real] - np.sqrt(rate[real] ** 2 - squares[real])  # the other one is their product over this one, to all digits
    nearer = np.divide(squares[real], further, out=np.zeros(len(further)), where=further != 0)
    found = np.concatenate([further, nearer])
    return found[found != 0]


def _quadratic(squares: Floats, damping: Floats) -> tuple[Complexes, Complexes]:
    """Poles λ (2m,) and vectors x (2m, m) with (s² + s D + Ω²)⁻¹ = Σ x xᵀ/(s − λ); vectors of nearly equal poles are made orthogonal.

    Conjugate poles follow each other, with conjugate vectors.
    A z = λ B z with z = (x, λx) and symmetric A and B: zᵀBz = 1 is the scale, zᵀBz' = 0 for another pole.
    """
    count, none, one = len(squares), np.zeros((len(squares), len(squares))), np.eye(len(squares))
    single = []
    poles: Complexes
    vectors: Complexes
    real = np.linalg.eig(np.block([[none, one], [-np.diag(squares), -damping]]))
    # Without an oscillating mode everything is real, but scales may be roots of negative numbers: complex throughout.
    poles, vectors = real.eigenvalues.astype(complex), real.eigenvectors.astype(complex)
    a, b = np.block([[-np.diag(squares), none], [none, one]]), np.block([[damping, one], [one, none]])
    near = np.abs(poles[:, None] - poles) <= SAME * np.abs(poles)
    upper = poles.imag > 0  # a pair's first, as LAPACK has them
    for k in np.flatnonzero(poles.imag >= 0):
        together = np.flatnonzero(near[k] & (poles.imag >= 0))
        if len(together) > 1 and together[0] == k:
            vectors[:, together] = np.linalg.qr(vectors[:, together])[0]
            for _ in range(2):  # orthogonal as to B, then turned so that A is diagonal as far as round-off lets it be told, again
                basis = _scaled(vectors[:, together], b)
                turn = np.linalg.eig(basis.T @ a @ basis)[1]
                vectors[:, together] = basis @ _scaled(turn, np.eye(len(together)))
            poles[together] = np.diagonal(vectors[:, together].T @ a @ vectors[:, together])
        elif len(together) == 1:
            single.append(k)
    poles[single], vectors[:, single] = _polished(squares, damping, poles[single], vectors[:count, single])
    poles[1:][upper[:-1]], vectors[:, 1:][:, upper[:-1]] = poles[upper].conj(), vectors[:, upper].conj()
    return poles, vectors[:count].T


def _polished(squares: Floats, damping: Floats, poles: Complexes, vectors: Complexes) -> tuple[Complexes, Complexes]:
    """Poles λ (k,) and normalised vectors z (2m, k) after one step of Rayleigh quotient iteration from x = `vectors` (m, k).

    Before it, eigenvectors beside modes a thousand times faster (a slow swing and a gearbox) are accurate to 1e-5 only.
    """

    def slopes(values: Complexes) -> Complexes:
        """Derivative T'(λ) (k, m, m) of T(λ) = λ² + λ D + Ω²."""
        found = np.empty((len(values), *damping.shape), dtype=complex)
        found[:] = damping
        diagonals(found)[:] += 2 * values[:, None]
        return found

    form, slope, x = poles[:, None, None] * damping, slopes(poles), vectors.T
    diagonals(form)[:] = poles[:, None] ** 2 + diagonals(form) + squares
    with suppress(np.linalg.LinAlgError):  # of a pole that is exact already
        x = np.linalg.solve(form, slope @ x[:, :, None])[:, :, 0]
        x /= np.abs(x).max(axis=1)[:, None]
    poles = poles - np.einsum("ki,kij,kj->k", x, form, x) / np.einsum("ki,kij,kj->k", x, slope, x)
    x /= np.sqrt(np.einsum("ki,kij,kj->k", x, slopes(poles), x))[:, None]
    return poles, np.concatenate([x, poles[:, None] * x], axis=1).T


def _scaled(vectors: Complexes, form: Floats) -> Complexes:
    """Basis of the span of `vectors` in which the bilinear form is the identity."""
    values, axes = np.linalg.eig(vectors.T @ form @ vectors)
    return vectors @ (axes / np.sqrt(values)) @ np.linalg.inv(axes)
