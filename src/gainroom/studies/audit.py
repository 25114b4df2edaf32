"""The gains that a robot already has: which are safe, their headroom, and the delay at which the robot vibrates.

A joint is safe where its gains have the required margin on it alone, its neighbours free, and where it takes no part in the vibration of
a robot that does not have it as a whole.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..analysis.stability import is_stable
from ..robot.gearbox_types import GearboxRange
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirements import Requirements, enough
from ..system.system import System
from .analysis import Analysis, analyze, typed_factor
from .deciding_joints import joints_that_miss
from .gearbox_range import RangeOfGearboxes, look_over
from .needed_stiffness import NeededStiffness, needed_stiffness
from .state import Progress, State, by_headroom, extra_delay, limit_of, limiting_joints, margins_of, state_of

MARGIN = 2.0
"""The required factor on all gains by default: 6 dB."""
EXTRA_DELAY = 0.5
"""Of the loop's delay: by so much it may be longer than was said, by default."""
MOST_DIGITS = 7
"""Of a gain that is typed."""
BARE = 5.0
"""Ms above which gains hardly damp their motion: up to it at least 1.9 dB and 11.5° are left."""
GROWTHS = 5
"""Times that joints are added to those whose gains are lowered."""
LOWER = (0.9, 0.7, 0.5, 0.3, 0.1, 0.03)
"""Of gains that have the gain margin and too little else: where lower ones are looked at."""
NUMBERS = ("margins", "single_joint_limits", "delay_limit")


@dataclass(frozen=True)
class AuditedJoint:
    """One joint's gains, and the stable factor on them, alone and with the other loops closed, in the worst state.

    needed_stiffness   of its gearbox, where none is known and the gains are safe on a rigid one [N m/rad]; else NaN
    """

    name: str
    kp: float
    kd: float
    ki: float
    motor_inertia: float
    safe: bool
    gain_limit: float
    limit_others_closed: float
    needed_stiffness: float = math.nan


