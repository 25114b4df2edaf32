"""What is known of a robot in each posture and contact state: the records that a study is made of."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..analysis.margin_record import GainLimit, Margins
from ..design.robot_gains import RobotGains
from ..linear.arrays import Complexes, Integers
from ..robot.spec import RobotSpec
from ..system.loop import Loop
from ..system.requirements import Requirements

if TYPE_CHECKING:
    from ..robot.model import RobotModel
    from ..robot.tasks import Tasks

STRONG = 0.5
"""A joint takes part in a vibration where it moves by at least this share of the one that moves most."""


@dataclass(frozen=True)
class JointRow:
    """One joint in one state.

    link_inertia        1/W_ii: the load with every neighbour free [kg m²]; inf where the contacts hold the joint
    participation       its part in the vibration at the limit, relative to the largest
    single_joint_limit  factor on its gains if it were the only joint, with that load
    limit_others_closed factor on its gains with all other loops as they are; NaN for an unstable robot
    kp, kd              what the controller does on this joint alone: N m/rad, N m s/rad
    kp_max, kd_max      largest, the other gains as they are; NaN where unstable, or the controller has none
    """

    name: str
    link_inertia: float
    participation: float
    single_joint_limit: float
    limit_others_closed: float
    kp: float
    kd: float
    kp_max: float
    kd_max: float


@dataclass(frozen=True)
class TaskRow:
    """One direction of a task.

    moves        False where no joint can move it in this state: its gains do nothing, and both limits are NaN
    kp, kd       its own gains [1/s²], [1/s]; P/PI: [1/s], [1/s], with ki [1/s²]; ki None: PD
    gain_limit   factor on them with no other direction closed; NaN where its gains are 0, and where it is not known
    limit_others_closed   factor on them with all others as they are; NaN where the stack is unstable
    """

    name: str
    direction: str
    moves: bool
    kp: float
    kd: float
    ki: float | None
    gain_limit: float
    limit_others_closed: float


@dataclass(frozen=True)
class TaskStudy:
    """The operational space in one state: the limit of all tasks together (NaN where they move nothing), and each direction."""

    tasks: "Tasks"
    limit: GainLimit
    rows: tuple[TaskRow, ...]

    @property
    def moves(self) -> bool:
        """Whether any direction can be moved in this state."""
        return any(row.moves for row in self.rows)


@dataclass(frozen=True)
class State:
    """One posture in one contact state."""

    posture: str
    contact: str

    @property
    def title(self) -> str:
        """For tables and messages."""
        return f"{self.posture}, {self.contact}"


@dataclass(frozen=True)
class JudgedState(State):
    """A state in which the gains move something, so that there is a verdict."""

    model: "RobotModel"
    margins: Margins

    @property
    def limit(self) -> GainLimit:
        """Of the common factor on all gains; its numbers are NaN where only the verdict is known."""
        return self.margins.limit

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """Those that take part in the vibration at the limit, the strongest first."""
        return limiting_joints(self.limit, self.model.joint_names)


@dataclass(frozen=True)
class StateStudy(JudgedState):
    """All that is known of one state."""

    loop: Loop
    joints: tuple[JointRow, ...]
    tasks: TaskStudy | None


@dataclass(frozen=True)
class StillState(State):
    """A state in which the gains move nothing: no loop is closed, so there is no verdict and no limit.

    reason   why, in words
    joints, tasks   their rows: all that depends on a loop is NaN
    """

    reason: str
    joints: tuple[JointRow, ...]
    tasks: TaskStudy | None


@dataclass(frozen=True)
class RobotStudy:
    """What `gainroom robot` tells.

    states        in the file's order, those in which the gains move something: one or more
    still         the others
    recommended   by space
    unstable_at   posture, contact state and corner of the uncertainty in which the gains as given are unstable, in words; "" where
                  none is found, nothing is uncertain, or they are unstable as stated
    """

    spec: RobotSpec
    states: tuple[StateStudy, ...]
    sentence: str
    warnings: tuple[str, ...]
    recommended: tuple[RobotGains, ...] = ()
    still: tuple[StillState, ...] = ()
    unstable_at: str = ""

    @property
    def stable_in_range(self) -> bool:
        """Stable as stated, and at every corner of the uncertainty."""
        return self.stable and not self.unstable_at

    @property
    def stable(self) -> bool:
        """In every state in which the gains move something."""
        return all(state.limit.stable for state in self.states)

    @property
    def worst(self) -> dict[str, StateStudy]:
        """By name of a requirement, the state that keeps least of it."""
        least: dict[str, Callable[[StateStudy], float]] = {
            "gain_margin": lambda state: state.margins.least_gain_margin,
            "phase_margin": lambda state: state.margins.least_phase_margin,
            "peak_sensitivity": lambda state: -state.margins.peak_sensitivity,
        }
        # Mirrored states differ by round-off: the first of them
        return {name: min(self.states, key=lambda state, key=key: float(f"{key(state):.9g}")) for name, key in least.items()}

    @property
    def unmet(self) -> dict[str, StateStudy]:
        """The requirements that are not kept in every state, each with the worst one; empty for an unstable robot."""
        asked = self.spec.requirements
        one = {name: Requirements(**{name: getattr(asked, name)}) for name in asked.asked}
        return {name: self.worst[name] for name in one if not one[name].met_by(self.worst[name].margins)} if self.stable else {}

    @property
    def tightest(self) -> StateStudy:
        """The state with the least room."""
        return min(self.states, key=lambda state: by_room(state.limit))

    @property
    def tightest_by_contact(self) -> tuple[StateStudy, ...]:
        """Of each contact state the posture with the least room, in the file's order."""
        contacts = dict.fromkeys(state.contact for state in self.states)
        groups = ([state for state in self.states if state.contact == contact] for contact in contacts)
        return tuple(min(group, key=lambda state: by_room(state.limit)) for group in groups)


def by_room(limit: GainLimit) -> tuple[bool, float]:
    """Sorts limits: unstable ones first, then the one with the least room. One that is not known (NaN) counts as far away."""
    return limit.stable, math.inf if math.isnan(limit.gain) else limit.gain


def strongest_first(mode: Complexes) -> Integers:
    """The joints by falling part in a vibration, those that differ by round-off alone (left and right) in the model's order."""
    parts = np.abs(mode)
    return np.argsort(-np.round(parts / parts.max(), 6), kind="stable")


def limiting_joints(limit: GainLimit, names: tuple[str, ...]) -> tuple[str, ...]:
    """The joints that take part in the vibration at a limit, the strongest first; none where there is no limit."""
    if not math.isfinite(limit.frequency):
        return ()
    parts = np.abs(limit.mode)
    return tuple(names[k] for k in strongest_first(limit.mode) if parts[k] >= STRONG * parts.max())
