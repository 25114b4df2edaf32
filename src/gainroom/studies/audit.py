"""The gains that a robot already has: which are safe, their headroom, and the delay at which the robot vibrates.

A joint is safe where its gains have the required margin on it alone, its neighbours free, and where it takes no part in the vibration of
a robot that does not have it as a whole.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..linear.arrays import Floats
from ..robot.gearbox_types import GearboxRange
from ..system.loop import Loop
from ..system.requirements import Requirements, enough
from ..system.system import System
from .analysis import Analysis, analyze
from .gearbox_range import RangeOfGearboxes, look_over
from .needed_stiffness import NeededStiffness, needed_stiffness
from .state import STRONG, Progress, State, by_headroom, extra_delay, margins_of, state_of

MARGIN = 2.0
"""The required factor on all gains by default: 6 dB."""
EXTRA_DELAY = 0.5
"""Of the loop's delay: by so much it may be longer than was said, by default."""
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
        """The names of what a state has too little of; of one that is not stable the gain margin."""
        if not self.enough_gain_in(state):
            return ["gain_margin"]
        missed = [] if enough(self.extra_delay(state), self.delay_margin) else ["delay_margin"]
        return missed + [one.name for one, needed in self.further.asked_for if not one.met(needed, one.value(state.margins))]

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

    @property
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
        vibrating = {name for state in self.states for missed in self.missed_in(state) for name in joints_that_miss(state, missed)}
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
        return scale if known and all(state.margins.paths is None for state in self.states) else math.nan

    @cached_property
    def scale(self) -> float:
        """The factor on all gains that makes them safe: gain_scale, or less where all else that is required is there; NaN: none found."""
        scale, lowest = min(self.gain_scale, 1.0), max(state.limit.lower_gain for state in self.states)
        if math.isnan(self.gain_scale) or self.has_rest_at(scale):
            return self.gain_scale if math.isnan(self.gain_scale) else scale
        held = next(
            (share * scale for share in LOWER if lowest * self.margin < share * scale and self.has_rest_at(share * scale)), math.nan
        )
        lost = scale
        while lost > 1.004 * held:
            middle = math.sqrt(held * lost)
            held, lost = (middle, lost) if self.has_rest_at(middle) else (held, middle)
        return held

    def has_rest_at(self, factor: float) -> bool:
        """Whether with all gains times `factor` all that is required but the gain margin is there, in every state."""
        return all(self.has_rest(state.loop.scaled(factor)) for state in self.states)

    def has_rest(self, loop: Loop) -> bool:
        """Whether a loop has what is required besides the gain margin."""
        if self.further.asked_for:
            found = margins_of(loop)
            return enough(found.delay_margin, self.delay_margin) and self.further.met_by(found)
        return self.delay_margin == 0 or enough(extra_delay(loop), self.delay_margin)

    @cached_property
    def extra_delay_to_use(self) -> float:
        """[s] until the gains to use vibrate, over all states; NaN where none are known, or the present ones are safe."""
        if self.safe or math.isnan(self.scale):
            return math.nan
        return float(np.min([extra_delay(state.loop.scaled(self.scale)) for state in self.states]))

    def holds(self, gains: Mapping[str, Floats]) -> bool:
        """Whether other gains of the same joints, (n,) each, are safe: audited like these, with the same gearboxes."""
        control = self.system.control
        assert control.controller is not None
        system = replace(self.system, control=replace(control, controller=replace(control.controller, **gains)))
        return replace(self, system=system, every=analyze(system, None, NUMBERS).every, needed=None, over=None).safe

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


def joints_that_miss(state: State, name: str) -> tuple[str, ...]:
    """The joints that move where a state misses a requirement: in its vibration at the gain limit, or where it is lost to delay or phase.

    Peak sensitivity: the joint whose loop has it.
    """
    names, found = state.model.joint_names, state.margins
    if name == "gain_margin" or state.loop.kd_path is not None:
        return state.limiting_joints
    if name == "phase_margin" and found.one_loop_phase_margin < found.common_phase_margin:
        return (names[int(np.argmin(found.one_loop.phase_margin))],)
    omega = {"delay_margin": found.delay_crossover, "phase_margin": found.gain_crossover}.get(name, found.peak_sensitivity_frequency)
    if not (math.isfinite(omega) and omega > 0):
        return state.limiting_joints
    response = state.loop.response(np.array([omega])).reshape(len(names), len(names))
    if name == "peak_sensitivity":
        return (names[int(np.argmax(np.abs(np.diagonal(np.linalg.inv(np.eye(len(names)) + response)))))],)
    values, vectors = np.linalg.eig(response)
    parts = np.abs(vectors[:, int(np.argmin(np.abs(np.abs(values) - 1)))])
    return tuple(names[k] for k in np.argsort(-parts, kind="stable") if parts[k] >= STRONG * parts.max())
