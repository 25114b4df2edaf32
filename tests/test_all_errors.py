"""Everything that is wrong in a file is said in one run: one line each, with file, key, value and what is allowed."""

import copy
import math
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings, strategies as st

from gainroom.cli import main
from gainroom.cli.example import example_texts, joint_examples
from gainroom.errors import MOST_PROBLEMS, GainroomError, Together, UnjudgedError
from gainroom.files.audit_options import AuditOptions
from gainroom.files.gain_files import gains_of, parse_gains, read_gains
from gainroom.files.joint_yaml import parse_joint, parse_simulation
from gainroom.files.logs.options import LogOptions, load_options
from gainroom.files.robot_yaml import parse_robot
from gainroom.files.simulator_options import SimulatorOptions
from gainroom.files.sweep_options import SweepOptions, sweep_plan
from gainroom.io.yaml_text import parse_yaml
from gainroom.robot.formats.model_files import load_model

TESTBED = joint_examples()["testbed-simulated"]
BIPED = example_texts()["biped"]


def refused(make, *arguments) -> tuple[str, ...]:
    with pytest.raises(GainroomError) as caught:
        make(*arguments)
    assert all("\n" not in problem for problem in caught.value.problems)
    return caught.value.problems


def assert_each_said_once(problems: tuple[str, ...], begins: list[str]) -> None:
    """Each line begins with one of the texts, and each text begins one line."""
    assert sorted(next((text for text in begins if problem.startswith(text)), problem) for problem in problems) == sorted(begins)


JOINT = """
joint: {motor_inertia: -1, link_inertia: "16,0", stifness: 1.0e4, damping: 1}
drive: {bandwidth: 4000.0, delay_ms: 2.0, delay_ticks: 3}
control: {type: pd, kp: 1.0e4, kv: 300.0, feedback: mtor, sample_rate_hz: 2000, notches: [{frequency_hz: 80, depth: 2}, {}]}
limits: {gain_margin_db: -6.0, phase: 3}
uncertainty: {stiffness: [3, 2], damping: 200%}
scenario: {duration: 1, reference: {type: step, start: 2}, noise: 5}
extra: 1
"""
IN_JOINT = [
    "extra: unknown key",
    "drive: give either delay_ms or delay_ticks",
    "control.feedback: 'mtor' must be motor or link; did you mean motor?",
    "control.notches[0].depth: 2 must be <= 1",
    "control.notches[1]: give either frequency",
    "control.kv is not a gain of type pd, which has kp, kd; did you mean kd?",
    "limits.phase: unknown key",
    "limits.gain_margin_db: -6.0 must be > 0",
    "uncertainty.stiffness: [3, 2] must be [low, high] with low <= high",
    "uncertainty.damping: '200%' must be less than 100%",
    "joint.stifness: unknown key; did you mean stiffness?",
    "joint.motor_inertia: -1 must be > 0",
    "joint.link_inertia: '16,0' is text and must be a number: the decimal sign is a point, 16.0",
    "scenario.reference.by is missing",
    "scenario.reference.start: 2 s must be before the run ends",
    "scenario.noise: 5 must be <= 1",
]


def test_everything_in_a_joint_yaml():
    assert_each_said_once(refused(parse_joint, JOINT, "knee.yaml"), [f"knee.yaml: {text}" for text in IN_JOINT])


def test_what_contradicts_itself_in_several_sections():
    """Each of these files' own values is right alone."""
    text = """
joint: {motor_inertia: 1, rotor_inertia: 1, link_inertia: 16.0, stiffness: 1.0e4, damping: 1}
drive: {bandwidth: 4000.0, delay_ms: 2.0, sample_rate_hz: 100}
control: {type: pd, kp: 1.0e4, kd: 300.0, feedback: motor, sample_rate_hz: 2000, velocity_filter: {bandwidth: 10000},
  notches: [{frequency_hz: 1100}]}
uncertainty: {delay_ms: [3, 4]}
"""
    begins = [
        "joint: rotor_inertia has no meaning beside motor_inertia",
        "drive.sample_rate_hz: 100.0 must equal control.sample_rate_hz 2000.0",
        "control.velocity_filter.bandwidth: 10000 rad/s must be below half the sample rate",
        "control.notches[0].frequency_hz: 1100 Hz must be below half the sample rate",
    ]
    assert_each_said_once(refused(parse_joint, text, "knee.yaml"), [f"knee.yaml: {each}" for each in begins])


