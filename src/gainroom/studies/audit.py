"""The gains that a robot already has: which are safe, their headroom, and the delay at which the robot vibrates.

What is required is what `gainroom robot` requires, margin by margin: a gain margin holds for all gains together and for each joint's with
the other loops closed. A joint is safe where its own are enough and it takes no part in the vibration of a state with too little.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Protocol, TypeVar

import numpy as np

from ..analysis.stability import is_stable
from ..design.gain_cases import case_margins, own_case
from ..design.margin_slopes import Case, Gains
from ..errors import GainroomError
from ..system.excluded_sets import ROUND_OFF
from ..system.linear.arrays import Booleans, Floats, rank
from ..system.loop import Loop
from ..system.requirement import Requirement, enough
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import System
from ..system.uncertainty import Place, Uncertainty
from .analysis import Analysis, analyze, verdict_of
from .deciding_joints import deciding_joints_in, joints_that_miss, margins_by_joint
from .factors import largest_factor
from .loop_numbers import extra_delay, margins_of
from .lowered_gains import GainsToUse, gains_over_range, gains_to_use
from .over_uncertainty import unknown_first
from .progress import Progress, quiet
from .state import State, path_headroom, state_of
from .sway import without_sway
from .verdict import Finding, Reading, Verdict
from .worst_place import OverRange, try_places

OPTIONS = {
    "rate_unknown": "--rate-hz",
    "gearbox_unknown": "--gearbox or --stiffness",
    "motor_inertia_unknown": "--motor-inertia",
    "nothing_required": "--margin-db",
    "sway": "--balance",
    "topples_with_weight": "--balance controller, or model.gravity_stiffness in the file of --write-robot",
}
"""Options that give what is not known, by a finding's code."""
Answer = TypeVar("Answer")
NUMBERS = ("margins", "limits_others_open", "delay_limit")


@dataclass(frozen=True)
class AuditedJoint:
    """One joint's gains, and the stable factor on them in the worst state.

    gain_limit          with the other loops open: all other joints switched off
    limit_others_closed with the other loops closed; NaN where a state is unstable
    limit               what is judged: the latter, up or down, in stable states, the former in others
    motor_inertia      NaN where it is guessed [kg m²]
    stiffness, damping, link_viscous   of its gearbox [N m/rad], [N m s/rad] and of its link [N m s/rad], where they were given; else NaN
    effort_limit       of its torque [N m], where it was given; else NaN
    margins            by the name of each requirement that is asked for: the worst that it bounds, of this joint's loop with the other
                       loops closed, and of all loops together where this joint moves in what they miss first [SI]; NaN where a state is
                       unstable, where it is not known, and where it is of other joints alone
    missed             the names of those requirements that these margins miss
    """

    name: str
    kp: float
    kd: float
    ki: float
    motor_inertia: float
    safe: bool
    gain_limit: float
    limit_others_closed: float
    limit: float
    stiffness: float = math.nan
    damping: float = math.nan
    link_viscous: float = math.nan
    effort_limit: float = math.nan
    margins: Mapping[str, float] = field(default_factory=dict)
    missed: tuple[str, ...] = ()


class Beside(Protocol):
    """A question beside an audit's own, and its findings."""

    @property
    def findings(self) -> tuple[Finding, ...]: ...


@dataclass(frozen=True)
class ReadAs:
    """One way to read what a model and its gains leave open: the option that says so, what it means, and the audit of the robot so read."""

    option: str
    meaning: str
    audit: "Audit"


