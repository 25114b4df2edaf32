"""Analysis of a system: margins of every state, joint and task, and which requirements are met in all of them.

One record for one joint and for a robot: a joint is a system of one state. Each study (joint.py, robot.py, audit.py) extends it.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from typing_extensions import Self

from ..analysis.margin_record import Margins
from ..design.gain_cases import bounded_margins
from ..errors import GainroomError
from ..system.requirements import REQUIREMENTS, reported
from ..system.system import Balance, System
from ..system.uncertainty import Uncertainty
from .critical_joints import critical_joints_in
from .over_uncertainty import Worst, unknown_first
from .progress import Progress, quiet
from .state import State, limit_headroom, limiting_joints, state_of
from .verdict import Finding, Level, Read, Verdict, judged, missed

THIS_STATE = "this state"
KEYS = {
    "rate_unknown": "control.sample_rate_hz",
    "gearbox_unknown": "joints: stiffness",
    "motor_inertia_unknown": "joints: motor_inertia",
    "nothing_required": "limits",
    "sway": "balance",
    "topples_with_weight": "model.gravity_stiffness, or balance: controller",
}
"""Keys of a joint.yaml or robot.yaml that give missing data, by the code of the finding."""


@dataclass(frozen=True)
class Analysis:
    """System with all its states, in the source's order."""

    system: System
    every: tuple[State, ...]

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict safe, unsafe or undecided, with all findings."""
        return verdict_of(self)

    @property
    def remedies(self) -> Mapping[str, str]:
        """File key, or option, that gives missing data, by the code of the finding."""
        return KEYS

    @property
    def ranges(self) -> Uncertainty | None:
        """Uncertainty whose worst place the system is at; None if it is at its nominal values, or nothing is uncertain."""
        return None

    def title_of(self, state: State) -> str:
        """Posture and contact state of a state; "" for a joint."""
        return state.title if state.posture else ""

    @property
    def states(self) -> tuple[State, ...]:
        """States in which the gains act on some motion: one or more."""
        return tuple(state for state in self.every if state.moves)

    @property
    def immobile(self) -> tuple[State, ...]:
        """States in which the gains act on no motion: no loop is closed, so there is no verdict and no limit."""
        return tuple(state for state in self.every if not state.moves)

    @property
    def examined(self) -> str:
        """Count of the states examined, as text, if some of the system's are missing; "" if all are examined."""
        count, total = len(self.every), len(self.system.source.states)
        return "" if count >= total else THIS_STATE if count == 1 else f"{count} of {total} states"

    @property
    def tightest(self) -> State:
        """State with the least headroom."""
        return min(self.states, key=lambda state: limit_headroom(state.limit))

    @property
    def tightest_by_contact(self) -> tuple[State, ...]:
        """State with the least headroom among the postures of each contact state, in the source's order."""
        contacts = dict.fromkeys(state.contact for state in self.states)
        groups = ([state for state in self.states if state.contact == contact] for contact in contacts)
        return tuple(min(group, key=lambda state: limit_headroom(state.limit)) for group in groups)

    @property
    def stable(self) -> bool:
        """True if stable in every state in which the gains act."""
        return all(state.limit.stable for state in self.states)

    @property
    def without_limit(self) -> list[State]:
        """States whose stability is known but whose limit is not."""
        return [state for state in self.states if math.isnan(state.limit.gain)]

    @property
    def stable_in_range(self) -> bool:
        """True if stable at the nominal values, and in every examined case within the uncertainty."""
        return self.stable and not self.unstable_case

    @property
    def unstable_case(self) -> str:
        """State and case within the uncertainty in which the gains are unstable, as text.

        "" if none is found, or they are nominally unstable.
        """
        found = [(self.title_of(state), self.worst_in(state).unstable_at) for state in self.states] if self.stable else []
        return next((f"{title} ({case})" if title else case for title, case in found if case), "")

    def worst_in(self, state: State) -> Worst:
        """Worst margins of one state over the uncertainty."""
        return state.worst_case

    def least(self, state: State, name: str) -> float:
        """Value bounded by the requirement `name` in one state, at the worst of the uncertainty; NaN: not known."""
        return REQUIREMENTS[name].value(self.worst_in(state).margins)

    def case_of(self, name: str) -> str:
        """Case of the uncertainty in which a requirement has its worst value, in its worst state, as text; "" at the nominal values."""
        return self.worst_in(self.worst[name]).at.get(name, "")

    @cached_property
    def balanced(self) -> "Self":
        """Analysis in which a controller above the joints damps sway, so that sway does not count in the margins."""
        return replace(self, system=replace(self.system, balance="controller"), every=tuple(state.balanced for state in self.every))

    @cached_property
    def swaying(self) -> dict[str, State]:
        """Requirements missed because of sway alone, by name with their worst states; {} if a controller damps it."""
        if self.system.balance == "controller" or not self.unmet or not any(state.sway for state in self.states):
            return {}
        missed = self.balanced.unmet
        return {name: state for name, state in self.unmet.items() if name not in missed}

    @property
    def sway_is_open(self) -> bool:
        """True if the verdict depends on which controller damps sway, and that is not stated."""
        return not self.system.balance and len(self.swaying) == len(self.unmet) > 0

    @property
    def damped_above(self) -> dict[str, State]:
        """First state in which the nominal margins miss a requirement because of sway alone, by the requirement's name.

        Empty unless the loop is stable and a balance controller above the joints is stated to damp sway.
        """
        if self.system.balance != "controller" or not self.stable:
            return {}
        short = [(state, name) for state in self.states for name in self.system.requirements.asked if self._misses(state.margins, name)]
        return {name: state for state, name in reversed(short) if not self._misses(state.counted, name)}

    def _misses(self, found: Margins, name: str) -> bool:
        return self.system.requirements.met(name, REQUIREMENTS[name].value(found)) is False

    @cached_property
    def worst(self) -> dict[str, State]:
        """Worst state of each requirement, by name; a state whose value is not known comes first.

        A margin that is not required may not be known over the uncertainty; then its nominal value counts. Among mirrored states, equal
        within round-off, the first is taken.
        """

        def left(state: State, name: str) -> float:
            one, value = REQUIREMENTS[name], self.least(state, name)
            value = one.value(state.counted) if math.isnan(value) and name not in self.system.requirements.asked else value
            return unknown_first(-value if one.at_most else value)

        found = (state.counted for state in self.states)
        names = [one.name for one in reported(self.system.requirements, self.states[0].model.size > 1, *found)]
        return {name: min(self.states, key=lambda state, name=name: left(state, name)) for name in names}

    @cached_property
    def unmet(self) -> dict[str, State]:
        """Requirements missed in some state or case, each with its worst state, largest shortfall first.

        Empty for an unstable system.
        """
        asked, short = self.system.requirements, self._shortfalls
        missed = {name: self.worst[name] for name in short if asked.met(name, self.least(self.worst[name], name)) is False}
        return dict(sorted(missed.items(), key=lambda item: -short[item[0]]))

    @property
    def requirements_met(self) -> bool | None:
        """True if stable and every requirement is met in every state and case; None if met there but not proved between cases."""
        met = self.stable_in_range and not self.unmet
        return None if met and self.system.uncertainty.names else met

    @cached_property
    def unstable_at_usual_rate(self) -> State | None:
        """State in which gains stable in continuous time are unstable at USUAL_RATE; None if there is none, or a rate is given."""
        if not (self.system.rate_is_missing and self.stable):
            return None
        states = (state.at_usual_rate for state in self.states)
        try:
            return next((state for state in states if not state.stable), None)
        except GainroomError:  # a controller that is made for continuous time alone
            return None

    @cached_property
    def missed_at_usual_rate(self) -> dict[str, float]:
        """Values that miss a requirement when the present gains run at USUAL_RATE, by name; {} if a rate is given.

        Only states that decide in continuous time are examined, so further requirements may be missed; only without uncertainty.
        """
        if not self.system.rate_is_missing or self.system.uncertainty.names or self.unstable_at_usual_rate is not None or not self.decisive:
            return {}
        deciding = {state.title: state for state in (*self.unmet.values(), self.worst[self.decisive])}
        try:
            found = [bounded_margins(state.at_usual_rate.case) for state in deciding.values()]
        except GainroomError:  # a controller that is made for continuous time alone
            return {}
        missed = {}
        for one, needed in self.system.requirements.asked_for:
            values = [value for margins in found if not one.met(needed, value := one.value(margins)) and not math.isnan(value)]
            if values:
                missed[one.name] = (max if one.at_most else min)(values)
        return missed

    @property
    def decisive(self) -> str:
        """Requirement with the largest shortfall, or the tightest if all are met; "" if unstable or nothing is required."""
        short = self._shortfalls
        return max(short, key=short.__getitem__, default="")

    @property
    def _shortfalls(self) -> dict[str, float]:
        """Shortfall of each requirement in its worst state, see Requirement.shortfall; {} for an unstable system."""
        asked = self.system.requirements.asked_for if self.stable_in_range else ()
        return {one.name: one.shortfall(needed, self.least(self.worst[one.name], one.name)) for one, needed in asked}


