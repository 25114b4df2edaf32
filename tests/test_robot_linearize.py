"""The plant of a robot in a posture on its contacts, against equations of motion solved whole and against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.robot import load_model
from gainroom.robot.contact import Contact, contact_jacobian, free_motion
from gainroom.robot.linearize import gravity_stiffness, linearize
from refusals import assert_refused
from robot_truths import (
    BOTH,
    GRAVITY,
    accelerations,
    actuators,
    any_posture,
    biped_posture,
    feet,
    hinge,
    link,
    motor_response,
    move_on_contacts,
    write_robot,
)

# Solves with matrices of condition up to about 1e5 lose that much of 1e-16; a hundredfold is left over.
SOLVED = 1e-9
CONTACTS = {
    "double": BOTH,
    "left": feet("left_sole"),
    "toes": feet("left_sole", "right_sole", kind="point"),
    "edges": feet("left_sole", "right_sole", kind="line"),
    "twice held": feet("left_sole", "left_foot", "right_sole"),
    "pelvis held": feet("pelvis", "left_sole"),
    "flight": [],
}


def two_links(folder, m1=3.0, m2=2.0, l1=0.5, c1=0.3, c2=0.25, i1=0.04, i2=0.02, base="fixed"):
    """A planar arm about y, hanging along −z at zero, its links' centres at c1 and c2."""
    links = link("base") if base == "fixed" else link("base", 5.0, inertia=(1, 1, 1))
    links += link("upper", m1, (0, 0, -c1), (1, i1, 1)) + link("lower", m2, (0, 0, -c2), (1, i2, 1)) + link("hand")
    joints = hinge("shoulder", "base", "upper") + hinge("elbow", "upper", "lower", (0, 0, -l1))
    joints += hinge("tip", "lower", "hand", (0, 0, -2 * c2), kind="fixed")
    return load_model(write_robot(folder, links, joints), base=base)


def test_two_link_arm_by_hand(tmp_path):
    m1, m2, l1, c1, c2, i1, i2 = 3.0, 2.0, 0.5, 0.3, 0.25, 0.04, 0.02
    arm = two_links(tmp_path)
    angle = 0.7
    # Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, section 6.4
    a11 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * math.cos(angle)) + i1 + i2
    a12 = m2 * (c2**2 + l1 * c2 * math.cos(angle)) + i2
    a22 = m2 * c2**2 + i2
    inverse = np.array([[a22, -a12], [-a12, a11]]) / (a11 * a22 - a12**2)
    model = linearize(arm, actuators(2), arm.configuration({"shoulder": 0.4, "elbow": angle}))
    assert_allclose(model.link_inverse_inertia, inverse, rtol=1e-12)  # a few roundings
    assert model.joint_names == ("shoulder", "elbow")
    assert model.contact_jacobian.shape == (0, 2)


def test_a_fixed_base_without_contact_is_the_inverse_of_its_mass_matrix(tmp_path):
    arm = two_links(tmp_path)
    q = arm.configuration({"elbow": 0.3})
    exact = np.linalg.inv(arm.mass_matrix(q))
    assert_allclose(linearize(arm, actuators(2), q).link_inverse_inertia, (exact + exact.T) / 2, rtol=0, atol=0)


def test_one_joint_is_the_plant_of_one_joint(tmp_path):
    links = link("base") + link("arm", 2.0, (0, 0, -0.5), (0, 0, 0))
    one = load_model(write_robot(tmp_path, links, hinge("hinge", "base", "arm")))
    model = linearize(one, actuators(1), one.neutral())
    joint = gr.ElasticJoint(motor_inertia=1.0, link_inertia=0.5, stiffness=1e4, damping=1.0)
    drive, controller = gr.Drive(4000.0, 0.9, 2e-3), gr.PD(1e3, 50.0)
    of_robot, of_joint = (gr.gain_limit(gr.build_loop(plant, drive, controller)) for plant in (model, joint))
    assert (of_robot.gain, of_robot.frequency) == (of_joint.gain, of_joint.frequency)


