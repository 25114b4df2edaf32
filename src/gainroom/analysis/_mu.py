"""Bounds of the structured singular value of complex matrices for n independent complex factors, from above and below, in the core.

μ(M) = 1 / min{ max|δ_i| : det(I − M diag(δ)) = 0 }, Packard and Doyle 1993. The method is described in structured_value.hpp.
"""

import numpy as np

from ..native import _core
from ..system.linear.arrays import Complexes, Floats

TOLERANCE = 1e-7  # decrease of log σ_max per step at which the search for D ends
MET = 1e-9  # relative distance of the two bounds of μ at which the search for a higher lower bound ends


def scaled(matrices: Complexes, scaling: Floats) -> Complexes:
    """D M D⁻¹ with D = diag(e^x): matrices (k, n, n), scaling x (k, n)."""
    return matrices * np.exp(scaling[:, :, None] - scaling[:, None, :])


def largest(matrices: Complexes) -> Floats:
    """Largest singular value σ_max (k,) of each of `matrices` (k, n, n)."""
    return np.linalg.svd(matrices, compute_uv=False)[:, 0]


def balanced(matrices: Complexes) -> Floats:
    """Scaling x (k, n) that nearly minimises the Frobenius norm of D M D⁻¹, D = diag(e^x), for each of `matrices` (k, n, n)."""
    return _core.balanced(np.ascontiguousarray(matrices, dtype=complex))


def improved(matrices: Complexes, start: Floats, tolerance: float = TOLERANCE) -> tuple[Floats, Floats]:
    """Scaling x (k, n) that minimises σ_max(D M D⁻¹), D = diag(e^x), and these σ_max (k,), by Newton's method from `start` (k, n).

    The minima are relative to `tolerance` where the method converges; elsewhere x is the best that it reached, still an upper bound of μ.
    """
    x, heights = _core.improved(np.ascontiguousarray(matrices, dtype=complex), np.ascontiguousarray(start), tolerance)
    return x, heights[:, 0]


def from_below(matrix: Complexes, upper: float) -> tuple[float, Complexes]:
    """Lower bound of μ(M) and its q (n,): the largest |eigenvalue| of M diag(q) found over |q_i| = 1; the search ends at `upper`."""
    lower, phases = _core.from_below(np.ascontiguousarray(matrix, dtype=complex), upper * (1 - MET))
    return lower, phases[:, 0]
