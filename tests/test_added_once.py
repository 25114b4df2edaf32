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
from gainroom.analysis.part_requirements import unread
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.system.requirement import Requirement
from gainroom.system.requirements import REQUIREMENTS
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


def own_noise(kp: float, kd: float, inertia: float = 1.0) -> float:
    """The same of JOINT with these gains, from L out of the equations of motion; POINTS are close enough for both to be the same sum."""
    omega = (np.arange(POINTS) + 0.5) / POINTS * NOISE.band
    ratio = response(PDJoint(inertia, 4.0, 1e4, 1.0, kp, kd, delay=2e-3, bandwidth=4000.0), omega)
    return COUNT * math.sqrt(np.mean(np.abs((kp + 1j * omega * kd) / (1 + ratio)) ** 2))


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
    assert "1 requirement fails" in found["sentence"]
    assert "rms noise torque" in screen
    assert "rms noise torque" in page.read_text("utf-8")
    use = found["recommended"]
    kept = own_noise(use["kp"], use["kd"])
    assert use["margins"]["noise_torque_nm"] == pytest.approx(kept, rel=1e-9)
    assert 0.98 * most < kept <= most * (1 + 1e-9)
    assert use["binding"] == "noise_torque"


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