@pytest.mark.parametrize("contacts", CONTACTS.values(), ids=CONTACTS)
@pytest.mark.parametrize("seed", range(3))
def test_joints_accelerate_as_the_equations_of_motion_say(body, contacts, seed):
    q = any_posture(body, seed)
    model = linearize(body, actuators(12), q, contacts)
    held = contact_jacobian(body, q, contacts)
    expected = accelerations(body.mass_matrix(q), held, np.eye(12))[6:]
    assert_allclose(model.link_inverse_inertia, expected, rtol=0, atol=SOLVED * np.abs(expected).max())


def test_contacts_hold_what_they_say(body):
    q = any_posture(body, 0)
    for kind, directions in (("flat", 6), ("line", 5), ("point", 3)):
        contact = feet("left_sole", kind=kind)
        held = contact_jacobian(body, q, contact)
        assert held.shape == (directions, 18)
        motion = free_motion(body.mass_matrix(q), held)
        assert motion.shape == (18, 18 - directions)
        assert_allclose(held @ motion, 0, atol=1e-12)  # of order 1, to a few roundings
        assert_allclose(motion.T @ body.mass_matrix(q) @ motion, np.eye(18 - directions), atol=1e-12)
    # What a line leaves of the frame's own motion is a roll about y and nothing else.
    twist = body.frame_jacobian(q, "left_sole") @ free_motion(
        body.mass_matrix(q), contact_jacobian(body, q, feet("left_sole", kind="line"))
    )
    assert np.abs(twist[4]).max() > 0.1
    assert_allclose(np.delete(twist, 4, axis=0), 0, atol=1e-12)


def test_feet_closed_into_a_loop_leave_six_motions(body):
    model = linearize(body, actuators(12), biped_posture(body), BOTH)
    sizes = np.linalg.eigvalsh(model.link_inverse_inertia)
    assert np.count_nonzero(sizes > 1e-12 * sizes[-1]) == 6
    again = linearize(body, actuators(12), biped_posture(body), feet("left_sole", "right_sole", "left_foot", "right_foot"))
    assert_allclose(again.link_inverse_inertia, model.link_inverse_inertia, atol=1e-12 * sizes[-1])  # redundant rows change nothing
    assert np.all(model.rigid)
    assert model.compliance is None


@pytest.mark.parametrize(("tilt", "left"), [(1e-12, 3), (1e-10, 3), (1.6e-9, 3), (2.4e-9, 2), (1e-7, 2), (1e-4, 2), (1.0, 2)])
def test_a_held_direction_counts_as_its_own_from_a_billionth_on(tilt: float, left: int):
    """Two rows that differ by `tilt`, whose singular values are √2 and tilt/√2: from a ratio of 1e-9 on the second holds, too."""
    held = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, tilt, 0.0, 0.0]])
    motion = free_motion(np.eye(4), held)
    assert motion.shape == (4, left)
    assert_allclose(held[0] @ motion, 0, atol=1e-9)


SOFT = {
    "one foot": [Contact("left_sole", stiffness=(2e5, 3e3), damping=(300.0, 20.0))],
    "both feet": [Contact("left_sole", stiffness=1e5), Contact("right_sole", "line", stiffness=(1e5, 2e3), damping=10.0)],
    "one soft, one rigid": [Contact("left_sole"), Contact("right_sole", "point", stiffness=[1e5, 1e5, 4e4], damping=100.0)],
    "soft downward only": [Contact("left_sole", stiffness=[np.inf, np.inf, 5e4, 2e3, 2e3, np.inf], damping=5.0)],
}


@pytest.mark.parametrize("contacts", SOFT.values(), ids=SOFT)
def test_soft_ground_is_springs_in_the_equations_of_motion(body, contacts):
    model = linearize(body, actuators(12), any_posture(body, 1), contacts)
    for s in (3j, 40j, 300j, 20 + 90j):
        expected = motor_response(model, s)
        assert_allclose(model.response(s, "motor")[0], expected, rtol=0, atol=1e-8 * np.abs(expected).max())  # ground and gearboxes: 1e7


