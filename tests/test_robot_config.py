"""robot.yaml: what is read is what was meant, everything else is named in one line, and no file makes a traceback."""

import contextlib
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.cli.example import example_texts
from gainroom.errors import GainroomError
from gainroom.files.robot_sections import ActuatorSection, ContactSection, ModelSection, PayloadSection, RobotControlSection, TaskSection
from gainroom.files.robot_yaml import load_robot, parse_robot
from gainroom.files.system_sections import UncertaintySection, control_section
from gainroom.io.yaml_text import parse_yaml
from gainroom.robot.formats.model_names import locate
from gainroom.system.system import System
from mutations import RANDOMS, mutated_data
from robot_truths import hinge, link, write_robot

BIPED = example_texts()["biped"]
DOCUMENT = (Path(__file__).parents[1] / "docs" / "robots.md").read_text("utf-8")
SECTIONS = [
    ModelSection,
    PayloadSection,
    ActuatorSection,
    ContactSection,
    TaskSection,
    control_section(RobotControlSection),
    UncertaintySection,
]
SMALL = """\
model: {file: robot.urdf, base: fixed}
joints:
  default: {rotor_inertia: 1.0e-4, gear_ratio: 100, stiffness: 1e4, damping: 2}
  ".*_knee": {gear_ratio: 50, delay_ms: 3}
  r_.*: {stiffness: rigid, bandwidth: .inf}
drive: {bandwidth: 4000, damping_ratio: 0.8, delay_ms: 2}
postures:
  bent: {".*": 0.1, ".*_knee": 0.6}
  flat: {l_hip: -0.2}
contacts:
  one: [l_foot]
  two: [{frame: l_foot, type: line, stiffness: 1e5, damping: 100}, {frame: r_foot, type: point, stiffness: [1e4, 1e4, .inf]}]
  none: []
control:
  type: pd
  feedback: motor
  kp: {default: 200, ".*_knee": 100}
  kd: 5
  sample_rate_hz: 2000
  velocity_filter: {bandwidth_hz: 100}
  notches: [{frequency: 300}]
  biquads: [{zero_frequency: 200, zero_damping: 0.2, pole_frequency_hz: 60, pole_damping: 0.7}]
tasks:
  - {name: foot, type: position, frame: l_foot, kp: [50, 60, 70], kd: 9}
  - {name: rest, type: posture, kp: 10, kv: 5, ki: 1}
limits: {gain_margin_db: 6, phase_margin_deg: 30}
uncertainty: {delay_ms: [2, 4], stiffness: 20%, motor_inertia: 10%, damping: [0, 5]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two legs of two hinges on a trunk."""
    path = tmp_path_factory.mktemp("robot")
    links, joints = link("trunk", 10.0, inertia=(0.1, 0.1, 0.1)), ""
    for side, y in (("l", 0.1), ("r", -0.1)):
        for part, mass in (("thigh", 3.0), ("shank", 2.0)):
            links += link(f"{side}_{part}", mass, (0, 0, -0.2), (0.05, 0.05, 0.01))
        links += link(f"{side}_foot")
        joints += hinge(f"{side}_hip", "trunk", f"{side}_thigh", (0, y, 0))
        joints += hinge(f"{side}_knee", f"{side}_thigh", f"{side}_shank", (0, 0, -0.4))
        joints += hinge(f"{side}_sole", f"{side}_shank", f"{side}_foot", (0, 0, -0.4), kind="fixed")
    write_robot(path, links, joints)
    return path


def edited(*edits: tuple[str, str]) -> str:
    text = SMALL
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def read(folder: Path, *edits: tuple[str, str]) -> System:
    return parse_robot(edited(*edits), "robot.yaml", folder)


def refusal(folder: Path, *edits: tuple[str, str]) -> str:
    with pytest.raises(GainroomError) as caught:
        read(folder, *edits)
    assert all(message.startswith("robot.yaml: ") and "\n" not in message for message in caught.value.problems)
    return caught.value.problems[0].removeprefix("robot.yaml: ")


