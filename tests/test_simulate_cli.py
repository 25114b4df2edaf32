"""gainroom simulate: keys, exit status, numbers that can be told in advance, logs that can be read however a run ends."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from html import unescape
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings

import gainroom as gr
from gainroom.cli import main
from gainroom.cli.example import joint_examples
from gainroom.cli.interrupts import stop_signals
from gainroom.errors import GainroomError, beside
from gainroom.files.joint_yaml import parse_simulation
from gainroom.files.logs import read_log
from gainroom.report.curves import thinned
from gainroom.report.simulation import in_time, simulation_page
from gainroom.report.simulation_text import SimulationPresentation, sentence
from gainroom.simulation import vibration
from gainroom.studies.simulation import Interrupted, simulate_study
from mutations import RANDOMS, mutated_data
from test_report import figures, headline

EXAMPLES = joint_examples()
LINEAR, HARDWARE = EXAMPLES["testbed-sampled"], EXAMPLES["testbed-simulated"]
SHAKEN = LINEAR.replace("kd: 70.0", "kd: 80.0")
KP = 1600.0
KEYS = {"diverged", "tracking", "vibration", "log"}  # fixed names: scripts outside the project read them
LONG = HARDWARE.replace("duration: 4.0,", "duration: 900.0,").replace("duration: 4.0 ", "duration: 900.0 ")


def write(folder: Path, text: str) -> Path:
    path = folder / "joint.yaml"
    path.write_text(text, "utf-8")
    return path


def simulated(text: str, gain: float = 1.0):
    return simulate_study(parse_simulation(text, "joint.yaml"), gain)


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, dict]:
    status = main(["simulate", *map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    assert err == ""
    return status, json.loads(out, parse_constant=pytest.fail)


def test_json_of_a_run_that_tracks(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    status, facts = run_json(capsys, write(tmp_path, LINEAR))
    assert status == 1  # tracks, with 0.9 dB of gain margin
    assert set(facts) >= KEYS
    assert facts["diverged"] is False
    assert facts["vibration"] is None
    assert facts["log"] is None
    assert set(facts["tracking"]) == {"joint"}
    assert set(facts["tracking"]["joint"]) >= {"rms", "peak", "steady_state"}


def test_vibration_is_that_of_the_rightmost_root(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Fig. 11's 1600:80 on the linear loop: without noise the matrix pencil is exact to far below 1e-4."""
    status, facts = run_json(capsys, write(tmp_path, SHAKEN))
    root = gr.rightmost_roots(parse_simulation(SHAKEN, "").loop()).roots[0]
    assert status == 1
    assert not facts["diverged"]
    assert facts["vibration"]["frequency_rad_s"] == pytest.approx(abs(root.imag), rel=1e-4)
    assert facts["vibration"]["growth_rate"] == pytest.approx(root.real, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["csv", "parquet", "mcap"])
def test_the_log_of_a_run_that_diverges_holds_numbers_only(tmp_path: Path, capsys: pytest.CaptureFixture[str], ending: str):
    log = tmp_path / f"run.{ending}"
    status, facts = run_json(capsys, write(tmp_path, LINEAR), "--gain", "1.5", "--log", log)
    assert status == 1
    assert facts["diverged"] is True
    assert facts["log"] == str(log)
    kept = read_log(log)  # which refuses what is not finite
    assert kept.complete
    assert kept.time[-1] + 5e-4 == pytest.approx(facts["diverged_at"])
    assert np.abs(kept.signals["motor_position"]).max() > 100


