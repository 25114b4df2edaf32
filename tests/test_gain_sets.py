"""Sets of gains wherever they stand in a YAML file: the only one is read, of several one is named; nothing of them is passed over."""

import textwrap
from pathlib import Path

import pytest
import yaml

from gainroom.errors import GainroomError
from gainroom.files.gain_files import JointGains, gains_of, parse_gains, read_gains
from gainroom.io.yaml_text import parse_yaml

JOINTS = ("l_hip", "l_knee", "r_hip", "r_knee")
SETS = """
common:
  dt: 0.002
  stiffness: [200, 150, 200, 150]
  damping: [5, 4, 5, 4]
prepare:
  stiffness: [350, 300, 350, 300]
  damping: [7.5, 7, 7.5, 7]
"""
PARTS = """
basic: {task: walk, checkpoint: null}
asset: {size: !!python/tuple [1, 2], seed: !Random {kind: any}}
init_state: {default_joint_angles: {default: 0.1, knee: 0.6, r_knee: 0.7}}
control:
  stiffness: {"hip": 200., "knee": 90., "r_knee": 80.}
  damping: {"hip": 5., "knee": 3., "r_knee": 2.}
  decimation: 10
"""
WRITTEN = """
sim: {dt: 0.005, device: 'cuda:0'}
scene:
  replicate: !!python/object/apply:builtins.slice [null, 3]
  robot:
    class_type: isaaclab.assets.articulation:Articulation
    init_state: {pos: &id001 !!python/tuple [0.0, 0.0, 0.3], joint_pos: {.*_hip: -0.4, .*_knee: 0.8}}
    actuators:
      hips:
        class_type: isaaclab.actuators.actuator_pd:DCMotor
        joint_names_expr: [.*_hip]
        stiffness: 25.0
        damping: 0.5
        effort_limit: 33.5
        armature: 0.01
      knees:
        class_type: isaaclab.actuators.actuator_pd:ImplicitActuator
        joint_names_expr: &id002 [.*_knee]
        stiffness: {l_.*: 30.0, r_.*: 31.0}
        damping: {.*: 0.75}
        effort_limit_sim: {.*_knee: 45.0}
        armature: null
  ball: {pos: *id001, actuators: {}}
"""


def read(text: str, chosen: str = "") -> JointGains:
    return gains_of(parse_gains(textwrap.dedent(text), "g.yaml", chosen), JOINTS)


def refusal(text: str, chosen: str = "") -> str:
    with pytest.raises(GainroomError) as caught:
        read(text, chosen)
    assert str(caught.value).startswith("g.yaml: ")
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix("g.yaml: ")


def test_one_of_several_sets_is_named(tmp_path: Path):
    assert refusal(SETS) == "holds gains in 2 places; name one, g.yaml:common (common, prepare)"
    assert refusal(SETS, "commn") == "'commn' holds no gains; did you mean 'common'? (sets: common, prepare)"
    assert read(SETS, "common").kp.tolist() == [200, 150, 200, 150]
    assert read(SETS, "prepare").kd.tolist() == [7.5, 7, 7.5, 7]
    for name in ("two.yaml", "two.json"):
        path = tmp_path / name
        path.write_text(SETS if name.endswith("yaml") else '{"a": {"kps": [1, 2, 3, 4],\t"kds": [0, 0, 0, 0]}, "b": {"kp": [], "kd": []}}')
    assert gains_of(read_gains(Path(f"{tmp_path}/two.yaml:prepare")), JOINTS).kp.tolist() == [350, 300, 350, 300]
    assert gains_of(read_gains(Path(f"{tmp_path}/two.json:a")), JOINTS).kp.tolist() == [1, 2, 3, 4]
    (tmp_path / "two.yaml:b.yaml").write_text("kps: [1, 1, 1, 1]\nkds: [1, 1, 1, 1]")
    assert gains_of(read_gains(tmp_path / "two.yaml:b.yaml"), JOINTS).kp.tolist() == [1, 1, 1, 1]  # a file of that name goes first


ORDER = "joint_names: [r_knee, r_hip, l_knee, l_hip]\n"
P_I_D = "{p: 7.0, i: 0.0, d: 1.0}"