@dataclass(frozen=True)
class Audit(Analysis):
    """The result of `gainroom audit`.

    system.requirements   what is required
    over     where something lies in a range: the places that were tried; `system` and all numbers are of the worst
    held     further places at which gains to use have to hold, beside the worst
    readings   where something is left open: each way to read it; all numbers are of one of them (audit_readings.py)
    open       they differ in the verdict, which there is none then
    joint_damping   what the model's own damping of joints was taken for, "controller": kd has it, "friction": link_viscous; None: not said
    """

    over: OverRange | None = None
    held: tuple[Place, ...] = ()
    readings: tuple[ReadAs, ...] = ()
    open: bool = False
    joint_damping: str | None = None

    @property
    def required(self) -> Requirements:
        """Of every state."""
        return self.system.requirements

    @property
    def margin(self) -> float:
        """The required factor on gains; 1 where stability is enough."""
        return self.required.gain_margin or 1.0

    @property
    def delay_margin(self) -> float:
        """[s] of extra delay that safe gains survive."""
        return self.required.delay_margin or 0.0

    @property
    def safe(self) -> bool:
        """Every state and every joint has what is required, at all places of the ranges that were tried."""
        return (self.over is None or self.over.safe) and all(map(self.enough_in, self.states)) and all(joint.safe for joint in self.joints)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What of the links no robot has: a verdict would be one about something else."""
        return self.system.source.body.doubts

    @property
    def withheld(self) -> bool:
        """Whether there is no verdict, neither safe nor unsafe, whatever the numbers say."""
        return bool(self.doubts) or self.open

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict as on any system, with what its ranges make of it, and what may be read in two ways."""
        found = verdict_of(self)
        if self.over is not None and not self.over.safe and found.level != "unsafe":
            open_still = self.sway_is_open or any(one.readings for one in found.deciding)
            found = found.with_findings(Finding("unsafe_in_gearbox_range", "undecided" if open_still else "unsafe"))
        if self.over is not None and self.over.safe:
            found = found.with_findings(Finding("range_sampled", "safe"))
        if not self.open:
            return found
        told = {each.code: each for one in self.readings for each in one.audit.verdict.deciding if each.readings}
        found = Verdict.of(told.get(each.code, each) for each in found.findings)  # what decides in one of them alone
        levels = tuple(Reading(one.option, one.audit.verdict.level) for one in self.readings)
        return found.open(Finding("read_in_two_ways", "undecided", remedy=self.readings[0].option.split()[0], readings=levels))

    def verdict_with(self, *others: "Beside | None") -> Verdict:
        """The verdict with what was asked for besides: the simulator, the workspace."""
        return self.verdict.with_findings(*(found for one in others if one is not None for found in one.findings))

    @property
    def ranges(self) -> Uncertainty | None:
        return None if self.over is None else self.over.system.uncertainty

    @property
    def remedies(self) -> Mapping[str, str]:
        """The options that give what is not known, by a finding's code."""
        return OPTIONS

    def least(self, state: State, name: str) -> float:
        """See value_in: an audit is one of the worst place in what is uncertain."""
        return self.value_in(state, REQUIREMENTS[name])

    @property
    def decided(self) -> bool:
        """False where something that is not known decides."""
        return self.verdict.level != "undecided"

    def enough_in(self, state: State) -> bool:
        """Whether a state is stable and has what is required."""
        return not self.missed_in(state)

    def missed_in(self, state: State) -> list[str]:
        """The names of all that a state has too little of; of one that is not stable all that is required."""
        stable = state.limit.stable
        missed = [one.name for one, needed in self.required.asked_for if not (stable and one.met(needed, self.value_in(state, one)))]
        return missed if stable else list(dict.fromkeys(["gain_margin", *missed]))

    def value_in(self, state: State, one: Requirement) -> float:
        """What is held against a requirement; where kd has a path of its own, the delay margin is that of the other gains' path."""
        return self.extra_delay(state) if one.name == "delay_margin" else one.value(state.counted)

    def joints_that_miss_in(self, state: State) -> set[str]:
        """The joints that move where a state has too little of something; of one that is not stable those that vibrate."""
        found = set() if self.enough_together_in(state) else set(state.limiting_joints)
        missed = set(self.missed_in(state)) - {"gain_margin"} if state.limit.stable else set()
        missed = {name for name in missed if not math.isnan(self.value_in(state, REQUIREMENTS[name]))}  # of what is not known nobody is it
        return found.union(*(joints_that_miss(state, one, needed) for one, needed in self.required.asked_for if one.name in missed))

    def enough_together_in(self, state: State) -> bool:
        """Whether a state has the gain margin on all gains; where kd has a path of its own, also on either path."""
        return state.limit.stable and enough(_together(state), self.margin)

    def margins_by_joint(self, one: Requirement) -> Floats:
        """(n,) each joint's own of what a requirement bounds, the worst of all states: see AuditedJoint.margins."""
        if not self.stable:
            return np.full(len(self.system.source.joint_names), math.nan)
        worst = np.fmax if one.at_most else np.fmin
        if all(one.of_loops(state.counted) is not None for state in self.states):
            worst = np.maximum if one.at_most else np.minimum  # of each joint; what is not known of one state is not known
        return worst.reduce([self._margins_by_joint_in(state, one) for state in self.states])

    def _margins_by_joint_in(self, state: State, one: Requirement) -> Floats:
        if one.name == "gain_margin":
            return margins_by_joint(state, one, _together(state), state.limiting_joints)
        return margins_by_joint(state, one, self.value_in(state, one), deciding_joints_in(state, one.name))

    def extra_delay(self, state: State) -> float:
        """[s] until a state vibrates; NaN where it is not known."""
        return state.delay_limit - state.system.delay

    @property
    def missed(self) -> tuple[str, ...]:
        """The names of what is missed in some state, or at some place of the ranges that was tried."""
        missed = [name for state in self.states for name in self.missed_in(state)]
        return tuple(dict.fromkeys(missed)) or (() if self.safe else ("gain_margin",))

    @property
    def least_extra_delay(self) -> float:
        """[s] over all states; NaN where it is not known in one."""
        return float(np.min([self.extra_delay(state) for state in self.states]))

    @property
    def tightest(self) -> State:
        """The state with the least headroom."""
        return min(self.states, key=lambda state: path_headroom(state.margins))

    @cached_property
    def joints(self) -> tuple[AuditedJoint, ...]:
        """Joint by joint, each in its worst state."""
        system = self.system
        gains = {name: getattr(system.control.controller, name, 0.0) for name in ("kp", "kd", "ki")}
        columns = {name: np.broadcast_to(gain, len(system.source.joint_names)) for name, gain in gains.items()}
        alone = np.min([state.limits_others_open for state in self.states], axis=0)
        closed = np.min([state.margins.one_loop.gain_margin for state in self.states], axis=0)
        judged = np.min([self.joint_limits_in(state) for state in self.states], axis=0)
        vibrating = {name for state in self.states for name in self.joints_that_miss_in(state)} | self._unsafe_at_corners
        actuators, margins = self.given_actuators, {one.name: self.margins_by_joint(one) for one, _ in self.required.asked_for}
        return tuple(
            AuditedJoint(
                name=name,
                **{key: float(column[k]) for key, column in columns.items()},
                safe=enough(float(judged[k]), self.margin) and name not in vibrating,
                gain_limit=float(alone[k]),
                limit_others_closed=float(closed[k]),
                limit=float(judged[k]),
                **{key: float(column[k]) for key, column in actuators.items()},
                margins={name: float(values[k]) for name, values in margins.items()},
                missed=tuple(
                    one.name
                    for one, needed in self.required.asked_for
                    if not (math.isnan(margins[one.name][k]) or one.met(needed, margins[one.name][k]))
                ),
            )
            for k, name in enumerate(system.source.joint_names)
        )

    @property
    def given_actuators(self) -> dict[str, Floats]:
        """(n,) motor_inertia, stiffness, damping, link_viscous and effort_limit, nominal ones; NaN where they were not given."""
        return (self.system if self.over is None else self.over.system).source.actuators.known

    def joint_limits_in(self, state: State) -> Floats:
        """(n,) the factor, up or down, on each joint's gains, the other loops closed; switched off in a state that is not stable."""
        return state.margins.one_loop_gain_margins if state.limit.stable else state.limits_others_open

    @property
    def joints_tightest_first(self) -> tuple[AuditedJoint, ...]:
        """The joints, unsafe ones first; of either those first that miss a requirement most, or have the least to spare."""

        def order(joint: AuditedJoint) -> tuple[bool, float, float]:
            asked = [(one, needed, joint.margins[one.name]) for one, needed in self.required.asked_for]
            missed = [one.shortfall(needed, value) for one, needed, value in asked if not math.isnan(value)]
            return joint.safe, rank(-max(missed, default=0.0)), unknown_first(joint.limit)

        return tuple(sorted(self.joints, key=order))

    @property
    def has_two_paths(self) -> bool:
        """Whether kd has a path of its own."""
        return any(state.margins.paths is not None for state in self.states)

    @cached_property
    def scale(self) -> float:
        """The factor on all gains that makes them safe; NaN: none was found, as where kd has a path of its own."""
        most = min(1.0, min(state.limit.gain for state in self.states) / self.margin)
        if self.has_two_paths or not most > 0:
            return math.nan
        every = np.ones(len(self.system.source.joint_names), dtype=bool)

        def holds(factor: float) -> bool:
            return self.holds_at(every, factor)

        seen = self.seen_factor(every, most)
        return seen if math.isnan(seen) or holds(seen) else largest_factor(holds, most)

    def seen_factor(self, lowered: Booleans, most: float) -> float:
        """The largest factor up to `most` on the gains of the joints `lowered` (n,); NaN: none. Seen in the core's looks, not proved."""

        def holds(factor: float) -> bool:
            return self.seen_at(lowered, factor)

        return largest_factor(holds, most)

    def seen_at(self, lowered: Booleans, factor: float) -> bool:
        """Whether every state has what is required with `factor` on the gains of the joints `lowered` (n,), as the core's looks see it."""
        return self.holds_at(lowered, factor) if self._cases is None else self.seen_with(np.where(lowered, factor, 1.0))

    def seen_with(self, factors: Floats) -> bool:
        """The same with `factors` (n,) on the joints' gains; False where the core does not look at this controller."""
        cases = self._cases
        return cases is not None and all(self.required.met_by(case_margins(case, factors * gains, near=True)) for case, gains in cases)

    @cached_property
    def _cases(self) -> list[tuple[Case, Gains]] | None:
        """Every state as the core looks at it; None where it does not look at this controller, and where sway is left to another one."""
        if self.system.balance == "controller" and any(state.sway for state in self.states):
            return None
        cases = [own_case(state.title, state.system, state.model) for state in self._held_states]
        return None if any(case is None for case in cases) else [case for case in cases if case is not None]

    def loops_at(self, lowered: Booleans, factor: float) -> Iterator[Loop]:
        """Every state's loop with the gains of the joints `lowered` (n,) times `factor`; those at `held` places are the last."""
        if lowered.all():
            yield from (state.loop.scaled(factor) for state in self._held_states)
        else:
            factors = np.where(lowered, factor, 1.0)
            changed = replace(self.controller, **{name: factors * getattr(self.controller, name) for name in self.gain_names})
            yield from (state.loop.regained(changed) for state in self._held_states)

    @cached_property
    def _held_states(self) -> tuple[State, ...]:
        """The states, and those at `held` places, with the gains that these have."""
        return (*self.states, *self._states_at(self.held))

    def _states_at(self, places: Sequence[Place]) -> list[State]:
        """The states at some places in the ranges."""
        if self.over is None:
            return []
        whole = replace(self.over.system, control=self.system.control, requirements=self.required)
        moved = [replace(whole.at(place), uncertainty=Uncertainty()) for place in places]
        return [state_of(one, state.posture, state.contact) for one in moved for state in self.states]

    @cached_property
    def _unsafe_at_corners(self) -> set[str]:
        """The joints that miss something at a corner of the ranges: where each of them does need not be the worst place."""
        found = set[str]()
        for state in self._states_at(() if self.over is None else self.over.unsafe_corners):
            short = [not enough(limit, self.margin) for limit in self.joint_limits_in(state).tolist()]
            found |= {*itertools.compress(self.system.source.joint_names, short), *self.joints_that_miss_in(state)}
        return found

    @property
    def controller(self) -> Any:
        """Of all joints: an audit is of gains in joint space."""
        assert self.system.control.controller is not None
        return self.system.control.controller

    @property
    def gain_names(self) -> tuple[str, ...]:
        """kp, kd, and ki where some joint has it."""
        return ("kp", "kd", "ki") if any(joint.ki for joint in self.joints) else ("kp", "kd")

    def holds_at(self, lowered: Booleans, factor: float) -> bool:
        """Whether so every state has what is required; states without the gain margin on all gains are found first, as that takes least."""
        loops = list(self.loops_at(lowered, factor))
        margin = self.margin * (1 - ROUND_OFF)  # which may be just what is left
        return all(is_stable(loop) and is_stable(loop.scaled(margin)) for loop in loops) and all(map(self.holds, self._held_states, loops))

    def holds(self, state: State, loop: Loop) -> bool:
        """True where one state's loop has every margin that is required; the delay margin is looked at first, as it costs the least."""
        if self.delay_margin > 0 and not enough(extra_delay(loop), self.delay_margin):
            return False
        return self.required.met_by(without_sway(state.case, margins_of(loop), loop))

    @cached_property
    def to_use(self) -> "GainsToUse[Audit] | None":
        """Gains to use in place of unsafe ones; None where none are known, for safe gains, and without a verdict."""
        if self.safe or self.withheld or self.sway_is_open:
            return None
        return gains_to_use(self) if self.over is None else gains_over_range(self)

    @property
    def ready_to_use(self) -> "GainsToUse[Audit] | None":
        """Those, unless the loop's rate is not known, which costs margin, or a motor's inertia, with which others would be found."""
        known = self.system.control.sample_time is not None and "motor_inertia_unknown" not in self.system.source.unknown
        return self.to_use if known else None

    @property
    def assumed_rigid(self) -> Booleans:
        """(n,) the gearboxes whose stiffness was not given: a safe verdict is conditional on them."""
        return self.system.source.actuators.assumed_rigid

    def of_gains(self, gains: Mapping[str, Floats]) -> "Audit":
        """Other gains of the same joints, (n,) each, audited like these, at the same place in a range: the worst of now."""
        system = self._with(gains)
        return replace(self, system=system, every=analyze(system, numbers=NUMBERS).every, over=None, readings=(), open=False)

    def over_range(self, gains: Mapping[str, Floats]) -> "Audit":
        """An audit of other gains over the whole range, which there must be."""
        assert self.over is not None
        whole = replace(self._with(gains), source=self.over.system.source, drives=self.over.system.drives, uncertainty=self.ranges)
        return replace(audit(whole, self.required), joint_damping=self.joint_damping)

    def held_at(self, places: Sequence[Place]) -> "Audit":
        """The same with further places at which gains to use have to hold."""
        return replace(self, held=tuple(dict.fromkeys((*self.held, *places))))

    def _with(self, gains: Mapping[str, Floats]) -> System:
        """The robot with other gains."""
        return replace(self.system, control=replace(self.system.control, controller=replace(self.controller, **gains)))

    @property
    def delay_limit(self) -> float:
        """[s], over all states; NaN where none is known."""
        return min((state.delay_limit for state in self.states if not math.isnan(state.delay_limit)), default=math.nan)

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """The joints that vibrate at the tightest state's limit, the largest participation factor first."""
        return self.tightest.limiting_joints

    @property
    def angles(self) -> dict[str, float]:
        """Position of every joint of the model, locked ones too [rad; m for a prismatic joint]."""
        posture = self.system.source.postures[self.tightest.posture]
        return {name: posture.angles.get(name, 0.0) for name in posture.body.joint_names} | dict(posture.body.locked)