def analyze(system: System, progress: Progress | None = None, numbers: tuple[str, ...] = ("margins",)) -> Analysis:
    """Analysis of every state of a system; `numbers` (properties of State) are computed now, all others on demand.

    progress   called with (states done, states in all, name of the next)

    Raises GainroomError for a state that cannot be linearised, where its numbers are too far apart to compute with, and where the gains act
    on no motion in any state.
    """
    return analyzed(system, in_turn(system, system.source.states, progress or quiet, numbers))


def in_turn(system: System, places: Sequence[tuple[str, str]], progress: Progress, numbers: tuple[str, ...]) -> Iterator[State]:
    """States at `places`, computed one after the other; arguments as analyze."""
    for index, (posture, contact) in enumerate(places):
        progress(index, len(places), f"state {posture}/{contact}")
        yield state_of(system, posture, contact, numbers)
    progress(len(places), len(places), "")


def analyzed(system: System, states: Iterable[State]) -> Analysis:
    """Analysis of given states. Raises GainroomError if the gains act on no motion in any."""
    found = tuple(states)
    if not any(state.moves for state in found):
        raise GainroomError(f"{system.source.name}: {found[0].reason} in any posture and contact state, so there is nothing to study")
    return Analysis(system, found)


def verdict_of(study: Analysis) -> Verdict:
    """Verdict of an analysis."""
    found = (*found_unstable(study), *found_missed(study), *rests_on(study))
    return judged(study.system, study.remedies, found, lambda level: read_as(study.system, found, study.states, level, study.ranges))