def test_hard_ground_is_rigid_ground(body):
    q = any_posture(body, 2)
    rigid = linearize(body, actuators(12), q, BOTH)
    hard = [replace(contact, stiffness=1e12) for contact in BOTH]
    springs = linearize(body, actuators(12), q, hard)
    reference = rigid.response(50j, "motor")[0]
    # The ground gives way by about (W_c s²/K)⁻¹: 10 · 50² / 1e12 of the motion.
    assert_allclose(springs.response(50j, "motor")[0], reference, rtol=0, atol=1e-6 * np.abs(reference).max())


def test_permuted_contacts_change_nothing(body):
    q = any_posture(body, 3)
    one, other = (linearize(body, actuators(12), q, contacts).link_inverse_inertia for contacts in (BOTH, BOTH[::-1]))
    assert_allclose(one, other, atol=1e-12 * np.abs(one).max())


# Gravity. Central differences are good to about 1e-9 of the largest torque.
DIFFERENCED = 1e-7


@pytest.mark.parametrize("angle", [0.0, 0.6, 3.0])
def test_pendulum(tmp_path, angle):
    links = link("base") + link("arm", 2.0, (0, 0, -0.5), (0, 0.1, 0))
    pendulum = load_model(write_robot(tmp_path, links, hinge("hinge", "base", "arm")))
    model = linearize(pendulum, actuators(1), pendulum.configuration({"hinge": angle}), gravity=True)
    assert_allclose(model.gravity_stiffness, [[2.0 * GRAVITY * 0.5 * math.cos(angle)]], atol=DIFFERENCED)


def test_hanging_double_pendulum_swings_at_its_frequencies(tmp_path):
    length = 0.4
    arm = two_links(tmp_path, m1=1.5, m2=1.5, l1=length, c1=length, c2=length, i1=0.0, i2=0.0)
    model = linearize(arm, actuators(2), arm.neutral(), gravity=True)
    assert model.gravity_stiffness is not None
    squares = np.sort(np.linalg.eigvals(model.link_inverse_inertia @ model.gravity_stiffness))
    # Two equal point masses on equal strings: ω² = (2 ± √2) g/l (Landau and Lifshitz, Mechanics, §23)
    assert_allclose(squares, (2 + math.sqrt(2) * np.array([-1, 1])) * GRAVITY / length, rtol=1e-8)


@pytest.mark.parametrize("lean", [0.0, 0.5])
def test_body_that_stands_on_its_foot_is_an_inverted_pendulum(tmp_path, lean):
    """The base is the pendulum, the foot is the link: the contact force's own stiffness takes part."""
    links = link("trunk", 6.0, (0, 0, 0.2), (0.3, 0.3, 0.3)) + link("foot", 1.0, (0, 0, -0.05), (0.01, 0.01, 0.01))
    robot = load_model(write_robot(tmp_path, links, hinge("ankle", "trunk", "foot", (0, 0, -0.7))), base="floating")
    q = robot.configuration({"ankle": lean})
    # The base is upright in every posture, weight along its −z, and the ground turns with the foot.
    model = linearize(robot, actuators(1), q, feet("foot"), gravity=True)
    assert_allclose(model.gravity_stiffness, [[-6.0 * GRAVITY * 0.9]], atol=1e-6)
    assert_allclose(model.link_inverse_inertia, [[1 / (0.3 + 6.0 * 0.9**2)]], rtol=1e-12)


