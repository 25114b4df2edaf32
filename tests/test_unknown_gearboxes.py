"""Gearboxes of which nobody says how stiff they are: what is said of them never ends the audit, claims no more than was checked, and is
not asked where somebody has said that they are rigid."""

import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

import gainroom as gr
from gainroom.cli import main
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.report.audit_text import audit_sentence
from gainroom.report.words import SOFTER
from gainroom.studies import audit as study

STEP = 2e-3
CALL = ("--delay-ms", "2", "--rate-hz", "500")
BOTH_MARGINS = gr.Requirements(gain_margin=10 ** (6 / 20), delay_margin=1e-3)
"""Of these arms, which are hardly damped: no phase margin is 12°."""
ASKED = ("--delay-margin-ms", "1", "--phase-margin-deg", "1", "--peak-sensitivity", "100")
"""Likewise of the command."""


def straight_arm(rotors: tuple[float, ...], last: str = "1e-3 1e-3 3e-4") -> str:
    """Joints that bend and twist in turn, all on one line: a twisting link has next to no inertia beside its geared rotor."""
    kinds = (("bend1", "0 1 0"), ("twist1", "0 0 1"), ("bend2", "0 1 0"), ("twist2", "0 0 1"))
    bodies, ends = "", ""
    for k, ((name, axis), rotor) in enumerate(zip(kinds, rotors, strict=True)):
        inertia, place = ("4e-3 4e-3 5e-4", "0.015 0 -0.1") if k == 0 else (last, f"0 {0.008 * (k == 3)} -0.05")
        bodies += (
            f'<body name="link{k}" pos="0 0 {-0.2 * (k > 0)}"><joint name="{name}" axis="{axis}" armature="{rotor}"/>'
            f'<inertial pos="{place}" mass="{1.8 if k == 0 else 0.5}" diaginertia="{inertia}"/>'
        )
        ends += "</body>"
    motors = "".join(
        f'<position joint="{name}" kp="{kp}" kv="{kv}"/>'
        for (name, _), kp, kv in zip(kinds, (220, 180, 180, 28), (2.6, 2.1, 2.1, 1.4), strict=True)
    )
    return f"<mujoco><worldbody>{bodies}{ends}</worldbody><actuator>{motors}</actuator></mujoco>"


ARMS = {
    "geared elbow": straight_arm((0.01, 0.16, 0.16, 0.01)),
    "geared wrist": straight_arm((0.02, 0.05, 0.3, 0.05), "8e-4 8e-4 2e-4"),
    "all geared": straight_arm((0.2, 0.2, 0.2, 0.2), "1e-3 1e-3 1e-4"),
    "a thin link": straight_arm((0.01, 0.12, 0.12, 0.01), "1e-3 1e-3 2e-5"),
}


