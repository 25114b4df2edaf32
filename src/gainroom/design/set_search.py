"""The search for one set of gains, over the states that it has to suit and the corners of the uncertainty.

It begins (starting_gains.py) with a part of what each joint alone is recommended, with the lightest load that any state gives it and the
longest delay; task directions begin alike. The gains that a file has play no part, but for a P/PI task's, whose proportions are kept.

Where contacts hold a floating base, its weight counts for gains of joints, unless the file says otherwise: they are all that holds the
robot up. They then also meet what is required without it, as a file's own gains are judged. (Tasks know the robot, and compensate the
weight as it changes.) Where no gains are found that meet the requirements with the weight, it is left out, and what it does at the gains
found so is reported beside them.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from ..analysis.dynamic_stiffness import damping_by_kind
from ..analysis.margin_record import GainLimit, Margins, worst_of
from ..analysis.margins import margins
from ..analysis.margins_outside import margins_outside
from ..errors import GainroomError, first_of_many, listed
from ..system.gain_bounds import GainBounds
from ..system.linear.arrays import Floats, Integers
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import Objective
from .gain_cases import SearchedState
from .gain_search import Raised, raised_gains
from .gain_sets import GainSet, StateStiffness
from .margin_slopes import GainCase, Gains, moved
from .objectives import goal_of
from .starting_gains import Beginning, stable_starts

SEARCHES = 3
"""Most searches for gains that hold between the corners of the uncertainty, too."""
TRIED = 2
"""Most beginnings tried, where one leads to no gains that meet the requirements."""
FAR = 0.5
"""Shortfall of one beginning above which no other was of use in 60 robots that were tried: seen, not proved."""
SOFTER = 3.0
"""Factor by which gains found are lowered to begin a second search: where costs have several minima, it often ends in another one."""
ALIKE = 0.01
"""Relative difference of data and loads below which joints are raised together."""
DIGITS = (4, 5, 6, 7)
"""Digits of rounded gains: the first number of them with which the requirements are met."""


TIED = 1e-3
"""Relative difference of two joints' margins below which round-off may decide which is less, as of mirrored legs."""
AT_JOINT = ", least at "
ON_BOUNDS = ", on the bounds "
"""What stands in the text of a nearest result before the bounds that its gains are on."""


@dataclass(frozen=True)
class _Failed:
    """Search, with the weight or without, that led to no gains that meet the requirements, and the gains it reached.

    cases   for which alone no gains were found
    far     True: the shortfall was so large that other beginnings are not tried
    """

    weighed: bool
    start: Gains
    cases: frozenset[GainCase]
    reached: Gains
    far: bool

    def over(self, cases: Sequence[GainCase]) -> Raised:
        """Result of the failed search over `cases`: the gains reached, and their margins."""
        return Raised(self.reached, tuple(case.all_margins(self.reached) for case in cases), False)