def _together(state: State) -> float:
    """The smallest factor, up or down, on all gains of a stable state, or on those of one path, that is lost."""
    paths = state.margins.paths
    return min(state.margins.gain_headroom, math.inf if paths is None else paths.headroom)


def required_of(margin: float | None = None, further: Mapping[str, float | None] = MappingProxyType({})) -> Requirements:
    """The usual ones, with another gain margin (a factor; 1: none), and `further` ones by name in place of theirs; None: not required."""
    required = {**Requirements.usual().needed, **({} if margin is None else {"gain_margin": margin}), **further}
    return Requirements(**{name: value for name, value in required.items() if value is not None and (name != "gain_margin" or value > 1)})


def audit(
    system: System,
    required: Requirements | None = None,
    progress: Progress = quiet,
) -> Audit:
    """Every state of `system`, whose control must be in joint space; at the worst place where it is uncertain. Raises as analyze does.

    required    of safe gains; None: as required_of has it
    """
    system, over = replace(system, requirements=required_of() if required is None else required), None
    if system.uncertainty.names:
        states = _moving(system)
        over = try_places(system, states, progress) if states else None
        system = replace(system if over is None else over.worst.system, uncertainty=Uncertainty())
    return Audit(system, analyze(system, progress, NUMBERS).every, over=over)


def or_none(question: Callable[[], Answer]) -> Answer | None:
    """The answer to a question beside the main one, which it must never end; None where it cannot be computed."""
    try:
        return question()
    except (GainroomError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        return None


def _moving(system: System) -> list[State]:
    """The states in which a joint moves."""
    return [state for names in system.source.states if (state := state_of(system, *names)).moves]
