"""Rigid bodies against closed forms and against MuJoCo, which has its own kinematics, inertia matrix and Jacobians."""

import importlib.metadata
import pickle
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from gainroom.robot import RigidBody, load_model
from robot_bodies import (
    COMPOUND,
    FAMILY,
    PLANAR,
    PLANAR_MJCF,
    PLANAR_URDF,
    TREE,
    WALKER_AND_DOOR,
    Witness,
    assert_close,
    compiled,
    example,
    random_angles,
    write,
)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILY)
@pytest.mark.parametrize("seed", [1, 2])
def test_an_mjcf_has_mujocos_dynamics(tmp_path: Path, name: str, seed: int):
    body = load_model(write(tmp_path, FAMILY[name]))
    angles = random_angles(body, seed)
    q = body.configuration(angles)
    witness = Witness.of(compiled(FAMILY[name]), body, angles)
    assert_close(body.mass_matrix(q), witness.mass_matrix())
    assert_close(body.gravity_torque(q), witness.data.qfrc_bias[witness.columns])
    assert {"back", "tip", "tool"} & set(body.frames) or name not in ("tree", "slides", "compound")
    for frame in body.frames:
        jacobian, placement = witness.jacobian(frame)
        assert_close(body.frame_jacobian(q, frame), jacobian)
        assert_close(np.column_stack(body.frame_placement(q, frame)), placement)


@pytest.mark.parametrize("name", ["tree", "slides", "compound"])
def test_the_centre_of_mass_is_mujocos(tmp_path: Path, name: str):
    body = load_model(write(tmp_path, FAMILY[name]))
    angles = random_angles(body, 3)
    q = body.configuration(angles)
    witness = Witness.of(compiled(FAMILY[name]), body, angles)
    rows = np.zeros((3, witness.model.nv))
    mujoco.mj_jacSubtreeCom(witness.model, witness.data, rows, 1)
    assert_close(body.com(q), witness.data.subtree_com[1])
    assert_close(body.com_jacobian(q), rows[:, witness.columns])
    assert body.total_mass == pytest.approx(witness.model.body_subtreemass[1], rel=1e-14)


def test_columns_keep_mujocos_joint_order(tmp_path: Path):
    """Only a floating base comes first; what is no part of a robot is left out, with a note."""
    body = load_model(write(tmp_path, WALKER_AND_DOOR))
    assert (body.base, body.joint_names, body.nv) == ("floating", ("leg", "door"), 8)
    assert "ball" not in body.frames
    assert any("'ball'" in note for note in body.notes)
    assert load_model(write(tmp_path, COMPOUND)).joint_names == ("yaw", "out", "roll", "wrist", "twist")


EXAMPLES = {
    "panda_description/urdf/panda.urdf": "fixed",
    "solo_description/robots/solo12.urdf": "floating",
    "g1_description/urdf/g1_29dof_rev_1_0.urdf": "floating",
    "talos_data/robots/talos_reduced.urdf": "floating",
    "kinova_description/robots/kinova.urdf": "fixed",
}


def example_path(file: str) -> Path:
    found = [path for path in importlib.metadata.files("example-robot-data") or () if str(path).endswith("/" + file)]
    return Path(str(found[0].locate()))


def mujoco_from_urdf(path: Path, floating: bool) -> Any:
    """MuJoCo's own reading of a URDF, with its pictures stripped."""
    text = re.sub(r"<!--.*?-->", "", path.read_text("utf-8"), flags=re.DOTALL)
    for tag in ("visual", "collision"):
        text = re.sub(rf"<{tag}\b[^>]*?(/>|>.*?</{tag}>)", "", text, flags=re.DOTALL)
    options = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco>'
    spec = mujoco.MjSpec.from_string(re.sub(r"</robot>\s*$", options + "</robot>", text))
    if floating:
        spec.worldbody.first_body().add_freejoint()
    return spec.compile()


