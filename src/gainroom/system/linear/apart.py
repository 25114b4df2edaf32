"""Matrices that fall apart: limbs on a fixed base do not feel each other, and what is asked of a matrix is asked of its small blocks."""

import numpy as np

from ...native import _core
from .arrays import Booleans, Complexes, Floats, Integers, distinct

OFF = 1e-8
"""Of eigenvalues of 1, about; of 1e-3, which a factor of 1000 brings to −1, 1e-5 at most."""


def parts_of(coupled: Booleans) -> list[Integers]:
    """Rows of a square pattern (n, n) in groups between which nothing couples: (g, s) those of every size s, each rising."""
    label = np.arange(len(coupled))
    both = coupled | coupled.T | np.eye(len(coupled), dtype=bool)
    while not np.array_equal(least := np.where(both, label, len(label)).min(axis=1, initial=len(label)), label):
        label = least
    parts = [np.flatnonzero(label == one) for one in distinct(label)]
    return [np.array([part for part in parts if len(part) == size]) for size in sorted({len(part) for part in parts})]


def blocks(matrices: Floats | Complexes, parts: Integers) -> Floats | Complexes:
    """Of matrices (..., n, n), those of parts (g, s): (..., g, s, s)."""
    return matrices[..., parts[:, :, None], parts[:, None, :]]


def eigenvalues(matrices: Complexes) -> Complexes:
    """Of matrices (k, n, n), block by block (k, n): off by about OFF, or to all digits of the largest where that is more."""
    count = len(matrices)
    found = [_eigenvalues(_stacked(matrices, parts)).reshape(count, parts.size) for parts in _parts(matrices)]
    return np.concatenate([np.zeros((count, 0), dtype=complex), *found], axis=1)


def inverses(matrices: Complexes) -> Complexes:
    """Of matrices (k, n, n), block by block. Raises numpy.linalg.LinAlgError for singular ones."""
    found = np.zeros_like(matrices)
    for parts in _parts(matrices):
        own = _inverses(_stacked(matrices, parts)).reshape(len(matrices), *parts.shape, parts.shape[1])
        found[:, parts[:, :, None], parts[:, None, :]] = own
    return found


def eigensystem(matrix: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (n,), rising, and orthonormal vectors (n, n) of a symmetric one, each of a single block."""
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
    """All blocks of all matrices (k g, s, s)."""
    size = parts.shape[1]
    return np.ascontiguousarray(blocks(matrices, parts), dtype=complex).reshape(-1, size, size)


def _eigenvalues(stack: Complexes) -> Complexes:
    """Where the core's may be off by more, numpy's: they balance what is large and small."""
    found = _core.symmetric_eigenvalues(stack, OFF)
    left = np.isnan(found[:, 0])
    found[left] = np.linalg.eigvals(stack[left])
    return found


def _inverses(stack: Complexes) -> Complexes:
    try:
        return _core.inverses(stack)
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def _parts(matrices: Complexes) -> list[Integers]:
    """Of all matrices (k, n, n) together."""
    return parts_of(np.any(matrices != 0, axis=0))