def test_a_payload_is_carried_in_every_posture(folder: Path):
    """At the knees' foot a point mass m is m Jᵀ J, where a joint is locked, too, whose posture reads the model anew."""
    plain = ("model: {file: robot.urdf, base: fixed}", "model: {file: robot.urdf, base: floating}")
    loaded = (plain[0], plain[1].replace("floating}", "floating, payload: {frame: l_foot, mass: 2.5}}"))
    locked = ("joints:\n", "joints:\n  locked: [r_hip]\n")
    for posture in ("bent", "flat"):
        bodies = [read(folder, edit, locked).source.postures[posture] for edit in (plain, loaded)]
        q = [one.body.configuration(one.angles) for one in bodies]
        jacobian = bodies[0].body.frame_jacobian(q[0], "l_foot")[:3]
        before, after = (one.body.mass_matrix(at) for one, at in zip(bodies, q, strict=True))
        assert_allclose(after, before + 2.5 * jacobian.T @ jacobian, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame: nobody, mass: 1", "model.payload: the robot has no frame 'nobody'"),
        ("frame: trunk, mass: 1", "model.payload: "),
        ("frame: l_foot, mass: -1", "model.payload.mass: -1 must be >= 0 kg"),
        ("mass: 1", "model.payload.frame is missing"),
    ],
)
def test_payloads_that_mean_nothing_are_refused(folder: Path, text: str, message: str):
    """The trunk stands still on its fixed base."""
    assert refusal(folder, ("base: fixed}", f"base: fixed, payload: {{{text}}}}}")).startswith(message)


def test_every_key_arrives_in_si(folder: Path):
    spec = read(folder)
    robot, control = spec.source, spec.control
    assert robot.joint_names == ("l_hip", "l_knee", "r_hip", "r_knee")
    assert robot.body.base == "fixed"
    assert_allclose(robot.actuators.motor_inertia, [1.0, 0.25, 1.0, 0.25], rtol=1e-15)
    assert_allclose(robot.actuators.stiffness, [1e4, 1e4, math.inf, math.inf])
    assert_allclose(robot.actuators.damping, 2.0)
    assert [drive.delay for drive in spec.drives] == pytest.approx([2e-3, 3e-3, 2e-3, 3e-3])
    assert [drive.bandwidth for drive in spec.drives] == [4000.0, 4000.0, math.inf, math.inf]
    assert {drive.damping_ratio for drive in spec.drives} == {0.8}
    assert dict(robot.postures["bent"].angles) == {"l_hip": 0.1, "l_knee": 0.6, "r_hip": 0.1, "r_knee": 0.6}
    assert dict(robot.postures["flat"].angles) == {"l_hip": -0.2}
    assert robot.states == tuple((posture, contact) for contact in ("one", "two", "none") for posture in ("bent", "flat"))
    assert [(contact.frame, contact.kind) for contact in robot.contacts["two"]] == [("l_foot", "line"), ("r_foot", "point")]
    assert_allclose(robot.contacts["two"][0].springs, [1e5] * 5)
    assert_allclose(robot.contacts["two"][0].dampers, [100.0] * 5)
    assert_allclose(robot.contacts["two"][1].springs, [1e4, 1e4, math.inf])
    assert robot.contacts["none"] == ()
    assert (control.space, str(control.feedback), control.sample_time) == ("joint", "motor", 1 / 2000)
    assert_allclose(control.controller.kp, [200, 100, 200, 100])
    assert_allclose(control.controller.kd, 5)
    assert control.controller.velocity_filter.bandwidth == pytest.approx(2 * math.pi * 100)
    assert control.controller.notches[0].frequency == 300
    assert control.controller.biquads[0].pole_frequency == pytest.approx(2 * math.pi * 60)
    assert [(task.name, task.kind, task.frame) for task in robot.stack] == [("foot", "position", "l_foot"), ("rest", "posture", None)]
    assert (robot.stack[0].kp, robot.stack[0].kd, robot.stack[0].ki) == ([50, 60, 70], 9, None)
    assert (robot.stack[1].kp, robot.stack[1].kd, robot.stack[1].ki) == (10, 5, 1)
    assert spec.requirements.peak_sensitivity is None
    assert 20 * math.log10(spec.requirements.gain_margin) == pytest.approx(6)
    assert not robot.gravity


