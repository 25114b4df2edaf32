"""Factors on gains: the largest that is good, and how it is typed."""

import math
from collections.abc import Callable

from ..design.joint_gains import rounded_down

LOWER = (0.99, 0.97, 0.9, 0.7, 0.5, 0.3, 0.1, 0.03)
"""Of gains that have the gain margin and too little else: where lower ones are looked at."""


def largest_factor(holds: Callable[[float], bool], most: float) -> float:
    """The largest factor up to `most` at which a test holds, within 0.1 %, where it holds below: at LOWER of it; NaN: nowhere there."""
    if not most > 0 or holds(most):
        return most
    return _between(holds, next((share * most for share in LOWER if holds(share * most)), math.nan), most)


def raised_factor(holds: Callable[[float], bool], held: float) -> float:
    """The largest factor from `held`, at which a test holds, up to 1, within 0.1 %, where it holds below it."""
    return 1.0 if holds(1.0) else _between(holds, held, 1.0)


def _between(holds: Callable[[float], bool], held: float, lost: float) -> float:
    """Where between the two a test ceases to hold, within 0.1 %; NaN where `held` is."""
    while lost > 1.001 * held:
        middle = math.sqrt(held * lost)
        held, lost = (middle, lost) if holds(middle) else (held, middle)
    return held


def typed_factor(factor: float) -> float:
    """A factor on gains as it is typed: three decimals, three digits where it is small, never rounded up; NaN where none is known."""
    return math.floor(1000 * factor) / 1000 if factor > 0.01 else rounded_down(factor)
