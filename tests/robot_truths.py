"""Independent truths about robots on the ground: equations of motion solved whole, without projectors; and small robots to try them on."""

from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from gainroom.robot import load_model
from gainroom.robot.actuators import Actuators
from gainroom.robot.body import RigidBody
from gainroom.robot.contact import Contact, contact_jacobian
from gainroom.simulation.robot_setup import RobotSetup
from gainroom.system.assembly import Feedback
from gainroom.system.drive import Drive
from gainroom.system.elastic_joint import ElasticJoint
from gainroom.system.system import Control

SIDES = ("left", "right")
JOINTS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
MIRROR = np.kron([[0, 1], [1, 0]], np.diag([-1, -1, 1, 1, 1, -1]))  # legs exchanged; yaw and roll turn the other way
STAND = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3}
GRAVITY = 9.81


def biped():
    with as_file(files("gainroom") / "robot" / "models" / "biped.urdf") as path:
        return load_model(path, base="floating")


def biped_posture(body, angles=STAND):
    return body.configuration({f"{side}_{joint}": angle for side in SIDES for joint, angle in angles.items()})


def any_posture(body, seed: int):
    """Legs in general position, well away from straight."""
    draw = np.random.default_rng(seed)
    angles = {}
    for side in SIDES:
        for joint in JOINTS:
            angles[f"{side}_{joint}"] = STAND.get(joint, 0.0) + draw.uniform(-0.25, 0.25)
    return body.configuration(angles)


def actuators(size: int, motor_inertia=1.0, stiffness=1e4, damping=1.0) -> Actuators:
    return Actuators(*(np.full(size, float(value)) for value in (motor_inertia, stiffness, damping, 0.0, 0.0)))


def feet(*names: str, kind: Any = "flat") -> list[Contact]:
    return [Contact(name, kind) for name in names]


BOTH = feet("left_sole", "right_sole")


def accelerations(inertia, held, torque):
    """v̇ of A v̇ + J_cᵀ f = Sᵀ τ, J_c v̇ = 0 for τ (n, k), solved whole; redundant rows leave f undetermined, never v̇."""
    total, count = len(inertia), len(held)
    force = np.vstack([np.zeros((total - len(torque), torque.shape[1])), torque, np.zeros((count, torque.shape[1]))])
    whole = np.block([[inertia, held.T], [held, np.zeros((count, count))]])
    return np.linalg.lstsq(whole, force, rcond=1e-12)[0][:total]


def motor_response(model, s: complex):
    """Motor torques → motor positions with links, gearboxes, springs under the feet and rigid contacts in one system of equations."""
    total, size = len(model.inertia), model.size
    soft = ~model.rigid
    springs = np.concatenate([contact.springs for contact in model.contacts])[soft]
    dampers = np.concatenate([contact.dampers for contact in model.contacts])[soft]
    ground, held = model.contact_jacobian[soft], model.contact_jacobian[~soft]
    gearbox = np.diag(model.stiffness + s * model.damping)
    selection = model.selection
    links = model.inertia * s**2 + ground.T @ np.diag(springs + s * dampers) @ ground + selection.T @ gearbox @ selection
    motors = s**2 * np.diag(model.motor_inertia) + gearbox
    nothing = np.zeros((len(held), size))
    whole = np.block(
        [
            [links, -selection.T @ gearbox, held.T],
            [-gearbox @ selection, motors, nothing.T],
            [held, nothing, np.zeros((len(held), len(held)))],
        ]
    )
    torque = np.vstack([np.zeros((total, size)), np.eye(size), nothing])
    return np.linalg.lstsq(whole, torque, rcond=1e-13)[0][total : total + size]


def move_on_contacts(body, q, start, contacts: Sequence[Contact], step):
    """The posture near q + step with every contact frame back where `start` has it: Gauss–Newton on the placements, smallest motion."""
    import pinocchio as pin

    def placed(posture, frame):
        return pin.SE3(*body.frame_placement(posture, frame))

    goals = [placed(start, contact.frame) for contact in contacts]
    q = body.integrate(q, step)
    for _ in range(20):
        errors = [pin.log6(placed(q, contact.frame).actInv(goal)).vector for contact, goal in zip(contacts, goals, strict=True)]
        q = body.integrate(q, np.linalg.pinv(contact_jacobian(body, q, contacts), rcond=1e-9) @ np.concatenate(errors))
    return q


def write_robot(folder: Path, links: str, joints: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="small">{links}{joints}</robot>', "utf-8")
    return path


def link(name: str, mass: float = 0.0, com=(0.0, 0.0, 0.0), inertia=(0.0, 0.0, 0.0)) -> str:
    if not mass:
        return f'<link name="{name}"/>'
    ixx, iyy, izz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{com[0]} {com[1]} {com[2]}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial></link>'
    )


def hinge(name: str, parent: str, child: str, at=(0.0, 0.0, 0.0), axis="0 1 0", kind="revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at[0]} {at[1]} {at[2]}"/>'
        f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )


def joint_setup(
    joint: ElasticJoint, drive: Drive, controller: Any, feedback: Feedback = "motor", sample_time: float = 5e-4, **options: Any
) -> RobotSetup:
    """One joint with its load on a fixed base, as a robot; `options` are RobotSetup's own, the rest as for build_loop."""
    import pinocchio as pin

    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    index = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), joint.name)
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.diag([1.0, 1.0, 1.0]) * joint.link_inertia), pin.SE3.Identity())
    values = (joint.motor_inertia, joint.stiffness, joint.damping, joint.motor_viscous, joint.link_viscous)
    return RobotSetup(
        body=RigidBody(f"joint '{joint.name}'", model, (joint.name,), "fixed", np.zeros(1)),
        actuators=Actuators(*(np.array([value]) for value in values)),
        drives=(drive,),
        control=Control("joint", controller, feedback, sample_time),
        q=np.zeros(1),
        **options,
    )
