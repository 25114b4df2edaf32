"""Joints of a robot.yaml out of joint.yamls beside it: values, intervals of their own, and no file from anywhere else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gainroom.errors import GainroomError
from gainroom.files.robot_yaml import load_robot_system
from gainroom.system.actuator_entry import ActuatorEntry
from robot_files import ROBOT, write_arm

ELBOW = """\
joint: {rotor_inertia: 2.0e-5, gear_ratio: 100, link_inertia: 0.8, stiffness: 6000.0, damping: 3.0, motor_viscous: 0.5}
drive: {bandwidth: 3000.0, damping_ratio: 0.7, delay_ms: 1.5}
control: {type: pd, kp: 300.0, kd: 20.0, feedback: motor, sample_rate_hz: 2000}
uncertainty: {delay_ms: [1.4, 1.7], stiffness: [5500.0, 6600.0], link_inertia: [0.7, 0.9], motor_inertia: 10%}
"""
WITH_FILE = ROBOT.replace("damping: 4.0}\n", "damping: 4.0}\n  elbow: {file: parts/elbow.yaml}\n", 1)


def arm(folder: Path, text: str = WITH_FILE, elbow: str = ELBOW) -> Path:
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "parts" / "elbow.yaml").write_text(elbow, "utf-8")
    return write_arm(folder, text)


def test_values_and_intervals_are_those_of_the_file(tmp_path: Path):
    system = load_robot_system(arm(tmp_path))
    assert system.source.joint_names == ("shoulder", "elbow")
    quantities = system.source.quantities
    assert {name: quantities[name].tolist() for name in ("motor_inertia", "stiffness", "damping")} == {
        "motor_inertia": [0.5, pytest.approx(0.2)],
        "stiffness": [8000.0, 6000.0],
        "damping": [4.0, 3.0],
    }
    assert [(drive.bandwidth, drive.damping_ratio, drive.delay) for drive in system.drives] == [(4000, 0.9, 2e-3), (3000, 0.7, 1.5e-3)]
    known = system.uncertainty
    assert set(known.names) == {"delay", "stiffness", "motor_inertia"}
    assert np.allclose(known.delay, [[2e-3, 1.4e-3], [2e-3, 1.7e-3]], rtol=1e-12)
    assert np.allclose(known.stiffness, [[8000, 5500], [8000, 6600]], rtol=1e-12)
    assert np.allclose(known.motor_inertia, [[0.5, 0.18], [0.5, 0.22]], rtol=1e-12)
    assert [text for text in system.assumptions if "intervals of elbow" in text and "together" not in text]


def test_ranges_of_the_robot_are_for_the_others(tmp_path: Path):
    text = WITH_FILE + "uncertainty: {stiffness: 20%, damping: [0, 5]}\n"
    known = load_robot_system(arm(tmp_path, text)).uncertainty
    assert np.allclose(known.stiffness, [[6400, 5500], [9600, 6600]], rtol=1e-12)
    assert np.allclose(known.damping, [[0, 0], [5, 5]])


def test_joints_with_intervals_vary_together_and_that_is_said(tmp_path: Path):
    system = load_robot_system(arm(tmp_path, WITH_FILE.replace("elbow: {file", '".*": {file')))
    assert [text for text in system.assumptions if "vary together" in text]
    low, high = (system.at((0.0, end, 0.0)).source.quantities["stiffness"] for end in (0.0, 1.0))
    assert (low.tolist(), high.tolist()) == (pytest.approx([5500.0] * 2), pytest.approx([6600.0] * 2))


def test_what_a_later_pattern_gives_takes_the_interval_with_it(tmp_path: Path):
    text = WITH_FILE.replace("elbow.yaml}\n", 'elbow.yaml}\n  "elb.*": {stiffness: 7000.0, rotor_inertia: 1.0e-5, gear_ratio: 100}\n')
    known = load_robot_system(arm(tmp_path, text)).uncertainty
    assert known.names == ("delay",)


@pytest.mark.parametrize("name", ["stiffness", "motor_inertia"])
def test_ranges_of_entries(name: str):
    entry = replace(ActuatorEntry(ranges={name: (1.0, 2.0)}), **{name: 1.5})
    stronger = replace(ActuatorEntry(), **{name: 1.2})
    assert ActuatorEntry(damping=1.0).over(entry).ranges == {name: (1.0, 2.0)}
    assert stronger.over(entry).ranges == {}
    assert replace(stronger, ranges={name: (1.1, 1.3)}).over(entry).ranges == {name: (1.1, 1.3)}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("parts/elbow.yaml", "../elbow.yaml", "must be in the folder of the robot.yaml"),
        ("parts/elbow.yaml", "parts/../parts/elbow.yaml", "must be in the folder of the robot.yaml"),
        ("parts/elbow.yaml", "/etc/passwd", "must be in the folder of the robot.yaml"),
        ("parts/elbow.yaml", "outside.yaml", "must be in the folder of the robot.yaml"),
        ("parts/elbow.yaml", "loop.yaml", "must be in the folder of the robot.yaml"),
        ("parts/elbow.yaml", "nothing.yaml", "no such file"),
        ("parts/elbow.yaml", "robot.yaml", "must be a joint.yaml"),
        ("parts/elbow.yaml", "parts", "is a directory"),
        ("elbow.yaml}", "elbow.yaml, stiffness: 1.0}", "joints.elbow.file has no meaning beside stiffness"),
        ("{file: parts/elbow.yaml}", "{file: 3}", "joints.elbow.file"),
    ],
)
def test_files_that_are_not_taken(old: str, new: str, words: str, tmp_path: Path):
    folder = tmp_path / "robot"
    folder.mkdir()
    (tmp_path / "elbow.yaml").write_text(ELBOW, "utf-8")
    (folder / "outside.yaml").symlink_to(tmp_path / "elbow.yaml")
    (folder / "loop.yaml").symlink_to(folder / "loop.yaml")
    with pytest.raises(GainroomError) as refused:
        load_robot_system(arm(folder, WITH_FILE.replace(old, new)))
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(folder / "robot.yaml"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("stiffness: 6000.0, damping: 3.0", "stiffness: rigid", "is a rigid joint"),
        ("delay_ms: 1.5", "delay_ms: -1", "drive.delay_ms"),
    ],
)
def test_files_that_are_wrong(old: str, new: str, words: str, tmp_path: Path):
    wrong = ELBOW.replace(old, new).partition("uncertainty")[0]
    with pytest.raises(GainroomError) as refused:
        load_robot_system(arm(tmp_path, elbow=wrong))
    assert words in str(refused.value)
