"""Rigid bodies against closed forms and against MuJoCo, which has its own kinematics, inertia matrix and Jacobians."""

import importlib.metadata
import pickle
import re
import subprocess
import sys
import threading
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from gainroom.robot import RigidBody, load_model
from gainroom.robot.mjcf import position_gains
from refusals import assert_refused

# Two programs add the same products in another order: a few round-offs of the largest entry, 1e-15 of it, and a thousand to spare.
AGREE = 1e-12
BALL = '<geom size="0.1" mass="{0}"/>'
INERTIAL = '<inertial pos="{0}" mass="{1}" diaginertia="{2}" euler="{3}"/>'

# Masses, places and orientations without any symmetry, so that a mistake in any of them shows.
TREE = f"""<mujoco><option gravity="0.3 -0.2 -9.7"/><worldbody><body name="trunk" pos="0.1 0.2 1">
  <freejoint/>{INERTIAL.format(".01 .02 .03", 5, ".2 .3 .4", "10 20 30")}<site name="back" pos="-.1 .2 .3" euler="20 -40 70"/>
  <body name="thigh" pos=".1 .2 -.1" euler="5 6 7"><joint name="hip" axis="0 1 .2" pos=".01 .02 .03"/>
    {INERTIAL.format("0 .01 -.2", 2, ".02 .03 .04", "30 10 5")}
    <body name="shank" pos=".02 0 -.4" quat=".9 .1 .2 .3"><joint name="knee" axis="0 1 0" range="-100 5"/>
      {INERTIAL.format(".01 0 -.2", 1, ".02 .02 .003", "0 10 5")}<body name="sole" pos="0 0 -.4" euler="10 0 0"/></body></body>
  <body name="arm" pos="0 -.2 .3"><joint name="shoulder" axis="1 0 0"/>{INERTIAL.format("0 -.1 .02", 0.7, ".01 .002 .01", "0 0 9")}</body>
</body></worldbody></mujoco>"""
SLIDES = f"""<mujoco><worldbody><body name="cart" euler="10 20 30"><joint name="rail" type="slide" axis="1 .5 .2" range="-1 2"/>
  {INERTIAL.format(".1 .2 .3", 3, ".1 .2 .25", "3 4 5")}<body name="lift" pos=".1 .2 .3" euler="40 0 10">
  <joint name="lift" type="slide" axis="0 1 1" pos="9 9 9"/>{INERTIAL.format("0 .1 0", 1, ".1 .1 .1", "0 0 0")}
  <body name="pole"><joint name="hinge" axis="0 0 1" pos="0 .1 .2"/>{INERTIAL.format(".4 0 0", 2, ".1 .2 .2", "0 0 0")}
  <site name="tip" pos="1 0 0"/></body></body></body></worldbody></mujoco>"""
# Several joints in one body turn about axes that those before have moved; ref shifts their zero.
COMPOUND = f"""<mujoco><worldbody><body name="arm" pos="0 0 1" euler="0 30 0">
  <joint name="yaw" axis="0 0 1" pos=".1 0 0" ref="30"/><joint name="out" type="slide" axis="1 0 .3" ref=".2"/>
  <joint name="roll" axis="1 .3 0" pos="0 .2 .1" ref="-20"/><geom type="box" size=".1 .2 .3" pos=".1 .1 .2" euler="10 20 30" mass="3"/>
  <body name="hand" pos="0 0 .5"><joint name="wrist" axis="0 1 0" pos=".05 .02 -.1"/><joint name="twist" axis="1 1 1"/>
  <geom type="capsule" fromto="0 0 0 .1 .2 .3" size=".05" density="700"/><site name="tool" pos=".1 .1 .1" euler="1 2 3"/></body>
  <body name="cover" pos="0 .3 0">{BALL.format(0.4)}</body></body></worldbody></mujoco>"""
