"""A system analysed: every state with its margins, joints and tasks, and which requirements are met in all of them.

One record for one joint and for a robot: a joint is a system of one state. Each study (joint.py, robot.py, audit.py) is this and what it
adds.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

from ..analysis.margin_record import Margins
from ..design.gain_cases import bounded_margins
from ..errors import GainroomError
from ..system.requirements import REQUIREMENTS
from ..system.system import Balance, System
from ..system.uncertainty import Uncertainty
from .deciding_joints import deciding_joints_in
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
"""Keys of a joint.yaml or robot.yaml that give what is not known, by a finding's code."""


@dataclass(frozen=True)
class Analysis:
    """A system and all its states, in the source's order."""

    system: System
    every: tuple[State, ...]

    @cached_property
    def verdict(self) -> Verdict:
        """Safe, unsafe or not decided, with all that was found."""
        return verdict_of(self)

    @property
    def remedies(self) -> Mapping[str, str]:
        """The key of the file, or the option, that gives what is not known, by a finding's code."""
        return KEYS

    @property
    def ranges(self) -> Uncertainty | None:
        """What is uncertain, where the system is at the worst place in it; None where it is at its nominal values, or nothing is."""
        return None

    def title_of(self, state: State) -> str:
        """Posture and contact state; "" of a joint."""
        return state.title if state.posture else ""

    @property
    def states(self) -> tuple[State, ...]:
        """Those in which the gains move something: one or more."""
        return tuple(state for state in self.every if state.moves)

    @property
    def immobile(self) -> tuple[State, ...]:
        """The others: no loop is closed there, so there is no verdict and no limit."""
        return tuple(state for state in self.every if not state.moves)

    @property
    def examined(self) -> str:
        """Where some of the system's states are not among these: of how many it is known what is; "" where all are."""
        count, total = len(self.every), len(self.system.source.states)
        return "" if count >= total else THIS_STATE if count == 1 else f"{count} of {total} states"

    @property
    def tightest(self) -> State:
        """The state with the least headroom."""
        return min(self.states, key=lambda state: limit_headroom(state.limit))

    @property
    def tightest_by_contact(self) -> tuple[State, ...]:
        """Of each contact state the posture with the least headroom, in the source's order."""
        contacts = dict.fromkeys(state.contact for state in self.states)
        groups = ([state for state in self.states if state.contact == contact] for contact in contacts)
        return tuple(min(group, key=lambda state: limit_headroom(state.limit)) for group in groups)

    @property
    def stable(self) -> bool:
        """In every state in which the gains move something."""
        return all(state.limit.stable for state in self.states)

    @property
    def without_limit(self) -> list[State]:
        """The states of which the verdict alone is known."""
        return [state for state in self.states if math.isnan(state.limit.gain)]

    @property
    def stable_in_range(self) -> bool:
        """At the nominal values, and in every case within the uncertainty that was looked at."""
        return self.stable and not self.unstable_case

    @property
    def unstable_case(self) -> str:
        """State and case within the uncertainty in which the gains are unstable, as text; "": none found, or they are nominally."""
        found = [(self.title_of(state), self.worst_in(state).unstable_at) for state in self.states] if self.stable else []
        return next((f"{title} ({case})" if title else case for title, case in found if case), "")

    def worst_in(self, state: State) -> Worst:
        """One state over the uncertainty."""
        return state.worst_case

    def least(self, state: State, name: str) -> float:
        """What the requirement `name` bounds, in one state, at the worst of the uncertainty."""
        return REQUIREMENTS[name].value(self.worst_in(state).margins)

    def case_of(self, name: str) -> str:
        """Where in the uncertainty the requirement's worst is, in its worst state, as text; "" at the nominal values."""
        return self.worst_in(self.worst[name]).at.get(name, "")

    @cached_property
    def balanced(self) -> "Self":
        """A copy of the analysis in which a controller above the joints damps sway, so that sway does not count in the margins."""
        return replace(self, system=replace(self.system, balance="controller"), every=tuple(state.balanced for state in self.every))

    @cached_property
    def swaying(self) -> dict[str, State]:
        """Requirements that sway alone misses, by name with their worst states; {} where a controller damps it."""
        if self.system.balance == "controller" or not self.unmet or not any(state.sway for state in self.states):
            return {}
        missed = self.balanced.unmet
        return {name: state for name, state in self.unmet.items() if name not in missed}

    @property
    def sway_is_open(self) -> bool:
        """True where who damps sway decides, and nobody said it."""
        return not self.system.balance and len(self.swaying) == len(self.unmet) > 0

    @property
    def damped_above(self) -> dict[str, State]:
        """Requirements that sway misses, which a controller above the joints damps; the nominal values."""
        if self.system.balance != "controller" or not self.stable:
            return {}
        short = [(state, name) for state in self.states for name in self.system.requirements.asked if self._misses(state.margins, name)]
        return {name: state for state, name in reversed(short) if not self._misses(state.counted, name)}

    def _misses(self, found: Margins, name: str) -> bool:
        return self.system.requirements.met(name, REQUIREMENTS[name].value(found)) is False

    @cached_property
    def worst(self) -> dict[str, State]:
        """By name of a requirement, the state that has least left of it; one of which that is not known comes first.

        What is not asked for may not be known over the uncertainty; then the nominal values count. Of mirrored states, which differ by
        round-off, the first.
        """

        def left(state: State, name: str) -> float:
            one, value = REQUIREMENTS[name], self.least(state, name)
            value = one.value(state.counted) if math.isnan(value) and name not in self.system.requirements.asked else value
            return unknown_first(-value if one.at_most else value)

        return {name: min(self.states, key=lambda state, name=name: left(state, name)) for name in REQUIREMENTS}

    @cached_property
    def unmet(self) -> dict[str, State]:
        """The requirements that are not met in every state and case, each with the worst state, what is missed most first.

        Empty for an unstable system.
        """
        asked, short = self.system.requirements, self._shortfalls
        missed = {name: self.worst[name] for name in short if asked.met(name, self.least(self.worst[name], name)) is False}
        return dict(sorted(missed.items(), key=lambda item: -short[item[0]]))

    @property
    def requirements_met(self) -> bool | None:
        """Stable, and every requirement met in every state and case; None where between the cases it is not proved."""
        met = self.stable_in_range and not self.unmet
        return None if met and self.system.uncertainty.names else met

    @cached_property
    def unstable_at_usual_rate(self) -> State | None:
        """A state in which gains that are stable in continuous time are unstable at USUAL_RATE; None: there is none, or a rate is given."""
        if not (self.system.rate_is_missing and self.stable):
            return None
        states = (state.at_usual_rate for state in self.states)
        try:
            return next((state for state in states if not state.stable), None)
        except GainroomError:  # a controller that is made for continuous time alone
            return None

    @cached_property
    def missed_at_usual_rate(self) -> dict[str, float]:
        """By name of a requirement, what the present gains have of it at USUAL_RATE where that is too little; {} where a rate is given.

        Of the states that decide in continuous time alone, so what is not named may be missed, too; only where nothing is uncertain.
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
        """The requirement that is missed most, or where all are met the tightest; "" of an unstable system, and where none is asked for."""
        short = self._shortfalls
        return max(short, key=short.__getitem__, default="")

    @property
    def _shortfalls(self) -> dict[str, float]:
        """By how much each requirement is missed in its worst state, as Requirement.shortfall has it; empty for an unstable system."""
        asked = self.system.requirements.asked_for if self.stable_in_range else ()
        return {one.name: one.shortfall(needed, self.least(self.worst[one.name], one.name)) for one, needed in asked}


def analyze(system: System, progress: Progress | None = None, numbers: tuple[str, ...] = ("margins",)) -> Analysis:
    """Every state of a system, its `numbers` (properties of State) computed now, all others when they are asked for.

    progress   is given (states done, states in all, the next one's name)

    Raises GainroomError for a state that cannot be linearised, where its numbers are too far apart to compute with, and where the gains
    move nothing in any state.
    """
    return analyzed(system, in_turn(system, system.source.states, progress or quiet, numbers))


def in_turn(system: System, places: Sequence[tuple[str, str]], progress: Progress, numbers: tuple[str, ...]) -> Iterator[State]:
    """The states at `places`, one after the other, as analyze has them."""
    for index, (posture, contact) in enumerate(places):
        progress(index, len(places), f"state {posture}/{contact}")
        yield state_of(system, posture, contact, numbers)
    progress(len(places), len(places), "")


def analyzed(system: System, states: Iterable[State]) -> Analysis:
    """All of a system's states. Raises GainroomError where the gains move nothing in any."""
    found = tuple(states)
    if not any(state.moves for state in found):
        raise GainroomError(f"{system.source.name}: {found[0].reason} in any posture and contact state, so there is nothing to study")
    return Analysis(system, found)


def verdict_of(study: Analysis) -> Verdict:
    """The verdict on a system analysed."""
    found = (*found_unstable(study), *found_missed(study), *rests_on(study))
    return judged(study.system, study.remedies, found, lambda level: read_as(study.system, found, study.states, level, study.ranges))


def read_as(system: System, found: Iterable[Finding], states: Sequence[State], level: Level, ranges: Uncertainty | None = None) -> Read:
    """The decision that all readings of a system's unknowns lead to; states with an unsafe finding are examined first."""
    from .readings import read  # types of gearboxes, which a joint does without

    return read(system, unsafe_first(found, states), level, ranges)


def unsafe_first(findings: Iterable[Finding], states: Sequence[State]) -> list[State]:
    """The states with what makes them unsafe first, then those with the least headroom."""
    named = {one.state for one in findings if one.level == "unsafe"}
    return sorted(states, key=lambda state: (state.title not in named, limit_headroom(state.limit)))


def found_unstable(study: Analysis) -> Iterator[Finding]:
    """States in which the gains are unstable; where none is at the nominal values, the case in the ranges in which one is."""
    yield from (unstable(state, study.title_of(state)) for state in study.states if not state.limit.stable)
    if study.unstable_case:
        yield Finding("unstable_in_range", "unsafe", {}, study.unstable_case)


def unstable(state: State, title: str) -> Finding:
    """The finding of a state in which the gains are unstable."""
    limit = state.limit
    values = {"gain_limit": limit.gain, "lower_gain_limit": limit.lower_gain, "limit_frequency_rad_s": limit.frequency}
    return Finding("topples" if state.loop.topples else "unstable", "unsafe", values, title, state.limiting_joints)


def found_missed(study: Analysis) -> Iterator[Finding]:
    """Requirements that a stable system misses, what is missed most first; one that is not known leaves the verdict open."""
    required = study.system.requirements
    for name, state in study.unmet.items():
        omega = REQUIREMENTS[name].frequency(study.worst_in(state).margins)
        joints = deciding_joints_in(state, name) if len(study.system.source.joint_names) > 1 else ()
        found = missed(required, name, study.least(state, name), frequency=omega, state=study.title_of(state), joints=joints)
        yield replace(found, level="undecided") if name in study.swaying and not study.system.balance else found
    yield from sway_found(study.system, list((study.swaying or study.damped_above).values()), study.remedies["sway"])


def sway_found(system: System, states: Sequence[State], remedy: str) -> list[Finding]:
    """The sway of the first of the `states` in which it alone misses a requirement, judged by who is said to damp it; [] of no states.

    How fast it is, how it is damped, whether the weight topples the robot; of the joints that move in it.
    """
    levels: dict[Balance, Level] = {"": "undecided", "joints": "unsafe", "controller": "safe"}
    if not states or (sway := states[0].sway) is None:
        return []
    state = states[0]
    values = {"frequency_rad_s": sway.frequency, "damping_ratio": sway.damping_ratio, "topples_with_weight": state.topples_with_weight}
    joints = limiting_joints(sway, state.model.joint_names)
    return [Finding("sway", levels[system.balance], values, state.title, joints, "" if system.balance else remedy)]


def found_toppling(study: Analysis) -> Iterator[Finding]:
    """A state in which gains that are safe without the robot's weight topple with it, where nobody said whether it counts."""
    if study.stable_in_range and not study.unmet and study.system.balance != "controller":
        toppling = next((state for state in study.states if state.topples_with_weight), None)
        if toppling is not None:
            remedy = study.remedies["topples_with_weight"]
            yield Finding("topples_with_weight", "undecided", state=study.title_of(toppling), remedy=remedy)


def rests_on(study: Analysis) -> Iterator[Finding]:
    """Findings that a verdict rests on: what it does not cover, or was looked at and not proved."""
    if study.stable_in_range and not study.unmet and study.requirements_met is None:
        yield Finding("range_sampled", "safe")
    yield from found_toppling(study)
    if study.immobile:
        yield Finding("immobile", "safe", state=", ".join(state.title for state in study.immobile))
    uncertified = [state.title for state in study.states if not state.margins.certified]
    if uncertified:
        yield Finding("not_certified", "safe", state=", ".join(filter(None, uncertified)))
