"""Array types by what they hold. numpy's own dtype parameters follow every promotion and would need a cast at each formula."""

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[Any]
Complexes: TypeAlias = Any  # numpy's stubs give .real and .imag only to arrays of one known dtype
Integers: TypeAlias = NDArray[Any]
Booleans: TypeAlias = NDArray[Any]


def rank(value: float) -> float:
    """Sort key that rounds to 9 digits: values equal within round-off, as of mirrored joints, keep their order."""
    return float(f"{value:.9g}")


def first_least(values: Floats) -> int:
    """Index of the least of `values` (n,); the first of those equal within round-off. NaN sorts last."""
    return int(np.argmin([rank(value) for value in np.where(np.isnan(values), np.inf, values).tolist()]))


def diagonals(matrices: Complexes) -> Complexes:
    """Diagonals (k, n) of C-contiguous matrices (k, n, n), as a writable view."""
    size = matrices.shape[-1]
    return matrices.reshape(len(matrices), size**2)[:, :: size + 1]


def distinct(values: Floats) -> Floats:
    """Distinct entries of `values`, sorted: np.unique without numpy.ma, whose import takes as long as half of numpy."""
    ordered = np.sort(values, axis=None)
    first = np.ones(len(ordered), dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    return ordered[first]


def are_diagonal(matrices: Iterable[Floats]) -> bool:
    """True if no matrix (n, n) has an entry off its diagonal."""
    return all(np.count_nonzero(matrix) == np.count_nonzero(np.diagonal(matrix)) for matrix in matrices)
