"""A joint's controller as difference equations: C that is compiled and run against the closed loop, tables against the response."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.files.joint_yaml import parse_joint
from test_sensor_laws import DOB, JOINT, TICK, TORQUE

PID = "type: pid, feedback: motor, kp: 1500, ki: 900, kd: 150, velocity_filter: {bandwidth: 900, order: 2}"
BOTH = "type: pd, feedback: {kp: link, kd: motor}, kp: 500, kd: 60, notches: [{frequency: 300}]"
LAW = (
    "type: lti, gain: 0.5, link: {zeros: [[0.9, 0.05], 0.3], poles: [1.0, [0.7, 0.2]], gain: 3000}, "
    "torque: {zeros: [], poles: [0.4], gain: -0.1}"
)
EVERY = [PID, BOTH, TORQUE, DOB, LAW]
PROGRAM = """
#include <stdio.h>
#include "law.h"
int main(void)
{{
    gainroom_state state = {{0}};
    double {arguments};
    while (scanf("{scans}", {addresses}) == {count}) printf("%.17g\\n", gainroom_law(&state, {arguments}));
    return 0;
}}
"""


def responses(control: str, omega: np.ndarray) -> dict[str, np.ndarray]:
    """What the controller of a joint.yaml makes of each quantity, by its transfer functions."""
    system: Any = parse_joint(JOINT.replace("CONTROL", control), "joint.yaml")
    law, feedback = system.control.controller, system.control.feedback
    if not feedback.mixed:
        return {feedback.position: law.transfer(TICK).at(1j * omega)}
    return {sensor: law.law(sensor, feedback, TICK).at(1j * omega) for sensor in feedback.sensors if law.law(sensor, feedback, TICK).gain}


@pytest.mark.parametrize("control", EVERY)
def test_tables_hold_the_law(control: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL", control))
    assert main(["export", str(path), "--to", "markdown", "--json"]) == 0
    text = json.loads(capsys.readouterr().out)["text"]
    omega = np.geomspace(5.0, 6000.0, 200)
    z = np.exp(1j * omega * TICK)
    found: dict[str, np.ndarray] = {}
    for part in text.split("\n## ")[1:]:
        value = np.ones(len(z), dtype=complex)
        for row in re.findall(r"^\| \d+ \| (.*) \|$", part, re.MULTILINE):
            b0, b1, b2, a1, a2 = map(float, row.split(" | "))
            value *= (b0 * z**2 + b1 * z + b2) / (z**2 + a1 * z + a2)
        found[part.partition(":")[0]] = value
    wanted = responses(control, omega)
    assert found.keys() == wanted.keys()
    for sensor, value in wanted.items():
        assert found[sensor] == pytest.approx(value, rel=1e-8)  # coefficients near z = 1: 1e-16 of what is 6e-6, |z − 1|²


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("control", EVERY)
def test_c_closes_the_loop_as_the_simulation(control: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The compiled law on random signals, against the transfer functions' own impulse responses."""
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL", control))
    assert main(["export", str(path), "--to", "c", "--output", str(tmp_path / "law.h"), "--write"]) == 0
    text = (tmp_path / "law.h").read_text()
    sensors = re.findall(r"^ \* (motor|link|torque): ", text, re.MULTILINE)
    (tmp_path / "law.c").write_text(
        PROGRAM.format(
            arguments=", ".join(sensors), scans="%lf " * len(sensors), addresses=", ".join(f"&{one}" for one in sensors), count=len(sensors)
        )
    )
    run = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "law.c", "-o", "law"]
    subprocess.run(run, cwd=tmp_path, check=True, timeout=60)
    given = np.random.default_rng(5).standard_normal((400, len(sensors))) * 1e-3
    lines = "\n".join(" ".join(map(repr, row)) for row in given.tolist())
    out = subprocess.run([str(tmp_path / "law")], input=lines, capture_output=True, text=True, check=True, timeout=60).stdout
    found = np.array(out.split(), dtype=float)
    radius, count = 1.02, 1 << 13  # the impulse response by an inverse transform on a circle that every pole is inside of
    z = radius * np.exp(2j * np.pi * np.arange(count) / count)
    system: Any = parse_joint(path.read_text(), "joint.yaml")
    law, feedback, wanted = system.control.controller, system.control.feedback, np.zeros(400)
    for k, sensor in enumerate(sensors):
        own = law.law(sensor, feedback, TICK) if feedback.mixed else law.transfer(TICK)
        impulse = np.fft.ifft(own.at(np.log(z) / TICK)).real * radius ** np.arange(count)
        wanted += np.convolve(given[:, k], impulse[:400])[:400]
    assert found == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (["--to", "mjcf"], "control.type: torque_feedback has other gains than this form holds; c and markdown hold any type"),
        (["--to", "c", "--onto", "robot.xml"], "--onto robot.xml: the controller of one joint is written as a whole; give --output"),
    ],
)
def test_other_forms_are_refused(call: list[str], problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL", TORQUE))
    assert main(["export", str(path), *call]) == 2
    error = capsys.readouterr().err
    assert problem in error
    assert error.count("\n") == 1


def test_a_controller_in_continuous_time_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL, sample_rate_hz: 2000", "type: pd, feedback: motor, kp: 1, kd: 1"))
    assert main(["export", str(path), "--to", "c"]) == 2
    assert "control.sample_rate_hz is missing: a controller is exported as difference equations at its rate" in capsys.readouterr().err


def test_damping_in_the_drive_is_a_part_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """kp at the host's rate, kd (1 − z⁻¹)/T at the drive's behind a low-pass by Tustin's rule, exact at its corner, by hand."""
    kp, kd, corner, fast = 1500.0, 150.0, 900.0, 5e-5
    control = f"type: pd, feedback: motor, kp: {kp}, kd: {kd}, velocity_filter: {{bandwidth: {corner}}}"
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL", f"{control}, kd_path: {{delay_ms: 0.1, sample_rate_hz: {1 / fast:.0f}}}"))
    assert main(["export", str(path), "--to", "markdown", "--json"]) == 0
    tables = re.findall(r"^\| 1 \| (.*) \|$", json.loads(capsys.readouterr().out)["text"], re.MULTILINE)
    host, drive = (list(map(float, one.split(" | "))) for one in tables)
    assert host == pytest.approx([kp, 0, 0, 0, 0])
    a = np.tan(corner * fast / 2)
    high = kd / fast * a / (1 + a)
    assert drive == pytest.approx([high, 0, -high, -(1 - a) / (1 + a), 0], rel=1e-12)
    assert main(["export", str(path), "--to", "c", "--json"]) == 0
    text = json.loads(capsys.readouterr().out)["text"]
    for name in ("gainroom_law(gainroom_state *state", "gainroom_drive_law(gainroom_drive_state *state"):
        assert text.count(name) == 1
    if compiler := shutil.which("cc"):
        (tmp_path / "law.h").write_text(text)
        (tmp_path / "both.c").write_text('#include "law.h"\nint main(void) { return 0; }\n')
        subprocess.run([compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-c", "both.c"], cwd=tmp_path, check=True)
