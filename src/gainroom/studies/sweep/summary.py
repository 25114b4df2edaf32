"""Summary of a sweep: worst postures, distribution of limits in every contact state, limiting joints, and coverage.

It is read task by task, so that memory does not grow with the sweep: quantiles come from a histogram of ln gain with bins STEP wide.
"""

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...robot.robot import Posture, Robot
from ...system.linear.arrays import Floats, Integers
from ...system.system import System
from .limits import Limits
from .plan import SweepPlan, SweepTask

WORST = 8
"""Default number of worst postures remembered per contact state."""
STEP = 1e-3
LOWEST, HIGHEST = 1e-6, 1e6
CONFIDENCE = 0.95


@dataclass(frozen=True)
class SweptPosture:
    """One posture in one contact state with one draw, all as indices, and its limit; `angles` (n,) [rad; m if prismatic].

    lower   factor below which lowered gains are unstable; 0: none, NaN: not known
    """

    number: int
    contact: int
    draw: int
    gain: float
    frequency: float
    joint: int
    certified: bool
    angles: Floats
    lower: float = 0.0

    @classmethod
    def of(cls, limits: Limits, row: int, numbers: tuple[int, int, int], angles: Floats) -> "SweptPosture":
        """Swept posture from one row of limits; `numbers`: indices of posture, contact state and draw."""
        gain, frequency, joint = float(limits.gain[row]), float(limits.frequency[row]), int(limits.joint[row])
        return cls(*numbers, gain, frequency, joint, bool(limits.certified[row]), angles, float(limits.lower[row]))

    @property
    def key(self) -> tuple[int, int, int]:
        """Indices of contact state, draw and posture."""
        return self.contact, self.draw, self.number

    def system(self, plan: SweepPlan) -> System:
        """System of the plan with this draw, and with this posture as its only one, named `posture N`."""
        system = plan.system.at(plan.places[self.draw])
        robot: Robot = system.source  # type: ignore[assignment]
        angles = dict(zip(robot.joint_names, self.angles.tolist(), strict=True))
        source = Robot(**{**vars(robot), "postures": {self.name: Posture(robot.body, angles)}})
        return System(**{**vars(system), "source": source})

    @property
    def name(self) -> str:
        """Name for tables; index −1: found by a search, not one of the sweep."""
        return f"posture {self.number}" if self.number >= 0 else "search"


@dataclass(frozen=True)
class ContactSummary:
    """Summary of one contact state over all postures and draws.

    count        finished limits; `unknown` of them have no gain, `uncertified` one above 0 that is not certified
    unstable     number with a gain of 1 or less, or a lower one above 1; `short`: with less than the required gain margin, up or down
    unsafe       number without that margin, a certificate, or a known limit
    lower        highest factor below which stable gains become unstable when lowered; 0: none
    worst        postures with the lowest limits, rising
    edges, spread   (b + 1,), (b,) a histogram of gains
    joints       (n,) number of times each joint limits
    """

    name: str
    count: int
    unknown: int
    uncertified: int
    unstable: int
    short: int
    unsafe: int
    lower: float
    worst: tuple[SweptPosture, ...]
    edges: Floats
    spread: Integers
    joints: Integers

    def quantile(self, share: float) -> float:
        """Gain below which a `share` of the known limits lies, accurate to STEP, 0 up to LOWEST; NaN if there are none."""
        known = np.cumsum(self.spread)
        if not len(known) or not known[-1]:
            return math.nan
        at = int(np.searchsorted(known, share * known[-1]))
        return 0.0 if self.edges[at] <= LOWEST else float(math.sqrt(self.edges[at] * self.edges[at + 1]))


@dataclass(frozen=True)
class SweepSummary:
    """Summary of the finished part of a sweep.

    margin    factor of the required gain margin; 1 if none is required
    searched  result of a local search from the worst postures (search.py); None: there was none
    """

    plan: SweepPlan
    contacts: tuple[ContactSummary, ...]
    margin: float
    searched: SweptPosture | None = None

    @property
    def count(self) -> int:
        """Number of finished limits."""
        return sum(one.count for one in self.contacts)

    @property
    def complete(self) -> bool:
        """True if nothing is left to compute."""
        return self.count == self.plan.states

    @property
    def worst_posture(self) -> SweptPosture | None:
        """Posture with the lowest limit of all; None if none is known."""
        found = [one.worst[0] for one in self.contacts if one.worst]
        return min(found, key=lambda one: (one.gain, one.draw, one.contact, one.number)) if found else None

    @property
    def unknown(self) -> int:
        """Number of limits that could not be found."""
        return sum(one.unknown for one in self.contacts)

    @property
    def uncertified(self) -> int:
        """Number of limits without proof."""
        return sum(one.uncertified for one in self.contacts)

    @property
    def unsafe(self) -> int:
        """Number of limits without the required margin, without a certificate, or not known."""
        return sum(one.unsafe for one in self.contacts)

    @property
    def stable(self) -> bool:
        """True if stable in every swept posture, each with a known limit."""
        return not self.unknown and not any(one.unstable for one in self.contacts)

    @property
    def margin_held(self) -> bool:
        """True if stable with the required gain margin, certified in every posture. Other margins are not computed."""
        return self.stable and not self.uncertified and not any(one.short for one in self.contacts)

    @property
    def scale(self) -> float:
        """Factor on all gains with which the margin holds in every swept posture, and in the searched one; NaN: none is known."""
        worst, found = self.worst_posture, self.searched
        if self.unknown or self.uncertified or worst is None:
            return math.nan
        gain, lower = worst.gain, self.lower
        if found is not None and found.gain < gain:
            gain, lower = (found.gain if found.certified else math.nan), max(lower, found.lower)
        scale = gain / self.margin
        return scale if scale > 0 and scale >= lower * self.margin else math.nan

    @property
    def lower(self) -> float:
        """Highest factor below which lowered gains become unstable in some posture; 0: none."""
        return max((one.lower for one in self.contacts), default=0.0)

    @property
    def rarer_than(self) -> float:
        """Share of further random postures below the lowest limit, at most, with CONFIDENCE; NaN for grids and trajectories.

        All of n independent postures lie above a quantile p with probability (1 − p)ⁿ.
        """
        if self.plan.postures.kind != "samples":
            return math.nan
        return 1 - (1 - CONFIDENCE) ** (1 / self.plan.postures.count)


