"""What was audited of gains goes along: through --json, export and every form, and the next audit judges the same."""

import datetime
import itertools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.gain_export import FORMS, export_gains
from gainroom.files.gain_files import parse_gains, read_gains
from test_actuator_configs import run

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


def with_leg(folder: Path, gains: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder, in which the test then works, with the leg and a file of gains."""
    monkeypatch.chdir(folder)
    (folder / "leg.xml").write_text(LEG, "utf-8")
    (folder / "gains.yaml").write_text(gains, "utf-8")
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return with_leg(tmp_path, GAINS, monkeypatch)


def told(capsys: pytest.CaptureFixture[str], *call: str) -> dict[str, Any]:
    status = main([*call, "--json"])
    out, err = capsys.readouterr()
    assert status != 2, err
    return json.loads(out)


def audited(capsys: pytest.CaptureFixture[str], gains: str, *options: str) -> dict[str, Any]:
    return told(capsys, "audit", "leg.xml", "--delay-ms", "3", "--gains", gains, *options)


def limits(answer: dict[str, Any]) -> dict[str, float | None]:
    return {joint["name"]: joint["effort_limit"] for joint in answer["joints"]}


@pytest.mark.parametrize("place", [pytest.param(name, marks=() if name in ("drive", "split") else pytest.mark.slow) for name in PLACES])
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
    assert "kd of answer.json has the joints' own damping of the model in it already" in second["assumptions"]


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


def exported(capsys: pytest.CaptureFixture[str], folder: Path, answer: dict[str, Any], form: str) -> tuple[str, dict[str, Any]]:
    """The name of the file of a form with an answer's gains, and what export says."""
    (folder / "answer.json").write_text(json.dumps(answer), "utf-8")
    target = f"out{FORMS[form].ending}"
    onto = ["--onto", "leg.xml"] if form == "mjcf" else []
    return target, told(capsys, "export", "answer.json", "--to", form, *onto, "--output", target, "--write")


QUICK = {("yaml", "drive"), ("mjcf", "drive"), ("ros2_control", "rate")}


@pytest.mark.parametrize(
    ("form", "place"),
    [pytest.param(*each, marks=() if each in QUICK else pytest.mark.slow) for each in itertools.product(FORMS, PLACES)],
)
def test_a_form_holds_it_or_names_the_flag(folder: Path, capsys: pytest.CaptureFixture[str], form: str, place: str):
    """What is audited again is what was audited, bit for bit but for an MJCF's armature, which is 0.1 + 0.1 of two numbers' difference."""
    (folder / "gains.yaml").write_text(GAINS.replace("kd: 2.3", "kd: 2.3, stiffness: 900, damping: 0.7"), "utf-8")
    first = audited(capsys, "gains.yaml", *PLACES[place], "--posture", "knee=1.1")
    target, said = exported(capsys, folder, first, form)
    model = [target, "--delay-ms", "3"] if form == "mjcf" else ["leg.xml", "--delay-ms", "3", "--gains", target]
    second = told(capsys, "audit", *model, *said["audit_with"])
    for key in JUDGED:
        assert second[key] == (pytest.approx(first[key], rel=1e-12) if isinstance(first[key], float) else first[key]), key
    assert second["posture"] == first["posture"]
    for mine, other in zip(second["joints"], first["joints"], strict=True):
        for key in ("kp", "kd", "motor_inertia", "stiffness", "damping"):
            assert mine[key] == (None if other[key] is None else pytest.approx(other[key], rel=1e-15)), key
    held = limits(second) == {"hip": 88.5, "knee": 30.0}
    assert held is (form not in ("legged_gym", "arrays", "c"))
    assert held is not any("limits of the torque have no place" in note for note in said["notes"])
    if said["audit_with"]:
        assert any(all(flag in note for flag in said["audit_with"] if flag.startswith("--")) for note in said["notes"])
        assert said["audit_with"][-1].split("=")[0] in (folder / target).read_text("utf-8")


def test_what_each_form_holds(folder: Path, capsys: pytest.CaptureFixture[str]):
    """By the published fields of each: mjlab's effort_limit and armature, MJCF's forcerange and armature, ros2_control's u_clamp."""
    first = audited(capsys, "gains.yaml", "--rate-hz", "400", "--posture", "knee=1.1")
    text = {form: exported(capsys, folder, first, form)[1] for form in FORMS}
    flags = {form: {each for each in said["audit_with"] if each.startswith("--")} for form, said in text.items()}
    rate, posture, inertia = "--rate-hz", "--posture", "--motor-inertia"
    assert flags == {
        "yaml": set(),
        "ros2_control": {posture, inertia},
        "mjcf": {rate, posture},
        "mjlab": {rate},
        "isaaclab": {rate},
        "legged_gym": {rate, inertia},
        "arrays": {rate, posture, inertia},
        "c": {rate, posture, inertia},
        "markdown": {rate, posture},
    }
    assert "effort_limit=88.5" in text["mjlab"]["text"]
    assert "effort_limit_sim=88.5" in text["isaaclab"]["text"]
    assert "u_clamp_max: 88.5, u_clamp_min: -88.5" in text["ros2_control"]["text"]
    assert text["legged_gym"]["text"].count('"knee": 1.1') == 1
    assert {joint["name"]: joint["effort_limit"] for joint in text["mjcf"]["joints"]} == {"hip": 88.5, "knee": 30.0}


def test_initial_states_run_as_python(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    first = audited(capsys, "gains.yaml", "--rate-hz", "400", "--posture", "knee=1.1")
    for form in ("mjlab", "isaaclab"):
        space = run(exported(capsys, folder, first, form)[1]["text"], monkeypatch)
        assert space["INITIAL_STATE"].joint_pos == {"knee": 1.1}
        assert [each.armature for each in (space["ACTUATORS"] if form == "mjlab" else space["ACTUATORS"].values())] == [0.2, 0.05]


@pytest.mark.parametrize("said", [["--stiffness", "inf"], ["--gearbox", "hip=direct", "--stiffness", "knee=900", "--damping", "knee=0.7"]])
def test_rigid_that_was_said_is_not_unknown_afterwards(folder: Path, capsys: pytest.CaptureFixture[str], said: list[str]):
    first = audited(capsys, "gains.yaml", "--rate-hz", "400", *said)
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    second = audited(capsys, "answer.json")
    assert second["rigid_gearboxes"] == first["rigid_gearboxes"] == []
    assert (second["decided"], second["gain_limit"]) == (first["decided"], first["gain_limit"])
    file = read_gains(folder / "answer.json")
    made = export_gains(file, "yaml", None, None, "1", datetime.date(2026, 1, 2))
    assert "stiffness: .inf" in made.text
    assert made.flags == ()
    flags = export_gains(file, "arrays", None, None, "1", datetime.date(2026, 1, 2)).flags
    assert ("inf" if said[1] == "inf" else "hip=inf") in flags


ODD = [("hip.2-x", "knee (l)"), ("on", "y"), ("J|1", "J=2"), ("left hip", "knee+")]


@pytest.mark.slow
@pytest.mark.parametrize("names", ODD)
@pytest.mark.parametrize("form", FORMS)
def test_names_that_look_like_patterns_are_names(folder: Path, capsys: pytest.CaptureFixture[str], form: str, names: tuple[str, str]):
    for old, new in zip(("hip", "knee"), names, strict=True):
        leg = (folder / "leg.xml").read_text("utf-8")
        (folder / "leg.xml").write_text(leg.replace(f'"{old}"', f'"{new}"'), "utf-8")
    gains = {name: {"kp": 60.0, "kd": 3.0, "motor_inertia": 0.2, "effort_limit": 30.0} for name in names}
    (folder / "gains.json").write_text(json.dumps({"gains": gains, "posture": {names[1]: 0.7}, "sample_rate_hz": 400}), "utf-8")
    first = audited(capsys, "gains.json")
    assert first["posture"] == {names[0]: 0.0, names[1]: 0.7}
    target, said = exported(capsys, folder, first, form)
    model = [target, "--delay-ms", "3"] if form == "mjcf" else ["leg.xml", "--delay-ms", "3", "--gains", target]
    second = told(capsys, "audit", *model, *said["audit_with"])
    assert second["gain_limit"] == pytest.approx(first["gain_limit"], rel=1e-12)  # an MJCF's armature is a sum
    assert second["posture"] == first["posture"]


def test_gearboxes_that_nobody_knows_stay_unknown(folder: Path, capsys: pytest.CaptureFixture[str]):
    first = audited(capsys, "gains.yaml", "--rate-hz", "400")
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    assert {gain.stiffness for gain in read_gains(folder / "answer.json").gains.values()} == {None}


ACTUATED = {
    "a servo with a gear": ('<position joint="hip" kp="1" gear="-3"/><position joint="knee" kp="2" forcerange="-5 5"/>', ""),
    "a servo and a damper": ('<position joint="hip" kp="1" forcerange="-5 5"/><velocity joint="hip" kv="1"/>', ""),
    "a rotor on the actuator": ('<position joint="hip" kp="1" gear="2" armature="0.01"/>', ""),
    "a joint's own limit": ('<motor joint="hip" ctrlrange="-20 20"/>', ' actuatorfrcrange="-7 7"'),
    "nothing": ("", ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", ACTUATED)
def test_mujoco_has_limits_and_armature(folder: Path, case: str):
    """MuJoCo's own generalized forces where the set-point is far away, and its own mass matrix with and without the rotors."""
    import mujoco

    actuators, limit = ACTUATED[case]
    text = LEG.replace('armature="0.1"', f'armature="0.1"{limit}').replace("</mujoco>", f"<actuator>{actuators}</actuator></mujoco>")
    (folder / "leg.xml").write_text(text.replace("<mujoco>", '<mujoco><compiler autolimits="true"/>'), "utf-8")
    made = export_gains(read_gains(folder / "gains.yaml"), "mjcf", folder / "leg.xml", None, "1", datetime.date(2026, 1, 2))
    model = mujoco.MjModel.from_xml_string(made.text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((2, 2))
    mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, full)
    bare = mujoco.MjModel.from_xml_string(LEG.replace('armature="0.1"', "").replace('armature="0.05"', ""))
    other = mujoco.MjData(bare)
    mujoco.mj_forward(bare, other)
    links = np.zeros((2, 2))
    mujoco.mj_fullM(bare, links, other.qM) if hasattr(other, "qM") else mujoco.mj_fullM(bare, other, links)
    assert np.diag(full - links) == pytest.approx([0.2, 0.05], rel=1e-12)  # round-off of sums of 1
    for joint, most in (("hip", 88.5), ("knee", 30.0)):
        sign = float(np.sign(model.actuator_gear[[model.actuator(k).trnid[0] == model.joint(joint).id for k in range(model.nu)]][0, 0]))
        for far in (-1e4, 1e4):
            data.ctrl[:] = 0.0
            data.ctrl[
                [model.actuator(k).trnid[0] == model.joint(joint).id and model.actuator_gainprm[k, 0] > 50 / 9 for k in range(model.nu)]
            ] = far
            mujoco.mj_forward(model, data)
            assert data.qfrc_actuator[model.joint(joint).dofadr[0]] == pytest.approx(sign * np.sign(far) * most, rel=1e-12)


def test_joints_of_an_included_file_keep_theirs_and_it_is_said(folder: Path, capsys: pytest.CaptureFixture[str]):
    body = LEG[LEG.index("    <body") : LEG.index("  </worldbody>")]
    (folder / "body.xml").write_text(f"<mujoco>{body}</mujoco>", "utf-8")
    servos = '<actuator><position joint="hip" kp="1"/><position joint="knee" kp="1"/></actuator>'
    (folder / "leg.xml").write_text(f'<mujoco><worldbody><include file="body.xml"/></worldbody>{servos}</mujoco>', "utf-8")
    said = told(capsys, "export", "gains.yaml", "--to", "mjcf", "--onto", "leg.xml")
    assert said["audit_with"] == ["--motor-inertia", "hip=0.2"]
    assert "armature" not in said["text"]


def test_what_a_pipe_gets_is_told_beside_it(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["export", "gains.yaml", "--to", "legged_gym"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("# gains by gainroom")
    assert "#   audit it with: --motor-inertia hip=0.2\n" in out
    assert "note: the motors' inertia has no place in this form: audit it with --motor-inertia hip=0.2\n" in err
    assert "note: limits of the torque have no place in this form, or not for hip, knee" in err


def test_a_file_that_runs_at_another_rate_says_so(folder: Path, capsys: pytest.CaptureFixture[str]):
    """A whole number of ticks a second is all that ros2_control takes, and a file that is there keeps its own."""
    first = audited(capsys, "gains.yaml", "--rate-hz", "333.3")
    _, said = exported(capsys, folder, first, "ros2_control")
    assert "update_rate: 333\n" in said["text"]
    assert said["audit_with"][-2:] == ["--rate-hz", "333.3"]
    there = "controller_manager: {ros__parameters: {update_rate: 1000}}\nlegs: {gains: {hip: {p: 1.0}, knee: {p: 1.0, u_clamp_max: 9.0}}}\n"
    (folder / "ros.yaml").write_text(there, "utf-8")
    said = told(capsys, "export", "answer.json", "--to", "ros2_control", "--onto", "ros.yaml")
    assert said["audit_with"][-2:] == ["--rate-hz", "333.3"]
    assert any("the controller's rate (1000 Hz in the file)" in note for note in said["notes"])
    assert {joint["name"]: joint["effort_limit"] for joint in said["joints"]} == {"hip": 88.5, "knee": 30.0}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("gains_run: drive", "drive_rate_hz is missing, which gains_run: drive needs"),
        ("drive_delay_ms: 1", "drive_delay_ms has no meaning without gains_run: drive or split"),
        (
            "gains_run: drive\nsample_rate_hz: 100\ndrive_rate_hz: 100\ndrive_delay_ms: 1",
            "sample_rate_hz has no meaning with gains_run: drive",
        ),
        ("gains_run: cloud", "gains_run: 'cloud' must be host, drive or split"),
        ("posture: {hip: far}", "posture.hip: 'far' is text"),
        ("sample_rate_hz: 0", "sample_rate_hz: 0 must be >= 1"),
    ],
)
def test_a_plain_file_says_a_place_as_a_whole(text: str, says: str):
    with pytest.raises(GainroomError, match=re.escape(says)):
        parse_gains(f"{text}\ngains: {{hip: [1, 1]}}", "g.yaml")


def test_patterns_of_a_posture_stand_for_joints(folder: Path):
    file = parse_gains('posture: {".*": 0.5, knee: 0}\ngains: {hip: [3, 1], knee: [2, 1]}', "g.yaml")
    made = export_gains(file, "legged_gym", None, None, "1", datetime.date(2026, 1, 2))
    assert '"hip": 0.5' in made.text
    assert '"knee": 0.0' in made.text
