"""gainroom audit --simulator mujoco: verdicts beside those of MuJoCo stepped, what is assumed, what is refused."""

import html
import json
import re
import sys
from pathlib import Path

import pytest
from pytest import approx

from gainroom.cli import main
from gainroom.robot.formats.model_files import load_model, stepping
from gainroom.robot.formats.model_format import Stepping
from simulator_witness import Witness

LEG = """<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody><body name="trunk" pos="0 0 .75"><freejoint/>
  <geom type="box" size=".12 .1 .1" mass="8"/><body euler="0 25 0"><joint name="hip" axis="0 1 0" armature=".03"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="2"/><body pos="0 0 -.4" euler="0 -50 0">
  <joint name="knee" axis="0 1 0" armature=".03" damping=".1"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1"/>
  <body name="foot" pos="0 0 -.4" euler="0 25 0"><joint name="ankle" axis="0 1 0" armature=".002"/>
  <geom type="box" size=".1 .05 .02" mass=".4"/></body></body></body></body></worldbody><actuator>
  <position joint="hip" kp="200" kv="6"/><position joint="knee" kp="200" kv="6"/><position joint="ankle" kp="60" kv="2"/></actuator>
</mujoco>"""
GAINS = {"hip": (200.0, 6.0), "knee": (200.0, 6.0), "ankle": (60.0, 2.0)}


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    path = tmp_path / "leg.xml"
    path.write_text(LEG, "utf-8")
    return path


def told(capsys: pytest.CaptureFixture[str], model: Path | str, *options: str) -> tuple[int, dict]:
    status = main(["audit", str(model), "--simulator", "mujoco", "--json", *options])
    return status, json.loads(capsys.readouterr().out)


def witness(timestep: float, pd: str, decimation: int = 1) -> Witness:
    """The file as it is, in flight, where its limits are least."""
    return Witness(LEG, GAINS, timestep, "implicitfast", pd, decimation)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay", "pd", "timestep", "decimation", "held_by"),
    [
        ("2", "explicit", 0.002, 1, "both"),
        ("8", "implicit", 0.005, 1, "simulator"),
        ("2", "explicit", 0.002, 2, "robot"),
        ("8", "explicit", 0.005, 1, "neither"),
    ],
)
def test_who_holds_the_gains(
    leg: Path, capsys: pytest.CaptureFixture[str], delay: str, pd: str, timestep: float, decimation: int, held_by: str
):
    options = ["--delay-ms", delay, "--pd", pd, "--timestep", str(timestep), *(["--decimation", "2"] if decimation == 2 else [])]
    status, answer = told(capsys, leg, *options, "--contact", "foot")
    found = answer["simulator"]
    mujoco = witness(timestep, pd, decimation)
    assert found["stable"] == (not mujoco.grows(1.0)) == (held_by in ("both", "simulator"))
    assert answer["stable"] == (held_by in ("both", "robot"))
    assert found["held_by"] == held_by
    assert status == (0 if answer["safe"] and found["stable"] else 1)
    if found["gain_limit"] is not None:
        assert not mujoco.grows(found["gain_limit"] * 0.99)
        assert mujoco.grows(found["gain_limit"] * 1.01)
    limits = [value if value is not None else float("inf") for value in (found["gain_limit"], answer["gain_limit"])]
    ends = [value if value is not None else float("inf") for value in (found["one_sided"]["from"], found["one_sided"]["to"])]
    assert ends == approx([min(limits), max(limits)])
    assert found["one_sided"]["held_by"] == ("simulator" if limits[0] > limits[1] else "robot")
    assert (found["largest_timestep_s"] is None) == found["stable"]
    if not found["stable"]:
        assert not witness(0.99 * found["largest_timestep_s"], pd, decimation).grows(1.0)
        assert witness(1.01 * found["largest_timestep_s"], pd, decimation).grows(1.0)


@pytest.mark.slow
def test_joints_that_only_one_of_the_two_holds(leg: Path, capsys: pytest.CaptureFixture[str]):
    """By themselves, as the witness has it with one actuator alone; the robot's are the audit's own."""
    options = ("--pd", "explicit", "--timestep", "0.002", "--decimation", "2")
    _, answer = told(capsys, leg, "--delay-ms", "2", *options)
    for joint, robot in zip(answer["simulator"]["joints"], answer["joints"], strict=True):
        alone = Witness(LEG, {joint["name"]: GAINS[joint["name"]]}, 0.002, "implicitfast", "explicit", 2)
        assert joint["stable"] == (not alone.grows(1.0))
        held = {(True, True): "both", (True, False): "simulator", (False, True): "robot", (False, False): "neither"}
        assert joint["held_by"] == held[joint["stable"], robot["gain_limit"] > 1]
    assert [joint["held_by"] for joint in answer["simulator"]["joints"]] == ["both", "both", "robot"]
    assert "only the robot holds the gains of ankle" in answer["simulator"]["sentence"]