def summarized(
    plan: SweepPlan, finished: Iterable[tuple[SweepTask, Limits]], margin: float | None = None, remembered: int = WORST
) -> SweepSummary:
    """Summary of finished tasks, in any order.

    margin       in place of the gain margin that the system requires
    remembered   number of worst postures of each contact state
    """
    margin = margin or plan.system.requirements.gain_margin or 1.0
    parts = [_Part(plan, index, margin, remembered) for index in range(len(plan.contacts))]
    for task, limits in finished:
        parts[task.contact].take(task, limits)
    return SweepSummary(plan, tuple(part.summary() for part in parts), margin)


class _Part:
    """Accumulator of one contact state during reading."""

    def __init__(self, plan: SweepPlan, index: int, margin: float, remembered: int):
        self._plan, self._index, self._margin, self._most = plan, index, margin, remembered
        self._bins = math.ceil(math.log(HIGHEST / LOWEST) / STEP)
        self._spread = np.zeros(self._bins, dtype=np.int64)
        self._joints = np.zeros(plan.robot.body.size, dtype=np.int64)
        self._counts = dict.fromkeys(("count", "unknown", "uncertified", "unstable", "short", "unsafe"), 0)
        self._lower = 0.0
        self._worst: list[tuple[float, int, int, SweptPosture]] = []

    def take(self, task: SweepTask, limits: Limits) -> None:
        known = ~np.isnan(limits.gain)
        gain = limits.gain[known]
        counts = self._counts
        counts["count"] += task.size
        counts["unknown"] += int(np.count_nonzero(~known))
        counts["uncertified"] += int(np.count_nonzero(~limits.certified[known] & (gain > 0)))
        lower = limits.lower[known]
        unstable = (gain <= 1) | (lower >= 1)
        short = (gain < self._margin) | (lower * self._margin > 1)
        counts["unstable"] += int(np.count_nonzero(unstable))
        counts["short"] += int(np.count_nonzero(short))
        counts["unsafe"] += int(np.count_nonzero(~known)) + int(np.count_nonzero(unstable | short | ~limits.certified[known]))
        self._lower = float(np.max(lower[~unstable], initial=self._lower))
        places = np.floor(np.log(np.clip(gain, LOWEST, HIGHEST * (1 - 1e-9)) / LOWEST) / STEP).astype(np.int64)
        self._spread += np.bincount(np.minimum(places, self._bins - 1), minlength=self._bins)
        self._joints += np.bincount(limits.joint[limits.joint >= 0], minlength=len(self._joints))
        self._remember(task, limits)

    def _remember(self, task: SweepTask, limits: Limits) -> None:
        """Keep the lowest limits, the first of equal ones."""
        bound = -self._worst[0][0] if len(self._worst) == self._most else math.inf
        candidates = np.flatnonzero(limits.gain <= bound)
        candidates = candidates[np.argsort(limits.gain[candidates], kind="stable")[: self._most]]
        angles = self._plan.postures.at(task.first, task.stop) if len(candidates) else None
        for row in candidates.tolist():
            assert angles is not None
            one = SweptPosture.of(limits, row, (task.first + row, task.contact, task.draw), angles[row])
            entry = (-one.gain, -one.draw, -one.number, one)
            if len(self._worst) < self._most:
                heapq.heappush(self._worst, entry)
            elif entry > self._worst[0]:
                heapq.heapreplace(self._worst, entry)

    def summary(self) -> ContactSummary:
        worst = sorted((one for *_, one in self._worst), key=lambda one: (one.gain, one.draw, one.number))
        filled = np.flatnonzero(self._spread)
        first, last = (int(filled[0]), int(filled[-1]) + 1) if len(filled) else (0, 0)
        edges = LOWEST * np.exp(STEP * np.arange(first, last + 1))
        name = self._plan.contacts[self._index]
        return ContactSummary(
            name, **self._counts, lower=self._lower, worst=tuple(worst), edges=edges, spread=self._spread[first:last], joints=self._joints
        )