def read_as(system: System, found: Iterable[Finding], states: Sequence[State], level: Level, ranges: Uncertainty | None = None) -> Read:
    """Decision over all readings of a system's missing data; states with an unsafe finding are examined first."""
    from .readings import read  # types of gearboxes, which a joint does without

    return read(system, unsafe_first(found, states), level, ranges)


def unsafe_first(findings: Iterable[Finding], states: Sequence[State]) -> list[State]:
    """States ordered with unsafe findings first, then by headroom."""
    named = {one.state for one in findings if one.level == "unsafe"}
    return sorted(states, key=lambda state: (state.title not in named, limit_headroom(state.limit)))


def found_unstable(study: Analysis) -> Iterator[Finding]:
    """Findings of unstable states; if none is nominally unstable, of the unstable case in the ranges."""
    yield from (unstable(state, study.title_of(state)) for state in study.states if not state.limit.stable)
    if study.unstable_case:
        yield Finding("unstable_in_range", "unsafe", {}, study.unstable_case)


def unstable(state: State, title: str) -> Finding:
    """Finding of one unstable state."""
    limit = state.limit
    values = {"gain_limit": limit.gain, "lower_gain_limit": limit.lower_gain, "limit_frequency_rad_s": limit.frequency}
    return Finding("topples" if state.loop.topples else "unstable", "unsafe", values, title, state.limiting_joints)


def found_missed(study: Analysis) -> Iterator[Finding]:
    """Findings of requirements that a stable system misses, largest shortfall first; an unknown value leaves the verdict undecided."""
    required = study.system.requirements
    for name, state in study.unmet.items():
        omega = REQUIREMENTS[name].frequency(study.worst_in(state).margins)
        joints = critical_joints_in(state, name) if len(study.system.source.joint_names) > 1 else ()
        found = missed(required, name, study.least(state, name), frequency=omega, state=study.title_of(state), joints=joints)
        yield replace(found, level="undecided") if name in study.swaying and not study.system.balance else found
    yield from sway_found(study.system, list((study.swaying or study.damped_above).values()), study.remedies["sway"])


def sway_found(system: System, states: Sequence[State], remedy: str) -> list[Finding]:
    """Sway finding of the first of `states` in which sway alone misses a requirement, judged by `balance`; [] without states.

    Its values are frequency, damping ratio, and whether the weight topples the robot; its joints are those that move in it.
    """
    levels: dict[Balance, Level] = {"": "undecided", "joints": "unsafe", "controller": "safe"}
    if not states or (sway := states[0].sway) is None:
        return []
    state = states[0]
    values = {"frequency_rad_s": sway.frequency, "damping_ratio": sway.damping_ratio, "topples_with_weight": state.topples_with_weight}
    joints = limiting_joints(sway, state.model.joint_names)
    return [Finding("sway", levels[system.balance], values, state.title, joints, "" if system.balance else remedy)]


def found_toppling(study: Analysis) -> Iterator[Finding]:
    """Finding of a state that is safe without the robot's weight and topples with it, where the file does not say whether it counts."""
    if study.stable_in_range and not study.unmet and study.system.balance != "controller":
        toppling = next((state for state in study.states if state.topples_with_weight), None)
        if toppling is not None:
            remedy = study.remedies["topples_with_weight"]
            yield Finding("topples_with_weight", "undecided", state=study.title_of(toppling), remedy=remedy)


def rests_on(study: Analysis) -> Iterator[Finding]:
    """Findings that a safe verdict rests on: cases not covered, and results examined but not proved."""
    if study.stable_in_range and not study.unmet and study.requirements_met is None:
        yield Finding("range_sampled", "safe")
    yield from found_toppling(study)
    if study.immobile:
        yield Finding("immobile", "safe", state=", ".join(state.title for state in study.immobile))
    uncertified = [state.title for state in study.states if not state.margins.certified]
    if uncertified:
        yield Finding("not_certified", "safe", state=", ".join(filter(None, uncertified)))