@dataclass(frozen=True)
class Audit(Analysis):
    """The result of `gainroom audit`.

    margin   the required factor
    needed   how stiff gearboxes must be whose stiffness is not known; None where all are known, the gains are not safe, it was not asked
             for, or cannot be computed (see needed_stiffness.py)
    over     where gearboxes lie in a range: what was looked at; `system` and all numbers are of the worst
    delay_margin   [s] of extra delay that safe gains survive
    further  what else is required of them: phase margin, peak sensitivity
    """

    margin: float
    needed: NeededStiffness | None = None
    over: RangeOfGearboxes | None = None
    delay_margin: float = 0.0
    further: Requirements = field(default_factory=Requirements)

    @property
    def safe(self) -> bool:
        """Every state and every joint has what is required, with all gearboxes that were looked at."""
        return (self.over is None or self.over.safe) and all(map(self.enough_in, self.states)) and all(joint.safe for joint in self.joints)

    def enough_in(self, state: State) -> bool:
        """Whether a state is stable with `margin` times its gains and has what else is required."""
        return not self.missed_in(state)

    def missed_in(self, state: State) -> list[str]:
        """The names of all that a state has too little of; of one that is not stable all that is required."""
        missed, lost = [] if self.enough_gain_in(state) else ["gain_margin"], not state.limit.stable
        late = self.delay_margin > 0 if lost else not enough(self.extra_delay(state), self.delay_margin)
        missed += ["delay_margin"] if late else []
        return missed + [one.name for one, needed in self.further.asked_for if lost or not one.met(needed, one.value(state.margins))]

    def joints_that_miss_in(self, state: State) -> set[str]:
        """The joints that move where a state has too little of something; of one that is not stable those that vibrate."""
        missed = self.missed_in(state) if state.limit.stable else ["gain_margin"]
        return {name for each in missed for name in joints_that_miss(state, each)}

    def enough_gain_in(self, state: State) -> bool:
        """Whether a state is stable with `margin` times its gains; where kd has a path of its own, also on either path alone."""
        paths = state.margins.paths
        return state.limit.stable and enough(state.limit.gain, self.margin) and (paths is None or enough(paths.headroom, self.margin))

    def extra_delay(self, state: State) -> float:
        """[s] until a state vibrates; NaN where it is not known."""
        return state.delay_limit - self.system.delay

    @property
    def missed(self) -> tuple[str, ...]:
        """The names of what is missed in some state, or of a joint by itself."""
        missed = [name for state in self.states for name in self.missed_in(state)]
        return tuple(dict.fromkeys(missed)) or (() if self.safe else ("gain_margin",))

    @property
    def least_extra_delay(self) -> float:
        """[s] over all states; NaN where it is not known in one."""
        return float(np.min([self.extra_delay(state) for state in self.states]))

    @property
    def tightest(self) -> State:
        """The state with the least headroom."""

        def left(state: State) -> tuple[bool, float]:
            stable, gain = by_headroom(state.limit)
            return stable, gain if state.margins.paths is None else min(gain, state.margins.paths.headroom)

        return min(self.states, key=left)

    @cached_property
    def joints(self) -> tuple[AuditedJoint, ...]:
        """Joint by joint, each in its worst state."""
        system = self.system
        gains = {name: getattr(system.control.controller, name, 0.0) for name in ("kp", "kd", "ki")}
        columns = {name: np.broadcast_to(gain, len(system.source.joint_names)) for name, gain in gains.items()}
        alone = np.min([state.single_joint_limits for state in self.states], axis=0)
        closed = np.min([state.margins.one_loop.gain_margin for state in self.states], axis=0)
        least = None if self.needed is None else self.needed.least
        needed = (
            np.full(len(alone), math.nan)
            if self.needed is None or least is None
            else np.where(self.needed.unknown, least.stiffness, math.nan)
        )
        vibrating = {name for state in self.states for name in self.joints_that_miss_in(state)}
        return tuple(
            AuditedJoint(
                name=name,
                **{key: float(column[k]) for key, column in columns.items()},
                motor_inertia=float(system.source.actuators.motor_inertia[k]),
                safe=enough(float(alone[k]), self.margin) and name not in vibrating,
                gain_limit=float(alone[k]),
                limit_others_closed=float(closed[k]),
                needed_stiffness=float(needed[k]),
            )
            for k, name in enumerate(system.source.joint_names)
        )

    @property
    def by_headroom(self) -> tuple[AuditedJoint, ...]:
        """The joints, unsafe ones first, then those with the least headroom alone."""
        return tuple(sorted(self.joints, key=lambda joint: (joint.safe, -math.inf if math.isnan(joint.gain_limit) else joint.gain_limit)))

    @property
    def gain_scale(self) -> float:
        """The factor on all gains that gives them the gain margin: exact, as limits move with one over it; NaN where none is known to.

        None is known where kd has a path of its own, and where a state's gains may not fall so far.
        """
        limits = [min(state.limit.gain, *np.nan_to_num(state.single_joint_limits, nan=math.inf).tolist()) for state in self.states]
        scale, lowest = min(limits) / self.margin, max(state.limit.lower_gain for state in self.states)
        known = 0 < scale < math.inf and lowest * self.margin < scale
        return scale if known and not self.has_two_paths else math.nan

    @property
    def has_two_paths(self) -> bool:
        """Whether kd has a path of its own."""
        return any(state.margins.paths is not None for state in self.states)

    @cached_property
    def scale(self) -> float:
        """The factor on all gains that makes them safe: gain_scale, or less where all else that is required is there; NaN: none found."""
        scale, lowest = min(self.gain_scale, 1.0), max(state.limit.lower_gain for state in self.states)
        if math.isnan(self.gain_scale):
            return math.nan
        every = np.ones(len(self.system.source.joint_names), dtype=bool)
        return largest_factor(lambda factor: lowest * self.margin < factor and self.has_rest_at(every, factor), scale)

    def loops_at(self, lowered: Booleans, factor: float) -> Iterator[Loop]:
        """Every state's loop with the gains of the joints `lowered` (n,) times `factor`."""
        if lowered.all():
            yield from (state.loop.scaled(factor) for state in self.states)
        else:
            factors = np.where(lowered, factor, 1.0)
            changed = replace(self.controller, **{name: factors * getattr(self.controller, name) for name in self.gain_names})
            yield from (state.loop.regained(changed) for state in self.states)

    @property
    def controller(self) -> Any:
        """Of all joints: an audit is of gains in joint space."""
        assert self.system.control.controller is not None
        return self.system.control.controller

    @property
    def gain_names(self) -> tuple[str, ...]:
        """kp, kd, and ki where some joint has it."""
        return ("kp", "kd", "ki") if any(joint.ki for joint in self.joints) else ("kp", "kd")

    def has_rest_at(self, lowered: Booleans, factor: float) -> bool:
        """Whether so all that is required but the gain margin is there, in every state."""
        return all(map(self.has_rest, self.loops_at(lowered, factor)))

    def has_rest(self, loop: Loop) -> bool:
        """Whether a loop has what is required besides the gain margin."""
        if self.further.asked_for:
            found = margins_of(loop)
            return enough(found.delay_margin, self.delay_margin) and self.further.met_by(found)
        return self.delay_margin == 0 or enough(extra_delay(loop), self.delay_margin)

    @cached_property
    def to_use(self) -> "GainsToUse | None":
        """Gains to use in place of unsafe ones; None where none are known, and for safe gains."""
        return None if self.safe else gains_to_use(self)

    @property
    def hardly_damped(self) -> bool:
        """Whether Ms is above BARE, where nothing is required of it."""
        value = self.worst["peak_sensitivity"].margins.peak_sensitivity
        return "peak_sensitivity" not in self.further.needed and value > BARE

    @property
    def ready_to_use(self) -> "GainsToUse | None":
        """Those, unless the loop's rate is not known, which costs margin, or they hardly damp the motion."""
        found = self.to_use
        return None if found is None or self.system.control.sample_time is None or found.audited.hardly_damped else found

    @property
    def assumed_rigid(self) -> Booleans:
        """(n,) the gearboxes whose stiffness was not given: a safe verdict is conditional on them."""
        return np.isinf(self.system.source.actuators.stiffness)

    @cached_property
    def delay_with_margin(self) -> float:
        """[s] of extra delay that leaves the required gain margin, over all states; NaN where it is not known, or is not there at all."""
        return float(np.min([extra_delay(state.loop.scaled(self.margin)) for state in self.states]))

    def of_gains(self, gains: Mapping[str, Floats]) -> "Audit":
        """Other gains of the same joints, (n,) each, audited like these, with the same gearboxes: of a range the worst of now."""
        control = replace(self.system.control, controller=replace(self.controller, **gains))
        system = replace(self.system, control=control)
        return replace(self, system=system, every=analyze(system, None, NUMBERS).every, needed=None, over=None)

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


