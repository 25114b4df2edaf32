"""What a model and its gains leave open is no verdict where it decides: joints' damping where actuators have no kd, where kp and kd run."""

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.linalg import expm

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.readings import FAMILIES, family_of

STEP, TICKS = 2e-3, 1
DAMPING = 6.0
"""[N m s/rad] too much for a kd with this delay, and none as friction."""


def leg(
    servo: str = 'kp="12"', damping: float = DAMPING, more: str = "", model: str = "leg", names: tuple[str, str] = ("hip", "knee")
) -> str:
    first, second = names
    servos = "".join(f"<position joint='{name}' {servo}/>" for name in names)
    return f"""<mujoco model="{model}"><default><joint damping="{damping}" armature="0.025"/></default><worldbody>
    <body pos="0 0 1"><joint name="{first}" axis="0 1 0"/><inertial pos="0 0 -0.07" mass="0.2" diaginertia="3e-4 3e-4 4e-5"/>
    <body pos="0 0 -0.13"><joint name="{second}" axis="0 1 0"{more}/>
    <inertial pos="0 0 -0.06" mass="0.1" diaginertia="1e-4 1e-4 1e-5"/></body>
    </body></worldbody><actuator>{servos}</actuator></mujoco>"""


def limit_of(mjcf: str, kp: np.ndarray, kd: np.ndarray, friction: np.ndarray, step: float = STEP) -> float:
    """The factor on all gains at which the spectral radius over a tick passes 1: rigid joints, torque held and TICKS late."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data, n = mujoco.MjData(model), model.nv
    mujoco.mj_forward(model, data)
    mass = np.zeros((n, n))
    mujoco.mj_fullM(model, data, mass)
    push, one, none = np.linalg.inv(mass), np.eye(n), np.zeros((n, n))
    whole = expm(step * np.block([[none, one, none], [none, -push @ np.diag(friction), push], [none, none, none]]))

    def radius(factor: float) -> float:
        law = factor * np.hstack([-np.diag(kp + kd / step), none, np.diag(kd / step), none])
        tick = np.vstack([
            np.hstack([whole[:n, : 2 * n], none, whole[:n, 2 * n :]]),
            np.hstack([whole[n : 2 * n, : 2 * n], none, whole[n : 2 * n, 2 * n :]]),
            np.hstack([one, none, none, none]),
            law,
        ])  # fmt: skip
        return float(np.abs(np.linalg.eigvals(tick)).max())

    low, high = 0.1, 1000.0
    assert radius(low) < 1 < radius(high)
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if radius(middle) < 1 else (low, middle)
    return low


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


CALL = ("--delay-ms", "2", "--rate-hz", "500", "--gearbox", "direct")


def told(capsys: pytest.CaptureFixture[str], model: str, *call: str, name: str = "robot.xml") -> tuple[int, dict]:
    Path(name).write_text(model, "utf-8")
    status = main(["audit", name, *(call or CALL), "--json"])
    return status, json.loads(capsys.readouterr().out)


GENERAL = leg().replace("<position joint='hip' kp=\"12\"/>", '<general joint="hip" gainprm="12" biastype="affine" biasprm="0 -12 0"/>')


@pytest.mark.parametrize("model", [leg(), leg('kp="12" kv="0"'), GENERAL, leg(more=' damping="7.0"')])
def test_a_servo_without_kd_on_a_damped_joint_is_open_between_two_limits(model: str, capsys: pytest.CaptureFixture[str]):
    """Each is the spectral radius's, to 1e-6 of it, where a root on the circle is known to about the square root of round-off."""
    status, found = told(capsys, model)
    assert (status, found["verdict"], found["decided"]) == (3, "undecided", False)
    assert found["sentence"].startswith("Not decided: --joint-damping is not given: controller (")
    damping = np.array([DAMPING, 7.0 if '"7.0"' in model else DAMPING])
    kp = np.full(2, 12.0)
    truths = {
        "--joint-damping controller": limit_of(model, kp, damping, np.zeros(2)),
        "--joint-damping friction": limit_of(model, kp, np.zeros(2), damping),
    }
    assert {one["option"]: one["gain_limit"] for one in found["readings"]} == {
        option: pytest.approx(truth, rel=1e-6) for option, truth in truths.items()
    }
    assert truths["--joint-damping controller"] < 0.98 * 10 ** (6 / 20) < truths["--joint-damping friction"]
    assert found["to_use"] is None
    (open_,) = [one for one in found["findings"] if one["code"] == "read_in_two_ways"]
    assert [one["verdict"] for one in open_["readings"]] == ["unsafe", "safe"]
    for truth in truths.values():
        assert f"vibration starts at {float(f'{truth:.4g}'):g} × these gains" in found["sentence"]