TWO_ARMS = f"""<mujoco><worldbody><body name="table" pos="0 0 1">{BALL.format(9)}
  <body name="left"><joint name="l1" axis="0 1 0"/>{INERTIAL.format(".2 0 0", 1, ".01 .02 .02", "0 0 5")}
    <body name="left2" pos=".4 0 0"><joint name="l2" axis="0 1 0"/>{INERTIAL.format(".2 .1 0", 1, ".01 .02 .02", "0 0 5")}
    </body></body></body>
  <body name="right" pos="1 0 0"><joint name="r1" axis="1 1 0"/>{INERTIAL.format(".3 0 0", 2, ".01 .02 .02", "0 7 5")}</body>
</worldbody></mujoco>"""
# The walker's base must come first although a door stands before it; the ball belongs to no robot.
WALKER_AND_DOOR = f"""<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body name="door" pos="2 0 0"><joint name="door" axis="0 0 1"/>{INERTIAL.format(".4 0 1", 8, ".3 .4 .2", "0 0 5")}</body>
  <body name="ball"><freejoint/>{BALL.format(1)}</body>
  <body name="walker" pos="0 0 1"><freejoint/>{INERTIAL.format("0 0 .1", 4, ".1 .1 .1", "0 0 0")}
    <body name="leg" pos="0 .1 0"><joint name="leg" axis="0 1 0"/>{INERTIAL.format("0 0 -.3", 2, ".1 .1 .01", "0 5 0")}</body></body>
</worldbody></mujoco>"""
# Masses that come from a default class, from group limits and from settotalmass.
CLASSES = """<mujoco><compiler settotalmass="7" inertiagrouprange="0 1"/><default><geom density="300"/>
  <default class="heavy"><geom mass="2" group="1"/></default><default class="shown"><geom group="2"/></default></default>
  <worldbody><body name="a" childclass="heavy"><joint name="a" axis="1 0 0"/><geom type="box" size=".1 .2 .3" pos="0 .1 .2"/>
  <geom class="shown" type="mesh" mesh="missing"/><body name="b" pos="0 0 .5"><joint name="b" axis="0 1 0"/>
  <frame pos=".1 0 0" euler="0 40 0"><geom class="main" type="cylinder" size=".1 .2"/></frame></body></body></worldbody>
  <asset><mesh name="missing" file="missing.stl"/></asset></mujoco>"""
FAMILY = {
    "tree": TREE,
    "slides": SLIDES,
    "compound": COMPOUND,
    "two arms": TWO_ARMS,
    "walker and door": WALKER_AND_DOOR,
    "classes": CLASSES,
}


