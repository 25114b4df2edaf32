"""The whole-body controller against the linear operational space it must be to first order, and against statics solved whole."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.robot.contact import Contact, contact_jacobian
from gainroom.robot.linearize import linearize
from gainroom.robot.tasks import Task, tasks_of
from gainroom.simulation.whole_body import PostureEstimate, WholeBodyControl, stance_of, values_of
from gainroom.system.controller import PD
from gainroom.system.system import Control
from robot_truths import BOTH, actuators, any_posture, biped, biped_posture, feet, move_on_contacts

TICK = 5e-4
STACK = (
    Task(name="com", kind="com", kp=[50, 90, 200], kd=[1, 5, 15]),
    Task(name="pelvis", kind="orientation", frame="pelvis", kp=100, kd=20),
    Task(name="rest", kind="posture", kp=30, kd=5),
)
TASK_SPACE = Control("task", None, "motor", TICK)
CONTACTS = {"double": BOTH, "left": feet("left_sole"), "flight": [], "line": [Contact("left_sole", "line"), Contact("right_sole")]}
TINY = 1e-6


@pytest.fixture(scope="module")
def body():
    return biped()


def control_of(body, q, held, control=TASK_SPACE, stack=STACK, **options):
    return WholeBodyControl(body, np.ones(12), held, q, control, stack, **options)


@pytest.mark.parametrize("held", ["double", "left", "line"])
def test_posture_is_found_from_joints_and_contacts(body, held):
    """Joints of a posture that stands on its contacts, far from where the estimate starts: base and all are found."""
    start = any_posture(body, 1)
    step = np.random.default_rng(2).uniform(-0.1, 0.1, body.nv)
    there = move_on_contacts(body, start, start, CONTACTS[held] if held == "left" else BOTH, step)  # a foot held flat is held on a line
    estimate = PostureEstimate(body, CONTACTS[held], start)
    for _ in range(8):
        stance = stance_of(body, estimate.q, np.ones(12), CONTACTS[held])
        follow = tasks_of(stance, STACK).follow
        estimate.renew(stance.contact_jacobian, follow)
        estimate.update(body.angles(there))
    assert_allclose(estimate.q, there, atol=1e-12)  # Newton's fixed point


@pytest.mark.parametrize("held", CONTACTS)
def test_small_motor_deviations_are_seen_as_the_linear_theory_sees_them(body, held):
    """θ off by any small amount, also one that contradicts the closed feet: the tasks' values change by Eᵀ δθ."""
    q = any_posture(body, 3)
    model = linearize(body, actuators(12), q, CONTACTS[held])
    tasks = tasks_of(model, STACK)
    deviation = TINY * np.random.default_rng(4).standard_normal(12)
    estimate = PostureEstimate(body, CONTACTS[held], q)
    estimate.renew(model.contact_jacobian, tasks.follow)
    values = values_of(body, STACK, q)
    before = values(q)
    found = values(estimate.update(body.angles(q) + deviation)) - before
    assert_allclose(found, tasks.jacobian @ deviation, atol=1e-9 * TINY / 1e-6)  # second order: 1e-12, times curvature


@pytest.mark.parametrize("rotors", [False, True])
@pytest.mark.parametrize("held", ["double", "left"])
def test_torques_are_eqs_9_and_10(body, held, rotors):
    """A step of δθ: −Kpq δθ − Kvq δθ/T_s at that tick, −Kpq δθ at the next."""
    q = any_posture(body, 5)
    model = linearize(body, actuators(12), q, CONTACTS[held])
    stiffness, damping = tasks_of(model, STACK, rotors).joint_gains()
    running = control_of(body, q, CONTACTS[held], replace(TASK_SPACE, rotors=rotors), gravity=False)
    deviation = TINY * np.random.default_rng(6).standard_normal(12)
    rest = body.angles(q)
    offset = np.zeros(len(running.channels))
    assert_allclose(running.tick(rest, offset)[0], 0, atol=1e-9)
    at_once = running.tick(rest + deviation, offset)[0]
    later = running.tick(rest + deviation, offset)[0]
    scale = np.abs(damping @ deviation).max() / TICK
    # Values are right to second order, about 10 δθ² = 1e-5 of their change.
    assert_allclose(at_once, -stiffness @ deviation - damping @ deviation / TICK, atol=2e-5 * scale)
    assert_allclose(later, -stiffness @ deviation, atol=2e-5 * scale)


