"""Gains in other people's forms: read back with the same verdict, as simulators themselves have them, nothing overwritten unasked."""

import datetime
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.export_forms.form import number_text
from gainroom.files.gain_export import FORMS, export_gains
from gainroom.files.gain_files import parse_gains, read_gains
from gainroom.files.gain_formats.gain_record import Gain
from mujoco_feedback import compiled_feedback
from test_actuator_configs import run, truth

TODAY = datetime.date(2026, 1, 2)
MODEL = """\
<mujoco>
  <compiler autolimits="true"/>
  <default><position dampratio="1" timeconst="0.02"/><default class="geared"><general gear="3"/></default></default>
  <worldbody>
    <body name="thigh"><joint name="hip" axis="0 1 0" damping="3" armature="0.1" range="-1 1"/>
      <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="shank" pos="0 0 -0.2"><joint name="knee" axis="0 1 0" armature="0.05"/>
        <inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></body>
  </worldbody>
  <actuator>
    ACTUATORS
  </actuator>
</mujoco>
"""
PAIR = '<position name="a" joint="hip" kp="1"/><motor name="b" joint="knee" ctrlrange="-20 20"/>'
GAINS = {"hip": Gain(40.0, 3.0), "knee": Gain(25.5, 1.25)}
PLAIN = "hip: {kp: 40, kd: 3, motor_inertia: 0.1}\nknee: {kp: 25.5, kd: 1.25, motor_inertia: 0.05}\n"
# The published parameters of the controllers' `gains`, Jazzy to rolling (ros2_controllers: joint_trajectory_controller/src/
# joint_trajectory_controller_parameters.yaml and pid_controller/src/pid_controller.yaml); all of p, i and d are doubles.
PUBLISHED = {"joints", "command_interfaces", "state_interfaces", "gains"}
PUBLISHED_GAINS = {"p", "i", "d", "ff_velocity_scale", "u_clamp_max", "u_clamp_min", "i_clamp_max", "i_clamp_min", "antiwindup_strategy"}
ROS2 = """\
# ours
controller_manager:
  ros__parameters: {update_rate: 500}
legs:
  ros__parameters:
    joints: [hip, knee]
    command_interfaces: [effort]
    gains:
      hip: {p: 1, i: 0.0, d: 2.0, i_clamp: 5.0}   # stiff
      knee:
        ff_velocity_scale: 0.0
        p: 7.0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.xml").write_text(MODEL.replace("ACTUATORS", PAIR), "utf-8")
    (tmp_path / "gains.yaml").write_text(PLAIN, "utf-8")
    (tmp_path / "ros.yaml").write_text(ROS2, "utf-8")
    return tmp_path


def onto(folder: Path, form: str) -> Path | None:
    return {"mjcf": folder / "robot.xml"}.get(form)


def exported(form: str, text: str = PLAIN, onto: Path | None = None, model: Path | None = None) -> str:
    return export_gains(parse_gains(text, "gains.yaml"), form, onto, model, "1.2.3", TODAY).text


def told(capsys: pytest.CaptureFixture[str], *call: str) -> dict[str, Any]:
    assert main([*call, "--json"]) != 2
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.parametrize("form", [*FORMS, "ros2_control onto"])
def test_the_same_verdict_is_read_back(folder: Path, capsys: pytest.CaptureFixture[str], form: str):
    """The audit of what was exported is the audit of the gains; ten digits of a gain are ten digits of its limit."""
    form, _, other = form.partition(" ")
    target = f"out{FORMS[form].ending}"
    source = folder / "ros.yaml" if other else onto(folder, form)
    call = ["export", "gains.yaml", "--to", form, "--output", target, "--write", *(["--onto", str(source)] if source else [])]
    said = told(capsys, *call)
    assert said["written"] is True
    assert (folder / target).read_text("utf-8") == said["text"]
    rate = ("--rate-hz", "500") if other else ()  # which that file has
    question = ("--delay-ms", "2", "--stiffness", "400", "--damping", "1", *rate)
    before = told(capsys, "audit", "robot.xml", "--gains", "gains.yaml", *question)
    after = told(capsys, "audit", "robot.xml", "--gains", target, *question)
    assert after["safe"] == before["safe"]
    for key in ("gain_limit", "delay_limit_ms"):
        assert after[key] == pytest.approx(before[key], rel=1e-8)
    assert [joint["name"] for joint in after["joints"]] == [joint["name"] for joint in before["joints"]]
    again = told(capsys, "audit", target, *question) if form == "mjcf" else after
    assert again["gain_limit"] == pytest.approx(before["gain_limit"], rel=1e-8)


@pytest.mark.parametrize("form", FORMS)
def test_where_they_come_from_stands_inside(folder: Path, form: str):
    text = exported(form, onto=onto(folder, form))
    for words in ("gains by gainroom 1.2.3, 2026-01-02, from gains.yaml (plain)", "delay: not said in that file", "margins: not known"):
        assert words in text


@pytest.mark.slow
@pytest.mark.parametrize(
    "actuators",
    [
        PAIR,
        '<position joint="hip" kp="5" kv="1" class="geared"/><motor joint="knee" class="geared"></motor>',
        '<general joint="hip" biastype="affine" gainprm="60" biasprm="4 -30 -1" gear="-2"/>'
        '<intvelocity joint="knee" kp="3" actrange="-1 1"/>',
        '<position joint="hip" kp="5"/><velocity joint="hip" kv="1"/><pid joint="knee" kp="1"/>',
        "",
    ],
    ids=["position and motor", "gears", "general", "two on a joint", "none"],
)
def test_mujoco_has_the_gains(folder: Path, actuators: str):
    """MuJoCo's forces themselves, by differences at rest, whatever its defaults and classes say."""
    path = folder / "robot.xml"
    path.write_text(MODEL.replace("ACTUATORS", actuators), "utf-8")
    target = folder / "out.xml"
    target.write_text(exported("mjcf", onto=path), "utf-8")
    found = compiled_feedback(target)
    for joint, gain in GAINS.items():
        assert found[joint] == pytest.approx((gain.kp, gain.kd), rel=1e-6)
    assert target.read_text("utf-8").count("<!--") == 1
    again = exported("mjcf", onto=target)
    assert again.count("<!--") == 1
    assert again == target.read_text("utf-8")