def test_tracking_is_what_the_log_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The default move, 3τ² − 2τ³ by 0.1 rad in 0.5 s, against the logged positions; CSV has every digit."""
    log = tmp_path / "run.csv"
    _, facts = run_json(capsys, write(tmp_path, LINEAR), "--log", log)
    kept = read_log(log)
    part = np.minimum(kept.time / 0.5, 1.0)
    error = 0.1 * (3 * part**2 - 2 * part**3) - kept.signals["motor_position"][:, 0]
    found = facts["tracking"]["joint"]
    assert found["rms"] == pytest.approx(math.sqrt(np.mean(error**2)), rel=1e-9)
    assert found["peak"] == pytest.approx(np.abs(error).max(), rel=1e-9)
    link = kept.signals["link_position"][:, 0]
    rest = link[-round(0.1 * len(link)) :].mean()  # of the link, where it comes to rest
    assert link.max() > rest
    assert found["overshoot"] == pytest.approx(link.max() / rest - 1, rel=1e-9)
    assert (facts["error_of"], facts["overshoot_of"]) == ("motor", "link")
    assert facts["torque_peak"]["joint"] == np.abs(kept.signals["actual_torque"]).max()


def test_a_lasting_torque_bends_a_pd_by_its_share_of_kp(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """At rest kp e balances the torque on the link; two seconds are twenty time constants of the slowest root."""
    text = LINEAR + "scenario: {duration: 3.0, reference: {type: hold}, disturbance: {torque: 8.0, start: 0.5}}\n"
    status, facts = run_json(capsys, write(tmp_path, text))
    assert status == 1  # tracks, with 0.9 dB of gain margin
    assert facts["tracking"]["joint"]["steady_state"] == pytest.approx(-8.0 / KP, rel=1e-6)


def test_gravity_bends_it_by_its_torque():
    """Level, a quarter turn from where it hangs. The link sags under 1 %: cos of 0.014 rad is 1 within 1e-4."""
    text = LINEAR + f"scenario: {{duration: 3.0, reference: {{type: hold}}, gravity: 20.0, hanging_at: {-math.pi / 2}}}\n"
    study = simulated(text)
    assert study.sound
    assert study.tracking.steady_state[0] == pytest.approx(20.0 / KP, rel=1e-3)


def test_hardware_vibrates_where_the_linear_loop_does_and_keeps_it_up():
    """Friction does not hide it once the joint moves; the torque limit ends its growth. Its frequency stays within 3 %."""
    assert simulated(HARDWARE).sound
    shaken = simulated(HARDWARE, 1.15)
    assert shaken.vibrates
    assert not shaken.run.diverged
    assert shaken.vibration is not None
    assert shaken.vibration.frequency == pytest.approx(shaken.limit.frequency, rel=0.03)
    assert shaken.limit.gain < 1


@pytest.mark.parametrize(("gain", "sound"), [(1.05, True), (1.15, False)])
@pytest.mark.parametrize(
    "reference",
    [
        "{type: multisine, amplitude: 0.01, frequencies: [3.0, 9.0, 20.0]}",
        "{type: chirp, amplitude: 0.05, first: 1.0, last: 60.0, duration: 2.0}",
        "{type: step, by: 0.01}",
        "{type: quintic, by: 0.3, duration: 2.0}",
    ],
)
def test_what_the_reference_does_is_not_called_a_vibration(reference: str, gain: float, sound: bool):
    """The limit is at 1.11."""
    assert simulated(LINEAR + f"scenario: {{reference: {reference}}}\n", gain).sound is sound


def test_oscillations_above_a_frequency():
    t = 1e-3 * np.arange(3000)
    signal = np.sin(20 * t) + 0.1 * np.sin(150 * t)
    found = vibration(signal, 1e-3, above=30.0)
    assert found is not None
    assert found.frequency == pytest.approx(150, rel=1e-6)
    assert vibration(signal, 1e-3, above=200.0) is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("scenario: {duration: 0}", "scenario.duration: 0 must be > 0"),
        ("scenario: {duration: 3600}", "at most 2000000"),
        ("scenario: {reference: {type: ramp}}", "scenario.reference.type: 'ramp' must be hold, step"),
        ("scenario: {reference: {type: cubic, by: 1}}", "scenario.reference.duration is missing"),
        (
            "scenario: {reference: {type: chirp, amplitude: 1, first: 1, last: 7000, duration: 1}}",
            "scenario.reference.last: 7000 rad/s must be below half the sample rate",
        ),
        (
            "scenario: {reference: {type: chirp, amplitude: 1, first_hz: 1, last_hz: 1200, duration: 1}}",
            "scenario.reference.last_hz: 1200 Hz must",
        ),
        ("scenario: {reference: {type: chirp, amplitude: 1, last: 7, duration: 1}}", "give either first [rad/s] or first_hz"),
        (
            "scenario: {reference: {type: multisine, amplitude: 1, frequencies: [1], frequencies_hz: [1]}}",
            "give either frequencies [rad/s] or",
        ),
        ("scenario: {disturbance: {torque: 1, start: 2}}", "scenario.disturbance.start: 2 s must be before the run ends"),
        ("scenario: {reference: {type: step, by: 1, start: 2.5}}", "scenario.reference.start: 2.5 s must be before the run ends"),
        ("scenario: {referense: {}}", "did you mean reference?"),
        ("scenario: {jitter_ms: 3}", "scenario.jitter_ms: 3 must be <= the drive's delay, 2.174 ms"),
        ("scenario: {friction: {motor: {coulomb: 2, static: 1}}}", "scenario.friction.motor: static 1"),
        ("scenario: {whole_ticks: 1}", "scenario.whole_ticks: 1 must be true or false"),
        ("scenario: {seed: 1.5}", "scenario.seed: 1.5 must be a whole number"),
        ("scenario: {noise: 2 mrad}", "scenario.noise: '2 mrad' is text"),
    ],
)
def test_a_wrong_scenario_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, says: str):
    path = write(tmp_path, LINEAR + change)
    assert main(["simulate", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
    assert str(path) in err


@pytest.mark.parametrize("command", ["simulate", "verify"])
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (EXAMPLES["testbed"], "control.sample_rate_hz is missing"),
        (EXAMPLES["testbed"].replace("delay_ms: 2.674", "delay_ticks: 5"), "control.sample_rate_hz is missing"),
        ("model: {file: a.urdf}\n", "drive is missing"),
        ("", "is empty"),
    ],
)
def test_what_cannot_be_simulated(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, text: str, says: str):
    path = write(tmp_path, text)
    assert main([command, str(path)]) == 2
    err = capsys.readouterr().err
    assert all(line.startswith(f"gainroom: error: {path}: ") for line in err.splitlines())
    assert says in err
    assert str(path) in err


@pytest.mark.parametrize("options", [["--gain", "0"], ["--gain", "nan"], ["--gain", "-1"], ["--log", "run.txt"], ["--log", "no/run.csv"]])
def test_a_wrong_call_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]):
    assert main(["simulate", str(write(tmp_path, LINEAR)), *options]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_neither_log_nor_report_takes_the_place_of_an_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "joint.csv"
    path.write_text(LINEAR, "utf-8")
    assert main(["simulate", str(path), "--log", str(path)]) == 2
    assert main(["simulate", str(path), "--report", str(path)]) == 2
    assert path.read_text("utf-8") == LINEAR
    assert capsys.readouterr().err.count("\n") == 2


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(random=RANDOMS)
def test_a_damaged_file_is_refused_in_one_line_or_read(random: Random):
    damaged = mutated_data(random, yaml.safe_load(HARDWARE))
    problems = ()
    try:
        parse_simulation(yaml.safe_dump(damaged), "joint.yaml")
    except GainroomError as error:
        problems = error.problems
    assert not any("\n" in message for message in problems)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "number"), [("csv", signal.SIGINT), ("parquet", signal.SIGINT), ("mcap", signal.SIGINT), ("csv", signal.SIGTERM)]
)
def test_an_interrupted_run_leaves_a_log_that_can_be_read(tmp_path: Path, ending: str, number: signal.Signals):
    """Stopped once it is known to be writing, far from its end; the report that was asked for is not begun."""
    log, page = tmp_path / f"run.{ending}", tmp_path / "run.html"
    command = [sys.executable, "-m", "gainroom", "simulate", str(write(tmp_path, LONG)), "--log", str(log), "--report", str(page)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, preexec_fn=heard)
    try:
        while process.poll() is None and not any(path.stat().st_size > 20_000 for path in files(tmp_path)):
            time.sleep(0.02)  # however long that takes
        process.send_signal(number)
        out, err = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 128 + number
    assert out == ""
    assert err.startswith("gainroom: interrupted at ")
    assert str(log) in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["joint.yaml", log.name]
    kept = read_log(log)
    assert kept.complete
    assert 0 < kept.time[-1] < 890
    assert np.diff(kept.time) == pytest.approx(5e-4)


def heard() -> None:
    """In a new process: no signal is ignored, though the tests may run in the background, where a shell has Ctrl-C ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def files(folder: Path) -> list[Path]:
    """Logs and their temporary files, also while one takes the other's name."""
    return [path for path in folder.iterdir() if path.exists() and path.suffix != ".yaml"]


