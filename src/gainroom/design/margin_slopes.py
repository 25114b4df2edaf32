"""Shortfalls of coupled loops against each requirement, at every crossing and peak near it, and their derivatives by every gain.

Gains act along directions: joints, or those of tasks. L = P X Δ E with P from torque to position, X (n, m) from direction to torque,
E (m, n) from position to direction, Δ = diag(d_j(s)) the law of each direction. The core samples such loops, and reports where their loci,
return ratios and S_ii come near an excluded set, and how these places move with the gains (loop_curves.hpp).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..analysis.loop_samples import WHOLE, Directed, LoopSamples, Reach, directed_loop, joint_loops, margins_of_samples, take_samples
from ..analysis.margin_record import Margins
from ..analysis.margins import margins
from ..analysis.margins_outside import outside
from ..errors import GainroomError
from ..system.controller import PD
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirement import Requirement
from ..system.requirements import Requirements
from .compliance_slopes import DirectedCompliance, SoftPeaks
from .swaying import Swaying

Gains = Floats
"""(3, m): kp, kd and ki of every direction; of a P/PI one kp, kv and ki."""
NEAR = 0.4  # distance from a requirement, in ln of a gain or sensitivity or as part of a phase, beyond which a margin is left out
FOLLOWED = 0.1  # likewise for margins predicted at gains a little further on
CLOSE = 0.15  # largest change in ln of a gain over which a loop's curves are predicted before it is sampled anew
STABLE = Reach(factor=3.0, phase=0.7)  # reach of samples for a root count alone: a smaller one takes more samples near −1
NO_BANDS = np.zeros((0, 2))
BROKEN = 1e-5  # shortfall below which it may be round-off
DIFFERENCE = 1e-3  # step in ln of a gain for the slope of a margin without a closed form
BELIEVED = 100.0  # largest slope that is used: two crossings that are about to vanish move ever faster


@dataclass(frozen=True, eq=False)
class GainCase:
    """Loop of one state of a machine as a function of gains along directions, with the requirements that they have to meet.

    title      for messages
    loop       gains (3, m) → the loop
    torque, jacobian   X (n, m), E (m, n)
    cascade    (m,) True for directions that are P/PI
    required   the requirements; none: stability alone
    contact    contact state
    sway       sway of the base as a function of gains; None where nothing sways
    balanced   True: a controller above the joints damps sway; then its frequencies count in no phase margin, sensitivity and compliance
    lag        (m,) of each joint's torque behind a slow motion [s]; None of tasks, whose directions share the motors
    """

    title: str
    loop: Callable[[Gains], Loop]
    torque: Floats
    jacobian: Floats
    cascade: Booleans
    required: Requirements
    contact: str = ""
    sway: Swaying | None = None
    balanced: bool = False
    lag: Floats | None = None
    _known: dict[bytes, Margins] = field(default_factory=dict, repr=False, compare=False)
    _whole: dict[bytes, Margins] = field(default_factory=dict, repr=False, compare=False)
    _stable: dict[bytes, bool | None] = field(default_factory=dict, repr=False, compare=False)
    _last: list[tuple[bytes, LoopSamples]] = field(default_factory=list, repr=False, compare=False)
    _anchor: list[tuple[Gains, LoopSamples]] = field(default_factory=list, repr=False, compare=False)
    _broke: list[str] = field(default_factory=list, repr=False, compare=False)
    _careful: list[bool] = field(default_factory=list, repr=False, compare=False)

    @property
    def joints(self) -> bool:
        """True if the directions are the joints."""
        eye = np.eye(len(self.torque))
        return np.array_equal(self.torque, eye) and np.array_equal(self.jacobian, eye)

    @cached_property
    def _directed(self) -> Directed:
        loop = self.loop(np.ones((3, len(self.cascade))))
        assert loop.parts is not None
        apart = self.joints and type(loop.parts.controller) is PD
        return joint_loops(loop) if apart else directed_loop(loop, self.torque, self.jacobian, self.cascade)

    @cached_property
    def compliance(self) -> DirectedCompliance:
        """Compliance of the links along the directions."""
        return DirectedCompliance(self.loop(np.ones((3, len(self.cascade)))), self.torque, self.jacobian, self.cascade)

    def peaks(self, gains: Gains) -> SoftPeaks:
        """Peaks of the links' compliance with these gains, above sway and at rest where a controller damps it."""
        bands = self.left_out(gains)
        return self.compliance.peaks(gains, above=float(bands.max(initial=0.0)))

    def left_out(self, gains: Gains) -> Floats:
        """Frequency bands (k, 2) [rad/s] of sway that a controller damps."""
        return self.sway.at(gains).bands if self.sway is not None and self.balanced else NO_BANDS

    @cached_property
    def _asked(self) -> "_Asked":
        """Reach that samples need to cover every requirement, and whether every requirement has slopes in closed form."""
        asked = _Asked()
        for one, needed in self.required.asked_for:
            one.slopes(asked, needed)
        return asked

    @property
    def _reach(self) -> Reach:
        """Reach of samples that covers every margin near its requirement."""
        return self._asked.reach

    def be_careful(self) -> None:
        """Switch to samples that also resolve loci that nearly meet, as all_margins always does: they take twice the time."""
        self._careful[:] = [True]
        for known in (self._known, self._last, self._anchor):
            known.clear()

    def margins(self, gains: Gains) -> Margins:
        """Margins with these gains that requirements bound, as far as they are near one; sampled once per set of gains."""
        key = gains.tobytes()
        if key not in self._known:
            self._known[key] = self._margins_at(gains, self._samples_at(gains), bool(self._careful))
        return self._known[key]

    def all_margins(self, gains: Gains) -> Margins:
        """Margins with these gains that requirements bound, however far from one; sampled once per set of gains."""
        key = gains.tobytes()
        if key not in self._whole:
            self._whole[key] = self._margins_at(gains, take_samples(self._directed, gains, WHOLE.wider(self._reach)), True)
        return self._whole[key]

    def _margins_at(self, gains: Gains, samples: LoopSamples, apart: bool) -> Margins:
        found = margins_of_samples(samples, len(self.torque), apart)
        if not found.stable or not samples.followed:
            return found
        found = replace(found, loops=(self.loop(gains),))
        if self.sway is not None and self.balanced and len((sway := self.sway.at(gains)).frequency):
            found = replace(outside(samples, found, sway.bands), sway_damping_ratio=float(sway.damping.min()))
        for one, _ in self.required.asked_for:
            if math.isnan(one.value(found)):
                found = replace(found, **one.sampled(_Peaks(samples)))
        if any(math.isnan(one.value(found)) for one, _ in self.required.asked_for):
            with suppress(GainroomError):
                return margins(self.loop(gains))
        return found

    def known(self, gains: Gains) -> bool:
        """True if the loop with these gains is stable, and every requirement's value is known."""
        return self.required.shortfall(self.margins(gains)) < math.inf

    def stable(self, gains: Gains) -> bool:
        """True if a count of roots finds the loop with these gains stable; False also if the count fails. Much quicker than `known`."""
        key = gains.tobytes()
        if key in self._known:
            return self._known[key].stable
        if key not in self._stable:
            if self.loop(gains).topples:
                self._stable[key] = False
            else:
                samples = take_samples(self._directed, gains, STABLE)
                self._stable[key] = samples.unstable == 0 if samples.followed and samples.unstable >= 0 else None  # None: not known
        return self._stable[key] is True

    def vibrates(self, gains: Gains) -> bool:
        """True if `stable` was asked for these gains and found unstable roots, though the robot does not topple under its weight."""
        return self._stable.get(gains.tobytes()) is False and self.loop(gains).stands

    def follows(self, gains: Gains) -> bool:
        """True if these gains are near enough to those of the anchor to predict curves from its samples."""
        if not self._anchor or not self._asked.curves:
            return False
        before = self._anchor[0][0]
        moving = before > 0
        return np.array_equal(moving, gains > 0) and bool(np.abs(np.log(gains[moving] / before[moving])).max(initial=0.0) < CLOSE)

    def followed(self, gains: Gains) -> "Slopes":
        """Slopes predicted from the samples at the anchor, see `slopes`; curves that have come near −1 since then are missing."""
        return _Curves(self, gains, self._anchor[0][1], NEAR, self.left_out(gains), followed=True).slopes()

    @property
    def anchored(self) -> Gains:
        """Gains (3, m) of the anchor: those whose samples curves are predicted from."""
        return self._anchor[0][0]

    def anchor(self, gains: Gains) -> None:
        """Samples the loop with these gains, which is stable; curves at other gains are predicted from these samples from now on."""
        self._anchor[:] = [(gains, self._samples_at(gains))]

    def slopes(self, gains: Gains) -> "Slopes | None":
        """Shortfalls near 0 with these gains, and their slopes; None where the loop is unstable, or could not be followed."""
        samples = self._samples_at(gains)
        if not samples.followed or samples.unstable != 0:
            return None
        return _Curves(self, gains, samples, NEAR, self.left_out(gains)).slopes()

    def _samples_at(self, gains: Gains) -> LoopSamples:
        """Samples of the loop with these gains; the last ones of a stable loop are stored."""
        key = gains.tobytes()
        if self._last and self._last[0][0] == key:
            return self._last[0][1]
        samples = take_samples(self._directed, gains, self._reach)
        if self._careful:
            samples.tell_apart(self._reach.factor / math.exp(NEAR), self._reach.phase / (1 + NEAR))
        if samples.followed and samples.unstable == 0:
            self._last[:] = [(key, samples)]
        return samples

    def breaks_by_sway(self, gains: Gains) -> bool:
        """True if what gains near the anchor are predicted to break is kept at all frequencies but those of sway."""
        if self.sway is None or self.balanced or not self.breaks(gains):
            return False
        return not self.breaks(gains, self.sway.at(gains).bands)

    def breaks(self, gains: Gains, bands: Floats | None = None) -> str:
        """Name of a requirement that gains near the anchor are predicted to break outside `bands`; "" where none is. None: `left_out`.

        Crossings and peaks near a requirement at the anchor are followed to the new gains: where they come to is a margin of the new loop.
        The requirement that broke last is checked first.
        """
        if not self._anchor:
            return ""
        bands = self.left_out(gains) if bands is None else bands
        curves = _Curves(self, gains, self._anchor[0][1], FOLLOWED, bands, followed=True, broken=True)
        asked = sorted(self.required.asked_for, key=lambda each: each[0].name not in self._broke)
        for one, needed in asked:
            if any(_broken(part) for _, part in one.slopes(curves, needed)):
                self._broke[:] = [one.name]
                return one.name
        return ""