def limit_of(mjcf: str) -> float:
    """The factor on all gains at which the spectral radius over a tick passes 1: torque held and one tick late, velocity by difference."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data, n = mujoco.MjData(model), model.nv
    mujoco.mj_forward(model, data)
    mass = np.zeros((n, n))
    mujoco.mj_fullM(model, data, mass)
    kp, kd = np.diag(model.actuator_gainprm[:, 0]), np.diag(-model.actuator_biasprm[:, 2])
    push, one, none = np.linalg.inv(mass), np.eye(n), np.zeros((n, n))

    def radius(factor: float) -> float:
        law = factor * np.hstack([-(kp + kd / STEP), none, kd / STEP])  # of q, v and the q of one tick ago
        rows = [
            [one, STEP * one, none, STEP**2 / 2 * push],
            [none, one, none, STEP * push],
            [one, none, none, none],
        ]
        return float(np.abs(np.linalg.eigvals(np.vstack([*map(np.hstack, rows), np.hstack([law, none])]))).max())

    low, high = 1.0, 100.0
    assert radius(low) < 1 < radius(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1 else (low, middle)
    return low


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


def told(capsys: pytest.CaptureFixture[str], *call: str) -> dict:
    assert main(["audit", *call, "--json"]) != 2
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("arm", [next(iter(ARMS)), *(pytest.param(name, marks=pytest.mark.slow) for name in [*ARMS][1:])])
def test_straight_arms_with_geared_joints_get_their_limit(arm: str, capsys: pytest.CaptureFixture[str]):
    """Their gearboxes' resonance is damped far quicker than a tick; the limit agrees with the spectral radius to 1e-6 of it, where a root
    on the circle is known to about the square root of round-off."""
    Path("arm.xml").write_text(ARMS[arm], "utf-8")
    assert told(capsys, "arm.xml", *CALL)["gain_limit"] == pytest.approx(limit_of(ARMS[arm]), rel=1e-6)


RIGID = {
    "one word for all": ({"gearboxes": ("direct",)}, None),
    "a number for all": ({"stiffness": math.inf}, None),
    "joint by joint": ({"gearboxes": ("bend.*=direct", "twist.*=direct")}, None),
    "half in words, half in numbers": ({"gearboxes": ("bend.*=direct",), "of_joints": (("stiffness", "twist.*", math.inf),)}, None),
    "with kd on the drive": ({"gearboxes": ("direct",), "gains_run": "split", "drive_rate_hz": 2000.0, "drive_delay_ms": 0.1}, None),
    "in the file of gains": ({}, "rigid"),
    "nobody": ({}, None),
}


@pytest.mark.parametrize("how", RIGID)
def test_who_says_that_joints_are_rigid_is_believed(how: str):
    options, stiffness = RIGID[how]
    Path("arm.xml").write_text(ARMS["geared elbow"], "utf-8")
    gains = {
        name: {"kp": kp, "kd": kd} | ({} if stiffness is None else {"stiffness": stiffness})
        for name, kp, kd in (("bend1", 220, 2.6), ("twist1", 180, 2.1), ("bend2", 180, 2.1), ("twist2", 28, 1.4))
    }
    Path("gains.yaml").write_text(yaml.safe_dump(gains), "utf-8")
    asked = audited("arm.xml", Path("gains.yaml"), AuditOptions(2.0, rate_hz=500.0, **options))
    found = study.audit(asked.system, BOTH_MARGINS)
    said = how != "nobody"
    assert (found.safe, found.decided) == (True, said)
    assert audit_sentence(found).startswith(
        "Safe"
        if said
        else "Not decided: the stiffness of the gearboxes is not given (--gearbox or --stiffness). "
        "With rigid gearboxes every requirement is met"
    )
    assert found.assumed_rigid.tolist() == [not said] * 4
    assert any("rigid" in text for text in asked.system.assumptions) is not said


@pytest.mark.slow
def test_of_some_rigid_joints_only_the_others_are_asked(capsys: pytest.CaptureFixture[str]):
    Path("arm.xml").write_text(ARMS["geared elbow"], "utf-8")
    found = told(capsys, "arm.xml", *CALL, *ASKED, "--gearbox", "twist1=direct", "--gearbox", "bend2=direct")
    assert (found["decided"], found["rigid_gearboxes"]) == (False, ["bend1", "twist2"])
    (why,) = [one for one in found["findings"] if one["level"] == "undecided"]
    assert (why["code"], why["joints"]) == ("gearbox_unknown", ["bend1", "twist2"])
    assert found["sentence"].startswith("Not decided: the stiffness of the gearboxes of bend1 and twist2 is not given (")


def test_a_known_stiffness_stays_and_the_word_direct_is_told_to_have_no_effect(capsys: pytest.CaptureFixture[str]):
    Path("arm.xml").write_text(ARMS["geared elbow"], "utf-8")
    options = ("--stiffness", "bend2=20000", "--damping", "bend2=10", "--gearbox", "direct")
    found = told(capsys, "arm.xml", *CALL, *options)
    assert [joint["stiffness"] for joint in found["joints"]] == [None, None, 20000, None]
    assert any("--gearbox has no effect where one joint has its stiffness" in text and "bend2" in text for text in found["warnings"])


def test_the_written_robot_says_that_joints_are_rigid(capsys: pytest.CaptureFixture[str]):
    Path("arm.xml").write_text(ARMS["geared elbow"], "utf-8")
    told(capsys, "arm.xml", *CALL, "--gearbox", "direct", "--write-robot", "robot.yaml")
    joints = yaml.safe_load(Path("robot.yaml").read_text("utf-8"))["joints"]
    assert {joints[name]["stiffness"] for name in ("bend1", "twist1", "bend2", "twist2")} == {float("inf")}


@pytest.mark.slow
def test_the_sentence_claims_no_more_than_was_checked(capsys: pytest.CaptureFixture[str]):
    """Met with rigid gearboxes, whatever was checked of elastic ones: how many sets were is told apart, and that others may not be safe."""
    Path("arm.xml").write_text(ARMS["geared elbow"], "utf-8")
    call = ("arm.xml", *CALL, *ASKED, "--gearbox", "twist1=direct")
    found = told(capsys, *call)
    assert found["verdict"] == "undecided"
    assert "With rigid gearboxes every requirement is met" in found["sentence"]
    assert "checked" not in found["sentence"]
    assert main(["audit", *call]) == 3
    assert SOFTER in " ".join(capsys.readouterr().out.split())
