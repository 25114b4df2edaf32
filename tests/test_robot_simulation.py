"""gainroom simulate of a whole robot: it follows its scenario, leaves what friction allows, falls and runs away where it must."""

import json
from pathlib import Path

import pytest

from gainroom.cli import main
from gainroom.io.logs import read_log
from robot_files import ROBOT, write_arm

JOINT = ROBOT + "scenario: {duration: 1.0, move: {joint: elbow, by: 0.1, duration: 0.5}}\n"


def played(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, dict]:
    status = main(["simulate", str(path), "--json", *options])
    return status, json.loads(capsys.readouterr().out, parse_constant=pytest.fail)


def test_joint_space_with_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    log = tmp_path / "run.csv"
    status, facts = played(write_arm(tmp_path, JOINT), capsys, "--log", str(log))
    assert status == 0
    assert set(facts["tracking"]) == {"shoulder", "elbow"}
    kept = read_log(log)
    assert kept.joint_names == ("shoulder", "elbow")
    travelled = kept.signals["motor_position"][-1] - kept.signals["motor_position"][0]
    assert travelled[1] == pytest.approx(0.1, abs=2e-3)  # weight is compensated as it changes: what is left is next to nothing
    assert abs(travelled[0]) < 2e-3
    assert main(["simulate", str(tmp_path / "robot.yaml")]) == 0
    assert capsys.readouterr().out.startswith("Tracks and does not vibrate")


def test_task_space_moves_the_task(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = ROBOT.replace(", kp: 400.0, kd: 30.0", ", space: task")
    status, facts = played(write_arm(tmp_path, text), capsys)
    assert status == 0
    channels = list(facts["tracking"])
    assert channels[:3] == ["com x", "com y", "com z"]
    assert facts["tracking"]["com x"]["peak"] < 0.01  # the default move; it follows, so it is never a whole centimetre off


def test_friction_leaves_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A stuck PD joint is off by at most Coulomb torque over kp."""
    rubbing = JOINT.replace("by: 0.1, duration: 0.5}", "by: 0.1, duration: 0.5}, friction: {coulomb: {elbow: 4.0}}")
    _, free = played(write_arm(tmp_path, JOINT), capsys)
    _, stuck = played(write_arm(tmp_path, rubbing), capsys)
    left = abs(stuck["tracking"]["elbow"]["steady_state"])
    assert left > 3 * abs(free["tracking"]["elbow"]["steady_state"])
    assert left < 1.05 * 4.0 / 400.0


def test_too_much_gain_diverges(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    status, facts = played(write_arm(tmp_path, JOINT), capsys, "--gain", "20")
    assert status == 1
    assert facts["diverged"] or facts["vibrates"]


@pytest.mark.parametrize(
    ("scenario", "says"),
    [
        ("{posture: bend}", "scenario.posture: 'bend'"),
        ("{move: {task: com, by: 0.1}}", "give joint"),
        ("{move: {joint: elbow, by: [0.1, 0.2]}}", "scenario.move.by: 2 numbers must be one"),
        ("{move: {joint: wrist, by: 0.1}}", "wrist"),
        ("{friction: {coulomb: {wrist: 0.1}}}", "wrist"),
        ("{ground: 1}", "true or false"),
    ],
)
def test_a_wrong_scenario_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], scenario: str, says: str):
    path = write_arm(tmp_path, ROBOT + f"scenario: {scenario}\n")
    assert main(["simulate", str(path)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err
    assert str(path) in err
