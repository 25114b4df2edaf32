"""What a robot's file comes to: base, joints that move and joints that are held, rotors, shapes, and the gains of its actuators."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from gainroom.robot import load_model
from gainroom.robot.mjcf import position_gains
from refusals import assert_refused
from robot_bodies import (
    INERTIAL,
    PLANAR,
    PLANAR_URDF,
    TREE,
    TWO_ARMS,
    Witness,
    assert_close,
    example,
    random_angles,
    write,
)


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