def test_ranges_are_each_joints_own(folder: Path):
    spec = read(folder, ("delay_ms: [2, 4]", "delay_ms: [1, 4]"))
    ranges = spec.uncertainty
    assert ranges.names == ("delay", "stiffness", "motor_inertia", "damping")
    assert_allclose(ranges.delay, ([1e-3] * 4, [4e-3] * 4))
    assert_allclose(ranges.stiffness, ([8e3, 8e3, math.inf, math.inf], [1.2e4, 1.2e4, math.inf, math.inf]))
    assert_allclose(ranges.motor_inertia, ([0.9, 0.225, 0.9, 0.225], [1.1, 0.275, 1.1, 0.275]))
    assert_allclose(ranges.damping, (np.zeros(4), np.full(4, 5.0)))
    least = spec.at((0, 0, 0, 0))
    low, drives = least.source.actuators, least.drives
    assert_allclose(low.stiffness, ranges.stiffness[0])
    assert_allclose(low.damping, 0)
    assert [drive.delay for drive in drives] == pytest.approx([1e-3] * 4)
    most = spec.at((1, 1, 1, 0.5))
    high, drives = most.source.actuators, most.drives
    assert_allclose(high.stiffness, ranges.stiffness[1])
    assert_allclose(high.motor_inertia, ranges.motor_inertia[1])
    assert_allclose(high.damping, 2.5)
    assert [drive.delay for drive in drives] == pytest.approx([4e-3] * 4)


def test_linearised_by_name(folder: Path):
    robot = read(folder).source
    model = robot.linearize(posture="bent", contact="none")
    q = robot.body.configuration({"l_hip": 0.1, "l_knee": 0.6, "r_hip": 0.1, "r_knee": 0.6})
    assert_allclose(model.link_inverse_inertia, np.linalg.inv(robot.body.mass_matrix(q)), rtol=1e-12)
    assert (model.posture, model.contact) == ("bent", "none")
    assert_allclose(model.motor_inertia, robot.actuators.motor_inertia)
    assert robot.linearize().contact == "one"  # the first ones
    with pytest.raises(GainroomError, match="posture 'bend' is not one of this robot's; did you mean 'bent'"):
        robot.linearize(posture="bend")
    with pytest.raises(GainroomError, match="contact 'three' is not one of this robot's"):
        robot.linearize(contact="three")


def test_tasks_of_the_file(folder: Path):
    robot = read(folder).source
    tasks = robot.tasks(robot.linearize("bent", "none"))
    assert tasks.directions[:3] == ("foot x", "foot y", "foot z")
    assert_allclose(tasks.kp, [50, 60, 70, 10, 10, 10, 10])
    assert tasks.cascade.tolist() == [False] * 3 + [True] * 4


def test_control_in_task_space(folder: Path):
    gains = ('  kp: {default: 200, ".*_knee": 100}\n  kd: 5\n', "")
    spec = read(folder, gains, ("type: pd", "type: ppi\n  space: task\n  rotors: true"))
    model = spec.source.linearize("bent", "none")
    controller = spec.controller(model)
    assert controller.velocity_filter == spec.control.velocity_filter is not None
    assert controller.notches == spec.control.notches != ()
    assert controller.biquads == spec.control.biquads != ()
    expected = spec.source.tasks(model, rotors=True).controller().terms()
    assert {key: value.tolist() for key, value in controller.terms().items()} == {key: value.tolist() for key, value in expected.items()}
    assert spec.loop(model).size == 4


@pytest.mark.parametrize(("kind", "gains"), [("pid", {"kp": 100.0, "ki": 5.0, "kd": 3.0}), ("ppi", {"kp": 40.0, "kv": 5.0, "ki": 1.0})])
def test_other_controllers(folder: Path, kind: str, gains: dict[str, float]):
    keys = "".join(f"  {name}: {value}\n" for name, value in gains.items())
    spec = read(folder, ("type: pd", f"type: {kind}"), ('  kp: {default: 200, ".*_knee": 100}\n  kd: 5\n', keys))
    assert type(spec.control.controller).__name__.lower() == kind
    for name, value in gains.items():
        assert_allclose(getattr(spec.control.controller, name), np.full(4, value))


def test_locked_joints_stand_as_each_posture_says(folder: Path):
    robot = read(folder, ("drive: {", "  locked: [r_.*]\ndrive: {")).source
    assert robot.joint_names == ("l_hip", "l_knee")
    assert dict(robot.postures["bent"].body.locked) == {"r_hip": 0.1, "r_knee": 0.6}
    assert dict(robot.postures["flat"].body.locked) == {"r_hip": 0.0, "r_knee": 0.0}
    assert dict(robot.postures["bent"].angles) == {"l_hip": 0.1, "l_knee": 0.6}
    assert robot.linearize("bent", "none").size == 2
    whole = read(folder).source.linearize("bent", "none")
    # On a fixed base the legs do not feel each other.
    assert_allclose(robot.linearize("bent", "none").link_inverse_inertia, whole.link_inverse_inertia[:2, :2], rtol=1e-12)