@dataclass(frozen=True)
class SetSearch:
    """Search for one set of gains, the best of those that several beginnings lead to.

    contact     the contact state of the set
    required    the requirements, without the reserve that a search keeps
    objective   what is made best
    beginning   the gains that it begins with
    images      joints that are images of each other, or which the file puts together: they have equal gains
    progress    called at every sampling of a loop
    nearest     filled with the nearest result as text, by contact state, where no set is found
    known       a set that it begins from, too, where it would else end softer
    only        True: it begins from `known` alone
    """

    contact: str
    required: Requirements
    objective: Objective
    beginning: Beginning
    images: Sequence[Sequence[int]]
    progress: Callable[[], None]
    nearest: dict[str, str]
    known: GainSet | None = None
    only: bool = False
    _failed: list[_Failed] = field(default_factory=list)

    def over(self, states: Sequence[SearchedState]) -> GainSet | None:
        """Set of gains for these states; None where no beginning leads to one that meets the requirements.

        The set found for the corners of the uncertainty is checked between them: cases there that miss a requirement join the search.
        """
        searched, between = ([state for state in states if state.state.between is inside] for inside in (False, True))
        for count in itertools.count(1):
            found = self._at_corners(searched)
            if found is None or not found.moves or not between:
                return found
            gains = gains_of(found)
            between = [state for state in between if np.any(state.moves & np.any(gains != 0, axis=0))]
            cases = [state.without if found.without_weight else state.with_weight for state in between]
            margins = [case.all_margins(gains) for case in cases]
            kept = [self.required.met_by(one) for one in margins]
            if all(kept):
                return replace(found, margins=worst_of([found.margins, *margins]), cases=found.cases + len(between))
            if count == SEARCHES:
                self.nearest[self.contact] = self._near(cases, Raised(gains, tuple(margins), False))
                break
            searched += itertools.compress(between, [not one for one in kept])
            between = list(itertools.compress(between, kept))
        return None

    def _at_corners(self, states: Sequence[SearchedState]) -> GainSet | None:
        """Gains that meet the requirements in `states`, from the best of several starting points; None if none is found.

        NaN gains where no direction moves. The plant without weight is searched where weight prevents a solution; where nothing is found
        `nearest` has the nearest result as text.
        """
        given = np.any(self.beginning.gains != 0, axis=0)
        acting = [state for state in states if np.any(state.moves & given)]
        cascade, size = self.beginning.cascade, len(given)
        if not acting:
            nothing = np.full(size, math.nan)
            unknown = Margins.unknown(GainLimit.unknown(size))
            return GainSet(self.contact, nothing, nothing, nothing if cascade.any() else None, unknown, "", 0)
        free = np.flatnonzero(given & np.any([state.moves for state in acting], axis=0))
        weighed = any(state.weighed for state in acting)
        heavy = [state.with_weight for state in acting]
        light = [state.without for state in acting if state.weighed]
        cases = heavy + light
        found = self._from_beginnings(acting, cases, weighed, free)
        if light and not found.holds:
            cases = heavy
            found = self._from_beginnings(acting, cases, weighed, free)
        without = weighed and not found.holds
        near = "" if found.holds else self._near(cases, found)
        if without and any(state.state.system.source.gravity for state in acting):  # the file excludes gains without the weight
            self.nearest[self.contact] = near
            return None
        if without:
            cases = [state.without for state in acting]
            found = self._from_beginnings(acting, cases, False, free)
        if not found.holds:
            self.nearest[self.contact] = near
            return None
        immobile = np.setdiff1d(np.arange(size), free)
        gains, margins = _rounded(found, cases, self.required, self._bounds(acting, free))
        gains[:, immobile[given[immobile]]] = math.nan
        links = _links(acting, np.nan_to_num(gains), without)
        where = tuple("" if k < 0 else cases[k].title for k in found.case)
        topples = [state.with_weight.title for state in acting if without and not state.with_weight.margins(np.nan_to_num(gains)).stable]
        whole = GainSet(
            self.contact,
            gains[0],
            gains[1],
            gains[2] if cascade.any() else None,
            worst_of(margins),
            "",
            len(acting),
            links,
            found.margin,
            where,
            found.of_sway,
            without_weight=without,
            nearest=near if without else "",
            topples=tuple(topples),
        )
        least, geared = (
            np.nan_to_num(whole.stiffness, nan=math.inf),
            [k >= 0 and links[k].gear_limited[j] for j, k in enumerate(whole.softest_in)],
        )
        softest = min(free.tolist(), key=lambda j: (geared[j], least[j]))  # a gearbox's limit is not the gains'
        return replace(whole, binding=where[softest], softest=softest)

    def _from_beginnings(self, states: Sequence[SearchedState], cases: Sequence[GainCase], weighed: bool, free: Integers) -> Raised:
        """Best result of several beginnings that meets the requirements; else the nearest one.

        With the largest kp as objective the first that does is taken, unless it is softer than `known`; then the next beginning is tried,
        too: the search is a local one. With dynamic stiffness of joints in all states, a third of the gains found so far is a beginning as
        well, and so are soft gains with equal rates: with gains of each joint alone a light joint starts far stiffer than its neighbours.
        A beginning that failed for some of these cases alone would fail again: its result then counts as the nearest. After TRIED
        failures no further beginning is tried.
        """
        groups, best = _groups(states, self.beginning, free, self.images), None
        bounds = self._bounds(states, free)
        beginning = replace(self.beginning, gains=_equal(self.beginning.gains, groups), bounds=bounds)
        goal = goal_of(self.objective, cases, beginning.unit, beginning.weight, groups)
        reached: list[_Failed] = []
        known = None if self.known is not None and self.known.without_weight and weighed else self.known

        def search(start: Gains) -> Raised:
            rest = beginning.most, self.progress, self.objective, beginning.weight, bounds
            return raised_gains(cases, start, beginning.unit, groups, *rest)

        before = [one for one in self._failed if one.weighed == weighed and one.cases <= set(cases)]
        if len(before) >= TRIED or (known is None and any(one.far for one in before)):
            return min((one.over(cases) for one in before), key=lambda each: _most_missed(cases, each))
        whole = None if known is None else gains_of(known, math.nan)
        for start in itertools.islice(stable_starts(cases, beginning, weighed, self.progress, whole, self.only), TRIED):
            again = next((one for one in before if np.array_equal(one.start, start)), None)
            found = again.over(cases) if again else search(start)
            if best is None or _better(cases, found, best, goal.softer):
                best = found
            if found.holds and (known is None or not goal.softer(found.gains, gains_of(known))):
                break
            if not found.holds and not again:
                short = max(cases[k].required.shortfall(found.margins[k]) for k in found.failed)
                reached.append(_Failed(weighed, start, frozenset(cases[k] for k in found.failed), found.gains, short > FAR))
                if short > FAR and known is None:
                    break
        if best is not None and best.holds:
            if self.objective == "largest_kp" or self.contact or not cases[0].joints:
                return best
            third = bounds.within(moved(best.gains, np.full((2, best.gains.shape[1]), -math.log(SOFTER)), beginning.cascade))
            for start in (third, _equal(beginning.even(), groups)):
                if all(case.known(start) for case in cases) and _better(cases, found := search(start), best, goal.softer):
                    best = found
            return best
        self._failed.extend(reached)
        first = beginning.first(weighed)
        return best or Raised(first, tuple(case.all_margins(first) for case in cases), False)

    def _bounds(self, states: Sequence[SearchedState], free: Integers) -> GainBounds:
        """Bounds of each direction, those of its group among them."""
        return self.beginning.bounds.shared(_groups(states, self.beginning, free, self.images), len(self.beginning.unit))

    def _near(self, cases: Sequence[GainCase], found: Raised) -> str:
        """Shortfall of the nearest result, as text, and which bounds its gains are on."""
        reached = {name: np.flatnonzero(self.beginning.bounds.on(name, found.gains)) for name in self.beginning.bounds.names}
        bounds = [f"{name} of {first_of_many([self.beginning.names[int(k)] for k in on])}" for name, on in reached.items() if len(on)]
        return _nearest(cases, found, self.beginning.names) + (f"{ON_BOUNDS}{listed(bounds)}" if bounds else "")


