"""The project's own biped: the published facts it was written from, and the picture it must show of CoM control (elasticity and delay)."""

import xml.etree.ElementTree as ET
from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.robot.linearize import linearize
from gainroom.robot.tasks import Task, tasks_of
from robot_truths import BOTH, JOINTS, MIRROR, SIDES, STAND, actuators, biped_posture, feet

HIP, THIGH, SHANK = (0.0, 0.1025, -0.1225), 0.35, 0.35
MASSES = (2.68, 2.67, 5.37, 3.88, 2.51, 3.46)  # hip yaw link to foot
CENTRES = ((-0.065, 0, 0.052), (-0.048, 0.002, 0), (0, 0, -0.189), (0.004, -0.002, -0.143), (-0.004, 0.002, 0), (-0.008, 0, -0.085))
TEXT = (files("gainroom") / "robot" / "models" / "biped.urdf").read_text("utf-8")
ROOT = ET.fromstring(TEXT)
LINKS = {link.get("name"): link for link in ROOT.iter("link")}
MOVED_LINKS = {joint.get("name"): joint.find("child").get("link") for joint in ROOT.iter("joint")}


def numbers(element, path: str, key: str) -> list[float]:
    return [float(part) for part in element.find(path).get(key).split()]


@pytest.mark.parametrize("side", SIDES)
def test_published_masses_and_centres(side):
    for joint, mass, centre in zip(JOINTS, MASSES, CENTRES, strict=True):
        link = LINKS[MOVED_LINKS[f"{side}_{joint}"]]
        assert numbers(link, "inertial/mass", "value") == [mass]
        assert numbers(link, "inertial/origin", "xyz") == [centre[0], centre[1] * (1 if side == "left" else -1), centre[2]]
    pelvis = LINKS["pelvis"]
    assert numbers(pelvis, "inertial/origin", "xyz") == [0, 0, 0.377]
    assert round(numbers(pelvis, "inertial/mass", "value")[0], 1) == 40.1


def test_published_total_and_joints(body):
    assert round(body.total_mass, 1) == 81.3
    assert body.joint_names == tuple(f"{side}_{joint}" for side in SIDES for joint in JOINTS)
    assert body.base == "floating"
    assert not body.notes
    assert not np.any(body.armature)
    assert not body.beyond_limits(biped_posture(body))


def test_published_dimensions(body):
    q = body.neutral()
    for side, sign in zip(SIDES, (1, -1), strict=True):
        places = {joint: body.frame_placement(q, MOVED_LINKS[f"{side}_{joint}"])[1] for joint in JOINTS}
        for hip in ("hip_yaw", "hip_roll", "hip_pitch"):
            assert_allclose(places[hip], (HIP[0], sign * HIP[1], HIP[2]), atol=1e-15)
        assert_allclose(places["hip_pitch"] - places["knee"], (0, 0, THIGH), atol=1e-15)
        assert_allclose(places["knee"] - places["ankle_pitch"], (0, 0, SHANK), atol=1e-15)
        assert_allclose(places["ankle_roll"], places["ankle_pitch"], atol=1e-15)
        for joint, axis in zip(JOINTS, "zxyyyx", strict=True):  # at zero all axes are the pelvis's
            turn = body.frame_jacobian(q, MOVED_LINKS[f"{side}_{joint}"])[3:, 6 + body.joint_names.index(f"{side}_{joint}")]
            assert_allclose(turn, np.eye(3)["xyz".index(axis)], atol=1e-15)


def test_every_link_is_the_solid_that_is_drawn():
    for name, link in LINKS.items():
        if link.find("inertial") is None:
            assert name in ("left_sole", "right_sole")
            continue
        (mass,) = numbers(link, "inertial/mass", "value")
        shape = link.find("visual/geometry")[0]
        assert numbers(link, "visual/origin", "xyz") == numbers(link, "inertial/origin", "xyz")
        if shape.tag == "box":
            x, y, z = (float(part) for part in shape.get("size").split())
            expected = mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        else:
            radius, length = float(shape.get("radius")), float(shape.get("length"))
            across = mass / 12 * (3 * radius**2 + length**2)
            expected = np.array([across, across, mass / 2 * radius**2])
        found = [numbers(link, "inertial/inertia", key)[0] for key in ("ixx", "iyy", "izz")]
        assert_allclose(found, expected, rtol=5e-6)  # six digits are written
    assert "mesh" not in TEXT


def test_it_stands_on_its_soles(body):
    q = biped_posture(body)
    height = body.com(q)[2] - body.frame_placement(q, "left_sole")[1][2]
    assert round(height, 3) == 0.844  # as the file's comment says
    assert "then stands 0.844 above them" in " ".join(TEXT.split())
    for side in SIDES:
        axes, place = body.frame_placement(q, f"{side}_sole")
        assert_allclose(axes, np.eye(3), atol=1e-15)  # flat on the ground
        foot = LINKS[f"{side}_foot"]
        under = numbers(foot, "visual/origin", "xyz")[2] - float(foot.find("visual/geometry/box").get("size").split()[2]) / 2
        assert_allclose(place[2] - body.frame_placement(q, f"{side}_foot")[1][2], under, atol=1e-12)
        length, width, _ = (float(part) for part in foot.find("visual/geometry/box").get("size").split())
        middle = place[0] + numbers(foot, "visual/origin", "xyz")[0]
        assert abs(body.com(q)[0] - middle) < length / 2  # the weight lies over the feet
        assert width > 0.1