@dataclass(frozen=True)
class Slopes:
    """Shortfalls of c crossings and peaks, negative where a requirement is met, and their derivatives by the gains.

    missed   (c,) the shortfall: ln of a ratio of gains or sensitivities, or a fraction of the required phase
    slope    (c, 2, m) its derivatives by ln of each direction's stiffness, then by ln of its damping
    name     (c,) of the requirement
    """

    missed: Floats
    slope: Floats
    name: tuple[str, ...]

    @classmethod
    def of(cls, parts: "Sequence[Slopes]") -> "Slopes":
        """Slopes of all `parts` in one."""
        missed, slope = (np.concatenate([getattr(part, field) for part in parts]) for field in ("missed", "slope"))
        return cls(missed, slope, tuple(name for part in parts for name in part.name))

    def seen_from(self, step: Floats, most: float) -> "Slopes":
        """Tangents at gains changed by `step` (2, m), as functions of the change from the gains before; shortfalls are at most `most`."""
        return Slopes(np.minimum(self.missed - np.einsum("ijk,jk->i", self.slope, step), most), self.slope, self.name)


def moved(gains: Gains, step: Floats, cascade: Booleans) -> Gains:
    """`gains` (3, m) with ln of stiffness and of damping changed by `step` (2, m).

    The stiffness of a P/PI direction is kp·kv, its damping kv, and ki goes with the stiffness.
    """
    stiffer, damped = np.exp(step)
    return gains * np.array([np.where(cascade, stiffer / damped, stiffer), damped, stiffer])


