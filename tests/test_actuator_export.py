"""Joints as actuators of a trainer: every number of the file is there, and what an actuator cannot hold is refused by name."""

import ast
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from gainroom.cli import main
from robot_files import write_arm

JOINT: dict[str, Any] = {
    "joint": {
        "rotor_inertia": 2e-5,
        "gear_ratio": 50,
        "link_inertia": 0.3,
        "stiffness": 3000.0,
        "damping": 0.5,
        "motor_viscous": 0.2,
        "link_viscous": 0.1,
    },
    "drive": {"bandwidth": 2500.0, "delay_ms": 4.4},
    "control": {"type": "pd", "kp": 300.0, "kd": 5.0, "feedback": "link", "sample_rate_hz": 500},
}


def exported(path: Path, data: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> tuple[list[dict[str, Any]], list[str]]:
    """Keyword arguments of each configuration, of a text that is read as Python, and notes."""
    path.write_text(yaml.safe_dump(data), "utf-8")
    assert main(["export", str(path), "--to", "mjlab-actuator", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    tree = ast.parse(told["text"])
    (imported,) = (node for node in tree.body if isinstance(node, ast.ImportFrom))
    assert (imported.module, [each.name for each in imported.names]) == ("gainroom.trainers.mjlab", ["ElasticDelayedActuatorCfg"])
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return [{str(one.arg): ast.literal_eval(one.value) for one in call.keywords} for call in calls], told["notes"]


def test_a_joint_has_its_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    found, notes = exported(tmp_path / "knee.yaml", JOINT, capsys)
    assert found == [
        {
            "target_names_expr": ("knee",),
            "stiffness": 300.0,
            "damping": 5.0,
            "viscous_damping": 0.1,
            "motor_inertia": pytest.approx(2e-5 * 50**2),
            "gearbox_stiffness": 3000.0,
            "gearbox_damping": 0.5,
            "viscous": 0.2,
            "delay": pytest.approx(4.4e-3),
            "period": pytest.approx(1 / 500),
            "bandwidth": 2500.0,
            "encoder": "link",
        }
    ]
    assert any("effort_limit" in note for note in notes)
    assert not any("jitter" in note for note in notes)
    _, notes = exported(tmp_path / "late.yaml", {**JOINT, "limits": {"jitter_margin_ms": 0.5}}, capsys)
    assert any("jitter" in note for note in notes)


def test_kd_keeps_its_own_path_and_rigid_is_rigid(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    control = {**JOINT["control"], "feedback": "motor", "kd_path": {"delay_ms": 0.3, "sample_rate_hz": 2000}}
    joint = {"motor_inertia": 0.04, "link_inertia": 0.3, "stiffness": float("inf")}
    drive = {"bandwidth": float("inf"), "delay_ms": 4.4, "command_delay_ms": 6}
    ((found,), notes) = exported(tmp_path / "a.yaml", {"joint": joint, "drive": drive, "control": control}, capsys)
    assert (found["kd_delay"], found["kd_period"]) == (pytest.approx(0.3e-3), pytest.approx(5e-4))
    assert not found.keys() & {"gearbox_stiffness", "gearbox_damping", "bandwidth", "encoder", "viscous"}
    assert any(note.startswith("set-points are 6 ms late") for note in notes)


def test_joints_of_a_robot_with_equal_numbers_are_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write_arm(tmp_path)
    data = yaml.safe_load(path.read_text("utf-8"))
    (first, *others) = names = robot_joints(path)
    data["joints"] = {**data["joints"], first: {"motor_inertia": 0.77, "stiffness": 4321.0, "effort_limit": 33.0}}
    data["control"] |= {"sample_rate_hz": 1000}
    found, notes = exported(path, data, capsys)
    assert sorted(name for one in found for name in one["target_names_expr"]) == sorted(names)
    own = next(one for one in found if first in one["target_names_expr"])
    assert own["target_names_expr"] == (first,)
    assert (own["motor_inertia"], own["gearbox_stiffness"], own["effort_limit"]) == (0.77, 4321.0, 33.0)
    assert others
    assert all(first not in note for note in notes)
    data["joints"][first] = {"motor_inertia": 0.77, "gearbox": "planetary"}
    found, notes = exported(path, data, capsys)
    own = next(one for one in found if first in one["target_names_expr"])
    assert own["gearbox_stiffness"] == pytest.approx(0.77 * 100.0 * 1600.0)  # the geometric middle of the type's range
    assert any(note.startswith(f"the gearbox of {first} is known by its type alone") for note in notes)


def robot_joints(path: Path) -> tuple[str, ...]:
    from gainroom.files.robot_yaml import load_robot

    return load_robot(path).joint_names


NO_PLACE = "has no place in an actuator"
REFUSED = [
    ({"velocity_filter": {"bandwidth": 900}}, f"control.velocity_filter: a filter {NO_PLACE}"),
    ({"notches": [{"frequency": 300}]}, f"control.notches: a filter {NO_PLACE}"),
    ({"type": "pid", "ki": 20}, f"control.type: pid: ki {NO_PLACE}"),
    ({"type": "ppi", "kp": 10, "kv": 4, "ki": 3, "kd": None}, "control.type: ppi:"),
    ({"feedback": {"kp": "link", "kd": "motor"}}, f"control.feedback: a sensor for each gain (kp link, kd motor) {NO_PLACE}"),
    ({"sample_rate_hz": None}, "control.sample_rate_hz is missing"),
]


@pytest.mark.parametrize(("others", "said"), REFUSED, ids=[said for _, said in REFUSED])
def test_what_it_cannot_hold_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str], others: dict[str, Any], said: str):
    control = {key: value for key, value in {**JOINT["control"], **others}.items() if value is not None}
    path = tmp_path / "joint.yaml"
    path.write_text(yaml.safe_dump({**JOINT, "control": control}), "utf-8")
    assert main(["export", str(path), "--to", "mjlab-actuator"]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_gains_alone_are_not_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "gains.yaml"
    path.write_text("knee: {kp: 40, kd: 3}\n", "utf-8")
    assert main(["export", str(path), "--to", "mjlab-actuator"]) == 2
    assert "needs a joint.yaml or a robot.yaml" in capsys.readouterr().err
    assert main(["export", str(path), "--to", "mjlab_actuator"]) == 2
    assert "mjlab-actuator" in capsys.readouterr().err


def test_audit_reads_motor_and_gearbox_of_what_was_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The limit that gainroom robot finds is that of an audit of the file, with the loop's delay and rate typed."""
    path = write_arm(tmp_path)
    data = yaml.safe_load(path.read_text("utf-8"))
    data["control"] = {"type": "pd", "kp": 400.0, "kd": 30.0, "feedback": "motor", "sample_rate_hz": 1000}
    data["joints"] = {"default": {"motor_inertia": 0.5, "stiffness": 5e3, "damping": 2.0}}
    data |= {"drive": {"bandwidth": float("inf"), "delay_ms": 2.0}, "postures": {"zero": {}}}
    path.write_text(yaml.safe_dump(data), "utf-8")
    assert main(["export", str(path), "--to", "mjlab-actuator", "--output", str(tmp_path / "a.py"), "--write"]) == 0
    capsys.readouterr()
    assert main(["robot", str(path), "--json"]) != 2
    wanted = json.loads(capsys.readouterr().out)["states"][0]["gain_limit"]
    model = tmp_path / data["model"]["file"]
    assert main(["audit", str(model), "--gains", str(tmp_path / "a.py"), "--delay-ms", "2", "--rate-hz", "1000", "--json"]) != 2
    told = json.loads(capsys.readouterr().out)
    assert told["gain_limit"] == pytest.approx(wanted, rel=1e-6)
    assert any("delay, period: not read here" in warning for warning in told["warnings"])
