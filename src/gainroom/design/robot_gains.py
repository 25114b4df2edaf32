"""Recommended gains of a robot: one set per contact state and one that is safe in all, with every loop closed, over the uncertainty.

Each set is searched for by itself (set_search.py), in parallel. Where a contact state's own set is softer than the one safe in all, which
holds there, too, it is searched for again from that: the search is a local one.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.boundary import coupled_delay_margin
from ..analysis.margin_record import Margins, worst_of
from ..errors import GainroomError
from ..system.requirements import Requirements
from ..system.system import Objective, StateCase, System
from ..system.uncertainty import Place
from .gain_cases import SearchedState, case_of, joint_state, task_state
from .gain_sets import GainSet, RobotGains
from .margin_slopes import GainCase, Gains
from .mirror import mirror_image, mirrored
from .parallel import Job, each, in_parallel
from .set_search import SetSearch, gains_of
from .starting_gains import Beginning, JointsAlone, joints_alone, joints_that_move, link_inertia, tasks_alike

RESERVE = 1e-3
"""Share of each requirement kept in reserve, so that gains may be rounded: four digits change a margin by half of it at most."""
EVERYWHERE = ""
"""The contact state of the set that is safe in all."""


def recommend_robot(
    system: System,
    space: str = "joint",
    progress: Callable[[], None] = lambda: None,
    start: RobotGains | None = None,
    alone: JointsAlone | None = None,
    by_contact: bool = True,
    places: Sequence[Place] = (),
) -> RobotGains:
    """Gains for the joints, or for the file's tasks (space "task").

    start   gains that are known, such as those found for fewer states: the search, a local one, begins there, too, where it would else
            end softer
    alone   what is known of joints by themselves, and is added to
    by_contact   False: the set for all states alone
    places  further ones in the uncertainty at which the gains have to hold, in every state

    Raises GainroomError where nothing is required, and in task space without tasks.
    """
    weight = _weighs(system, space)
    further = [system.case_at(place, posture, contact, weight) for posture, contact in system.source.states for place in places]
    states = [*system.cases(weight=weight, inside=True), *(replace(case, between=False) for case in further)]
    first = states[0].model
    required, searched = system.requirements, joint_state if space == "joint" else task_state
    every = [searched(replace(state, system=replace(state.system, requirements=required.tightened(RESERVE)))) for state in states]
    moved = [state.model for state, one in zip(states, every, strict=True) if one.moves.any()] or [first]
    beginning = joints_alone(system, first, np.min([link_inertia(model) for model in moved], axis=0), alone)
    if space == "joint":
        names, inertia = system.source.joint_names, first.motor_inertia + link_inertia(first)
    else:
        tasks = system.source.tasks(first, system.control.rotors)
        names, inertia = tasks.directions, None
        beginning = tasks_alike(tasks, beginning)
    own = {contact: [one for one in every if one.contact == contact] for contact in system.source.contacts}
    known = {} if start is None else {EVERYWHERE: start.everywhere, **start.per_contact}
    images = equal_joints(system) if space == "joint" else ()
    searches = _Searches({**own, EVERYWHERE: every}, searched, required, system.objective, beginning, images, known)
    some = [contact for contact in own if by_contact and len(own[contact]) < len(states)]
    sets, missed = searches.sets(mirrored(some, own, beginning, images), progress)
    everywhere = sets.pop(EVERYWHERE)
    for contact in [contact for contact in own if by_contact and contact not in some]:  # all states have it
        sets[contact] = everywhere and replace(everywhere, contact=contact)
        if EVERYWHERE in missed:
            missed[contact] = missed[EVERYWHERE]
    nearest = {contact: missed[contact] for contact in (EVERYWHERE, *own) if contact in missed}
    per_contact = {contact: sets[contact] for contact in own if by_contact}
    return RobotGains(space, tuple(names), per_contact, everywhere, inertia, nearest, _unweighed(system, space, states))


_Sets = tuple[dict[str, GainSet | None], dict[str, str]]
"""Sets by contact state, and for those not found the nearest result as text."""


@dataclass(frozen=True)
class _Searches:
    """Searches for sets of gains, one for each contact state and one for all: from `beginning`, and from `known` sets.

    searched   makes a state with loops of its own, so that no search depends on samples that another has taken
    """

    states: Mapping[str, Sequence[SearchedState]]
    searched: Callable[[StateCase], SearchedState]
    required: Requirements
    objective: Objective
    beginning: Beginning
    images: Sequence[Sequence[int]]
    known: Mapping[str, GainSet | None]

    def sets(self, groups: Sequence[Sequence[str]], progress: Callable[[], None]) -> _Sets:
        """Sets for all states together and for the contact states, in groups that mirror each other; the nearest where none is found."""
        groups = sorted(groups, key=self._effort, reverse=True)  # the longest searches begin first
        found: dict[str, GainSet | None] = {}
        nearest: dict[str, str] = {}
        for sets, missed in in_parallel([self._of([EVERYWHERE]), *map(self._of, groups)], progress):
            found |= sets
            nearest |= missed
        safe = found[EVERYWHERE]
        behind = [group for group in groups if safe is not None and any(self._behind(contact, found[contact], safe) for contact in group)]
        for sets, _ in in_parallel([self._of(group, safe) for group in behind], progress):
            for contact, one in sets.items():
                before = found[contact]
                if one is not None and self._behind(contact, before, one):
                    near = nearest.pop(contact) if before is None else before.nearest
                    found[contact] = replace(one, nearest=near if one.without_weight else "")
        return found, nearest

    def _effort(self, group: Sequence[str]) -> int:
        """Number of cases in a group's search: with the weight where it counts, and without it."""
        return sum(1 + state.weighed for state in self.states[group[0]])

    def _behind(self, contact: str, one: GainSet | None, other: GainSet) -> bool:
        """True if `other` is the better set for `contact`: with the weight where it counts and `one` is without it, or else stiffer."""
        if one is None:
            return True
        if one.without_weight != other.without_weight and any(state.weighed for state in self.states[contact]):
            return one.without_weight
        return one.times_stiffer(other) < 1

    def _of(self, group: Sequence[str], safe: GainSet | None = None) -> Job[_Sets]:
        """Job that searches for the first set of a group, and gives the mirrored states the same gains in their order.

        safe   the only set to begin from, if it is given
        """

        def job(checkpoint: Callable[[], None]) -> _Sets:
            states = {contact: [self.searched(one.state) for one in self.states[contact]] for contact in group}
            sets: dict[str, GainSet | None] = {}
            missed: dict[str, str] = {}
            first = group[0]
            for contact in group:
                image = mirror_image(sets[first], states[first], states[contact], self.required) if sets else None
                known = safe or self.known.get(contact)
                search = SetSearch(
                    contact, self.required, self.objective, self.beginning, self.images, checkpoint, missed, known, safe is not None
                )
                sets[contact] = image or search.over(states[contact])
            return sets, missed

        return job


