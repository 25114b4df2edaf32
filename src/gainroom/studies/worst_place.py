"""Worst place in a system's uncertainty among those tried: where gains have the least left of the requirements, in any state.

Tried are the corners and places between for all joints together, a scan from soft to stiff gearboxes and one along the delay, places at
which joints differ, and a bounded search about the worst of those. A stiffer gearbox, or more delay, may be better or worse, as a resonance
meets the phase of the delay; and gains that hold with all joints at equal shares may fail where joints differ. Every place is judged by
sampled margins; between places nothing is proved.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ..system.linear.arrays import Floats
from ..system.system import StateCase, System
from ..system.uncertainty import Place, Share, is_end
from .loop_numbers import LATE, bounded_margins, extra_delay, first_factor
from .progress import Progress, quiet
from .sway import without_sway

GEARBOX = ("resonance", "stiffness", "damping_ratio", "damping")
"""Quantity of the gearboxes that is scanned, the first of these that is uncertain."""


class PlacedState(Protocol):
    """Posture and contact state with its plant: a State (state.py)."""

    @property
    def posture(self) -> str: ...
    @property
    def contact(self) -> str: ...
    @property
    def model(self) -> Any: ...


@dataclass(frozen=True)
class Tries:
    """Number and choice of the places tried.

    until_unsafe   True: stop at the first unsafe place
    """

    turn: float = math.pi / 3  # [rad] of a resonance's phase, by the delay, from one place of the scan to the next
    factor: float = 1.3  # largest ratio of resonances from one place of the scan to the next
    scanned: int = 24  # of one scan from end to end, at most
    inside: int = 8  # places of a Halton sequence, all joints together
    mixed: int = 12  # draws of joints that differ
    near: float = 0.4  # in ln of a gain: a worst that is further from what is required is not searched about
    dips: int = 3  # places about each dip of the scan
    searched: int = 24  # places about the worst where joints differ
    settled: float = 2e-3  # in ln of a gain
    apart: bool = True  # each joint, with its image, at one end and all others at the other
    until_unsafe: bool = False


TRIES = Tries()
"""Search effort for ranges that the user states."""
FEW = Tries(scanned=8, inside=4, mixed=4, dips=0, searched=8, apart=False, until_unsafe=True)
"""Search effort for assumed ranges: only whether any place is unsafe, in a fraction of an audit's time."""


@dataclass(frozen=True)
class Tried:
    """One place in the uncertainty, judged in all states.

    system     at that place
    safe       True: every requirement holds in every state
    shortfall  largest of the requirements, see Requirement.shortfall; for unstable gains the log of the factor by which they must be
               lowered; NaN: not known
    stable     True: in every state
    together   True: all joints are at one share of their ranges
    """

    place: Place
    system: System
    safe: bool
    shortfall: float
    stable: bool
    together: bool

    @property
    def order(self) -> tuple[bool, bool, bool, float]:
        """Sort key of places, the worst last: safe ones first, unknown ones last."""
        unknown = math.isnan(self.shortfall)
        return not self.safe, unknown, not self.stable, 0.0 if unknown else self.shortfall


@dataclass(frozen=True)
class OverRange:
    """System over its uncertainty, with all places tried.

    system   with its uncertainty, at its nominal values
    """

    system: System
    tried: tuple[Tried, ...]

    @property
    def worst(self) -> Tried:
        """Place with the largest shortfall, or the least headroom if all are safe."""
        return max(self.tried, key=lambda one: one.order)

    @property
    def safe(self) -> bool:
        """True if every requirement holds at every place."""
        return all(one.safe for one in self.tried)

    @property
    def mixed(self) -> int:
        """Number of places at which joints differ."""
        return sum(not one.together for one in self.tried)

    @property
    def unsafe_corners(self) -> list[Place]:
        """Unsafe corners, with all joints at the same ends."""
        return [one.place for one in self.tried if not one.safe and all(map(is_end, one.place))]

    def unsafe(self, most: int) -> list[Place]:
        """Unsafe places, worst first, at most `most`."""
        found = sorted((one for one in self.tried if not one.safe), key=lambda one: one.order, reverse=True)
        return [one.place for one in found[:most]]


def try_places(system: System, states: Sequence[PlacedState], progress: Progress = quiet, tries: Tries = TRIES) -> OverRange:
    """Worst place of a system over its uncertainty, in those of its `states` in which a joint moves."""
    search = _Search(system, states, progress, tries)
    with suppress(_Enough):
        search.run()
    progress(1, 1, "")
    return OverRange(system, tuple(search.tried.values()))


class _Enough(Exception):  # noqa: N818 - ends a search
    """End of a search at the first unsafe place."""


