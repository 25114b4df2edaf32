"""Linearisation of a robot in a posture on its contacts to a plant of n joints: W = S P Sᵀ, compliant contact, gravity stiffness.

A floating base and passive joints move with the joints as contacts and closed loops demand. What holds rigidly is projected out
(contact.py); springs push with f = −(K_c + s B_c) x_c on their own motion x_c, which leaves

    W(s) = W − C (s² (K_c + s B_c)⁻¹ + D)⁻¹ Cᵀ,    C = S P J_kᵀ,    D = J_k P J_kᵀ

with J_k the compliant rows and P what the rigid ones leave. Stiff springs give back rigid contact.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import GainroomError, require_finite
from ..system.linear.arrays import Floats
from ..system.plant import Compliance
from .assemble import massless
from .contact import REDUNDANT, Constraints, Contact, free_motion, held
from .linkage import ties_base
from .model import RobotModel

if TYPE_CHECKING:
    from .actuators import Actuators
    from .body import RigidBody

# Central differences: truncation grows as step², round-off as 1/step; they meet near the cube root of the machine precision, where about
# ten digits are right.
STEP = 1e-5


def linearize(body: "RigidBody", actuators: "Actuators", q: Floats, contacts: Sequence[Contact] = (), gravity: bool = False) -> RobotModel:
    """Linear robot model about posture `q`, standing on `contacts`.

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
    holding = held(body, q, contacts)
    inertia = body.mass_matrix(q)
    _require_mass(body, inertia)
    motion, joints, inverse = _links(body, inertia, holding)
    return RobotModel(
        link_inverse_inertia=inverse,
        motor_inertia=actuators.motor_inertia,
        stiffness=actuators.stiffness,
        damping=actuators.damping,
        motor_viscous=actuators.motor_viscous,
        link_viscous=actuators.link_viscous,
        gravity_stiffness=_stiffness(body, q, contacts, gravity),
        compliance=_compliance(motion, joints, holding),
        joint_names=body.joint_names,
        body=body,
        q=q,
        inertia=inertia,
        contacts=contacts,
        held=holding,
    )


def _links(body: "RigidBody", inertia: Floats, holding: Constraints) -> tuple[Floats, Floats, Floats]:
    """Free motion R (nv, r), its joint rows S R (n, r), and W (n, n) = S R Rᵀ Sᵀ, without contact springs."""
    motion = free_motion(inertia, holding.jacobian[holding.rigid])
    joints = motion[body.nv - body.size :]
    # Without base and passive joints nothing is projected, and W is A⁻¹ to the last bit.
    inverse = joints @ joints.T if holding.rigid.any() or body.nv > body.size else np.linalg.inv(inertia)
    return motion, joints, inverse


def link_inverse_inertia(body: "RigidBody", q: Floats, contacts: Sequence[Contact] = ()) -> Floats:
    """Inverse link inertia W (n, n) without contact springs; arguments and errors are those of linearize."""
    inertia = body.mass_matrix(q)
    _require_mass(body, inertia)
    return _links(body, inertia, held(body, q, tuple(contacts)))[2]


