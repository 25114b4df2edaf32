"""Array types by what they hold. numpy's own dtype parameters follow every promotion and would need a cast at each formula."""

from typing import Any, TypeAlias

from numpy.typing import NDArray

Floats: TypeAlias = NDArray[Any]
Complexes: TypeAlias = Any  # numpy's stubs give .real and .imag only to arrays of one known dtype
Integers: TypeAlias = NDArray[Any]
Booleans: TypeAlias = NDArray[Any]
