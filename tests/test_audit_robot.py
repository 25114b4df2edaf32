"""What `audit` takes for each joint and contact, and the robot.yaml that it writes, against the robot described by hand."""

import json
from pathlib import Path

import pytest

import gainroom as gr
from gainroom.cli import main
from robot_bodies import write
from test_linkages import FOUR_BAR

BIPED = "gainroom:biped.urdf"
GAINS = """gains:
  default: {kp: 900, kd: 40, motor_inertia: 0.8}
  ".*_knee": {kp: 700, kd: 30, stiffness: 6000, damping: 2.5, link_viscous: 0.7}
"""


def asked(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict]:
    status = main([*arguments, "--json"])
    return status, json.loads(capsys.readouterr().out)


def by_hand(folder: Path, kind: str) -> gr.System:
    text = f"""
model: {{package: gainroom, file: biped.urdf, base: floating, gravity_stiffness: false}}
joints:
  default: {{motor_inertia: 0.8, stiffness: 20000, damping: 1}}
  ".*_knee": {{stiffness: 6000, damping: 2.5, link_viscous: 0.7}}
drive: {{bandwidth: .inf, delay_ms: 2}}
contacts: {{contact: [{{frame: left_sole, type: {kind}}}]}}
control: {{type: pd, kp: {{default: 900, ".*_knee": 700}}, kd: {{default: 40, ".*_knee": 30}}, feedback: motor}}
"""
    return gr.load_robot(write(folder, text, "hand.yaml")).system


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flat", "line", "point"])
def test_contacts_have_types_and_joints_their_own_gearbox(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str):
    gains = write(tmp_path, GAINS, "gains.yaml")
    typed = "left_sole" if kind == "flat" else f"left_sole:{kind}"
    arguments = ("--delay-ms", "2", "--gains", str(gains), "--stiffness", ".*_(hip|ankle)_.*=20000", "--damping", ".*_(hip|ankle)_.*=1")
    arguments += ("--contact", typed)
    _, found = asked(capsys, "audit", BIPED, *arguments)
    state = next(state for state in found["states"] if state["contact"] == "contact")
    hand = by_hand(tmp_path, kind)
    truth = gr.gain_limit(hand.loop(hand.source.linearize("zero", "contact"))).gain
    assert state["gain_limit"] == pytest.approx(truth, rel=1e-9)
    assert any("flat" in text for text in found["assumptions"]) == (kind == "flat")


@pytest.mark.slow
def test_the_written_robot_is_the_audited_one(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """Its limits, with and without contact, its rate and its joints; the model is named from where the file is."""
    monkeypatch.setattr("gainroom.studies.robot._recommended", lambda system: [])  # which take longest
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    gains = write(tmp_path, GAINS, "gains.yaml")
    arguments = ("--delay-ms", "2", "--rate-hz", "1000", "--gains", str(gains), "--contact", "left_sole:line", "--posture", ".*_knee=0.5")
    _, found = asked(capsys, "audit", BIPED, *arguments, "--margin-db", "4", "--write-robot", "out/robot.yaml")
    _, again = asked(capsys, "robot", "out/robot.yaml")
    for key in ("gain_limit", "limit_frequency_rad_s", "posture", "contact"):
        assert [state[key] for state in again["states"]] == [state[key] for state in found["states"]]
    system = gr.load_robot("out/robot.yaml").system
    assert system.requirements.gain_margin == pytest.approx(10 ** (4 / 20))
    usual = gr.Requirements.usual()
    assert system.requirements.phase_margin == pytest.approx(usual.phase_margin)
    assert system.requirements.peak_sensitivity == usual.peak_sensitivity
    assert system.control.sample_time == 1e-3


@pytest.mark.slow
def test_the_written_robot_keeps_loops_and_its_model_beside_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    model, out = write(tmp_path, FOUR_BAR, "bars.xml"), tmp_path / "robot.yaml"
    _, found = asked(capsys, "audit", str(model), "--delay-ms", "2", "--write-robot", str(out))
    assert "file: bars.xml" in out.read_text()
    assert gr.load_robot(out).body.passive == ("coupler", "rocker")
    _, again = asked(capsys, "robot", str(out))
    assert again["states"][0]["gain_limit"] == found["gain_limit"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--write-robot", "robot.txt"), ["robot.txt", ".yaml"]),
        (("--write-robot", "gains.yaml"), ["gains.yaml"]),  # has been read
        (("--contact", "left_sole:ball"), ["left_sole:ball", "frame"]),
        (("--write-robot", "no/robot.yaml"), ["no/robot.yaml", "directory"]),
    ],
)
def test_refused_calls_write_nothing(tmp_path: Path, capsys, monkeypatch, arguments: tuple[str, ...], words: list[str]):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, GAINS, "gains.yaml")
    assert main(["audit", BIPED, "--delay-ms", "2", "--gains", "gains.yaml", *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert all(word in line for word in words)
    assert [path.name for path in tmp_path.iterdir()] == ["gains.yaml"]
    assert (tmp_path / "gains.yaml").read_text() == GAINS


@pytest.mark.parametrize("wrong", ["stiffness: -1", "damping: .nan", "link_viscous: much"])
def test_numbers_of_a_gearbox_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: str):
    gains = write(tmp_path, f"gains: {{default: {{kp: 9, kd: 1, motor_inertia: 0.5, {wrong}}}}}", "gains.yaml")
    assert main(["audit", BIPED, "--delay-ms", "2", "--gains", str(gains)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"gains.default.{wrong.partition(':')[0]}" in line
