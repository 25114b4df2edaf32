"""The structured singular value of complex matrices for n independent complex factors: bounds from above and below, in the core.

μ(M) = 1 / min{ max|δ_i| : det(I − M diag(δ)) = 0 }, Packard and Doyle 1993; how it is bounded is said in structured_value.hpp.
"""

import numpy as np

from ..native import _core
from ..system.linear.arrays import Complexes, Floats

TOLERANCE = 1e-7  # of log σ_max, at which the search for D ends
MET = 1e-9  # where both bounds of μ are this near each other, relative, none is looked for any more


def scaled(matrices: Complexes, scaling: Floats) -> Complexes:
    """D M D⁻¹ with D = diag(e^x): matrices (k, n, n), scaling x (k, n)."""
    return matrices * np.exp(scaling[:, :, None] - scaling[:, None, :])


def largest(matrices: Complexes) -> Floats:
    """σ_max (k,)."""
    return np.linalg.svd(matrices, compute_uv=False)[:, 0]


def balanced(matrices: Complexes) -> Floats:
    """x (k, n) that nearly minimises the Frobenius norm of D M D⁻¹, of matrices (k, n, n)."""
    return _core.balanced(np.ascontiguousarray(matrices, dtype=complex))


def improved(matrices: Complexes, start: Floats, tolerance: float = TOLERANCE) -> tuple[Floats, Floats]:
    """x (k, n) and σ_max(D M D⁻¹) (k,), within `tolerance` (relative) of the least where Newton's method gets there from `start` (k, n)."""
    x, heights = _core.improved(np.ascontiguousarray(matrices, dtype=complex), np.ascontiguousarray(start), tolerance)
    return x, heights[:, 0]


def from_below(matrix: Complexes, upper: float) -> tuple[float, Complexes]:
    """The largest |eigenvalue| of M diag(q) found, and q (n,); the search ends where it meets the bound `upper`."""
    lower, phases = _core.from_below(np.ascontiguousarray(matrix, dtype=complex), upper * (1 - MET))
    return lower, phases[:, 0]
