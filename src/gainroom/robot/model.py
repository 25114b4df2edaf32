"""Robot linearised about one posture in one contact state: a plant of n joints, with the data of its operational space."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..system.linear.arrays import Booleans, Floats
from ..system.plant import Plant
from .contact import Constraints, Contact

if TYPE_CHECKING:
    from .body import RigidBody


class Stance(Protocol):
    """Robot model in one posture on its contacts, as a task controller needs it; members as in RobotModel."""

    @property
    def body(self) -> "RigidBody": ...
    @property
    def q(self) -> Floats: ...
    @property
    def inertia(self) -> Floats: ...
    @property
    def motor_inertia(self) -> Floats: ...
    @property
    def contact_jacobian(self) -> Floats: ...
    @property
    def selection(self) -> Floats: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...


@dataclass(frozen=True, kw_only=True)
class RobotModel(Plant):
    """Plant with the robot state that it was linearised from.

    body               the links
    q                  posture, in the body's configuration (nq,)
    inertia            A (N, N) of the links, rotors apart, by the body's velocities [kg m² and so on]
    held               constraints: contacts, rigid and compliant, and closed loops
    contacts           in the order of `held`
    posture, contact   their names, for tables
    """

    body: "RigidBody"
    q: Floats
    inertia: Floats
    held: Constraints
    contacts: tuple[Contact, ...] = ()
    posture: str = ""
    contact: str = ""

    def __repr__(self) -> str:
        state = f", posture {self.posture!r}, contact {self.contact!r}" if self.posture else ""
        return f"RobotModel({self.size} joints, {self.body.base} base{state})"

    @property
    def selection(self) -> Floats:
        """Selection matrix S (n, N) of the actuated joints, the last of all degrees of freedom."""
        total = len(self.inertia)
        return np.eye(total)[total - self.size :]

    @property
    def rigid(self) -> Booleans:
        """(c,) True for rigidly held rows of the contact Jacobian; the others are springs and enter as `compliance`."""
        return self.held.rigid

    @property
    def contact_jacobian(self) -> Floats:
        """Constraint Jacobian J_c (c, N): all rows of `held`."""
        return self.held.jacobian


def with_rotors(model: Stance) -> Floats:
    """Inertia (N, N) of the links and the actuated joints' rotors."""
    return model.inertia + model.selection.T @ np.diag(model.motor_inertia) @ model.selection