def test_a_motors_limit_becomes_the_servos(folder: Path):
    import mujoco

    model = mujoco.MjModel.from_xml_string(exported("mjcf", onto=folder / "robot.xml"))
    assert model.actuator("b").forcerange.tolist() == [-20, 20]
    assert not model.actuator("b").ctrllimited
    assert model.actuator("a").id == 0  # names and order stay


def test_a_generals_input_keeps_its_scale(folder: Path):
    import mujoco

    path = folder / "robot.xml"
    path.write_text(MODEL.replace("ACTUATORS", '<general joint="hip" biastype="affine" gainprm="60" biasprm="4 -30 -1"/>'), "utf-8")
    model = mujoco.MjModel.from_xml_string(exported("mjcf", "hip: [60, 2]", onto=path))
    assert model.actuator_gainprm[0, 0] == 120
    assert model.actuator_biasprm[0, :3].tolist() == [8, -60, -2]


@pytest.mark.parametrize(("form", "name"), [("mjlab", "mjlab"), ("isaaclab", "isaaclab")])
def test_simulators_files_run_as_python(monkeypatch: pytest.MonkeyPatch, form: str, name: str):
    """What Python itself makes of the file, by full matches of its patterns."""
    text = exported(form, PLAIN.replace("knee", "'knee.2-x'"))
    found = truth(run(text, monkeypatch)["ACTUATORS"], ("hip", "knee.2-x", "kneeA2-x"))
    assert found == {"stiffness": [40, 25.5, 0], "damping": [3, 1.25, 0], "armature": [0.1, 0.05, 0]}


