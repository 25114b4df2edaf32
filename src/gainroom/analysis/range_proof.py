"""Does every joint within the ranges keep what is asked? A proof, or a joint that does not, or an honest "not proved".

A requirement keeps L(jω) out of a set that holds −1 (system/excluded_sets.py). Where one joint of the ranges is stable, and L stays out of
that set at every frequency for every joint within them, no root can cross the stability boundary on the way from that joint to any other,
so all of them are stable and keep the margin (zero exclusion: Barmish 1994, New Tools for Robustness of Linear Systems). Boxes of frequency
and parameters are split in two until L is shown to stay out of the set everywhere in each (box_loops.py), or until the middle of one lies
in it, or until the work is spent.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.excluded_sets import ExcludedSet, Segment
from ..system.feedback import GivenFeedback, feedback_of
from ..system.linear.arrays import Booleans, Complexes, Floats
from ..system.requirements import Requirements
from ..system.uncertainty import Uncertainty
from .box_loops import BoxLoop, Sectors

Judge = Callable[[dict[str, float]], bool]

CHUNK = 4096  # boxes evaluated together
FIRST_STEP = 1.5  # ratio of the highest to the lowest frequency of a first box
NEARBY = 0.1  # distance of log L from an excluded set below which a joint is judged, and again at each half of it
NEAR_RESONANCE = (0.6, 1.7)  # multiples of the resonance between which boxes are of frequency relative to the resonance


@dataclass(frozen=True)
class Proof:
    """Result of a proof over a whole range of joints.

    holds    every joint within it keeps the requirements, provided that one of them is stable
    boxes    number of boxes evaluated
    broken   True: `worst` breaks a requirement. If neither `holds` nor `broken` is True, the work was spent before either was known
    worst    the joint that came nearest to breaking one, by quantity, SI
    """

    holds: bool
    boxes: int
    broken: bool
    worst: dict[str, float]


def prove(
    joint: ElasticJoint,
    drive: Drive,
    uncertainty: Uncertainty,
    controller: Any,
    requirements: Requirements,
    feedback: GivenFeedback = "motor",
    sample_time: float | None = None,
    judge: Judge = lambda values: False,
    most: int = 500_000,
) -> Proof:
    """Proof that `requirements` hold in all of `uncertainty`; with nothing required, that no root can reach the stability boundary.

    A requirement that gives no excluded set cannot be proved, nor can loops whose gains measure both sides: no box is evaluated then.

    judge  True if the joint with these values (by quantity, SI) breaks a requirement, exactly; called for the nearest to doing so
    most   boxes to evaluate before giving up
    """
    if feedback_of(feedback, controller).mixed:
        return Proof(False, 0, False, {})
    loop = BoxLoop(joint, drive, uncertainty, controller, feedback, sample_time)
    shapes = [one.excluded(needed) for one, needed in requirements.asked_for]
    given = [shape for shape in shapes if shape is not None]
    if not loop.boundable or len(given) < len(shapes):
        return Proof(False, 0, False, {})
    return _BoxSearch(loop, [Segment(1.0), *given], judge, most).run()


class _BoxSearch:
    """Search over boxes of frequency and parameters; keeps the joint that came nearest to one of the excluded sets, `shapes`."""

    def __init__(self, loop: BoxLoop, shapes: list[ExcludedSet], judge: Judge, most: int) -> None:
        self.loop, self.shapes, self.judge, self.most = loop, shapes, judge, most
        self.least, self.judged = math.inf, NEARBY
        self.worst: dict[str, float] = {}

    def run(self) -> Proof:
        """Result of splitting boxes until all are decided, a requirement is broken, or the work is spent."""
        spent = 0
        for scaled, low, high in self.first_boxes():
            waiting = [(low, high)]
            while waiting:
                low, high = waiting.pop()
                if len(low) > CHUNK:
                    waiting.append((low[CHUNK:], high[CHUNK:]))
                    low, high = low[:CHUNK], high[:CHUNK]
                needed = ~self.covered(low, high, scaled)
                low, high = low[needed], high[needed]
                if not len(low):
                    continue
                spent += len(low)
                sectors = self.loop.at(low, high, scaled)
                if self.breaks(sectors, low, high):
                    return Proof(False, spent, True, self.worst)
                open_ = ~self.clear(sectors)
                if not open_.any():
                    continue
                if spent > self.most:
                    return Proof(False, spent, False, self.worst)
                waiting.append(_halves(low[open_], high[open_], sectors.score[open_]))
        return Proof(True, spent, False, self.worst)

    def first_boxes(self) -> list[tuple[bool, Floats, Floats]]:
        """Boxes that together cover all frequencies for all joints: (counted in resonances, low, high)."""
        last = self.loop.nyquist or self.loop.silent_above(self.smallest())
        pieces = [(False, *self.whole(np.append(0.0, _steps(1e-3 * last, last))))]
        return pieces if self.loop.rigid else [(True, *self.whole(_steps(*NEAR_RESONANCE))), *pieces]

    def covered(self, low: Floats, high: Floats, scaled: bool) -> Booleans:
        """True for boxes that others cover: near the resonance those counted in resonances, beyond half the sample rate all."""
        if scaled:
            slow, _ = self.loop.resonances_in(low, high)
            return low[:, 0] * slow >= (self.loop.nyquist or math.inf)
        if self.loop.rigid:
            return np.zeros(len(low), dtype=bool)
        slow, fast = self.loop.resonances_in(low, high)
        return (low[:, 0] >= NEAR_RESONANCE[0] * fast) & (high[:, 0] <= NEAR_RESONANCE[1] * slow)

    def whole(self, ends: Floats) -> tuple[Floats, Floats]:
        """One box of all parameters per step between `ends`."""
        count = len(ends) - 1
        low, high = (np.tile(values, (count, 1)) for values in (self.loop.low, self.loop.high))
        return np.column_stack([ends[:-1], low]), np.column_stack([ends[1:], high])

    def smallest(self) -> float:
        """|L| below which no requirement can be broken."""
        return 0.999 * min(0.99, *(shape.smallest for shape in self.shapes))

    def clear(self, found: Sectors) -> Booleans:
        """True where L stays out of every excluded set in the whole box."""
        return np.all([shape.clear(found) for shape in self.shapes], axis=0)

    def breaks(self, found: Sectors, low: Floats, high: Floats) -> bool:
        """True if the joint in the middle of a box breaks a requirement, as `judge` says; boxes nearer to an excluded set are noted."""
        distance = self.distance(found.center)
        k = int(np.argmin(distance))
        if distance[k] < self.least:
            self.least = float(distance[k])
            self.worst = dict(zip(self.loop.names, (0.5 * (low[k] + high[k]))[1:].tolist(), strict=True))
            if self.least < 0.5 * self.judged:
                self.judged = max(self.least, 0.0)
                return self.judge(self.worst)
        return False

    def distance(self, value: Complexes) -> Floats:
        """Distance of each L from the nearest excluded set."""
        distance = np.min([shape.distance(value) for shape in self.shapes], axis=0)
        return np.where(np.isnan(distance), np.inf, distance)


def _steps(first: float, last: float) -> Floats:
    """Geometric steps of about FIRST_STEP from `first` to `last`."""
    return np.geomspace(first, last, 1 + max(1, math.ceil(math.log(last / first) / math.log(FIRST_STEP))))


def _halves(low: Floats, high: Floats, score: Floats) -> tuple[Floats, Floats]:
    """Each box cut in two where it moves L most; a wide range at its geometric mean."""
    row = np.arange(len(low))
    axis = np.argmax(np.where(high > low, score, -1.0), axis=1)
    start, end = low[row, axis], high[row, axis]
    wide = (start > 0) & (end > 2 * start)
    cut = np.where(wide, np.sqrt(np.where(wide, start * end, 1.0)), np.where(start > 0, 0.5 * (start + end), 0.25 * end))
    left, right = high.copy(), low.copy()
    left[row, axis] = right[row, axis] = cut
    return np.vstack([low, right]), np.vstack([left, high])