@dataclass
class Witness:
    """MuJoCo's model of the same robot, at the same posture; columns in the body's order."""

    model: Any
    data: Any
    columns: np.ndarray

    @classmethod
    def of(cls, model: Any, body: RigidBody, angles: dict[str, float]) -> "Witness":
        data = mujoco.MjData(model)
        data.qpos[:] = 0
        columns = []
        for joint in range(model.njnt):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                data.qpos[model.jnt_qposadr[joint] + 3] = 1
                if model.body_subtreemass[model.jnt_bodyid[joint]] > model.body_mass[model.jnt_bodyid[joint]] and body.base == "floating":
                    columns.extend(model.jnt_dofadr[joint] + np.arange(6))
        for name in body.joint_names:
            data.qpos[model.joint(name).qposadr[0]] = angles.get(name, 0.0)
            columns.append(model.joint(name).dofadr[0])
        mujoco.mj_forward(model, data)
        return cls(model, data, np.array(columns))

    def mass_matrix(self) -> np.ndarray:
        columns = []
        for direction in np.eye(self.model.nv):
            column = np.zeros(self.model.nv)
            mujoco.mj_mulM(self.model, self.data, column, direction)
            columns.append(column)
        full = np.array(columns) - np.diag(self.model.dof_armature)
        return full[np.ix_(self.columns, self.columns)]

    def jacobian(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Rows and placement of a body or site: (6, N) in its own axes."""
        rows = np.zeros((6, self.model.nv))
        body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if body >= 0:
            mujoco.mj_jacBody(self.model, self.data, rows[:3], rows[3:], body)
            rotation, place = self.data.xmat[body].reshape(3, 3), self.data.xpos[body]
        else:
            site = self.model.site(name).id
            mujoco.mj_jacSite(self.model, self.data, rows[:3], rows[3:], site)
            rotation, place = self.data.site_xmat[site].reshape(3, 3), self.data.site_xpos[site]
        local = np.kron(np.eye(2), rotation.T) @ rows
        return local[:, self.columns], np.column_stack([rotation, place])


def assert_close(found: np.ndarray, truth: np.ndarray, tolerance: float = AGREE) -> None:
    np.testing.assert_allclose(found, truth, rtol=0, atol=tolerance * max(1.0, np.abs(truth).max()))


def write(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def random_angles(body: RigidBody, seed: int) -> dict[str, float]:
    return dict(zip(body.joint_names, np.random.default_rng(seed).uniform(-2, 2, body.size).tolist(), strict=True))


def compiled(text: str) -> Any:
    """By MuJoCo from the whole file, only without the mesh that is not there."""
    text = re.sub(r'<geom class="shown"[^>]*/>', "", text)
    spec = mujoco.MjSpec.from_string(re.sub(r"<asset>.*</asset>", "", text))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # settotalmass is on its way out
        return spec.compile()


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


def example(file: str) -> dict[str, str]:
    return {"package": "example-robot-data", "file": file}


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
    body = load_model(example(file), base)
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


PLANAR_URDF = """<robot name="planar"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 -{c1}"/><mass value="{m1}"/>
    <inertia ixx="9" iyy="{i1}" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -{c2}"/><mass value="{m2}"/>
    <inertia ixx="9" iyy="{i2}" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tip"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -{l1}"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="0 0 -{l2}"/></joint></robot>"""
PLANAR_MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="9 {i1} 9"/><body name="lower" pos="0 0 -{l1}">
  <joint name="elbow" axis="0 1 0" range="-1 2"/><inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="9 {i2} 9"/>
  <body name="tip" pos="0 0 -{l2}"/></body></body></worldbody></mujoco>"""
PLANAR = {"m1": 2.0, "m2": 1.5, "i1": 8.99, "i2": 8.5, "c1": 0.2, "c2": 0.3, "l1": 0.5, "l2": 0.7}


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
    assert planar.beyond_limits(q) == ("joint 'elbow' at 2.5 is outside its limits -1 to 2",)
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


def test_a_floating_base_feels_the_whole_mass(tmp_path: Path):
    """Linear block m I, coupling m [c]×ᵀ to rotation about the base: rigid-body inertia at any point."""
    body = load_model(write(tmp_path, TREE))
    q = body.configuration(random_angles(body, 6))
    inertia, (x, y, z) = body.mass_matrix(q), body.com(q)
    assert_close(inertia[:3, :3], body.total_mass * np.eye(3), 1e-14)
    assert_close(inertia[:3, 3:6], -body.total_mass * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), 1e-13)
    assert_close(body.gravity_torque(q)[:3], -body.total_mass * np.array([0.3, -0.2, -9.7]), 1e-13)


def test_the_base_is_what_the_call_says(tmp_path: Path):
    tree = write(tmp_path, TREE)
    floating, fixed = load_model(tree, "floating"), load_model(tree, "fixed")
    angles = random_angles(fixed, 7)
    assert (floating.nv, fixed.nv) == (9, 3)
    assert_close(fixed.mass_matrix(fixed.configuration(angles)), floating.mass_matrix(floating.configuration(angles))[6:, 6:])
    assert_close(fixed.frame_placement(fixed.neutral(), "trunk")[1], np.array([0.1, 0.2, 1.0]))  # welded where the file has it
    grounded = write(tmp_path, TREE.replace("<freejoint/>", ""))
    freed = load_model(grounded, "floating")
    assert load_model(grounded).base == "fixed"
    assert_close(freed.mass_matrix(freed.configuration(angles)), floating.mass_matrix(floating.configuration(angles)))


@pytest.mark.parametrize("value", [0.0, 0.8])
def test_locking_removes_rows_and_columns(value: float):
    """A joint that is held is a constraint q̇ = 0: the rest of A at the same posture, for every kind of joint."""
    file = example("kinova_description/robots/kinova.urdf")
    full = load_model(file)
    held = full.joint_names[1], full.joint_names[3]
    angles = random_angles(full, 8) | dict.fromkeys(held, value)
    body = load_model(file, locked=[held[0], ".*_4"], posture_for_locked=angles)
    keep = [index for index, name in enumerate(full.joint_names) if name not in held]
    assert body.joint_names == tuple(full.joint_names[index] for index in keep)
    assert dict(body.locked) == dict.fromkeys(held, value)
    # A posture may name locked joints too, where it agrees with them.
    q, q_full = body.configuration(angles), full.configuration(angles)
    assert_close(body.mass_matrix(q), full.mass_matrix(q_full)[np.ix_(keep, keep)])
    assert_close(body.gravity_torque(q), full.gravity_torque(q_full)[keep])
    for frame in full.frames:
        assert_close(body.frame_jacobian(q, frame), full.frame_jacobian(q_full, frame)[:, keep])
    drawn, drawn_full = body.skeleton(q), full.skeleton(q_full)
    assert drawn.names == drawn_full.names
    assert_close(drawn.positions, drawn_full.positions)
    assert_refused(lambda: body.configuration({held[0]: value + 0.1}), [held[0], "locked", f"{value:g}"])