@dataclass(frozen=True)
class GainsToUse:
    """Gains in place of unsafe ones, certified as they are typed.

    factor   on the gains of `joints`; all others stay
    gains    (n,) by name, rounded to the digits that are typed
    audited  their audit: safe
    """

    factor: float
    joints: tuple[str, ...]
    gains: Mapping[str, Floats]
    audited: Audit


def gains_to_use(result: Audit) -> GainsToUse | None:
    """Some joints' gains lowered by one factor, and where that does not do all gains; None where neither is known to be safe.

    The factor has three digits, the gains four or as many more as leave them safe.
    """
    names = result.system.source.joint_names
    every = np.ones(len(names), dtype=bool)
    some, factor_on_some = _some_lowered(result)
    for lowered, factor in ((some, factor_on_some), (every, result.scale)):
        factor = typed_factor(factor)
        if not factor > 0:
            continue
        exact = {name: np.array([getattr(joint, name) for joint in result.joints]) for name in result.gain_names}
        for count in range(4, MOST_DIGITS + 1):
            typed = {
                name: np.array([float(f"{value:.{count}g}") for value in (np.where(lowered, factor, 1.0) * values).tolist()])
                for name, values in exact.items()
            }
            audited = result.of_gains(typed)
            if audited.safe:
                return GainsToUse(factor, tuple(name for name, low in zip(names, lowered, strict=True) if low), typed, audited)
            if lowered is some:  # its factor was found, not proved: more digits would not mend it
                break
    return None


