"""A robot in MuJoCo: any RigidBody with elastic joints, rotors, friction, and contacts held or on real ground.

An elastic joint is two joints of MuJoCo in one body: the motor's, with armature J_m, turns to θ (what a motor-side encoder reads), and
the gearbox's, with stiffness K and damping B, by q − θ, so that the link stands at their sum q. A rigid joint is one joint with armature.

MuJoCo's Euler integrator moves positions with the velocity it has just changed. Read with velocities half a step earlier than positions,
that is the leapfrog rule: positions are right to second order, a vibration at ω appears at ω (1 + (ω h)²/24), and nothing leads by half
a step, provided that the torque of a step at t is the mean over t ± h/2 (torque_line.py gives that).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, nearest, require_finite, require_positive
from ..robot.actuators import Actuators
from ..robot.body import RigidBody, library
from ..robot.contact import Contact
from ..robot.formats.mjcf_compiler import ARENA
from ..robot.ground import Ground, Sole, ground_axes, upwards
from ..system.linear.arrays import Floats, Integers

HARDEST_CONSTRAINT = 0.9999
"""MuJoCo's largest constraint impedance: motion against a constraint is reduced to 1e-4 of the free motion, before feedback."""
HEIGHT = 0.02
"""Height of the boxes under flat feet, and radius of the cylinders and balls under line and point contacts [m]."""
GROUND_TIME = 2e-3
"""Time constant of the ground force [s]: hard as concrete at the frequencies at which loops vibrate."""


@dataclass(frozen=True, eq=False)
class MujocoRobot:
    """Robot compiled for MuJoCo, with the addresses of its joints in MuJoCo's arrays.

    model        the MjModel; its first n actuators are the motors, in the body's order
    body         the links it was made from
    contacts     its contacts
    motor_q, motor_v     (n,) addresses of the motors in qpos and qvel
    elastic      (n,) True for an elastic gearbox
    spring_q, spring_v   addresses of the springs of the elastic joints
    stiffness, damping   of those springs [N m/rad], [N m s/rad]
    """

    model: Any
    body: RigidBody
    contacts: tuple[Contact, ...]
    motor_q: Integers
    motor_v: Integers
    elastic: Any
    spring_q: Integers
    spring_v: Integers
    stiffness: Floats
    damping: Floats

    def new_data(self, q: ArrayLike, torque: ArrayLike = 0.0) -> Any:
        """MjData at rest, links in posture `q` (nq,), gearboxes deflected by joint torque (n,) [N m]: θ = q + τ_J/K."""
        data = library("mujoco", "MuJoCo").MjData(self.model)
        q = require_finite(self.body.source, "posture", q)
        joint_torque = np.broadcast_to(require_finite(self.body.source, "torque", torque), (self.body.size,))
        twist = joint_torque[self.elastic] / self.stiffness
        motors = self.body.angles(q)
        motors[self.elastic] += twist
        if self.body.base == "floating":
            data.qpos[:3], data.qpos[3:7] = q[:3], q[[6, 3, 4, 5]]
        data.qpos[self.motor_q], data.qpos[self.spring_q] = motors, -twist
        return data

    def motor_position(self, qpos: Floats) -> Floats:
        """Motor positions θ (..., n) [rad] from MuJoCo's positions (..., nq)."""
        return qpos[..., self.motor_q]

    def link_position(self, qpos: Floats) -> Floats:
        """Link positions q (..., n) [rad] from MuJoCo's positions (..., nq)."""
        position = qpos[..., self.motor_q]
        position[..., self.elastic] += qpos[..., self.spring_q]
        return position

    def joint_torque(self, qpos: Floats, qvel: Floats) -> Floats:
        """Joint torques τ_J = K (θ − q) + B (θ̇ − q̇) (..., n) [N m]; NaN for rigid joints, whose torque is not defined."""
        torque = np.full((*qpos.shape[:-1], len(self.elastic)), math.nan)
        torque[..., self.elastic] = -self.stiffness * qpos[..., self.spring_q] - self.damping * qvel[..., self.spring_v]
        return torque


