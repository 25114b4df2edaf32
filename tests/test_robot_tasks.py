"""Tasks: what the joint torques do to the robot's own equations of motion, and eqs. (5) to (10) of Jung et al. 2017."""

import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.files.robot_yaml import parse_robot
from gainroom.robot import load_model
from gainroom.robot.contact import contact_jacobian
from gainroom.robot.linearize import linearize
from gainroom.robot.tasks import Task, tasks_of
from refusals import assert_refused
from robot_truths import (
    BOTH,
    MIRROR,
    accelerations,
    actuators,
    any_posture,
    biped_posture,
    feet,
    hinge,
    link,
    write_robot,
)

# Accelerations of order 1 through matrices of condition up to about 1e5: a hundredfold over their round-off.
SOLVED = 1e-9
COM = Task(name="com", kind="com", kp=[50, 90, 200], kd=[1, 5, 15])
PELVIS = Task(name="pelvis", kind="orientation", frame="pelvis", kp=100, kd=20)
SWING = Task(name="swing", kind="position", frame="right_sole", kp=200, kd=30)
TURN = Task(name="turn", kind="orientation", frame="right_sole", kp=50, kd=10)
POSTURE = Task(name="posture", kind="posture", kp=10, kd=1)


def standing(body, contacts, seed=0):
    return linearize(body, actuators(12), any_posture(body, seed), contacts)


def task_accelerations(model, tasks, body, rotors=False):
    """What each direction of the tasks does under a unit acceleration asked of each, and how the contacts move."""
    inertia = model.inertia + rotors * model.selection.T @ np.diag(model.motor_inertia) @ model.selection
    moved = accelerations(inertia, contact_jacobian(body, model.q, model.contacts), tasks.torque)
    rows = []
    for task in tasks.tasks:
        if task.kind == "posture":
            rows.append(model.selection)
        elif task.kind == "com":
            rows.append(body.com_jacobian(model.q))
        else:
            jacobian = body.frame_jacobian(model.q, task.frame)
            axes = body.frame_placement(model.q, task.frame)[0]
            rows.append(axes @ jacobian[slice(0, 3) if task.kind == "position" else slice(3, 6)])
    return np.vstack(rows) @ moved, model.contact_jacobian @ moved


def arm(folder, l1=0.5, l2=0.4):
    """Two links that turn about y; x = −l1 sin a − l2 sin(a + b), z = −l1 cos a − l2 cos(a + b)."""
    links = link("base") + link("upper", 3.0, (0, 0, -0.3), (1, 0.04, 1)) + link("lower", 2.0, (0, 0, -0.2), (1, 0.02, 1)) + link("hand")
    joints = hinge("shoulder", "base", "upper") + hinge("elbow", "upper", "lower", (0, 0, -l1))
    return load_model(write_robot(folder, links, joints + hinge("tip", "lower", "hand", (0, 0, -l2), kind="fixed")))


def test_on_a_fixed_base_the_paper_s_formulas(tmp_path):
    a, b, l1, l2 = 0.4, 0.9, 0.5, 0.4
    body = arm(tmp_path, l1, l2)
    model = linearize(body, actuators(2), body.configuration({"shoulder": a, "elbow": b}))
    tasks = tasks_of(model, [Task(name="hand", kind="position", frame="hand", kp=[100, 1, 400], kd=[20, 1, 40])])
    jacobian = np.array(
        [[-l1 * math.cos(a) - l2 * math.cos(a + b), -l2 * math.cos(a + b)], [l1 * math.sin(a) + l2 * math.sin(a + b), l2 * math.sin(a + b)]]
    )
    assert_allclose(tasks.jacobian[[0, 2]], jacobian, atol=1e-12)  # E = Jᵀ, to a few roundings
    inertia = body.mass_matrix(model.q)
    task_inertia = np.linalg.inv(jacobian @ np.linalg.inv(inertia) @ jacobian.T)
    position, velocity = tasks.joint_gains()
    assert_allclose(position, jacobian.T @ task_inertia @ np.diag([100, 400]) @ jacobian, rtol=1e-9)  # eq. (10)
    assert_allclose(velocity, jacobian.T @ task_inertia @ np.diag([20, 40]) @ jacobian, rtol=1e-9)
    # A joint posture in the inertia's own metric: eq. (6).
    posture = tasks_of(model, [Task(name="posture", kind="posture", kp=7, kd=2)], rotors=True).joint_gains()
    assert_allclose(posture[0], (inertia + np.eye(2)) * 7, rtol=1e-9)
    assert_allclose(posture[1], (inertia + np.eye(2)) * 2, rtol=1e-9)


