"""The mode of eigenvalues that are equal, such as those of limbs that do not feel each other.

Every vector in their eigenspace is an eigenvector: round-off decides which one an algorithm finds, and with it which of two legs is named.
"""

import math

import numpy as np

from ..system.linear.arrays import Booleans, Complexes, Floats

EQUAL = 1e-9
"""Relative distance of eigenvalues, and of crossings, that count as equal: eigenvectors of others are known to 1e-7."""
SHIFT = 1e-10
"""Relative shift from an eigenvalue with which a matrix is solved, so that it is not singular."""
SINGLE = 1e-4  # share of a vector's length below which it is the same as another
SAME = 1e-6  # relative difference of parts that count as equal, and relative remainder of a vector that others span


def equal_to(value: complex, values: Complexes) -> Booleans:
    """Mask of those eigenvalues (r,) that equal `value` to EQUAL, relative."""
    return np.abs(values - value) <= EQUAL * abs(value)


def common_mode(vectors: Complexes) -> Complexes:
    """Mode shape (n,) in the span of `vectors` (n, r) in which, as a rule, every joint moves that moves in any; the largest part is 1.

    The mode is a sum of vectors of the span. Each has part 1 at the joint that moves most in the space left by those before it, of equal
    joints the first.
    """
    if vectors.shape[1] == 1:
        return vectors[:, 0] / vectors[_largest(np.abs(vectors[:, 0])), 0]
    lengths = np.linalg.norm(vectors, axis=0)
    basis, sizes, _ = np.linalg.svd(vectors / np.maximum(lengths, SAME * lengths.max()), full_matrices=False)
    basis = basis[:, sizes > SAME * sizes[0]]
    total = np.zeros(len(vectors), dtype=complex)
    while basis.shape[1]:
        pivot = _largest(np.linalg.norm(basis, axis=1))
        row = basis[pivot]
        total += basis @ row.conj() / np.vdot(row, row)
        basis = basis @ np.linalg.svd(row[None, :])[2][1:].conj().T
    return total / total[_largest(np.abs(total))]


def null_vectors(matrix: Complexes) -> Complexes:
    """Orthonormal null vectors (n, r), |M x| ≤ EQUAL, of a nearly singular `matrix` (n, n) with a diagonal about 1.

    Inverse iteration costs less than all eigenvectors. It begins with two vectors, and takes more while all of them are null vectors. If
    both converge to the same there is but one, known to SINGLE.
    """
    count, size = min(2, len(matrix)), len(matrix)
    while True:
        starts = np.exp(1j * np.outer(np.arange(1, size + 1) ** 2, np.arange(1, count + 1)))
        found = np.linalg.solve(matrix, starts)
        first, other = found[:, 0], found[:, -1]
        own = np.vdot(first, first).real
        across = other - first * (np.vdot(first, other) / own)
        if count == 2 and np.vdot(across, across).real <= SINGLE**2 * np.vdot(other, other).real:
            return first[:, None] / math.sqrt(own)
        found = np.linalg.svd(np.linalg.solve(matrix, np.linalg.qr(found)[0]), full_matrices=False)[0]
        null = np.linalg.norm(matrix @ found, axis=0) <= EQUAL
        if count == size or not null.all():
            return found[:, null]
        count = min(2 * count, size)


def _largest(sizes: Floats) -> int:
    """Index of the largest of `sizes`; the first of those equal within round-off."""
    return int(np.argmax(sizes >= sizes.max() * (1 - SAME)))
