"""Audit of a robot's present gains: unsafe joints, their headroom, and the delay at which the robot vibrates.

Requirements are those of `gainroom robot`, margin by margin: a gain margin holds for all gains together and for each joint's with the other
loops closed. A joint is safe if its own margins suffice and it takes no part in the vibration of a state whose margins do not.
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
from ..design.margin_slopes import GainCase, Gains
from ..errors import GainroomError
from ..system.excluded_sets import ROUND_OFF
from ..system.linear.arrays import Booleans, Floats, rank
from ..system.loop import Loop
from ..system.requirement import Requirement, enough
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import System
from ..system.uncertainty import Place, Uncertainty
from .analysis import Analysis, analyze, verdict_of
from .critical_joints import critical_joints_in, joints_that_miss, margins_by_joint
from .factors import largest_factor
from .loop_numbers import extra_delay, margins_of
from .over_uncertainty import unknown_first
from .progress import Progress, quiet
from .safe_gains import GainsToUse, gains_over_range, gains_to_use
from .state import State, path_headroom, state_of
from .study_record import StudyRecord
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
"""Options that give missing data, by the code of the finding."""
Answer = TypeVar("Answer")
NUMBERS = ("margins", "limits_others_open", "delay_limit")


@dataclass(frozen=True)
class AuditedJoint:
    """Gains of one joint, and the stable factor on them in the worst state.

    safe                None: not known, as the robot misses a requirement that was not measured of this joint
    gain_limit          with the other loops open: all other joints switched off
    limit_others_closed with the other loops closed; NaN where a state is unstable
    limit               judged value: limit_others_closed, up or down, in stable states; gain_limit in others
    motor_inertia      NaN where it is assumed [kg m²]
    stiffness, damping, link_viscous   of its gearbox [N m/rad], [N m s/rad] and of its link [N m s/rad]; NaN where not given
    effort_limit       of its torque [N m]; NaN where not given
    margins            worst value of each requirement asked for, by its name: of this joint's loop with the other loops closed, and of
                       all loops together where this joint moves in what misses it first [SI]; NaN where a state is unstable, where the
                       value is not known, and where it belongs to other joints alone
    missed             names of the requirements that these margins miss
    """

    name: str
    kp: float
    kd: float
    ki: float
    motor_inertia: float
    safe: bool | None
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
    """Additional question asked with an audit, and its findings."""

    @property
    def findings(self) -> tuple[Finding, ...]: ...


@dataclass(frozen=True)
class ReadAs:
    """Reading of an ambiguous model or gains: the option that selects it, its meaning, and the audit under it."""

    option: str
    meaning: str
    audit: "Audit"


@dataclass(frozen=True)
class Audit(Analysis, StudyRecord):
    """Result of `gainroom audit`.

    system.requirements   required margins
    over     places tried in the ranges; `system` and all numbers are of the worst. None: no ranges
    held     further places at which recommended gains have to hold, beside the worst
    readings   possible readings of ambiguous input; all numbers are of one of them (least_of)
    open       True: the readings differ in the verdict, so that there is none
    joint_damping   reading of the model's own joint damping: "controller": contained in kd; "friction": link_viscous; None: not stated
    of       files.audit_options.Audited, robot and gains as they were read; None: the system was judged as it is
    """

    over: OverRange | None = None
    held: tuple[Place, ...] = ()
    readings: tuple[ReadAs, ...] = ()
    open: bool = False
    joint_damping: str | None = None
    of: Any = None

    @property
    def required(self) -> Requirements:
        """Requirements on every state."""
        return self.system.requirements

    @property
    def margin(self) -> float:
        """Required gain margin as a factor; 1 if stability suffices."""
        return self.required.gain_margin or 1.0

    @property
    def delay_margin(self) -> float:
        """Required extra delay [s]."""
        return self.required.delay_margin or 0.0

    @property
    def safe(self) -> bool:
        """True if every state and every joint meets the requirements, at all places of the ranges that were tried."""
        return (self.over is None or self.over.safe) and all(map(self.enough_in, self.states)) and all(joint.safe for joint in self.joints)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Implausible link data, which would make a verdict about something else."""
        return self.system.source.body.doubts

    @property
    def withheld(self) -> bool:
        """True if there is no verdict, neither safe nor unsafe, whatever the numbers say."""
        return bool(self.doubts) or self.open

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict on the gains: safe, unsafe or undecided, with the effect of ranges and of ambiguous readings on it."""
        found = verdict_of(self)
        if self.over is not None and not self.over.safe and found.level != "unsafe":
            open_still = self.sway_is_open or any(one.readings for one in found.deciding)
            found = found.with_findings(Finding("unsafe_in_gearbox_range", "undecided" if open_still else "unsafe"))
        if self.over is not None and self.over.safe:
            found = found.with_findings(Finding("range_sampled", "safe"))
        if not self.open:
            return found
        ambiguous = {each.code: each for one in self.readings for each in one.audit.verdict.deciding if each.readings}
        found = Verdict.of(ambiguous.get(each.code, each) for each in found.findings)  # what decides in one of them alone
        levels = tuple(Reading(one.option, one.audit.verdict.level) for one in self.readings)
        return found.open(Finding("read_in_two_ways", "undecided", remedy=self.readings[0].option.split()[0], readings=levels))

    def verdict_with(self, *others: "Beside | None") -> Verdict:
        """Verdict with the findings of additional questions: simulator, workspace."""
        return self.verdict.with_findings(*(found for one in others if one is not None for found in one.findings))

    @property
    def ranges(self) -> Uncertainty | None:
        return None if self.over is None else self.over.system.uncertainty

    @property
    def remedies(self) -> Mapping[str, str]:
        """Options that give missing data, by the code of the finding."""
        return OPTIONS

    def least(self, state: State, name: str) -> float:
        """Value bounded by the requirement `name` in one state, see value_in: the system already is at the worst place."""
        return self.value_in(state, REQUIREMENTS[name])

    @property
    def decided(self) -> bool:
        """False if missing data decides the verdict."""
        return self.verdict.level != "undecided"

    def enough_in(self, state: State) -> bool:
        """True if a state is stable and meets the requirements."""
        return not self.missed_in(state)

    def missed_in(self, state: State) -> list[str]:
        """Names of the requirements that a state misses; all of them if it is unstable."""
        stable = state.limit.stable
        missed = [one.name for one, needed in self.required.asked_for if not (stable and one.met(needed, self.value_in(state, one)))]
        return missed if stable else list(dict.fromkeys(["gain_margin", *missed]))

    def value_in(self, state: State, one: Requirement) -> float:
        """Value compared with a requirement in a state; if kd has a separate path, the delay margin is that of the other gains' path."""
        return self.extra_delay(state) if one.name == "delay_margin" else one.value(state.counted)

    def joints_that_miss_in(self, state: State) -> set[str]:
        """Names of the joints that move where a state misses a requirement; if it is unstable, of those that vibrate."""
        found = set() if self.enough_together_in(state) else set(state.limiting_joints)
        missed = set(self.missed_in(state)) - {"gain_margin"} if state.limit.stable else set()
        missed = {name for name in missed if not math.isnan(self.value_in(state, REQUIREMENTS[name]))}  # of what is not known nobody is it
        return found.union(*(joints_that_miss(state, one, needed) for one, needed in self.required.asked_for if one.name in missed))

    def joints_left_open_in(self, state: State) -> set[str]:
        """Names of the joints of which it is not known whether they miss what a stable state misses."""
        missed = [REQUIREMENTS[name] for name in self.missed_in(state) if name != "gain_margin"] if state.limit.stable else []
        return set(state.model.joint_names) if any(not self._placed_in(state, one) for one in missed) else set()

    def _placed_in(self, state: State, one: Requirement) -> bool:
        """True if it is known which joints miss a requirement that a state misses."""
        if math.isnan(self.value_in(state, one)):
            return False
        own = one.of_loops(state.counted)
        return own is not None if one.bounds_each_loop else own is not None or bool(critical_joints_in(state, one.name))

    def enough_together_in(self, state: State) -> bool:
        """True if a state has the gain margin on all gains; if kd has a separate path, also on either path."""
        return state.limit.stable and enough(_together(state), self.margin)

    def margins_by_joint(self, one: Requirement) -> Floats:
        """Values (n,) of a requirement per joint, the worst of all states: see AuditedJoint.margins."""
        if not self.stable:
            return np.full(len(self.system.source.joint_names), math.nan)
        worst = np.fmax if one.at_most else np.fmin
        if all(one.of_loops(state.counted) is not None for state in self.states):
            worst = np.maximum if one.at_most else np.minimum  # of each joint; what is not known of one state is not known
        return worst.reduce([self._margins_by_joint_in(state, one) for state in self.states])

    def _margins_by_joint_in(self, state: State, one: Requirement) -> Floats:
        if one.name == "gain_margin":
            return margins_by_joint(state, one, _together(state), state.limiting_joints)
        return margins_by_joint(state, one, self.value_in(state, one), critical_joints_in(state, one.name))

    def extra_delay(self, state: State) -> float:
        """Extra delay until a state vibrates [s]; NaN: not known."""
        return state.delay_limit - state.system.delay

    @property
    def missed(self) -> tuple[str, ...]:
        """Names of the requirements missed in some state, or at some place of the ranges that was tried."""
        missed = [name for state in self.states for name in self.missed_in(state)]
        return tuple(dict.fromkeys(missed)) or (() if self.safe else ("gain_margin",))

    @property
    def least_extra_delay(self) -> float:
        """Least extra delay of all states [s]; NaN if it is not known in one."""
        return float(np.min([self.extra_delay(state) for state in self.states]))

    @property
    def tightest(self) -> State:
        """State with the least headroom."""
        return min(self.states, key=lambda state: path_headroom(state.margins))

    @cached_property
    def joints(self) -> tuple[AuditedJoint, ...]:
        """Audited joints, each in its worst state."""
        system = self.system
        gains = {name: getattr(system.control.controller, name, 0.0) for name in ("kp", "kd", "ki")}
        columns = {name: np.broadcast_to(gain, len(system.source.joint_names)) for name, gain in gains.items()}
        alone = np.min([state.limits_others_open for state in self.states], axis=0)
        closed = np.min([state.margins.one_loop.gain_margin for state in self.states], axis=0)
        judged = np.min([self.joint_limits_in(state) for state in self.states], axis=0)
        vibrating = {name for state in self.states for name in self.joints_that_miss_in(state)} | self._unsafe_at_corners
        open_still = {name for state in self.states for name in self.joints_left_open_in(state)}
        actuators, margins = self.given_actuators, {one.name: self.margins_by_joint(one) for one, _ in self.required.asked_for}

        def missed_by(k: int) -> tuple[str, ...]:
            asked = [(one, needed, margins[one.name][k]) for one, needed in self.required.asked_for]
            return tuple(one.name for one, needed, value in asked if not (math.isnan(value) or one.met(needed, value)))

        def is_safe(k: int, name: str) -> bool | None:
            if not enough(float(judged[k]), self.margin) or name in vibrating or missed_by(k):
                return False
            return None if name in open_still else True

        return tuple(
            AuditedJoint(
                name=name,
                **{key: float(column[k]) for key, column in columns.items()},
                safe=is_safe(k, name),
                gain_limit=float(alone[k]),
                limit_others_closed=float(closed[k]),
                limit=float(judged[k]),
                **{key: float(column[k]) for key, column in actuators.items()},
                margins={name: float(values[k]) for name, values in margins.items()},
                missed=missed_by(k),
            )
            for k, name in enumerate(system.source.joint_names)
        )

    @property
    def given_actuators(self) -> dict[str, Floats]:
        """Nominal motor_inertia, stiffness, damping, link_viscous and effort_limit, (n,) each; NaN where not given."""
        return (self.system if self.over is None else self.over.system).source.actuators.known

    def joint_limits_in(self, state: State) -> Floats:
        """Factor (n,), up or down, on each joint's gains, the other loops closed; the other loops open in an unstable state."""
        return state.margins.one_loop_gain_margins if state.limit.stable else state.limits_others_open

    @property
    def joints_tightest_first(self) -> tuple[AuditedJoint, ...]:
        """Joints, unsafe ones first, then those of which that is not known; within each group by shortfall, then by headroom."""

        def order(joint: AuditedJoint) -> tuple[int, float, float]:
            asked = [(one, needed, joint.margins[one.name]) for one, needed in self.required.asked_for]
            missed = [one.shortfall(needed, value) for one, needed, value in asked if not math.isnan(value)]
            return (False, None, True).index(joint.safe), rank(-max(missed, default=0.0)), unknown_first(joint.limit)

        return tuple(sorted(self.joints, key=order))

    @property
    def has_kd_path(self) -> bool:
        """True if kd has a separate path."""
        return any(state.margins.paths is not None for state in self.states)

    @cached_property
    def scale(self) -> float:
        """Factor on all gains that makes them safe; NaN if none was found, or kd has a separate path."""
        most = min(1.0, min(state.limit.gain for state in self.states) / self.margin)
        if self.has_kd_path or not most > 0:
            return math.nan
        every = np.ones(len(self.system.source.joint_names), dtype=bool)

        def holds(factor: float) -> bool:
            return self.holds_at(every, factor)

        seen = self.seen_factor(every, most)
        return seen if math.isnan(seen) or holds(seen) else largest_factor(holds, most)

    def seen_factor(self, lowered: Booleans, most: float) -> float:
        """Largest factor up to `most` on the gains of the joints `lowered` (n,), by the core's samples without proof; NaN: none."""

        def holds(factor: float) -> bool:
            return self.seen_at(lowered, factor)

        return largest_factor(holds, most)

    def seen_at(self, lowered: Booleans, factor: float) -> bool:
        """True if, by the core's samples, every state meets the requirements with `factor` on the gains of the joints `lowered` (n,)."""
        return self.holds_at(lowered, factor) if self._cases is None else self.seen_with(np.where(lowered, factor, 1.0))

    def seen_with(self, factors: Floats) -> bool:
        """True if, by the core's samples, every state meets the requirements with `factors` (n,) on the joints' gains.

        False if the core does not sample this controller.
        """
        cases = self._cases
        return cases is not None and all(self.required.met_by(case_margins(case, factors * gains, near=True)) for case, gains in cases)

    @cached_property
    def _cases(self) -> list[tuple[GainCase, Gains]] | None:
        """Cases of every state for the core; None if it does not sample this controller."""
        cases = [own_case(state.title, state.system, state.model) for state in self._held_states]
        return None if any(case is None for case in cases) else [case for case in cases if case is not None]

    def loops_at(self, lowered: Booleans, factor: float) -> Iterator[Loop]:
        """Loop of every state with the gains of the joints `lowered` (n,) times `factor`; loops at `held` places are last."""
        if lowered.all():
            yield from (state.loop.scaled(factor) for state in self._held_states)
        else:
            factors = np.where(lowered, factor, 1.0)
            changed = replace(self.controller, **{name: factors * getattr(self.controller, name) for name in self.gain_names})
            yield from (state.loop.regained(changed) for state in self._held_states)

    @cached_property
    def _held_states(self) -> tuple[State, ...]:
        """States, followed by those at `held` places, with the gains of each."""
        return (*self.states, *self._states_at(self.held))

    def _states_at(self, places: Sequence[Place]) -> list[State]:
        """States at given places in the ranges."""
        if self.over is None:
            return []
        whole = replace(self.over.system, control=self.system.control, requirements=self.required)
        moved = [replace(whole.at(place), uncertainty=Uncertainty()) for place in places]
        return [state_of(one, state.posture, state.contact) for one in moved for state in self.states]

    @cached_property
    def _unsafe_at_corners(self) -> set[str]:
        """Names of joints that miss a requirement at a corner of the ranges, which need not be the worst place of the whole robot."""
        found = set[str]()
        for state in self._states_at(() if self.over is None else self.over.unsafe_corners):
            short = [not enough(limit, self.margin) for limit in self.joint_limits_in(state).tolist()]
            found |= {*itertools.compress(self.system.source.joint_names, short), *self.joints_that_miss_in(state)}
        return found

    @property
    def controller(self) -> Any:
        """Controller of all joints, in joint space."""
        assert self.system.control.controller is not None
        return self.system.control.controller

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Gain names: kp, kd, and ki if some joint has it."""
        return ("kp", "kd", "ki") if any(joint.ki for joint in self.joints) else ("kp", "kd")

    def holds_at(self, lowered: Booleans, factor: float) -> bool:
        """True if every state meets the requirements with `factor` on `lowered` (n,).

        The gain margin, cheapest to check, is checked first.
        """
        loops = list(self.loops_at(lowered, factor))
        margin = self.margin * (1 - ROUND_OFF)  # which may be just what is left
        return all(is_stable(loop) and is_stable(loop.scaled(margin)) for loop in loops) and all(map(self.holds, self._held_states, loops))

    def holds(self, state: State, loop: Loop) -> bool:
        """True if the loop of one state has every required margin; the delay margin, cheapest to compute, is checked first."""
        if self.delay_margin > 0 and not enough(extra_delay(loop), self.delay_margin):
            return False
        return self.required.met_by(without_sway(state.case, margins_of(loop), loop))

    @cached_property
    def to_use(self) -> "GainsToUse[Audit] | None":
        """Safe gains in place of unsafe ones; None if none are known, the gains are safe, or there is no verdict."""
        if self.safe or self.withheld or self.sway_is_open:
            return None
        return gains_to_use(self) if self.over is None else gains_over_range(self)

    @property
    def ready_to_use(self) -> "GainsToUse[Audit] | None":
        """`to_use` if no missing data (rate, motor inertia) would lead to other gains; otherwise None."""
        known = self.system.control.sample_time is not None and "motor_inertia_unknown" not in self.system.source.unknown
        return self.to_use if known else None

    @property
    def assumed_rigid(self) -> Booleans:
        """(n,) True for gearboxes whose stiffness is not given: a safe verdict is conditional on them."""
        return self.system.source.actuators.assumed_rigid

    def of_gains(self, gains: Mapping[str, Floats]) -> "Audit":
        """Audit of other `gains` of the same joints, (n,) each, at the place in the ranges that is worst now."""
        system = self._with(gains)
        return replace(self, system=system, every=analyze(system, numbers=NUMBERS).every, over=None, readings=(), open=False)

    def over_range(self, gains: Mapping[str, Floats]) -> "Audit":
        """Audit of other `gains` over the whole range; needs `over`."""
        assert self.over is not None
        whole = replace(self._with(gains), source=self.over.system.source, drives=self.over.system.drives, uncertainty=self.ranges)
        return replace(audit(whole, self.required), joint_damping=self.joint_damping)

    def held_at(self, places: Sequence[Place]) -> "Audit":
        """Audit with further places at which recommended gains have to hold."""
        return replace(self, held=tuple(dict.fromkeys((*self.held, *places))))

    def _with(self, gains: Mapping[str, Floats]) -> System:
        """System with other `gains`."""
        return replace(self.system, control=replace(self.system.control, controller=replace(self.controller, **gains)))

    @property
    def delay_limit(self) -> float:
        """Least total delay [s] over all states at which the robot vibrates; NaN if none is known."""
        return min((state.delay_limit for state in self.states if not math.isnan(state.delay_limit)), default=math.nan)

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """Names of the joints that vibrate at the tightest state's limit, the largest participation factor first."""
        return self.tightest.limiting_joints

    @property
    def angles(self) -> dict[str, float]:
        """Position of every joint of the model by name, locked ones too [rad; m for a prismatic joint]."""
        posture = self.system.source.postures[self.tightest.posture]
        return {name: posture.angles.get(name, 0.0) for name in posture.body.joint_names} | dict(posture.body.locked)