def test_what_is_left_out_is_assumed_and_said(folder: Path):
    text = "model: {file: robot.urdf}\ndrive: {bandwidth: .inf, delay_ms: 1}\ncontrol: {type: pd, feedback: motor, kp: 1, kd: 1}\n"
    spec = parse_robot(text, "f", folder)
    assert spec.source.states == (("zero", "free"),)
    assert spec.source.body.base == "fixed"
    assert np.all(np.isinf(spec.source.actuators.stiffness))
    base, bare, usual = spec.assumptions
    assert "the base is fixed" in base
    assert "rigid with motor inertia 0: l_hip, l_knee, r_hip, r_knee" in bare
    assert "usual limits" in usual
    assert "gain margin ≥ 6 dB, phase margin ≥ 30°, Ms ≤ 2" in usual
    spec = parse_robot(text + "contacts: {stand: [l_foot]}", "f", folder)
    assert spec.source.body.base == "floating"
    assert "the base is floating" in spec.assumptions[0]


def test_a_posture_beyond_the_limits_is_a_warning(folder: Path):
    (warning,) = read(folder, ("l_hip: -0.2", "l_hip: -3.2")).warnings
    assert "posture 'flat': joint 'l_hip' at -3.2 is outside its limits -3 to 3" in warning


def test_the_shipped_biped():
    spec = parse_robot(BIPED, "biped.yaml")
    assert spec.assumptions == spec.warnings == ()
    assert spec.source.body.base == "floating"
    assert len(spec.source.joint_names) == 12
    assert set(spec.source.contacts) == {"double", "left", "right", "flight"}
    assert set(spec.source.postures) == {"stand", "crouch"}
    assert_allclose(spec.source.actuators.motor_inertia, 1.0, rtol=1e-15)


def test_load_robot_carries_its_file(folder: Path):
    path = folder / "robot.yaml"
    path.write_text(SMALL, "utf-8")
    robot = load_robot(path)
    assert robot.name == str(path)
    assert robot.system is not None
    assert robot.system.source == robot
    model = robot.linearize("bent", "none")
    for thing, words in ((robot, "4 joints"), (robot.system, "joint space"), (model, "posture 'bent'"), (robot.body, "4 joints")):
        assert words in repr(thing)
        assert "\n" not in repr(thing)
        assert "array(" not in repr(thing)
    loop = gr.build_loop(robot.linearize("bent", "none"), gr.Drive(4000.0, 0.9, 2e-3), gr.PD(kp=2000.0, kd=100.0))
    assert loop.size == 4