def gravity_stiffness(body: "RigidBody", q: Floats, contacts: Sequence[Contact] = ()) -> Floats:
    """Gravity stiffness G (n, n), symmetric [N m/rad]: derivative of the holding joint torque by motion on rigid contacts.

    Near equilibrium, with torque τ₀ and contact forces f₀ that hold the robot, g = Sᵀ τ₀ + J_cᵀ f₀, the links obey

        A δq̈ = Sᵀ δτ + J_cᵀ δf − H δq,    H = ∂(g − J_cᵀ f₀)/∂q,    J_c δq = 0

    The second part of H is the geometric stiffness of the contact forces. Motion on the contacts is δq = Y δq_a with Y = R (S R)⁺ and R of
    contact.py, so δq̈_a = W (δτ − G δq_a) with G = Yᵀ H Y: the second derivative of the weight's potential less τ₀ᵀ q_a over the
    motions that the contacts leave. H is taken by central differences along the columns of Y. On a fixed base without contact Y = I
    and G = ∂g/∂q.

    Where feet closed into a loop can press against each other, the torques that hold the robot are not unique and G depends on them:
    the smallest ones, in least squares, are taken. In flight everything falls alike and G = 0. Springs under a foot enter without the
    load they carry.

    Raises GainroomError where contacts leave the base free to move (points, lines, springs), or loops a passive joint: that motion does
    not follow from the joints, so no G expresses its weight.
    """
    if body.base == "floating" and not contacts and not ties_base(body):
        return np.zeros((body.size, body.size))
    holding = held(body, q, contacts)
    jacobian, rigid = holding.jacobian, holding.rigid
    motion = free_motion(body.mass_matrix(q), jacobian[rigid])
    joints = motion[body.nv - body.size :]
    free = _free(motion, joints)
    if free:
        what, moved = "rigid contacts that hold the base", "it"
        if body.passive:
            what, moved = "contacts and closed loops that hold base and passive joints", "them"
        elif ties_base(body):
            what = "contacts and closed loops that hold the base"
        raise GainroomError(
            f"robot: gravity stiffness needs {what}; {free} direction{'s' * (free > 1)} of {moved} can move while the joints stand still"
        )
    inverse = np.linalg.pinv(joints, rcond=REDUNDANT)
    reached = motion @ inverse  # Y
    weight = body.gravity_torque(q)
    torque = np.linalg.pinv(joints.T, rcond=REDUNDANT) @ (motion.T @ weight)  # τ₀
    rest = weight.copy()
    rest[body.nv - body.size :] -= torque
    forces = np.linalg.lstsq(jacobian[rigid].T, rest, rcond=REDUNDANT)[0]  # f₀; J_cᵀ f₀ is unique

    def unbalanced(direction: Floats, step: float) -> Floats:
        moved = body.integrate(q, step * direction)
        return body.gravity_torque(moved) - held(body, moved, contacts).jacobian[rigid].T @ forces

    change = [(unbalanced(column, STEP) - unbalanced(column, -STEP)) / (2 * STEP) for column in reached.T]
    stiffness = reached.T @ np.array(change).T
    return (stiffness + stiffness.T) / 2


def _stiffness(body: "RigidBody", q: Floats, contacts: Sequence[Contact], gravity: bool) -> Floats | None:
    """Stiffness (n, n) on the links beside the gearboxes, from gravity (if `gravity`) and the joints' own springs; None: none.

    A spring between the two links of joint j gives −k δq_j, a joint torque like the gearbox's: it adds k to G's diagonal on any contacts.
    """
    springs = np.array([body.springs.get(name, 0.0) for name in body.joint_names])
    if not gravity:
        return np.diag(springs) if springs.any() else None
    return gravity_stiffness(body, q, contacts) + np.diag(springs)


def holds_base(body: "RigidBody", q: Floats, contacts: Sequence[Contact]) -> bool:
    """True if rigid contacts hold a floating base, so that it moves with the joints alone and gravity stiffness is defined."""
    if body.base == "fixed" or not contacts:
        return False
    holding = held(body, q, contacts)
    motion = free_motion(body.mass_matrix(q), holding.jacobian[holding.rigid])
    return not _free(motion, motion[body.nv - body.size :])


def _free(motion: Floats, joints: Floats) -> int:
    """Number of directions in which base and passive joints can move while the actuated joints are immobile."""
    sizes = np.linalg.svd(joints, compute_uv=False)
    return motion.shape[1] - int(np.count_nonzero(sizes > REDUNDANT * sizes.max(initial=0.0)))


def _compliance(motion: Floats, joints: Floats, holding: Constraints) -> Compliance | None:
    """Compliance of contact springs and passive-joint springs, in the form of Plant; None if all constraints are rigid."""
    soft = ~holding.rigid
    if not soft.any():
        return None
    moved = holding.jacobian[soft] @ motion  # J_k R
    return Compliance(joints @ moved.T, moved @ moved.T, stiffness=holding.springs[soft], damping=holding.dampers[soft])


def _require_mass(body: "RigidBody", inertia: Floats) -> None:
    """Raise GainroomError if some motion has no inertia in this posture; loading checks two other postures only."""
    if massless(inertia):
        raise GainroomError(f"{body.source}: singular mass matrix in this posture: no mass moves with some of its joints")