def test_a_relation_is_judged_beside_a_wrong_value_elsewhere():
    """The wrong stiffness hides neither the range of the delay, nor the motor that is not described."""
    text = """
joint: {link_inertia: 16.0, stiffness: -1, damping: 1}
drive: {bandwidth: 4000.0, delay_ms: 2.0}
control: {type: pd, kp: 1.0e4, kd: 300.0, feedback: motor}
uncertainty: {delay_ms: [3, 4], stiffness: 20%}
"""
    begins = ["joint.stiffness: -1 must be > 0", "joint.motor_inertia is missing", "uncertainty.delay_ms: [3.0, 4.0] must contain"]
    assert_each_said_once(refused(parse_joint, text, "knee.yaml"), [f"knee.yaml: {each}" for each in begins])


def test_one_mistake_is_one_line():
    """What only follows from a wrong value is not said beside it."""
    for old, new in (("stiffness:", "stifness:"), ("delay_ms:", "delay:"), ("type: pd", "type: pdd"), ("kd:", "kv:"), ("kp: ", "kp: -")):
        assert TESTBED.count(old) == 1, old
        assert len(refused(parse_simulation, TESTBED.replace(old, new), "knee.yaml")) == 1, new


def test_a_scenario_is_judged_beside_the_joint():
    text = TESTBED.replace("damping: ", "damping: -").replace("duration:", "durations:", 1)
    assert len(refused(parse_simulation, text, "knee.yaml")) == 2


ROBOT = """
model: {package: gainroom, file: biped.urdf, base: floating}
joints:
  default: {rotor_inertia: 1.0e-4, gear_ratio: 100, stiffness: 1.0e4, damping: 1.0}
  ".*_elbow": {gear_ratio: 144}
  foo: 7
drive: {bandwidth: fast, delay_ms: 2.0}
postures: {stand: {".*_hip_pitch": -0.3, ".*_kne": 0.6, "x": 1}, low: {left_knee: 90°}}
contacts: {double: [left_sole, right_sol], left: [left_sole, {fram: 3}], flight: 5, twice: [left_sole, left_sole]}
control: {type: pd, space: joint, feedback: motor, kp: {left_kne: 1}, kd: 100.0}
tasks: [{name: com, type: com, kp: [50, -90, -200], kd: [1, 5, 15]}, {name: com, type: orientation, frame: pelvs, kp: 100, kd: 20}]
scenario: {posture: up, move: {task: com, by: 0.1}, torque_limit: {".*_wrist": 5}}
"""
IN_ROBOT = [
    "joints.foo: 7 must be a section",
    "joints.'.*_elbow' matches no joint",
    "drive.bandwidth: 'fast' is text",
    "postures.low.left_knee: '90°' is text",
    "postures.stand.'.*_kne' matches no joint",
    "postures.stand.'x' matches no joint",
    "contacts.left[1].fram: unknown key; did you mean frame?",
    "contacts.flight: 5 must be a list",
    "contacts.twice: frame 'left_sole' is used 2 times",
    "contacts.double[1]: the robot has no frame 'right_sol'",
    "control.kp.'left_kne' matches no joint",
    "tasks[0].kp[1]: -90 must be >= 0",
    "tasks[0].kp[2]: -200 must be >= 0",
    "tasks[1].frame: the robot has no frame 'pelvs'",
    "tasks[1].name: 'com' is the name of two tasks",
    "scenario.posture: 'up' is none of the file's",
    "scenario.move: control.space is joint: give joint",
    "scenario.torque_limit.'.*_wrist' matches no joint",
]


def test_everything_in_a_robot_yaml():
    pytest.importorskip("pinocchio")
    assert_each_said_once(refused(parse_robot, ROBOT, "robot.yaml"), [f"robot.yaml: {text}" for text in IN_ROBOT])


def test_what_does_not_need_the_model_is_judged_without_it():
    text = ROBOT.replace("file: biped.urdf", "file: none.urdf")
    problems = refused(parse_robot, text, "robot.yaml")
    assert any("none.urdf" in problem for problem in problems)
    assert [text for text in IN_ROBOT if any(problem.startswith(f"robot.yaml: {text}") for problem in problems)] == [
        text for text in IN_ROBOT if "matches no" not in text and "has no frame" not in text and "is used" not in text
    ]