def test_what_a_planar_arm_cannot_move_is_said_and_left_alone(tmp_path):
    body = arm(tmp_path)
    straight = linearize(body, actuators(2), body.configuration({"shoulder": 0.4}))
    tasks = tasks_of(straight, [Task(name="hand", kind="position", frame="hand", kp=100, kd=20)])
    assert len(tasks.warnings) == 1
    assert "'hand'" in tasks.warnings[0]
    assert "1 of its 3" in tasks.warnings[0]
    # Along the arm and out of its plane no torque helps and none is asked for.
    along, across = np.array([-math.sin(0.4), 0, -math.cos(0.4)]), np.array([-math.cos(0.4), 0, math.sin(0.4)])
    for still in (along, np.array([0, 1, 0])):
        assert_allclose(tasks.torque @ still, 0, atol=1e-9)
    moved = task_accelerations(straight, tasks, body)[0]
    assert_allclose(moved @ across, across, atol=SOLVED)


@pytest.mark.parametrize("rotors", [False, True])
@pytest.mark.parametrize(
    ("contacts", "stack"), [(BOTH, [COM, PELVIS]), (feet("left_sole"), [COM, PELVIS, SWING, TURN])], ids=["double", "left"]
)
def test_tasks_that_agree_get_what_they_ask_for(body, contacts, stack, rotors):
    """Each direction accelerates as asked, no other does, and the feet stay."""
    model = standing(body, contacts)
    tasks = tasks_of(model, stack, rotors)
    moved, feet_moved = task_accelerations(model, tasks, body, rotors)
    assert_allclose(moved, np.eye(3 * len(stack)), atol=SOLVED)
    assert_allclose(feet_moved, 0, atol=SOLVED)
    assert not tasks.warnings
    # Then the order does not matter, and eqs. (9), (10) hold for the stack as one task.
    inertia = model.inertia + rotors * model.selection.T @ model.selection
    held = contact_jacobian(body, model.q, contacts)
    inverse = np.linalg.inv(inertia)
    projected = inverse - inverse @ held.T @ np.linalg.pinv(held @ inverse @ held.T, rcond=1e-10) @ held @ inverse
    reached = projected[:, 6:] @ np.linalg.pinv(projected[6:, 6:], rcond=1e-10)
    jacobians = {
        "com": body.com_jacobian(model.q),
        "pelvis": body.frame_jacobian(model.q, "pelvis")[3:],
        "swing": body.frame_placement(model.q, "right_sole")[0] @ body.frame_jacobian(model.q, "right_sole")[:3],
        "turn": body.frame_placement(model.q, "right_sole")[0] @ body.frame_jacobian(model.q, "right_sole")[3:],
    }
    jacobian = np.vstack([jacobians[task.name] for task in stack])
    effect = (jacobian @ reached).T
    expected = effect @ np.linalg.inv(jacobian @ projected @ jacobian.T) @ np.diag(tasks.kp) @ effect.T
    assert_allclose(tasks.joint_gains()[0], expected, atol=1e-7 * np.abs(expected).max())  # W' has condition 1e5, met twice


@pytest.mark.parametrize(
    "contacts", [BOTH, feet("left_sole"), feet("left_sole", kind="line"), []], ids=["double", "left", "line", "flight"]
)
def test_tasks_below_are_not_felt_above(body, contacts):
    """Six directions too many: those above win, those below get what is left."""
    stack = [PELVIS, COM, Task(name="shank", kind="position", frame="left_shank", kp=1, kd=1), POSTURE]
    model = standing(body, contacts, seed=1)
    tasks = tasks_of(model, stack)
    moved, feet_moved = task_accelerations(model, tasks, body)
    assert_allclose(feet_moved, 0, atol=SOLVED)
    sizes = [3, 3, 3, 12]
    ends = np.cumsum(sizes)
    for end in ends[:-1]:
        assert_allclose(moved[:end, end:], 0, atol=SOLVED * max(1, np.abs(tasks.torque).max() / 100))
    if contacts:
        assert_allclose(moved[:3, :3], np.eye(3), atol=SOLVED)
    if contacts == BOTH:  # pelvis and centre of mass take all six motions
        assert len(tasks.warnings) == 2
        assert "'shank'" in tasks.warnings[0]
        assert "0 of its 3" in tasks.warnings[0]