def build_mujoco(
    body: RigidBody,
    actuators: Actuators,
    q: ArrayLike,
    contacts: Sequence[Contact] = (),
    *,
    timestep: float,
    coulomb: ArrayLike = 0.0,
    gravity: bool = True,
    ground: Ground | None = None,
) -> MujocoRobot:
    """MuJoCo model of a robot, ready to be simulated from posture `q`.

    body, actuators   links and motors; stiffness inf: rigid
    q          (nq,) posture in which contact frames are fixed, or the ground is placed, and springs in the joints are unloaded
    contacts   rigid ones are held by constraints, or stand on the ground; those with stiffness hang on springs and dampers
    timestep   h [s]; stable up to 2/ω of the fastest vibration
    coulomb    (n,) or one for all: Coulomb friction on the motor side [N m]; viscous friction is the actuators' own
    gravity    False: no gravity
    ground     None: rigid contacts cannot slip or lift

    Raises GainroomError for frames that the robot does not have, a contact with rigid and springy directions at once, and friction < 0.
    """
    mujoco = library("mujoco", "MuJoCo")
    require_positive("simulation", "timestep", timestep, "s")
    body.require_tree("simulation")
    q = require_finite(body.source, "posture", q)
    friction = np.broadcast_to(require_finite("simulation", "coulomb friction", coulomb), (body.size,))
    if np.any(friction < 0):
        raise GainroomError(f"simulation: coulomb friction {friction.min():g} N·m must be >= 0")
    spec = mujoco.MjSpec()
    spec.memory, spec.option.timestep = ARENA, timestep
    spec.option.gravity = np.array(body.model.gravity.linear) * (1.0 if gravity else 0.0)
    bodies = _add_links(mujoco, spec, body, actuators)
    for name in body.joint_names:  # before the springs under feet: the first n actuators are the motors
        spec.add_actuator(name=name, target=_motor(name), trntype=mujoco.mjtTrn.mjTRN_JOINT)
    for contact in contacts:
        _add_contact(mujoco, spec, bodies, body, q, contact, ground, timestep, gravity)
    for name in _link_side(body, actuators):
        tendon = spec.add_tendon(name=name)
        tendon.wrap_joint(_motor(name), 1.0)
        tendon.wrap_joint(_spring(name), 1.0)
    model = spec.compile()
    robot = _addressed(model, body, actuators, tuple(contacts))
    _set_values(mujoco, robot, actuators, friction, timestep, body.angles(q))
    return robot


def _link(joint: str) -> str:
    return f"{joint}/link"


def _motor(name: str) -> str:
    return f"{name}/motor"


def _spring(name: str) -> str:
    return f"{name}/spring"


def _link_side(body: RigidBody, actuators: Actuators) -> list[str]:
    """Names of elastic joints with friction or a spring on the link side, which act on the sum of two MuJoCo joints: a tendon."""
    elastic = np.isfinite(actuators.stiffness)
    return [name for k, name in enumerate(body.joint_names) if elastic[k] and (actuators.link_viscous[k] > 0 or body.springs.get(name))]


def _add_links(mujoco: Any, spec: Any, body: RigidBody, actuators: Actuators) -> list[Any]:
    """MuJoCo bodies by index of Pinocchio's joints; masses are set after compilation, as MuJoCo refuses some that no solid has."""
    pin = library("pinocchio", "Pinocchio")
    model, neutral = body.model, body.neutral()
    bodies = [spec.worldbody]
    for index in range(1, model.njoints):
        place, inertia, joint = model.jointPlacements[index], model.inertias[index], model.joints[index]
        link = bodies[model.parents[index]].add_body(
            name=_link(model.names[index]), pos=place.translation, quat=_quaternion(pin, place.rotation)
        )
        link.explicitinertial, link.mass, link.inertia = True, 1.0, np.ones(3)
        link.ipos, link.iquat = inertia.lever, _quaternion(pin, _principal(inertia.inertia)[1])
        bodies.append(link)
        if joint.nv == 6:
            link.add_joint(name=model.names[index], type=mujoco.mjtJoint.mjJNT_FREE, armature=float(model.armature[joint.idx_v]))
            continue
        record = joint.createData()
        joint.calc(record, neutral)
        motion = np.array(record.S).ravel()  # of one degree of freedom: linear or angular, constant
        prismatic = np.any(motion[:3])
        shape = {
            "type": mujoco.mjtJoint.mjJNT_SLIDE if prismatic else mujoco.mjtJoint.mjJNT_HINGE,
            "axis": motion[:3] if prismatic else motion[3:],
        }
        k = body.joint_names.index(model.names[index])
        link.add_joint(name=_motor(model.names[index]), armature=actuators.motor_inertia[k], **shape)
        if np.isfinite(actuators.stiffness[k]):
            link.add_joint(name=_spring(model.names[index]), **shape)
    return bodies


def _principal(inertia: Floats) -> tuple[Floats, Floats]:
    """Principal moments (3,) and principal axes (3, 3), right-handed."""
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return moments, axes


