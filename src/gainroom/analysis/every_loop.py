"""The gains (kp, kd) of one part of a controller that are good in several loops at once: a robot in all its states.

What is stable in every loop is where the stable gains of all overlap (part_plane.py). In each of them the part's own loop keeps the
required margins (part_requirements.py), and where a gain margin is required all gains together do: any common factor within it leaves the
loop stable, which is looked at for FACTORS of them. With `others` every other loop keeps them, too (other_loops.py), and all loops
together any common phase (common_phase_plane.py): then everything that is asked for has been looked at. Sampled, not certified.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

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


@dataclass(frozen=True)
class EveryLoop:
    """The same part in each of `loops`, which are those of one robot; gains up to `window`."""

    loops: Sequence[tuple[Loop, LoopPart]]
    window: tuple[float, float]

    @cached_property
    def planes(self) -> list[PartPlane]:
        """Of the gains as they are, one per loop."""
        return [PartPlane.of(loop, part, self.window) for loop, part in self.loops]

    def stable(self) -> tuple[Floats, ...]:
        """Outlines of the gains that are stable in every loop, as PartPlane.outlines. Raises GainroomError as PartPlane.columns."""
        return self._outlines(lambda kps: [plane.columns(kps) for plane in self.planes])

    def required(self, asked: Requirements, others: bool = False) -> tuple[Floats, ...]:
        """The same of those that also keep what is asked for; `others`: in the loops of all other parts, and of all together, too."""
        margin = [one.excluded(needed) for one, needed in asked.asked_for]
        angle = max((shape.angle for shape in margin if isinstance(shape, Arc)), default=0.0)
        widest = max((shape.factor for shape in margin if isinstance(shape, Segment)), default=1.0)
        factors = [factor for factor in np.geomspace(1 / widest, widest, FACTORS + 1).tolist() if abs(factor - 1) > 1e-9]
        scaled = [PartPlane.of(loop.scaled(factor), part, self.window) for loop, part in self.loops for factor in factors]
        seen = [(*each, plane) for each, plane in zip(self.loops, self.planes, strict=True) if others and asked.asked]
        singly = [OtherLoops(*each, self.window) for each in seen]
        turned = [CommonPhase(*each, angle, self.window) for each in seen if angle]

        def every(kps: Floats) -> Iterator[list[Floats]]:
            yield from (required_columns(plane, asked, kps) for plane in self.planes)
            yield from (plane.columns(kps) for plane in scaled)
            yield from (other.columns(one, needed, kps) for other in singly for one, needed in asked.asked_for)
            yield from (phase.columns(kps) for phase in turned)

        return self._outlines(every)

    def _outlines(self, every: Callable[[Floats], Iterable[list[Floats]]]) -> tuple[Floats, ...]:
        def columns(kps: Floats) -> list[Floats]:
            return [reduce(overlap, found) for found in zip(*every(kps), strict=True)]

        return max(self.planes, key=lambda plane: plane.static).outlines(self.window, columns)