def _together(state: State) -> float:
    """Smallest destabilising factor, up or down, on all gains of a stable state, or on those of one path."""
    paths = state.margins.paths
    return min(state.margins.gain_headroom, math.inf if paths is None else paths.headroom)


def required_of(margin: float | None = None, further: Mapping[str, float | None] = MappingProxyType({})) -> Requirements:
    """Default requirements with another gain `margin` (a factor; 1: none), and `further` ones by name in place of defaults.

    None: not required.
    """
    required = {**Requirements.usual().needed, **({} if margin is None else {"gain_margin": margin}), **further}
    return Requirements(**{name: value for name, value in required.items() if value is not None and (name != "gain_margin" or value > 1)})


def audit(
    system: System,
    required: Requirements | None = None,
    progress: Progress = quiet,
) -> Audit:
    """Audit of every state of `system`, at the worst place of its uncertainty; control must be in joint space. Raises as analyze.

    required    requirements on the gains; None: those of required_of
    """
    system, over = replace(system, requirements=required_of() if required is None else required), None
    if system.uncertainty.names:
        states = _moving(system)
        over = try_places(system, states, progress) if states else None
        system = replace(system if over is None else over.worst.system, uncertainty=Uncertainty())
    return Audit(system, analyze(system, progress, NUMBERS).every, over=over)


def or_none(question: Callable[[], Answer]) -> Answer | None:
    """Answer to an additional question, whose failure must not end the main one; None if it cannot be computed."""
    try:
        return question()
    except (GainroomError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        return None


def _moving(system: System) -> list[State]:
    """States in which the gains act on some motion."""
    return [state for names in system.source.states if (state := state_of(system, *names)).moves]


def least_of(readings: Sequence[ReadAs]) -> Audit:
    """Audit of the reading with the lowest gain limit, with all readings attached; any of them may be the true one."""
    return _read(min((one.audit for one in readings), key=lambda audit: audit.tightest.limit.gain), readings)


def with_drives(host: Audit, drives: Callable[[], ReadAs | None], option: str, meaning: str) -> Audit:
    """Audit of gains on the host, with the reading that they run in the drives attached if the drives can take them and it decides."""
    there = None if host.withheld else or_none(drives)
    return host if there is None or (host.safe and there.audit.safe) else _read(host, (ReadAs(option, meaning, host), there))


def _read(one: Audit, readings: Sequence[ReadAs]) -> Audit:
    """Audit `one` with all readings attached; no verdict if they differ."""
    return replace(one, readings=tuple(readings), open=len({each.audit.verdict.level for each in readings}) > 1)