def _quaternion(pin: Any, rotation: Floats) -> Floats:
    """Quaternion (w, x, y, z) of a rotation matrix."""
    return pin.Quaternion(np.array(rotation)).coeffs()[[3, 0, 1, 2]]


def _addressed(model: Any, body: RigidBody, actuators: Actuators, contacts: tuple[Contact, ...]) -> MujocoRobot:
    elastic = np.isfinite(actuators.stiffness)
    motors = [model.joint(_motor(name)) for name in body.joint_names]
    springs = [model.joint(_spring(name)) for name, soft in zip(body.joint_names, elastic, strict=True) if soft]
    return MujocoRobot(
        model=model,
        body=body,
        contacts=contacts,
        motor_q=np.array([joint.qposadr[0] for joint in motors]),
        motor_v=np.array([joint.dofadr[0] for joint in motors]),
        elastic=elastic,
        spring_q=np.array([joint.qposadr[0] for joint in springs], dtype=int),
        spring_v=np.array([joint.dofadr[0] for joint in springs], dtype=int),
        stiffness=actuators.stiffness[elastic],
        damping=actuators.damping[elastic],
    )


def _set_values(mujoco: Any, robot: MujocoRobot, actuators: Actuators, friction: Floats, timestep: float, rest: Floats) -> None:
    """Set the compiled model's values exactly, without the compiler's adjustments; then update the constants that MuJoCo derives.

    rest   (n,) positions at which the joints' own springs are unloaded [rad]
    """
    model, body, elastic = robot.model, robot.body, robot.elastic
    for index in range(1, body.model.njoints):
        inertia = body.model.inertias[index]
        link = model.body(_link(body.model.names[index])).id
        model.body_mass[link], model.body_inertia[link] = inertia.mass, _principal(inertia.inertia)[0]
    model.dof_damping[robot.motor_v] = actuators.motor_viscous + np.where(elastic, 0.0, actuators.link_viscous)
    model.dof_frictionloss[robot.motor_v] = friction
    model.dof_solref[robot.motor_v] = 2 * timestep, 1.0  # at rest again within one step
    model.dof_solimp[robot.motor_v, :2] = HARDEST_CONSTRAINT
    model.jnt_stiffness[model.dof_jntid[robot.spring_v]] = robot.stiffness
    model.dof_damping[robot.spring_v] = robot.damping
    for k, name in enumerate(body.joint_names):
        if not elastic[k]:
            model.jnt_stiffness[model.dof_jntid[robot.motor_v[k]]] = body.springs.get(name, 0.0)
            model.qpos_spring[robot.motor_q[k]] = rest[k]
    for name in _link_side(body, actuators):
        tendon, k = model.tendon(name).id, body.joint_names.index(name)
        model.tendon_damping[tendon] = actuators.link_viscous[k]
        model.tendon_stiffness[tendon], model.tendon_lengthspring[tendon] = body.springs.get(name, 0.0), rest[k]
    option = model.opt
    option.solver, option.jacobian = mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtJacobian.mjJAC_DENSE
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0  # feet creep ten times less than they would
    option.tolerance = 1e-10
    # A diverging state must be visible, not reset; one robot is one island.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_ISLAND)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _add_contact(
    mujoco: Any,
    spec: Any,
    bodies: list[Any],
    body: RigidBody,
    q: Floats,
    contact: Contact,
    ground: Ground | None,
    timestep: float,
    gravity: bool,
) -> None:
    """Add one contact: springs if it has a stiffness, otherwise ground or constraints."""
    pin = library("pinocchio", "Pinocchio")
    if contact.frame not in body.frames:
        raise GainroomError(f"{body.source}: no frame {contact.frame!r}{nearest(contact.frame, body.frames, 'frame')}")
    frame = body.model.frames[body.model.getFrameId(contact.frame)]
    rotation, place = body.frame_placement(q, contact.frame)
    foot, world = (
        _BodyFrame(bodies[frame.parentJoint], frame.placement.translation, frame.placement.rotation),
        _BodyFrame(spec.worldbody, place, rotation),
    )
    soft = np.isfinite(contact.springs)
    if soft.all():
        _add_springs(mujoco, pin, spec, foot, world, contact)
    elif soft.any():
        raise GainroomError(f"contact {contact.frame!r}: the simulation takes stiffness in all held directions or in none")
    elif ground is None:
        _add_holds(mujoco, pin, spec, foot, world, contact, timestep)
    else:
        axes = ground_axes(contact, rotation, upwards(body) if gravity else None)
        turned = rotation.T @ axes
        _add_ground(mujoco, pin, spec, foot.turned(turned), world.turned(turned), contact, ground)