@pytest.mark.parametrize(("file", "base"), EXAMPLES.items())
def test_a_urdf_has_mujocos_dynamics(file: str, base: Any):
    locked = ["panda_finger_joint2"] if "panda" in file else []  # it follows the other finger, here and not in MuJoCo's model
    body = load_model(example(file), base, locked=locked)
    assert body.base == base
    angles = random_angles(body, 4)
    q = body.configuration(angles)
    witness = Witness.of(mujoco_from_urdf(example_path(file), base == "floating"), body, angles)
    assert_close(body.mass_matrix(q), witness.mass_matrix())
    assert_close(body.gravity_torque(q), witness.data.qfrc_bias[witness.columns])
    known = {witness.model.body(index).name for index in range(witness.model.nbody)}
    frames = [frame for frame in body.frames if frame in known]
    assert len(frames) > body.size
    for frame in frames:
        jacobian, placement = witness.jacobian(frame)
        assert_close(body.frame_jacobian(q, frame), jacobian)
        assert_close(np.column_stack(body.frame_placement(q, frame)), placement)


@pytest.fixture(params=["robot.urdf", "robot.xml"])
def planar(request: pytest.FixtureRequest, tmp_path: Path) -> RigidBody:
    text = PLANAR_URDF if request.param.endswith("urdf") else PLANAR_MJCF
    return load_model(write(tmp_path, text.format(**PLANAR), request.param))


def test_a_two_link_arm_follows_the_textbook(planar: RigidBody):
    """Hanging arm, absolute angles a = q1, b = q1 + q2 (Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, section 7.3)."""
    q1, q2 = 0.4, -0.7
    m1, m2, i1, i2, c1, c2, l1, l2 = (PLANAR[key] for key in ("m1", "m2", "i1", "i2", "c1", "c2", "l1", "l2"))
    q = planar.configuration({"shoulder": q1, "elbow": q2})
    a22 = i2 + m2 * c2**2
    a12 = a22 + m2 * l1 * c2 * np.cos(q2)
    a11 = i1 + m1 * c1**2 + m2 * l1**2 + m2 * l1 * c2 * np.cos(q2) + a12
    assert_close(planar.mass_matrix(q), np.array([[a11, a12], [a12, a22]]), 1e-14)
    g2 = m2 * 9.81 * c2 * np.sin(q1 + q2)
    assert_close(planar.gravity_torque(q), np.array([(m1 * c1 + m2 * l1) * 9.81 * np.sin(q1) + g2, g2]), 1e-14)
    place = -np.array([l1 * np.sin(q1) + l2 * np.sin(q1 + q2), 0, l1 * np.cos(q1) + l2 * np.cos(q1 + q2)])
    assert_close(planar.frame_placement(q, "tip")[1], place, 1e-14)
    from_shoulder, from_elbow = (l1 * np.sin(q2), -l1 * np.cos(q2) - l2), (0, -l2)  # x and z in the tip's axes
    linear = np.array([[z, 0, -x] for x, z in (from_shoulder, from_elbow)]).T  # e_y × r
    assert_close(planar.frame_jacobian(q, "tip"), np.vstack([linear, [[0, 0], [1, 1], [0, 0]]]), 1e-14)
    points = -np.array([[0, 0], [0, 0], [l1 * np.sin(q1), l1 * np.cos(q1)], place[[0, 2]] * -1])
    skeleton = planar.skeleton(q)
    assert_close(skeleton.positions[:, [0, 2]], points, 1e-14)
    assert skeleton.names == ("base", "shoulder", "elbow", "end of elbow")
    assert (skeleton.parents.tolist(), skeleton.joints.tolist()) == ([-1, 0, 1, 2], [-1, 0, 1, -1])


def test_angles_and_limits(planar: RigidBody):
    """A continuous joint is two numbers in a posture and one angle outside."""
    q = planar.configuration({"shoulder": 3.0, "elbow": 2.5})
    assert planar.nv == planar.size == 2
    np.testing.assert_allclose(planar.angles(q), [3.0, 2.5], rtol=1e-15)
    np.testing.assert_array_equal(planar.lower, [-np.inf, -1])
    np.testing.assert_array_equal(planar.upper, [np.inf, 2])
    assert planar.beyond_limits(planar.neutral()) == ()
    assert planar.beyond_limits(q) == ("joint 'elbow' at 2.5 is outside its limits -1 to 2 rad",)
    moved = planar.integrate(q, [0.05, -0.5])
    np.testing.assert_allclose(planar.angles(moved), [3.05, 2.0], rtol=1e-14)