class _Search:
    def __init__(self, system: System, states: Sequence[PlacedState], progress: Progress, tries: Tries) -> None:
        self.system, self.states, self.progress, self.tries = system, states, progress, tries
        self.uncertain, self.size = system.uncertainty, len(system.source.joint_names)
        self.names, self.tried = self.uncertain.names, dict[Place, Tried]()
        self.gearbox = next((self.names.index(name) for name in GEARBOX[:2] if name in self.names), None)
        self.expected = len(self.uncertain.corners) + tries.inside + tries.mixed + tries.searched + 2 * tries.scanned + self.size

    def run(self) -> None:
        if self.gearbox is not None:  # most of what is unsafe shows here, which ends the search where that is all that is asked
            self.scan(self.gearbox, self.stiff_to_soft())
        if "delay" in self.names and len(shares := self.late_to_early()) > 2:  # a resonance's phase turns between the ends
            self.scan(self.names.index("delay"), shares)
        for place in [*self.uncertain.corners, *self.uncertain.inside(self.tries.inside)]:
            self.at(place)
        for place in self.uncertain.mixed(self.size, self.tries.mixed):
            self.at(place)
        self.search()

    def at(self, place: Place) -> Tried:
        """Tried (margins judged in all states) of one place in the uncertainty, computed once."""
        if place not in self.tried:
            self.progress(min(len(self.tried), self.expected), self.expected, "ranges")
            together = not any(isinstance(share, tuple) and len(set(share)) > 1 for share in place)
            self.tried[place] = _judged(self.system.at(place), self.states, place, together)
            if self.tries.until_unsafe and not self.tried[place].safe:
                raise _Enough
        return self.tried[place]

    @property
    def worst(self) -> Tried:
        return max(self.tried.values(), key=lambda one: one.order)

    def scan(self, which: int, shares: Sequence[float]) -> None:
        """Scan along one quantity with everything else low, and high; each peak of the shortfall is followed to its top."""
        for end in (0.0, 1.0):

            def at(share: float, end: float = end) -> float:
                one = self.at(tuple(share if k == which else end for k in range(len(self.names))))
                return math.inf if math.isnan(one.shortfall) else one.shortfall

            row = sorted((share, at(share)) for share in shares)
            worst = max(value for _, value in row)
            for one, other in ((0, 1), (-1, -2)):  # what is worst at an end may be worse just inside
                if len(row) > 1 and row[one][1] == worst:
                    place = 0.5 * (row[one][0] + row[other][0])
                    row.append((place, at(place)))
            row.sort()
            for k in range(1, len(row) - 1):
                three = row[k - 1 : k + 2]
                for _ in range(self.tries.dips):
                    place = _peak(three, worst - self.tries.near)
                    if place is None:
                        break
                    four = sorted([*three, (place, at(place))])
                    highest = max(range(1, 3), key=lambda k, four=four: four[k][1])
                    settled = four[highest][1] - three[1][1] < self.tries.settled
                    three = four[highest - 1 : highest + 2]
                    if settled:
                        break

    def ends(self, which: int) -> tuple[Floats, Floats]:
        """Ends (n,) of the range of one quantity."""
        low, high = (np.broadcast_to(np.asarray(end, dtype=float), self.size) for end in getattr(self.uncertain, self.names[which]))
        return low, high

    @property
    def lighter(self) -> Floats:
        """Ratio (n,) of each joint's resonance to that of its motor alone on the gearbox, the largest in any state."""
        loads = [np.diagonal(state.model.link_inverse_inertia) for state in self.states]
        return np.sqrt(1 + self.system.source.quantities["motor_inertia"] * np.max(loads, axis=0))

    def late_to_early(self) -> list[float]:
        """Shares of the range of delay from 1 to 0, in steps that change no joint's resonance phase by more than Tries.turn."""
        values, (low, high) = self.system.source.quantities, self.ends(self.names.index("delay"))
        with np.errstate(divide="ignore", invalid="ignore"):
            resonance = np.sqrt(values["stiffness"] / values["motor_inertia"]) * self.lighter
        turned = (high - low) * np.where(np.isfinite(resonance), resonance, 0.0)
        count = min(max(math.ceil(float(np.max(turned)) / self.tries.turn), 1), self.tries.scanned)
        return np.linspace(1.0, 0.0, count + 1).tolist()

    def stiff_to_soft(self) -> list[float]:
        """Shares of the range of stiffness from 1 to 0, in steps that change no joint's resonance phase by more than Tries.turn."""
        assert self.gearbox is not None
        low, high = self.ends(self.gearbox)
        inertia = self.system.source.quantities["motor_inertia"]
        if self.names[self.gearbox] == "stiffness":
            with np.errstate(divide="ignore", invalid="ignore"):
                low, high = np.sqrt(low / inertia), np.sqrt(high / inertia)
        wide = np.isfinite(low) & np.isfinite(high) & (low > 0) & (high > low)
        if not wide.any():
            return [0.0, 1.0]
        low, span = low[wide], np.log(high[wide] / low[wide])
        turned = self.system.lag * self.lighter[wide]  # by [rad/s] of the motor's, at the joint's resonance
        found = [1.0]
        while found[-1] > 0:
            omega = low * np.exp(span * found[-1])
            with np.errstate(divide="ignore"):
                fine = np.minimum(self.tries.turn / turned, omega * (1 - 1 / self.tries.factor))
            step = float(np.min(-np.log1p(-fine / omega) / span))
            found.append(max(0.0, found[-1] - max(step, 1 / self.tries.scanned)))
        return found

    def search(self) -> None:
        """Search joint by joint to either end of its ranges, from the worst place so far, as long as a worse one is found."""
        by_joint = [k for k, name in enumerate(self.names) if name != "delay"]
        if self.size < 2 or not by_joint:
            return
        from ..robot.mirror_names import image_groups  # loads what a single joint does not need

        best = self.worst
        groups = image_groups(self.system.source.joint_names)
        for group in dict.fromkeys(groups) if self.gearbox is not None and self.tries.apart else ():
            for end in (0.0, 1.0):
                apart = tuple(end if one == group else 1 - end for one in groups)
                self.at(tuple(apart if k == self.gearbox else share for k, share in enumerate(best.place)))
        best, left = self.worst, self.tries.searched
        moves = list(self.moves(by_joint))
        while left > 0 and best.shortfall > -self.tries.near:
            before = best
            for which, joint, end in moves:
                place = tuple(_with(share, joint, end, self.size) if k == which else share for k, share in enumerate(best.place))
                if place in self.tried:
                    continue
                best = max(best, self.at(place), key=lambda one: one.order)
                left -= 1
                if left == 0:
                    return
            if best is before:
                return

    def moves(self, by_joint: Sequence[int]) -> Iterator[tuple[int, int, float]]:
        """Moves (quantity, joint, end) in a shuffled order with a fixed seed."""
        every = [(which, joint, end) for which in by_joint for joint in range(self.size) for end in (0.0, 1.0)]
        yield from (every[k] for k in np.random.default_rng(0).permutation(len(every)).tolist())


