"""What other commands do with a workspace: audit looks at all of it, robot names worse postures and takes a sweep's."""

import json
from importlib.resources import files

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.first_crossing import SEARCH
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.robot.linearize import linearize
from gainroom.sweep.limits import configurations
from robot_files import ROBOT, write_arm

BIPED = files("gainroom") / "robot" / "models" / "biped.urdf"
PROVED = 1 - SEARCH.nudge
QUICK = ROBOT.partition("tasks:")[0] + "limits: {gain_margin_db: 6}\n"
STRETCHED = QUICK.replace("shoulder: 0.4, elbow: 0.9", "shoulder: 0.0, elbow: 0.0")


def alone(file, angles) -> float:
    """gain_limit of the file's gains at joint positions (n,)."""
    system = load_robot_system(file)
    robot = system.source
    q = configurations(robot.body, np.array([angles]))[0]
    return gr.gain_limit(system.loop(linearize(robot.body, robot.actuators, q))).gain


def test_robot_names_a_posture_that_is_worse_than_the_file_s(tmp_path, capsys):
    """The arm bends: some posture has a limit more than 1 % below that of the file's, which is the highest of a search."""
    light = STRETCHED.replace("motor_inertia: 0.5", "motor_inertia: 0.02").replace("kp: 400.0, kd: 30.0", "kp: 40.0, kd: 2.0")
    file = write_arm(tmp_path, light)
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (60, 2))
    limits = [alone(file, one) for one in angles]
    best = angles[int(np.argmax(limits))]
    file.write_text(light.replace("shoulder: 0.0, elbow: 0.0", f"shoulder: {best[0]}, elbow: {best[1]}"))
    assert min(limits) < 0.985 * max(limits)
    assert main(["robot", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    worse = found["worse_posture"]
    known = min(state["gain_limit"] for state in found["states"])
    assert worse["gain_limit"] < 0.99 * known
    assert worse["gain_limit"] == pytest.approx(alone(file, list(worse["angles"].values())) * PROVED, rel=1e-9)
    assert main(["robot", str(file)]) == 0
    assert "another posture is worse than the file's" in " ".join(capsys.readouterr().out.split())


def test_robot_takes_the_worst_postures_of_a_sweep(tmp_path, capsys):
    """They stand among its states, and recommended gains have the margin in every swept posture, not in the file's alone."""
    file, store = write_arm(tmp_path, STRETCHED), tmp_path / "sweep.zarr"
    assert main(["sweep", str(file), "--samples", "300", "--output", str(store), "--json"]) == 0
    worst = json.loads(capsys.readouterr().out)["worst"]
    assert main(["robot", str(file), "--sweep", str(store), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    states = {state["posture"]: state["gain_limit"] for state in found["states"]}
    assert states[f"sweep {worst['posture']}"] * PROVED == pytest.approx(worst["gain_limit"], rel=1e-9)
    swept = found["swept"]
    assert swept["limits"] == 300
    assert "swept 3" in states  # the recommended gains of the first round were short of it there
    assert swept["below_margin_share"] == 0
    assert swept["worst"]["gain_limit"] >= 10 ** (6 / 20)


def test_a_sweep_of_another_robot_is_refused(tmp_path, capsys):
    file, store = write_arm(tmp_path, STRETCHED), tmp_path / "sweep.zarr"
    assert main(["sweep", str(file), "--samples", "20", "--output", str(store), "--json"]) == 0
    biped = tmp_path / "biped.yaml"
    biped.write_text((files("gainroom") / "files" / "examples" / "biped.yaml").read_text())
    capsys.readouterr()
    for given, words in ((store, "is a sweep of a robot with other joints"), (tmp_path, "is not the store of a sweep")):
        assert main(["robot", str(biped), "--sweep", str(given)]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.parametrize("factor", [1.0, 6.0])
def test_audit_looks_at_the_whole_workspace(tmp_path, capsys, factor):
    """Against gain_limit at the posture it names, and by count of random ones."""
    gains = tmp_path / "gains.yaml"
    gains.write_text(f"default: {{kp: {400 * factor}, kd: {30 * factor}, motor_inertia: 1.0}}\n")
    call = ["audit", str(BIPED), "--delay-ms", "2", "--gains", str(gains), "--base", "fixed", "--workspace", "300", "--json"]
    status = main(call)
    found = json.loads(capsys.readouterr().out)
    swept = found["workspace"]
    assert swept["limits"] == 300
    assert status == (0 if found["safe"] and swept["gain_margin_met"] else 1)
    assert swept["worst"]["gain_limit"] <= found["gain_limit"] * (1 + 1e-9)
    assert (swept["below_margin_share"] > 0) is (not swept["gain_margin_met"])
    assert main(call[:-1]) == status
    assert "Workspace:" in capsys.readouterr().out


def test_what_else_fails_in_the_worst_postures_is_said(tmp_path, capsys):
    """The biped's gain margin holds everywhere; its phase margin does not, where gain limits are lowest. --strict minds."""
    biped = tmp_path / "biped.yaml"
    biped.write_text((files("gainroom") / "files" / "examples" / "biped.yaml").read_text())
    call = ["sweep", str(biped), "--samples", "200", "--contact", "left"]
    assert main([*call, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["gain_margin_met"] is True
    system = load_robot_system(biped)
    robot = system.source
    q = configurations(robot.body, np.array([list(found["worst"]["angles"].values())]))[0]
    margins = gr.joint_margins(system.loop(linearize(robot.body, robot.actuators, q, robot.contacts["left"])))
    assert ("phase_margin" in found["unmet"]) is (margins.phase_margin < np.pi / 6)
    assert found["unmet"]
    assert main([*call, "--strict"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "Not met where gain limits are lowest: phase margin" in said
    assert "Safe" not in said
