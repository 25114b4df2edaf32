"""The gains (kp, kd) of one part of a controller that are good in several loops at once: a robot in all its states.

Gains that are stable in every loop are where the stable gains of all overlap (part_region.py). In each of them the part's own loop keeps
the required margins (part_region_margins.py), and where a gain margin is required all gains together do: any common factor within it
leaves the loop stable, which is checked for FACTORS of them. With `others` every other loop keeps them, too (part_region_other_loops.py),
and all loops together any common phase (part_region_common_phase.py): these are all requirements there are. Sampled, not certified.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..system.excluded_sets import Arc, Segment
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from ..system.requirements import Requirements
from .part_region import PartRegion
from .part_region_common_phase import CommonPhase
from .part_region_margins import overlap, required_columns
from .part_region_other_loops import OtherLoops

FACTORS = 4  # factors on all gains, beside 1, at which stability is checked for a gain margin
Columns = Callable[[Floats], list[Floats]]
"""Function from kp (m,) to the allowed kd, sorted open intervals (p, 2) per kp."""


@dataclass(frozen=True)
class RegionInEveryState:
    """Allowed gains (kp, kd) of the same part in each of `loops`, those of one robot's states; gains up to `window`.

    checkpoint   called between loops; it ends the computation by raising
    """

    loops: Sequence[tuple[Loop, LoopPart]]
    window: tuple[float, float]
    checkpoint: Callable[[], None] = lambda: None

    @cached_property
    def planes(self) -> list[PartRegion]:
        """Gain planes with the present gains, one per loop."""
        return [self._plane(*each) for each in self.loops]

    def _plane(self, loop: Loop, part: LoopPart) -> PartRegion:
        self.checkpoint()
        return PartRegion.of(loop, part, self.window)

    @cached_property
    def _found(self) -> dict[Requirements, list[Floats]]:
        """Intervals of kd with which the part's own loop and all gains together meet requirements, by requirements; at the outlines' kp."""
        return {}

    def stable(self) -> tuple[Floats, ...]:
        """Outlines of the gains that are stable in every loop, as PartRegion.outlines. Raises GainroomError as PartRegion.columns."""
        return self._outlines(lambda kps: self._narrowed(kps, self._all(kps), (plane.columns for plane in self.planes)))

    def required(self, asked: Requirements, others: bool = False) -> tuple[Floats, ...]:
        """Outlines of the stable gains that also meet `asked`; `others`: also in the loops of all other parts, and of all together."""

        def columns(kps: Floats) -> list[Floats]:
            if asked not in self._found:
                self._found[asked] = self._narrowed(kps, self._all(kps), self._own(asked))
            return self._narrowed(kps, self._found[asked], self._others(asked) if others and asked.asked else ())

        return self._outlines(columns)

    def _own(self, asked: Requirements) -> Iterator[Columns]:
        """Checks of the part's own loop, and of stability with common factors on all gains."""
        yield from (partial(required_columns, plane, asked) for plane in self.planes)
        widest = max((shape.factor for shape in _shapes(asked) if isinstance(shape, Segment)), default=1.0)
        factors = [factor for factor in np.geomspace(1 / widest, widest, FACTORS + 1).tolist() if abs(factor - 1) > 1e-9]
        yield from (self._plane(loop.scaled(factor), part).columns for loop, part in self.loops for factor in factors)

    def _others(self, asked: Requirements) -> Iterator[Columns]:
        """Checks of all other loops, and of a common phase in all together."""
        angle = max((shape.angle for shape in _shapes(asked) if isinstance(shape, Arc)), default=0.0)
        for each, plane in zip(self.loops, self.planes, strict=True):
            other = OtherLoops(*each, plane, self.window)
            yield from (partial(other.columns, one, needed) for one, needed in asked.asked_for)
            if angle:
                yield CommonPhase(*each, plane, angle, self.window).columns

    def _all(self, kps: Floats) -> list[Floats]:
        return [np.array([[0.0, 2 * self.window[1]]])] * len(kps)

    def _narrowed(self, kps: Floats, begun: Sequence[Floats], checks: Iterable[Columns]) -> list[Floats]:
        """Intervals of kd, one array per kp, left after each check; an empty one is not checked further."""
        left = list(begun)
        for check in checks:
            self.checkpoint()
            alive: Any = np.flatnonzero([len(one) for one in left])
            if not len(alive):
                break
            for k, found in zip(alive.tolist(), check(kps[alive]), strict=True):
                left[k] = overlap(left[k], found)
        return left

    def _outlines(self, columns: Columns) -> tuple[Floats, ...]:
        return max(self.planes, key=lambda plane: plane.static).outlines(self.window, columns)


def _shapes(asked: Requirements) -> list[Any]:
    return [one.excluded(needed) for one, needed in asked.asked_for]