@pytest.mark.slow
def test_what_the_file_says_counts_and_what_is_typed_wins(leg: Path, capsys: pytest.CaptureFixture[str]):
    _, answer = told(capsys, leg, "--delay-ms", "2")
    found = answer["simulator"]
    assert (found["timestep_s"], found["integrator"], found["pd"], found["armature"]) == (0.005, "implicitfast", "implicit", "file")
    assert found["gain_limit"] is None
    assert any("as in the file: or give --pd" in text for text in found["assumptions"])
    assert any("own damping" in text and "beside kd" in text for text in found["assumptions"])
    _, answer = told(capsys, leg, "--delay-ms", "2", "--integrator", "Euler", "--timestep", "0.001")
    assert (answer["simulator"]["integrator"], answer["simulator"]["timestep_s"]) == ("Euler", 0.001)
    assert answer["simulator"]["gain_limit"] is not None  # Euler takes an actuator's kv explicitly


@pytest.mark.slow
def test_gains_of_a_file_are_a_programs(leg: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    gains = tmp_path / "gains.yaml"
    gains.write_text('".*": {kp: 50, kd: 2, ki: 1, motor_inertia: 0.2}', "utf-8")
    call = ("--delay-ms", "2", "--gains", str(gains))
    _, first = told(capsys, leg, *call)
    assert first["simulator"]["pd"] == "explicit"
    texts = " ".join(first["simulator"]["assumptions"])
    for words in ("or give --pd", "or give --decimation", "give --armature motor", "ki is left out"):
        assert words in texts
    _, motors = told(capsys, leg, *call, "--armature", "motor")
    assert motors["simulator"]["gain_limit"] > 2 * first["simulator"]["gain_limit"]
    assert "armature" not in " ".join(motors["simulator"]["assumptions"])


@pytest.mark.slow
def test_damping_that_is_the_controllers_acts_once(leg: Path, capsys: pytest.CaptureFixture[str]):
    """As the file has it, <position kp> and joint damping, both times the factor: the witness changes both."""
    text = re.sub(r' kv="\d+"| damping="[^"]*"', "", LEG).replace('integrator="implicitfast"', 'integrator="Euler"')
    leg.write_text(text.replace("<worldbody>", '<default><joint damping="0.05"/></default><worldbody>', 1), "utf-8")
    _, answer = told(capsys, leg, "--delay-ms", "0.5", "--joint-damping", "controller")
    found = answer["simulator"]
    assert [joint["kd"] for joint in answer["joints"]] == [0.05] * 3
    assert any("a part of kd" in line for line in found["assumptions"])
    mujoco = Witness(text, {joint: (kp, 0.05) for joint, (kp, _) in GAINS.items()}, 0.005, "Euler", "joint-damping")
    assert not mujoco.grows(found["gain_limit"] * 0.99)
    assert mujoco.grows(found["gain_limit"] * 1.01)
    _, beside = told(capsys, leg, "--delay-ms", "0.5", "--joint-damping", "friction")
    assert beside["simulator"]["gain_limit"] != approx(found["gain_limit"], rel=0.01)


@pytest.mark.slow
def test_a_urdf_names_no_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    gains = tmp_path / "gains.yaml"
    gains.write_text('".*": {kp: 2000, kd: 100, motor_inertia: 1}', "utf-8")
    _, answer = told(capsys, "gainroom:biped.urdf", "--delay-ms", "2", "--gains", str(gains), "--contact", "left_sole")
    found = answer["simulator"]
    assert (found["timestep_s"], found["integrator"], found["armature"]) == (0.002, "Euler", "motor")
    assert any("no timestep and no integrator" in text for text in found["assumptions"])
    assert any("held, as softly as MuJoCo's contacts" in text for text in found["assumptions"])


@pytest.mark.slow
def test_without_the_option_nothing_is_said(leg: Path, capsys: pytest.CaptureFixture[str]):
    main(["audit", str(leg), "--delay-ms", "2", "--json"])
    assert json.loads(capsys.readouterr().out)["simulator"] is None
    main(["audit", str(leg), "--delay-ms", "2"])
    assert "MuJoCo" not in capsys.readouterr().out


@pytest.mark.slow
def test_terminal_and_page_say_what_json_says(leg: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    page = tmp_path / "audit.html"
    options = ["--delay-ms", "2", "--pd", "explicit", "--decimation", "3", "--report", str(page)]
    _, answer = told(capsys, leg, *options)
    main(["audit", str(leg), "--simulator", "mujoco", *options])
    shown = " ".join(capsys.readouterr().out.split())
    text = " ".join(html.unescape(re.sub(r"<[^>]*>", " ", page.read_text("utf-8"))).split())
    for place in (shown, text):
        assert answer["simulator"]["sentence"] in place
    assert "--simulator mujoco --pd explicit --decimation 3" in text  # the command that makes the page again


@pytest.mark.slow
def test_a_page_of_gains_that_only_the_robot_holds_is_not_good(leg: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Gearboxes are given, so that the robot's verdict has no condition; MuJoCo takes its own actuators implicitly, a program's not."""
    page = tmp_path / "audit.html"
    options = ["--delay-ms", "0.1", "--rate-hz", "10000", "--stiffness", "50000", "--damping", "20", "--report", str(page)]
    for kind, holds in (("implicit", True), ("explicit", False)):
        _, answer = told(capsys, leg, *options, "--pd", kind)
        assert answer["requirements_met"]
        assert answer["simulator"]["stable"] == holds
        own = page.read_text("utf-8")
        assert f'<body class="{"good" if holds else "bad"}">' in own
        assert ("On the robot: Safe" in own) == (not holds)
        assert ("unstable in the simulator" in own.partition("Do this")[0]) == (not holds)


def test_stepping_of_a_file(tmp_path: Path):
    inner, outer = tmp_path / "options.xml", tmp_path / "scene.xml"
    inner.write_text('<mujocoinclude><option timestep="0.004"><flag eulerdamp="disable"/></option></mujocoinclude>', "utf-8")
    outer.write_text(LEG.replace('<option timestep="0.005" integrator="implicitfast"/>', '<include file="options.xml"/>'), "utf-8")
    found = stepping(outer)
    assert (found.timestep, found.integrator, found.unnamed, found.armature) == (0.004, "Euler", ("integrator",), True)
    assert found.disabled == 1 << 15  # mjDSBL_EULERDAMP
    assert stepping(Path(load_model("gainroom:biped.urdf").source)) == Stepping()


def test_damping_of_actuators_is_the_joints_too(leg: Path):
    """Since MuJoCo 3.5 an actuator may have damping before its gear; in MuJoCo's own force it counts by gear²."""
    leg.write_text(LEG.replace('<position joint="knee"', '<position joint="knee" damping="0.7" gear="2"'), "utf-8")
    mujoco = pytest.importorskip("mujoco")
    if not hasattr(mujoco.MjModel, "actuator_damping"):
        pytest.skip("not in this MuJoCo")
    model = mujoco.MjModel.from_xml_path(str(leg))
    data = mujoco.MjData(model)
    data.joint("knee").qvel = 1.0
    mujoco.mj_forward(model, data)
    body = load_model(leg)
    knee = body.nv - body.size + body.joint_names.index("knee")
    assert body.model.damping[knee] == approx(-data.joint("knee").qfrc_passive[0], rel=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--simulator", "isaac"], "--simulator 'isaac': must be mujoco"),
        (["--timestep", "0.002"], "--timestep: goes with --simulator mujoco"),
        (["--armature", "motor"], "--armature: goes with --simulator mujoco"),
        (["--simulator", "mujoco", "--timestep", "2"], "--timestep: 2.0 must be <= 0.1 s"),
        (["--simulator", "mujoco", "--timestep", "0"], "--timestep: 0.0 must be > 0 s"),
        (["--simulator", "mujoco", "--timestep", "nan"], "--timestep: nan is not a number"),
        (["--simulator", "mujoco", "--timestep", "2ms"], "'2ms' must be a number in seconds"),
        (["--simulator", "mujoco", "--integrator", "rk4"], "--integrator 'rk4': must be Euler, RK4, implicit, implicitfast or discrete"),
        (["--simulator", "mujoco", "--pd", "impl"], "--pd 'impl': must be explicit, implicit or joint-damping"),
        (["--simulator", "mujoco", "--armature", "x"], "--armature 'x': must be file or motor"),
        (["--simulator", "mujoco", "--pd", "explicit", "--decimation", "0"], "--decimation 0: must be 1 to 100 steps"),
        (["--simulator", "mujoco", "--decimation", "4"], "--decimation 4: goes with --pd explicit"),
    ],
)
def test_what_is_refused(leg: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str):
    assert main(["audit", str(leg), "--delay-ms", "2", *options]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("option", ['timestep="0.5"', 'timestep="-1"', 'integrator="Eule"'])
def test_a_files_absurd_options(leg: Path, capsys: pytest.CaptureFixture[str], option: str):
    leg.write_text(LEG.replace('timestep="0.005" integrator="implicitfast"', option), "utf-8")
    assert main(["audit", str(leg), "--delay-ms", "2", "--simulator", "mujoco"]) == 2
    err = capsys.readouterr().err
    assert str(leg) in err
    assert err.count("\n") == 1


def test_without_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    gains = tmp_path / "gains.yaml"
    gains.write_text('".*": {kp: 2000, kd: 100, motor_inertia: 1}', "utf-8")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["audit", "gainroom:biped.urdf", "--delay-ms", "2", "--gains", str(gains), "--simulator", "mujoco"]) == 2
    err = capsys.readouterr().err
    assert "need MuJoCo: pip install 'gainroom[robot]'" in err
    assert err.count("\n") == 1
