"""The structured singular value of complex matrices for n independent complex factors: bounds from above and below, many at once.

μ(M) = 1 / min{ max|δ_i| : det(I − M diag(δ)) = 0 }, Packard and Doyle 1993.

From above: μ ≤ min σ_max(D M D⁻¹) over D = diag(e^x) > 0, convex in x (Sezginer and Overton 1990) and equal to μ for n ≤ 3. σ_max has kinks
where the largest singular values meet, which equal legs make the rule. Schatten norms have none: log‖D M D⁻¹‖_q = log(Σ σ_k^q)/q is
convex in x as well (Hadamard's three lines), lies above log σ_max by log(n)/q at most, and is balancing (Osborne 1960) at q = 2.
So Newton's method follows its minimum while q rises.

From below: any eigenvalue of M diag(q) with |q_i| = 1; the power iteration of Packard, Fan and Doyle 1988 finds a large one.
"""

from typing import NamedTuple

import numpy as np

from ..linear.arrays import Complexes, Floats

TOLERANCE = 1e-7  # of log σ_max, at which the search for D ends
FIRST_POWER = 64.0
SHARPEN, LATE = 4.0, 3  # factor on q once its minimum has been reached; after so many times the path of minima is followed straight on
NEWTON_STEPS = 80
LARGEST_STEP = 8.0  # of x
SMALLEST_ENTRY = 1e-9  # entries below this part of the largest count as this part: a triangular M would send D to infinity
POWER_STEPS, STARTS = 60, 8
SMALLEST = 1e-300


class Bounds(NamedTuple):
    """lower ≤ μ ≤ upper; scaling (n,): log of the D that gives `upper`; phases (n,): q, with |eigenvalue| `lower` of M diag(q)."""

    lower: float
    upper: float
    scaling: Floats
    phases: Complexes


def structured_singular_value(matrix: Complexes) -> Bounds:
    """Both bounds for one complex matrix (n, n)."""
    scaling, upper = improved(matrix[None], balanced(matrix[None]))
    lower, phases = from_below(scaled(matrix[None], scaling)[0])
    return Bounds(min(lower, float(upper[0])), float(upper[0]), scaling[0], phases)


def scaled(matrices: Complexes, scaling: Floats) -> Complexes:
    """D M D⁻¹ with D = diag(e^x): matrices (k, n, n), scaling x (k, n)."""
    return matrices * np.exp(scaling[:, :, None] - scaling[:, None, :])


def largest(matrices: Complexes) -> Floats:
    """σ_max (k,)."""
    return np.linalg.svd(matrices, compute_uv=False)[:, 0]


def balanced(matrices: Complexes) -> Floats:
    """x (k, n) that nearly minimises the Frobenius norm of D M D⁻¹, by Newton's method on its convex logarithm."""
    size = matrices.shape[1]
    diagonal = np.arange(size)
    squares = np.abs(matrices) ** 2
    squares += SMALLEST_ENTRY**2 * np.max(squares, axis=(1, 2), keepdims=True) + SMALLEST
    squares[:, diagonal, diagonal] = 0.0
    scaling = np.zeros(matrices.shape[:2])
    for _ in range(8 if size > 1 else 0):
        now = squares * np.exp(2 * (scaling[:, :, None] - scaling[:, None, :]))
        rows, columns = now.sum(axis=2), now.sum(axis=1)
        if np.all(np.abs(rows - columns) <= 0.05 * (rows + columns)):
            break
        hessian = -(now + now.swapaxes(1, 2))
        hessian[:, diagonal, diagonal] += rows + columns
        # Constant x changes nothing, nor does a common factor on loops that are not coupled: filled up, so that there is a solution.
        hessian += (rows.sum(axis=1) * 2 / size)[:, None, None] * (1 / size + 1e-6 * np.eye(size))
        step = np.linalg.solve(hessian, (columns - rows)[:, :, None])[:, :, 0] / 2
        scaling += _limited(step, 1.5)
    return _centred(scaling)