def test_ros2_control_has_published_parameters_only():
    data = yaml.safe_load(exported("ros2_control", "hip: {kp: 40, kd: 3, ki: 1e-7}\nknee: [1e6, 0]"))
    assert data["controller_manager"]["ros__parameters"]["effort_joint_trajectory_controller"] == {
        "type": "joint_trajectory_controller/JointTrajectoryController"
    }
    parameters = data["effort_joint_trajectory_controller"]["ros__parameters"]
    assert set(parameters) <= PUBLISHED
    assert (parameters["joints"], parameters["command_interfaces"]) == (["hip", "knee"], ["effort"])
    for gains in parameters["gains"].values():
        assert set(gains) <= PUBLISHED_GAINS
        assert all(type(value) is float for value in gains.values())  # ROS refuses an integer for a double
    assert parameters["gains"]["hip"] == {"p": 40.0, "i": 1e-7, "d": 3.0}


def test_ros2_control_stays_as_it_is_but_for_the_gains(folder: Path):
    gains = "hip: {kp: 40, kd: 3, ki: 0.5}\nknee: {kp: 8, kd: 0.25}"
    text = exported("ros2_control", gains, onto=folder / "ros.yaml")
    wanted = ROS2.replace("p: 1, i: 0.0, d: 2.0", "p: 40.0, i: 0.5, d: 3.0").replace("p: 7.0", "p: 8.0\n        d: 0.25")
    assert text.endswith(wanted)
    assert text.removesuffix(wanted).startswith("# gains by gainroom 1.2.3")
    (folder / "ros.yaml").write_text(text, "utf-8")
    assert exported("ros2_control", gains, onto=folder / "ros.yaml") == text


@pytest.mark.parametrize("value", [1.0, 100.0, 1e6, 1e-7, 123456789.123, 2 / 3, 1e12])
def test_numbers_are_floats_for_every_reader(value: float):
    text = number_text(value)
    assert type(yaml.safe_load(text)) is float
    assert float(text) == pytest.approx(value, rel=1e-9)


def answer(**changes: Any) -> dict[str, Any]:
    """What gainroom robot --json has, as far as it counts."""
    margins = {"gain_margin_db": 6.02, "phase_margin_deg": 31.0, "peak_sensitivity": 2.0}
    sets = [
        {"contact": "everywhere", "kp": [40.0, None], "kd": [3.0, None], "ki": None, **margins},
        {"contact": "left", "kp": [50.0, 60.0], "kd": [3.0, 4.0], "ki": None},
    ]
    recommended = [{"space": "task", "names": ["x"], "sets": []}, {"space": "joint", "names": ["hip", "knee"], "sets": sets}]
    actuators = [{"name": name, "motor_inertia": 0.1, "delay_ms": delay} for name, delay in (("hip", 2.0), ("knee", 3.0))]
    said = {"robot": "robot.yaml", "gainroom": "9", "states": [], "unstable_at": None, "sample_rate_hz": 2000.0}
    return said | {"recommended": recommended, "actuators": actuators} | changes


GAINS_RUN_THERE = "gains_run: drive\ndrive_rate_hz: 4000\ndrive_delay_ms: 0.3"


def test_the_header_says_which_delay_the_gains_feel(tmp_path: Path):
    said = f"{GAINS_RUN_THERE}\ngains: {{hip: {{kp: 40, kd: 3}}}}\n"
    (tmp_path / "gains.yaml").write_text(said, "utf-8")
    found = read_gains(tmp_path / "gains.yaml")
    text = export_gains(replace(found, origin=replace(found.origin, delay_ms=5.0)), "mjlab", None, None, "1.2.3", TODAY).text
    assert "#   delay: 0.3 ms in the drive at 4000 Hz; of set-points 5 ms\n" in text


def test_a_robots_answer_is_read(tmp_path: Path):
    path = tmp_path / "answer.json"
    path.write_text(json.dumps(answer()), "utf-8")
    file = read_gains(path)
    assert dict(file.gains) == {"hip": Gain(40, 3, motor_inertia=0.1)}  # nothing can move the knee
    assert dict(read_gains(path, "left").gains) == {"hip": Gain(50, 3, motor_inertia=0.1), "knee": Gain(60, 4, motor_inertia=0.1)}
    text = export_gains(file, "ros2_control", None, None, "1.2.3", TODAY).text
    assert "update_rate: 2000\n" in text
    assert (
        "#   model: robot.yaml\n#   delay: 3 ms; controller at 2000 Hz\n#   margins: gain margin ≥ 6.02 dB, phase margin ≥ 31°, Ms ≤ "
        in text
    )