@pytest.mark.parametrize("held", ["double", "left", "line"])
def test_the_weight_is_held(body, held):
    """With its torques and some contact forces, nothing accelerates; among all such torques they are the smallest."""
    q = any_posture(body, 7)
    running = control_of(body, q, CONTACTS[held])
    torque = running.holding_torque
    weight = body.gravity_torque(q)
    jacobian = contact_jacobian(body, q, CONTACTS[held])
    load = weight - np.concatenate([np.zeros(6), torque])
    forces = np.linalg.lstsq(jacobian.T, load, rcond=1e-12)[0]
    assert_allclose(jacobian.T @ forces, load, atol=1e-8 * np.abs(weight).max())
    # any torque that holds differs by one that contact forces balance: the smallest is at right angles to those
    balanced = np.linalg.svd(jacobian[:, :6].T)[2][6:] @ jacobian[:, 6:]
    assert len(balanced) == len(jacobian) - 6
    assert_allclose(balanced @ torque, 0, atol=1e-8 * np.abs(torque).max())


def test_joint_space_is_joint_pd_and_weight(body):
    q = biped_posture(body)
    gains = PD(np.full(12, 2000.0), np.full(12, 100.0))
    control = Control("joint", gains, "motor", TICK)
    running = control_of(body, q, BOTH, control, stack=())
    rest, offset = body.angles(q), np.linspace(0, 0.01, 12)
    start = running.tick(rest, 0 * offset)[0]
    assert_allclose(start, running.holding_torque, rtol=1e-12)
    torque, desired, measured = running.tick(rest, offset)
    assert_allclose(torque - running.holding_torque, 2000.0 * offset + 100.0 * offset / TICK, rtol=1e-9)
    assert_allclose((desired, measured), (rest + offset, rest), atol=1e-15)
    assert running.channels == body.joint_names


def test_everything_is_renewed_with_the_posture(body):
    """Far from the start, with refresh 1, torques are those of a controller that starts there."""
    q = biped_posture(body)
    there = move_on_contacts(body, q, q, BOTH, np.r_[np.zeros(8), -0.15, 0.3, -0.15, 0, 0, 0, -0.15, 0.3, -0.15, 0])
    moved, fresh = control_of(body, q, BOTH, refresh=1), control_of(body, there, BOTH)
    nothing = np.zeros(len(moved.channels))
    for share in np.linspace(0, 1, 40):
        moved.tick(body.angles(q) + share * (body.angles(there) - body.angles(q)), nothing)
    for _ in range(3):
        moved.tick(body.angles(there), nothing)
    fresh.tick(body.angles(there), nothing)
    assert_allclose(moved.holding_torque, fresh.holding_torque, atol=1e-7)
    push = np.zeros(len(nothing))
    push[2] = 1e-3
    change = [control.tick(body.angles(there), push)[0] - control.tick(body.angles(there), nothing)[0] for control in (moved, fresh)]
    assert_allclose(change[0], change[1], atol=1e-6 * np.abs(change[1]).max())


def test_orientation_counts_from_the_start_in_world_axes(body):
    q = body.integrate(biped_posture(body), np.r_[0, 0, 0, 0.3, -0.2, 0.4, np.zeros(12)])
    values = values_of(body, STACK[1:2], q)
    assert_allclose(values(q), 0, atol=1e-15)
    turn = 1e-3 * np.array([1.0, 2.0, -1.5])
    axes = body.frame_placement(q, "pelvis")[0]
    turned = body.integrate(q, np.r_[0, 0, 0, axes.T @ turn, np.zeros(12)])
    assert_allclose(values(turned), turn, atol=1e-12)


def test_refusals(body):
    with pytest.raises(GainroomError, match="give sample_rate_hz"):
        control_of(body, biped_posture(body), BOTH, replace(TASK_SPACE, sample_time=None))
    with pytest.raises(GainroomError, match="refresh 0 must be a whole number >= 1"):
        control_of(body, biped_posture(body), BOTH, refresh=0)
