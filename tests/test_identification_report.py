"""Pages of identification: through the command line, from logs whose truth is known; what stands in the pictures is what the log holds."""

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.logs import read_joint
from gainroom.identification import identify_gains
from gainroom.identification.frequency_response import FrequencyResponse
from gainroom.identification.gains import predicted_torque
from gainroom.report.identification import frequency_response
from gainroom.simulation import Friction, Scenario, Testbed, simulate
from identified import multisine, soft_loop

TICK, COUNT = 1e-3, 8000
TIME = np.arange(COUNT) * TICK
JOINT, DRIVE = gr.ElasticJoint(0.2, 0.8, 1e4, 2.0), gr.Drive(2000.0, 0.9, 3 * TICK)


def logged(folder: Path, run, *names: str) -> Path:
    values = {name: getattr(run, "motor_reading" if name == "motor_position" else name)[:, 0] for name in names}
    table = np.column_stack([run.time, *values.values()])
    np.savetxt(folder / "run.csv", table, delimiter=",", header=",".join(["time", *values]), comments="", fmt="%.12g")
    return folder / "run.csv"


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A joint in closed loop under a multisine, with an encoder."""
    torque = 10 * multisine(np.random.default_rng(0), TIME, np.geomspace(6, 100, 60))
    bed = Testbed(soft_loop(JOINT, DRIVE, 1.0, 0.7, TICK), motor_resolution=1e-5)
    run = simulate(bed, Scenario(0.3 * np.sin(2 * TIME)[:, None], (COUNT - 1) * TICK, feedforward=torque[:, None], noise=1e-5))
    names = ("target_torque", "demand_torque", "actual_torque", "motor_position", "reference")
    return logged(tmp_path_factory.mktemp("moved"), run, *names)


def page_of(folder: Path, capsys: pytest.CaptureFixture[str], *call: str) -> tuple[str, list[dict], str]:
    """The page, its pictures, and the terminal's answer."""
    report = folder / "page.html"
    assert main(["identify", *call, "--report", str(report)]) == 0
    text = report.read_text("utf-8")
    pictures = [json.loads(found) for found in re.findall(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)]
    assert pictures
    body = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="https?:', body)  # self-contained
    assert "nan" not in re.sub(r"<[^>]*>", " ", body).lower().split()
    for picture in pictures:
        assert all(
            axis["title"]["text"] for name, axis in picture["layout"].items() if re.fullmatch(r"[xy]axis\d*", name) and "title" in axis
        )
        drawn = [trace.get("name") for trace in picture["data"] if trace.get("showlegend", picture["layout"]["showlegend"])]
        assert all(drawn)  # no legend says "trace 1"
    return text, pictures, capsys.readouterr().out


def traces(picture: dict) -> dict[str, dict]:
    return {trace["name"]: trace for trace in picture["data"] if trace.get("name")}


@pytest.mark.slow
def test_the_page_of_a_joint(moved, tmp_path, capsys):
    text, pictures, out = page_of(tmp_path, capsys, "joint", str(moved))
    assert out.splitlines()[0][:40] in text  # the headline is the terminal's
    response, residuals, torques = pictures[:3]
    found = traces(response)
    # By hand: the motor side of two masses at the frequencies drawn, without hold and delay, which do not change |H| below 40 Hz.
    omega, size = (np.array(found["fitted"][axis]) for axis in "xy")
    low = omega < 2 * math.pi * 40
    s = 1j * omega[low]
    spring = 2.0 * s + 1e4
    by_hand = np.abs(s**2 * (0.8 * s**2 + spring) / ((0.2 * s**2 + spring) * (0.8 * s**2 + spring) - spring**2))
    assert np.median(np.abs(size[low] / by_hand - 1)) < 0.03
    assert {"measured", "95 % band"} <= set(found)
    assert len(residuals["data"][1]["y"]) == 60
    shapes = [shape["x0"] for shape in torques["layout"]["shapes"] if shape["type"] == "line"]
    assert shapes[0] == 0.0
    assert shapes[1] == pytest.approx(3.0, abs=0.1)  # ms
    assert {"target", "demand", "actual"} == set(traces(torques))
    assert "gainroom identify joint" in text


@pytest.mark.slow
def test_the_page_of_a_delay_shows_the_log_s_own_rows(moved, tmp_path, capsys):
    _, pictures, _ = page_of(tmp_path, capsys, "delay", str(moved))
    shown = traces(pictures[0])
    record = read_joint(moved).record
    target = record.channels["target_torque"]
    row = int(np.flatnonzero(np.abs(target - shown["target"]["y"][0]) < 1e-4 * np.ptp(target))[0])
    for title in ("target", "demand", "actual"):
        values = np.array(shown[title]["y"])
        rows = [np.allclose(record.channels[f"{title}_torque"][k : k + len(values)], values, atol=1e-4 * np.ptp(target))
                for k in range(len(target) - len(values))]  # fmt: skip
        assert any(rows)
    assert row >= 0
    assert pictures[1]["data"][0]["type"] == "bar"
    assert sum(pictures[1]["data"][0]["y"]) == pytest.approx(100.0, abs=0.1)


