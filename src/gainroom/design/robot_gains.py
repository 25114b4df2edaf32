"""Recommended gains of a robot: one set per contact state and one that is safe in all, with every loop closed, over the uncertainty.

The search (gain_search.py) begins with a part of what each joint alone is recommended, with the lightest load that any state gives it and
the longest delay; task directions begin alike. The gains that a file has play no part, but for a P/PI task's, whose proportions are kept.

Where contacts hold a floating base, its weight counts for gains of joints, unless the file says otherwise: they are all that holds the
robot up. They then also meet what is required without it, as a file's own gains are judged. (Tasks know the robot, and compensate the
weight as it changes.) Where no gains are found that meet the requirements with the weight, it is left out, and what it does at the gains
found so is reported beside them.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.coupled_margins import coupled_delay_margin
from ..analysis.margin_record import GainLimit, Margins, worst_of
from ..errors import GainroomError
from ..system.linear.arrays import Floats, Integers
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import StateCase, System
from .gain_cases import SearchedState, case_of, joint_state, task_state
from .gain_search import Raised, raised_gains, stiffness
from .gain_sets import GainSet, RobotGains
from .margin_slopes import Case, Gains
from .mirrored_sets import mirror_image, mirrored
from .side_by_side import Job, each, side_by_side
from .starting_gains import Beginning, JointsAlone, joints_alone, joints_that_move, link_inertia, stable_starts, tasks_alike

SEARCHES = 3
"""For gains that hold between the corners of the uncertainty, too."""
TRIED = 2
"""Beginnings, where one does not come to gains that meet the requirements."""
ALIKE = 0.01
"""Relative: joints whose data and loads differ by less are raised together."""
RESERVE = 1e-3
"""Of each requirement, kept in the search, so that gains may be rounded to few digits: four move each by half of that at most."""
DIGITS = (4, 5, 6, 7)
"""That gains are rounded to: the first that keep what is required."""
EVERYWHERE = ""
"""The contact state of the set that is safe in all."""


@dataclass(frozen=True)
class _Failed:
    """A search, with the weight or without, that came to no gains that meet the requirements; and what it reached.

    safe    the set that was among the beginnings, or None
    cases   for which alone none were found
    """

    weighed: bool
    safe: GainSet | None
    start: Gains
    cases: frozenset[Case]
    reached: Gains

    def over(self, cases: Sequence[Case]) -> Raised:
        """What was reached, as a search over these cases would end, too."""
        return Raised(self.reached, tuple(case.all_margins(self.reached) for case in cases), False)


def recommend_robot(
    system: System,
    space: str = "joint",
    progress: Callable[[], None] = lambda: None,
    start: RobotGains | None = None,
    alone: JointsAlone | None = None,
    by_contact: bool = True,
) -> RobotGains:
    """Gains for the joints, or for the file's tasks (space "task").

    start   gains that are known, such as those found for fewer states: the search, a local one, begins there, too, where it would else
            end softer
    alone   what is known of joints by themselves, and is added to
    by_contact   False: the set for all states alone

    Raises GainroomError where nothing is required, and in task space without tasks.
    """
    states = list(system.cases(weight=space == "joint", inside=True))
    first = states[0].model
    required = system.requirements

    def with_reserve(state: StateCase) -> SearchedState:
        state = replace(state, system=replace(state.system, requirements=required.tightened(RESERVE)))
        return joint_state(state) if space == "joint" else task_state(state)

    found = [with_reserve(state) for state in states]
    moved = [state.model for state, one in zip(states, found, strict=True) if one.moves.any()] or [first]
    beginning = joints_alone(system, first, np.min([link_inertia(model) for model in moved], axis=0), alone)
    if space == "joint":
        names, inertia = system.source.joint_names, first.motor_inertia + link_inertia(first)
    else:
        tasks = system.source.tasks(first, system.control.rotors)
        names, inertia = tasks.directions, None
        beginning = tasks_alike(tasks, beginning)
    nearest: dict[str, str] = {}
    known = {} if start is None else {EVERYWHERE: start.everywhere, **start.per_contact}
    failed: list[_Failed] = []

    def gain_set(
        contact: str,
        states: Sequence[SearchedState],
        checkpoint: Callable[[], None],
        safe: GainSet | None,
        failed: list[_Failed],
        nearest: dict[str, str],
    ) -> GainSet | None:
        def search(some: Sequence[SearchedState]) -> GainSet | None:
            return _set(contact, some, required, beginning, checkpoint, nearest, safe, failed)

        return _over_uncertainty(contact, states, required, nearest, search)

    safe = gain_set(EVERYWHERE, found, progress, known.get(EVERYWHERE), failed, nearest)
    if not by_contact:
        return RobotGains(space, tuple(names), {}, safe, inertia, nearest, _unweighed(system, space, states))
    whole: dict[str, GainSet | None] = {}
    own = {contact: [state for state in found if state.contact == contact] for contact in system.source.contacts}

    def alike(contacts: Sequence[str]) -> Job[tuple[list[GainSet | None], dict[str, str]]]:
        """Sets, and of those not found what came nearest. The first is searched for; what mirrors it has its gains in another order."""

        def job(checkpoint: Callable[[], None]) -> tuple[list[GainSet | None], dict[str, str]]:
            sets: list[GainSet | None] = []
            missed: dict[str, str] = {}
            for contact in contacts:
                found = mirror_image(sets[0], own[contacts[0]], own[contact], required) if sets else None
                sets.append(found or gain_set(contact, own[contact], checkpoint, known.get(contact) or safe, list(failed), missed))
            return sets, missed

        return job

    for contact in [contact for contact, states in own.items() if len(states) == len(found)]:
        whole[contact] = safe and replace(safe, contact=contact)
        if EVERYWHERE in nearest:
            nearest[contact] = nearest[EVERYWHERE]
    some = [contact for contact in own if contact not in whole]
    groups = mirrored(some, own, beginning)
    for contacts, (sets, missed) in zip(groups, side_by_side([alike(contacts) for contacts in groups], progress), strict=True):
        whole.update(zip(contacts, sets, strict=True))
        nearest |= missed
    per_contact = {contact: whole[contact] for contact in own}
    return RobotGains(space, tuple(names), per_contact, safe, inertia, nearest, _unweighed(system, space, states))


def margins_at_rate(system: System, found: GainSet, space: str, rate: float) -> Margins:
    """What gains for every state keep where the loop runs at `rate` [Hz], the rest as it is: the worst of all states and corners."""
    sampled = replace(system, control=replace(system.control, sample_time=1 / rate))
    weight = space == "joint" and not found.without_weight
    return worst_of(each(lambda acting: acting[0].all_margins(acting[1]), list(_acting(sampled, found, space, weight))))


def delay_margin_in_all(system: System, found: GainSet, space: str) -> float:
    """The smallest extra delay [s] at which gains for every state vibrate in one, certified; NaN where it is not known.

    At the corners of the uncertainty; of a range of the delay, which is the same for all, at its shortest: one longer by d leaves less by
    d. With the weight where it counts, and without it, as a file's own gains are judged.
    """
    weights = {space == "joint" and not found.without_weight, False}
    later = 0.0
    if ends := system.uncertainty.delay_range:
        low, high = ends
        system, later = replace(system.with_values(delay=low), uncertainty=system.uncertainty.without("delay")), high - low
    try:
        cases = [case for weight in weights for case in _acting(system, found, space, weight)]
        return min(each(lambda acting: coupled_delay_margin(acting[0].loop(acting[1])), cases)) - later
    except GainroomError:
        return math.nan


def _acting(system: System, found: GainSet, space: str, weight: bool) -> Iterator[tuple[Case, Gains]]:
    """The cases in which these gains act, with the gains as a case takes them."""
    gains = _gains_of(found)
    return ((case_of(case, space), gains) for case in system.cases(weight=weight) if _acts(case, space))


def _acts(case: StateCase, space: str) -> bool:
    """Whether gains of that space move anything there."""
    if space == "joint":
        return bool(joints_that_move(case.model, case.system.control.feedback).any())
    return bool(case.system.source.tasks(case.model, case.system.control.rotors).movable.any())


def _unweighed(system: System, space: str, states: Sequence[StateCase]) -> tuple[str, ...]:
    """Where the weight cannot count although it should."""
    if system.source.gravity is not None or system.source.body.base == "fixed" or space == "task":
        return ()
    return tuple(state.title for state in states if state.model.contacts and state.model.gravity_stiffness is None and not state.place)


def _over_uncertainty(
    contact: str,
    states: Sequence[SearchedState],
    required: Requirements,
    nearest: dict[str, str],
    search: Callable[[Sequence[SearchedState]], GainSet | None],
) -> GainSet | None:
    """What `search` finds for the corners of the uncertainty; places between at which that misses a requirement are searched with, too."""
    searched, between = ([state for state in states if state.state.between is inside] for inside in (False, True))
    for count in itertools.count(1):
        found = search(searched)
        if found is None or not found.moves or not between:
            return found
        gains = _gains_of(found)
        between = [state for state in between if np.any(state.moves & np.any(gains != 0, axis=0))]
        cases = [state.without if found.without_weight else state.with_weight for state in between]
        margins = [case.all_margins(gains) for case in cases]
        kept = [required.met_by(one) for one in margins]
        if all(kept):
            return replace(found, margins=worst_of([found.margins, *margins]), cases=found.cases + len(between))
        if count == SEARCHES:
            nearest[contact] = _nearest(cases, Raised(gains, tuple(margins), False))
            break
        searched += itertools.compress(between, [not one for one in kept])
        between = list(itertools.compress(between, kept))
    return None


def _set(
    contact: str,
    states: Sequence[SearchedState],
    required: Requirements,
    beginning: Beginning,
    progress: Callable[[], None],
    nearest: dict[str, str],
    safe: GainSet | None,
    failed: list[_Failed],
) -> GainSet | None:
    """Gains that none can be raised of in these states; None, and a word in `nearest`, where no beginning leads to some that meet them.

    safe     a set that holds in these and other states: none softer is returned
    failed   searches that came to none, which are not tried again; added to
    """
    given = np.any(beginning.gains != 0, axis=0)
    acting = [state for state in states if np.any(state.moves & given)]
    cascade, size = beginning.cascade, len(given)
    if not acting:
        nothing = np.full(size, math.nan)
        unknown = Margins.unknown(GainLimit.unknown(size))
        return GainSet(contact, nothing, nothing, nothing if cascade.any() else None, unknown, "", 0, nothing)
    free = np.flatnonzero(given & np.any([state.moves for state in acting], axis=0))
    weighed = any(state.weighed for state in acting)
    heavy = [state.with_weight for state in acting]
    light = [state.without for state in acting if state.weighed]
    cases = heavy + light
    found = _from_beginnings(acting, cases, beginning, weighed, free, progress, safe, failed)
    if light and not found.holds:
        cases = heavy
        found = _from_beginnings(acting, cases, beginning, weighed, free, progress, safe, failed)
    without = weighed and not found.holds
    near = "" if found.holds else _nearest(cases, found)
    if without and any(state.state.system.source.gravity for state in acting):  # as the file says: gains without it are no answer
        nearest[contact] = near
        return None
    if without:
        cases = [state.without for state in acting]
        found = _from_beginnings(acting, cases, beginning, False, free, progress, safe, failed)
    if not found.holds:
        nearest[contact] = near
        return None
    immobile = np.setdiff1d(np.arange(size), free)
    gains, margins = _rounded(found, cases, required)
    gains[:, immobile[given[immobile]]] = math.nan
    stiff = stiffness(gains, cascade)
    compliance = np.divide(beginning.unit, stiff, out=np.full(size, math.nan), where=stiff > 0)
    softest = max(free.tolist(), key=lambda j: np.nan_to_num(compliance[j]))
    where = tuple("" if k < 0 else cases[k].title for k in found.case)
    topples = [state.with_weight.title for state in acting if without and not state.with_weight.margins(np.nan_to_num(gains)).stable]
    return GainSet(
        contact,
        gains[0],
        gains[1],
        gains[2] if cascade.any() else None,
        worst_of(margins),
        where[softest],
        len(acting),
        compliance,
        found.margin,
        where,
        softest,
        without,
        near if without else "",
        tuple(topples),
    )


def _rounded(found: Raised, cases: Sequence[Case], required: Requirements) -> tuple[Gains, Sequence[Margins]]:
    """The gains in as few digits as keep what is required, and their margins in every case."""
    for digits in DIGITS:
        gains = np.array([[float(f"{gain:.{digits}g}") for gain in row] for row in found.gains.tolist()])
        margins = [case.all_margins(gains) for case in cases]
        if all(required.met_by(one) for one in margins):
            return gains, margins
    return found.gains.copy(), found.margins


def _from_beginnings(
    states: Sequence[SearchedState],
    cases: Sequence[Case],
    beginning: Beginning,
    weighed: bool,
    free: Integers,
    progress: Callable[[], None],
    safe: GainSet | None,
    failed: list[_Failed],
) -> Raised:
    """The gains that are reached from the first beginning from which any are that meet the requirements; else those that came nearest.

    Where they are softer than `safe`, which has to suit more states, the next beginning is tried, too: the search is a local one.
    A beginning that failed for some of these cases alone would do so again: what was reached then is what came nearest. Where as many as
    are tried did, none is looked for.
    """
    groups, best, reached = _groups(states, beginning, free), None, []
    safe = None if safe is not None and safe.without_weight and weighed else safe

    def softer(gains: Gains, other: Gains) -> bool:
        """Whether they give way more, in what both hold."""
        stiff, beside = (stiffness(each, beginning.cascade)[free] for each in (gains, other))
        both = (stiff > 0) & (beside > 0)
        unit = beginning.unit[free][both]
        return float((unit / stiff[both]).sum()) > float((unit / beside[both]).sum())

    before = [one for one in failed if one.weighed == weighed and one.cases <= set(cases)]
    if len(same := [one for one in before if one.safe is safe]) >= TRIED:
        return min((one.over(cases) for one in same), key=lambda each: _most_missed(cases, each))
    known = None if safe is None else _gains_of(safe, math.nan)
    for start in itertools.islice(stable_starts(cases, beginning, weighed, progress, known), TRIED):
        again = next((one for one in before if np.array_equal(one.start, start)), None)
        found = again.over(cases) if again else raised_gains(cases, start, beginning.unit, groups, beginning.most, progress)
        if best is None or _better(cases, found, best, softer):
            best = found
        if found.holds and (safe is None or not softer(found.gains, _gains_of(safe))):
            break
        if not found.holds:
            missed = again.cases if again else frozenset(cases[k] for k in found.failed)
            reached.append(_Failed(weighed, safe, start, missed, found.gains))
    if best is not None and best.holds:
        return best
    failed += reached
    first = beginning.first(weighed)
    return best or Raised(first, tuple(case.all_margins(first) for case in cases), False)


def _gains_of(found: GainSet, where_none: float = 0.0) -> Gains:
    """(3, m)."""
    whole = np.array([found.kp, found.kd, np.zeros(len(found.kp)) if found.ki is None else found.ki])
    return np.where(np.isnan(whole), where_none, whole)


def _groups(states: Sequence[SearchedState], beginning: Beginning, free: Integers) -> list[list[int]]:
    """Directions that are raised together: legs that take turns are alike."""
    return _alike([*beginning.data, *np.sort([state.load for state in states], axis=0)], free)


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


def _better(cases: Sequence[Case], found: Raised, other: Raised, softer: Callable[[Gains, Gains], bool]) -> bool:
    """Whether it holds where the other does not, or the other is softer; or it comes nearer where neither holds."""
    if found.holds and other.holds:
        return softer(other.gains, found.gains)
    return found.holds or (not other.holds and _most_missed(cases, found) < _most_missed(cases, other))


def _most_missed(cases: Sequence[Case], found: Raised) -> float:
    return max(case.required.shortfall(margins) for margins, case in zip(found.margins, cases, strict=True))


def _nearest(cases: Sequence[Case], found: Raised) -> str:
    """What came nearest, as text."""
    margins, case = max(zip(found.margins, cases, strict=True), key=lambda pair: pair[1].required.shortfall(pair[0]))
    shortage = "too soft for the weight" if case.loop(found.gains).topples else _shortage(margins, case.required)
    return f"{shortage} in {case.title}"


def _shortage(margins: Margins, required: Requirements) -> str:
    """The requirement that is missed most, as text."""
    name = required.missed(margins)
    if name == "stability":
        return "unstable"
    one, needed = REQUIREMENTS[name], required.needed[name]
    texts = ([one.text(value, significant) for value in (one.value(margins), needed)] for significant in range(3, 10))
    found, asked = next((pair for pair in texts if pair[0] != pair[1]), ("less", one.text(needed)))
    return f"{one.named(margins)} {found} of {asked}"