def test_the_posture_fills_what_the_tasks_leave(body):
    model = standing(body, feet("left_sole"))
    tasks = tasks_of(model, [COM, POSTURE])
    assert not tasks.warnings
    position = tasks.joint_gains()[0]
    assert np.linalg.matrix_rank(position) == 12
    alone = tasks_of(model, [COM]).joint_gains()[0]
    assert np.linalg.matrix_rank(alone, tol=1e-9 * np.abs(alone).max()) == 3


@pytest.mark.parametrize("contacts", [BOTH, feet("left_sole"), []], ids=["double", "left", "flight"])
@pytest.mark.parametrize("stack", [[COM], [COM, PELVIS], [PELVIS, POSTURE], [PELVIS, SWING, COM], [replace(COM, kp=[50, 90, 0])]])
def test_motions_that_no_task_holds(body, contacts, stack):
    """Of the rigid robot's q̈ = −W Kpq q: as many eigenvalues are 0 as contacts hold and tasks leave; the others are of the gains' size."""
    model = standing(body, contacts)
    tasks = tasks_of(model, stack)
    held = 12 - np.linalg.matrix_rank(model.link_inverse_inertia, tol=1e-9, hermitian=True)
    rates = np.abs(np.linalg.eigvals(model.link_inverse_inertia @ tasks.joint_gains()[0]))
    # Gains of 10 and more: 1e-4 is far below them, and far above the round-off of a defective eigenvalue 0 (the root of 1e-12)
    assert tasks.free == np.count_nonzero(rates < 1e-4) - held
    assert tasks.motions == 12 - held


@pytest.mark.parametrize("contacts", [BOTH, feet("left_sole")], ids=["double", "left"])
@pytest.mark.parametrize("rotors", [False, True])
def test_one_task_with_equal_gains_is_a_spring(body, contacts, rotors):
    position, velocity = tasks_of(standing(body, contacts), [COM], rotors).joint_gains(100, 20)
    scale = np.abs(position).max()
    assert_allclose(position, position.T, atol=1e-10 * scale)  # condition of W', 1e5
    assert np.linalg.eigvalsh((position + position.T) / 2)[0] > -1e-10 * scale
    assert_allclose(position, 5 * velocity, rtol=1e-12, atol=1e-12 * scale)


def test_left_and_right_are_mirror_images(body):
    drawn = {"hip_yaw": 0.1, "hip_roll": 0.15, "hip_pitch": -0.5, "knee": 0.8, "ankle_pitch": -0.2, "ankle_roll": -0.05}
    turned = {"hip_yaw": -1, "hip_roll": -1, "ankle_roll": -1}
    angles = {f"left_{joint}": angle for joint, angle in drawn.items()}
    angles |= {f"right_{joint}": turned.get(joint, 1) * angle for joint, angle in drawn.items()}
    q = body.configuration(angles)
    double, left, right = (linearize(body, actuators(12), q, held) for held in (BOTH, feet("left_sole"), feet("right_sole")))
    for one, other in ((double, double), (left, right)):
        scale = np.abs(one.link_inverse_inertia).max()
        assert_allclose(MIRROR @ one.link_inverse_inertia @ MIRROR.T, other.link_inverse_inertia, atol=SOLVED * scale)
        for gains, mirrored in zip(tasks_of(one, [COM, PELVIS]).joint_gains(), tasks_of(other, [COM, PELVIS]).joint_gains(), strict=True):
            assert_allclose(MIRROR @ gains @ MIRROR.T, mirrored, atol=1e-8 * np.abs(gains).max())