def test_the_page_of_gains_finds_the_torque_again(tmp_path, capsys):
    """The law with the gains found makes the logged torque, to a thousandth; wrong units stand beside what was asked for."""
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(40.0, 9.0), sample_time=TICK)
    reference = 0.2 * multisine(np.random.default_rng(1), TIME, np.geomspace(0.3, 5, 12))
    run = simulate(Testbed(loop, motor_resolution=1e-6), Scenario(reference[:, None], (COUNT - 1) * TICK))
    log = logged(tmp_path, run, "target_torque", "motor_position", "reference")
    record = read_joint(log).record
    fit = identify_gains(record)
    _, measured, law = predicted_torque(fit, record)
    inner = slice(500, -500)
    assert np.std((measured - law)[inner]) < 1e-3 * np.std(measured[inner])
    text, pictures, _ = page_of(tmp_path, capsys, "gains", str(log), "--asked", f"kp={40 / 2 / math.pi:.6f},kd=9")
    assert "revolutions taken for radians" in text
    ratios = {trace["y"][0]: trace["x"][0] for trace in pictures[1]["data"]}
    assert ratios == {"kp": pytest.approx(2 * math.pi, rel=1e-3), "kd": pytest.approx(1.0, rel=1e-3)}


def test_the_page_of_a_locked_output_has_its_hysteresis(tmp_path, capsys):
    """Branches 2F apart, with the stiffness as their slope."""
    locked = gr.ElasticJoint(0.2, math.inf, 1e4, 2.0)
    bed = Testbed(gr.build_loop(locked, DRIVE, gr.PD(0.0, 0.0), sample_time=TICK), motor_friction=Friction(1.5), motor_resolution=2e-6)
    torque = 20 * np.sin(2 * np.pi * 0.5 * TIME)
    run = simulate(bed, Scenario(0.0, (COUNT - 1) * TICK, feedforward=torque[:, None]))
    _, pictures, _ = page_of(tmp_path, capsys, "stiffness", str(logged(tmp_path, run, "actual_torque", "motor_position")))
    lines = [trace for trace in pictures[0]["data"] if trace["mode"] == "lines"]
    (forward, back), middle = lines[:2], lines[2]
    assert forward["y"][0] - back["y"][0] == pytest.approx(3.0, rel=0.03)
    assert np.diff(middle["y"])[0] / np.diff(middle["x"])[0] == pytest.approx(10.0, rel=0.01)  # N·m per mrad


def test_a_page_does_not_take_the_log_s_place(moved, capsys):
    before = moved.read_bytes()
    assert main(["identify", "delay", str(moved), "--report", str(moved)]) == 2
    error = capsys.readouterr().err
    assert "overwrite the input" in error
    assert error.count("\n") == 1
    assert moved.read_bytes() == before


@pytest.mark.parametrize(("averages", "noise"), [(60, 0.4), (200, 0.2)])
def test_the_band_of_a_measured_response_holds_the_true_one_nineteen_times_of_twenty(averages: int, noise: float):
    """Random spectra, whose motion is H times the torque and noise: 95 of 100 bands hold |H|, of 500 within 3 %."""
    rng, lines, true = np.random.default_rng(averages), 500, 2.5
    omega = np.linspace(20.0, 60.0, lines)
    torque, other = (rng.normal(size=(2, averages, lines, 2)) @ [1, 1j]).reshape(2, averages, lines)
    motion = true * (torque + noise * other)
    cross, power, moved = (np.sum(values, axis=0) for values in (motion * torque.conj(), np.abs(torque) ** 2, np.abs(motion) ** 2))
    nothing, all_of_it = np.full(lines, 1e9), np.ones(lines)
    measured = FrequencyResponse(omega, cross / power, np.abs(cross) ** 2 / (power * moved), nothing, all_of_it, 0.0, averages)
    assert measured.excited.all()
    fit = SimpleNamespace(
        measured=measured, parameters={}, response=lambda omega: np.full(len(omega), true, dtype=complex), torque="torque"
    )
    (picture,) = re.findall(r'<script type="application/json">(.*?)</script>', str(frequency_response(fit)), re.DOTALL)  # type: ignore[arg-type]
    band = np.array(traces(json.loads(picture))["95 % band"]["y"])
    high, low = band[:lines], band[lines:][::-1]
    assert np.mean((low < true) & (true < high)) == pytest.approx(0.95, abs=0.03)
