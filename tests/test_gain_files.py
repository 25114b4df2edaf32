"""Gains from other people's files: what is known arrives as it was meant, everything else is refused in one line."""

import contextlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.files.gain_files import gains_of, parse_gains, read_gains
from gainroom.files.gain_formats.gain_record import Gain
from gainroom.io.yaml_text import parse_yaml
from gainroom.robot.formats.model_names import locate
from mujoco_feedback import compiled_feedback
from mutations import RANDOMS, mutated_data

NAMES = ("l_hip", "l_knee", "r_hip", "r_knee")
PLAIN = """\
gains:
  default: {kp: 40.0, kd: 2.5}
  ".*_knee": {kp: 99.0, kd: 6.3, motor_inertia: 0.025}
  r_knee: {kp: 90, kd: 6, ki: 1}
"""
TRAJECTORY = """\
controller_manager:
  ros__parameters:
    update_rate: 500
    legs: {type: joint_trajectory_controller/JointTrajectoryController}
legs:
  ros__parameters:
    joints: [l_hip, l_knee]
    command_interfaces: [effort]
    gains:
      l_hip: {p: 100.0, i: 1.0, d: 2.0, i_clamp: 5.0, ff_velocity_scale: 0.0}
      l_knee: {p: 120.0, d: 3.0}
"""
PID = """\
pid_controller:
  ros__parameters:
    dof_names: [l_hip]
    command_interface: effort
    reference_and_state_interfaces: [position, velocity]
    gains: {l_hip: {p: 7.0, i: 0.0, d: 0.5, u_clamp_max: 10.0, antiwindup: true}}
"""
GROUP = """\
effort_controller:
  type: effort_controllers/JointGroupPositionController
  joints: [l_hip, l_knee]
  l_hip: {pid: {p: 14.0, i: 1.0, d: 0.4, i_clamp_min: -5.0}}
  l_knee: {pid: {p: 15.0, d: 0.5}}
"""
SINGLE = """\
one_controller: {type: effort_controllers/JointPositionController, joint: l_hip, pid: {p: 4000.0, d: 200, i: 1}}
two_controller: {type: effort_controllers/JointPositionController, joint: l_knee, pid: {p: 10.0}}
"""
GAZEBO = "gazebo_ros_control: {pid_gains: {l_hip: {p: 10.0, i: 0.0, d: 1.0}}}\n"
MJCF = """\
<mujoco>
  <worldbody>
    <body name="thigh"><joint name="hip" axis="0 1 0" damping="3" armature="0.1"/>
      <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="shank" pos="0 0 -0.2"><joint name="knee" axis="0 1 0"/>
        <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></body>
  </worldbody>
  <actuator>ACTUATORS</actuator>
</mujoco>
"""


def refusal(text: str) -> str:
    with pytest.raises(GainroomError) as caught:
        gains_of(parse_gains(text, "gains.yaml"), NAMES)
    assert all(message.startswith("gains.yaml") and "\n" not in message for message in caught.value.problems)
    return caught.value.problems[0].removeprefix("gains.yaml: ")


def test_plain_patterns_later_wins():
    file = parse_gains(PLAIN, "f")
    found = gains_of(file, NAMES)
    assert file.form == "plain"
    assert_allclose(found.kp, [40, 99, 40, 90])
    assert_allclose(found.kd, [2.5, 6.3, 2.5, 6])
    assert_allclose(found.ki, [0, 0, 0, 1])
    assert_allclose(found.motor_inertia, [np.nan, 0.025, np.nan, 0.025])  # what the later entry does not name stays
    assert found.given.all()


def test_plain_without_a_heading_and_as_pairs():
    section = parse_yaml(PLAIN, "f")["gains"]
    assert parse_gains(yaml.safe_dump(section, sort_keys=False), "f").gains == parse_gains(PLAIN, "f").gains
    assert parse_gains("l_hip: [40, 2.5]\nl_knee: [1, 0]", "f").gains == {"l_hip": Gain(40, 2.5), "l_knee": Gain(1, 0)}


def test_json_with_tabs(tmp_path: Path):
    path = tmp_path / "gains.json"
    path.write_text(json.dumps(parse_yaml(PLAIN, "f"), indent="\t"), "utf-8")
    assert read_gains(path).gains == parse_gains(PLAIN, "f").gains


