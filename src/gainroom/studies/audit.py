"""The gains that a robot already has: which are safe, their headroom, and the delay at which the robot vibrates.

A joint is safe where its gains have the required margin on it alone, its neighbours free, and where it takes no part in the vibration of
a robot that does not have it as a whole.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..system.requirements import enough
from ..system.system import System
from .analysis import Analysis, analyze
from .state import Progress, State, by_headroom

MARGIN = 2.0
"""The required factor on all gains by default: 6 dB."""
NUMBERS = ("margins", "single_joint_limits", "delay_limit")


@dataclass(frozen=True)
class AuditedJoint:
    """One joint's gains, and the stable factor on them, alone and with the other loops closed, in the worst state."""

    name: str
    kp: float
    kd: float
    ki: float
    motor_inertia: float
    safe: bool
    gain_limit: float
    limit_others_closed: float


@dataclass(frozen=True)
class Audit(Analysis):
    """The result of `gainroom audit`.

    margin   the required factor
    """

    margin: float

    @property
    def safe(self) -> bool:
        """Every state and every joint has the margin."""
        return all(map(self.enough_in, self.states)) and all(joint.safe for joint in self.joints)

    def enough_in(self, state: State) -> bool:
        """Whether a state is stable with `margin` times its gains; where kd has a path of its own, also on either path alone."""
        paths = state.margins.paths
        return state.limit.stable and enough(state.limit.gain, self.margin) and (paths is None or enough(paths.headroom, self.margin))

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
        vibrating = {name for state in self.states if not self.enough_in(state) for name in state.limiting_joints}
        return tuple(
            AuditedJoint(
                name=name,
                **{key: float(column[k]) for key, column in columns.items()},
                motor_inertia=float(system.source.actuators.motor_inertia[k]),
                safe=enough(float(alone[k]), self.margin) and name not in vibrating,
                gain_limit=float(alone[k]),
                limit_others_closed=float(closed[k]),
            )
            for k, name in enumerate(system.source.joint_names)
        )

    @property
    def by_headroom(self) -> tuple[AuditedJoint, ...]:
        """The joints, unsafe ones first, then those with the least headroom alone."""
        return tuple(sorted(self.joints, key=lambda joint: (joint.safe, -math.inf if math.isnan(joint.gain_limit) else joint.gain_limit)))

    @property
    def scale(self) -> float:
        """The factor on all gains that makes them safe: exact, as every limit moves with one over it; NaN where none is known to.

        None is known where kd has a path of its own, and where a state's gains may not fall so far.
        """
        limits = [min(state.limit.gain, *np.nan_to_num(state.single_joint_limits, nan=math.inf).tolist()) for state in self.states]
        scale, lowest = min(limits) / self.margin, max(state.limit.lower_gain for state in self.states)
        known = 0 < scale < math.inf and lowest * self.margin < scale
        return scale if known and all(state.margins.paths is None for state in self.states) else math.nan

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


def audit(system: System, margin: float = MARGIN, progress: Progress | None = None) -> Audit:
    """Every state of `system`, whose control must be in joint space, against a required gain margin (a factor). Raises as analyze does."""
    return Audit(system, analyze(system, progress, NUMBERS).every, margin)
