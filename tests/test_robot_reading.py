"""What a robot's file comes to: base, joints that move and joints that are held, rotors, shapes, and the gains of its actuators."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from gainroom.robot import load_model
from gainroom.robot.actuators import Actuators
from gainroom.robot.formats.model_files import position_gains
from gainroom.robot.linearize import linearize
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
from robot_truths import hinge, link, write_robot


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


def test_followers_follow_and_are_said_to(tmp_path: Path):
    panda = load_model(example("panda_description/urdf/panda.urdf"))
    assert panda.size == 8
    assert panda.passive == ("panda_finger_joint2",)
    assert any("mimics 'panda_finger_joint1'" in note for note in panda.notes)
    assert_refused(lambda: panda.require_tree("here"), ["here", "'panda_finger_joint2'", "lock"])
    bolted = load_model(example("panda_description/urdf/panda.urdf"), locked=["panda_finger_joint1"])
    assert dict(bolted.locked) == {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
    bolted.require_tree("here")
    coupled = TWO_ARMS.replace(
        "</worldbody>",
        '</worldbody><equality><joint joint1="l2" joint2="r1"/><connect body1="left" body2="right" anchor="0 0 0"/></equality>',
    )
    body = load_model(write(tmp_path, coupled))
    assert body.joint_names == ("l1", "r1")
    assert any("'l2' is tied to 'r1'" in note for note in body.notes)
    assert len(body.linkages) == 2  # the loop is kept: test_linkages.py
    assert any("closed loops are kept closed" in note for note in body.notes)


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


@pytest.mark.skipif(not hasattr(mujoco.MjModel, "actuator_armature"), reason="this MuJoCo has no armature in actuators")
def test_a_rotor_counts_whatever_its_actuator_does(tmp_path: Path):
    """Actuators whose gains are left out still turn with their joint; those on a tendon are said to be missing."""
    curved = '<general joint="l2" gear="3" armature="0.02" gaintype="affine" gainprm="1 2 0" biastype="affine" biasprm="0 -5 -1"/>'
    muscle = '<muscle joint="r1" armature="0.4" lengthrange="0.1 1"/>'
    text = TWO_ARMS.replace("</worldbody>", f"</worldbody><actuator>{curved}{muscle}</actuator>")
    body = load_model(write(tmp_path, text))
    witness = Witness.of(mujoco.MjModel.from_xml_string(text), body, {})
    links = Witness.of(mujoco.MjModel.from_xml_string(TWO_ARMS), body, {})
    assert_close(np.diag(body.armature), witness.mass_matrix() - links.mass_matrix())
    assert body.armature[1] == pytest.approx(0.02 * 3**2, rel=1e-15)
    assert not position_gains(tmp_path / "robot.xml").joints
    tendon = '<tendon><fixed name="t"><joint joint="l2" coef="1"/></fixed></tendon><actuator><motor name="pull" tendon="t" armature="1"/>'
    notes = load_model(write(tmp_path, TWO_ARMS.replace("</worldbody>", f"</worldbody>{tendon}</actuator>"))).notes
    assert any("on no joint, does not count: pull" in note for note in notes)


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
    gains = {joint: (gain.kp, gain.kd) for joint, gain in position_gains(write(tmp_path, text)).joints.items()}
    assert set(gains) == {"a", "b"}
    assert gains["a"] == pytest.approx((30 * 9, 2 * 9 + 5), rel=1e-15)
    assert gains["b"] == pytest.approx((8, 2 * 0.7 * np.sqrt(8 * 0.5)), rel=1e-12)


def test_unusual_inertia_is_said(tmp_path: Path):
    strange = {**PLANAR, "i1": 30.0}  # more than the other two together
    body = load_model(write(tmp_path, PLANAR_URDF.format(**strange), "robot.urdf"))
    assert any("no solid has the inertia" in note and "'upper'" in note for note in body.notes)


def test_a_wrist_of_massless_links_is_no_mistake(tmp_path: Path):
    """Three joints at one point whose axes are independent only when bent: singular at zero, sound elsewhere."""
    joint = '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/><axis xyz="{3}"/></joint>'
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="2" izz="2" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = '<link name="w"/><link name="x"/><link name="y"/>' + f'<link name="z">{inertia}</link>'
    joints = joint.format("a", "w", "x", "1 0 0") + joint.format("b", "x", "y", "0 1 0") + joint.format("c", "y", "z", "1 0 0")
    body = load_model(write(tmp_path, f'<robot name="wrist">{links}{joints}</robot>', "robot.urdf"))
    assert np.linalg.matrix_rank(body.mass_matrix(body.neutral())) == 2
    assert np.linalg.matrix_rank(body.mass_matrix(body.configuration({"b": 1.0}))) == 3


SPRUNG = TREE.replace('name="hip"', 'name="hip" stiffness="40" springref="20"').replace('name="knee"', 'name="knee" stiffness="7"')


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_springs_of_joints_pull_as_mujoco_has_them(tmp_path: Path, base: str):
    """W G against how MuJoCo's own accelerations change with the joints' positions, by central differences, without gravity."""
    body = load_model(write(tmp_path, SPRUNG), base)
    assert dict(body.springs) == {"hip": 40.0, "knee": 7.0, "shoulder": 0.0}
    assert any("springs" in note and "hip 40, knee 7" in note for note in body.notes)
    actuators = Actuators(*(np.full(3, value) for value in (0.0, np.inf, 0.0, 0.0, 0.0)))
    angles = random_angles(body, 3)
    model = linearize(body, actuators, body.configuration(angles))
    still = SPRUNG if base == "floating" else SPRUNG.replace("<freejoint/>", "")
    witness = mujoco.MjModel.from_xml_string(still.replace('gravity="0.3 -0.2 -9.7"', 'gravity="0 0 0"'))
    data = mujoco.MjData(witness)
    places = [witness.joint(name).qposadr[0] for name in body.joint_names]
    freedoms = [witness.joint(name).dofadr[0] for name in body.joint_names]

    def acceleration(index: int, step: float) -> np.ndarray:
        """Of the joints, loaded with what holds the springs where the joints stand."""
        data.qpos[places] = [angles[name] for name in body.joint_names]
        mujoco.mj_forward(witness, data)
        data.qfrc_applied[:] = -data.qfrc_passive
        data.qpos[places[index]] += step
        mujoco.mj_forward(witness, data)
        return data.qacc[freedoms].copy()

    step = 1e-3  # the springs are linear: only round-off is left, and at this step the links have moved by 1e-3 of the answer
    found = np.column_stack([(acceleration(k, step) - acceleration(k, -step)) / (2 * step) for k in range(3)])
    truth = -model.link_inverse_inertia @ model.gravity_stiffness
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-4 * np.abs(truth).max())


def test_what_the_file_switches_off_does_not_act(tmp_path: Path):
    off = SPRUNG.replace("/><worldbody>", '><flag gravity="disable" spring="disable"/></option><worldbody>')
    body = load_model(write(tmp_path, off))
    assert not body.springs
    assert not body.gravity_torque(body.neutral()).any()


TOLD = {
    'frictionloss="0.3"': "dry friction in the model file is not counted [N m]: hip 0.3",
    'damping="0.7"': "damping in the model file is not counted",
    'stiffness="3 5"': "only the linear part counts: hip",
}


@pytest.mark.parametrize("attribute", TOLD)
def test_what_a_joint_has_and_does_not_count_is_told(tmp_path: Path, attribute: str):
    body = load_model(write(tmp_path, TREE.replace('name="hip"', f'name="hip" {attribute}')))
    assert any(TOLD[attribute] in note for note in body.notes)


def test_friction_of_a_urdf_is_told(tmp_path: Path):
    text = PLANAR_URDF.format(**PLANAR).replace(
        '<axis xyz="0 1 0"/></joint>', '<axis xyz="0 1 0"/><dynamics damping="1" friction="2"/></joint>'
    )
    notes = load_model(write(tmp_path, text, "robot.urdf")).notes
    assert any("friction in the model file is not counted [N m]: shoulder 2" in note for note in notes)
    assert any("damping in the model file is not counted" in note for note in notes)


def test_tendons_and_lifted_bodies_are_told(tmp_path: Path):
    tendon = '</worldbody><tendon><fixed name="t" stiffness="30"><joint joint="hip" coef="1"/></fixed></tendon>'
    lifted = TREE.replace('<body name="shank"', '<body name="shank" gravcomp="1"')
    notes = load_model(write(tmp_path, lifted.replace("</worldbody>", tendon))).notes
    assert any("1 tendon ignored: their springs" in note for note in notes)
    assert any("gravcomp" in note and "shank" in note for note in notes)


def test_rotors_of_transmissions_are_motors_inertia(tmp_path):
    """Drake's: rotor_inertia gear_ratio²; a reduction alone says nothing of the rotor, and is named."""
    links = link("base") + link("one", 2.0, inertia=(1, 0.3, 1)) + link("two", 1.0, inertia=(1, 0.1, 1))
    joints = hinge("hip", "base", "one") + hinge("knee", "one", "two")
    drake = '<actuator><d:rotor_inertia xmlns:d="drake" value="2e-4"/><d:gear_ratio xmlns:d="drake" value="-50"/></actuator>'
    transmissions = (
        f'<transmission name="a"><joint name="hip"/>{drake}</transmission><transmission name="b"><joint name="knee"/><actuator name="m">'
        "<mechanicalReduction>100.0</mechanicalReduction></actuator></transmission>"
    )
    path = write_robot(tmp_path, links, joints + transmissions)
    body = load_model(path)
    np.testing.assert_allclose(body.armature, [2e-4 * 50**2, 0.0], rtol=1e-15)
    np.testing.assert_array_equal(body.mass_matrix(body.neutral()), load_model(write_robot(tmp_path, links, joints)).mass_matrix([0, 0]))
    assert any("gear ratios" in note and "knee 100.0" in note and "hip" not in note for note in body.notes)
    for wrong, word in (("2e-4", "-1"), ("2e-4", "much"), ("-50", "1e200")):
        (tmp_path / "wrong.urdf").write_text((links + joints + transmissions).replace(wrong, word).join(['<robot name="r">', "</robot>"]))
        assert_refused(lambda: load_model(tmp_path / "wrong.urdf"), ["hip"])
