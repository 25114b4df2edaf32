"""Matrices that fall apart: limbs on a fixed base do not feel each other, and what is asked of a matrix is asked of its small blocks."""

from collections.abc import Callable

import numpy as np

from ...native import _core
from .arrays import Booleans, Complexes, Floats, Integers, distinct


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
    """Of matrices (k, n, n), block by block (k, n). Raises numpy.linalg.LinAlgError where they do not settle."""
    count = len(matrices)
    found = [_of_blocks(_core.eigenvalues, matrices, parts).reshape(count, parts.size) for parts in _parts(matrices)]
    return np.concatenate([np.zeros((count, 0), dtype=complex), *found], axis=1)


def inverses(matrices: Complexes) -> Complexes:
    """Of matrices (k, n, n), block by block. Raises numpy.linalg.LinAlgError for singular ones."""
    found = np.zeros_like(matrices)
    for parts in _parts(matrices):
        own = _of_blocks(_core.inverses, matrices, parts).reshape(len(matrices), *parts.shape, parts.shape[1])
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


def _of_blocks(function: Callable[[Complexes], Complexes], matrices: Complexes, parts: Integers) -> Complexes:
    """What `function` of the core finds of all blocks (k g, s, s) of all matrices."""
    size = parts.shape[1]
    try:
        return function(np.ascontiguousarray(blocks(matrices, parts), dtype=complex).reshape(-1, size, size))
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error


def _parts(matrices: Complexes) -> list[Integers]:
    """Of all matrices (k, n, n) together."""
    return parts_of(np.any(matrices != 0, axis=0))