def test_selected_joints_alone_stay():
    legs = load_model(example("talos_data/robots/talos_reduced.urdf"), "floating", selected=["leg_.*"])
    assert legs.size == 12
    assert legs.nv == 18
    assert all(name.startswith("leg_") for name in legs.joint_names)
    whole = load_model(example("talos_data/robots/talos_reduced.urdf"), "floating")
    assert legs.total_mass == pytest.approx(whole.total_mass, rel=1e-13)
    assert set(legs.locked) == set(whole.joint_names) - set(legs.joint_names)


def test_followers_are_held_and_said_to_be(tmp_path: Path):
    panda = load_model(example("panda_description/urdf/panda.urdf"))
    assert panda.size == 8
    assert dict(panda.locked) == {"panda_finger_joint2": 0.0}
    assert any("mimics 'panda_finger_joint1'" in note for note in panda.notes)
    coupled = TWO_ARMS.replace(
        "</worldbody>",
        '</worldbody><equality><joint joint1="l2" joint2="r1"/><connect body1="left" body2="right" anchor="0 0 0"/></equality>',
    )
    body = load_model(write(tmp_path, coupled))
    assert body.joint_names == ("l1", "r1")
    assert any("'l2' is tied to 'r1'" in note for note in body.notes)
    assert any("1 equality constraint ignored" in note for note in body.notes)


def test_rotors_stay_out_of_the_links(tmp_path: Path):
    """Armature is the motors': reported joint by joint, not in A."""
    bare = load_model(write(tmp_path, TREE))
    geared = load_model(write(tmp_path, TREE.replace('name="knee"', 'name="knee" armature="0.3"')))
    q = bare.configuration(random_angles(bare, 9))
    np.testing.assert_array_equal(geared.armature, [0, 0.3, 0])
    np.testing.assert_array_equal(bare.armature, [0, 0, 0])
    np.testing.assert_array_equal(geared.mass_matrix(q), bare.mass_matrix(q))
    fewer = load_model(write(tmp_path, TREE.replace('name="knee"', 'name="knee" armature="0.3"')), locked=["hip"])
    np.testing.assert_array_equal(fewer.armature, [0.3, 0])


@pytest.mark.skipif(not hasattr(mujoco.MjModel, "actuator_armature"), reason="this MuJoCo has no armature in actuators")
def test_a_rotor_before_a_gear_is_reflected_as_mujoco_does(tmp_path: Path):
    text = TWO_ARMS.replace("</worldbody>", '</worldbody><actuator><motor joint="l2" gear="3" armature="0.02"/></actuator>')
    body = load_model(write(tmp_path, text))
    witness = Witness.of(mujoco.MjModel.from_xml_string(text), body, {})
    links = Witness.of(mujoco.MjModel.from_xml_string(TWO_ARMS), body, {})
    assert_close(np.diag(body.armature), witness.mass_matrix() - links.mass_matrix())
    assert body.armature[1] == pytest.approx(0.02 * 3**2, rel=1e-15)


def test_shapes_weigh_what_their_closed_form_says(tmp_path: Path):
    """A ball on a stick: I = 2/5 m r² + m d², m from the default class's density."""
    text = """<mujoco><default><default class="lead"><geom density="11340"/></default></default><worldbody><body>
      <joint name="swing" axis="0 1 0"/><geom class="lead" size="0.05" pos="0 0 -0.7"/></body></worldbody></mujoco>"""
    mass = 11340 * 4 / 3 * np.pi * 0.05**3
    body = load_model(write(tmp_path, text))
    assert_close(body.mass_matrix(body.neutral()), np.array([[0.4 * mass * 0.05**2 + mass * 0.7**2]]), 1e-13)