def improved(matrices: Complexes, start: Floats, tolerance: float = TOLERANCE) -> tuple[Floats, Floats]:
    """x (k, n) and σ_max(D M D⁻¹) (k,), within `tolerance` (relative) of the least where Newton's method gets there."""
    count = len(start)
    x, trial, anchor, best_x = start.copy(), start.copy(), start.copy(), start.copy()
    best, height = np.full(count, np.inf), np.full(count, np.inf)
    power, damping, levels = np.full(count, FIRST_POWER), np.full(count, 1e-3), np.zeros(count, dtype=int)
    slope, curvature = np.zeros(start.shape), np.zeros((*start.shape, start.shape[1]))
    active = np.arange(count)
    for _ in range(NEWTON_STEPS):
        left, values, right = np.linalg.svd(scaled(matrices[active], trial[active]))
        better = values[:, 0] < best[active]
        best_x[active[better]], best[active[better]] = trial[active[better]], values[better, 0]
        fresh = _height(values, power[active])
        down = fresh <= height[active] + 1e-15
        taken = active[down]
        x[taken], height[taken] = trial[taken], fresh[down]
        damping[taken] = np.maximum(damping[taken] / 10, 1e-9)
        damping[active[~down]] *= 8
        slope[taken], curvature[taken] = _derivatives(left[down], values[down], right[down], power[taken])
        step = _newton_step(slope[active], curvature[active], damping[active])
        promise = -np.sum(slope[active] * step, axis=1)  # about twice what the step gains
        excess = fresh - _height(values, np.inf)
        reached = down & (promise < 0.3 * np.maximum(excess, tolerance))
        finished = (reached & (promise + excess < tolerance)) | (damping[active] > 1e9)
        sharper = active[reached]
        if len(sharper):
            power[sharper] *= SHARPEN
            height[sharper] = _height(values[reached], power[sharper])
            slope[sharper], curvature[sharper] = _derivatives(left[reached], values[reached], right[reached], power[sharper])
            late = levels[sharper] >= LATE
            ahead = (x[sharper] - anchor[sharper]) / SHARPEN  # the minima approach the last one as 1/q
            step[reached] = np.where(late[:, None], ahead, _newton_step(slope[sharper], curvature[sharper], damping[sharper]))
            height[sharper[late]] = np.inf
            anchor[sharper] = x[sharper]
            levels[sharper] += 1
        trial[active] = x[active] + step
        active = active[~finished]
        if not len(active):
            break
    return _centred(best_x), best


def _height(values: Floats, power: Floats | float) -> Floats:
    """log(Σ σ^q)/q (k,)."""
    highest = np.log(np.maximum(values[:, 0], SMALLEST))
    if np.ndim(power) == 0:
        return highest
    return highest + np.log(np.maximum(np.sum(_relative(values) ** np.reshape(power, (-1, 1)), axis=1), 1.0)) / power


def _relative(values: Floats) -> Floats:
    """Singular values (k, n), the largest 1: log‖·‖ has the same derivatives for any multiple."""
    return np.where(values[:, :1] > 0, values / np.maximum(values[:, :1], SMALLEST), 1.0)


def _newton_step(slope: Floats, curvature: Floats, damping: Floats) -> Floats:
    size = slope.shape[1]
    mean = np.trace(curvature, axis1=1, axis2=2) / size + 1e-12
    filled = curvature + (mean * damping)[:, None, None] * np.eye(size) + (mean / size)[:, None, None]
    return _limited(-np.linalg.solve(filled, slope[:, :, None])[:, :, 0], LARGEST_STEP)


def _limited(step: Floats, most: float) -> Floats:
    """`step` (k, n), shortened where an entry exceeds `most`."""
    return step * np.minimum(1.0, most / np.maximum(np.abs(step).max(axis=1, keepdims=True), SMALLEST))


def _centred(x: Floats) -> Floats:
    return x - x.mean(axis=1, keepdims=True)