@pytest.mark.parametrize("met", [True, False, None])
def test_gains_of_continuous_time_that_would_fail_at_a_real_rate_are_not_exported(tmp_path: Path, met: bool | None):
    """As `gainroom robot` shows none of them; the next audit may read them."""
    path = tmp_path / "answer.json"
    path.write_text(json.dumps(answer(at_usual_rate=None if met is None else {"sample_rate_hz": 2000, "requirements_met": met})), "utf-8")
    if met is False:
        with pytest.raises(GainroomError, match=r"at_usual_rate; state control\.sample_rate_hz in the robot's file"):
            read_gains(path, to_use=True)
    assert read_gains(path, to_use=met is not False).gains


def test_gains_that_do_without_the_weight_say_so(tmp_path: Path):
    """Where no gains meet the requirements with it: the file for the controller says what its margins leave out, and where it topples."""
    data, path = answer(), tmp_path / "answer.json"
    found = data["recommended"][1]["sets"][0]
    for without, topples, says in (
        (
            True,
            ["stand/double", "stand/left"],
            "without the robot's weight; with it the robot topples in stand/double and stand/left: a balance",
        ),
        (True, [], "in every state without the robot's weight\n"),
        (False, [], "in every state\n"),
    ):
        found |= {"without_weight": without, "topples": topples}
        path.write_text(json.dumps(data), "utf-8")
        assert says in export_gains(read_gains(path), "yaml", None, None, "1.2.3", TODAY).text


def joint_sets(*kp: list[Any]) -> dict[str, Any]:
    return {"recommended": [{"space": "joint", "names": ["hip"], "sets": [{"contact": "everywhere", "kp": each} for each in kp]}]}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"recommended": None}, "recommended: holds no gains per joint"),
        ({"recommended": [{"space": "task"}]}, "holds no gains per joint, only of tasks"),
        ({"recommended": [{"space": "joint", "names": [1], "sets": []}]}, "names and sets must be lists"),
        (joint_sets(), "no gains were found for 'everywhere'; contact states with gains: none"),
        (joint_sets([1, 2]), "kp must be a list of 1 numbers"),
        (joint_sets([-1]), "'hip'.kp: -1 must be >= 0"),
        (joint_sets([None]), "no joint has gains"),
        ({"actuators": 3}, "actuators: must be a list of sections with a name each"),
        ({"actuators": [{"name": "hip", "delay_ms": "x"}]}, "actuators.'hip'.delay_ms: 'x' is text"),
        ({"sample_rate_hz": [1]}, "sample_rate_hz: [1] is not a number"),
    ],
)
def test_an_answer_that_was_changed_is_refused(tmp_path: Path, changes: dict[str, Any], says: str):
    path = tmp_path / "answer.json"
    path.write_text(json.dumps(answer(**changes)), "utf-8")
    with pytest.raises(GainroomError) as caught:
        read_gains(path)
    assert says in str(caught.value)
    assert str(caught.value).startswith(str(path))