def test_the_flag_that_decides_is_advised_and_decides(capsys: pytest.CaptureFixture[str]):
    Path("robot.xml").write_text(leg(), "utf-8")
    assert main(["audit", "robot.xml", *CALL]) == 3
    out = capsys.readouterr().out
    assert out.startswith("Not decided: --joint-damping is not given")
    assert len(re.findall(r"^  gainroom audit robot.xml .* --joint-damping (?:controller|friction)$", out, re.MULTILINE)) == 2
    for what, status in (("controller", 1), ("friction", 0)):
        answer, found = told(capsys, leg(), *CALL, "--joint-damping", what)
        assert (answer, found["safe"], found["readings"]) == (status, status == 0, [])


def test_what_is_safe_in_both_readings_is_safe(capsys: pytest.CaptureFixture[str]):
    status, found = told(capsys, leg(damping=0.5))
    kp, kd, none = np.full(2, 12.0), np.full(2, 0.5), np.zeros(2)
    limits = [limit_of(leg(damping=0.5), kp, kd, none), limit_of(leg(damping=0.5), kp, none, kd)]
    assert [one["gain_limit"] for one in found["readings"]] == pytest.approx(limits, rel=1e-6)
    assert (status, found["verdict"], [one["safe"] for one in found["readings"]]) == (0, "safe", [True, True])


def test_a_gearbox_that_nobody_described_decides_in_the_drives_too(capsys: pytest.CaptureFixture[str]):
    """Unsafe on the host with any gearbox, safe in the drives with a rigid one alone: both flags are asked for."""
    call = ("--delay-ms", "4", "--rate-hz", "500")
    status, found = told(capsys, leg(*HOST_UNSAFE, **HUMANOID), *call)
    assert status == 3
    codes = {one["code"]: one for one in found["findings"] if one["level"] == "undecided"}
    assert {"read_in_two_ways", "gearbox_unknown"} <= codes.keys()
    drive = next(one["option"] for one in found["readings"] if "drive" in one["option"]).split()
    status, found = told(capsys, leg(*HOST_UNSAFE, **HUMANOID), "--delay-ms", "4", *drive)
    assert (status, [one["code"] for one in found["findings"] if one["level"] == "undecided"]) == (3, ["gearbox_unknown"])


def test_a_file_of_gains_without_kd_likewise(capsys: pytest.CaptureFixture[str]):
    Path("gains.yaml").write_text("{default: {kp: 12, kd: 0}}", "utf-8")
    status, found = told(capsys, leg('kp="1" kv="1"'), *CALL, "--gains", "gains.yaml")
    assert (status, found["verdict"]) == (3, "undecided")
    assert found["sentence"].startswith("Not decided: --joint-damping is not given")


@pytest.mark.parametrize(
    ("model", "says"),
    [
        (leg('kp="12" kv="0.5"'), "Safe"),  # kd of its own
        (leg(damping=0.0), "Not safe: unstable"),  # no damping at all
        (leg('kp="4000"'), "Not safe"),  # too much for either reading
    ],
)
def test_nothing_is_open_with_kd_without_damping_or_where_both_are_unsafe(model: str, says: str, capsys: pytest.CaptureFixture[str]):
    _, found = told(capsys, model)
    assert found["sentence"].startswith(says)


def test_the_robot_that_is_written_is_one_of_the_readings(capsys: pytest.CaptureFixture[str]):
    told(capsys, leg(), *CALL, "--write-robot", "robot.yaml")
    text = Path("robot.yaml").read_text("utf-8")
    assert ("link_viscous" in text) is not ("kd: {hip: 6.0" in text)


HUMANOID = {"model": "g1_29dof", "names": ("left_hip_pitch_joint", "left_knee_joint")}
QUADRUPED = {"model": "go2", "names": ("FL_hip_joint", "FL_thigh_joint")}
BOOSTER = {"model": "T1", "names": ("Left_Hip_Pitch", "Left_Knee_Pitch")}
HOST_UNSAFE = ('kp="60" kv="5"', 0.0)  # at 4 ms and 500 Hz, not in a drive at 1 kHz


@pytest.mark.parametrize("robot", [HUMANOID, QUADRUPED, BOOSTER])
def test_where_kp_and_kd_run_is_open_on_robots_whose_drives_take_them(robot: dict, capsys: pytest.CaptureFixture[str]):
    model, call = leg(*HOST_UNSAFE, **robot), ("--delay-ms", "4", "--rate-hz", "500", "--gearbox", "direct")
    status, found = told(capsys, model, *call)
    assert (status, found["verdict"], found["to_use"]) == (3, "undecided", None)
    assert found["sentence"].startswith("Not decided: --gains-run is not given: host (the program computes the torques and sends them): ")
    host, drive = found["readings"]
    assert (host["safe"], drive["safe"]) == (False, True)
    assert host["gain_limit"] == found["gain_limit"] == pytest.approx(told(capsys, model, *call, "--gains-run", "host")[1]["gain_limit"])
    flags = drive["option"].split()
    status, there = told(capsys, model, "--delay-ms", "4", "--gearbox", "direct", *flags)
    assert (status, there["gain_limit"]) == (0, pytest.approx(drive["gain_limit"]))