def _with(share: Share, joint: int, end: float, size: int) -> Share:
    """Share with that of one joint moved to an end."""
    return tuple(end if k == joint else one for k, one in enumerate(np.broadcast_to(share, size).tolist()))


def _peak(three: Sequence[tuple[float, float]], enough: float) -> float | None:
    """Position of a parabola's maximum through three (place, shortfall); None if it is at an end, or below `enough`."""
    (x0, y0), (x1, y1), (x2, y2) = three
    if not (y1 >= max(y0, y2) and y1 > enough and all(map(math.isfinite, (y0, y1, y2)))):
        return None
    bend, slope, _ = np.polyfit([x0 - x1, 0.0, x2 - x1], [y0, y1, y2], 2)
    place = float(x1 - slope / (2 * bend)) if bend < 0 else math.nan
    return place if x0 < place < x2 and min(abs(place - x) for x in (x0, x1, x2)) > 1e-6 else None


def _judged(system: System, states: Sequence[PlacedState], place: Place, together: bool) -> Tried:
    """Tried of one place in the uncertainty: safe and stable or not in each of `states`, and the largest shortfall."""
    values, safe, stable, worst = system.source.quantities, True, True, -math.inf
    for state in states:
        known = {name: value for name, value in values.items() if hasattr(state.model, name) and name != "link_inertia"}
        model = replace(state.model, **known) if system.source.body is not None else system.source.linearize()
        case = StateCase(state.posture, state.contact, "", system, model)
        met, counted, short = _in_state(case)
        safe, stable, worst = safe and met, stable and counted, float(np.maximum(worst, short))
    return Tried(place, system, safe, worst, stable, together)


def _in_state(case: StateCase) -> tuple[bool, bool, float]:
    """Requirements met, stable, and shortfall of one case; a delay margin near its requirement is certified."""
    required = case.system.requirements
    found = bounded_margins(case, near=True)
    if found.stable and not required.met_by(found):  # else it is met without sway, too, which takes ten times as long
        found = without_sway(case, found)
    if not found.stable:
        factor = first_factor(case.system.loop(case.model))
        margin = required.gain_margin or 1.0
        return False, False, math.inf if factor <= 0 else math.log(margin / factor) if not math.isnan(factor) else math.nan
    needed = required.delay_margin
    if needed is not None and found.delay_margin < LATE * needed:
        found = replace(found, delay_margin=extra_delay(case.system.loop(case.model)))
    return required.met_by(found), True, required.shortfall(found)