def line(capsys: pytest.CaptureFixture[str], *call: str) -> str:
    assert main(["export", *call]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


@pytest.mark.slow
def test_an_unsafe_audit_is_exported_as_the_gains_to_use(folder: Path, capsys: pytest.CaptureFixture[str]):
    """And those are safe when they are audited again, in place of the model's, which are not."""
    question = ("--delay-ms", "4", "--rate-hz", "1000", "--margin-db", "40", "--delay-margin-ms", "2")
    question += ("--phase-margin-deg", "1", "--peak-sensitivity", "100")
    first = told(capsys, "audit", "robot.xml", "--gains", "gains.yaml", *question)
    assert first["safe"] is False
    Path("answer.json").write_text(json.dumps(first), "utf-8")
    made = told(capsys, "export", "answer.json", "--to", "yaml", "--output", "use.yaml", "--write")
    assert {one["name"]: (one["kp"], one["kd"]) for one in made["joints"]} == {
        one["name"]: (one["kp"], one["kd"]) for one in first["to_use"]["joints"]
    }
    assert "gain margin ≥ 40 dB, phase margin ≥ 1°, Ms ≤ 100, delay margin ≥ 2 ms" in Path("use.yaml").read_text("utf-8")
    assert "with rigid gearboxes of hip" in Path("use.yaml").read_text("utf-8")
    assert told(capsys, "audit", "robot.xml", "--gains", "use.yaml", *question)["requirements_met"] is True
    assert told(capsys, "audit", "robot.xml", "--gains", "answer.json", *question)["requirements_met"] is False  # what was audited, again


@pytest.mark.parametrize("delay", ["2", "12"])
def test_what_an_audit_was_given_of_gearboxes_goes_along(folder: Path, capsys: pytest.CaptureFixture[str], delay: str):
    """Of safe gains and of those to use in place of unsafe ones; a form that has no place for it says so."""
    given = {"stiffness": 900.0, "damping": 0.5}
    plain = "".join(f"{name}: {{kp: {kp}, kd: {kd}, stiffness: 900, damping: 0.5}}\n" for name, kp, kd in (("hip", 40, 3), ("knee", 25, 1)))
    (folder / "springs.yaml").write_text(plain, "utf-8")
    call = ["audit", str(folder / "robot.xml"), "--gains", str(folder / "springs.yaml"), "--delay-ms", delay, "--rate-hz", "1000"]
    call += ["--phase-margin-deg", "1", "--peak-sensitivity", "100", "--json"]  # so that lower gains help at 12 ms
    main(call)
    audit = json.loads(capsys.readouterr().out)
    assert [{key: joint[key] for key in given} for joint in audit["joints"]] == [given, given]
    answer = folder / "answer.json"
    answer.write_text(json.dumps(audit), "utf-8")
    file = read_gains(answer, to_use=True)
    back = yaml.safe_load(export_gains(file, "yaml", None, None, "0", TODAY).text)["gains"]
    assert all(values.items() >= given.items() for values in back.values())
    assert any("stiffness" in note for note in export_gains(file, "arrays", None, None, "0", TODAY).notes)
    again = folder / "again.yaml"
    again.write_text(yaml.safe_dump({"gains": back}), "utf-8")
    main([str(again) if word.endswith("springs.yaml") else word for word in call])
    second = json.loads(capsys.readouterr().out)
    assert second["rigid_gearboxes"] == []
    assert second["requirements_met"]
    if audit["requirements_met"]:
        assert second["gain_limit"] == pytest.approx(audit["gain_limit"], rel=1e-9)


def test_an_audits_answer_is_read(folder: Path, capsys: pytest.CaptureFixture[str]):
    question = ("audit", "robot.xml", "--delay-ms", "2", "--rate-hz", "1000")
    first = told(capsys, *question, "--gains", "gains.yaml")
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    second = told(capsys, "audit", "robot.xml", "--delay-ms", "2", "--gains", "answer.json")  # the rate is the answer's
    assert second["gain_limit"] == first["gain_limit"]
    assert second["joints"] == first["joints"]
    text = export_gains(read_gains(folder / "answer.json"), "arrays", None, None, "1.2.3", TODAY).text
    assert "#   model: robot.xml\n#   delay: 2 ms; controller at 1000 Hz\n#   margins: vibration starts at" in text


def test_nothing_is_written_unasked(folder: Path, capsys: pytest.CaptureFixture[str]):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert main(["export", "gains.yaml", "--to", "mjcf", "--onto", "robot.xml"]) == 0
    shown = capsys.readouterr().out
    assert '-    <position name="a" joint="hip" kp="1"/><motor' in shown
    assert '+    <position name="a" joint="hip" kp="40.0" kv="3.0"/><position name="b" joint="knee"' in shown
    assert "Not written: add --write to write robot.xml" in shown
    today = capsys_version()
    assert main(["export", "gains.yaml", "--to", "mjlab"]) == 0
    days = today, capsys_version()  # midnight may pass meanwhile
    assert capsys.readouterr().out in [exported("mjlab").replace("1.2.3, 2026-01-02", day) for day in days]
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert main(["export", "gains.yaml", "--to", "mjcf", "--onto", "robot.xml", "--write"]) == 0
    assert {path.name for path in folder.iterdir()} == set(before)
    assert (folder / "robot.xml").read_bytes() != before["robot.xml"]


def capsys_version() -> str:
    import gainroom

    return f"{gainroom.__version__}, {datetime.date.today().isoformat()}"


@pytest.mark.parametrize(
    ("call", "says"),
    [
        ("gains.yaml --to urdf", "--to 'urdf': must be one of yaml, ros2_control, mjcf"),
        ("gains.yaml --to mjcf", "--to mjcf: needs --onto FILE, the MJCF"),
        ("gains.yaml --to mjlab --onto robot.xml", "--onto robot.xml: a file of the form mjlab is written as a whole"),
        ("gains.yaml --to mjlab --write", "--write: needs --output FILE"),
        ("gains.yaml --to yaml --output gains.yaml --write", "gains.yaml: the export would overwrite the input"),
        ("gains.yaml --to mjcf --onto ros.yaml", "ros.yaml: line 1, column 2: is no XML"),
        ("gains.yaml --to ros2_control --onto robot.xml", "robot.xml: must be a ros2_control file with p, i and d under joints' names"),
        ("gains.yaml --to ros2_control --onto gains.yaml", "holds no gains of ros2_control to replace"),
        (
            "gains.yaml --to yaml --contact left",
            "gains.yaml: is no answer of gainroom robot --json; --contact chooses among the sets of one",
        ),
        ("nothing.yaml --to yaml", "nothing.yaml: no such file"),
        ("gains.yaml --to yaml --output no/such/out.yaml --write", "cannot be written: there is no directory"),
    ],
)
def test_bad_calls(folder: Path, capsys: pytest.CaptureFixture[str], call: str, says: str):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert main(["export", *call.split()]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("form", "text", "says"),
    [
        ("mjlab", "hip: {kp: 1, ki: 2}", "holds no integral gain, which hip have; yaml, ros2_control, c, markdown do"),
        ("yaml", '".*": [1, 1]', "names its joints by patterns, or not at all: give --model"),
        ("mjcf", "elbow: [1, 1]", "gains.'elbow' matches no joint"),
    ],
)
def test_what_a_form_cannot_hold(folder: Path, form: str, text: str, says: str):
    with pytest.raises(GainroomError) as caught:
        exported(form, text, onto=onto(folder, form))
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("actuators", "says"),
    [
        ('<position joint="hip"/><position joint="hip"/>', "joint 'hip' has several actuators (position, position)"),
        ('<damper joint="hip" kv="1" ctrlrange="0 1"/>', "<damper> takes no kp and kd; make it a <position>"),
    ],
)
def test_actuators_that_cannot_take_gains(folder: Path, actuators: str, says: str):
    (folder / "robot.xml").write_text(MODEL.replace("ACTUATORS", actuators), "utf-8")
    with pytest.raises(GainroomError) as caught:
        exported("mjcf", onto=folder / "robot.xml")
    assert says in str(caught.value)


