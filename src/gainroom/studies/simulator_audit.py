"""Audit of gains in a training simulator beside the robot: gains that only one of the two holds."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ..simulation.simulated_gains import SimulatedRobot, Simulator, SimulatorLimit
from ..system.linear.arrays import Booleans
from .audit import Audit
from .state import limiting_joints
from .verdict import Finding

HeldBy = Literal["both", "simulator", "robot", "neither"]
"""Which of simulator and robot is stable with given gains."""


@dataclass(frozen=True)
class SimulatedJoint:
    """Stability of one joint's gains on it alone, its neighbours free, in every state: in simulation and on the robot."""

    name: str
    stable: bool
    held_by: HeldBy


@dataclass(frozen=True, eq=False)
class SimulatedState:
    """Posture in one contact state; `joints` (n,): True where a joint's gains alone are stable."""

    posture: str
    contact: str
    limit: SimulatorLimit
    joints: Booleans


@dataclass(frozen=True, eq=False)
class SimulatorAudit:
    """Results in the simulator beside an audit.

    states            those that the audit judges
    assumed           assumptions about the simulator, where nothing was stated
    largest_timestep  at which these gains are stable [s]; None if they are with the simulator's
    """

    audit: Audit
    simulator: Simulator
    assumed: tuple[str, ...]
    states: tuple[SimulatedState, ...]
    largest_timestep: float | None

    @property
    def tightest(self) -> SimulatedState:
        """State with the least headroom."""
        return min(self.states, key=lambda state: (state.limit.stable, state.limit.gain))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Finding of unstable gains in the simulator; () if they are stable."""
        if self.limit.stable:
            return ()
        where = f"{self.tightest.posture}/{self.tightest.contact}"
        return (Finding("unstable_in_simulator", "unsafe", {"gain_limit": self.limit.gain}, where),)

    @property
    def limit(self) -> SimulatorLimit:
        """Limit in the tightest state."""
        return self.tightest.limit

    @property
    def held_by(self) -> HeldBy:
        """Which of simulator and robot holds these gains, in every state."""
        return _held_by(self.limit.stable, self.audit.tightest.limit.stable)

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """Names of the joints that move most where the simulation begins to grow, the strongest first."""
        return limiting_joints(self.limit, self.audit.system.source.joint_names)

    @property
    def one_sided(self) -> tuple[HeldBy, float, float] | None:
        """Range of factors on all gains that only one of the two holds: which one, from, to.

        None if there is none, or a limit is not known.
        """
        simulator, robot = self.limit.gain, self.audit.tightest.limit.gain
        if not min(simulator, robot) < max(simulator, robot):  # NaN is not <
            return None
        return ("simulator" if simulator > robot else "robot"), min(simulator, robot), max(simulator, robot)

    @property
    def armature_differs(self) -> tuple[str, ...]:
        """Names of the joints whose armature in the simulator is not their motor's inertia."""
        source = self.audit.system.source
        if self.simulator.armature == "motor":
            return ()
        same = np.isclose(source.body.armature, source.actuators.motor_inertia, rtol=0.01, atol=0.0)
        return tuple(name for name, equal in zip(source.joint_names, same.tolist(), strict=True) if not equal)

    @cached_property
    def joints(self) -> tuple[SimulatedJoint, ...]:
        """Results per joint."""
        stable = np.all([state.joints for state in self.states], axis=0).tolist()
        pairs = zip(self.audit.joints, stable, strict=True)
        return tuple(SimulatedJoint(joint.name, holds, _held_by(holds, joint.gain_limit > 1)) for joint, holds in pairs)


def _held_by(simulator: bool, robot: bool) -> HeldBy:
    return ("both" if robot else "simulator") if simulator else "robot" if robot else "neither"


def audit_simulator(audit: Audit, simulator: Simulator, assumed: tuple[str, ...] = ()) -> SimulatorAudit:
    """Audit of the gains of `audit` in `simulator`, with its assumptions `assumed`. Raises GainroomError as SimulatedRobot."""
    kp, kd = (np.array([getattr(joint, name) for joint in audit.joints]) for name in ("kp", "kd"))
    states, steps = [], []
    for state in audit.states:
        robot = _simulated(audit, simulator, state.posture, state.contact)
        alone = np.eye(len(kp))
        joints = np.array([robot.stable(simulator, one * kp, one * kd) for one in alone])
        limit = robot.limit(simulator, kp, kd)
        states.append(SimulatedState(state.posture, state.contact, limit, joints))
        if not limit.stable:
            steps.append(robot.largest_timestep(simulator, kp, kd))
    return SimulatorAudit(audit, simulator, assumed, tuple(states), min(steps, default=None))


def _simulated(audit: Audit, simulator: Simulator, posture: str, contact: str) -> SimulatedRobot:
    """Robot of one state as modelled by the simulator."""
    source = audit.system.source
    stance = source.postures[posture]
    body = stance.body
    armature = body.armature if simulator.armature == "file" else source.actuators.motor_inertia
    return SimulatedRobot(body, body.configuration(stance.angles), armature, source.contacts[contact])
