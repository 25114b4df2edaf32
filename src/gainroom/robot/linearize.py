"""From a robot in a posture on its contacts to a plant of n joints: W = S P Sᵀ, compliant contact, gravity stiffness.

A floating base moves with the joints as the contacts demand. Rigid contacts are projected out (contact.py); a compliant one pushes with
f = −(K_c + s B_c) x_c on its own motion x_c, which leaves

    W(s) = W − C (s² (K_c + s B_c)⁻¹ + D)⁻¹ Cᵀ,    C = S P J_kᵀ,    D = J_k P J_kᵀ

with J_k the compliant rows and P what the rigid ones leave. Stiff springs give back rigid contact.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import GainroomError, require_finite
from ..linear.arrays import Floats
from ..system.plant import Compliance
from .assemble import massless
from .contact import REDUNDANT, Contact, contact_jacobian, free_motion, rigid_rows
from .model import RobotModel

if TYPE_CHECKING:
    from .actuators import Actuators
    from .body import RigidBody

# Central differences: truncation grows as step², round-off as 1/step; they meet near the cube root of the machine precision, where about
# ten digits are right.
STEP = 1e-5


def linearize(body: "RigidBody", actuators: "Actuators", q: Floats, contacts: Sequence[Contact] = (), gravity: bool = False) -> RobotModel:
    """The robot about posture `q`, standing on `contacts`.

    body        the links
    actuators   one entry per joint of the body
    q           (nq,) configuration, as body.configuration gives it
    contacts    none: in flight, or a fixed base that touches nothing
    gravity     True: with gravity stiffness, see gravity_stiffness; springs of the body's own joints always count

    Raises GainroomError for a posture of the wrong shape, unknown or repeated frames, massless links, and gravity where the contacts
    leave the base free.
    """
    q = require_finite("robot", "posture", q)
    contacts = tuple(contacts)
    jacobian = contact_jacobian(body, q, contacts)
    rigid = rigid_rows(contacts)
    inertia = body.mass_matrix(q)
    _require_mass(body, inertia)
    motion = free_motion(inertia, jacobian[rigid])
    joints = motion[body.nv - body.size :]  # S R
    # Without contact nothing is projected, and a fixed base has A⁻¹ to the last bit.
    inverse = joints @ joints.T if rigid.any() or body.base == "floating" else np.linalg.inv(inertia)
    return RobotModel(
        link_inverse_inertia=inverse,
        motor_inertia=actuators.motor_inertia,
        stiffness=actuators.stiffness,
        damping=actuators.damping,
        motor_viscous=actuators.motor_viscous,
        link_viscous=actuators.link_viscous,
        gravity_stiffness=_stiffness(body, q, contacts, gravity),
        compliance=_compliance(motion, joints, jacobian[~rigid], contacts),
        joint_names=body.joint_names,
        body=body,
        q=q,
        inertia=inertia,
        contacts=contacts,
        contact_jacobian=jacobian,
    )


def gravity_stiffness(body: "RigidBody", q: Floats, contacts: Sequence[Contact] = ()) -> Floats:
    """G (n, n), symmetric [N m/rad]: the change of the holding joint torque with motion on its rigid contacts.

    Near equilibrium, with torque τ₀ and contact forces f₀ that hold the robot, g = Sᵀ τ₀ + J_cᵀ f₀, the links obey

        A δq̈ = Sᵀ δτ + J_cᵀ δf − H δq,    H = ∂(g − J_cᵀ f₀)/∂q,    J_c δq = 0

    The second part of H is the geometric stiffness of the contact forces. Motion on the contacts is δq = Y δq_a with Y = R (S R)⁺ and R of
    contact.py, so δq̈_a = W (δτ − G δq_a) with G = Yᵀ H Y: the second derivative of the weight's potential less τ₀ᵀ q_a over the
    motions that the contacts leave. H is taken by central differences along the columns of Y. On a fixed base without contact Y = I
    and G = ∂g/∂q.

    Where feet closed into a loop can press against each other, the torques that hold the robot are not unique and G depends on them:
    the smallest ones, in least squares, are taken. In flight everything falls alike and G = 0. Springs under a foot enter without the
    load they carry.

    Raises GainroomError where contacts leave the base free to move (points, lines, springs): that motion does not follow from the joints,
    so no G expresses its weight.
    """
    jacobian = contact_jacobian(body, q, contacts)
    rigid = rigid_rows(contacts)
    if body.base == "floating" and not len(jacobian):
        return np.zeros((body.size, body.size))
    motion = free_motion(body.mass_matrix(q), jacobian[rigid])
    joints = motion[body.nv - body.size :]
    free = _free(motion, joints)
    if free:
        raise GainroomError(
            f"robot: gravity stiffness needs rigid contacts that hold the base; {free} direction{'s' * (free > 1)} of it can move "
            "while the joints stand still"
        )
    inverse = np.linalg.pinv(joints, rcond=REDUNDANT)
    reached = motion @ inverse  # Y
    weight = body.gravity_torque(q)
    held = np.linalg.pinv(joints.T, rcond=REDUNDANT) @ (motion.T @ weight)  # τ₀
    rest = weight.copy()
    rest[body.nv - body.size :] -= held
    forces = np.linalg.lstsq(jacobian[rigid].T, rest, rcond=REDUNDANT)[0]  # f₀; J_cᵀ f₀ is unique

    def unbalanced(direction: Floats, step: float) -> Floats:
        moved = body.integrate(q, step * direction)
        return body.gravity_torque(moved) - contact_jacobian(body, moved, contacts)[rigid].T @ forces

    change = [(unbalanced(column, STEP) - unbalanced(column, -STEP)) / (2 * STEP) for column in reached.T]
    stiffness = reached.T @ np.array(change).T
    return (stiffness + stiffness.T) / 2


def _stiffness(body: "RigidBody", q: Floats, contacts: Sequence[Contact], gravity: bool) -> Floats | None:
    """The stiffness on the links beside the gearboxes: gravity where `gravity`, and the joints' own springs; None: none.

    A spring between the two links of joint j turns −k δq_j, a joint torque like those of the gearbox: it adds k to G's diagonal on any
    contacts.
    """
    springs = np.array([body.springs.get(name, 0.0) for name in body.joint_names])
    if not gravity:
        return np.diag(springs) if springs.any() else None
    return gravity_stiffness(body, q, contacts) + np.diag(springs)


def holds_base(body: "RigidBody", q: Floats, contacts: Sequence[Contact]) -> bool:
    """Whether rigid contacts hold a floating base, so that it moves with the joints alone and gravity stiffness is theirs."""
    if body.base == "fixed" or not contacts:
        return False
    motion = free_motion(body.mass_matrix(q), contact_jacobian(body, q, contacts)[rigid_rows(contacts)])
    return not _free(motion, motion[body.nv - body.size :])


def _free(motion: Floats, joints: Floats) -> int:
    """The number of directions in which the base can move while the joints are immobile."""
    sizes = np.linalg.svd(joints, compute_uv=False)
    return motion.shape[1] - int(np.count_nonzero(sizes > REDUNDANT * sizes.max(initial=0.0)))


def _compliance(motion: Floats, joints: Floats, jacobian: Floats, contacts: Sequence[Contact]) -> Compliance | None:
    """The springs under the feet as the plant wants them; None where every contact is rigid."""
    if not len(jacobian):
        return None
    springs = np.concatenate([contact.springs for contact in contacts])
    dampers = np.concatenate([contact.dampers for contact in contacts])
    soft = np.isfinite(springs)
    moved = jacobian @ motion  # J_k R
    return Compliance(coupling=joints @ moved.T, inverse_inertia=moved @ moved.T, stiffness=springs[soft], damping=dampers[soft])


def _require_mass(body: "RigidBody", inertia: Floats) -> None:
    """Raise GainroomError where some motion has no inertia in this posture; loading has only looked at two others."""
    if massless(inertia):
        raise GainroomError(f"{body.source}: singular mass matrix in this posture: no mass moves with some of its joints")