def test_gains_that_a_fast_host_holds_and_a_slower_drive_does_not_are_open(capsys: pytest.CaptureFixture[str]):
    """Gains that are safe at 5 kHz are not taken to be so in drives, which are read as at 1 kHz; either has one tick of delay."""
    model, (kp, kd) = leg('kp="600" kv="12"', 0.0, **HUMANOID), (np.full(2, 600.0), np.full(2, 12.0))
    truths = {step: limit_of(model, kp, kd, np.zeros(2), step) for step in (2e-4, 1e-3)}
    assert truths[1e-3] < 1.9 < 2.1 < truths[2e-4]
    status, found = told(capsys, model, "--delay-ms", "0.2", "--rate-hz", "5000", "--gearbox", "direct")
    host, drive = found["readings"]
    assert (host["gain_limit"], drive["gain_limit"]) == pytest.approx((truths[2e-4], truths[1e-3]), rel=1e-6)
    assert (status, host["safe"], drive["safe"]) == (3, True, False)


def test_gains_in_a_drives_own_form_likewise(capsys: pytest.CaptureFixture[str]):
    """60 N·m/rad and 5 N·m·s/rad per revolution: moteus computes them in the drive, whatever the robot is."""
    Path("gains.yaml").write_text(f"moteus: {{'.*': {{kp: {60 * 2 * np.pi}, kd: {5 * 2 * np.pi}}}}}", "utf-8")
    call = ("--delay-ms", "4", "--rate-hz", "500", "--gearbox", "direct", "--gains", "gains.yaml")
    _, found = told(capsys, leg(*HOST_UNSAFE), *call)
    assert found["sentence"].startswith("Not decided: --gains-run is not given")


@pytest.mark.parametrize(
    ("robot", "options"),
    [
        ({"model": "leg", "names": ("left_hip_pitch_joint", "left_knee_joint")}, ()),  # no known robot
        ({"model": "t1", "names": ("a", "b")}, ()),  # its name, but not its joints
        (HUMANOID, ("--gains-run", "host")),  # said
    ],
)
def test_elsewhere_the_host_is_judged(robot: dict, options: tuple[str, ...], capsys: pytest.CaptureFixture[str]):
    _, found = told(capsys, leg(*HOST_UNSAFE, **robot), "--delay-ms", "4", "--rate-hz", "500", "--gearbox", "direct", *options)
    assert found["sentence"].startswith("Not safe: stable, but 3 requirements fail: ")
    assert found["verdict"] == "unsafe"
    assert found["readings"] == []


def test_verdicts_that_agree_are_verdicts(capsys: pytest.CaptureFixture[str]):
    """Safe on the host and in the drives is safe; unsafe in both is unsafe, and what the drives do is told."""
    _, found = told(capsys, leg('kp="12" kv="0.5"', 0.0, **HUMANOID))
    assert (found["sentence"].startswith("Safe"), found["readings"]) == (True, [])
    _, found = told(capsys, leg('kp="4000" kv="60"', 0.0, **HUMANOID))
    assert found["sentence"].startswith("Not safe")
    assert "--gains-run is not given: host (" in found["sentence"]
    assert [one["safe"] for one in found["readings"]] == [False, False]


def test_a_reading_that_cannot_be_computed_does_not_end_the_audit(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    def fails(*_: object) -> None:
        raise GainroomError("cannot be computed")

    monkeypatch.setattr("gainroom.files.audit_call.drive_reading", fails)
    _, found = told(capsys, leg(*HOST_UNSAFE, **HUMANOID), "--delay-ms", "4", "--rate-hz", "500", "--gearbox", "direct")
    assert (found["verdict"], found["readings"]) == ("unsafe", [])
    assert found["sentence"].startswith("Not safe: stable, but 3 requirements fail: ")


def test_the_numbers_say_which_reading_they_are_of(capsys: pytest.CaptureFixture[str]):
    _, found = told(capsys, leg())
    option, limit = min(((one["option"], one["gain_limit"]) for one in found["readings"]), key=lambda one: one[1])
    assert found["gain_limit"] == limit
    assert f" With {option}: Vibration starts at {limit:.3g} × these gains" in found["sentence"]


def test_every_family_has_its_source():
    assert all(re.search("sdk|20[0-9]{2}|reference", one.source) for one in FAMILIES)
    assert family_of("example-robot-data:g1_29dof_rev_1_0.urdf") is not None
    assert family_of("example-robot-data:go2.urdf") is not None
    assert family_of("example-robot-data:panda.urdf") is None
    assert family_of("example-robot-data:talos_reduced.urdf") is None


def test_the_robot_that_is_written_says_which_reading_it_is(capsys: pytest.CaptureFixture[str]):
    assert told(capsys, leg(), *CALL, "--write-robot", "robot.yaml")[0] == 3
    (line,) = [line for line in Path("robot.yaml").read_text("utf-8").splitlines() if "reads robot.xml as with" in line]
    first, second = re.findall(r"--joint-damping (\w+)", line)
    assert {first, second} == {"controller", "friction"}
    assert ("link_viscous" in Path("robot.yaml").read_text("utf-8")) is (first == "friction")