def test_left_and_right_legs_are_mirror_images(body):
    turned = {"hip_yaw": -1, "hip_roll": -1, "ankle_roll": -1}
    draw = np.random.default_rng(0)
    left = {joint: draw.uniform(-0.4, 0.4) for joint in JOINTS}
    right = {joint: draw.uniform(-0.4, 0.4) for joint in JOINTS}

    def posture(one, other):
        angles = {f"left_{joint}": angle for joint, angle in one.items()}
        return body.configuration(angles | {f"right_{joint}": turned.get(joint, 1) * angle for joint, angle in other.items()})

    here, there = (body.mass_matrix(q)[6:, 6:] for q in (posture(left, right), posture(right, left)))
    # `posture` mirrors the right leg already, so exchanging the two arguments is the reflection of the whole robot.
    assert_allclose(MIRROR @ here @ MIRROR.T, there, atol=1e-12 * np.abs(here).max())
    assert_allclose(body.lower[:6], body.lower[6:])
    assert_allclose(body.upper[:6], body.upper[6:])
    for joint in turned:
        index = JOINTS.index(joint)
        assert body.lower[index] == -body.upper[index]


# theory: CoM control on a biped of these dimensions, J_m 1, K 1e4, B 1, ω_c 4000, ζ 0.9, T 2 ms, knees at 0.6.
HARD, PAPER = (np.full(3, 100.0), np.full(3, 20.0)), (np.array([50.0, 90, 200]), np.array([1.0, 5, 15]))
SCALES = {("double", "hard"): 0.64, ("left", "hard"): 0.41, ("double", "paper"): 9.1, ("left", "paper"): 2.0}


def common_scale(model, tasks, kp, kd, delay=2e-3, bandwidth=4000.0, damping_ratio=0.9):
    """The smallest factor on the CoM gains for which an eigenvalue of the 3 × 3 task loop lies on −1/factor, on a dense grid."""
    omega = np.geomspace(5.0, 3000.0, 6000)
    s = 1j * omega
    drive = bandwidth**2 / (s**2 + 2 * damping_ratio * bandwidth * s + bandwidth**2) * np.exp(-s * delay)
    moved = tasks.jacobian @ model.response(s, "motor") @ tasks.torque
    values = np.linalg.eigvals(drive[:, None, None] * moved * (kp + s[:, None] * kd)[:, None, :])
    values = values[np.arange(len(omega))[:, None], np.argsort(np.abs(values), axis=1)]
    crosses = (np.diff(np.sign(values.imag), axis=0) != 0) & (values.real[1:] < 0) & (values.real[:-1] < 0)
    return 1 / np.abs(values[:-1][crosses]).max()


@pytest.mark.parametrize("rotors", [False, True])
def test_gains_that_are_harmless_on_a_rigid_robot_are_not_on_this_one(body, rotors):
    found = {}
    for contact, held in (("double", BOTH), ("left", feet("left_sole"))):
        model = linearize(body, actuators(12), biped_posture(body, STAND), held)
        rigid = linearize(body, actuators(12, stiffness=np.inf, damping=0.0), biped_posture(body, STAND), held)
        tasks = tasks_of(model, [Task(name="com", kind="com", kp=1, kd=1)], rotors)
        for gains, (kp, kd) in (("hard", HARD), ("paper", PAPER)):
            found[contact, gains] = common_scale(model, tasks, kp, kd)
        assert common_scale(rigid, tasks, *HARD) > 20
    # The links' shapes are ours and the controller's model with or without rotors moves them by up to 12 %: within 15 %.
    for case, scale in SCALES.items():
        assert found[case] == pytest.approx(scale, rel=0.15)
    assert found["double", "hard"] < 1
    assert found["double", "paper"] > 4 * found["left", "paper"]


@pytest.mark.parametrize("contact", [BOTH, []], ids=["double", "flight"])
@pytest.mark.parametrize("above", [1e-4, 5e-4, 2e-3, 2e-2])
def test_gains_just_above_the_limit_have_it_just_below(body, contact, above):
    """Equal legs have limits within 1e-3 of each other: from gains slightly too high there is a way back."""
    model = linearize(body, actuators(12), biped_posture(body), contact)
    loop = gr.build_loop(model, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(kp=2000.0, kd=100.0))
    limit = gr.gain_limit(loop)
    back = gr.gain_limit(loop.scaled(limit.gain * (1 + above)))
    assert not back.stable
    assert back.certificate.holds
    assert back.gain * (1 + above) == pytest.approx(1, rel=1e-9)
