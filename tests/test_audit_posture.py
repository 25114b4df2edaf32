"""`gainroom audit --posture`: the limits are those of the posture that is asked for, and every answer says which it was."""

import json
import re
from html import unescape
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pytest import approx

import gainroom as gr
from gainroom.cli import main
from gainroom.files.audit_options import AuditOptions, audited as audited_robot
from gainroom.files.audited_robot import audited_robot_text
from gainroom.report.audit_text import audit_warnings
from gainroom.studies.audit import Audit, audit
from refusals import assert_refused

INERTIAL = '<inertial pos="{0} 0 {1}" mass="{2}" diaginertia="{3} {3} {3}"/>'
LEG = f"""<mujoco><compiler angle="radian"/><default><joint axis="0 1 0" armature="0.1"/></default><worldbody>
  <body pos="0 0 1"><joint name="hip" range="-1 1" damping="0.4"/>{INERTIAL.format(0, -0.2, 2, 0.03)}
  <body pos="0 0 -.4"><joint name="knee" range="0 2"/>{INERTIAL.format(0, -0.2, 1, 0.02)}
  <body pos="0 0 -.4"><joint name="ankle"/>{INERTIAL.format(0.3, 0, 1.5, 0.02)}</body></body></body></worldbody>
  <actuator><position joint="hip" kp="300" kv="10"/><position joint="knee" kp="200" kv="10"/></actuator>
  <keyframe><key name="home" qpos="-0.4 0.8 1.4" ctrl="-0.4 0.8"/><key name="folded" qpos="0 2.5 0"/></keyframe></mujoco>"""


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    path = tmp_path / "leg.xml"
    path.write_text(LEG, "utf-8")
    return path


def audited(leg: Path, *posture: str) -> Audit:
    return audit(audited_robot(str(leg), None, AuditOptions(delay_ms=2.0, rate_hz=1000.0, posture=posture)).system)


def limit_by_mujoco(leg: Path, angles: tuple[float, float, float]) -> float:
    """From MuJoCo's mass matrix of hip and knee, the ankle held where it is."""
    model = mujoco.MjModel.from_xml_path(str(leg))
    data = mujoco.MjData(model)
    data.qpos[:] = angles
    mujoco.mj_forward(model, data)
    mass = np.zeros((3, 3))
    for row, direction in zip(mass, np.eye(3), strict=True):
        mujoco.mj_mulM(model, data, row, direction)
    links = (mass - 0.1 * np.eye(3))[:2, :2]
    plant = gr.Plant(np.linalg.inv(links), motor_inertia=0.1)
    loop = gr.build_loop(plant, gr.Drive(delay=2e-3), gr.PD(np.array([300.0, 200.0]), 10.0), sample_time=1e-3)
    return gr.gain_limit(loop).gain


@pytest.mark.parametrize(
    ("posture", "angles"),
    [
        ((), (0.0, 0.0, 0.0)),
        (("home",), (-0.4, 0.8, 1.4)),  # the ankle has no gains: it is held at the keyframe's angle
        (("home", "knee=1.2"), (-0.4, 1.2, 1.4)),  # the later wins
        (("knee=1.2", "home"), (-0.4, 0.8, 1.4)),
        ((".*e=0.3", "ankle=-0.2"), (0.0, 0.3, -0.2)),
    ],
)
def test_limits_are_those_of_the_posture(leg: Path, posture: tuple[str, ...], angles: tuple[float, float, float]):
    result = audited(leg, *posture)
    assert result.angles == approx(dict(zip(("hip", "knee", "ankle"), angles, strict=True)), abs=1e-15)
    # Two programs' mass matrices agree to 1e-12; limits are found to better than 1e-8.
    assert result.tightest.limit.gain == approx(limit_by_mujoco(leg, angles), rel=1e-8)