@pytest.mark.parametrize(
    ("old", "new", "start", "contains"),
    [
        ("robot.urdf", "robt.urdf", "", "no such file"),
        ("file: robot.urdf", "fle: robot.urdf", "model.fle: unknown key", "did you mean file?"),
        ("file: robot.urdf", "file: 3", "model.file: 3 must be a name", ""),
        ("file: robot.urdf", "file: biped, package: gainroom", "model.file: gainroom ships no 'biped'", "did you mean 'biped.urdf'?"),
        ("file: robot.urdf", "file: a.urdf, package: no-such-package-here", "model: package 'no-such-package-here' is not installed", ""),
        ("base: fixed", "base: float", "model.base: 'float' must be fixed or floating", "did you mean floating?"),
        ("base: fixed", "gravity_stiffness: 1", "model.gravity_stiffness: 1 must be true or false", ""),
        ("stiffness: 1e4, damping: 2", "stifness: 1e4", "joints.default.stifness: unknown key", "did you mean stiffness?"),
        ("delay_ms: 2", "clock: continuous, delay_ms: 2", "drive.clock: must be left out with control.sample_rate_hz", ""),
        ("stiffness: 1e4, damping: 2", "stiffness: stiff", "joints.default.stiffness: 'stiff' is text", ""),
        ("stiffness: 1e4, damping: 2", "stiffness: .nan", "joints.default.stiffness: nan is not a number", ""),
        ("gear_ratio: 50", "gear_ratio: -50", "joints.'.*_knee'.gear_ratio: -50 must be > 0", ""),
        ("gear_ratio: 50", "gear_ratio: 50, motor_inertia: 1", "joint 'l_knee': gear_ratio has no meaning beside", ""),
        ("rotor_inertia: 1.0e-4, ", "", "joint 'l_hip': gear_ratio needs rotor_inertia", ""),
        ('".*_knee": {gear', '".*_elbow": {gear', "joints.'.*_elbow' matches no joint", "joints: l_hip, l_knee"),
        ('".*_knee": {gear', '"(": {gear', "joints.'(' is not a regular expression", ""),
        ("drive: {", "  locked: [arm_.*]\ndrive: {", "", "'arm_.*' matches no joint"),
        ("drive: {", "  locked: [.*]\ndrive: {", "", "actuate"),
        ("drive: {", "  locked: arm\ndrive: {", "joints.locked: 'arm' must be a list", ""),
        ("drive: {", "  locked: [1]\ndrive: {", "joints.locked[0]: 1 must be a name", ""),
        ("delay_ms: 2}", "delay_s: 2}", "drive.delay_s: unknown key", "did you mean delay_ms?"),
        ("delay_ms: [2, 4]", "delay_ms: [2, 600]", "delay_ms of joint 'l_hip': 600 ms must be <= 500 ms, 1000 ticks at 2000 Hz", ""),
        ("l_hip: -0.2", "l_hp: -0.2", "postures.flat.'l_hp' matches no joint", "did you mean 'l_hip'?"),
        ("l_hip: -0.2", "l_hip: .inf", "postures.flat.l_hip: inf must be <= 10000", ""),
        ("l_hip: -0.2", "l_hip: 30°", "postures.flat.l_hip: '30°' is text", ""),
        ("flat: {l_hip: -0.2}", "flat: 3", "postures.flat: 3 must be a section", ""),
        ("one: [l_foot]", "one: [l_fot]", "contacts.one[0]: the robot has no frame 'l_fot'", "did you mean 'l_foot'?"),
        ("one: [l_foot]", "one: [l_foot, l_foot]", "contacts.one: frame 'l_foot' is used 2 times", ""),
        ("one: [l_foot]", "one: l_foot", "contacts.one: 'l_foot' must be a list", ""),
        ("one: [l_foot]", "one: [7]", "contacts.one[0]: 7 must be a section", ""),
        ("type: line", "type: lines", "contacts.two[0].type: 'lines' must be flat, line or point", "did you mean line?"),
        ("[1e4, 1e4, .inf]", "[1e4, 1e4]", "contacts.two[1]: contact 'r_foot'", "3 numbers"),
        ("[1e4, 1e4, .inf]", "[1e4, -1, 1]", "contacts.two[1].stiffness: -1 must be > 0", ""),
        ("stiffness: 1e5, damping", "damping", "contacts.two[0]: contact 'l_foot': damping needs a stiffness", ""),
        ("type: pd", "type: lqr", "control.type: 'lqr' must be pd, pid or ppi", ""),
        ("type: pd", "type: ppi", "control.kd is not a gain of type ppi", "kp, kv, ki"),
        ("type: pd", "type: pid", "control.ki is missing", ""),
        ("type: pd", "type: pd\n  space: task", "control.kp is for space joint", ""),
        ("type: pd", "type: pd\n  rotor: true", "control.rotor: unknown key", "did you mean rotors?"),
        ("  feedback: motor\n", "", "control.feedback is missing", "motor or link"),
        ("default: 200, ", "", "control.kp: no value for joint l_hip, r_hip", "default"),
        ("kp: {default: 200", "kp: {default: -2", "control.kp.default: -2 must be >= 0", ""),
        ('kp: {default: 200, ".*_knee": 100}', "kp: 0", "control.kp: must be > 0 on some joint", ""),
        ("kd: 5\n", "kd: .nan\n", "control.kd: nan is not a number", ""),
        ("kd: 9}", "kd: 9, ki: 1}", "tasks[0].ki is for P/PI", "kv"),
        ("kd: 9}", "kp: 9}", "line", "twice"),
        ("kd: 9}", "damping: 9}", "tasks[0].damping: unknown key", ""),
        (", kd: 9}", "}", "tasks[0]: give either kd (PD), or kv and ki", ""),
        ("[50, 60, 70]", "[50, 60]", "tasks[0].kp: [50.0, 60.0] must be a number, or 3 numbers", ""),
        ("frame: l_foot, kp", "frame: foot, kp", "tasks[0].frame: the robot has no frame 'foot'", "_foot'?"),
        ("frame: l_foot, kp", "kp", "tasks[0].frame is missing: the name of the frame", ""),
        ("type: posture", "type: posture, frame: trunk", "tasks[1].frame has no meaning for type posture", ""),
        ("name: rest", "name: foot", "tasks[1].name: 'foot' is the name of two tasks", ""),
        ("stiffness: 20%", "stiffness: [1e3, 2e3]", "uncertainty.stiffness: [1000.0, 2000.0] must contain", "10000"),
        ("stiffness: 20%", "payload: 20%", "uncertainty.payload: unknown key", ""),
        ("delay_ms: [2, 4]", "delay_ms: [2, 2.5]", "uncertainty.delay_ms: [2.0, 2.5] must contain", "3"),
        ("limits: {", "limit: {", "limit: unknown key", "did you mean limits?"),
        ("postures:", "posture:", "posture: unknown key", "did you mean postures?"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(folder: Path, old: str, new: str, start: str, contains: str):
    message = refusal(folder, (old, new))
    assert message.startswith(start)
    assert contains in message


def test_task_space_needs_tasks_that_fit(folder: Path):
    gains = ('  kp: {default: 200, ".*_knee": 100}\n  kd: 5\n', "")
    assert "control.type: pd, but task 'rest' has kv" in refusal(folder, gains, ("type: pd", "type: pd\n  space: task"))
    assert "control.type: pid has no meaning in task space" in refusal(folder, gains, ("type: pd", "type: pid\n  space: task"))
    start = SMALL.index("tasks:")
    without = (SMALL[start : SMALL.index("limits:")], "")
    assert "control.space: task needs tasks" in refusal(folder, gains, without, ("type: pd", "type: pd\n  space: task"))
    assert "control.rotors is for tasks" in refusal(folder, without, ("type: pd", "type: pd\n  rotors: true"))


def test_too_many_states(folder: Path):
    postures = "".join(f"  p{k}: {{l_hip: 0.{k}}}\n" for k in range(50))
    contacts = "".join(f"  c{k}: []\n" for k in range(11))
    text = ("  bent: ", postures + "  bent: ")
    assert "postures: 52 entries must be at most 50" in refusal(folder, text)
    fewer = ("  bent: ", "".join(f"  p{k}: {{l_hip: 0.{k}}}\n" for k in range(48)) + "  bent: ")
    assert "combinations must be at most 500" in refusal(folder, fewer, ("  one: ", contacts + "  one: "))


def test_an_empty_file_points_to_the_example():
    with pytest.raises(GainroomError, match="is empty; `gainroom example biped` prints a file to start from"):
        parse_robot("# nothing\n", "robot.yaml")


@st.composite
def mutated_robots(draw: st.DrawFn) -> str:
    random = draw(RANDOMS)
    data = parse_yaml(random.choice([SMALL, SMALL, BIPED]), "f")
    for _ in range(random.randint(1, 3)):
        data = mutated_data(random, data)
    return yaml.safe_dump(data, allow_unicode=True, sort_keys=False)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(text=mutated_robots())
def test_mutated_files_are_read_or_refused_in_one_line(folder: Path, text: str):
    problems = ()
    with contextlib.suppress(UnicodeEncodeError):
        try:
            parse_robot(text, "robot.yaml", folder)
        except GainroomError as error:
            problems = error.problems
    assert all(message.startswith("robot.yaml") and "\n" not in message for message in problems)
    assert "robot.urdf" in os.listdir(folder)


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_key_is_documented(section):
    assert [key for key in section.model_fields if f"`{key}`" not in DOCUMENT] == []


def test_the_documented_file_is_a_valid_one():
    block, *_ = re.findall(r"^```yaml\n(.*?)^```", DOCUMENT, re.MULTILINE | re.DOTALL)  # the others are parts
    spec = parse_robot(block, "docs/robots.md")
    assert spec.source.actuators.motor_inertia.max() == pytest.approx(1e-4 * 144**2)


def test_the_documented_names_of_a_packaged_model_are_one_file():
    found = re.findall(r"`(\{(?:package|file): .*?\})`", DOCUMENT)
    assert len(found) == 2
    sections = [yaml.safe_load(text) for text in found]
    paths = {locate(section if "package" in section else section["file"]) for section in sections}
    assert [path.name for path in paths] == ["talos_reduced.urdf"]
