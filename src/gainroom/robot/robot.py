"""Robot: links, actuators, postures, contact states and tasks; a source of plants in SI units."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, first_of_many, named, nearest
from ..system.linear.arrays import Booleans, Floats

if TYPE_CHECKING:
    from ..system.system import System
    from .actuators import Actuators
    from .body import RigidBody
    from .contact import Contact
    from .ground import Ground
    from .model import RobotModel
    from .tasks import Task, Tasks


@dataclass(frozen=True)
class Posture:
    """Posture of the robot: angles [rad] by joint name, 0 where not named; `body` has its locked joints at this posture's angles."""

    body: "RigidBody"
    angles: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Robot:
    """Robot: links, actuators, and the postures, contact states and tasks in which it is studied.

    postures, contacts   by name, in the file's order
    stack                tasks by falling priority; none: joint space only
    gravity              True: with gravity stiffness; None: only in `linearize(weight=True)`
    system               the whole file, with control and limits; None for a robot made by hand
    """

    name: str
    actuators: "Actuators"
    postures: Mapping[str, Posture]
    contacts: Mapping[str, "tuple[Contact, ...]"]
    stack: "tuple[Task, ...]" = ()
    gravity: bool | None = False
    system: "System | None" = field(default=None, compare=False)

    def __repr__(self) -> str:
        names = f"postures {first_of_many(tuple(self.postures))}; contacts {first_of_many(tuple(self.contacts))}"
        return f"Robot({self.name!r}: {self.body.size} joints, {self.body.base} base; {names})"

    @property
    def body(self) -> "RigidBody":
        """Links, with locked joints as in the first posture."""
        return next(iter(self.postures.values())).body

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints, in the model's order."""
        return self.body.joint_names

    @property
    def states(self) -> tuple[tuple[str, str], ...]:
        """Every posture with every contact state, by name."""
        return tuple((posture, contact) for contact in self.contacts for posture in self.postures)

    @property
    def prismatic(self) -> Booleans:
        """(n,) True where a joint is prismatic: its values are in m and N."""
        return self.body.prismatic

    @property
    def unknown(self) -> Mapping[str, tuple[str, ...]]:
        """Missing gearbox and motor data and implausible links, as names by finding code; codes without names are left out."""
        joints, actuators = np.array(self.joint_names), self.actuators
        found = {
            "gearbox_unknown": tuple(joints[actuators.assumed_rigid].tolist()),
            "motor_inertia_unknown": tuple(joints[actuators.without_inertia].tolist()),
            "implausible": self.body.doubts,
        }
        return {code: names for code, names in found.items() if names}

    @property
    def quantities(self) -> Mapping[str, Floats]:
        """Motor inertia, gearbox and friction by name, each (n,)."""
        return self.actuators.quantities

    def with_quantities(self, **values: ArrayLike) -> "Robot":
        """Robot with other actuator `values`, by name in `quantities`, each a number or (n,)."""
        each = {name: np.broadcast_to(np.asarray(value, dtype=float), len(self.joint_names)) for name, value in values.items()}
        return replace(self, actuators=replace(self.actuators, **each))

    @cached_property
    def moved_inertia(self) -> Floats:
        """Inertia (n,) that each motor moves, the largest over all states [kg m²]."""
        return moved_inertia(self.postures, self.contacts)

    def linearize(self, posture: str | None = None, contact: str | None = None, weight: bool = False) -> "RobotModel":
        """Plant about one posture in one contact state; by default the first ones.

        weight   True: where gravity is not described, include its stiffness if contacts hold a floating base

        Raises GainroomError for an unknown name, and where the robot cannot be linearised.
        """
        from .linearize import holds_base, linearize

        posture = _known("posture", posture, self.postures)
        contact = _known("contact", contact, self.contacts)
        stance = self.postures[posture]
        with named(f"{self.name}: posture {posture!r}, contact {contact!r}"):
            q = stance.body.configuration(dict(stance.angles))
            held = self.contacts[contact]
            weighed = weight and holds_base(stance.body, q, held) if self.gravity is None else self.gravity
            model = linearize(stance.body, self.actuators, q, held, gravity=weighed)
        return replace(model, posture=posture, contact=contact)

    def tasks(self, model: "RobotModel", rotors: bool = False) -> "Tasks":
        """Operational space of this robot's tasks at the linearised state `model`; `rotors`: the controller's model includes motor inertia.

        Raises GainroomError if there are no tasks, or they do not fit the robot.
        """
        from .tasks import tasks_of

        if not self.stack:
            raise GainroomError(f"{self.name}: there are no tasks")
        return tasks_of(model, self.stack, rotors)


def moved_inertia(postures: Mapping[str, Posture], contacts: "Mapping[str, tuple[Contact, ...]]") -> Floats:
    """Inertia (n,) that each joint's motor moves, 1/W_ii, the largest over all postures and contact states [kg m²].

    A joint that cannot move, W_ii = 0, gets the largest of the others, 1 where there is none.

    Raises GainroomError where the robot cannot be linearised.
    """
    from .linearize import link_inverse_inertia

    every = [
        np.diagonal(link_inverse_inertia(one.body, one.body.configuration(dict(one.angles)), held))
        for one in postures.values()
        for held in contacts.values()
    ]
    with np.errstate(divide="ignore"):
        largest = np.max(1 / np.maximum(every, 0.0), axis=0)
    finite = np.isfinite(largest)
    return np.where(finite, largest, largest.max(initial=0.0, where=finite) or 1.0)


def _known(kind: str, name: str | None, values: Mapping[str, Any]) -> str:
    if name is None:
        return next(iter(values))
    if name not in values:
        raise GainroomError(f"{kind} {name!r} is not one of this robot's{nearest(name, tuple(values), kind)}")
    return name


@dataclass(frozen=True)
class RobotScenario:
    """Scenario of a robot simulation: the robot stands in a posture and moves a task or joints from rest to rest.

    posture, contact   by name; None: the first
    duration           of the run [s]
    task, joint        moved task, or pattern of moved joints; both None: the first task, or in joint space the arm's joints
    by                 displacement [m, rad], a number for all directions or joints, or one for each; None: a centimetre along x, 0.01 rad
    move_duration      [s]
    coulomb, viscous   (n,) friction on the motors' side [N m], [N m s/rad]
    torque_limit       (n,) of the commands [N m]
    resolution         of the encoders, joint side; 0: ideal [rad]
    ground             feet may slip on it and lift; None: they are held
    """

    posture: str | None = None
    contact: str | None = None
    duration: float = 2.0
    task: str | None = None
    joint: str | None = None
    by: tuple[float, ...] | None = None
    move_duration: float = 1.0
    coulomb: ArrayLike = 0.0
    viscous: ArrayLike = 0.0
    torque_limit: ArrayLike = math.inf
    resolution: float = 0.0
    ground: "Ground | None" = None
