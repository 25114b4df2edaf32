"""Classes of legged_gym as a source of gains and of a posture: read as text, judged as their numbers are."""

import json
from pathlib import Path

import pytest

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.gain_files import gains_of, read_gains

BASE = "from legged_gym.envs.base.legged_robot_config import LeggedRobotCfg, LeggedRobotCfgPPO\n"
CONFIG = (
    BASE
    + """
class BipedRoughCfg( LeggedRobotCfg ):
    class init_state( LeggedRobotCfg.init_state ):
        pos = [0.0, 0.0, 0.9]  # x, y, z [m]
        default_joint_angles = {
            'left_hip_pitch': -0.3, 'left_knee': 2 * 0.3, 'left_ankle_pitch': -0.3,
            'right_hip_pitch': -0.3, 'right_knee': 0.6, 'right_ankle_pitch': -0.3,
            'left_hip_yaw': 0., 'left_hip_roll': 0., 'left_ankle_roll': 0.,
            'right_hip_yaw': 0., 'right_hip_roll': 0., 'right_ankle_roll': 0.,
        }
    class control( LeggedRobotCfg.control ):
        control_type = 'P'
        stiffness = {'hip': 150., 'hip_roll': 200., 'knee': 200., 'ankle': 40.}  # [N*m/rad]
        damping = {'hip': 4., 'hip_roll': 5., 'knee': 5., 'ankle': 2.}
        action_scale = 0.25
        decimation = 4
    class asset( LeggedRobotCfg.asset ):
        file = '{LEGGED_GYM_ROOT_DIR}/resources/robots/biped/biped.urdf'
    class rewards( LeggedRobotCfg.rewards ):
        class scales( LeggedRobotCfg.rewards.scales ):
            torques = -0.0001

class BipedRoughCfgPPO( LeggedRobotCfgPPO ):
    class runner( LeggedRobotCfgPPO.runner ):
        experiment_name = 'biped'
"""
)
OPTIONS = ("--delay-ms", "2", "--rate-hz", "1000", "--motor-inertia", "0.3", "--contact", "left_sole")


def write(folder: Path, text: str, name: str = "config.py") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def audited(capsys: pytest.CaptureFixture[str], gains: Path | str, *options: str) -> dict:
    status = main(["audit", "gainroom:biped.urdf", "--gains", str(gains), *OPTIONS, *options, "--json"])
    out, err = capsys.readouterr()
    assert status in (0, 1), err
    return json.loads(out)


def test_the_last_key_in_a_joints_name_counts(tmp_path: Path):
    """As legged_gym's loop over the keys sets the gains again at each key that is in the name, in the file's order."""
    found = read_gains(write(tmp_path, CONFIG))
    assert found.form == "legged_gym"
    names = ("left_hip_pitch", "left_hip_roll", "left_knee", "left_ankle_roll", "torso")
    gains = gains_of(found, names)
    assert gains.kp.tolist() == [150, 200, 200, 40, 0]
    assert gains.kd.tolist() == [4, 5, 5, 2, 0]
    swapped = CONFIG.replace("'hip': 150., 'hip_roll': 200.,", "'hip_roll': 200., 'hip': 150.,")
    assert gains_of(read_gains(write(tmp_path, swapped)), names).kp.tolist() == [150, 150, 200, 40, 0]


