"""Array types by what they hold. numpy's own dtype parameters follow every promotion and would need a cast at each formula."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[Any]
Complexes: TypeAlias = Any  # numpy's stubs give .real and .imag only to arrays of one known dtype
Integers: TypeAlias = NDArray[Any]
Booleans: TypeAlias = NDArray[Any]


def distinct(values: Floats) -> Floats:
    """The different ones of `values`, sorted: np.unique without numpy.ma, whose import takes as long as half of numpy."""
    ordered = np.sort(values, axis=None)
    first = np.ones(len(ordered), dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=first[1:])
    return ordered[first]
