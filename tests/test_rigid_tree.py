"""The core's tree of links, and what it sees at a tick, against Pinocchio on random robots with joints of every kind."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.robot.body import Base, RigidBody
from gainroom.robot.contact import Contact
from gainroom.robot.rigid_tree import held_frames, rigid_tree, tree_frame, tree_tasks
from gainroom.robot.tasks import Task
from gainroom.simulation.whole_body import PostureEstimate, stance_of, values_of

pin = pytest.importorskip("pinocchio")

KINDS = (
    lambda axis: pin.JointModelRevoluteUnaligned(axis),
    lambda axis: pin.JointModelPrismaticUnaligned(axis),
    lambda _: pin.JointModelRUBX(),
    lambda _: pin.JointModelRY(),
    lambda _: pin.JointModelRUBZ(),
    lambda _: pin.JointModelPX(),
)
STACK = tuple(
    Task(name=kind, kind=kind, frame="tip" if kind in ("position", "orientation") else None, kp=0.0, kd=0.0)
    for kind in ("com", "position", "posture", "orientation")
)
CASES = [(base, seed) for base in ("floating", "fixed") for seed in range(4)]


def robot(base: Base, seed: int) -> tuple[RigidBody, np.ndarray]:
    """With a posture; branched, masses off their joints, 2 frames."""
    draw, model = np.random.default_rng(seed), pin.Model()
    pin.seed(seed)
    if base == "floating":
        model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Random(), "root")
        model.appendBodyToJoint(1, pin.Inertia.Random(), pin.SE3.Random())
    first = model.njoints
    for k in range(9):
        axis = draw.normal(size=3)
        joint = KINDS[k % len(KINDS)](axis / np.linalg.norm(axis))
        chain = [model.njoints - 1]  # Pinocchio wants branches one after the other: on the last link or what carries it
        while chain[-1] >= first:
            chain.append(model.parents[chain[-1]])
        parent = int(draw.choice(chain))
        model.addJoint(parent, joint, pin.SE3.Random(), f"j{k}")
        model.appendBodyToJoint(model.njoints - 1, pin.Inertia.Random(), pin.SE3.Random())
    for name, joint in (("tip", model.njoints - 1), ("foot", first)):
        model.addFrame(pin.Frame(name, joint, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    body = RigidBody("random", model, tuple(f"j{k}" for k in range(9)), base, np.zeros(9))
    return body, pin.integrate(model, pin.neutral(model), draw.normal(size=model.nv))


@pytest.mark.parametrize(("base", "seed"), CASES)
def test_weight_and_values_are_pinocchios(base, seed):
    body, start = robot(base, seed)
    q = pin.integrate(body.model, start, np.random.default_rng(seed).normal(size=body.nv))
    weight = body.gravity_torque(q)
    assert_allclose(rigid_tree(body).weight(q), weight, atol=1e-12 * np.abs(weight).max())
    axes, place = body.frame_placement(q, "tip")
    turned = pin.log3(axes @ body.frame_placement(start, "tip")[0].T)
    expected = np.concatenate([body.com(q), place, body.angles(q), turned])
    assert_allclose(values_of(body, STACK, start)(q), expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4, 1e-2, 1.0, 3.0, np.pi - 1e-7])
def test_rotation_vectors_of_any_size(turn):
    body, q = robot("floating", 5)
    axis = np.random.default_rng(6).normal(size=3)
    axes = body.frame_placement(q, "tip")[0]
    local = body.frame_placement(q, "tip")[0].T @ (turn * axis / np.linalg.norm(axis))
    root = pin.XYZQUATToSE3(q[:7])
    # about the tip's own axes, which are the base's turned
    moved = q.copy()
    moved[:7] = pin.SE3ToXYZQUAT(
        pin.SE3(
            body.model.jointPlacements[1].rotation.T @ pin.exp3(axes @ local) @ body.model.jointPlacements[1].rotation @ root.rotation,
            root.translation,
        )
    )
    # near π a rotation says its axis by products with cos(t/2) = 5e-8: by squares no digit is lost
    assert_allclose(values_of(body, STACK[3:], q)(moved), axes @ local, atol=1e-12)


@pytest.mark.parametrize("kinds", [("flat", "point"), ("line",), ()])
@pytest.mark.parametrize(("base", "seed"), CASES)
def test_a_newton_step_is_written_out(base, seed, kinds):
    """Joints from encoders, the base counted on, held frames brought back: with Pinocchio's integrals and logarithms."""
    body, start = robot(base, seed)
    model, data, draw = body.model, body.model.createData(), np.random.default_rng(seed)
    contacts = [Contact(frame, kind) for frame, kind in zip(("foot", "tip"), kinds, strict=False)]
    estimate = PostureEstimate(body, contacts, start)
    rows = sum(len(contact.rows) for contact in contacts)
    counted, back = 0.3 * draw.normal(size=(body.nv - 9, 9)), 0.1 * draw.normal(size=(body.nv, rows))
    goals = [pin.SE3(*body.frame_placement(start, contact.frame)) for contact in contacts]
    q, before = start, body.angles(start)
    for _ in range(3):
        joints = before + 0.3 * draw.normal(size=9)
        moved = np.concatenate([counted @ (joints - before), np.zeros(9)])
        q, before = pin.integrate(model, q, moved), joints
        for joint, position in zip(body.joints, joints, strict=True):
            both = [np.cos(position), np.sin(position)]
            q[joint.idx_q : joint.idx_q + joint.nq] = both if joint.nq == 2 else position
        pin.framesForwardKinematics(model, data, q)
        away = [np.zeros(0)]
        for contact, goal in zip(contacts, goals, strict=True):
            left = data.oMf[model.getFrameId(contact.frame)].actInv(goal)
            twist = pin.log6(left).vector if contact.kind == "flat" else np.concatenate([left.translation, pin.log3(left.rotation)])
            away.append(twist[list(contact.rows)])
        q = pin.integrate(model, q, back @ np.concatenate(away))
        estimate._running.renew(back, counted)
        assert_allclose(estimate.update(joints), q, atol=1e-12 * np.abs(q).max())


@pytest.mark.parametrize(("base", "seed"), CASES)
def test_mass_matrix_and_jacobians_are_pinocchios(base, seed):
    """Wherever the base is, those of a robot a kilometre away have all their digits."""
    body, q = robot(base, seed)
    contacts = Contact("foot"), Contact("tip", "line")
    near = stance_of(body, q, np.ones(body.size), contacts)
    expected = near.inertia, near.contact_jacobian, np.vstack([task.jacobian(near) for task in STACK])
    first = body.model.njoints - body.size
    for placement, parent in zip(body.model.jointPlacements, body.model.parents.tolist(), strict=True):
        if parent < first - 1 or (base == "fixed" and parent == 0):
            placement.translation += 1000.0
    for found, known in zip(rigid_tree(body).dynamics(q, *held_frames(body, contacts), tree_tasks(body, STACK)), expected, strict=True):
        assert_allclose(found, known, atol=1e-13 * np.abs(known).max())  # round-off of sums over ten links


def test_a_frame_of_the_world_is_none_of_a_floating_robot():
    for base in ("floating", "fixed"):
        body, _ = robot(base, 0)
        model = body.model.copy()
        model.addFrame(pin.Frame("ground", 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        grounded = RigidBody("random", model, body.joint_names, base, np.zeros(body.size))
        if base == "fixed":
            assert tree_frame(grounded, "ground")[0] == 0
            continue
        with pytest.raises(GainroomError, match="'ground' is fixed to the world"):
            tree_frame(grounded, "ground")