@pytest.fixture
def set_interrupt() -> Iterator[Callable[[Any], None]]:
    """Sets what SIGINT does; the tests themselves may run in the background, where a shell has it ignored."""
    before = signal.getsignal(signal.SIGINT)
    yield lambda handler: signal.signal(signal.SIGINT, handler)
    signal.signal(signal.SIGINT, before)


def test_the_first_signal_is_noted_and_handlers_come_back(set_interrupt: Callable[[Any], None]):
    set_interrupt(signal.default_int_handler)
    with stop_signals() as stopped:
        assert stopped() == 0
        os.kill(os.getpid(), signal.SIGINT)
        assert stopped() == signal.SIGINT
        with pytest.raises(KeyboardInterrupt):  # the second one acts as ever
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_is_ignored_stays_ignored(set_interrupt: Callable[[Any], None]):
    set_interrupt(signal.SIG_IGN)
    with stop_signals() as stopped:
        os.kill(os.getpid(), signal.SIGINT)
        assert stopped() == 0
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_an_interruption_says_how_far_it_came():
    rows = []
    with pytest.raises(Interrupted) as caught:
        simulate_study(parse_simulation(LINEAR, ""), rows=rows.append, interrupted=lambda: True)
    assert len(rows) == 1
    assert caught.value.time == pytest.approx(rows[0].time[-1] + 5e-4)


