"""The gains (kp, kd) of one part of a controller that are good in several loops at once: a robot in all its states.

What is stable in every loop is where the stable gains of all overlap (part_plane.py). In each of them the part's own loop keeps the
required margins (part_requirements.py), and where a gain margin is required all gains together do: any common factor within it leaves the
loop stable, which is looked at for FACTORS of them. With `others` every other loop keeps them, too (other_loops.py), and all loops
together any common phase (common_phase_plane.py): then everything that is asked for has been looked at. Sampled, not certified.
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
from .common_phase_plane import CommonPhase
from .other_loops import OtherLoops
from .part_plane import PartPlane
from .part_requirements import overlap, required_columns

FACTORS = 4  # beside 1
Look = Callable[[Floats], list[Floats]]
"""From kp (m,) to the kd that are good, as sorted open intervals."""


@dataclass(frozen=True)
class EveryLoop:
    """The same part in each of `loops`, which are those of one robot; gains up to `window`.

    checkpoint   called between loops; it ends what goes on by raising
    """

    loops: Sequence[tuple[Loop, LoopPart]]
    window: tuple[float, float]
    checkpoint: Callable[[], None] = lambda: None

    @cached_property
    def planes(self) -> list[PartPlane]:
        """Of the gains as they are, one per loop."""
        return [self._plane(*each) for each in self.loops]

    def _plane(self, loop: Loop, part: LoopPart) -> PartPlane:
        self.checkpoint()
        return PartPlane.of(loop, part, self.window)

    @cached_property
    def _kept(self) -> dict[Requirements, list[Floats]]:
        """What the part's own loop and all gains together keep, at the one set of kp that the outlines have."""
        return {}

    def stable(self) -> tuple[Floats, ...]:
        """Outlines of the gains that are stable in every loop, as PartPlane.outlines. Raises GainroomError as PartPlane.columns."""
        return self._outlines(lambda kps: self._narrowed(kps, self._all(kps), (plane.columns for plane in self.planes)))

    def required(self, asked: Requirements, others: bool = False) -> tuple[Floats, ...]:
        """The same of those that also keep what is asked for; `others`: in the loops of all other parts, and of all together, too."""

        def columns(kps: Floats) -> list[Floats]:
            if asked not in self._kept:
                self._kept[asked] = self._narrowed(kps, self._all(kps), self._own(asked))
            return self._narrowed(kps, self._kept[asked], self._others(asked) if others and asked.asked else ())

        return self._outlines(columns)

    def _own(self, asked: Requirements) -> Iterator[Look]:
        """Of the part's own loop, and of all gains together."""
        yield from (partial(required_columns, plane, asked) for plane in self.planes)
        widest = max((shape.factor for shape in _shapes(asked) if isinstance(shape, Segment)), default=1.0)
        factors = [factor for factor in np.geomspace(1 / widest, widest, FACTORS + 1).tolist() if abs(factor - 1) > 1e-9]
        yield from (self._plane(loop.scaled(factor), part).columns for loop, part in self.loops for factor in factors)

    def _others(self, asked: Requirements) -> Iterator[Look]:
        """Of all other loops, and of one phase in all together."""
        angle = max((shape.angle for shape in _shapes(asked) if isinstance(shape, Arc)), default=0.0)
        for each, plane in zip(self.loops, self.planes, strict=True):
            other = OtherLoops(*each, plane, self.window)
            yield from (partial(other.columns, one, needed) for one, needed in asked.asked_for)
            if angle:
                yield CommonPhase(*each, plane, angle, self.window).columns

    def _all(self, kps: Floats) -> list[Floats]:
        return [np.array([[0.0, 2 * self.window[1]]])] * len(kps)

    def _narrowed(self, kps: Floats, kept: Sequence[Floats], looks: Iterable[Look]) -> list[Floats]:
        """What is left of sets of kd, one per kp, after each look; where nothing is left nothing more is looked at."""
        left = list(kept)
        for look in looks:
            self.checkpoint()
            alive: Any = np.flatnonzero([len(one) for one in left])
            if not len(alive):
                break
            for k, found in zip(alive.tolist(), look(kps[alive]), strict=True):
                left[k] = overlap(left[k], found)
        return left

    def _outlines(self, columns: Look) -> tuple[Floats, ...]:
        return max(self.planes, key=lambda plane: plane.static).outlines(self.window, columns)


def _shapes(asked: Requirements) -> list[Any]:
    return [one.excluded(needed) for one, needed in asked.asked_for]
