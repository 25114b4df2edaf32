"""Gains for several coupled loops: how far a shape of gains can be scaled while every requirement holds, in every case.

A shape is a controller for each scale σ > 0; here only the stiffness grows with it, for several dampings in turn, and the stiffest result
is taken. A case is a posture, a contact state and a place in the uncertainty. The largest σ is bracketed and bisected on the case that
stands in the way; the others are screened with the answer, and any that breaks a requirement takes its place.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .errors import GainroomError
from .forbidden import Requirements
from .kept import Kept, kept_by
from .loop import Loop

Case = Callable[[float], Loop]
"""σ → the loop with gains of that scale."""
SMALLEST, LARGEST = 1e-4, 1e4  # of the scales that are tried
STEP = 1.5  # between scales that are tried
MOST_UP = 9  # of them above a scale that does not hold, where gravity asks for gains
ACCURACY = 0.02  # relative, of the scale; the answer is rounded towards the safe side


@dataclass(frozen=True)
class Scaled:
    """The largest scale that keeps the requirements in every case.

    scale     σ; 0 where none on the ladder keeps them
    binding   index of the case that stands in the way
    kept      what each case keeps at that scale, in the order of the cases
    """

    scale: float
    binding: int
    kept: tuple[Kept, ...]


def largest_scale(
    cases: Sequence[Case],
    required: Requirements,
    progress: Callable[[], None] = lambda: None,
    start: float = 1.0,
    first: int = 0,
    known: float = 0.0,
    weighed: bool = False,
) -> Scaled:
    """The largest scale of gains that keeps `required` in every case. `progress` is called after every loop that is looked at.

    start, first   a guess at the scale, and at the case that stands in the way
    known          a scale that is known to keep them in every case: the answer is not smaller
    weighed        gravity counts, so that too small a scale may not do, either: larger ones than `start` are tried, too

    Else assumes that a smaller scale is safer, as it is for PD gains around a plant without gravity; the answer is checked in every case.
    Raises GainroomError without cases or requirements.
    """
    if not cases or not required.asked:
        raise GainroomError("largest_scale needs at least one case and one requirement")

    def look(case: Case, scale: float) -> Kept:
        found = kept_by(case(scale))
        progress()
        return found

    binding, scale = first, _largest_of_one(lambda scale: look(cases[first], scale).meets(required), start, known, weighed)
    for _ in range(3 * len(cases)):
        if scale == 0:
            return Scaled(0.0, binding, ())
        kept = [look(case, scale) for case in cases]
        broken = [k for k, one in enumerate(kept) if not one.meets(required)]
        if not broken:
            return Scaled(scale, binding, tuple(kept))
        binding = max(broken, key=lambda k: kept[k].shortfall(required))
        case = cases[binding]
        scale = _largest_of_one(lambda scale, case=case: look(case, scale).meets(required), scale / (1 + ACCURACY), known, weighed)
    return Scaled(known, binding, tuple(look(case, known) for case in cases)) if known else Scaled(0.0, binding, ())


def _largest_of_one(holds: Callable[[float], bool], start: float, known: float, weighed: bool) -> float:
    """The largest scale at which `holds`, within ACCURACY below it and >= `known`, at which it is known to; 0 where none is found."""
    inside, outside, step = known or None, None, 1.0
    if start > known:
        inside, outside = (start, None) if holds(start) else (inside, start)
    if inside is None and weighed:
        inside = next((start * STEP**k for k in range(1, MOST_UP) if holds(start * STEP**k)), None)
        outside = None if inside is not None else start
    while inside is None or outside is None:
        step *= STEP  # a poor guess is left behind quickly
        trial = step * inside if inside is not None else (outside or start) / step
        if not SMALLEST < trial < LARGEST:
            return inside or 0.0
        if holds(trial):
            inside = trial
        else:
            outside = trial
    while outside / inside > 1 + ACCURACY:
        middle = math.sqrt(inside * outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside
