"""A requirement and a controller that this package does not know, each added in one place, and judged wherever others are.

The requirement is measured of the loop, as no margin is: the rms of the torque command that encoder noise makes.
"""

import json
import math
import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.part_region_margins import unread
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.studies.critical_joints import critical_joints
from gainroom.system.controller import CONTROLLERS, Controller, GainKey
from gainroom.system.requirement import Requirement
from gainroom.system.requirements import REQUIREMENTS, SensitivityBound
from independent.joint import PDJoint
from independent.margins import response
from robot_files import ROBOT, write_arm

COUNT, POINTS = 1e-4, 200
"""[rad rms] of the encoder; frequencies at which the noise's power is summed."""


@dataclass(frozen=True)
class NoiseTorque(Requirement):
    """The rms torque command [N m] of the motor that has most, where every position is measured with white noise of COUNT up to `band`."""

    at_most: bool = True
    band: float = 2 * math.pi * 500

    def measured(self, loop: Any) -> float:
        omega = (np.arange(POINTS) + 0.5) / POINTS * (self.band if loop.sample_time is None else math.pi / loop.sample_time)
        law, ratio = loop.control_at(1j * omega), loop.response(omega).reshape(POINTS, loop.size, loop.size)
        torque = law @ np.linalg.inv(np.eye(loop.size) + ratio)
        return COUNT * math.sqrt((np.abs(torque) ** 2).mean(axis=0).sum(axis=1).max())


NOISE = NoiseTorque("noise_torque", "rms noise torque", "noise_torque_nm", "N·m", meaning="what encoder noise makes of the torque.")
JOINT = """\
joint: {motor_inertia: 1.0, link_inertia: 4.0, stiffness: 1e4, damping: 1.0}
drive: {bandwidth: 4000, delay_ms: 2}
control: {type: pd, feedback: motor, kp: 900, kd: 100}
limits: {gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2}
"""


@pytest.fixture
def noise(monkeypatch: pytest.MonkeyPatch) -> NoiseTorque:
    monkeypatch.setitem(REQUIREMENTS, NOISE.name, NOISE)
    return NOISE


def with_limit(text: str, most: float) -> str:
    return text.replace("peak_sensitivity: 2}", f"peak_sensitivity: 2, noise_torque_nm: {most!r}}}")


def own_noise(kp: float, kd: float, inertia: float = 1.0, tick: float | None = None) -> float:
    """The same of JOINT with these gains, from L out of the equations of motion; POINTS are close enough for both to be the same sum."""
    omega = (np.arange(POINTS) + 0.5) / POINTS * (math.pi / tick if tick else NOISE.band)
    rate = (1 - np.exp(-1j * omega * tick)) / tick if tick else 1j * omega
    ratio = response(PDJoint(inertia, 4.0, 1e4, 1.0, kp, kd, delay=2e-3, bandwidth=4000.0), omega, tick)
    return COUNT * math.sqrt(np.mean(np.abs((kp + rate * kd) / (1 + ratio)) ** 2))


def printed(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    main([*map(str, words)])
    return " ".join(capsys.readouterr().out.split())


def of_json(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    return json.loads(printed(capsys, *words, "--json"))


@pytest.mark.slow
def test_a_measured_requirement_of_a_joint(tmp_path: Path, capsys, noise: NoiseTorque):
    """Judged, worded, in JSON and on the page; kept by the recommended gains, which are as stiff as it allows."""
    path, page, now = tmp_path / "joint.yaml", tmp_path / "page.html", own_noise(900.0, 100.0)
    most = float(f"{0.6 * now:.4g}")
    path.write_text(with_limit(JOINT, most), "utf-8")
    found, screen = of_json(capsys, "joint", path, "--report", page), printed(capsys, "joint", path)
    assert found["noise_torque_nm"] == pytest.approx(now, rel=1e-9)
    assert found["required"]["noise_torque_nm"] == most
    assert "noise_torque" in found["unmet"]
    assert f"rms noise torque {now:.3g} N·m (≤ {most:.3g} N·m)" in found["sentence"]
    assert own_noise(900.0, 100.0, tick=1 / 2000) > most > own_noise(900.0, 100.0, tick=1 / 500)  # so that the rate decides
    assert found["sentence"].startswith("Not decided: the loop's rate is not given, and any rate costs margin (control.sample_rate_hz). ")
    assert " With a rate of 500 Hz: safe." in found["sentence"]
    assert "rms noise torque" in screen
    assert "rms noise torque" in page.read_text("utf-8")
    use = found["recommended"]
    kept = own_noise(use["kp"], use["kd"])
    assert use["margins"]["noise_torque_nm"] == pytest.approx(kept, rel=1e-9)
    assert 0.98 * most < kept <= most * (1 + 1e-9)
    assert use["binding"] == "noise_torque"


@pytest.mark.slow
def test_what_cannot_be_met_is_told_once(tmp_path: Path, capsys, noise: NoiseTorque):
    """One screen said "Safe: every requirement is met" above "no gains meet the requirements"."""
    path = tmp_path / "joint.yaml"
    for most, met in ((1e-9, False), (1e9, True)):
        path.write_text(with_limit(JOINT, most), "utf-8")
        screen, found = printed(capsys, "joint", path), of_json(capsys, "joint", path)
        assert ("noise_torque" not in found["unmet"]) is met
        assert (found["recommended"] is not None) is met
        assert ("no PD gains meet the requirements" in screen) is not met


@pytest.mark.slow
def test_a_measured_requirement_over_a_range(tmp_path: Path, capsys, noise: NoiseTorque):
    """The worst of the cases that are looked at, the ends among them; nothing is proved of it, and nothing claimed."""
    text = with_limit(JOINT, 1e9) + "uncertainty: {motor_inertia: 20%}\n"
    path = tmp_path / "joint.yaml"
    path.write_text(text, "utf-8")
    found = of_json(capsys, "joint", path)
    ends, inside = ([own_noise(900.0, 100.0, inertia) for inertia in np.linspace(0.8, 1.2, count)] for count in (2, 81))
    assert max(ends) * (1 - 1e-9) <= found["worst"]["noise_torque_nm"] <= max(inside) * 1.001  # 81 cases miss little of so smooth a curve
    assert found["worst_case"]["noise_torque"]
    assert found["recommended"]["proved"] is False


@pytest.mark.slow
def test_a_simulated_joint_is_judged_the_same(tmp_path: Path, capsys, noise: NoiseTorque):
    path = tmp_path / "joint.yaml"
    path.write_text(with_limit(JOINT.replace("kp: 900", "sample_rate_hz: 2000, kp: 900"), 0.01), "utf-8")
    missed, run = (of_json(capsys, command, path)["sentence"] for command in ("joint", "simulate"))
    start = missed.partition("rms noise torque")[2].partition(" N·m)")[0]
    assert start
    assert f"rms noise torque{start} N·m)" in run


def arm_noise(path: Path, kp: Any, kd: Any) -> float:
    """Of the arm sampled at 2 kHz, its law written out: kp + kd (1 − z⁻¹)/T."""
    system = load_robot_system(path)
    case = next(iter(system.cases()))
    loop = system.loop(case.model, gr.PD(np.array(kp), np.array(kd)))
    omega = (np.arange(POINTS) + 0.5) / POINTS * math.pi * 2000
    law = np.array(kp) + np.multiply.outer((1 - np.exp(-1j * omega / 2000)) * 2000, np.array(kd))
    torque = law[:, :, None] * np.linalg.inv(np.eye(2) + loop.response(omega))
    # L = P D, and the command is −D (I + P D)⁻¹ n
    return COUNT * math.sqrt((np.abs(torque) ** 2).mean(axis=0).sum(axis=1).max())


@pytest.mark.slow
def test_a_measured_requirement_of_a_robot(tmp_path: Path, capsys, noise: NoiseTorque):
    """In robot, sweep and simulate: missed alike; kept by the recommended gains."""
    limits = "limits: {gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2}\n"
    path = write_arm(tmp_path, with_limit(ROBOT.partition("tasks")[0] + limits, 2.0))
    now = arm_noise(path, [400.0, 400.0], [30.0, 30.0])
    found = of_json(capsys, "robot", path)
    assert found["states"][0]["kept"]["noise_torque_nm"] == pytest.approx(now, rel=1e-9)
    assert found["unmet"] == ["noise_torque"]
    assert "rms noise torque" in found["sentence"]
    assert "mainly at" not in found["sentence"]  # it tells nothing of single joints
    (sets, *_) = found["recommended"][0]["sets"]
    assert 0.9 * 2.0 < arm_noise(path, sets["kp"], sets["kd"]) <= 2.0 * (1 + 1e-9)
    swept = of_json(capsys, "sweep", path, "--samples", "8")
    assert swept["unmet"] == ["noise_torque"]
    assert "rms noise torque" in of_json(capsys, "simulate", path)["sentence"]


def audited(folder: Path, *more: str | Path) -> list[str]:
    """A call of audit for the arm's links with motors and gains."""
    gains = folder / "gains.yaml"
    gains.write_text("gains: {shoulder: {kp: 400, kd: 30}, elbow: {kp: 400, kd: 30}}\n", "utf-8")
    said = {"delay-ms": 2, "rate-hz": 2000, "stiffness": 8000, "damping": 4, "motor-inertia": 0.5, "bandwidth": 4000}
    machine = [word for name, value in said.items() for word in (f"--{name}", str(value))]
    return ["audit", str(folder / "robot.urdf"), "--gains", str(gains), *machine, *map(str, more)]


@pytest.mark.slow
def test_a_measured_requirement_of_an_audit(tmp_path: Path, capsys, noise: NoiseTorque):
    """Asked for by its key, missed, kept by the gains to use instead, and in the robot.yaml that is written, which misses it alike."""
    written = tmp_path / "written.yaml"
    write_arm(tmp_path)
    found = of_json(capsys, *audited(tmp_path, "--require", "noise_torque_nm=6", "--write-robot", written, "--workspace", "4"))
    now = arm_noise(written, [400.0, 400.0], [30.0, 30.0])
    assert found["noise_torque_nm"] == pytest.approx(now, rel=1e-6)  # as the file's digits of the model are
    assert "noise_torque" in found["unmet"]
    assert "rms noise torque" in found["sentence"]
    assert found["required"]["noise_torque_nm"] == 6.0
    use = found["to_use"]["joints"]
    assert 0.9 * 6 < arm_noise(written, *([joint[gain] for joint in use] for gain in ("kp", "kd"))) <= 6.0 * (1 + 1e-9)
    robot = of_json(capsys, "robot", written)
    assert robot["worst"]["noise_torque"]["noise_torque_nm"] == pytest.approx(found["noise_torque_nm"], rel=1e-9)
    assert "noise_torque" in robot["unmet"]


COMPLEMENTARY = SensitivityBound("peak_complementary", "Mt", "peak_complementary", slope=-1.0, offset=1.0)


def test_an_audit_says_of_a_joint_what_was_measured_of_it(tmp_path: Path, capsys, monkeypatch, noise: NoiseTorque):
    """Where the robot misses what a joint has no value of, the joint is not told safe; one whose value is known and too large is unsafe."""
    monkeypatch.setitem(REQUIREMENTS, COMPLEMENTARY.name, replace(COMPLEMENTARY, at_frequency="peak_complementary_frequency"))
    write_arm(tmp_path)
    written, lenient = (
        tmp_path / "written.yaml",
        ("--margin-db", "1", "--require", "phase_margin_deg=5", "--require", "peak_sensitivity=20"),
    )
    call = [*audited(tmp_path, *lenient), "--write-robot", str(written)]
    assert {joint["safe"] for joint in of_json(capsys, *call)["joints"]} == {True}

    system = load_robot_system(written)
    case = next(iter(system.cases()))
    response = system.loop(case.model, system.controller(case.model)).response(np.geomspace(1e-1, np.pi * 2000, 100_000))
    peaks = np.abs(1 - np.diagonal(np.linalg.inv(np.eye(2) + response), axis1=1, axis2=2)).max(axis=0)
    first, second = np.argsort(-peaks)
    assert peaks[first] > peaks[second] > 1.02
    for least, safe in ((peaks[second], {first: False, second: None}), (peaks[first], {first: True, second: True})):
        share = 0.99 if safe[second] is None else 1.01  # so that both loops miss it, or none
        found = of_json(capsys, *call, "--require", f"peak_complementary={share * least:.4f}")
        assert [joint["safe"] for joint in found["joints"]] == [safe[k] for k in range(2)]
        known = found["joints"][first]["margins"]["peak_complementary"]
        assert known == pytest.approx(peaks[first], rel=1e-3)

    missed = [*call, "--require", "noise_torque_nm=6"]
    page = tmp_path / "page.html"
    assert [joint["safe"] for joint in of_json(capsys, *missed)["joints"]] == [None, None]
    text = printed(capsys, *missed, "--report", page)
    table = text.partition(" joint ")[2]
    assert "safe –: not known, as the robot misses what was not measured of this joint" in text
    assert "rms noise torque ≤" not in table
    html = page.read_text("utf-8")
    assert "not known of 2; judged:" in html
    assert "Joints whose loops miss it" not in html


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise=2", "--require noise=2: must be LIMIT=NUMBER or LIMIT=none, with one of gain_margin_db,"),
        ("noise_torque_nm", "--require noise_torque_nm: '' must be a number"),
        ("noise_torque_nm=-1", "--require noise_torque_nm -1: must be > 0"),
        ("noise_torque_nm=nan", "--require noise_torque_nm nan: must be > 0"),
    ],
)
def test_what_audit_cannot_require_is_refused(text: str, message: str, tmp_path: Path, capsys, noise: NoiseTorque):
    write_arm(tmp_path)
    assert main(audited(tmp_path, "--require", text)) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_app_shows_a_measured_requirement(tmp_path: Path, noise: NoiseTorque):
    """The verdict's table has it; the map of one loop's gains, which cannot, says so."""
    pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")
    from gainroom.app.bench import Opened
    from gainroom.app.joint_bench import JointBench
    from gainroom.app.messages import View
    from gainroom.app.robot_bench import RobotBench

    limits = "limits: {gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2}\n"
    two = ROBOT.partition("tasks")[0].replace("postures: {", "postures: {straight: {}, ") + limits
    arm = write_arm(tmp_path, with_limit(two, 2.0))
    for bench in (
        JointBench(Opened(with_limit(JOINT, 1.0), "joint.yaml", tmp_path)),
        RobotBench(Opened(arm.read_text("utf-8"), "robot.yaml", tmp_path)),
    ):
        verdicts = [part for name, part in bench.full(View(), None, lambda *_: None) if name == "verdict"]
        row = next(row for row in verdicts[-1]["rows"] if row["name"] == "noise_torque")
        assert row["met"] is False
        assert "rms noise torque" in verdicts[-1]["sentence"]
    maps = [part for name, part in bench.curves(View(), None, "", True) if name == "map"]
    assert [part.get("unread") for part in maps][-1] == ["rms noise torque"]
    assert not any(part.get("whole") for part in maps)  # "every requirement in every state" is not known
    assert maps[-1]["last"]


@pytest.mark.slow
@dataclass(frozen=True)
class Bandwidth(Requirement):
    """The least frequency [rad/s] at which a position no longer follows its reference within 3 dB, as far as the samples tell."""

    def measured(self, loop: Any) -> float:
        omega = np.geomspace(0.1, 3000, 500)
        ratio = loop.response(omega).reshape(500, loop.size, loop.size)
        follows = np.abs(np.diagonal(np.linalg.solve(np.eye(loop.size) + ratio, ratio), axis1=1, axis2=2)) > math.sqrt(0.5)
        return float(omega[np.argmin(follows.all(axis=1))])


BANDWIDTH = Bandwidth("bandwidth", "bandwidth", "bandwidth_hz", "Hz", 1 / (2 * math.pi), usual=2 * math.pi * 5)
"""One that is at least so much, and is asked for where a file says nothing."""


@pytest.mark.slow
def test_a_usual_requirement_is_asked_for_where_nothing_is_said(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(REQUIREMENTS, BANDWIDTH.name, BANDWIDTH)
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.partition("limits")[0], "utf-8")
    found = of_json(capsys, "joint", path)
    omega = np.geomspace(0.1, 3000, 500)
    ratio = response(PDJoint(1.0, 4.0, 1e4, 1.0, 900.0, 100.0, delay=2e-3, bandwidth=4000.0), omega)
    own = omega[np.argmin(np.abs(ratio / (1 + ratio)) > math.sqrt(0.5))] / (2 * math.pi)
    assert found["bandwidth_hz"] == pytest.approx(own)
    assert ("bandwidth" in found["unmet"]) is bool(own < 5) is True
    assert found["recommended"]["margins"]["bandwidth_hz"] >= 5
    assert "bandwidth ≥ 5 Hz" in load_robot_system(write_arm(tmp_path)).assumptions[-1]


def test_the_joint_that_misses_a_requirement(monkeypatch: pytest.MonkeyPatch):
    """Of a bound on |1 − S_ii| the joint with the largest there; of what is measured the one that it names, or none."""

    @dataclass(frozen=True)
    class OfJoints(Bandwidth):
        def of_loops(self, found: Any) -> Any:
            return np.array([3.0, 2.0])

    known = SensitivityBound("peak_complementary", "Mt", "mt", at_frequency="peak_complementary_frequency", slope=-1.0, offset=1.0)
    of_joints = OfJoints("of_joints", "bandwidth", "of_joints_hz")
    for one in (known, BANDWIDTH, of_joints):
        monkeypatch.setitem(REQUIREMENTS, one.name, one)
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    for kd, worst in (([8.0, 30.0], 0), ([30.0, 8.0], 1)):
        loop = gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(np.array([400.0, 400.0]), np.array(kd)))
        found = gr.margins(loop)
        values = loop.response(np.geomspace(0.1, 3000, 20_000))
        peaks = np.abs(1 - np.diagonal(np.linalg.inv(np.eye(2) + values), axis1=1, axis2=2)).max(axis=0)
        assert np.argmax(peaks) == worst
        assert critical_joints(loop, found, ("hip", "knee"), known.name) == (("hip", "knee")[worst],)
        assert critical_joints(loop, found, ("hip", "knee"), "bandwidth") == ()
        assert critical_joints(loop, found, ("hip", "knee"), "of_joints") == ("knee",)


def test_no_picture_leaves_out_a_requirement_unsaid():
    """A delay margin, which is of all loops together, is in no map of one loop's gains."""
    assert unread(gr.Requirements(gain_margin=2.0, phase_margin=0.5, peak_sensitivity=2.0)) == ()
    assert unread(gr.Requirements(delay_margin=1e-3)) == ("delay margin",)


def test_what_is_measured_is_not_known_where_the_loop_cannot_tell(noise: NoiseTorque):
    """Of an unstable loop, of a callable, and of kd on a path of its own: NaN, which meets nothing."""
    joint, drive = gr.ElasticJoint(1.0, 4.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    stable = gr.margins(gr.build_loop(joint, drive, gr.PD(900.0, 100.0)))
    assert NOISE.value(stable) == pytest.approx(own_noise(900.0, 100.0), rel=1e-9)
    assert math.isnan(NOISE.value(gr.margins(gr.build_loop(joint, drive, gr.PD(9e5, 100.0)))))
    assert math.isnan(NOISE.value(gr.margins(gr.loop_from(lambda s: 1 / (s + 1)))))
    asked = gr.Requirements(noise_torque=1e9)
    assert asked.met_by(stable)
    assert not asked.met_by(replace(stable, loops=()))


def test_loops_go_to_other_processes():
    """Searches side by side hand their margins over, and the loops that these are of."""
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    loop = gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(np.array([400.0, 300.0]), np.array([20.0, 15.0])), sample_time=1e-3)
    found = gr.margins(loop)
    again = pickle.loads(pickle.dumps(found))
    omega = np.array([3.0, 50.0])
    assert np.array_equal(again.loops[0].response(omega), loop.response(omega))


@dataclass(frozen=True)
class DisturbanceObserver(Controller):
    """PD and an observer of what disturbs an inertia J: u = C e + d, d = Q (u − J s² x), Q = g/(s + g), so that u (1 − Q) = (C + Q J s²) e.

    kp [N m/rad], kd [N m s/rad], observer g [rad/s], inertia J [kg m²]
    """

    kind = "PD with a disturbance observer"
    GAINS = (
        *gr.PD.GAINS,
        GainKey("observer", "rad/s", "the bandwidth of the disturbance observer", scales=False),
        GainKey("inertia", "kg·m²", "the inertia that the disturbance observer assumes"),
    )
    held_ratio = "inertia/kd"

    kp: Any
    kd: Any
    observer: Any
    inertia: Any

    def terms(self) -> Any:
        """(C + Q J s²)/(1 − Q) = (kp + kd s)(1 + g/s) + g J s."""
        g = self.observer
        return {(0, 0): np.asarray(self.kp + g * self.kd), (1, 0): np.asarray(self.kd + g * self.inertia), (0, 1): np.asarray(g * self.kp)}

    def plane(self) -> Any:
        """J/kd is held."""
        g = self.observer
        return {(0, 0): 1.0, (0, 1): g}, {(0, 0): g, (1, 0): 1 + g * self.inertia / self.kd}

    def plane_gains(self) -> tuple[float, float]:
        return self.kp, self.kd

    def from_plane(self, kp: float, kd: float) -> "DisturbanceObserver":
        return replace(self, kp=kp, kd=kd, inertia=kd * self.inertia / self.kd)


@dataclass(frozen=True)
class Unplanned(DisturbanceObserver):
    """The same, and no search for gains knows how to move them."""

    has_plane = False
    held_ratio = ""


@pytest.fixture
def observer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CONTROLLERS, "dob", DisturbanceObserver)
    monkeypatch.setitem(CONTROLLERS, "unplanned", Unplanned)


class Careful(DisturbanceObserver):
    """The same, which refuses gains of its own accord, and knows nothing of files."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.any(np.asarray(self.observer) > 100):
            raise gr.GainroomError("the observer must not be faster than 100 rad/s")
        if np.any(np.asarray(self.inertia) > 10 * np.asarray(self.kd)):
            raise gr.GainroomError("damps too little")


OBSERVED = "type: dob, feedback: motor, kp: 600, kd: 90, observer: 6, inertia: 0.5"
AS_PID = "type: pid, feedback: motor, kp: 1140, ki: 3600, kd: 93"
"""The same law: kp + g kd, g kp, kd + g J."""
KNEE = JOINT.replace("type: pd, feedback: motor, kp: 900, kd: 100", f"{OBSERVED}, sample_rate_hz: 2000")
ARM = ROBOT.partition("tasks")[0].replace(
    "type: pd, feedback: motor, sample_rate_hz: 2000, kp: 400.0, kd: 30.0", f"{OBSERVED}, sample_rate_hz: 2000"
)
SAME = "gain_margin_db", "phase_margin_deg", "delay_margin_ms", "peak_sensitivity", "gain_limit", "stable", "unmet", "requirements_met"


@pytest.mark.parametrize(
    ("wrong", "joint", "robot"),
    [
        ("observer: 101", "control.observer 101.0", "control.observer [101.0, 101.0]"),
        (
            "observer: 6, inertia: 5000",
            "control.kp 600.0, control.kd 90.0, control.observer 6.0, control.inertia 5000.0",
            "control.kp [600.0, 600.0], control.kd [90.0, 90.0], control.observer [6.0, 6.0], control.inertia [5000.0, 5000.0]",
        ),
    ],
)
def test_what_a_controller_refuses_names_file_key_and_value(tmp_path: Path, capsys, monkeypatch, wrong: str, joint: str, robot: str):
    """Its class raises an error that knows neither; where it names no gain, all of them are told."""
    monkeypatch.setitem(CONTROLLERS, "dob", Careful)
    write_arm(tmp_path)
    why = "the observer must not be faster than 100 rad/s" if "101" in wrong else "damps too little"
    given = wrong if "inertia" in wrong else f"{wrong}, inertia: 0.5"
    for command, text, told in (("joint", KNEE, joint), ("robot", ARM, robot)):
        path = tmp_path / f"{command}.yaml"
        path.write_text(text.replace("observer: 6, inertia: 0.5", given), "utf-8")
        assert main([command, str(path)]) == 2
        assert capsys.readouterr().err == f"gainroom: error: {path}: {told}: {why}\n"


@pytest.mark.slow
def test_a_disturbance_observer_of_a_joint(tmp_path: Path, capsys, observer: None):
    """Read from a file, and judged as the block diagram says: Ms on a dense grid, and all else as of the PID that it amounts to."""
    path = tmp_path / "joint.yaml"
    path.write_text(KNEE.replace(", sample_rate_hz: 2000", ""), "utf-8")
    omega = np.geomspace(0.1, 3000, 200_000)
    plant, q = response(PDJoint(1.0, 4.0, 1e4, 1.0, 1.0, 0.0, delay=2e-3, bandwidth=4000.0), omega), 6 / (1j * omega + 6)
    law = (600 + 90j * omega + q * 0.5 * (1j * omega) ** 2) / (1 - q)
    assert of_json(capsys, "joint", path)["peak_sensitivity"] == pytest.approx(np.max(1 / np.abs(1 + plant * law)), rel=1e-6)
    found = []
    for text in (KNEE, KNEE.replace(OBSERVED, AS_PID)):
        path.write_text(text, "utf-8")
        found.append(of_json(capsys, "joint", path))
    assert {key: found[0][key] for key in SAME} == approximately({key: found[1][key] for key in SAME})
    use = found[0]["recommended"]["controller"]
    assert (use["type"], use["observer"]) == ("dob", 6.0)
    assert use["inertia"] / use["kd"] == pytest.approx(0.5 / 90)
    use = ", ".join(f"{key}: {value!r}" for key, value in use.items())
    path.write_text(KNEE.replace(OBSERVED, f"feedback: motor, {use}"), "utf-8")
    again = of_json(capsys, "joint", path)
    assert again["requirements_met"] is True
    # the search counts a fraction of a tick as the phase that it costs, which a delay margin is not quite
    assert again["worst"] == pytest.approx(found[0]["recommended"]["margins"], rel=1e-5)


def pasted(screen: str, text: str) -> str:
    """`text` with the lines that a terminal gives for `control` in place of OBSERVED."""
    lines = screen.partition("Do this:")[2].partition("\n\n")[0].splitlines()
    gains = [line.partition("#")[0].strip() for line in lines if line.startswith("  ") and not line.strip().startswith("gainroom ")]
    return text.replace(OBSERVED, f"feedback: motor, {', '.join(gains)}")


@pytest.mark.slow
def test_advice_that_changes_the_type_names_it(tmp_path: Path, capsys, observer: None):
    """Pasted, without what it says to leave out, it is a file that meets every requirement: of a joint and of a robot."""
    limits = "limits: {gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2}\n"
    arm = write_arm(tmp_path)
    missed = KNEE.replace("peak_sensitivity: 2", "peak_sensitivity: 1.3")  # a controller that meets all is left as it is
    for command, path, text in (("joint", tmp_path / "joint.yaml", missed), ("robot", arm, ARM + limits)):
        for kind in ("unplanned", "dob") if command == "robot" else ("unplanned",):
            path.write_text(text.replace("type: dob", f"type: {kind}"), "utf-8")
            main([command, str(path), "--report", str(tmp_path / "page.html")])
            screen, page = capsys.readouterr().out, (tmp_path / "page.html").read_text("utf-8")
            assert "type: pd  # leave out observer and inertia" in screen
            assert "type: pd  # leave out observer and inertia" in page
            assert command == "robot" or "Recommended controller, type pd: kp" in page
            path.write_text(pasted(screen, text), "utf-8")
            found = of_json(capsys, command, path)
            assert found["unmet"] == []
            assert found["stable"]


@pytest.mark.slow
def test_a_disturbance_observer_of_a_robot(tmp_path: Path, capsys, observer: None):
    """The same as of the PID that it amounts to, in every command that judges; gains by joint are read like others."""
    path, answers = write_arm(tmp_path), []
    for text in (ARM.replace(", inertia: 0.5", ", inertia: {shoulder: 0.5, elbow: 0.5}"), ARM.replace(OBSERVED, AS_PID)):
        path.write_text(text, "utf-8")
        robot = of_json(capsys, "robot", path, "--report", tmp_path / "page.html")
        swept, run = of_json(capsys, "sweep", path, "--samples", "6"), of_json(capsys, "simulate", path)
        for joint in robot["states"][0]["joints"]:
            joint.update(kp_max=None, kd_max=None)  # of gains that act by themselves alone
        answers.append((robot["states"], robot["worst"], robot["unmet"], swept["sentence"], run["sentence"]))
        assert CONTROLLERS[text.partition("type: ")[2][:3]].__name__ in (tmp_path / "page.html").read_text("utf-8")
    assert json.loads(json.dumps(answers[0])) == approximately(answers[1])


def approximately(value: Any) -> Any:
    """The same lists and mappings, with numbers that are equal but for round-off."""
    if isinstance(value, dict):
        return {key: approximately(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [approximately(each) for each in value]
    return pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (KNEE, "observer: 6", "observer: -6", "control.observer: -6 must be >= 0"),
        (
            KNEE,
            ", inertia: 0.5",
            "",
            "control.inertia is missing: the inertia that the disturbance observer assumes [kg·m²], a number >= 0",
        ),
        (KNEE, "type: dob", "type: pd", "control.observer is not a gain of type pd, which has kp, kd"),
        (KNEE, "type: dob", "type: dop", "'dop' must be pd, pid, ppi, torque_feedback, dob, lti or unplanned; did you mean dob?"),
        (
            ARM,
            ", observer: 6",
            "",
            "control.observer is missing: the bandwidth of the disturbance observer [rad/s], a number >= 0, or one per",
        ),
        (ARM, ", inertia: 0.5", ", inertia: {shoulder: 0.5}", "control.inertia: no value for joint elbow"),
        (ARM, "type: dob", "type: dob, space: task", "control.kp is for space joint"),
    ],
)
def test_gain_keys_come_from_the_controller(text: str, old: str, new: str, message: str, tmp_path: Path, capsys, observer: None):
    """In both files, with bounds, units and what is missing; nothing is said of it while nobody knows it."""
    path = write_arm(tmp_path, text.replace(old, new)) if text is ARM else tmp_path / "joint.yaml"
    path.write_text(text.replace(old, new), "utf-8")
    assert main(["robot" if text is ARM else "joint", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_a_gain_that_another_type_may_leave_out_is_asked_for(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    """Types share keys: kp may be 0 in one and not in another."""

    @dataclass(frozen=True)
    class Damper(gr.PD):
        GAINS = (replace(gr.PD.GAINS[0], positive=False), gr.PD.GAINS[1])

    monkeypatch.setitem(CONTROLLERS, "damper", Damper)
    path = tmp_path / "joint.yaml"
    for kind, status in (("pd", 2), ("damper", 0)):
        path.write_text(
            JOINT.replace("type: pd", f"type: {kind}").replace("kp: 900", "kp: 0").partition("limits")[0] + "limits: {}\n", "utf-8"
        )
        said = main(["joint", str(path)]), capsys.readouterr().err
        assert (said[0] == 2) is (status == 2)
        assert ("control.kp: 0 must be > 0" in said[1]) is (status == 2)


@pytest.mark.parametrize("text", [KNEE, ARM], ids=["joint", "robot"])
def test_a_controller_that_contradicts_itself_is_refused(text: str, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    """What it forgets to override would be judged, or recommended for, as another law; so would kd apart from what else kd is in."""

    class Unscaled(DisturbanceObserver):
        GAINS = tuple(replace(one, scales=True) for one in DisturbanceObserver.GAINS)  # the observer's bandwidth, too

    class Flat(DisturbanceObserver):
        plane = gr.PD.plane

    class Held(DisturbanceObserver):
        def from_plane(self, kp: float, kd: float) -> "Held":
            return replace(self, kp=kp, kd=kd)

    path = write_arm(tmp_path, text) if text is ARM else tmp_path / "joint.yaml"
    for kind, message in ((Unscaled, "Unscaled.scaled: must"), (Flat, "Flat.plane: must"), (Held, "Held.plane: must")):
        monkeypatch.setitem(CONTROLLERS, "dob", kind)
        path.write_text(text, "utf-8")
        assert main(["robot" if text is ARM else "joint", str(path)]) == 2
        assert message in capsys.readouterr().err
    monkeypatch.setitem(CONTROLLERS, "dob", DisturbanceObserver)
    path.write_text(text.replace("observer: 6", "kd_path: {delay_ms: 0.2, sample_rate_hz: 10000}, observer: 6"), "utf-8")
    assert main(["robot" if text is ARM else "joint", str(path)]) == 2
    assert "kd_path: is for controllers whose kd acts by itself" in capsys.readouterr().err


def test_a_controller_that_nobody_knows_is_no_traceback(tmp_path: Path, capsys):
    path = write_arm(tmp_path, ARM)
    assert main(["robot", str(path)]) == 2
    assert "unknown key" in capsys.readouterr().err


@pytest.mark.slow
def test_the_app_shows_a_controller(tmp_path: Path, observer: None):
    """With its own gains; recommended gains of another type are told, and not put into its own. Without a plane a robot's page says so."""
    pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")
    from gainroom.app.bench import Opened
    from gainroom.app.joint_bench import JointBench
    from gainroom.app.messages import View
    from gainroom.app.robot_bench import RobotBench

    write_arm(tmp_path)
    joint, robot = (make(Opened(text, "file.yaml", tmp_path)) for make, text in ((JointBench, KNEE), (RobotBench, ARM)))
    assert [gain["name"] for gain in joint.opening()["structures"][""]["gains"]] == ["kp", "kd", "observer", "inertia"]
    assert [gain["unit"] for gain in robot.opening()["gains"]["elbow"]] == ["N·m/rad", "N·m·s/rad", "rad/s", "kg·m²"]
    for bench, gains in ((joint, {"observer": 3.0}), (robot, {"elbow": {"observer": 3.0}})):
        parts = dict(bench.full(View.model_validate({"gains": gains}), None, lambda *_: None))
        assert parts["verdict"]["stable"]
    assert joint.system(View(gains={"observer": 3.0})).control.controller.observer == 3.0
    for bench in (joint, robot):
        assert bench.opening()["forms"] == {"yaml": "YAML"}  # no other format holds these gains
        assert "observer" in bench.copied(View(), "yaml")
        with pytest.raises(gr.GainroomError, match="not the gains of a controller of type dob; copy as yaml"):
            bench.copied(View(), "mjcf")
    other = dict(JointBench(Opened(KNEE.replace("dob", "unplanned"), "file.yaml", tmp_path)).full(View(), None, lambda *_: None))
    assert other["use"]["gains"] is None
    with pytest.raises(gr.GainroomError, match=r"control\.type: unplanned has no kp–kd plane"):
        RobotBench(Opened(ARM.replace("dob", "unplanned"), "file.yaml", tmp_path))


@pytest.mark.slow
def test_every_command_finds_the_same(tmp_path: Path, capsys, noise: NoiseTorque):
    """One level and one finding for a requirement that nobody knew: joint and simulate, robot, simulate, audit and sweep."""
    joint, limits = tmp_path / "joint.yaml", "limits: {gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2}\n"
    joint.write_text(with_limit(JOINT.replace("kp: 900", "sample_rate_hz: 2000, kp: 900"), 1.0), "utf-8")
    robot = write_arm(
        tmp_path, with_limit(ROBOT.partition("tasks")[0].replace("{bent: {shoulder: 0.4, elbow: 0.9}}", "{zero: {}}") + limits, 2.0)
    )
    calls = [("joint", joint), ("simulate", joint), ("robot", robot), ("simulate", robot), ("sweep", robot, "--samples", "4")]
    for words in (*calls, (*audited(tmp_path, "--require", "noise_torque_nm=2"),)):
        found = of_json(capsys, *words)
        assert found["verdict"] == "unsafe", words
        (one,) = (each for each in found["findings"] if each["code"] == "noise_torque")
        assert one["level"] == "unsafe"
        assert one["noise_torque_nm"] > one["required"]
    for most, level in ((1e9, "safe"), (1e-9, "unsafe")):
        joint.write_text(with_limit(JOINT.replace("kp: 900", "sample_rate_hz: 2000, kp: 900"), most), "utf-8")
        assert {of_json(capsys, command, joint)["verdict"] for command in ("joint", "simulate")} == {level}