@pytest.mark.parametrize(
    ("gain", "state", "says"),
    [
        (0.25, "good", "These gains may stay"),
        (0.5, "bare", "Not safe: stable, but 2 requirements fail: Ms "),
        (1.0, "bare", "Not safe: stable, but 3 requirements fail: Ms "),
        (1.5, "bad", "DIVERGES"),
        (30.0, "bad", "DIVERGES"),
        (1.14, "bad", "VIBRATES"),
    ],
    ids=["sound", "too little phase margin", "too little gain margin", "diverges", "diverges at once", "vibrates"],
)
def test_the_page_says_it_at_first_glance(gain: float, state: str, says: str):
    study = simulated(LINEAR + "scenario: {duration: 1.0}\n", gain)
    page = simulation_page(SimulationPresentation(study), "gainroom simulate joint.yaml")
    assert f'<body class="{state}">' in page
    assert says in page
    assert headline(page) == sentence(study)
    assert page.index("Do this") < page.index('class="cards"') < page.index('class="plot"') < page.index("<details")
    proposed = re.findall(r"--gain (\S+)</pre>", page)
    if state == "good":
        assert proposed == []
    else:  # the loop scaled by it has all margins that the file asks for
        found = gr.margins(parse_simulation(LINEAR, "").loop(float(proposed[0])))
        assert found.stable
        assert found.gain_margin >= 10 ** (6 / 20)
        assert found.phase_margin >= math.radians(30)
        assert found.peak_sensitivity <= 2
    # Factors are all on the file's gains, as --gain is: the limit is that of the file's loop, whatever the run's own factor.
    limit = gr.margins(parse_simulation(LINEAR, "").loop(1.0)).gain_margin
    whose = "these gains" if gain == 1 else f"the file's gains (this run: {gain:g} ×)"
    assert f"vibrates from {beside(limit, gain)} × {whose}, at " in sentence(study)
    if proposed:
        assert f"repeat this run with {proposed[0]} × {whose.partition(' (')[0]}:" in unescape(page)
        assert float(proposed[0]) < min(gain, limit)
    assert ("The last 12 periods: " in page) == (not study.sound)
    assert len(page) < 6e6


@pytest.mark.parametrize(
    "reference", ["{type: step, by: 0.05}", "{type: step, by: 0.05, start: 0.2, base: 0.3}", "{type: cubic, by: 0.05, duration: 0.2}"]
)
def test_what_is_drawn_as_commanded_is_the_position_and_the_error(reference: str):
    """Curves of few enough ticks to be drawn whole: commanded − actual = error at each, also of a step in the first."""
    study = simulated(LINEAR + f"scenario: {{duration: 0.5, reference: {reference}}}\n", 0.5)
    (picture,) = figures(simulation_page(SimulationPresentation(study), ""))
    curves = {(one["name"], one["yaxis"]): np.array(one["y"]) for one in picture["data"]}
    for side in ("motor", "link"):
        assert len(curves[side, "y"]) == len(study.run.time)
        error = curves["commanded", "y"] - curves[side, "y"]
        assert error == pytest.approx(curves[side, "y2"], abs=2e-3)  # [mrad], of six digits each


