"""What was audited of gains goes along: through --json, export and every form, and the next audit judges the same."""

import json
from pathlib import Path
from typing import Any

import pytest

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.gain_files import read_gains

LEG = """\
<mujoco>
  <worldbody>
    <body name="thigh"><joint name="hip" axis="0 1 0" armature="0.1"/>
      <inertial pos="0 0 -0.1" mass="4" diaginertia="0.02 0.02 0.02"/>
      <body name="shank" pos="0 0 -0.3"><joint name="knee" axis="0 1 0" armature="0.05" damping="0.5"/>
        <inertial pos="0 0 -0.2" mass="3" diaginertia="0.01 0.01 0.01"/></body></body>
  </worldbody>
</mujoco>
"""
GAINS = """\
hip: {kp: 123.456789012345, kd: 7.1, motor_inertia: 0.2, effort_limit: 88.5}
knee: {kp: 60, kd: 2.3, effort_limit: 30}
"""
PLACES = {
    "continuous": [],
    "host": ["--rate-hz", "400", "--gains-run", "host"],
    "rate": ["--rate-hz", "333.3"],
    "drive": ["--gains-run", "drive", "--drive-rate-hz", "8000", "--drive-delay-ms", "0.3"],
    "split": ["--rate-hz", "400", "--gains-run", "split", "--drive-rate-hz", "1200", "--drive-delay-ms", "0.3"],
}
JUDGED = ("safe", "gain_limit", "delay_limit_ms", "limit_frequency_rad_s", "sample_rate_hz", "kd_path", "command_delay_ms", "gains_run")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "leg.xml").write_text(LEG, "utf-8")
    (tmp_path / "gains.yaml").write_text(GAINS, "utf-8")
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *call: str) -> dict[str, Any]:
    status = main([*call, "--json"])
    out, err = capsys.readouterr()
    assert status < 2, err
    return json.loads(out)


def audited(capsys: pytest.CaptureFixture[str], gains: str, *options: str) -> dict[str, Any]:
    return told(capsys, "audit", "leg.xml", "--delay-ms", "3", "--gains", gains, *options)


def limits(answer: dict[str, Any]) -> dict[str, float | None]:
    return {joint["name"]: joint["effort_limit"] for joint in answer["joints"]}


@pytest.mark.parametrize("place", PLACES)
def test_an_answer_is_judged_the_same_without_saying_anything_again(folder: Path, capsys: pytest.CaptureFixture[str], place: str):
    """To the last bit: the numbers of an answer are written in full."""
    first = audited(capsys, "gains.yaml", *PLACES[place], "--posture", "knee=1.1")
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    second = audited(capsys, "answer.json")
    assert {key: second[key] for key in JUDGED} == {key: first[key] for key in JUDGED}
    assert second["joints"] == first["joints"]
    assert second["posture"] == first["posture"]
    assert limits(second) == {"hip": 88.5, "knee": 30.0}


def test_what_is_typed_wins_over_what_an_answer_says(folder: Path, capsys: pytest.CaptureFixture[str]):
    first = audited(capsys, "gains.yaml", *PLACES["drive"], "--posture", "knee=1.1")
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    typed = audited(capsys, "answer.json", *PLACES["host"], "--posture", "knee=0.2")
    plain = audited(capsys, "gains.yaml", *PLACES["host"], "--posture", "knee=0.2")
    assert {key: typed[key] for key in JUDGED} == {key: plain[key] for key in JUDGED}
    assert main(["audit", "leg.xml", "--delay-ms", "3", "--gains", "answer.json", "--rate-hz", "400"]) == 2
    assert "--rate-hz 400: the gains of answer.json run on the drive" in capsys.readouterr().err


def test_an_answer_without_a_place_tells_it_by_its_numbers(folder: Path, capsys: pytest.CaptureFixture[str]):
    """As answers of before do, which had the path of kd and the delay of set-points."""
    first = audited(capsys, "gains.yaml", *PLACES["drive"])
    del first["gains_run"]
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    second = audited(capsys, "answer.json")
    assert second["gains_run"] == "drive"
    assert second["gain_limit"] == first["gain_limit"]
    path = {"sample_rate_hz": 400.0, "kd_path": {"delay_ms": 0.3, "sample_rate_hz": 8000.0}, "delay_ms": 3.0, "command_delay_ms": 0.0}
    (folder / "answer.json").write_text(json.dumps(first | path), "utf-8")
    origin = read_gains(folder / "answer.json").origin
    assert (origin.gains_run, origin.sample_rate_hz, origin.delay_ms) == ("split", 400.0, 3.0)
    assert (origin.drive_rate_hz, origin.drive_delay_ms) == (8000.0, 0.3)


def test_damping_that_was_counted_is_not_counted_twice(folder: Path, capsys: pytest.CaptureFixture[str]):
    first = audited(capsys, "gains.yaml", "--rate-hz", "400", "--joint-damping", "controller")
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    assert {joint["name"]: joint["kd"] for joint in first["joints"]}["knee"] == pytest.approx(2.8, rel=1e-15)
    second = audited(capsys, "answer.json")
    assert second["gain_limit"] == first["gain_limit"]
    assert any("leave --joint-damping out, so that it counts once" in warning for warning in second["warnings"])


def test_a_robot_that_an_audit_writes_keeps_the_limits(folder: Path, capsys: pytest.CaptureFixture[str]):
    """And so do the gains that are found for it: its answer goes to export."""
    audited(capsys, "gains.yaml", "--rate-hz", "400", "--write-robot", "robot.yaml")
    found = told(capsys, "robot", "robot.yaml")
    assert {each["name"]: each["effort_limit"] for each in found["actuators"]} == {"hip": 88.5, "knee": 30.0}
    found["recommended"] = [{"space": "joint", "names": ["hip"], "sets": [{"contact": "everywhere", "kp": [1.0], "kd": [1.0]}]}]
    (folder / "robot.json").write_text(json.dumps(found), "utf-8")
    assert read_gains(folder / "robot.json").gains["hip"].effort_limit == 88.5


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"gains_run": "cloud"}, "gains_run 'cloud': must be host, drive or split"),
        ({"posture": {"hip": "far"}}, "posture.'hip': 'far' is text"),
        ({"sample_rate_hz": -1}, "sample_rate_hz: -1 must be >= 0"),
        ({"kd_path": {"delay_ms": [1]}}, "kd_path: delay_ms: [1] is not a number"),
    ],
)
def test_an_answer_that_was_changed_is_refused(folder: Path, changes: dict[str, Any], says: str):
    answer = {"states": [], "delay_limit_ms": 3.0, "joints": [{"name": "hip", "kp": 1.0, "kd": 1.0}], **changes}
    (folder / "answer.json").write_text(json.dumps(answer), "utf-8")
    with pytest.raises(GainroomError) as caught:
        read_gains(folder / "answer.json")
    assert says in str(caught.value)
