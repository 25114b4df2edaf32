"""A joint.yaml without gains: `gainroom joint` tells which may be used; other commands ask for them."""

import json
from pathlib import Path

import pytest

from gainroom.cli import main

ELBOW = """
joint: {rotor_inertia: 7.0e-5, gear_ratio: 80, link_inertia: 0.35, stiffness: 900, damping: 0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 3.0}
control: {type: pd, feedback: motor, sample_rate_hz: 1000}
"""


def written(folder: Path, text: str) -> str:
    path = folder / "elbow.yaml"
    path.write_text(text, "utf-8")
    return str(path)


def answer(capsys: pytest.CaptureFixture[str], *arguments: str):
    status = main([*arguments, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_the_gains_that_may_be_used_are_those_recommended_beside_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    page = tmp_path / "elbow.html"
    status, asked = answer(capsys, "joint", written(tmp_path, ELBOW), "--report", str(page))
    assert status == 0
    assert asked["verdict"] == "safe"
    _, beside = answer(capsys, "joint", written(tmp_path, ELBOW.replace("type: pd,", "type: pd, kp: 500, kd: 20,")))
    assert asked["recommended"]["kp"] == beside["recommended"]["kp"]
    assert asked["recommended"]["kd"] == beside["recommended"]["kd"]
    assert asked["dynamic_stiffness"] == pytest.approx(asked["recommended"]["margins"]["dynamic_stiffness"], rel=1e-9)
    assert f"kp: {asked['recommended']['kp']:g}" in page.read_text("utf-8")


def test_no_gains_is_an_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """With 0.3 s of delay none keep 6 dB, 30° and Ms 2 about a gearbox without damping."""
    path = written(tmp_path, ELBOW.replace("delay_ms: 3.0", "delay_ms: 300.0"))
    status, found = answer(capsys, "joint", path)
    assert (status, found["verdict"], found["recommended"]) == (1, "unsafe", None)
    assert main(["joint", path, "--exit-zero"]) == 0
    assert "No PD gains meet the requirements" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["simulate", "verify"])
def test_other_commands_need_gains(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main([command, written(tmp_path, ELBOW)]) == 2
    told = capsys.readouterr().err
    assert "control.kp is missing" in told
    assert "`gainroom joint FILE` tells which gains may be used" in told


def test_gains_with_a_ratio_to_others_are_asked_for_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["joint", written(tmp_path, ELBOW.replace("type: pd", "type: pid"))]) == 2
    assert "control.ki is missing" in capsys.readouterr().err
