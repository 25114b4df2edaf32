"""What an audit takes from files beside gains: the controller's rate, the joints' own damping, keyframes of a scene. Each is told."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.files.gain_files import parse_gains

MODEL = """\
<mujoco>
  <worldbody>
    <body name="thigh"><joint name="hip" axis="0 0 1" damping="1.5" armature="0.1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.2 0.2 0.3"/></body>
  </worldbody>
  <actuator>ACTUATOR</actuator>
</mujoco>
"""
INERTIA, DAMPING, DELAY = 0.4, 1.5, 5e-3
ROS2 = """\
controller_manager:
  ros__parameters: {update_rate: 500}
legs:
  ros__parameters:
    command_interfaces: [effort]
    gains:
      hip: {p: 60.0, d: 8.0}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.xml").write_text(MODEL.replace("ACTUATOR", '<position joint="hip" kp="60" kv="8"/>'), "utf-8")
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *call: str) -> dict[str, Any]:
    assert main(["audit", *call, "--json"]) != 2
    return json.loads(capsys.readouterr().out)


def limit(kp: float, kd: float, damping: float) -> float:
    """The factor g at which J s² + b s + g (kp + kd s) e^{-sT} has its first root jω: the angle condition, then the size."""

    def angle(omega: float) -> float:
        return np.arctan2(kd * omega, kp) - omega * DELAY + np.arctan2(damping, INERTIA * omega)

    omega = brentq(angle, 1.0, np.pi / DELAY)
    return float(abs(INERTIA * omega**2 - 1j * damping * omega) / abs(kp + 1j * kd * omega))


@pytest.mark.parametrize(
    ("option", "kd", "damping", "says"),
    [
        (
            [],
            8.0,
            0.0,
            "is not counted: say what it is, --joint-damping controller (a part of kd, as in many training models) or friction: hip 1.5",
        ),
        (["--joint-damping", "controller"], 8.0 + DAMPING, 0.0, "counts as a part of the controller's kd: hip 1.5"),
        (["--joint-damping", "friction"], 8.0, DAMPING, "counts as friction of the links: hip 1.5"),
    ],
)
def test_joint_damping(folder: Path, capsys: pytest.CaptureFixture[str], option: list[str], kd: float, damping: float, says: str):
    found = told(capsys, "robot.xml", "--delay-ms", "5", *option)
    assert found["gain_limit"] == pytest.approx(limit(60.0, kd, damping), rel=1e-6)
    assert [text for text in found["warnings"] if says in text]
    assert found["joints"][0]["kd"] == pytest.approx(kd)


def test_joint_damping_is_one_of_two():
    with pytest.raises(GainroomError, match="--joint-damping motor: must be controller or friction"):
        AuditOptions(2.0, joint_damping="motor")


def test_the_files_update_rate_is_the_controllers(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "ros.yaml").write_text(ROS2, "utf-8")
    call = ("robot.xml", "--delay-ms", "5", "--gains", "ros.yaml")
    found = told(capsys, *call)
    assert found["sample_rate_hz"] == pytest.approx(500)
    assert "the controller runs at 500 Hz, as ros.yaml has it: --rate-hz says another" in found["assumptions"]
    assert found["gain_limit"] == told(capsys, *call, "--rate-hz", "500")["gain_limit"]
    other = told(capsys, *call, "--rate-hz", "1000")
    assert other["sample_rate_hz"] == pytest.approx(1000)
    assert not any("the controller runs at" in text for text in other["assumptions"])
    (folder / "ros.yaml").write_text(ROS2.replace("update_rate: 500", "use_sim_time: true"), "utf-8")
    assert told(capsys, *call)["model"] == "continuous"


@pytest.mark.parametrize(
    ("old", "new", "rate"),
    [
        ("", "", 500),
        ("command_interfaces: [effort]", "command_interfaces: [effort]\n    update_rate: 100", 100),
        ("command_interfaces: [effort]", "command_interfaces: [effort]\n    update_rate: 0", 500),
        ("update_rate: 500", "update_rate: 250.0", 250),
        ("controller_manager:", "/two/controller_manager:", 500),
        ("legs:", "arms: {ros__parameters: {update_rate: 50}}\nlegs:", 500),
    ],
)
def test_rates(old: str, new: str, rate: float):
    assert parse_gains(ROS2.replace(old, new) if old else ROS2, "f").origin.sample_rate_hz == rate


@pytest.mark.parametrize("value", ["fast", "-1", "[500]", "1e9"])
def test_a_rate_that_is_none_is_refused(value: str):
    with pytest.raises(GainroomError, match=r"f: controller_manager\.ros__parameters\.update_rate: "):
        parse_gains(ROS2.replace("500", value), "f")


def test_a_keyframe_of_the_scene(folder: Path):
    def angles(*posture: str) -> dict[str, float]:
        spec = audited("robot.xml", None, AuditOptions(2.0, posture=posture)).system
        return {**spec.source.postures[next(iter(spec.source.postures))].angles, **dict.fromkeys(spec.assumptions, 0.0)}

    keys = '<keyframe><key name="bent" qpos="0.7"/></keyframe>'
    (folder / "a_scene.xml").write_text("<mujoco", "utf-8")  # another's, and broken
    (folder / "other_scene.xml").write_text(f"<mujoco>{keys.replace('0.7', '0.1')}</mujoco>", "utf-8")  # includes nothing
    (folder / "scene.xml").write_text(f'<mujoco><include file="robot.xml"/>{keys}</mujoco>', "utf-8")
    found = angles("bent")
    assert found["hip"] == pytest.approx(0.7)
    assert "--posture bent: the keyframe of scene.xml" in found
    with pytest.raises(GainroomError, match="must be JOINT=ANGLE, or a keyframe of an MJCF"):
        angles("bend")
