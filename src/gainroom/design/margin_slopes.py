"""By how much coupled loops miss each requirement, wherever they may, and how that changes with every gain.

Gains act along directions: joints, or those of tasks. L = P X Δ E with P from torque to position, X (n, m) from direction to torque,
E (m, n) from position to direction, Δ = diag(d_j(s)) what the gains make of each. The core looks at such loops, and tells where their loci,
return ratios and S_ii come near what is excluded, and how these places move (loop_curves.hpp).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..analysis.look import WHOLE, Directed, Reach, Seen, directed_loop, joint_loops, look, margins_seen
from ..analysis.margin_record import Margins
from ..analysis.margins import margins
from ..errors import GainroomError
from ..system.controller import PD
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirement import Requirement
from ..system.requirements import Requirements

Gains = Floats
"""(3, m): kp, kd and ki of every direction; of a P/PI one kp, kv and ki."""
NEAR = 0.4  # in ln of a gain or a sensitivity, or as part of a phase: what is further from being missed is left out
FOLLOWED = 0.1  # the same, where gains are only a little further
CLOSE = 0.15  # in ln of a gain: so far what was seen of a loop is followed before it is looked at anew
STABLE = Reach(factor=3.0, phase=0.7)  # where nothing but the number of unstable roots is asked for: less takes more samples near −1
BROKEN = 1e-5  # what is missed by less may be round-off
DIFFERENCE = 1e-3  # in ln of a gain, of a margin whose slope is not known in closed form
BELIEVED = 100.0  # two crossings that are about to vanish move ever faster: no further than this is believed


@dataclass(frozen=True, eq=False)
class Case:
    """One state of a machine, in which gains have to keep something.

    title      for messages
    loop       gains (3, m) → the loop
    torque, jacobian   X (n, m), E (m, n)
    cascade    (m,) True for directions that are P/PI
    required   the requirements; none: stability alone
    """

    title: str
    loop: Callable[[Gains], Loop]
    torque: Floats
    jacobian: Floats
    cascade: Booleans
    required: Requirements
    _known: dict[bytes, Margins] = field(default_factory=dict, repr=False, compare=False)
    _whole: dict[bytes, Margins] = field(default_factory=dict, repr=False, compare=False)
    _stable: dict[bytes, bool | None] = field(default_factory=dict, repr=False, compare=False)
    _last: list[tuple[bytes, Seen]] = field(default_factory=list, repr=False, compare=False)
    _anchor: list[tuple[Gains, Seen]] = field(default_factory=list, repr=False, compare=False)
    _broke: list[str] = field(default_factory=list, repr=False, compare=False)
    _careful: list[bool] = field(default_factory=list, repr=False, compare=False)

    @property
    def joints(self) -> bool:
        """Whether its directions are the joints."""
        eye = np.eye(len(self.torque))
        return np.array_equal(self.torque, eye) and np.array_equal(self.jacobian, eye)

    @cached_property
    def _directed(self) -> Directed:
        loop = self.loop(np.ones((3, len(self.cascade))))
        assert loop.parts is not None
        apart = self.joints and type(loop.parts.controller) is PD
        return joint_loops(loop) if apart else directed_loop(loop, self.torque, self.jacobian, self.cascade)

    @cached_property
    def _asked(self) -> "_Asked":
        """What requirements ask for."""
        asked = _Asked()
        for one, needed in self.required.asked_for:
            one.slopes(asked, needed)
        return asked

    @property
    def _reach(self) -> Reach:
        """As far as anything near being missed may lie."""
        return self._asked.reach

    def be_careful(self) -> None:
        """From now on margins are also those of loci that nearly meet, as all_margins always has them: in twice the time."""
        self._careful[:] = [True]
        for known in (self._known, self._last, self._anchor):
            known.clear()

    def margins(self, gains: Gains) -> Margins:
        """Those of the loop with these gains that requirements bound, as far as they are near what is asked for; looked at once."""
        key = gains.tobytes()
        if key not in self._known:
            self._known[key] = self._margins_at(gains, self._looked_at(gains), bool(self._careful))
        return self._known[key]

    def all_margins(self, gains: Gains) -> Margins:
        """The same, however far they are from what is asked for."""
        key = gains.tobytes()
        if key not in self._whole:
            self._whole[key] = self._margins_at(gains, look(self._directed, gains, WHOLE.wider(self._reach)), True)
        return self._whole[key]

    def _margins_at(self, gains: Gains, seen: Seen, apart: bool) -> Margins:
        found = margins_seen(seen, len(self.torque), apart)
        if not found.stable or not seen.followed:
            return found
        found = replace(found, loops=(self.loop(gains),))
        for one, _ in self.required.asked_for:
            if math.isnan(one.value(found)):
                found = replace(found, **one.sampled(_Peaks(seen)))
        if any(math.isnan(one.value(found)) for one, _ in self.required.asked_for):
            with suppress(GainroomError):
                return margins(self.loop(gains))
        return found

    def known(self, gains: Gains) -> bool:
        """Whether the loop with these gains is stable, and could be followed."""
        return self.required.shortfall(self.margins(gains)) < math.inf

    def stable(self, gains: Gains) -> bool:
        """The same, but for what cannot be followed near −1: in a fraction of the time."""
        key = gains.tobytes()
        if key in self._known:
            return self._known[key].stable
        if key not in self._stable:
            if self.loop(gains).topples:
                self._stable[key] = False
            else:
                seen = look(self._directed, gains, STABLE)
                self._stable[key] = seen.unstable == 0 if seen.followed and seen.unstable >= 0 else None  # None: not known
        return self._stable[key] is True

    def vibrates(self, gains: Gains) -> bool:
        """Whether `stable` has counted unstable roots of a loop with these gains that holds up the weight."""
        return self._stable.get(gains.tobytes()) is False and self.loop(gains).stands

    def follows(self, gains: Gains) -> bool:
        """Whether these gains are so near the anchor that what was seen there may be followed."""
        if not self._anchor or not self._asked.curves:
            return False
        before = self._anchor[0][0]
        moving = before > 0
        return np.array_equal(moving, gains > 0) and bool(np.abs(np.log(gains[moving] / before[moving])).max(initial=0.0) < CLOSE)

    def followed(self, gains: Gains) -> "Slopes":
        """As `slopes`, of what was seen at the anchor: what has come near since then is not in it."""
        return _Curves(self, gains, self._anchor[0][1], NEAR, followed=True).slopes()

    def anchor(self, gains: Gains) -> None:
        """What is seen of the loop with these gains, which is stable, is followed from now on."""
        self._anchor[:] = [(gains, self._looked_at(gains))]

    def slopes(self, gains: Gains) -> "Slopes | None":
        """Everything near being missed by a loop, and how it moves; None where it is unstable, or could not be followed."""
        seen = self._looked_at(gains)
        return _Curves(self, gains, seen, NEAR).slopes() if seen.followed and seen.unstable == 0 else None

    def _looked_at(self, gains: Gains) -> Seen:
        """The loop with these gains; kept where it is stable, until others are looked at."""
        key = gains.tobytes()
        if self._last and self._last[0][0] == key:
            return self._last[0][1]
        seen = look(self._directed, gains, self._reach)
        if self._careful:
            seen.tell_apart(self._reach.factor / math.exp(NEAR), self._reach.phase / (1 + NEAR))
        if seen.followed and seen.unstable == 0:
            self._last[:] = [(key, seen)]
        return seen

    def breaks(self, gains: Gains) -> str:
        """A requirement that a loop of gains near the anchor is seen to break; "" where that is not to be seen so quickly.

        What was near being missed there is followed: wherever that comes to, it is a margin of the new loop. The requirement that broke
        last is looked at first.
        """
        if not self._anchor:
            return ""
        curves = _Curves(self, gains, self._anchor[0][1], FOLLOWED, followed=True, broken=True)
        asked = sorted(self.required.asked_for, key=lambda each: each[0].name not in self._broke)
        for one, needed in asked:
            if any(_broken(part) for _, part in one.slopes(curves, needed)):
                self._broke[:] = [one.name]
                return one.name
        return ""


@dataclass(frozen=True)
class Slopes:
    """What is missed, in ln of a gain or a sensitivity or as part of a phase, negative where it is met; and how it changes.

    missed (c,)     slope (c, 2, m): by ln of each direction's stiffness, and of its damping     name (c) of what is required
    """

    missed: Floats
    slope: Floats
    name: tuple[str, ...]

    @classmethod
    def of(cls, parts: "Sequence[Slopes]") -> "Slopes":
        """All of them."""
        missed, slope = (np.concatenate([getattr(part, field) for part in parts]) for field in ("missed", "slope"))
        return cls(missed, slope, tuple(name for part in parts for name in part.name))

    def seen_from(self, step: Floats, most: float) -> "Slopes":
        """These tangents, of gains moved by `step` (2, m), at the gains before, where no more than `most` is missed."""
        return Slopes(np.minimum(self.missed - np.einsum("ijk,jk->i", self.slope, step), most), self.slope, self.name)


def moved(gains: Gains, step: Floats, cascade: Booleans) -> Gains:
    """`gains` (3, m) with ln of stiffness and of damping changed by `step` (2, m).

    The stiffness of a P/PI direction is kp·kv, its damping kv, and ki goes with the stiffness.
    """
    stiffer, damped = np.exp(step)
    return gains * np.array([np.where(cascade, stiffer / damped, stiffer), damped, stiffer])


Part = tuple[int, Slopes]
PEAKS, ENDS = 0, 3  # places; loci and return ratios are between


@dataclass(frozen=True)
class _Peaks:
    """What a requirement may ask of a look (system/loop_protocols.py)."""

    seen: Seen

    def peak(self, slope: float = 1.0, offset: float = 0.0) -> tuple[float, float]:
        """The largest |slope S_ii + offset|, and its frequency [rad/s]."""
        return self.seen.peak(slope, offset)

    def delay(self) -> tuple[float, float]:
        """The least extra delay [s] in all loops, and its frequency [rad/s]."""
        return min(map(tuple, self.seen.delay_crossings(math.inf).tolist()), default=(math.inf, math.nan))


class _Asked:
    """Curves that only take down how far they are asked for, and whether nothing but curves is."""

    def __init__(self) -> None:
        self.reach, self.curves = Reach(), True

    def at_axis(self, name: str, factor: float) -> list[Part]:
        return self._wider(Reach(factor=factor * math.exp(NEAR)))

    def at_circle(self, name: str, angle: float) -> list[Part]:
        return self._wider(Reach(phase=min(angle * (1 + NEAR), math.pi)))

    def at_delays(self, name: str, longest: float) -> list[Part]:
        return self._wider(Reach(phase=math.pi))

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> list[Part]:
        return self._wider(Reach(peaks=((slope, offset, ceiling * math.exp(-NEAR)),)))

    def by_differences(self, requirement: Requirement, needed: float) -> list[Part]:
        self.curves = False
        return []

    def _wider(self, reach: Reach) -> list[Part]:
        self.reach = self.reach.wider(reach)
        return []


@dataclass(frozen=True)
class _Curves:
    """What requirements ask of the loops of a case: what is missed or met by less than `near`, about where they were seen.

    followed   True: where gains are only a little further than where loops were seen; what is not followed is left out
    broken     True: nothing is asked but whether anything is broken; what comes after the first such is left out, and how it moves

    Parts come with their place, peaks first, then loci, return ratios and ends: where a search is flat, their order decides by round-off.
    """

    case: Case
    gains: Gains
    seen: Seen
    near: float
    followed: bool = False
    broken: bool = False

    def slopes(self) -> Slopes:
        """Everything that is required."""
        found = [part for one, needed in self.case.required.asked_for for part in one.slopes(self, needed)]
        return Slopes.of([self._nothing, *(part for _, part in sorted(found, key=lambda pair: pair[0]))])

    @property
    def _nothing(self) -> Slopes:
        return Slopes(np.zeros(0), np.zeros((0, 2, self.case.torque.shape[1])), ())

    def _moving(self, found: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
        """(c,) margins, and how they move (c, 2, m)."""
        return found[0][:, 0], found[1].reshape(len(found[1]), 2, self.case.torque.shape[1])

    def at_axis(self, name: str, factor: float) -> list[Part]:
        """Gain margins: where loci and return ratios are real and negative."""
        needed = math.log(factor)
        until = needed - BROKEN if self.broken else 0.0

        def parts() -> Iterator[Part]:
            for place, locus in ((PEAKS + 1, True), (PEAKS + 2, False)):
                crossings = self.seen.crossings(self.gains, locus, True, needed + self.near, until)
                yield place, _limited(needed, *self._moving(crossings), 1.0, name)
                ends = self.seen.ends(self.gains, locus, needed + self.near)
                yield ENDS, _limited(needed, *self._moving(ends), 1.0, name)

        return self._as_far_as_asked(parts())

    def at_circle(self, name: str, angle: float) -> list[Part]:
        """Phase margins: where loci and return ratios are of size 1."""
        until = angle * (1 - BROKEN) if self.broken else 0.0

        def parts() -> Iterator[Part]:
            for place, locus in ((PEAKS + 1, True), (PEAKS + 2, False)):
                crossings = self.seen.crossings(self.gains, locus, False, angle * (1 + self.near), until)
                yield place, _limited(angle, *self._moving(crossings), angle, name)

        return self._as_far_as_asked(parts())

    def _as_far_as_asked(self, parts: Iterator[Part]) -> list[Part]:
        """All of them, or as far as the first that is broken."""
        found = []
        for part in parts:
            found.append(part)
            if self.broken and _broken(part[1]):
                break
        return found

    def at_delays(self, name: str, longest: float) -> list[Part]:
        """Delay margins: where loci are of size 1, and their lag there over ω."""
        delays = self.seen.delays(self.gains, longest * math.exp(self.near))
        least, moves = self._moving(delays)
        kept = least > 0
        return [(PEAKS + 1, _believed(np.log(longest / least[kept]), -moves[kept] / least[kept, None, None], name))]

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> list[Part]:
        """Where |slope S_ii + offset| is largest: a change of place changes nothing there."""
        until = ceiling * math.exp(BROKEN) if self.broken else math.inf
        height, moves = self._moving(self.seen.peaks(self.gains, ceiling * math.exp(-self.near), slope, offset, until))
        return [(PEAKS, Slopes(np.log(height / ceiling), moves, (name,) * len(height)))]

    def by_differences(self, requirement: Requirement, needed: float) -> list[Part]:
        """The worst of a margin that has no curve here: its differences from that at gains a little larger, one after the other."""
        case, gains = self.case, self.gains
        size = case.torque.shape[1]
        if self.followed:
            return []

        def missed(gains: Gains) -> float:
            found = case.margins(gains)
            return requirement.shortfall(needed, requirement.value(found)) if found.stable else math.inf

        here, slope = missed(gains), np.zeros((1, 2, size))
        if here < -self.near:
            return []
        for place in np.ndindex(2, size):
            step = np.zeros((2, size))
            step[place] = DIFFERENCE
            there = missed(moved(gains, step, case.cascade))
            slope[0][place] = (there - here) / DIFFERENCE if math.isfinite(there) else BELIEVED
        return [(PEAKS, _believed(np.array([here]), slope, requirement.name))]


def _broken(part: Slopes) -> bool:
    return bool(np.any(part.missed > BROKEN))


def _limited(needed: float, margin: Floats, moves: Floats, unit: float, name: str) -> Slopes:
    """By how much margins, of either sign, miss what is needed, in shares of `unit`."""
    return _believed((needed - np.abs(margin)) / unit, -np.sign(margin)[:, None, None] * moves / unit, name)


def _believed(missed: Floats, slope: Floats, name: str) -> Slopes:
    steepest = np.abs(slope).max(axis=(1, 2), initial=0.0)
    return Slopes(missed, slope * np.minimum(1.0, BELIEVED / np.maximum(steepest, BELIEVED))[:, None, None], (name,) * len(missed))