def _derivatives(left: Complexes, values: Floats, right: Complexes, power: Floats) -> tuple[Floats, Floats]:
    """Gradient (k, n) and Hessian (k, n, n) of log‖D M D⁻¹‖_q in x, from the singular value decomposition.

    With dx = ξ, A = Uᴴ diag(ξ) U, B = Vᴴ diag(ξ) V and p = q/2, perturbation theory of the eigenvalues λ = σ² of the Gram matrix H gives
    dH_kl = 2 σ_k σ_l A_kl − (λ_k + λ_l) B_kl and d² tr H^p = p tr(H^(p−1) d²H) + p Σ |dH_kl|² (λ_k^(p−1) − λ_l^(p−1))/(λ_k − λ_l).
    Pairs without one of the singular values that carry the norm are left out.
    """
    count, size = values.shape
    exponent = power[:, None, None] / 2
    sigma = np.maximum(_relative(values), 1e-12)
    lam, log_lam = sigma**2, 2 * np.log(sigma)
    weight = np.exp(exponent[:, :, 0] * log_lam)
    total = weight.sum(axis=1)
    weight /= total[:, None]
    top = int(np.count_nonzero(weight > 1e-14, axis=1).max(initial=1))
    right = right.conj().swapaxes(1, 2)
    slope = np.einsum("ck,cik->ci", weight, np.abs(left) ** 2 - np.abs(right) ** 2)

    row, column = lam[:, :top, None], lam[:, None, :]
    bigger = np.maximum(log_lam[:, :top, None], log_lam[:, None, :])
    fall = -np.abs(log_lam[:, :top, None] - log_lam[:, None, :])
    near = fall > -1e-12
    between = np.where(near, exponent - 1, np.expm1((exponent - 1) * fall) / np.where(near, 1.0, np.expm1(fall)))
    theta = np.exp((exponent - 2) * bigger) * between / total[:, None, None]
    theta[:, :, top:] *= 2  # for the pair in the other order
    both = sigma[:, :top, None] * sigma[:, None, :]
    share = weight[:, :top, None]
    flat = (count, 1, top * size)
    on_left = (2 * share + 2 * row * column * theta).reshape(flat)
    on_right = (share + share * column / row + 0.5 * (row + column) ** 2 * theta).reshape(flat)
    across = (-4 * share / row * both - 2 * both * (row + column) * theta).reshape(flat)
    by_left = (left.conj()[:, :, :top, None] * left[:, :, None, :]).reshape(count, size, top * size)
    by_right = (right.conj()[:, :, :top, None] * right[:, :, None, :]).reshape(count, size, top * size)
    curvature = ((by_left * on_left + by_right * across) @ by_left.conj().swapaxes(1, 2)).real
    curvature += ((by_right * on_right) @ by_right.conj().swapaxes(1, 2)).real
    curvature = (curvature + curvature.swapaxes(1, 2)) / 2
    return slope, curvature - power[:, None, None] * slope[:, :, None] * slope[:, None, :]


def from_below(matrix: Complexes) -> tuple[float, Complexes]:
    """The largest |eigenvalue| of M diag(q) found, and q (n,): power iterations side by side, from the largest singular vectors."""
    size = len(matrix)
    left, values, right = np.linalg.svd(matrix)
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(size, STARTS)) + 1j * rng.normal(size=(size, STARTS))
    mixing *= (values / max(values[0], SMALLEST))[:, None] ** np.linspace(40, 1, STARTS)
    mixing[:, 0] = np.eye(size)[0]
    b, w, a = right.conj().T @ mixing, left @ mixing, left @ mixing
    for _ in range(POWER_STEPS):
        before, a = a, _unit(matrix @ b)
        w = _unit(matrix.conj().T @ (np.abs(w) * _sign(a)))
        b = np.abs(a) * _sign(w)
        if np.abs(a - before).max() < 1e-9:
            break
    phases = _sign(w) * _sign(a).conj()
    radii = np.abs(np.linalg.eigvals(matrix * phases.T[:, None, :])).max(axis=1)
    best = int(np.argmax(radii))
    return float(radii[best]), phases[:, best]


def _unit(columns: Complexes) -> Complexes:
    return columns / np.maximum(np.linalg.norm(columns, axis=0), SMALLEST)


def _sign(value: Complexes) -> Complexes:
    size = np.abs(value)
    return np.where(size > 0, value / np.where(size > 0, size, 1.0), 1.0)