def test_a_command_prints_each_and_exits_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "knee.yaml"
    file.write_text(JOINT, "utf-8")
    assert main(["joint", str(file), "--report", str(tmp_path / "page.html")]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert len(lines := error.splitlines()) == len(IN_JOINT)
    assert all(line.startswith(f"gainroom: error: {file}: ") for line in lines)
    assert not (tmp_path / "page.html").exists()


def test_lines_are_bounded(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "knee.yaml"
    file.write_text(f"{joint_examples()['testbed']}\n" + "".join(f"what{k}: 1\n" for k in range(MOST_PROBLEMS + 7)), "utf-8")
    assert main(["joint", str(file)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == MOST_PROBLEMS + 1
    assert lines[-1] == "gainroom: error: and 7 more"


@given(st.lists(st.sampled_from(["motor_inertia", "link_inertia", "stiffness", "damping"]), min_size=1, unique=True))
@settings(max_examples=15, deadline=None)
def test_whatever_numbers_are_wrong_each_has_its_line(names: list[str]):
    values = dict.fromkeys(("motor_inertia", "link_inertia", "stiffness", "damping"), "1") | dict.fromkeys(names, "-1")
    text = f"joint: {{{', '.join(f'{name}: {value}' for name, value in values.items())}}}\n"
    text += "drive: {bandwidth: 4000.0, delay_ms: 2.0}\ncontrol: {type: pd, kp: 1.0e4, kd: 300.0, feedback: motor}\n"
    assert_each_said_once(refused(parse_joint, text, "f"), [f"f: joint.{name}: -1 must be" for name in names])


LEGS = ("left_hip", "left_knee", "right_hip", "right_knee")
ROS2 = """
legs:
  ros__parameters:
    gains:
      left_hip: {p: -1, d: 2}
      left_knee: {p: 100, dd: 2, i: high}
      right_hip: {d: 2}
      right_knee: 5
"""
ISAAC = """
from isaaclab.actuators import ImplicitActuatorCfg
from isaaclab.assets import ArticulationCfg

ROBOT = ArticulationCfg(actuators={
    "hips": ImplicitActuatorCfg(joint_names_expr=[".*_hip", 5], stiffness=-25.0, damping=None),
    "knees": ImplicitActuatorCfg(joint_names_expr=[".*_knee"], stiffness={"left_.*": 25.0, "right_.*": "much"}, damping=0.5, armature=-1),
})
"""
GYM = """
class Robot:
    class control:
        control_type = "P"
        stiffness = {"hip": -100, "knee": "much"}
        damping = {"hip": 2, "knee": -1}
    class asset:
        armature = -0.1
"""
FORMATS = {
    "plain.yaml": (
        "left_hip: {kp: -1, kd: 2}\nleft_knee: {kp: 1, kdd: 2}\nright_hip: [1]\nright_knee: {kd: 2, motor_inertia: 0}\n",
        [
            "left_hip.kp: -1 must be >= 0",
            "left_knee.kdd: unknown key; did you mean kd?",
            "right_hip: [1] must be [kp, kd]",
            "right_knee.kp is missing",
            "right_knee.motor_inertia: 0 must be > 0",
        ],
    ),
    "beside.yaml": (
        "gains:\n  left_hip: {kp: -1}\n  left_knee: {kd: 2}\ngains_run: split\nsample_rate_hz: 0\ndrive_rate_hz: fast\n",
        [
            "gains.left_hip.kp: -1 must be >= 0",
            "gains.left_knee.kp is missing",
            "sample_rate_hz: 0 must be >= 1",
            "drive_rate_hz: 'fast' is text",
            "drive_delay_ms is missing, which gains_run: split needs",
        ],
    ),
    "names.yaml": (
        "left_hipp: {kp: 1}\nknee: {kp: 1}\nright_hip: {kp: 1}\n",
        ["gains.'left_hipp' matches no joint", "gains.'knee' matches no joint"],
    ),
    "arrays.yaml": (
        "kps: [1, -2, 3, x]\nkds: [-1, 1, 1, 1]\n",
        ["kps[1]: -2 must be >= 0", "kps[3]: 'x' is text", "kds[0]: -1 must be >= 0"],
    ),
    "order.json": (
        '{"joint_names": ["left_hip", "knee", "hip", "right_knee"], "kps": [1, 1, 1, 1], "kds": [1, 1, 1, 1]}',
        ["joint_names: 'knee' is no joint of the model", "joint_names: 'hip' is no joint of the model"],
    ),
    "lengths.json": (
        '{"joint_names": ["left_hip", "left_knee"], "kps": [1, 1, 1, 1], "kds": [1, 1, 1]}',
        ["kps has 4 numbers and kds 3", "joint_names has 2 entries and kps 4 numbers"],
    ),
    "ros2.yaml": (
        ROS2,
        [
            "legs.ros__parameters.gains.left_hip.p: -1 must be >= 0",
            "legs.ros__parameters.gains.left_knee.dd: unknown key beside p, i, d",
            "legs.ros__parameters.gains.left_knee.i: 'high' is text",
            "legs.ros__parameters.gains.right_hip.p is missing",
            "legs.ros__parameters.gains.right_knee: 5 must be a section with p, i and d",
        ],
    ),
    "isaac.py": (
        ISAAC,
        [
            "line 6: ImplicitActuatorCfg: joint_names_expr: 5 must be a name or pattern",
            "line 6: ImplicitActuatorCfg: stiffness: -25.0 must be >= 0",
            "line 6: ImplicitActuatorCfg: damping is None",
            "line 7: ImplicitActuatorCfg: stiffness.'right_.*': 'much' is text",
            "line 7: ImplicitActuatorCfg: armature: -1 must be >= 0",
        ],
    ),
    "gym.py": (
        GYM,
        [
            "line 3: Robot.control: stiffness.hip: -100 must be >= 0",
            "line 3: Robot.control: stiffness.knee: 'much' is text",
            "line 3: Robot.control: damping.knee: -1 must be >= 0",
            "Robot.asset: armature: -0.1 must be >= 0",
        ],
    ),
    "moteus.cfg": (
        "servo.pid_position.kp -4.0\nservo.pid_position.kd much\nservo.pid_position.ki 1\nservo.pid_position.ki 2\n",
        [
            "line 1: servo.pid_position.kp: -4.0 must be >= 0",
            "line 2: servo.pid_position.kd: 'much' must be a number",
            "line 4: servo.pid_position.ki: is given twice",
        ],
    ),
    "moteus.yaml": (
        "moteus:\n  left_hip: {kp: -1}\n  left_knee: {kpp: 1}\n",
        ["moteus.left_hip.kp: -1 must be >= 0", "moteus.left_knee.kpp: unknown key; did you mean kp?"],
    ),
    "robot.h": (
        "float Kp[4] = {1, a, 3, b};\nfloat Kd[4] = {1, 1, 1, c};\n",
        ["line 1: Kp: 'a' must be a number", "line 1: Kp: 'b' must be a number", "line 2: Kd: 'c' must be a number"],
    ),
    "isaac.yaml": (
        "actuators:\n  hips: {joint_names_expr: ['.*_hip'], stiffness: -1, damping: x}\n"
        "  knees: {joint_names_expr: ['.*_knee'], stiffness: 1}\n",
        ["actuators.hips: stiffness: -1 must be >= 0", "actuators.hips: damping: 'x' is text", "actuators.knees: damping is missing"],
    ),
}


@pytest.mark.parametrize("name", FORMATS)
def test_everything_in_a_file_of_gains(tmp_path: Path, name: str):
    text, begins = FORMATS[name]
    (tmp_path / name).write_text(text, "utf-8")
    problems = refused(lambda: gains_of(read_gains(tmp_path / name), LEGS))
    assert_each_said_once(problems, [f"{tmp_path / name}: {each}" for each in begins])


def test_one_cause_of_many_numbers_is_said_once(tmp_path: Path):
    """A motor's constant that comes from elsewhere stands in stiffness, damping and armature of every actuator."""
    text = ISAAC.replace("ROBOT", "MOTOR = made_elsewhere(3)\nROBOT", 1)
    text = text.replace("-25.0", "MOTOR").replace("None", "MOTOR").replace(", 5]", "]").replace('"much"', "MOTOR")
    (tmp_path / "r.py").write_text(text, "utf-8")
    problems = refused(lambda: gains_of(read_gains(tmp_path / "r.py"), LEGS))
    assert sum("made_elsewhere" in problem for problem in problems) == 1
    assert len(problems) == 2  # and the armature


class TestTogether:
    def test_steps_and_the_end_of_the_block(self):
        def fails(*texts: str) -> int:
            raise GainroomError(*texts)

        def block() -> None:
            with Together() as together:
                one = together.step(lambda: 1)
                two = together.step(lambda: fails("two", "twice"))
                together.step(lambda: two() + one())
                together.step(lambda: fails("three", "two"))
                assert one() == 1
                two()

        assert refused(block) == ("two", "twice", "three")

    def test_the_only_error_keeps_its_cause(self):
        cause = GainroomError("alone")

        def block() -> None:
            with Together() as together:
                together.add(cause)

        with pytest.raises(GainroomError) as caught:
            block()
        assert caught.value is cause

    def test_other_errors_pass(self):
        def block() -> None:
            with Together() as together:
                together.add(GainroomError("one"))
                raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            block()

    def test_what_was_never_judged_is_no_answer(self):
        """A block that asks for what no step has made, and says nothing of why, has a fault of its own."""
        with pytest.raises(UnjudgedError), Together():
            raise UnjudgedError


def test_faults_of_the_text_are_said_beside_those_of_its_values():
    text = JOINT.replace("extra: 1", "extra: 1\nlimits: {}\n5: 6\n").replace(
        "gain_margin_db: -6.0", "gain_margin_db: 1e999, gain_margin_db: 3"
    )
    begins = [f"knee.yaml: {each}" for each in IN_JOINT if "gain_margin_db" not in each]
    begins += [f"knee.yaml: line {each}" for each in ("5, column 26: '1e999' is too large", "5, column 33: key 'gain_margin_db' is given")]
    begins += ["knee.yaml: line 9, column 1: key 'limits' is given twice", "knee.yaml: line 10, column 1: a key must be a word"]
    assert_each_said_once(refused(parse_joint, text, "knee.yaml"), begins)
    with pytest.raises(GainroomError) as caught:
        parse_gains("left_hip: {kp: 1, kp: 2}\nleft_knee: {kp: 1e999, kd: -1}\n", "g.yaml")
    assert_each_said_once(
        caught.value.problems,
        [
            "g.yaml: line 1, column 19: key 'kp' is given twice",
            "g.yaml: line 2, column 17: '1e999' is too",
            "g.yaml: left_knee.kd: -1 must",
        ],
    )


def test_options_of_an_audit_are_judged_together():
    problems = refused(lambda: AuditOptions(2.0, gains_run="split", base="floor", damping=3.0, joint_damping="some"))
    begins = ["--gains-run split: needs --drive-rate-hz", "--gains-run split: needs --drive-delay-ms", "--base floor: must be"]
    begins += ["--damping 3: is of elastic", "--joint-damping some: must be"]
    assert_each_said_once(problems, begins)
    problems = refused(lambda: SimulatorOptions(timestep=-1, integrator="best", decimation=0))
    begins = [
        "--timestep: goes with --simulator mujoco",
        "--timestep: -1 must be > 0",
        "--integrator 'best': must be",
        "--decimation 0: must",
    ]
    assert_each_said_once(problems, begins)


def test_options_of_a_log_are_judged_together(tmp_path: Path):
    begins = ["columns: unknown channel 'torq'", "units: time:", "rotor_side: unknown channel 'x'", "log: end 1 s must be > start 2 s"]
    problems = refused(lambda: LogOptions(columns={"torq": "a"}, units={"time": "feet"}, rotor_side=("x",), gear_ratio=2, start=2, end=1))
    assert_each_said_once(problems, begins)
    file = tmp_path / "log.yaml"
    file.write_text("columns: {time: [1], torq: a}\nunits: {time: true}\ngear_ratio: -3\nrotor_side: [motor_position]\nend: 0\n", "utf-8")
    begins = ["columns.time: [1] must be a name", "units.time: true must be a name", "gear_ratio: -3 must be > 0", "end: 0 must be > 0"]
    assert_each_said_once(refused(load_options, file), [f"{file}: {each}" for each in begins])


def test_options_of_a_sweep_are_judged_together():
    pytest.importorskip("pinocchio")
    system = parse_robot(BIPED, "robot.yaml")
    options = SweepOptions(
        samples=5, grid=("left_knee=0:1", "left_kne=0:1:3"), ranges=("x",), contacts=("ground", "left"), seed=-1, posture="crouching"
    )
    begins = ["--samples and --grid: only one", "--range goes with --samples", "--seed -1 must be >= 0", "--contact: 'ground' is not one"]
    begins += ["--posture: 'crouching' is not one", "--grid: 'left_knee=0:1' must be", "--grid: 'left_kne' matches no joint"]
    assert_each_said_once(refused(sweep_plan, system, options), [*begins, "--range: 'x' must be"])


def test_a_scenario_and_its_joint_are_judged_against_each_other(tmp_path: Path):
    text = TESTBED.replace("scenario:", "scenario:\n  jitter_ms: 50\n  feedforward: none.csv", 1)
    place = text.index("  reference:")
    text = text[:place] + "  reference: {type: chirp, amplitude: 0.1, first_hz: 1, last_hz: 1.0e6, duration: 1}\n"
    begins = ["scenario.jitter_ms: 50 must be <= the drive's delay", "scenario.reference.last_hz: 1e+06 Hz must be below half"]
    problems = refused(parse_simulation, text, "knee.yaml")
    assert [text for text in begins if any(problem.startswith(f"knee.yaml: {text}") for problem in problems)] == begins
    assert any("none.csv: no such file" in problem for problem in problems)


URDF = """<robot name="arm">
<link name="base"/>
<link name="upper"><inertial><mass value="-1"/><inertia ixx="-1" ixy="0" ixz="0" iyy="x" iyz="0" izz="1"/></inertial></link>
<link name="lower"><inertial><mass value="1"/><inertia ixx="-1" ixy="0" ixz="0" iyy="1" iyz="0" izz="-2"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="bas"/><child link="upper"/><axis xyz="0 0 0"/></joint>
<joint name="elbow" type="hinge"><parent link="upper"/><child link="lower"/></joint>
</robot>
"""


def test_everything_in_a_urdf(tmp_path: Path):
    pytest.importorskip("pinocchio")
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, "utf-8")
    begins = [
        "link 'upper': mass -1 kg must be >= 0",
        "link 'upper': inertia ixx -1 kg·m² must be >= 0",
        "link 'upper': inertia iyy 'x' must be a finite number",
        "link 'lower': inertia ixx -1 kg·m² must be >= 0",
        "link 'lower': inertia izz -2 kg·m² must be >= 0",
        "joint 'shoulder': parent link 'bas' is not in the file; did you mean 'base'?",
        "joint 'shoulder': axis '0 0 0' must be three numbers",
        "joint 'shoulder': does not specify limits",
        "joint 'elbow': has no known type [hinge]",
    ]
    assert_each_said_once(refused(load_model, path, "fixed"), [f"{path}: {each}" for each in begins])


WHOLE_JOINT = """
joint: {rotor_inertia: 1.0e-4, gear_ratio: 100, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2}
control: {type: pd, kp: 1.0e4, kd: 300.0, feedback: motor, sample_rate_hz: 2000, notches: [{frequency_hz: 80}, {frequency_hz: 90}]}
limits: {gain_margin_db: 6.0, phase_margin_deg: 30.0, peak_sensitivity: 2.0}
uncertainty: {delay_ms: [2, 3], stiffness: 20%, link_inertia: [0.8, 16.0]}
scenario: {duration: 4, reference: {type: step, by: 1, start: 1}, disturbance: {torque: 1, start: 1}, jitter_ms: 0.1}
"""
EDITS = {
    "joint": [
        ("gear_ratio: 100", "gear_ratio: 100, motor_inertia: 1"),
        ("bandwidth: 4000.0", "bandwidth: quick"),
        ("{frequency_hz: 80}", "{frequency_hz: 1200}"),
        ("{frequency_hz: 90}", "{frequency_hz: 90, depth: 2}"),
        ("feedback: motor", "feedback: both"),
        ("peak_sensitivity: 2.0", "peak_sensitivity: 0.5"),
        ("stiffness: 20%", "stiffness: 200%"),
        ("delay_ms: [2, 3]", "delay_ms: [3, 4]"),
        ("by: 1, start: 1", "by: 1, start: 9"),
        ("torque: 1,", "torqe: 1,"),
        ("gain_margin_db: 6.0", "gain_margin_db: 1e999"),
    ],
    "robot": [
        ("gear_ratio: 100\n", "gear_ratio: -100\n"),
        ("delay_ms: 2.0", "delay_ms: none"),
        ("postures:", "postures:\n  more: {left_kne: 1}"),
        ("type: pd", "type: pdd"),
        ("phase_margin_deg: 30.0", "phase_margin: 30.0"),
        ("left: [left_sole]", "left: [left_sol]"),
        ("frame: pelvis, kp: 100", "frame: plvis, kp: -100"),
        ("model: {", "model: {payload: {frame: pelvis, mass: -1}, "),
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize(("make", "kind", "whole"), [(parse_joint, "joint", WHOLE_JOINT), (parse_robot, "robot", BIPED)])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_of_several_mistakes_each_is_said_as_if_it_were_the_only_one(data, make, kind: str, whole: str):
    """Mistakes that have nothing to do with each other: together they are refused with the lines that each has alone."""
    if kind == "robot":
        pytest.importorskip("pinocchio")
    edits = data.draw(st.lists(st.sampled_from(EDITS[kind]), min_size=2, max_size=6, unique=True))
    alone: set[str] = set()
    text = whole
    for old, new in edits:
        assert whole.count(old) == 1, old
        alone |= set(refused(make, whole.replace(old, new), "f"))
        text = text.replace(old, new)
    assert set(refused(make, text, "f")) == alone


WHOLE_GAINS = (
    "gains: {left_hip: {kp: 1, kd: 2}, left_knee: [1, 2], '.*': {kp: 3, motor_inertia: 1}}\ngains_run: split\nsample_rate_hz: 100\n"
    "drive_rate_hz: 1000\ndrive_delay_ms: 1\nposture: {left_hip: 1}",
    "legs: {ros__parameters: {gains: {left_hip: {p: 1, d: 2, u_clamp_max: 3, u_clamp_min: -3}, left_knee: {p: 1, i: 2}}}}\n"
    "controller_manager: {ros__parameters: {update_rate: 100}}",
    "joint_names: [left_hip, left_knee, right_hip, right_knee]\nkps: [1, 2, 3, 4]\nkds: [1, 2, 3, 4]\narm_kps: [1]\narm_kds: [1]\n"
    "arm_joint_names: [x]",
    "control: {stiffness: {hip: 1, knee: 2}, damping: {hip: 1, knee: 2}, control_type: P}\nasset: {armature: 0.1}\n"
    "init_state: {default_joint_angles: {hip: 1}}",
    "actuators: {hips: {joint_names_expr: ['.*_hip'], stiffness: 1, damping: {'.*': 2}, armature: 0.1}}",
    "moteus: {left_hip: {kp: 1, kd: 2}, '.*': {kp: 2}}",
)
ODD = (
    None,
    [],
    {},
    "x",
    -1,
    0,
    math.inf,
    math.nan,
    True,
    1e300,
    [1],
    [1, 2, 3],
    {"a": 1},
    "20%",
    [3, 2],
    {"default": 1},
    "left_knee",
    7,
    "task",
)


def places(node: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Of all values in it, the keys that lead there."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield (*at, key)
        yield from places(value, (*at, key))


@given(random=st.randoms(use_true_random=False), whole=st.sampled_from([WHOLE_JOINT, TESTBED, *WHOLE_GAINS]))
@settings(max_examples=150, deadline=None)
def test_whatever_stands_in_several_places_it_is_read_or_refused(random: Any, whole: str):
    """Checks that go on beside a wrong value meet nothing that they do not expect."""
    data = parse_yaml(whole, "f.yaml")
    for _ in range(random.randint(1, 6)):
        *path, last = random.choice([*places(data)] or [("x",)])
        node = reduce(lambda inner, key: inner[key], path, data)
        if random.random() < 0.7:
            node[last] = copy.deepcopy(random.choice(ODD))
        else:
            node.pop(last, None) if isinstance(node, dict) else node.pop()
    text, problems = yaml.safe_dump(data), ()
    try:
        if whole in WHOLE_GAINS:
            gains_of(parse_gains(text, "f.yaml"), LEGS)
        else:
            parse_simulation(text, "f.yaml")
    except GainroomError as error:
        problems = error.problems
    assert all(problem.startswith("f.yaml") and "\n" not in problem for problem in problems)