@pytest.mark.parametrize("name", ["tree", "slides", "compound"])
def test_a_frame_jacobian_is_the_derivative_of_its_placement(tmp_path: Path, name: str):
    body = load_model(write(tmp_path, FAMILY[name]))
    q = body.configuration(random_angles(body, 5))
    step = 1e-5  # central differences: error of step² times third derivatives of order one, and round-off 1e-16/step
    for frame in body.frames:
        rotation, _ = body.frame_placement(q, frame)
        columns = []
        for direction in np.eye(body.nv) * step:
            (after, there), (before, here) = (body.frame_placement(body.integrate(q, sign * direction), frame) for sign in (1, -1))
            spin = rotation.T @ (after - before) / (2 * step)
            columns.append([*rotation.T @ (there - here) / (2 * step), spin[2, 1], spin[0, 2], spin[1, 0]])
        assert_close(body.frame_jacobian(q, frame), np.array(columns).T, 1e-8)


@pytest.mark.parametrize("name", ["tree", "slides", "compound"])
def test_a_payload_is_a_point_mass(tmp_path: Path, name: str):
    """M + m Jᵀ J, J of the frame's origin; its weight beside the links', and nothing of the robot that has none is changed."""
    body = load_model(write(tmp_path, FAMILY[name]))
    q = body.configuration(random_angles(body, 7))
    before, weight = body.mass_matrix(q), body.gravity_torque(q)
    for frame in body.carriers:
        loaded, jacobian = body.with_payload(frame, 1.5).with_payload(frame, 0.5), body.frame_jacobian(q, frame)[:3]
        assert_close(loaded.mass_matrix(q), before + 2.0 * jacobian.T @ jacobian, 1e-12)
        assert loaded.total_mass == pytest.approx(body.total_mass + 2.0, rel=1e-14)
        rotation, _ = body.frame_placement(q, frame)
        pull = rotation.T @ np.array(body.model.gravity.linear)
        assert_close(loaded.gravity_torque(q), weight - 2.0 * jacobian.T @ pull, 1e-12)
        assert loaded.payload == {frame: 2.0}
    assert body.carriers
    assert_close(body.mass_matrix(q), before, 0)


def test_a_floating_base_feels_the_whole_mass(tmp_path: Path):
    """Linear block m I, coupling m [c]×ᵀ to rotation about the base: rigid-body inertia at any point."""
    body = load_model(write(tmp_path, TREE))
    q = body.configuration(random_angles(body, 6))
    inertia, (x, y, z) = body.mass_matrix(q), body.com(q)
    assert_close(inertia[:3, :3], body.total_mass * np.eye(3), 1e-14)
    assert_close(inertia[:3, 3:6], -body.total_mass * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), 1e-13)
    assert_close(body.gravity_torque(q)[:3], -body.total_mass * np.array([0.3, -0.2, -9.7]), 1e-13)


def test_a_body_travels_and_is_shared(planar: RigidBody):
    """Sent to another process, or used by threads at once, it gives the same numbers."""
    q = planar.configuration({"shoulder": 0.3})
    truth = planar.mass_matrix(q)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(planar)).mass_matrix(q), truth)
    wrong = []

    def work(angle: float) -> None:
        mine = planar.configuration({"elbow": angle})
        expected = planar.gravity_torque(mine)
        wrong.extend(1 for _ in range(200) if not np.array_equal(planar.gravity_torque(mine), expected))

    threads = [threading.Thread(target=work, args=(angle,)) for angle in (0.1, 0.9, 1.7)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_robots_cost_nothing_until_one_is_read():
    check = "import sys, gainroom.robot; sys.exit(bool({'pinocchio', 'mujoco'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", check]).returncode == 0