def gains_of(found: GainSet, where_none: float = 0.0) -> Gains:
    """Gains (3, m), kp, kd and ki, of a set; `where_none` for directions that nothing moves."""
    whole = np.array([found.kp, found.kd, np.zeros(len(found.kp)) if found.ki is None else found.ki])
    return np.where(np.isnan(whole), where_none, whole)


def _rounded(found: Raised, cases: Sequence[GainCase], required: Requirements, bounds: GainBounds) -> tuple[Gains, Sequence[Margins]]:
    """The gains in as few digits as keep what is required and the bounds, and their margins in every case."""
    for digits in DIGITS:
        gains = bounds.within(np.array([[float(f"{gain:.{digits}g}") for gain in row] for row in found.gains.tolist()]))
        margins = [case.all_margins(gains) for case in cases]
        if all(required.met_by(one) for one in margins):
            return gains, margins
    return found.gains.copy(), found.margins


def _links(states: Sequence[SearchedState], gains: Gains, without: bool) -> tuple[StateStiffness, ...]:
    """Dynamic stiffness in each posture and contact state with these gains, in the worst case; `without` the weight, or also with it."""
    found: dict[str, StateStiffness] = {}
    for state in states:
        title = f"{state.state.posture}/{state.state.contact}"
        for case in dict.fromkeys([state.without] if without else [state.with_weight, state.without]):
            own, omega, geared = case.peaks(gains).softest(gains.shape[1])
            if title not in found:
                loop = case.loop(gains)
                sway = np.zeros(0) if case.sway is None else case.sway.at(gains).frequency
                damping = damping_by_kind(loop, sway, np.unique(omega[geared]))
                found[title] = StateStiffness(title, state.contact, own, omega, geared, damping)
                continue
            one = found[title]
            softer = (own < one.stiffness) | np.isnan(one.stiffness)
            found[title] = replace(
                one,
                stiffness=np.where(softer, own, one.stiffness),
                omega=np.where(softer, omega, one.omega),
                gear_limited=np.where(softer, geared, one.gear_limited),
            )
    return tuple(found.values())


