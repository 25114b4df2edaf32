"""Bad input to `gainroom robot` and `gainroom audit`: exit status 2, one line that names what is wrong, no traceback, in bounded time."""

import contextlib
import os
import re
import warnings
from pathlib import Path
from random import Random

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.robot_yaml import parse_robot
from gainroom.robot.name_patterns import compile_pattern
from refusals import assert_refused
from robot_truths import hinge, link, write_robot

ROBOT = """\
model: {file: robot.urdf, base: fixed}
joints: {default: {motor_inertia: 0.5, stiffness: 5e3, damping: 2}}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {bent: {hip: 0.3, knee: -0.8}}
contacts: {free: []}
control: {type: pd, feedback: motor, kp: 900, kd: 40}
tasks: [{name: tip, type: position, frame: tip, kp: 200, kd: 20}]
"""
PLAIN = ROBOT.partition("postures")[0] + "control: {type: pd, feedback: motor, kp: 900, kd: 40}\n"
GAINS = "hip: {kp: 900, kd: 40}\nknee: {kp: 400, kd: 20}\n"
LEVELS = "".join(f'<!ENTITY a{k} "{"&a" * 9}{k - 1};">' for k in range(1, 12))
BOMB = f'<!DOCTYPE robot [<!ENTITY a0 "aaaaaaaaaa">{LEVELS}]><robot name="&a11;"/>'
MASSLESS = link("base") + link("upper") + link("lower"), hinge("hip", "base", "upper") + hinge("knee", "upper", "lower")
LINKS = (
    link("base") + link("upper", 4.0, (0, 0, 0.25), (0.1, 0.1, 0.01)) + link("lower", 3.0, (0, 0, 0.2), (0.05, 0.05, 0.01)) + link("tip")
)
JOINTS = (
    hinge("hip", "base", "upper") + hinge("knee", "upper", "lower", (0, 0, 0.5)) + hinge("end", "lower", "tip", (0, 0, 0.4), kind="fixed")
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_robot(tmp_path, LINKS, JOINTS)
    (tmp_path / "gains.yaml").write_text(GAINS, "utf-8")
    return tmp_path


def line(capsys: pytest.CaptureFixture[str], *call: str) -> str:
    """What is said of a call that must be refused, a line per problem."""
    assert main(list(call)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("gainroom: error: ")
    assert all(line.startswith("gainroom: error: ") and len(line) < 700 for line in err.splitlines())
    return err


def robot_line(capsys: pytest.CaptureFixture[str], folder: Path, text: str) -> str:
    (folder / "robot.yaml").write_text(text, "utf-8")
    return line(capsys, "robot", str(folder / "robot.yaml"), "--json")


def audit_line(capsys: pytest.CaptureFixture[str], folder: Path, *options: str) -> str:
    model = str(folder / "robot.urdf")
    return line(capsys, "audit", model, "--gains", str(folder / "gains.yaml"), "--delay-ms", "2", "--motor-inertia", "0.5", *options)


MODELS = {
    "malformed": (f"<robot>{LINKS}", ["robot.urdf: line 1, column"]),
    "no XML": ("joint: 1", ["robot.urdf: line 1"]),
    "massless": (f'<robot name="r">{"".join(MASSLESS)}</robot>', ["no mass moves with the joints 'hip', 'knee'"]),
    "no joint": (f'<robot name="r">{link("base", 1.0, inertia=(1, 1, 1))}</robot>', ["no actuated joint"]),
    "entities": (BOMB, ["document types and entities"]),
    "number": (f'<robot name="r">{LINKS}{JOINTS}</robot>'.replace("4.0", "1e999"), ["robot.urdf"]),
}


@pytest.mark.parametrize("kind", ["missing", "directory", "pipe", *MODELS])
def test_models(folder: Path, capsys: pytest.CaptureFixture[str], kind: str):
    path = folder / "robot.urdf"
    path.unlink()
    words = {"missing": ["no such file"], "directory": ["directory"], "pipe": ["not a regular file"]}.get(kind, [])
    if kind == "directory":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind in MODELS:
        text, words = MODELS[kind]
        path.write_text(text, "utf-8")
    for told in (robot_line(capsys, folder, PLAIN), audit_line(capsys, folder)):
        assert str(path) in told
        for word in words:
            assert word in told


EDITS = {
    "frame in contact": ("free: []", "free: [tipp]", ["contacts.free[0]", "'tipp'", "did you mean 'tip'"]),
    "frame in task": ("frame: tip", "frame: tipp", ["tasks[0].frame", "'tipp'"]),
    "frame twice": ("free: []", "free: [tip, tip]", ["contacts.free", "used 2 times"]),
    "joint": ("hip: 0.3", "hop: 0.3", ["postures.bent.'hop'", "did you mean 'hip'"]),
    "package": ("file: robot.urdf", "package: no-such-robots, file: x.urdf", ["'no-such-robots'", "pip install"]),
    "file in package": ("file: robot.urdf", "package: example-robot-data, file: nothing.urdf", ["has no 'nothing.urdf'"]),
    "name of a robot": ("file: robot.urdf", "file: nothing_description", ["'nothing_description'", "no such file"]),
    "pattern, joints": ("joints: {", 'joints: {"leg_.*": {damping: 1}, ', ["joints.'leg_.*'", "matches no joint"]),
    "pattern, locked": ("joints: {", "joints: {locked: [leg_.*], ", ["robot.yaml: joints.locked[0]: 'leg_.*' matches no joint"]),
    "pattern, gains": ("kp: 900", "kp: {default: 900, leg_.*: 3}", ["control.kp.'leg_.*'", "matches no joint"]),
    "all locked": ("joints: {", "joints: {locked: [.*], ", ["no actuated joint: all 2 joints are locked"]),
    "gain, nan": ("kp: 900", "kp: .nan", ["control.kp: nan is not a number"]),
    "gain, inf": ("kd: 40", "kd: .inf", ["control.kd: inf must be <= 1e+12"]),
    "gain, huge": ("kp: 900", "kp: 1e300", ["control.kp: 1e+300 must be <= 1e+12"]),
    "gain, larger than a double": ("kp: 900", "kp: 1e400", ["'1e400' is too large a number"]),
    "task gain, nan": ("kp: 200", "kp: [1, .nan, 1]", ["tasks[0].kp: nan is not a number"]),
    "gain, of another unit": ("kd: 40", "kd: 4e10", ["joint 'hip'", "kd 4e+10 N·m·s/rad", "delay of 2 ms", "wrong unit"]),
    "bandwidth": ("bandwidth: 3000", "bandwidth: 1e7", ["drive.bandwidth: 10000000.0 must be <= 1e+06 rad/s, or .inf"]),
    "bandwidth of a joint": (
        "damping: 2}",
        "damping: 2, bandwidth: 1e12}",
        ["joints.default.bandwidth: 1000000000000.0 must be <= 1e+06 rad/s"],
    ),
    "inertia, tiny": ("motor_inertia: 0.5", "motor_inertia: 1e-300", ["joints.default.motor_inertia: 1e-300 must be >= 1e-12"]),
    "delay": ("delay_ms: 2", "delay_ms: 1e5", ["drive.delay_ms: 100000.0 must be <= 10000 ms"]),
    "filter": (
        "type: pd,",
        "type: pd, sample_rate_hz: 500, notches: [{frequency_hz: 250}],",
        ["control.notches[0].frequency_hz: 250 Hz"],
    ),
    "ticks of one joint": ("type: pd,", "type: pd, sample_rate_hz: 1e6,", ["delay_ms of joint 'hip': 2 ms must be <= 1 ms, 1000 ticks"]),
    "ticks of all joints": ("type: pd,", "type: pd, sample_rate_hz: 4e5,", ["all 2 joints together, 1600 ticks, must be <= 600"]),
    "anchors": ("bent: {hip", "a: &a {hip: 1}, b: *a, bent: {hip", ["line 4", "anchors and aliases"]),
    "backtracking": ("joints: {", 'joints: {"(h+)+p": {damping: 1}, ', ["'(h+)+p' can match in too many ways"]),
    "backtracking with stars": ("joints: {", 'joints: {".*.*.*.*.*x": {damping: 1}, ', ["too many ways"]),
    "nested": ("free: []", "free: " + "[" * 3000 + "]" * 3000, ["nested more than"]),
}


@pytest.mark.parametrize("kind", EDITS)
def test_robot_files(folder: Path, capsys: pytest.CaptureFixture[str], kind: str):
    old, new, words = EDITS[kind]
    assert old in ROBOT
    told = robot_line(capsys, folder, ROBOT.replace(old, new, 1))
    assert str(folder / "robot.yaml") in told
    for word in words:
        assert word in told


def test_ticks_of_an_uncertain_delay_count(folder: Path):
    sampled = ROBOT.replace("type: pd,", "type: pd, sample_rate_hz: 1000,") + "uncertainty: {delay_ms: [2, HIGH]}\n"
    parse_robot(sampled.replace("HIGH", "100"), "f", folder)
    assert_refused(lambda: parse_robot(sampled.replace("HIGH", "400"), "f", folder), ["800 ticks", "<= 600"])


GAIN_FILES = {
    "malformed": ("hip: {kp: [", ["line 1"]),
    "nan": ("hip: {kp: .nan}", ["hip.kp: nan is not a number"]),
    "inf": ("hip: {kp: 1, kd: .inf}", ["hip.kd: inf must be"]),
    "huge": ("hip: {kp: 1e300}", ["hip.kp: 1e+300 must be <= 1e+12"]),
    "another unit": ("hip: {kp: 1, kd: 5e8}", ["joint 'hip'", "kd 5e+08 N·m·s/rad", "wrong unit"]),
    "pattern": ('"leg_.*": {kp: 1}', ["'leg_.*' matches no joint"]),
    "joint": ("hop: {kp: 1}", ["did you mean 'hip'"]),
    "backtracking": ('"(h|hi|hip)*": {kp: 1}', ["too many ways"]),
    "anchors": ("a: &a {kp: 1}\nb: *a", ["gains.'a' matches no joint"]),  # they are followed
    "zero": ("hip: {kp: 0, kd: 0}", ["all gains are zero"]),
    "inertia": ("hip: {kp: 1, motor_inertia: .nan}", ["hip.motor_inertia: nan"]),
}


@pytest.mark.parametrize("kind", GAIN_FILES)
def test_gain_files(folder: Path, capsys: pytest.CaptureFixture[str], kind: str):
    text, words = GAIN_FILES[kind]
    (folder / "gains.yaml").write_text(text, "utf-8")
    told = audit_line(capsys, folder)
    assert str(folder / "gains.yaml") in told
    for word in words:
        assert word in told


def test_options_of_audit(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert "--contact: the robot has no frame 'tipp'; did you mean" in audit_line(capsys, folder, "--contact", "tipp", "--base", "fixed")
    assert "--contact: frame 'tip' is used 2 times" in audit_line(capsys, folder, "--contact", "tip", "--contact", "tip", "--base", "fixed")
    assert "the link of the floating base has no mass" in audit_line(capsys, folder, "--base", "floating")
    assert "all 2 joints together, 1600 ticks, must be <= 600" in audit_line(capsys, folder, "--rate-hz", "4e5")
    assert "--bandwidth: 1e+12 must be <= 1e+06 rad/s, or .inf" in audit_line(capsys, folder, "--bandwidth", "1e12").replace(
        "1000000000000.0", "1e+12"
    )
    assert "--margin-db: nan is not a number" in audit_line(capsys, folder, "--margin-db", "nan")


def test_a_posture_beyond_the_limits_is_a_warning(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "robot.yaml").write_text(ROBOT.replace("hip: 0.3", "hip: 3.3").partition("tasks")[0] + "limits: {}\n", "utf-8")
    assert main(["robot", str(folder / "robot.yaml")]) == 3  # no margin is required
    assert "Warning: posture 'bent': joint 'hip' at 3.3 is outside its limits" in " ".join(capsys.readouterr().out.split())
    model = folder / "robot.urdf"
    model.write_text(model.read_text("utf-8").replace('lower="-3"', 'lower="0.1"'), "utf-8")
    call = ["audit", str(model), "--gains", str(folder / "gains.yaml"), "--delay-ms", "2", "--motor-inertia", "0.5"]
    assert main(call) == 3  # no rate
    told = " ".join(capsys.readouterr().out.split())
    assert "Warning: posture 'zero': joint 'hip' at 0 is outside its limits 0.1 to 3 rad, joint 'knee' at 0" in told


def test_absurd_numbers_that_are_allowed_have_an_answer(folder: Path, capsys: pytest.CaptureFixture[str]):
    text = ROBOT.partition("tasks")[0].replace("5e3", "1e-12").replace("damping: 2", "damping: 1e12") + "limits: {}\n"
    (folder / "robot.yaml").write_text(text, "utf-8")
    assert main(["robot", str(folder / "robot.yaml")]) != 2
    out, err = capsys.readouterr()
    assert err == ""
    assert "nan" not in out


def test_gain_region_of_a_joint_whose_drive_is_absurdly_quick():
    """Samples that follow the delay's phase are bounded, not laid up to the drive's bandwidth."""
    joint = gr.ElasticJoint(0.5, 0.8, 5e3, 2.0)
    quick, ideal = (gr.pd_region(joint, gr.Drive(bandwidth, 0.9, 2e-3)).max_kd(900.0) for bandwidth in (1e12, np.inf))
    assert quick == pytest.approx(ideal, rel=1e-6)


def test_what_doubles_cannot_hold_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    def singular(loop: gr.Loop) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    for name in ("margins", "joint_margins"):
        monkeypatch.setattr(f"gainroom.studies.loop_numbers.{name}", singular)
    for told in (robot_line(capsys, folder, ROBOT), audit_line(capsys, folder)):
        assert "cannot be computed (singular matrix): look for values that are many orders of magnitude off" in told


@pytest.mark.slow
def test_patterns_of_which_python_warns_are_refused():
    """Without its warnings being caught, whose filters are the whole process's; brackets, signs and letters at random."""
    draw = Random(2017)
    warned = 0
    for _ in range(20_000):
        pattern = "".join(draw.choice("[]^-&~|ab\\") for _ in range(draw.randint(2, 9)))
        with warnings.catch_warnings():
            warnings.simplefilter("error", FutureWarning)
            try:
                re.compile(pattern)
                nested = False
            except re.error:
                nested = False
            except FutureWarning:
                nested = True
            if nested:
                warned += 1
                with pytest.raises(gr.GainroomError):
                    compile_pattern(pattern, "f")
            else:
                with contextlib.suppress(gr.GainroomError):
                    compile_pattern(pattern, "f")
    assert warned > 500