def test_the_inputs_of_a_scenario_have_units():
    text = "scenario: {duration: 0.5, reference: {type: step, by: 0.05}, gravity: 5, torque_limit: 80, friction: {motor: {coulomb: 2}}}\n"
    page = simulation_page(SimulationPresentation(simulated(LINEAR + text)), "")
    for words in ("<dd>0.5 s</dd>", "type step, by 0.05 rad", "<dd>5 N·m</dd>", "<dd>80 N·m</dd>", "coulomb 2 N·m"):
        assert words in page


def test_a_thinned_curve_keeps_its_ends_and_its_envelope():
    values = np.sin(0.9 * np.arange(50_000)) * np.linspace(0, 1, 50_000)
    values[31_234] = 5.0  # a single tick
    keep = thinned(values, 1000)
    assert len(keep) <= 1002
    assert {0, 31_234, 49_999} <= set(keep.tolist())
    for part in np.array_split(np.arange(50_000), 100):
        assert np.ptp(values[np.intersect1d(keep, part)]) >= 0.95 * np.ptp(values[part])


def test_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    page, log = tmp_path / "run.html", tmp_path / "run.csv"
    assert main(["simulate", str(write(tmp_path, LINEAR)), "--report", str(page), "--log", str(log)]) == 1
    out, err = capsys.readouterr()
    assert err == ""
    told = out.replace("\n", " ")
    assert told.startswith("Not safe: stable, but 3 requirements fail: Ms ")  # missed most: 14.4 instead of 2
    assert ", gain margin 0.916 dB (≥ 6 dB) at 78.4 Hz. No vibration in this run. " in told
    (command,) = [line for line in out.splitlines() if " --gain " in line]  # to be copied, and so on one line, as paths are
    assert command.startswith(f"  gainroom simulate {tmp_path}")
    assert max(len(line) for line in out.splitlines() if line != command) <= max(100, len(f"Report: {page}"))
    assert f"Log: {log}\n" in out
    assert page.exists()


LEFT = """\
joint: {{motor_inertia: 0.2, link_inertia: 0.8, stiffness: 1.0e4, damping: 1.0}}
drive: {{bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}}
control: {{type: pd, kp: {kp}, kd: 20.0, feedback: motor, sample_rate_hz: 2000}}
scenario: {{duration: 2.0, reference: {{type: quintic, by: 0.1, duration: 0.5}}{hardware}}}
"""
STICKS, WEIGHS = "friction: {motor: {coulomb: 4.0}}", "gravity: 11.0"


@pytest.mark.parametrize(
    ("kp", "hardware", "told"),
    [
        (400, STICKS, "Motion has stopped; friction may explain the remaining error."),
        (400, WEIGHS, "Motion has stopped; gravity may explain the remaining error."),
        (400, f"{WEIGHS}, {STICKS}", "Motion has stopped; friction or gravity may explain the remaining error."),
        (400, "disturbance: {torque: 5.0, start: 0.2}", "Motion has stopped with an error."),
        (10, "disturbance: {torque: 1.0, start: 0.2}", "An error remains, and the motion has not stopped."),
        (800, "", ""),
    ],
)
def test_an_error_that_is_left_is_told_with_what_may_explain_it(kp: int, hardware: str, told: str):
    """kd/kp = 2 s is on its way 1.8 s after a push; 4 N·m of friction, 11 of weight, 5 of load over 400 N·m/rad are over 2 mrad."""
    outcome = simulate_study(parse_simulation(LEFT.format(kp=kp, hardware=f", {hardware}" if hardware else ""), "x"))
    caption = in_time(outcome)
    assert ("Motion has stopped" in caption, "An error remains" in caption) == (told.startswith("M"), told.startswith("A"))
    assert told in caption
