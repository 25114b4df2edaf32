"""Gain factors: the largest that passes a test, and its rounding."""

import math
from collections.abc import Callable

from ..design.joint_gains import rounded_down

LOWER = (0.99, 0.97, 0.9, 0.7, 0.5, 0.3, 0.1, 0.03)
"""Shares of the factor with the gain margin at which a test is tried, when margins other than the gain margin are missed there."""


def largest_factor(holds: Callable[[float], bool], most: float) -> float:
    """Largest factor up to `most` at which a test holds, within 0.1 %; it is bracketed at shares LOWER of it. NaN: none holds."""
    if not most > 0 or holds(most):
        return most
    return _between(holds, next((share * most for share in LOWER if holds(share * most)), math.nan), most)


def raised_factor(holds: Callable[[float], bool], held: float) -> float:
    """Largest factor from `held`, at which a test holds, up to 1, within 0.1 %."""
    return 1.0 if holds(1.0) else _between(holds, held, 1.0)


def _between(holds: Callable[[float], bool], held: float, lost: float) -> float:
    """Factor between `held` and `lost` at which the test ceases to hold, within 0.1 %; NaN if `held` is."""
    while lost > 1.001 * held:
        middle = math.sqrt(held * lost)
        held, lost = (middle, lost) if holds(middle) else (held, middle)
    return held


def typed_factor(factor: float) -> float:
    """Factor rounded down to three decimals, or three digits if it is small; NaN if none is known."""
    return math.floor(1000 * factor) / 1000 if factor > 0.01 else rounded_down(factor)