def equal_joints(system: System) -> tuple[tuple[int, ...], ...]:
    """Groups of joints with equal gains, every joint in one: those of the file, or joints that are images of each other by name."""
    if system.groups is not None:
        grouped = {k for group in system.groups for k in group}
        return (*system.groups, *((k,) for k in range(len(system.source.joint_names)) if k not in grouped))
    from ..robot.mirror_names import images  # loads what a single joint does not need

    return images(system.source.joint_names)


def margins_at_rate(system: System, found: GainSet, space: str, rate: float) -> Margins:
    """Margins of a set of gains where the loop runs at `rate` [Hz], all else as it is: the worst of all states and corners."""
    sampled = replace(system, control=replace(system.control, sample_time=1 / rate))
    weight = _weighs(system, space) and not found.without_weight
    return worst_of(each(lambda acting: acting[0].all_margins(acting[1]), list(_acting(sampled, found, space, weight))))


def delay_margin_in_all(system: System, found: GainSet, space: str) -> float:
    """The smallest extra delay [s] at which gains for every state vibrate in one, certified; NaN where it is not known.

    At the corners of the uncertainty; of a range of the delay, which is the same for all, at its shortest: one longer by d leaves less by
    d. With the weight where it counts, and without it, as a file's own gains are judged.
    """
    weights = {_weighs(system, space) and not found.without_weight, False}
    later = 0.0
    if ends := system.uncertainty.delay_range:
        low, high = ends
        system, later = replace(system.with_values(delay=low), uncertainty=system.uncertainty.without("delay")), high - low
    try:
        cases = [case for weight in weights for case in _acting(system, found, space, weight)]
        return min(each(lambda acting: coupled_delay_margin(acting[0].loop(acting[1])), cases)) - later
    except GainroomError:
        return math.nan


def _acting(system: System, found: GainSet, space: str, weight: bool) -> Iterator[tuple[GainCase, Gains]]:
    """The cases in which these gains act, with the gains as a case takes them."""
    gains = gains_of(found)
    return ((case_of(case, space), gains) for case in system.cases(weight=weight) if _acts(case, space))


def _weighs(system: System, space: str) -> bool:
    """True if the joints' gains alone hold a standing robot's weight: no task or balance controller does."""
    return space == "joint" and system.balance != "controller"


def _acts(case: StateCase, space: str) -> bool:
    """True if gains of that space ("joint" or "task") move anything in that state."""
    if space == "joint":
        return bool(joints_that_move(case.model, case.system.control.feedback).any())
    return bool(case.system.source.tasks(case.model, case.system.control.rotors).movable.any())


def _unweighed(system: System, space: str, states: Sequence[StateCase]) -> tuple[str, ...]:
    """Titles of the states in which the weight is left out although it should count."""
    if system.source.gravity is not None or system.source.body.base == "fixed" or not _weighs(system, space):
        return ()
    return tuple(state.title for state in states if state.model.contacts and state.model.gravity_stiffness is None and not state.place)