def test_joints_without_gains_are_told_apart():
    found = gains_of(parse_gains("l_hip: {kp: 1}\nl_knee: {kp: 0, kd: 0}", "f"), NAMES)
    assert found.given.tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("text", "gains"),
    [
        (TRAJECTORY, {"l_hip": Gain(100, 2, 1), "l_knee": Gain(120, 3)}),
        (PID, {"l_hip": Gain(7, 0.5)}),
        (GROUP, {"l_hip": Gain(14, 0.4, 1), "l_knee": Gain(15, 0.5)}),
        (SINGLE, {"l_hip": Gain(4000, 200, 1), "l_knee": Gain(10)}),
        (GAZEBO, {"l_hip": Gain(10, 1)}),
        ("robot: {controllers: " + json.dumps(parse_yaml(GROUP, "f")) + "}", {"l_hip": Gain(14, 0.4, 1), "l_knee": Gain(15, 0.5)}),
        ("l_hip: {p: 1.0, d: 2}", {"l_hip": Gain(1, 2)}),
    ],
)
def test_ros2_control(text: str, gains: dict[str, Gain]):
    file = parse_gains(text, "f")
    assert (file.form, dict(file.gains), file.notes) == ("ros2_control", gains, ())


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("command_interfaces: [effort]", "command_interfaces: [velocity]", "commands velocity, not effort"),
        ("command_interfaces: [effort]", "command_interfaces: [position]", "commands position, not effort"),
        ("legs: {type: joint_trajectory_controller/", "legs: {type: position_controllers/", "is a 'position_controllers/"),
    ],
)
def test_gains_that_make_no_torque_are_left_out(old: str, new: str, says: str):
    text = TRAJECTORY.replace(old, new)
    assert f"no controller here commands torque: legs.ros__parameters.gains.l_hip: left out, as it {says}" in refusal(text)
    file = parse_gains(text + "arm: {ros__parameters: {command_interfaces: [effort], gains: {r_hip: {p: 5}}}}\n", "f")
    assert dict(file.gains) == {"r_hip": Gain(5)}
    assert len(file.notes) == 2


def test_a_velocity_loop_is_no_position_gain():
    assert "follows 'velocity', not position" in refusal(PID.replace("[position, velocity]", "[velocity]"))
    assert "JointVelocityController" in refusal(SINGLE.replace("JointPosition", "JointVelocity"))