@pytest.mark.slow
def test_the_audit_is_that_of_the_same_numbers_in_the_default_posture(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    told = audited(capsys, write(tmp_path, CONFIG))
    plain = write(
        tmp_path,
        "'.*_hip_(yaw|pitch)': {kp: 150, kd: 4}\n'.*_hip_roll': {kp: 200, kd: 5}\n"
        "'.*_knee': {kp: 200, kd: 5}\n'.*_ankle_.*': {kp: 40, kd: 2}\n",
        "plain.yaml",
    )
    bent = [f"--posture={pattern}={angle}" for pattern, angle in ((".*_hip_pitch", -0.3), (".*_knee", 0.6), (".*_ankle_pitch", -0.3))]
    same, straight = audited(capsys, plain, *bent), audited(capsys, plain)
    for key in ("safe", "gain_limit", "delay_limit_ms", "joints", "posture"):
        assert told[key] == same[key]
    assert straight["gain_limit"] != told["gain_limit"]
    assert any("default_joint_angles" in text and "--posture" in text for text in told["assumptions"])
    asked = audited(capsys, write(tmp_path, CONFIG), "--posture", ".*=0")
    assert asked["gain_limit"] == straight["gain_limit"]
    again = audited(capsys, write(tmp_path, CONFIG), "--posture", "default_joint_angles", "--posture", "left_knee=0.7")
    assert (again["posture"]["left_knee"], again["posture"]["right_knee"]) == (0.7, 0.6)


def test_of_several_robots_one_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A class that inherits all of it is no other robot; one with other gains is."""
    flat = "\nclass BipedFlatCfg( BipedRoughCfg ):\n    class terrain( BipedRoughCfg.terrain ):\n        mesh_type = 'plane'\n"
    assert read_gains(write(tmp_path, CONFIG + flat)).form == "legged_gym"
    soft = "\nclass SoftCfg( BipedRoughCfg ):\n    class control( BipedRoughCfg.control ):\n"
    soft += "        stiffness = {'hip': 1., 'hip_roll': 2., 'knee': 3., 'ankle': 4.}\n"
    path = write(tmp_path, CONFIG + soft)
    with pytest.raises(GainroomError, match=r"holds the gains of 2 robots; name one, .*:BipedRoughCfg"):
        read_gains(path)
    with pytest.raises(GainroomError, match=r"'HardCfg' holds no gains \(classes: BipedRoughCfg, SoftCfg\)"):
        read_gains(Path(f"{path}:HardCfg"))
    assert gains_of(read_gains(Path(f"{path}:SoftCfg")), ("knee", "hip", "hip_roll", "ankle")).kp.tolist() == [3, 1, 2, 4]
    assert gains_of(read_gains(Path(f"{path}:SoftCfg")), ("knee", "hip", "hip_roll", "ankle")).kd.tolist() == [5, 4, 5, 2]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("'knee': 200.,", "'knee': -1.,", "control: stiffness.knee"),
        ("'knee': 200.,", "'knee': helper(3),", "control: stiffness.knee"),
        ("'knee': 200.,", "'knee': open('/etc/passwd').read(),", "control: stiffness.knee"),
        ("damping = {'hip': 4.,", "damping = {'hop': 4.,", "damping: names no 'hip', which stiffness has"),
        ("control_type = 'P'", "control_type = 'T'", "control_type 'T' must be 'P'"),
        ("'ankle': 2.}", "'ankle': 2.}\n        stiffness = GAINS", "stiffness: 'GAINS'"),
        ("'left_knee': 2 * 0.3", "'left_knee': 'bent'", "default_joint_angles.left_knee"),
        ("stiffness = {'hip': 150.,", "stiffness = {'elbow': 1., 'hip': 150.,", "damping: names no 'elbow'"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: str):
    assert old in CONFIG
    path = write(tmp_path, CONFIG.replace(old, new))
    assert main(["audit", "gainroom:biped.urdf", "--gains", str(path), *OPTIONS]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert str(path) in err
    assert words in err


def test_a_key_in_no_joints_name_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = CONFIG.replace("'ankle': 40.}", "'ankle': 40., 'elbow': 7.}").replace("'ankle': 2.}", "'ankle': 2., 'elbow': 1.}")
    assert main(["audit", "gainroom:biped.urdf", "--gains", str(write(tmp_path, text)), *OPTIONS]) == 2
    assert "control: 'elbow' is in no joint's name" in capsys.readouterr().err


@pytest.mark.parametrize(("written", "inertia"), [("armature = 1e-3", 0.001), ("armature = 0.", None), ("name = 'x'", None)])
def test_the_armature_of_the_asset_is_every_motors_inertia(tmp_path: Path, written: str, inertia: float | None):
    text = CONFIG.replace(
        "    class rewards( LeggedRobotCfg.rewards ):", f"        {written}\n    class rewards( LeggedRobotCfg.rewards ):"
    )
    assert {gain.motor_inertia for gain in read_gains(write(tmp_path, text)).gains.values()} == {inertia}
    yaml = f"asset: {{{written.replace(' = ', ': ')}}}\ncontrol: {{stiffness: {{hip: 1.0}}, damping: {{hip: 1.0}}}}"
    assert {gain.motor_inertia for gain in read_gains(write(tmp_path, yaml, "g.yaml")).gains.values()} == {inertia}
    with pytest.raises(GainroomError, match="armature: 'rotor' is no name of this file"):
        read_gains(write(tmp_path, text.replace(written, "armature = rotor")))


SMALL = """
class Base:
    class control:
        stiffness = {"hip": 10.0, "knee": 20.0}
        damping = {"hip": 1.0, "knee": 2.0}
"""


@pytest.mark.parametrize(
    ("text", "kp"),
    [
        ("Base.control.stiffness['hip'] = 30.0", [30, 20]),
        ("class B(Base):\n    class control(Base.control):\n        stiffness = {**Base.control.stiffness, 'knee': 5.0}", [10, 5]),
        ("for k in Base.control.stiffness: Base.control.stiffness[k] *= 3", [30, 60]),
    ],
)
def test_what_changes_a_class_counts(text: str, kp: list[float], tmp_path: Path):
    name = ":B" if "class B" in text else ""
    path = write(tmp_path, SMALL + text)
    assert gains_of(read_gains(Path(f"{path}{name}")), ("hip", "knee")).kp.tolist() == kp


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("    def __init__(self):\n        self.control.stiffness['hip'] = 30.0", 7),
        ("    def __init__(self):\n        self.soften()\n    def soften(self):\n        self.control.damping = {}", 9),
        ("    def __init__(self):\n        setattr(self.control, 'stiffness', {})", 7),
    ],
)
def test_an_init_that_may_change_the_gains_is_refused(tmp_path: Path, body: str, line: int):
    with pytest.raises(GainroomError, match=f"line {line}: B.* mentions the gains and may change them where an object is made"):
        read_gains(write(tmp_path, f"{SMALL}class B(Base):\n{body}\n"))
    harmless = "class B(Base):\n    def __init__(self):\n        self.name = 'b'\n"
    assert read_gains(write(tmp_path, SMALL + harmless)).form == "legged_gym"


def test_a_class_whose_base_is_not_read_is_named(tmp_path: Path):
    """As legged_gym's own flat configurations, which inherit the gains of another folder's file; beside it they are read."""
    flat = "from robots import {0}\nclass FlatCfg( {0} ):\n    class terrain( {0}.terrain ):\n        mesh_type = 'plane'\n"
    path = write(tmp_path, flat.format("BipedRoughCfg"), "flat.py")
    with pytest.raises(GainroomError, match="line 2: FlatCfg inherits from BipedRoughCfg, whose file is not read: give that file, or"):
        read_gains(path)
    write(tmp_path, CONFIG, "robots.py")
    assert gains_of(read_gains(path), ("left_knee", "left_hip_roll", "left_ankle_roll")).kp.tolist() == [200, 200, 40]


def test_nothing_is_run(tmp_path: Path):
    mark = tmp_path / "ran"
    text = f"import pathlib\npathlib.Path({str(mark)!r}).write_text('x')\n" + CONFIG
    read_gains(write(tmp_path, text))
    assert not mark.exists()


@pytest.mark.slow
def test_the_export_is_read_back_with_the_same_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    source, out = write(tmp_path, CONFIG), tmp_path / "again.py"
    assert main(["export", str(source), "--to", "legged_gym", "--output", str(out), "--write"]) == 0
    capsys.readouterr()
    one, other = audited(capsys, source, "--posture", ".*=0"), audited(capsys, out, "--posture", ".*=0")
    for key in ("safe", "gain_limit", "delay_limit_ms", "joints"):
        assert one[key] == other[key]