def test_a_keyframe_counts_actuators(folder: Path):
    text = MODEL.replace("ACTUATORS", '<position joint="hip"/>').replace(
        "</mujoco>", '<keyframe><key name="home" ctrl="0"/></keyframe></mujoco>'
    )
    (folder / "robot.xml").write_text(text, "utf-8")
    with pytest.raises(GainroomError, match="joints without an actuator: knee; add them, or leave ctrl out of the keyframe 'home'"):
        exported("mjcf", onto=folder / "robot.xml")
    assert 'ctrl="0"' in exported("mjcf", "hip: [3, 1]", onto=folder / "robot.xml")


def test_actuators_of_an_included_file(folder: Path):
    (folder / "act.xml").write_text('<mujocoinclude><actuator><position joint="hip"/></actuator></mujocoinclude>', "utf-8")
    (folder / "robot.xml").write_text(MODEL.replace("<actuator>\n    ACTUATORS\n  </actuator>", '<include file="act.xml"/>'), "utf-8")
    with pytest.raises(GainroomError, match="some of its actuators stand in an included file"):
        exported("mjcf", onto=folder / "robot.xml")


def test_patterns_are_resolved_by_a_model(folder: Path):
    assert parse_gains(exported("arrays", '".*": [4, 1]', model=folder / "robot.xml"), "f").own_names == ("hip", "knee")