def stiffness(gains: Gains, cascade: Booleans) -> Floats:
    """Stiffness (m,) of each direction: kp, of a P/PI kp·kv."""
    return gains[0] * np.where(cascade, gains[1], 1.0)


PlacedSlopes = tuple[int, Slopes]
PEAKS, ENDS = 0, 3  # places; loci and return ratios are between


@dataclass(frozen=True)
class _Peaks:
    """Quantities of a loop's samples that a requirement may read (system/loop_protocols.py)."""

    samples: LoopSamples

    def peak(self, slope: float = 1.0, offset: float = 0.0) -> tuple[float, float]:
        """The largest |slope S_ii + offset|, and its frequency [rad/s]."""
        return self.samples.peak(slope, offset)

    def delay(self) -> tuple[float, float]:
        """The least extra delay [s] in all loops, and its frequency [rad/s]."""
        return min(map(tuple, self.samples.delay_crossings(math.inf).tolist()), default=(math.inf, math.nan))


class _Asked:
    """Visitor of the requirements that collects the reach of samples they need; `curves` False: one has no slope in closed form."""

    def __init__(self) -> None:
        self.reach, self.curves = Reach(), True

    def at_axis(self, name: str, factor: float) -> list[PlacedSlopes]:
        return self._wider(Reach(factor=factor * math.exp(NEAR)))

    def at_circle(self, name: str, angle: float) -> list[PlacedSlopes]:
        return self._wider(Reach(phase=min(angle * (1 + NEAR), math.pi)))

    def at_delays(self, name: str, longest: float) -> list[PlacedSlopes]:
        return self._wider(Reach(phase=math.pi))

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> list[PlacedSlopes]:
        return self._wider(Reach(peaks=((slope, offset, ceiling * math.exp(-NEAR)),)))

    def at_sway(self, name: str, needed: float) -> list[PlacedSlopes]:
        return []

    def at_measured(self, requirement: Requirement, needed: float) -> list[PlacedSlopes]:
        return []

    def by_differences(self, requirement: Requirement, needed: float) -> list[PlacedSlopes]:
        self.curves = False
        return []

    def _wider(self, reach: Reach) -> list[PlacedSlopes]:
        self.reach = self.reach.wider(reach)
        return []