def _some_lowered(result: Audit) -> tuple[Booleans, float]:
    """Joints (n,), unsafe ones and where they do not suffice those that vibrate then, and the largest factor found on their gains alone.

    The factor is NaN where none was found, where all joints are unsafe, and where kd has a path of its own.
    """
    names, lowered = result.system.source.joint_names, np.array([not joint.safe for joint in result.joints])
    most = min(1.0, min((joint.gain_limit for joint in result.joints if not joint.safe), default=math.nan) / result.margin)
    if not most > 0 or result.has_two_paths:
        return lowered, math.nan

    def holds(factor: float) -> bool:
        loops = list(result.loops_at(lowered, factor))
        return all(is_stable(loop) and is_stable(loop.scaled(result.margin)) for loop in loops) and all(map(result.has_rest, loops))

    for _ in range(GROWTHS):
        limits = map(limit_of, result.loops_at(lowered, most))
        short = {name for limit in limits if not enough(limit.gain, result.margin) for name in limiting_joints(limit, names)}
        if not short - {name for name, low in zip(names, lowered, strict=True) if low}:
            break
        lowered = lowered | np.isin(names, list(short))
    return lowered, math.nan if lowered.all() else largest_factor(holds, most)


def largest_factor(holds: Callable[[float], bool], most: float) -> float:
    """The largest factor up to `most` at which a test holds, within 0.1 %, where it holds below: at LOWER of it; NaN: nowhere there."""
    if not most > 0 or holds(most):
        return most
    held = next((share * most for share in LOWER if holds(share * most)), math.nan)
    lost = most
    while lost > 1.001 * held:
        middle = math.sqrt(held * lost)
        held, lost = (middle, lost) if holds(middle) else (held, middle)
    return held


def audit(
    system: System,
    margin: float = MARGIN,
    progress: Progress | None = None,
    damping_ratio: float | None = None,
    gearboxes: GearboxRange | None = None,
    delay_margin: float | None = None,
    further: Requirements | None = None,
) -> Audit:
    """Every state of `system`, whose control must be in joint space, against a required gain margin (a factor). Raises as analyze does.

    damping_ratio   of gearboxes of unknown stiffness: also how stiff they must be, where the gains are safe on rigid ones
    gearboxes       the ranges that the others lie in; the audit is then one of the worst within them
    delay_margin    [s] that safe gains have; None: EXTRA_DELAY of the delay
    further         what else they have
    """
    extra = EXTRA_DELAY * system.delay if delay_margin is None else delay_margin
    further = Requirements() if further is None else further
    over = None
    if gearboxes is not None:
        states = [state for names in system.source.states if (state := state_of(system, *names)).moves]
        over = look_over(system, states, margin, gearboxes, progress) if states else None
        system = system if over is None else system.with_values(stiffness=over.worst.stiffness, damping=over.worst.damping)
    found = Audit(system, analyze(system, progress, NUMBERS).every, margin, over=over, delay_margin=extra, further=further)
    if damping_ratio is None or not found.safe:
        return found
    return replace(found, needed=needed_stiffness(system, found.states, margin, damping_ratio, progress, found.has_rest))