@pytest.mark.parametrize(
    "contacts", [feet("left_sole"), BOTH, feet("left_sole", "right_sole", "left_foot")], ids=["left", "both", "redundant"]
)
def test_gravity_on_the_ground_is_the_curvature_of_potential_energy(body, contacts):
    """U less the work of the torques that hold the robot, over postures whose feet are where they were: its second differences."""
    q = any_posture(body, 4)
    stiffness = gravity_stiffness(body, q, contacts)
    motion = free_motion(body.mass_matrix(q), contact_jacobian(body, q, contacts))
    joints = motion[6:]
    holding = np.linalg.lstsq(joints.T, motion.T @ body.gravity_torque(q), rcond=None)[0]

    def energy(step):
        moved = move_on_contacts(body, q, q, contacts, step)
        return body.total_mass * GRAVITY * body.com(moved)[2] - holding @ (body.angles(moved) - body.angles(q))

    size = 2e-3  # truncation 4e-6 of the whole, round-off 1e-13/4e-6
    draw = np.random.default_rng(0)
    for _ in range(6):
        direction = motion @ draw.normal(size=motion.shape[1])
        direction /= np.linalg.norm(direction)
        curvature = (energy(size * direction) - 2 * energy(0 * direction) + energy(-size * direction)) / size**2
        across = direction[6:]
        assert_allclose(across @ stiffness @ across, curvature, atol=1e-5 * np.abs(stiffness).max())
    assert_allclose(stiffness, stiffness.T, atol=0)


def test_nothing_falls_relative_to_itself_in_flight(body):
    assert not np.any(gravity_stiffness(body, biped_posture(body), []))


def test_gravity_is_refused_where_the_base_is_free(body):
    q = biped_posture(body)
    assert_refused(lambda: linearize(body, actuators(12), q, feet("left_sole", kind="point"), gravity=True), ["gravity", "3 directions"])
    assert_refused(lambda: linearize(body, actuators(12), q, feet("left_sole", kind="line"), gravity=True), ["gravity", "1 direction "])
    soft = [Contact("left_sole", stiffness=1e5)]
    assert_refused(lambda: linearize(body, actuators(12), q, soft, gravity=True), ["gravity", "6 directions"])


def test_bad_contacts_are_refused(body):
    q = biped_posture(body)

    def standing(*contacts):
        return lambda: linearize(body, actuators(12), q, contacts)

    assert_refused(standing(Contact("left_sol")), ["'left_sol'", "left_sole"])
    assert_refused(standing(Contact("left_sole"), Contact("left_sole", "point")), ["'left_sole'", "2 times"])
    assert_refused(lambda: Contact("left_sole", "round"), ["'left_sole'", "'round'", "flat, line, point"])  # type: ignore[arg-type]
    for stiffness in (-1.0, 0.0, math.nan, "soft", [1e5, 1e5, 1e5], [[1e5]]):
        assert_refused(lambda stiffness=stiffness: Contact("left_sole", stiffness=stiffness), ["'left_sole'", "stiffness"])
    for damping in (-1.0, math.nan, math.inf, [1.0] * 7):
        assert_refused(lambda damping=damping: Contact("left_sole", stiffness=1e5, damping=damping), ["'left_sole'", "damping"])
    assert_refused(lambda: Contact("left_sole", damping=10.0), ["'left_sole'", "damping", "stiffness"])
    assert_refused(lambda: Contact("left_sole", "point", stiffness=[1e5, 1e3]), ["3 numbers"])


def test_bad_postures_are_refused(body):
    assert_refused(lambda: linearize(body, actuators(12), np.zeros(12)), ["(19,)"])
    q = biped_posture(body)
    q[8] = math.nan
    with pytest.raises(gr.GainroomError, match="posture"):
        linearize(body, actuators(12), q)


def test_a_posture_in_which_no_mass_moves_with_a_joint_is_refused(tmp_path):
    """A wrist's middle link has no mass, and with the last joint at π/2 the point mass lies on the middle axis."""
    links = link("base") + link("upper", 1.0, (0.3, 0, 0), (0.1, 0.1, 0.1)) + link("gimbal") + link("tool", 1.0, (0.2, 0, 0), (0, 0, 0))
    joints = hinge("first", "base", "upper", axis="0 0 1") + hinge("second", "upper", "gimbal", (0.5, 0, 0), axis="0 1 0")
    joints += hinge("third", "gimbal", "tool", axis="0 0 1")
    wrist = load_model(write_robot(tmp_path, links, joints))
    linearize(wrist, actuators(3), wrist.configuration({"second": 0.3}))
    assert_refused(lambda: linearize(wrist, actuators(3), wrist.configuration({"third": math.pi / 2})), ["singular mass matrix"])
