"""Linear algebra by uncoupled blocks: groups of joints that do not interact (limbs on a fixed base) are solved as small matrices."""

import numpy as np

from ...native import _core
from .arrays import Booleans, Complexes, Floats, Integers, distinct


def parts_of(coupled: Booleans) -> list[Integers]:
    """Uncoupled groups of rows of a square pattern (n, n): one array (g, s) for each group size s, rows rising."""
    label = np.arange(len(coupled))
    both = coupled | coupled.T | np.eye(len(coupled), dtype=bool)
    while not np.array_equal(least := np.where(both, label, len(label)).min(axis=1, initial=len(label)), label):
        label = least
    parts = [np.flatnonzero(label == one) for one in distinct(label)]
    return [np.array([part for part in parts if len(part) == size]) for size in sorted({len(part) for part in parts})]


def blocks(matrices: Floats | Complexes, parts: Integers) -> Floats | Complexes:
    """Diagonal blocks (..., g, s, s) of matrices (..., n, n), for groups of rows `parts` (g, s)."""
    return matrices[..., parts[:, :, None], parts[:, None, :]]


def inverses(matrices: Complexes) -> Complexes:
    """Inverses of matrices (k, n, n), block by block. Raises numpy.linalg.LinAlgError for singular ones."""
    found = np.zeros_like(matrices)
    for parts in _parts(matrices):
        own = _inverses(_stacked(matrices, parts)).reshape(len(matrices), *parts.shape, parts.shape[1])
        found[:, parts[:, :, None], parts[:, None, :]] = own
    return found


def eigensystem(matrix: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (n,), rising, and orthonormal eigenvectors (n, n) of a symmetric matrix; each vector lies in a single block."""
    values, vectors, start = np.zeros(len(matrix)), np.zeros(matrix.shape), 0
    for parts in parts_of(matrix != 0):
        own, turned = np.linalg.eigh(blocks(matrix, parts))
        places = start + np.arange(parts.size).reshape(parts.shape)
        values[places] = own
        vectors[parts[:, :, None], places[:, None, :]] = turned
        start += parts.size
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def _stacked(matrices: Complexes, parts: Integers) -> Complexes:
    """Blocks of all matrices, stacked (k g, s, s)."""
    size = parts.shape[1]
    return np.ascontiguousarray(blocks(matrices, parts), dtype=complex).reshape(-1, size, size)


def _inverses(stack: Complexes) -> Complexes:
    try:
        return _core.inverses(stack)
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def _parts(matrices: Complexes) -> list[Integers]:
    """Uncoupled groups shared by all matrices (k, n, n)."""
    return parts_of(np.any(matrices != 0, axis=0))
