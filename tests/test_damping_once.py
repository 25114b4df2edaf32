"""The joints' own damping of a model is counted once on every way that gains go: in kd, or in the friction of the links."""

import datetime
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.files.gain_export import FORMS, export_gains
from gainroom.files.gain_files import read_gains
from test_gains_go_along import LEG, audited, exported, told, with_leg

GAINS = "hip: {kp: 120, kd: 7.1, motor_inertia: 0.2}\nknee: {kp: 60, kd: 2.3}\n"
UNSAFE = "hip: {kp: 4000, kd: 40, motor_inertia: 0.2}\nknee: {kp: 900, kd: 9}\n"
RATE = ("--rate-hz", "400")
TODAY = datetime.date(2026, 1, 2)
ACTUATORS = {
    "none": "",
    "servos": '<position joint="hip" kp="1" gear="3"/><motor joint="knee"/>',
    "dampers of their own": '<position joint="hip" kp="1" gear="3" damping="0.7"/><motor joint="knee" damping="0.2"/>',
    "a servo and a damper": '<position joint="knee" kp="1"/><velocity joint="knee" kv="1"/>',
}
WHERE = {
    "on the joint": LEG,
    "by default": LEG.replace("<mujoco>", '<mujoco><default><joint damping="0.5"/></default>').replace(
        ' damping="0.5"/>\n      <inertial pos="0 0 -0.2"', '/>\n      <inertial pos="0 0 -0.2"'
    ),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return with_leg(tmp_path, GAINS, monkeypatch)


def resistance(text: str) -> dict[str, float]:
    """By MuJoCo's own forces: what opposes each joint's speed, by how much per rad/s, with everything that is in the file."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(text)
    found = {}
    for k in range(model.njnt):
        data = mujoco.MjData(model)
        data.qvel[k] = 1e-3
        mujoco.mj_forward(model, data)
        found[model.joint(k).name] = -float(data.qfrc_passive[k] + data.qfrc_actuator[k]) / 1e-3
    return found


@pytest.mark.slow
@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("actuators", ACTUATORS)
@pytest.mark.parametrize("what", ["controller", "friction"])
def test_an_exported_mjcf_damps_as_the_audited_robot(
    folder: Path, capsys: pytest.CaptureFixture[str], what: str, actuators: str, where: str
):
    """What MuJoCo opposes to a speed is the kd that was typed and the damping that the model had, each once."""
    text = WHERE[where].replace("</mujoco>", f"<actuator>{ACTUATORS[actuators]}</actuator></mujoco>")
    (folder / "leg.xml").write_text(text, "utf-8")
    before = {"hip": 0.0 if where == "on the joint" else 0.5, "knee": 0.5}
    own = {"hip": before["hip"] + 9 * 0.7, "knee": 0.7} if actuators.startswith("dampers") else before  # before the gear, so gear²
    first = audited(capsys, "gains.yaml", *RATE, "--joint-damping", what)
    target, said = exported(capsys, folder, first, "mjcf")
    wanted = {"hip": 7.1 + own["hip"], "knee": 2.3 + own["knee"]}
    assert resistance((folder / target).read_text("utf-8")) == pytest.approx(wanted, rel=1e-9)  # round-off of a difference of 1e-3
    second = told(capsys, "audit", target, "--delay-ms", "3", *said["audit_with"])
    assert second["gain_limit"] == pytest.approx(first["gain_limit"], rel=1e-12)  # kd / gear² · gear²
    assert second["safe"] == first["safe"]


@pytest.mark.slow
@pytest.mark.parametrize("again", [(), ("controller",), ("friction",)])
@pytest.mark.parametrize("what", ["controller", "friction"])
@pytest.mark.parametrize("form", ["answer", *FORMS])
def test_what_was_counted_counts_once_or_contradicts(
    folder: Path, capsys: pytest.CaptureFixture[str], form: str, what: str, again: tuple[str, ...]
):
    """Saying the same again changes nothing; saying the other is an error that names the option and the file."""
    first = audited(capsys, "gains.yaml", *RATE, "--joint-damping", what)
    flags: list[str] = []
    if form == "answer":
        (folder / "answer.json").write_text(json.dumps(first), "utf-8")
        model = ["leg.xml", "--gains", "answer.json"]
    else:
        target, said = exported(capsys, folder, first, form)
        flags = said["audit_with"]
        model = [target] if form == "mjcf" else ["leg.xml", "--gains", target]
    if form not in ("answer", "yaml") and again:
        return  # the file holds no such word: its note says which flag it takes
    call = ["audit", *model, "--delay-ms", "3", *flags, *(("--joint-damping", *again) if again else ())]
    if again and again != (what,):
        assert main(call) == 2
        said = capsys.readouterr().err
        assert f"--joint-damping {again[0]}: the gains of {model[-1]} hold it as {what} already" in said
        return
    second = told(capsys, *call)
    assert second["gain_limit"] == pytest.approx(first["gain_limit"], rel=1e-12)
    assert second["safe"] == first["safe"]
    if form in ("answer", "yaml"):
        assert (second["gain_limit"], second["joints"], second["joint_damping"]) == (first["gain_limit"], first["joints"], what)


@pytest.mark.parametrize("what", [None, "controller", "friction"])
def test_the_file_that_an_audit_prints_goes_with_the_same_call(folder: Path, capsys: pytest.CaptureFixture[str], what: str | None):
    """Pasted back, with the options that were typed: the margins that the advice was given with."""
    (folder / "gains.yaml").write_text(UNSAFE, "utf-8")
    bounds = ("--phase-margin-deg", "1", "--peak-sensitivity", "100")  # the gain margin decides, which a factor on the gains mends
    call = ["audit", "leg.xml", "--delay-ms", "3", *RATE, *bounds, *(() if what is None else ("--joint-damping", what))]
    first = told(capsys, *call, "--gains", "gains.yaml")
    assert not first["requirements_met"]
    assert main([*call, "--gains", "gains.yaml", "--verbose"]) == 1
    lines = [line[2:] for line in capsys.readouterr().out.splitlines()]
    start = next(k for k, line in enumerate(lines) if line.startswith(("joint_damping:", "gains:", "hip:")))
    stop = next(k for k in range(start, len(lines)) if not lines[k].startswith(("joint_damping:", "gains:", "  ", "hip:", "knee:")))
    (folder / "use.yaml").write_text("\n".join(lines[start:stop]), "utf-8")
    assert ("joint_damping: " in lines[start]) is (what is not None)
    second = told(capsys, *call, "--gains", "use.yaml")
    assert second["requirements_met"]
    kd = {joint["name"]: joint["kd"] for joint in second["joints"]}
    assert kd == {joint["name"]: joint["kd"] for joint in first["to_use"]["joints"]}
    assert not any("--joint-damping" in one for one in second["warnings"]) or what is None


@pytest.mark.parametrize(
    ("gains", "what", "says"),
    [
        ("knee: {kp: 60, kd: 2.3, link_viscous: 0.5}", "controller", "has the joints' own damping of knee as link_viscous already"),
        ("knee: {kp: 60, kd: 2.3, link_viscous: 0.4}", "friction", "has another link_viscous of knee 0.4, not 0.5"),
        ("joint_damping: motor\ngains: {knee: [60, 2.3]}", None, "joint_damping: 'motor'"),
    ],
)
def test_contradictions_are_errors(folder: Path, capsys: pytest.CaptureFixture[str], gains: str, what: str | None, says: str):
    (folder / "gains.yaml").write_text(gains, "utf-8")
    option = () if what is None else ("--joint-damping", what)
    assert main(["audit", "leg.xml", "--delay-ms", "3", "--gains", "gains.yaml", *option]) == 2
    assert says in capsys.readouterr().err


def test_friction_that_somebody_measured_stands_beside_the_controllers(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "gains.yaml").write_text("hip: [120, 7.1]\nknee: {kp: 60, kd: 2.3, link_viscous: 0.1}\n", "utf-8")
    found = {joint["name"]: joint for joint in audited(capsys, "gains.yaml", *RATE, "--joint-damping", "controller")["joints"]}
    assert (found["knee"]["kd"], found["knee"]["link_viscous"]) == (pytest.approx(2.8, rel=1e-15), 0.1)


def test_kd_that_robot_recommends_is_the_whole(folder: Path, capsys: pytest.CaptureFixture[str]):
    audited(capsys, "gains.yaml", *RATE, "--joint-damping", "controller", "--write-robot", "robot.yaml")
    found: dict[str, Any] = told(capsys, "robot", "robot.yaml")
    (folder / "robot.json").write_text(json.dumps(found), "utf-8")
    recommended = dict(zip(found["recommended"][0]["names"], found["recommended"][0]["sets"][0]["kd"], strict=True))
    for option in ((), ("--joint-damping", "controller")):
        judged = told(capsys, "audit", "leg.xml", "--delay-ms", "3", "--gains", "robot.json", *option)
        assert {joint["name"]: joint["kd"] for joint in judged["joints"]} == recommended


def test_damping_in_kd_counts_once_in_the_simulator(folder: Path, capsys: pytest.CaptureFixture[str]):
    """Of gains whose file says so, as of the option that does."""
    simulator = ("--simulator", "mujoco", "--timestep", "0.002", "--integrator", "Euler", "--pd", "explicit", "--decimation", "1")
    simulator = (*simulator, "--armature", "file")
    first = audited(capsys, "gains.yaml", *RATE, "--joint-damping", "controller", *simulator)
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    second = audited(capsys, "answer.json", *simulator)
    assert second["simulator"] == first["simulator"]
    assert np.isfinite(first["simulator"]["gain_limit"])


def test_what_stays_in_an_included_file_is_named(folder: Path):
    body = LEG[LEG.index("    <body") : LEG.index("  </worldbody>")]
    (folder / "body.xml").write_text(f"<mujoco>{body}</mujoco>", "utf-8")
    servos = '<actuator><position joint="hip" kp="1"/><position joint="knee" kp="1"/></actuator>'
    (folder / "leg.xml").write_text(f'<mujoco><worldbody><include file="body.xml"/></worldbody>{servos}</mujoco>', "utf-8")
    (folder / "gains.yaml").write_text(f"joint_damping: controller\ngains:\n  {GAINS.replace(chr(10), chr(10) + '  ')}", "utf-8")
    made = export_gains(read_gains(folder / "gains.yaml"), "mjcf", folder / "leg.xml", None, "1", TODAY)
    assert any("included file for knee: set it to 0 there" in note for note in made.notes)