@dataclass(frozen=True)
class _Curves:
    """Visitor of the requirements that collects, from samples of a loop, shortfalls above −`near` and their slopes.

    bands      (k, 2) frequencies [rad/s] at which phase margins and sensitivities are left out
    followed   True: `seen` is of gains a little away, and its curves are predicted; margins without a curve are left out
    broken     True: for a check whether anything is broken; parts after the first that is broken are left out, and so are slopes

    Parts come with their place, peaks first, then loci, return ratios and ends: where a search is flat, their order decides by round-off.
    """

    case: GainCase
    gains: Gains
    samples: LoopSamples
    near: float
    bands: Floats
    followed: bool = False
    broken: bool = False

    def slopes(self) -> Slopes:
        """Slopes of all that is required."""
        found = [part for one, needed in self.case.required.asked_for for part in one.slopes(self, needed)]
        return Slopes.of([self._nothing, *(part for _, part in sorted(found, key=lambda pair: pair[0]))])

    @property
    def _nothing(self) -> Slopes:
        return Slopes(np.zeros(0), np.zeros((0, 2, self.case.torque.shape[1])), ())

    def _moving(self, found: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
        """Margins (c,) and their derivatives (c, 2, m) from the core's arrays: (c, 1), and (c, 2 m)."""
        return found[0][:, 0], found[1].reshape(len(found[1]), 2, self.case.torque.shape[1])

    def _outside(self, found: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
        """Margins and derivatives as `_moving` returns them, at frequencies outside `bands` only."""
        omega = found[0][:, 1:]
        kept = ~np.any((omega > self.bands[:, 0]) & (omega < self.bands[:, 1]), axis=1)
        return self._moving((found[0][kept], found[1][kept]))

    def _first_below(self, limit: float, none: float) -> float:
        """Margin at which samples may stop, where a broken one is searched; `none`: nowhere, as it may lie in a band."""
        return limit if self.broken and not len(self.bands) else none

    def at_axis(self, name: str, factor: float) -> list[PlacedSlopes]:
        """Gain margins: where loci and return ratios are real and negative."""
        needed = math.log(factor)
        until = needed - BROKEN if self.broken else 0.0

        def parts() -> Iterator[PlacedSlopes]:
            for place, locus in ((PEAKS + 1, True), (PEAKS + 2, False)):
                crossings = self.samples.crossings(self.gains, locus, True, needed + self.near, until)
                yield place, _limited(needed, *self._moving(crossings), 1.0, name)
                ends = self.samples.ends(self.gains, locus, needed + self.near)
                yield ENDS, _limited(needed, *self._moving(ends), 1.0, name)

        return self._as_far_as_asked(parts())

    def at_circle(self, name: str, angle: float) -> list[PlacedSlopes]:
        """Phase margins: where loci and return ratios are of size 1."""
        until = self._first_below(angle * (1 - BROKEN), 0.0)

        def parts() -> Iterator[PlacedSlopes]:
            for place, locus in ((PEAKS + 1, True), (PEAKS + 2, False)):
                crossings = self.samples.crossings(self.gains, locus, False, angle * (1 + self.near), until)
                yield place, _limited(angle, *self._outside(crossings), angle, name)

        return self._as_far_as_asked(parts())

    def _as_far_as_asked(self, parts: Iterator[PlacedSlopes]) -> list[PlacedSlopes]:
        """List of the parts; if the visitor only checks for broken requirements (`broken`), up to the first broken one."""
        found = []
        for part in parts:
            found.append(part)
            if self.broken and _broken(part[1]):
                break
        return found

    def at_delays(self, name: str, longest: float) -> list[PlacedSlopes]:
        """Delay margins: where loci are of size 1, and their lag there over ω."""
        delays = self.samples.delays(self.gains, longest * math.exp(self.near))
        least, moves = self._moving(delays)
        kept = least > 0
        return [(PEAKS + 1, _believed(np.log(longest / least[kept]), -moves[kept] / least[kept, None, None], name))]

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> list[PlacedSlopes]:
        """Peaks of |slope S_ii + offset|: at a maximum, its shift in frequency changes nothing to first order."""
        until = self._first_below(ceiling * math.exp(BROKEN), math.inf)
        height, moves = self._outside(self.samples.peaks(self.gains, ceiling * math.exp(-self.near), slope, offset, until))
        return [(PEAKS, Slopes(np.log(height / ceiling), moves, (name,) * len(height)))]

    def at_sway(self, name: str, needed: float) -> list[PlacedSlopes]:
        """Damping ratios of sway, in shares of the required one."""
        if self.case.sway is None:
            return []
        sway = self.case.sway.at(self.gains)
        return [(ENDS, Slopes(1 - sway.damping / needed, -sway.slope / needed, (name,) * len(sway.damping)))]

    def by_differences(self, requirement: Requirement, needed: float) -> list[PlacedSlopes]:
        """Shortfall of a margin that no curve gives, and its slopes by finite differences: each needs new samples."""
        case = self.case
        if self.followed:
            return []

        def missed(gains: Gains) -> float:
            found = case.margins(gains)
            return requirement.shortfall(needed, requirement.value(found)) if found.stable else math.inf

        return self._by_differences(missed, requirement.name)

    def at_measured(self, requirement: Requirement, needed: float) -> list[PlacedSlopes]:
        """Shortfall of a quantity that a requirement computes from the loop itself, and its slopes by finite differences."""
        case = self.case
        known = case.margins(case.anchored if self.followed else self.gains).loops

        def missed(gains: Gains) -> float:
            with suppress(GainroomError):
                return requirement.shortfall(needed, requirement.measured_about(known[0], case.loop(gains)))
            return math.inf

        return self._by_differences(missed, requirement.name) if known else []

    def _by_differences(self, missed: Callable[[Gains], float], name: str) -> list[PlacedSlopes]:
        """Shortfall `missed` at the gains, and its slopes by forward differences, one gain at a time."""
        size = self.case.torque.shape[1]
        here, slope = missed(self.gains), np.zeros((1, 2, size))
        if here < -self.near:
            return []
        for place in np.ndindex(2, size) if not self.broken else ():
            step = np.zeros((2, size))
            step[place] = DIFFERENCE
            there = missed(moved(self.gains, step, self.case.cascade))
            slope[0][place] = (there - here) / DIFFERENCE if math.isfinite(there) else BELIEVED
        return [(PEAKS, _believed(np.array([here]), slope, name))]


def _broken(part: Slopes) -> bool:
    return bool(np.any(part.missed > BROKEN))


def _limited(needed: float, margin: Floats, moves: Floats, unit: float, name: str) -> Slopes:
    """Shortfalls of margins of either sign below `needed`, in shares of `unit`, with their slopes."""
    return _believed((needed - np.abs(margin)) / unit, -np.sign(margin)[:, None, None] * moves / unit, name)


def _believed(missed: Floats, slope: Floats, name: str) -> Slopes:
    steepest = np.abs(slope).max(axis=(1, 2), initial=0.0)
    return Slopes(missed, slope * np.minimum(1.0, BELIEVED / np.maximum(steepest, BELIEVED))[:, None, None], (name,) * len(missed))