def test_exact_model_on_a_rigid_robot_leaves_one_scalar_loop(body):
    """With rotors in the controller's model, rigid gearboxes and every motion in a task, each direction is 1/s² with its own PD."""
    model = linearize(body, actuators(12, stiffness=np.inf, damping=0.0), biped_posture(body), BOTH)
    tasks = tasks_of(model, [COM, PELVIS], rotors=True)
    drive = gr.Drive(4000.0, 0.9, 2e-3)
    unit = gr.ElasticJoint(motor_inertia=0.0, link_inertia=1.0)
    scalar = gr.gain_limit(gr.build_loop(unit, drive, gr.PD(100.0, 20.0)))
    s = np.array([5j, 200j, 30 + 700j])
    controlled = tasks.jacobian @ model.response(s, "motor") @ tasks.torque
    assert_allclose(controlled * s[:, None, None] ** 2, np.broadcast_to(np.eye(6), (3, 6, 6)), atol=SOLVED)
    # The nearest of six equal loci; joint gains lose some digits on the way.
    whole = gr.gain_limit(gr.build_loop(model, drive, gr.PD(*tasks.joint_gains(100, 20))))
    assert whole.gain == pytest.approx(scalar.gain, rel=1e-6)
    assert whole.frequency == pytest.approx(scalar.frequency, rel=1e-4)


def test_the_centre_of_mass_cannot_be_moved_in_flight(body):
    tasks = tasks_of(standing(body, []), [COM])
    assert "0 of its 3" in tasks.warnings[0]
    assert not np.any(tasks.joint_gains()[0])


@pytest.mark.parametrize("wrist", [0.0, 0.8])
def test_a_singular_posture_is_said_to_be_one(wrist):
    """A UR5 with axes 4 and 6 parallel (wrist_2 = 0) cannot turn about one direction while its tip stays; six joints would do."""
    body = load_model({"package": "example-robot-data", "file": "ur5_robot.urdf"})
    q = body.configuration({"shoulder_lift_joint": -1.0, "elbow_joint": 1.57, "wrist_2_joint": wrist})
    stack = [Task(name=name, kind=name, frame="tool0", kp=100, kd=20) for name in ("position", "orientation")]
    tasks = tasks_of(linearize(body, actuators(6), q), stack)
    assert tasks.free == (1 if wrist == 0 else 0)
    assert [text.partition("; its")[0].partition(" in this")[0] for text in tasks.warnings] == (
        ["task 'orientation': the joints can move 2 of its 3 directions"] if wrist == 0 else []
    )
    assert all("beside the tasks above it" in text and "singular: try another" in text for text in tasks.warnings)


def test_one_joint_is_a_robot_too(tmp_path):
    """A pendulum of a point mass: moved across its arm, and held still by a contact."""
    body = load_model(write_robot(tmp_path, link("base") + link("arm", 2.0, (0, 0, -0.5)), hinge("hinge", "base", "arm")))
    free = linearize(body, actuators(1), body.neutral())
    tasks = tasks_of(free, [Task(name="com", kind="com", kp=100, kd=20)])
    assert_allclose(tasks.joint_gains()[0], [[100 * 2.0 * 0.5**2]], rtol=1e-12)
    assert "1 of its 3" in tasks.warnings[0]
    held = linearize(body, actuators(1), body.neutral(), feet("arm"), gravity=True)
    assert_allclose(held.link_inverse_inertia, [[0.0]], atol=0)
    assert "0 of its 3" in tasks_of(held, [COM]).warnings[0]


def test_directions_add_up_and_scale_one_by_one(body):
    tasks = tasks_of(standing(body, BOTH), [COM, PELVIS])
    assert tasks.directions == ("com x", "com y", "com z", "pelvis x", "pelvis y", "pelvis z")
    assert tasks_of(standing(body, BOTH), [POSTURE]).directions[3] == "posture left_knee"
    shares = [tasks.direction_gains(direction) for direction in tasks.directions]
    for k, whole in enumerate(tasks.joint_gains()):
        assert_allclose(sum(share[k] for share in shares), whole, atol=1e-12 * np.abs(whole).max())
        assert np.linalg.matrix_rank(shares[2][k], tol=1e-9 * np.abs(shares[2][k]).max()) == 1
    raised = tasks.scaled("com z", 3.0).joint_gains()[0]
    assert_allclose(raised, tasks.joint_gains()[0] + 2 * shares[2][0], atol=1e-9 * np.abs(raised).max())
    assert_allclose(tasks.direction_gains("com x", kp=7)[0], tasks.joint_gains(kp=[7, 0, 0, 0, 0, 0])[0], atol=1e-9)