@pytest.mark.parametrize(
    ("text", "chosen", "kp"),
    [
        (ORDER + SETS, "common", [150, 200, 150, 200]),  # an order that stands around the set
        ("robots:\n" + textwrap.indent(SETS, "  "), "robots.prepare", [350, 300, 350, 300]),
        ("soft: {l_hip: {kp: 1}}\nhard: {gains: {.*_hip: [9, 1], .*: [8, 1]}}", "hard", [8, 8, 8, 8]),
        ("soft: {l_hip: {kp: 1}}\nhard: {gains: {.*_hip: [9, 1], .*: [8, 1]}}", "soft", [1, 0, 0, 0]),
        ("one: {motor: {control: {stiffness: 80.0, damping: 2.0}}}", "", [80, 80, 80, 80]),
        (
            f"modes: [{{name: a, l_hip: {{kp: 3}}}}, {{name: b, {ORDER.strip()}, kps: [1, 2, 3, 4], kds: [1, 1, 1, 1]}}]",
            "modes.1",
            [4, 3, 2, 1],
        ),
        (f"arm: {{gains: {{l_hip: {P_I_D}}}}}\nleg: {{gains: {{l_hip: {P_I_D}, r_hip: {P_I_D}}}}}", "leg", [7, 0, 7, 0]),
        (f"drives: {{gains: {{l_hip: {P_I_D}}}}}\npolicy: {{kps: [1, 2, 3, 4], kds: [1, 1, 1, 1]}}", "drives", [7, 0, 0, 0]),
        (f"drives: {{gains: {{l_hip: {P_I_D}}}}}\npolicy: {{kps: [1, 2, 3, 4], kds: [1, 1, 1, 1]}}", "policy", [1, 2, 3, 4]),
        ("base: &b {kp: 5.0, kd: 1.0}\ngains: {l_hip: *b, r_hip: {<<: *b, kp: 6.0}}", "gains", [5, 0, 6, 0]),
        ("kps: [1, 2, 3, 4]\nkds: &d [1, 1, 1, 1]\nbench: {kps: [2, 2, 2, 2], kds: *d}", ".", [1, 2, 3, 4]),
        ("motors: {a: {moteus: {.*: {kp: 6.283185307179586}}}, b: {moteus: {.*: {kp: 1}}}}", "motors.a", [1, 1, 1, 1]),
    ],
)
def test_a_set_is_found_at_any_depth_and_by_the_keys_that_lead_to_it(text: str, chosen: str, kp: list[float]):
    assert read(text, chosen).kp.tolist() == kp


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"drives: {{gains: {{l_hip: {P_I_D}, r_hip: {P_I_D}}}}}\npolicy: {{kps: [1], kds: [1]}}", "(drives, policy)"),
        (f"arm: {{gains: {{l_hip: {P_I_D}}}}}\nleg: {{gains: {{l_hip: {P_I_D}}}}}", "name one, g.yaml:leg, or leave one in the file"),
        ("kps: [1]\nkds: [1]\nhip: {kp: 3}", "name one, g.yaml:. (., hip)"),
        ("a: {control: {stiffness: {hip: 1}, damping: {hip: 1}}}\nb: {l_hip: {kp: 1}}", "name one, g.yaml:a.control (a.control, b)"),
        (f"{PARTS}  arm: {{stiffness: {{hip: 1}}, damping: {{hip: 1}}}}", "name one, g.yaml:control (control, control.arm)"),
        (WRITTEN.replace("actuators: {}", "more: {x: {joint_names_expr: [a], stiffness: 1}}"), "(scene.robot, scene.ball.more)"),
        (
            WRITTEN.replace("    init_state", "    extra: {x: {joint_names_expr: [a], stiffness: 1}}\n    init_state"),
            "(scene.robot, scene.robot.extra)",
        ),
        (f"{WRITTEN}\nkps: [1]\nkds: [1]", "name one, g.yaml:. (., scene.robot)"),
    ],
)
def test_gains_of_two_forms_are_asked_about(text: str, says: str):
    assert says in refusal(text)


def test_gains_by_part_of_a_joints_name():
    """As legged_gym's loop and those of its descendants read them: the last key in a name counts."""
    found = read(PARTS)
    assert found.kp.tolist() == [200, 90, 200, 80]
    assert found.kd.tolist() == [5, 3, 5, 2]
    assert found.postures == {"default_joint_angles": {"l_hip": 0.1, "l_knee": 0.6, "r_hip": 0.1, "r_knee": 0.7}}
    assert "'arm' is in no joint's name" in refusal(PARTS.replace('"hip"', '"arm"'))
    assert refusal(PARTS.replace("decimation: 10", "control_type: T")) == "control: control_type 'T' must be 'P', a position controller"
    assert "damping: 3 is no mapping" in refusal("control: {stiffness: {hip: 1}, damping: 3}")
    assert "damping: names no 'knee'" in refusal("control: {stiffness: {knee: 1}, damping: {hip: 3}}")
    more = PARTS.replace("decimation: 10", "arm_stiffness: {elbow: 3.0}")
    assert refusal(more) == "control: arm_stiffness: gains of further joints are read from stiffness and damping alone: write them there"
    assert read(PARTS.replace("decimation: 10", "stiffness_range: [0.9, 1.1]")).kp.tolist() == [200, 90, 200, 80]
    varied = "task: {joints: {stiffness: {range: [0.9, 1.1], operation: scaling}, damping: {range: [0.9, 1.1], operation: scaling}}}"
    assert read(PARTS + varied).kp.tolist() == [200, 90, 200, 80]
    turned = read(PARTS.replace("knee: 0.6, r_knee: 0.7", "r_knee: 0.7, knee: 0.6"))
    assert "'knee' is a part of 'r_knee', which stands before it" in turned.unread_postures["default_joint_angles"]