def test_postures_matter_and_are_told(leg: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    page = tmp_path / "audit.html"
    call = ["audit", str(leg), "--delay-ms", "2", "--rate-hz", "1000", "--posture", "home", "--report", str(page)]
    told = []
    for options in (["--json"], []):
        assert main([*call, *options]) == 1
        told.append(" ".join(capsys.readouterr().out.split()))
    facts = json.loads(told[0])
    assert facts["posture"] == {"hip": -0.4, "knee": 0.8, "ankle": 1.4}
    assert facts["gain_limit"] != approx(audited(leg).tightest.limit.gain, rel=1e-2)
    assert "Posture: home" in told[1]
    text = " ".join(re.sub(r"<[^>]*>", " ", unescape(page.read_text("utf-8"))).split())
    assert "Linear about posture home" in text
    assert "hip −0.4, knee 0.8" in text
    assert "--posture home" in text  # the command that makes the page again


def test_beyond_limits_is_a_warning(leg: Path):
    assert not [text for text in audit_warnings(audited(leg, "home")) if "limits" in text]
    (found,) = [text for text in audit_warnings(audited(leg, "folded")) if "limits" in text]
    assert (
        found == "posture 'folded': joint 'knee' at 2.5 is outside its limits 0 to 2 rad; move it inside with --posture, or check the model"
    )


def test_damping_of_the_model_is_said_to_be_left_out(leg: Path):
    (found,) = [text for text in audit_warnings(audited(leg)) if "damping" in text]
    assert "hip 0.4" in found
    assert "not counted" in found
    assert any("armature" in text and "hip 0.1" in text for text in audited(leg).system.assumptions)


@pytest.mark.parametrize(
    ("posture", "words"),
    [
        ("hom", ["--posture 'hom'", "JOINT=ANGLE", "did you mean 'home'?", "keyframes: home, folded"]),
        ("kne=1", ["--posture 'kne=1': 'kne' matches no joint", "did you mean 'knee'?"]),
        ("knee=60deg", ["--posture 'knee=60deg': '60deg' must be a number in rad"]),
        ("knee=nan", ["nan is not a number"]),
        ("knee=1e6", ["must be <= 10000"]),
    ],
)
def test_bad_postures(leg: Path, posture: str, words: list[str]):
    assert_refused(lambda: audited(leg, posture), words)


FLOATING = """<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint/><geom size="0.2" mass="9"/>
<body name="arm"><joint name="elbow" axis="0 1 0"/><geom size="0.1" pos="0 0 0.3" mass="1"/></body></body></worldbody>
<actuator><position joint="elbow" kp="100" kv="5"/></actuator></mujoco>"""


@pytest.mark.parametrize(("base", "told"), [(None, "floating"), ("floating", "floating"), ("fixed", "fixed")])
def test_a_base_that_was_said_is_not_assumed(tmp_path: Path, capsys: pytest.CaptureFixture[str], base: str | None, told: str):
    model = tmp_path / "robot.xml"
    model.write_text(FLOATING, "utf-8")
    call = ["audit", str(model), "--delay-ms", "2", "--motor-inertia", "0.1", *([] if base is None else ["--base", base])]
    main([*call, "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert facts["base"] == told
    assert not any("base" in text for text in facts["assumptions"])
    assert [text for text in facts["warnings"] if "base" in text] == (
        ["base: fixed holds the free joint of 'trunk', as if bolted down"] if told == "fixed" else []
    )
    main(call)
    assert f"Posture: zero; {told} base" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("posture", "name"), [((), "zero"), (("home",), "home"), (("home", "knee=1.2"), "given"), ((".*e=0.3", "ankle=-0.2"), "given")]
)
def test_a_posture_has_a_short_name(leg: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], posture: tuple[str, ...], name: str):
    """Patterns are no name: they would stand in every sentence and table, and as a key in the file to go on from."""
    written = tmp_path / "robot.yaml"
    typed = [f"--posture={text}" for text in posture]
    main(["audit", str(leg), "--delay-ms", "2", "--rate-hz", "1000", *typed, "--write-robot", str(written)])
    assert f"Posture: {name};" in capsys.readouterr().out
    assert gr.load_robot(written).system.source.states == ((name, "free"),)


def test_written_numbers_have_the_digits_that_are_meant(leg: Path):
    """A stiffness J Ω² comes with round-off, which nobody would type."""
    found = audited_robot(str(leg), None, AuditOptions(delay_ms=2.0, rate_hz=1000.0))
    values = {"hip": {"stiffness": 43740.000000000015, "damping": 1 / 3}, "knee": {"stiffness": 0.1 + 0.2, "damping": 5.0}}
    given = found.sections["joints"]
    joints = given | {name: {**given.get(name, {}), **own} for name, own in values.items()}
    text = audited_robot_text(
        {**found.sections, "joints": joints}, str(leg), gr.Requirements(gain_margin=10**0.3), ["heading"], leg.parent / "robot.yaml"
    )
    for pair in ("stiffness: 43740.0", "damping: 0.3333333333333333", "stiffness: 0.3", "damping: 5.0", "gain_margin_db: 6.0"):
        assert re.search(rf"{re.escape(pair)}[,}}]", text), text


def test_a_urdf_has_no_keyframes(tmp_path: Path):
    gains = tmp_path / "gains.yaml"

    def make() -> object:
        return audited_robot("gainroom:biped.urdf", gains, AuditOptions(delay_ms=2.0, posture=("home",))).system

    gains.write_text('".*": {kp: 1, kd: 1}', "utf-8")
    assert_refused(make, ["--posture 'home'", "keyframes: none"])