def test_cascades_act_per_direction(body):
    """D(s) = X diag((kd + ki/s)(kp + s)) Eᵀ for P/PI directions, X diag(kp + s kd) Eᵀ for PD ones, redundant posture included."""
    cascade = Task(name="com", kind="com", kp=[40, 20, 100], kd=[1, 5, 5], ki=[1, 0.1, 1.0])
    tasks = tasks_of(standing(body, feet("left_sole")), [cascade, PELVIS, POSTURE])
    s = np.array([3j, 1 + 40j])
    control = tasks.controller()
    assert isinstance(control, gr.PPI)
    found = control.matrix(s, s, 12, None)
    for point, matrix in zip(s, found, strict=True):
        kp, kd, ki = (np.array(gain) for gain in (cascade.kp, cascade.kd, cascade.ki))
        wanted = np.concatenate([(kd + ki / point) * (kp + point), np.full(3, 100 + 20 * point), np.full(12, 10 + 1 * point)])
        expected = tasks.torque @ np.diag(wanted) @ tasks.jacobian
        assert_allclose(matrix, expected, atol=1e-12 * np.abs(expected).max())
    half = control.scaled(0.5).matrix(s, s, 12, None)
    assert_allclose(half, found / 2, rtol=1e-12, atol=1e-12 * np.abs(found).max())
    loop = gr.build_loop(standing(body, feet("left_sole")), gr.Drive(4000.0, 0.9, 2e-3), control)
    assert loop.response(100.0).shape == (1, 12, 12)
    plain = tasks_of(standing(body, BOTH), [COM, PELVIS])
    assert isinstance(plain.controller(), gr.PD)
    assert_refused(lambda: tasks.joint_gains(), ["P/PI"])


def test_bad_tasks_are_refused(body):
    model = standing(body, BOTH)
    assert_refused(lambda: tasks_of(model, []), ["at least one"])
    assert_refused(lambda: tasks_of(model, [COM, COM]), ["'com'", "2 times"])
    assert_refused(lambda: tasks_of(model, [Task(name="p", kind="position", frame="pelvi", kp=1, kd=1)]), ["'pelvi'", "'pelvis'"])
    assert_refused(lambda: Task(name="p", kind="position", kp=1, kd=1), ["'p'", "needs a frame"])
    assert_refused(lambda: Task(name="com", kind="com", frame="pelvis", kp=1, kd=1), ["'com'", "'pelvis'"])
    assert_refused(lambda: Task(name="t", kind="torque", kp=1, kd=1), ["'t'", "'torque'", "com, position"])  # type: ignore[arg-type]
    assert_refused(lambda: Task(name="com", kind="com", kp=math.nan, kd=1), ["'com'", "kp", "finite"])
    assert_refused(lambda: tasks_of(model, [Task(name="com", kind="com", kp=[1, 2], kd=1)]), ["'com'", "kp", "(2,)", "3 numbers"])
    tasks = tasks_of(model, [COM])
    assert_refused(lambda: tasks.joint_gains([1, 2, 3, 4], 1), ["kp", "3 numbers"])
    assert_refused(lambda: tasks.direction_gains("com w"), ["'com w'", "com x"])
    stiff = [Task(name="com", kind="com", kp=1, kd=1, ki=1), Task(name="pelvis", kind="orientation", frame="pelvis", kp=1, kd=0)]
    assert_refused(lambda: tasks_of(model, stiff).controller(), ["'pelvis x'", "kd"])


@pytest.mark.parametrize("gains", ["kp: 100, kd: 20", "kp: 6, kv: 2, ki: 1"], ids=["pd", "ppi"])
def test_a_task_that_nothing_moves_has_no_gain(gains: str):
    """The right foot, which stands on the ground: no joint can move it."""
    text = (files("gainroom") / "files" / "examples" / "biped.yaml").read_text("utf-8").partition("control:")[0]
    text += f"control: {{type: {'ppi' if 'kv' in gains else 'pd'}, space: task, feedback: motor}}\n"
    text += f"tasks: [{{name: foot, type: position, frame: right_foot, {gains}}}]\n"
    system = parse_robot(text, "f", Path())
    loop = system.loop(system.source.linearize("stand", "double"))
    assert not gr.is_stable(loop)  # without gains nothing holds the robot
    for number in (gr.gain_limit, gr.joint_margins):
        with pytest.raises(gr.GainroomError, match="all gains are zero"):
            number(loop)