@pytest.mark.parametrize(
    ("text", "start", "contains"),
    [
        ("", "is empty", ""),
        ("[1, 2]", "holds no gains in a known form", "{kp, kd}"),
        ("a: 1", "holds no gains in a known form", "ros2_control"),
        ("l_hip: {stiffness: 3}", "holds no gains in a known form", "MJCF"),
        ("l_hip: {kp: -1}", "l_hip.kp: -1 must be >= 0", ""),
        ("gains: {l_hip: {kp: 1, kd: .nan}}", "gains.l_hip.kd: nan is not a number", ""),
        ("gains: {l_hip: {kp: .inf}}", "gains.l_hip.kp: inf must be <= 1e+12", ""),
        ("gains: {l_hip: {kp: 10 Nm}}", "gains.l_hip.kp: '10 Nm' is text", ""),
        ("gains: {l_hip: {kp: 1, kdd: 2}}", "gains.l_hip.kdd: unknown key", "did you mean kd?"),
        ("gains: {l_hip: {kp: 1, kv: 2}}", "gains.l_hip.kv: unknown key; did you mean kd", "P/PI control"),
        ("gains: {l_hip: {kp: 1, d: 2}}", "gains.l_hip.d: unknown key; did you mean kd?", ""),
        ("gains: {l_hip: {kp: 1, kd: -2}}", "gains.l_hip.kd: -2 must be >= 0", ""),
        ("gains: {l_hip: {kd: 2}}", "gains.l_hip.kp is missing", ""),
        ("gains: {l_hip: [1]}", "gains.l_hip: [1] must be [kp, kd]", ""),
        ("gains: {l_hip: {kp: 1}}\nrate: 3", "rate: unknown key", ""),
        ('".*_hip": {kp: 1}\n".*_elbow": {kp: 2}', "gains.'.*_elbow' matches no joint", "l_hip"),
        ("l_kne: {kp: 1}", "gains.'l_kne' matches no joint", "did you mean 'l_knee'?"),
        ('"(": {kp: 1}', "gains.'(' is not a regular expression", ""),
        ("l_hip: {kp: 0}", "all gains are zero", ""),
        (TRAJECTORY.replace("p: 100.0", "p: -100.0"), "legs.ros__parameters.gains.l_hip.p: -100.0 must be >= 0", ""),
        (TRAJECTORY.replace("d: 2.0", "d: .nan"), "legs.ros__parameters.gains.l_hip.d: nan is not a number", ""),
        (TRAJECTORY.replace("p: 120.0", "pp: 120.0"), "legs.ros__parameters.gains.l_knee.pp: unknown key beside p, i, d", ""),
        (TRAJECTORY.replace("p: 120.0", "P: 120.0"), "legs.ros__parameters.gains.l_knee.P: unknown key", "did you mean p?"),
        (TRAJECTORY.replace("d: 3.0", "kd: 3.0"), "legs.ros__parameters.gains.l_knee.kd: unknown key", ""),
        (
            TRAJECTORY.replace("p: 120.0, ", ""),
            "legs.ros__parameters.gains.l_knee.p is missing: the gain on position [N·m/rad], and holds d",
            "write 0",
        ),
        (TRAJECTORY.replace("i_clamp: 5", "i_clmp: 5"), "legs.ros__parameters.gains.l_hip.i_clmp: unknown key", "did you mean i_clamp?"),
        (TRAJECTORY.replace("p: 120.0, d: 3.0", "prop: 120.0"), "legs.ros__parameters.gains.l_knee: must hold p, i and d", "holds prop"),
        (TRAJECTORY.replace("p: 120.0, d: 3.0", ""), "legs.ros__parameters.gains.l_knee: must hold p, i and d", ""),
        (TRAJECTORY.replace("{p: 120.0, d: 3.0}", "null"), "legs.ros__parameters.gains.l_knee: nothing must be a section with p, i", ""),
        (GROUP.replace("{p: 15.0, d: 0.5}", "null"), "effort_controller.l_knee.pid: nothing must be a section with p, i", ""),
        (GROUP.replace("{p: 15.0, d: 0.5}", "15.0"), "effort_controller.l_knee.pid: 15.0 must be a section with p, i", ""),
        (TRAJECTORY.replace("p: 120.0", "p: [120.0]"), "legs.ros__parameters.gains.l_knee.p: [120.0] is not a number", ""),
        (TRAJECTORY.replace("p: 120.0", "p: {x: 120.0}"), "legs.ros__parameters.gains.l_knee.p: {'x': 120.0} is not a number", ""),
        (TRAJECTORY.replace("p: 120.0", "p: '120.0'"), "legs.ros__parameters.gains.l_knee.p: '120.0' is text", ""),
        (TRAJECTORY.replace("p: 120.0", "p: true"), "legs.ros__parameters.gains.l_knee.p: true is not a number", ""),
        (GROUP.replace("p: 14.0, i: 1.0", "p: [14.0], i: 1.0"), "effort_controller.l_hip.pid.p: [14.0] is not a number", ""),
        (GROUP.replace("p: 15.0, d: 0.5", "x: 15.0"), "effort_controller.l_knee.pid: must hold p, i and d", ""),
        (GAZEBO.replace("i: 0.0", "l: 0.0"), "gazebo_ros_control.pid_gains.l_hip.l: unknown key beside p, i, d", ""),
        (TRAJECTORY + GAZEBO, "joint 'l_hip' has gains twice, in legs.ros__parameters.gains.l_hip and in gazebo", "leave one"),
        (TRAJECTORY.replace("l_knee", "l_elbow"), "gains.'l_elbow' matches no joint", ""),
        ("gains: {p: 1, d: 2}", "gains: p, i, d stand under no joint's name", ""),
        ("p: 1", "at the top: p, i, d stand under no joint's name", ""),
        ("a: &x {kp: 1}\nb: *y", "line 2, column 4: *y is used before its value has ended", ""),
        ("a: !!python/object/apply:os.getcwd []", "holds no gains in a known form", "found a: !!python/object/apply:os.getcwd in line 1"),
    ],
)
def test_what_is_wrong_is_named(text: str, start: str, contains: str):
    message = refusal(text)
    assert message.startswith(start)
    assert contains in message


def write_mjcf(folder: Path, actuators: str) -> Path:
    path = folder / "robot.xml"
    path.write_text(MJCF.replace("ACTUATORS", actuators), "utf-8")
    return path


def test_mjcf_position_actuators(tmp_path: Path):
    """<position> is kp (u − q) − kv q̇; an affine <general> with gear g pushes with g (b1 g q + b2 g q̇) on its joint."""
    path = write_mjcf(
        tmp_path,
        '<position joint="hip" kp="50" kv="2"/>'
        '<general joint="knee" biastype="affine" gainprm="30" biasprm="0 -30 -1.5" gear="2"/><motor joint="hip"/>',
    )
    file = read_gains(path)
    assert (file.form, file.notes) == ("MJCF", ())
    assert dict(file.gains) == {"hip": Gain(50.0, 2.0), "knee": Gain(120.0, 6.0)}