def test_missing_meshes_do_not_matter_where_inertia_is_explicit(tmp_path: Path):
    shown = TREE.replace(
        "<worldbody>", '<asset><mesh name="m" file="gone.stl"/><texture name="t" type="2d" file="gone.png"/></asset><worldbody>'
    )
    shown = shown.replace(
        "<freejoint/>", '<freejoint/><geom type="mesh" mesh="m"/><frame><geom type="mesh" mesh="m" material="x"/></frame>'
    )
    bare, dressed = load_model(write(tmp_path, TREE)), load_model(write(tmp_path, shown))
    q = bare.configuration(random_angles(bare, 10))
    np.testing.assert_array_equal(dressed.mass_matrix(q), bare.mass_matrix(q))
    insisting = shown.replace("<worldbody>", '<compiler inertiafromgeom="true"/><worldbody>')
    assert_refused(lambda: load_model(write(tmp_path, insisting)), ["robot.xml", "'trunk'", "'gone.stl'", "missing"])


def test_a_mesh_that_is_there_gives_its_inertia(tmp_path: Path):
    """A unit cube that turns about an edge: I = 2/3 m."""
    corners = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"]
    (tmp_path / "meshes").mkdir()
    write(tmp_path / "meshes", "\n".join([*corners, *(f"f {face}" for face in faces)]) + "\n", "cube.obj")
    text = """<mujoco><compiler meshdir="meshes"/><asset><mesh file="cube.obj"/></asset><worldbody><body><joint name="turn"/>
      <geom type="mesh" mesh="cube" density="6"/></body></worldbody></mujoco>"""
    body = load_model(write(tmp_path, text))
    # MuJoCo keeps the vertices of meshes in single precision.
    assert_close(body.mass_matrix(body.neutral()), np.array([[6 * 2 / 3]]), 1e-6)


def test_gains_of_position_servos(tmp_path: Path):
    """Torque gear × (kp (u − gear q) − kv gear q̇): gains times gear². dampratio: kv = 2 ζ √(kp m) before the gear."""
    ball = INERTIAL.format("0 0 0", 0.5, "1 1 1", "0 0 0")
    text = f"""<mujoco><default><default class="damped"><position kv="2"/></default></default><worldbody>
      <body><joint name="a"/>{ball}</body><body><joint name="b" type="slide"/>{ball}</body>
      <body><joint name="c"/>{ball}</body></worldbody><actuator>
      <position class="damped" joint="a" kp="30" gear="3"/><velocity joint="a" kv="5"/><position joint="b" kp="8" dampratio="0.7"/>
      <motor joint="c"/></actuator></mujoco>"""
    gains = position_gains(write(tmp_path, text))
    assert set(gains) == {"a", "b"}
    assert gains["a"] == pytest.approx((30 * 9, 2 * 9 + 5), rel=1e-15)
    assert gains["b"] == pytest.approx((8, 2 * 0.7 * np.sqrt(8 * 0.5)), rel=1e-12)


def test_unusual_inertia_is_said(tmp_path: Path):
    strange = {**PLANAR, "i1": 30.0}  # more than the other two together
    body = load_model(write(tmp_path, PLANAR_URDF.format(**strange), "robot.urdf"))
    assert any("no solid has the inertia" in note and "'shoulder'" in note for note in body.notes)


def test_a_wrist_of_massless_links_is_no_mistake(tmp_path: Path):
    """Three joints at one point whose axes are independent only when bent: singular at zero, sound elsewhere."""
    joint = '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/><axis xyz="{3}"/></joint>'
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="2" izz="2" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = '<link name="w"/><link name="x"/><link name="y"/>' + f'<link name="z">{inertia}</link>'
    joints = joint.format("a", "w", "x", "1 0 0") + joint.format("b", "x", "y", "0 1 0") + joint.format("c", "y", "z", "1 0 0")
    body = load_model(write(tmp_path, f'<robot name="wrist">{links}{joints}</robot>', "robot.urdf"))
    assert np.linalg.matrix_rank(body.mass_matrix(body.neutral())) == 2
    assert np.linalg.matrix_rank(body.mass_matrix(body.configuration({"b": 1.0}))) == 3


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