def _groups(states: Sequence[SearchedState], beginning: Beginning, free: Integers, images: Sequence[Sequence[int]]) -> list[list[int]]:
    """Groups of directions with equal gains: images of each other with like data, and those with like data and loads in all states."""
    apart = [sorted({*image} & {*free.tolist()}) for image in images]
    found = [group for image in apart for group in _alike(beginning.data, np.array(image, dtype=int))] if len(beginning.data) else []
    rest = np.setdiff1d(free, np.concatenate(apart).astype(int) if apart else free[:0])
    return [*found, *_alike([*beginning.data, *np.sort([state.load for state in states], axis=0)], rest)]


def _equal(gains: Gains, groups: Sequence[Sequence[int]]) -> Gains:
    """Gains (3, m) with the least of each group in all of it."""
    found = gains.copy()
    for group in groups:
        found[:, group] = gains[:, group].min(axis=1, keepdims=True)
    return found


def _alike(data: Sequence[Floats], free: Integers) -> list[list[int]]:
    """Directions `free` in groups whose `data` (each (m,)) are the same within ALIKE."""
    found: list[list[int]] = []
    table = np.array(data)
    for j in free.tolist():
        for group in found:
            if np.allclose(table[:, j], table[:, group[0]], rtol=ALIKE, atol=0.0):
                group.append(j)
                break
        else:
            found.append([j])
    return found


def _better(cases: Sequence[GainCase], found: Raised, other: Raised, softer: Callable[[Gains, Gains], bool]) -> bool:
    """True if `found` meets the requirements and `other` does not or is softer; or neither does and `found` is nearer to them."""
    if found.holds and other.holds:
        return softer(other.gains, found.gains)
    return found.holds or (not other.holds and _most_missed(cases, found) < _most_missed(cases, other))


def _most_missed(cases: Sequence[GainCase], found: Raised) -> float:
    return max(case.required.shortfall(margins) for margins, case in zip(found.margins, cases, strict=True))


def _nearest(cases: Sequence[GainCase], found: Raised, names: Sequence[str]) -> str:
    """Shortfall of the nearest result, the case in which it occurs and the joint that has least, as text."""
    margins, case = max(zip(found.margins, cases, strict=True), key=lambda pair: pair[1].required.shortfall(pair[0]))
    if case.loop(found.gains).topples:
        return f"too soft for the weight in {case.title}"
    joint = _worst_joint(case, found.gains, case.required.missed(margins)) if case.joints else None
    return f"{_shortage(margins, case.required)} in {case.title}" + ("" if joint is None else f"{AT_JOINT}{names[joint]}")


def _worst_joint(case: GainCase, gains: Gains, name: str) -> int | None:
    """The joint whose own loop has least of a margin, the first of those that are TIED; None where it is not of one loop, or not known."""
    if name not in REQUIREMENTS:
        return None
    with suppress(GainroomError):
        loop = case.loop(gains)
        each = REQUIREMENTS[name].of_loops(margins_outside(loop, margins(loop), case.left_out(gains)))
        if each is not None and not np.isnan(each).any():
            worst = each >= (1 - TIED) * each.max() if REQUIREMENTS[name].at_most else each <= each.min() + TIED * abs(each.min())
            return int(np.flatnonzero(worst)[0])
    return None


def _shortage(margins: Margins, required: Requirements) -> str:
    """The requirement that is missed most, as text; gains of loops that a search could not follow may miss none."""
    name = required.missed(margins)
    if name in ("stability", ""):
        return "unstable" if name else "margins that are not certified"
    one, needed = required.asked_by(name)
    texts = ([one.text(value, significant) for value in (one.value(margins), needed)] for significant in range(3, 10))
    found, asked = next((pair for pair in texts if pair[0] != pair[1]), ("less", one.text(needed)))
    return f"{one.named(margins)} {found} of {asked}"