@pytest.mark.parametrize(
    "actuator",
    [
        '<position joint="JOINT" kp="50" dampratio="0.7"/>',
        '<position joint="JOINT" kp="50" kv="2" gear="3" timeconst="0.01"/>',
        '<intvelocity joint="JOINT" kp="30" kv="1" actrange="-1 1"/>',
        '<velocity joint="JOINT" kv="4"/><position joint="JOINT" kp="20"/>',
        '<pid joint="JOINT" kp="50" kv="2"/>',
        '<general jointinparent="JOINT" biastype="affine" gainprm="3" biasprm="1 -30 -1.5" gear="-2"/>',
    ],
)
def test_mjcf_actuators_push_as_mujoco_has_them(tmp_path: Path, actuator: str):
    path = write_mjcf(tmp_path, actuator.replace("JOINT", "hip") + actuator.replace("JOINT", "knee"))
    found = read_gains(path).gains
    for joint, (kp, kd) in compiled_feedback(path).items():  # linear laws: differences are exact but for round-off
        assert (found[joint].kp, found[joint].kd) == pytest.approx((kp, kd), rel=1e-8, abs=1e-8)


def test_mjcf_dampratio_by_hand(tmp_path: Path):
    """kv = 2 ζ sqrt(kp M) of a single joint: M = 0.01 + 1 · 0.1² of the link and 0.1 of armature [kg m²]."""
    path = tmp_path / "robot.xml"
    text = MJCF.replace("ACTUATORS", '<position joint="hip" kp="50" dampratio="0.7"/>')
    path.write_text(re.sub(r'<body name="shank".*?</body>', "", text, flags=re.DOTALL), "utf-8")
    assert read_gains(path).gains == {"hip": Gain(50.0, pytest.approx(2 * 0.7 * (50 * 0.12) ** 0.5))}


def test_mjcf_integral_limits_and_what_is_left_out(tmp_path: Path):
    path = write_mjcf(
        tmp_path,
        '<pid joint="hip" kp="50" kv="2" ki="7" gear="2" forcerange="-30 20"/>'
        '<position joint="knee" kp="5" kv="1" delay="0.01" nsample="5"/>'
        '<muscle name="biceps" joint="knee" lengthrange="0 1"/><general name="bent" joint="knee" gaintype="affine" gainprm="1 1 1"/>',
    )
    file = read_gains(path)
    assert dict(file.gains) == {"hip": Gain(200, 8, 28, effort_limit=60), "knee": Gain(5, 1)}
    assert file.notes == (
        "actuators that are no torque on one joint are left out: biceps, bent",
        "the delay of these joints' actuators delays the set-point, not the feedback, and does not count: knee",
    )


def test_mjcf_joint_damping_is_not_the_controllers(tmp_path: Path):
    file = read_gains(write_mjcf(tmp_path, '<position joint="hip" kp="50"/>'))
    assert dict(file.gains) == {"hip": Gain(50.0, 0.0)}
    assert "hip" in file.notes[0]
    assert "damping" in file.notes[0]


@pytest.mark.parametrize(
    ("actuators", "says"),
    [
        ('<motor joint="hip"/>', "no actuator feeds position back"),
        ('<general joint="hip" biastype="affine" biasprm="0 5 0"/>', "actuator of joint 'hip': kp: -5.0 must be >= 0"),
    ],
)
def test_mjcf_without_gains(tmp_path: Path, actuators: str, says: str):
    with pytest.raises(GainroomError, match=says):
        read_gains(write_mjcf(tmp_path, actuators))


def test_a_urdf_holds_no_gains():
    with pytest.raises(GainroomError, match=r"biped.urdf: holds no gains: no actuator feeds position back .* give --gains"):
        read_gains(locate("gainroom:biped.urdf"))


@st.composite
def mutated_gains(draw: st.DrawFn) -> str:
    random = draw(RANDOMS)
    data = parse_yaml(random.choice([PLAIN, TRAJECTORY, PID, GROUP, SINGLE, GAZEBO]), "f")
    for _ in range(random.randint(1, 3)):
        data = mutated_data(random, data)
    return yaml.safe_dump(data, allow_unicode=True)


@pytest.mark.slow
@settings(max_examples=250, deadline=None, suppress_health_check=list(HealthCheck))
@given(text=mutated_gains())
def test_mutated_files_are_read_or_refused_in_one_line(text: str):
    problems = ()
    with contextlib.suppress(UnicodeEncodeError):
        try:
            gains_of(parse_gains(text, "gains.yaml"), NAMES)
        except GainroomError as error:
            problems = error.problems
    assert all(message.startswith("gains.yaml") and "\n" not in message for message in problems)


def test_what_is_not_known_beside_gains_is_told():
    file = parse_gains(TRAJECTORY.replace("d: 3.0", "d: 3.0, wraps_at_pi: true"), "f")
    assert file.notes == ("legs.ros__parameters.gains.l_knee: does not count, as it is not known here: wraps_at_pi",)
    assert file.gains["l_knee"] == Gain(120, 3)


def test_joints_may_be_called_as_the_terms_are():
    assert dict(parse_gains("gains: {p: {p: 1, d: 2}, d: {p: 3.0}}", "f").gains) == {"p": Gain(1, 2), "d": Gain(3)}