@dataclass(frozen=True)
class _BodyFrame:
    """Frame on a MuJoCo body."""

    body: Any
    position: Floats
    rotation: Floats

    def turned(self, rotation: Floats) -> "_BodyFrame":
        """Frame at the same origin with other axes, the columns of `rotation` in its own."""
        return replace(self, rotation=self.rotation @ rotation)

    def site(self, pin: Any, name: str, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.body.add_site(name=name, pos=self.position + self.rotation @ offset, quat=_quaternion(pin, self.rotation))

    def geom(self, pin: Any, name: str, kind: Any, size: Sequence[float], offset: Sequence[float], turned: Floats) -> None:
        self.body.add_geom(
            name=name,
            type=kind,
            size=size,
            pos=self.position + self.rotation @ offset,
            quat=_quaternion(pin, self.rotation @ turned),
            contype=0,
            conaffinity=0,  # touches by explicit pairs only
        )


def _add_holds(mujoco: Any, pin: Any, spec: Any, foot: _BodyFrame, world: _BodyFrame, contact: Contact, timestep: float) -> None:
    """Add equality constraints: a weld; for a line two of its points, for a point itself."""
    offsets = {"flat": [0.0], "line": [-0.05, 0.05], "point": [0.0]}[contact.kind]
    kind = mujoco.mjtEq.mjEQ_WELD if contact.kind == "flat" else mujoco.mjtEq.mjEQ_CONNECT
    for number, offset in enumerate(offsets):
        names = [f"{contact.frame}/{side}{number}" for side in ("foot", "ground")]
        for name, place in zip(names, (foot, world), strict=True):
            place.site(pin, name, (0.0, offset, 0.0))
        spec.add_equality(
            name=f"{contact.frame}/hold{number}",
            type=kind,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=names[0],
            name2=names[1],
            solref=[2 * timestep, 1.0],  # errors die out in two steps, the fastest that MuJoCo allows
            solimp=[HARDEST_CONSTRAINT, HARDEST_CONSTRAINT, 1e-3, 0.5, 2.0],
        )


def _add_springs(mujoco: Any, pin: Any, spec: Any, foot: _BodyFrame, world: _BodyFrame, contact: Contact) -> None:
    """Add a spring and a damper per direction, as actuators that push on the frame by its displacement."""
    names = [f"{contact.frame}/{side}" for side in ("foot", "ground")]
    for name, place in zip(names, (foot, world), strict=True):
        place.site(pin, name)
    for row, stiffness, damping in zip(contact.rows, contact.springs, contact.dampers, strict=True):
        spring = spec.add_actuator(name=f"{contact.frame}/spring{row}", trntype=mujoco.mjtTrn.mjTRN_SITE)
        spring.target, spring.refsite, spring.gear = names[0], names[1], np.eye(6)[row]
        spring.gainprm[0] = 0.0
        spring.biastype, spring.biasprm[1:3] = mujoco.mjtBias.mjBIAS_AFFINE, (-stiffness, -damping)


def _add_ground(mujoco: Any, pin: Any, spec: Any, foot: _BodyFrame, world: _BodyFrame, contact: Contact, ground: Ground) -> None:
    """Add a ground plane under the frame, and the touching shape on the foot: box, cylinder along y, or ball, lowest at the frame.

    foot, world   the contact frame on either side, with the axes of its ground
    """
    sole = ground.soles.get(contact.frame, Sole())
    kinds = mujoco.mjtGeom
    upright, along_y = np.eye(3), np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    kind, size, offset, turned = {
        "flat": (kinds.mjGEOM_BOX, [sole.length / 2, sole.width / 2, HEIGHT / 2], (*sole.center, HEIGHT / 2), upright),
        "line": (kinds.mjGEOM_CAPSULE, [HEIGHT, sole.width / 2, 0.0], (0.0, sole.center[1], HEIGHT), along_y),
        "point": (kinds.mjGEOM_SPHERE, [HEIGHT, 0.0, 0.0], (0.0, 0.0, HEIGHT), upright),
    }[contact.kind]
    names = [f"{contact.frame}/{side}" for side in ("sole", "ground")]
    foot.geom(pin, names[0], kind, size, offset, turned)
    world.geom(pin, names[1], kinds.mjGEOM_PLANE, [0.0, 0.0, 1.0], (0.0, 0.0, 0.0), upright)
    spec.add_pair(
        geomname1=names[0],
        geomname2=names[1],
        condim=3,
        friction=[ground.friction, ground.friction, 0.0, 0.0, 0.0],
        solref=[GROUND_TIME, 1.0],
        solimp=[0.95, 0.99, 1e-3, 0.5, 2.0],
    )