def test_actuators_as_isaac_lab_writes_them():
    file = parse_gains(WRITTEN, "g.yaml")
    found = gains_of(file, JOINTS)
    assert found.kp.tolist() == [25, 30, 25, 31]
    assert found.kd.tolist() == [0.5, 0.75, 0.5, 0.75]
    assert [each.get("motor_inertia") for each in found.actuators] == [0.01, None, 0.01, None]
    assert [each[0].effort_limit for each in file.matched(JOINTS)] == [33.5, 45, 33.5, 45]
    assert found.postures == {"init_state": {"l_hip": -0.4, "l_knee": 0.8, "r_hip": -0.4, "r_knee": 0.8}}
    own = (
        "articulation: {actuators: !!python/tuple [{target_names_expr: !!python/tuple [.*], stiffness: 3.0, damping: 1.0, armature: 0.02}]}"
    )
    assert read(own).kp.tolist() == [3, 3, 3, 3]
    network = WRITTEN.replace("actuator_pd:DCMotor", "actuator_net:ActuatorNetLSTM")
    assert read(network).kp.tolist() == [0, 30, 0, 31]
    assert "scene.robot: actuators.hips: left out, as it is a network" in read(network).notes[0]
    assert refusal(WRITTEN.replace("stiffness: 25.0", "stiffness: null")) == (
        "scene.robot: actuators.hips: stiffness is None: the value stands in the robot's file; write the number"
    )
    assert "actuators.knees names no joints" in refusal(WRITTEN.replace("joint_names_expr: &id002", "names:"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("kps: !Gains [1, 2, 3, 4]\nkds: [1, 1, 1, 1]", "line 1: kps: what has the tag '!Gains' is not read"),
        ("kps: [1, 2, !!python/object/apply:numpy.float64 [3], 4]\nkds: [1, 1, 1, 1]", "line 1: kps.2: what has the tag"),
        ("kps: [1, 2, 3, 4]\nkds: [1, 1, 1, 1]\njoint_names: !names [a, b, c, d]", "line 3: joint_names: "),
        ("l_hip: {kp: 1}\nrobot: !Robot {legs: {kps: [1, 2]}}", "line 2: robot: what has the tag '!Robot' is not read, and gains may"),
        ("l_hip: !Gain {kp: 1}", "line 1: l_hip: what has the tag '!Gain'"),
        ("control: {stiffness: !!python/object:x.Y {hip: 1}, damping: {hip: 1}}", "line 1: control.stiffness: what has the tag"),
        ("control: {stiffness: {hip: !!float abc}, damping: {hip: 1}}", "line 1: control.stiffness.hip: what has the tag '!!float'"),
        (WRITTEN.replace("stiffness: 25.0", "stiffness: !n 25.0"), "scene.robot.actuators.hips.stiffness: what has the tag '!n'"),
    ],
)
def test_a_tag_where_gains_stand_is_refused_with_its_line(text: str, says: str):
    assert says in refusal(text)


def test_values_used_again_are_what_yaml_says():
    text = """
        a: &a {x: 1, y: [1, &z {q: 2}]}
        b: {<<: *a, x: 3}
        c: {x: 5, <<: [*z, {q: 4, x: 6}]}
        d: [*z, *a, !!python/tuple [1], !!int '7', !!str 8, !!float 9]
        '<<': 3
    """
    found = parse_yaml(text, "f", of_others=True)
    plain = yaml.safe_load(text.replace("!!python/tuple ", "").replace("'<<'", "'<'"))
    assert {key.replace("<<", "<"): value for key, value in found.items()} == plain
    assert repr(parse_yaml("a: !!python/name:os.system ''", "f", of_others=True)["a"]) == "!!python/name:os.system in line 1"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a0: &a0 [1, 1]\n" + "\n".join(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 40)), "more than 20000 values"),
        ("a0: &a0 {x: 1}\n" + "\n".join(f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, 40)), "nested more than 20 deep"),
        ("a0: &a0 [1]\n" + "\n".join(f"a{k}: &a{k} [*a{k - 1}]" for k in range(1, 40)), "nested more than 20 deep"),
        ("a: &a [*a]", "*a is used before its value has ended"),
        ("a: {<<: 3}", "<< must be a mapping, or a list of them"),
    ],
)
def test_values_used_again_stay_within_bounds(text: str, says: str):
    with pytest.raises(GainroomError, match=r"^f: line ") as caught:
        parse_yaml(text, "f", of_others=True)
    assert says in str(caught.value)
