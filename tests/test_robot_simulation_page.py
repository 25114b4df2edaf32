"""The page of a played robot: what it says of runs that track, vibrate, fall and run away, its numbers, and what a user typed."""

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from html import escape, unescape
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.robot_yaml import parse_robot
from gainroom.report.number_format import digits, hertz, milli
from gainroom.report.simulation import CLOSE_PERIODS, MOST_CHANNELS, simulation_page
from gainroom.report.simulation_text import SimulationPresentation, sentence, warnings
from gainroom.robot.tasks import Task
from gainroom.simulation.oscillation import Vibration, parts_in
from gainroom.simulation.robot_setup import channel_units
from gainroom.simulation.robot_simulation import RobotSimulation
from gainroom.studies.simulation import Outcome, simulate_study
from robot_files import ROBOT, write_arm
from robot_truths import hinge, link, write_robot
from test_report import figures, headline, without_library
from test_robot_report import BIPED, HOSTILE, cells

COMMAND = "gainroom simulate biped.yaml --report out.html"
SAMPLED = "control: {type: pd, space: task, feedback: motor, sample_rate_hz: 2000}\n"
TASKS = """\
tasks:
  - {name: com, type: com, kp: [50, 90, 200], kd: [1, 5, 15]}
  - {name: pelvis, type: orientation, frame: pelvis, kp: 100, kd: 20}
"""
STAND = BIPED + SAMPLED + TASKS
MOVE = "scenario: {duration: 0.8, move: {task: com, by: [0.01, 0.005, -0.01], duration: 0.4}, friction: {coulomb: 2.0}, ground: true}\n"
SHAKE = "scenario: {duration: 1.0, move: {task: com, by: [0.01, 0, 0], duration: 0.3}}\n"
CROUCH = STAND.replace("-0.3", "-0.6").replace('_knee": 0.6', '_knee": 1.2')
TOPPLE = CROUCH + "scenario: {duration: 2.0, move: {task: com, by: [0.2, 0, 0], duration: 0.8}, ground: true}\n"  # the soles end at 0.1 m
LIFTED = BIPED.replace("double: [left_sole, right_sole], left: [left_sole], flight: []", "flight: []")
JOINTS = "control: {type: pd, feedback: motor, sample_rate_hz: 2000, kp: 2000.0, kd: 100.0}\n"
ALL_JOINTS = "scenario: {duration: 0.6, move: {joint: '.*', by: 0.05, duration: 0.3}}\n"


def simulated(text: str, gain: float = 1.0) -> Outcome:
    return simulate_study(RobotSimulation.of(parse_robot(text, "biped.yaml")), gain)


@pytest.fixture(scope="module")
def sound() -> Outcome:
    return simulated(STAND + MOVE)


@pytest.fixture(scope="module")
def sound_page(sound: Outcome) -> str:
    return simulation_page(SimulationPresentation(sound), COMMAND)


@pytest.fixture(scope="module")
def limit() -> gr.GainLimit:
    """Of the same robot, by the front door."""
    spec = parse_robot(STAND + SHAKE, "biped.yaml")
    return gr.gain_limit(spec.loop(spec.source.linearize("stand", "double")))


@pytest.fixture(scope="module")
def shaken(limit: gr.GainLimit) -> Outcome:
    return simulated(STAND + SHAKE, 1.04 * limit.gain)


@pytest.fixture(scope="module")
def fallen() -> Outcome:
    return simulated(TOPPLE)


def glance(page: str) -> tuple[str, str, list[str]]:
    """How the page looks, its banner, and the labels of its cards."""
    own = without_library(page)
    banner = re.search(r'class="banner"[^>]*>(.*?)</p>', own)
    found = re.search(r'<body class="(\w+)">', own)
    assert found is not None
    return found.group(1), "" if banner is None else banner.group(1), re.findall(r'<p class="label">(.*?)</p>', own)


def drawn(figure: dict, name: str) -> dict[str, np.ndarray]:
    """The curves of this name, by axis."""
    return {
        one.get("yaxis", "y"): np.array([one["x"], one["y"]], dtype=float)
        for one in figure["data"]
        if unescape(one.get("name", "")) == name
    }


@pytest.mark.slow
def test_a_sound_run_at_first_glance(sound: Outcome, sound_page: str):
    state, banner, labels = glance(sound_page)
    asked = sound.run.reference[-1] - sound.run.reference[0]  # 2 % of it is what settling means
    late = [
        name
        for name, error, move in zip(sound.run.channels, sound.tracking.steady_state, asked, strict=True)
        if abs(error) > 0.02 * abs(move) > 0
    ]
    assert late
    assert sound.margins is not None
    assert (state, banner) == ("bare", "")
    assert all(name in sentence(sound).partition(" not settle within 2 %")[0] for name in late)
    assert sound.margins.least_phase_margin < math.radians(30)
    assert sound.margins.peak_sensitivity > 2
    # Ms is missed most: by more of ln 2 than the phase margin of its 30°
    assert math.log(sound.margins.peak_sensitivity / 2) > 1 - math.degrees(sound.margins.least_phase_margin) / 30
    assert labels == ["peak sensitivity Ms", "phase margin", "vibration", "gain margin", "settles", "largest error", "feet moved by"]
    assert sound.margins.common_phase_margin < sound.margins.one_loop_phase_margin
    assert re.match(
        r"Not safe: stable, but 2 requirements fail in \S+/\S+: Ms of one loop \S+ \(≤ 2\) at"
        r" \w+, \S+ Hz; phase margin of all loops \S+ \(≥ 30°\) at \w+, \S+ Hz\. No vibration, but ",
        sentence(sound),
    )
    assert headline(sound_page) == sentence(sound)
    assert without_library(sound_page).count("✗ not met") == 2  # the headline counts what the cards count


def test_the_page_carries_answer_then_reason_in_order(sound: Outcome, sound_page: str):
    own = unescape(without_library(sound_page))
    wanted = (
        sentence(sound).partition(". ")[0],
        "Over time: the channels together",
        "Initial and final posture",
        "Channel by channel",
        "Joints",
        "Inputs and assumptions",
        COMMAND,
    )
    start = own.index("<body")
    for part in wanted:
        start = own.index(part, start)
    assert "The last" not in own
    assert own.count("<figure>") == own.count("<figcaption>") + own.count("</tbody></table></div></figure>")


def test_the_page_is_self_contained_and_small(sound_page: str):
    assert len(sound_page.encode()) < 2e6
    own = without_library(sound_page)
    assert not re.findall(r"<(?:link|img|iframe|object|embed|audio|video|source)\b", own)
    assert not re.findall(r"<[a-z][^>]*\s(?:src|href)\s*=", own)
    for outside in ("@import", "url(", "https://", "http://"):
        assert outside not in own


def test_numbers_in_the_tables_are_the_runs(sound: Outcome, sound_page: str):
    """By definition, from the rows; the table's first column names the channel, then unit and way."""
    run, table = sound.run, cells(sound_page, "channel")
    error = run.reference - run.measured
    assert list(table) == list(run.channels)
    for k, row in enumerate(table.values()):
        rms, peak, last = math.sqrt(np.mean(error[:, k] ** 2)), np.abs(error[:, k]).max(), error[-160:, k].mean()  # a tenth of 0.8 s
        assert row[0] == ("mm" if k < 3 else "mrad")
        assert row[2:5] == [milli(value, 1e-7) for value in (rms, peak, last)]
    assert [row[1] for row in table.values()] == ["10", "5", "10", "0", "0", "0"]
    torques = cells(sound_page, "joint")
    peaks = np.abs(run.actual_torque).max(axis=0)
    assert [row[0] for row in torques.values()] == [digits(value, "", 3) if value > 1e-3 else "0" for value in peaks]


def test_what_fails_comes_first(sound: Outcome, sound_page: str):
    """By hand from the rows: of the channels that miss the band of 2 % at the end the one that misses it most, with that band around 0."""
    run = sound.run
    move = np.abs(run.reference[-1] - (run.reference[0] - run.error[0]))
    left = np.abs(run.error[-len(run.time) // 10 :].mean(axis=0))
    worst = max((k for k in range(3) if np.isinf(sound.tracking.settling_time[k])), key=lambda k: left[k] / move[k])
    name = run.channels[worst]
    body = unescape(without_library(sound_page))
    assert body.index("Do this") < body.index('class="cards"') < body.index(f"Over time: {name}, ") < body.index("<details")
    hero = figures(sound_page)[0]
    assert np.abs(drawn(hero, "error")["y2"][1]).max() == pytest.approx(1e3 * np.abs(run.error[:, worst]).max(), rel=1e-5)
    (band,) = hero["layout"]["shapes"]
    assert (band["yref"], band["y0"], band["y1"]) == ("y2", pytest.approx(-20 * move[worst]), pytest.approx(20 * move[worst]))
    (advised,) = re.findall(r"This run leaves an error in (.*?)\. If the new gains do, too,", body)
    assert name in advised
    left_over = [run.channels[k] for k in range(3) if left[k] > 0.02 * move[k] and np.isinf(sound.tracking.settling_time[k])]
    assert re.split(", | and ", advised) == left_over


def test_every_curve_over_time_has_its_unit_in_hover_and_axis(sound_page: str):
    every = [(one, figure["layout"]) for figure in figures(sound_page) for one in figure["data"]]
    curves = [(one, layout) for one, layout in every if "s: %{y" in one.get("hovertemplate", "")]
    assert len(curves) > 20
    for one, layout in curves:
        title = layout["yaxis" + one["yaxis"][1:]]["title"]["text"]
        assert re.search(r"\[(.*)\]", title)[1] == re.search(r"%\{y:.4g\} (.*)<extra>", one["hovertemplate"])[1]  # type: ignore[index]
        assert layout["xaxis"]["title"]["text"] == "time [s]"


def test_the_second_picture_shows_all_three_directions_with_their_errors(sound: Outcome, sound_page: str):
    """Millimetres from where the run began, the error under them; 500 points or more of 1600 keep the envelope."""
    hero = figures(sound_page)[1]
    for k, name in enumerate(("com x", "com y", "com z")):
        curves = drawn(hero, name)
        moved = 1e3 * (sound.run.measured[:, k] - sound.run.measured[0, k])
        assert set(curves) == {"y", "y2"}
        assert curves["y"][1].max() == pytest.approx(moved.max(), abs=1e-4)  # six digits are drawn
        assert np.abs(curves["y2"][1]).max() == pytest.approx(1e3 * np.abs(sound.run.error[:, k]).max(), rel=1e-5)
    hardest = sound.run.joint_names[int(np.argmax(sound.torque_peak))]
    assert np.abs(drawn(hero, hardest)["y3"][1]).max() == pytest.approx(sound.torque_peak.max(), rel=1e-5)


def test_links_are_shown_where_they_are(sound: Outcome, sound_page: str):
    """Of the drawn channel pelvis y, from the links' own postures."""
    pictures = [figure for figure in figures(sound_page) if drawn(figure, "links")]
    assert len(pictures) == 1 + MOST_CHANNELS  # what fails has one more
    true = 1e3 * (sound.run.actual[:, 4] - sound.run.actual[0, 4])
    (curve,) = drawn(pictures[5], "links").values()
    assert np.interp(sound.run.time, *curve) == pytest.approx(true, abs=0.02 * np.ptp(true))  # straight between 500 points


def test_slip_is_how_far_a_foot_went(sound: Outcome, fallen: Outcome):
    """A standing foot gives way by less than a tenth of a millimetre; one of a robot that topples about its toes, by centimetres."""
    assert sound.slip.shape == (2,)
    assert sound.slip.max() < 1e-4
    assert fallen.slip.max() > 0.01


@pytest.mark.slow
def test_a_vibrating_run(shaken: Outcome, limit: gr.GainLimit):
    """4 % above the limit it vibrates within 2 % of the frequency there, in the shape that is predicted there."""
    page = simulation_page(SimulationPresentation(shaken), COMMAND)
    state, banner, labels = glance(page)
    assert (state, "VIBRATES" in banner) == ("bad", True)
    assert "vibration" in labels
    assert shaken.vibrates
    assert shaken.vibration is not None
    assert shaken.vibration.frequency == pytest.approx(limit.frequency, rel=0.02)
    assert hertz(shaken.vibration.frequency) in page
    assert f"The last {CLOSE_PERIODS} periods" in page
    assert shaken.oscillation is not None
    # 4 % of gain turn the shape a little; both are scaled to a largest of 1.
    assert np.abs(shaken.oscillation.parts) == pytest.approx(np.abs(limit.mode), abs=0.05)
    assert [row[-1] for row in cells(page, "joint").values()][3] == digits(abs(shaken.oscillation.parts[3]), "", 2)


def test_the_prediction_is_the_linear_loops(sound: Outcome, shaken: Outcome, limit: gr.GainLimit):
    assert sound.limit is not None
    assert shaken.limit is not None
    assert sound.limit.gain == pytest.approx(limit.gain, rel=1e-9)
    assert shaken.limit.gain == pytest.approx(1 / 1.04, rel=1e-9)  # a factor on the gains played
    assert (sound.limit.stable, shaken.limit.stable) == (True, False)


def test_a_fallen_run(fallen: Outcome):
    page = simulation_page(SimulationPresentation(fallen), COMMAND)
    state, banner, labels = glance(page)
    assert (state, banner) == ("bad", "FELL: do not run this on the robot")
    assert labels[0] == "falls after"
    assert fallen.run.ending == "fell"
    assert sentence(fallen).startswith("Not safe: the robot fell after ")
    assert any("the move, the feet or friction end the run" in warning for warning in warnings(fallen))  # the loop is stable
    assert all(row[4:] == ["–", "–", "–"] for row in cells(page, "channel").values())  # nothing has settled
    assert "<b>FELL</b>" in json.dumps(figures(page))


@pytest.mark.slow
def test_a_run_that_diverges(limit: gr.GainLimit):
    """Half above the limit: at the frequency of the linear loop's rightmost root, which grows e-fold in a hundredth of a second."""
    gain = 1.5 * limit.gain
    play = simulated(STAND + SHAKE, gain)
    root = gr.rightmost_roots(play.spec.loop(gain)).roots[0]
    page = simulation_page(SimulationPresentation(play), COMMAND)
    state, banner, labels = glance(page)
    assert (state, "DIVERGES" in banner) == ("bad", True)
    assert labels[0] == "diverges after"
    assert play.run.ending == "diverged"
    assert play.vibration is not None
    assert play.vibration.frequency == pytest.approx(abs(root.imag), rel=0.02)
    assert play.vibration.growth_rate == pytest.approx(root.real, rel=0.05)
    assert f"vibrating at {play.vibration.frequency / (2 * math.pi):.3g} Hz" in sentence(play)
    assert "NaN" not in json.dumps(figures(page))


@pytest.mark.slow
def test_many_joints_are_no_heap():
    """The three that are furthest off together, six by themselves, and words on the rest; a robot in free fall stays in its picture."""
    play = simulated(LIFTED + JOINTS + ALL_JOINTS)
    page = simulation_page(SimulationPresentation(play), COMMAND)
    hero = figures(page)[0]
    worst = {play.run.channels[k] for k in np.argsort(-play.tracking.peak)[:3]}
    assert {one["name"] for one in hero["data"] if one.get("yaxis") == "y2"} == worst
    assert sum(bool(drawn(figure, "links")) for figure in figures(page)) == MOST_CHANNELS
    assert "Not drawn: " in page
    assert "3 of 12 channels" in page
    assert "feet moved by" not in page
    pose = figures(page)[1]
    heights = [value for one in pose["data"] for value in one["y"] if value is not None]
    assert np.ptp(heights) < 1.5  # of 1 m of robot that has fallen 1.8 m
    assert "In free fall" in page


@pytest.mark.slow
def test_a_torque_limit_keeps_a_vibration_at_its_size(limit: gr.GainLimit):
    """It neither grows nor dies away, and is one all the same; the page says what limits it."""
    limited = SHAKE.replace("scenario: {", "scenario: {torque_limit: {default: 150, '.*_yaw': .inf}, resolution: 1.0e-6, ")
    play = simulated(STAND + limited.replace("duration: 1.0", "duration: 1.5"), 1.3 * limit.gain)
    assert play.completed
    assert play.vibrates
    assert play.vibration is not None
    assert abs(play.vibration.damping_ratio) < 1e-3
    assert "sustained" in sentence(play)
    assert np.abs(play.run.demand_torque).max() == pytest.approx(150.0)
    own = unescape(simulation_page(SimulationPresentation(play), COMMAND))
    assert "150 N·m, 10 of 12 joints" in own
    assert digits(1e-3, "mrad", 3) in own


@pytest.mark.slow
def test_the_page_tells_the_ground(sound: Outcome, sound_page: str):
    text = (STAND + MOVE).replace(
        "ground: true", "ground: {friction: 0.6, soles: {left_sole: {length: 0.3, width: 0.12, center: [0.02, 0]}}}"
    )
    own = unescape(simulation_page(SimulationPresentation(simulated(text)), COMMAND))
    assert "they may slip and lift: friction 0.6, soles left_sole 0.3 m × 0.12 m about (0.02, 0) m, right_sole 0.2 m × 0.1 m" in own
    assert "friction 0.8, soles left_sole 0.2 m × 0.1 m" in unescape(sound_page)


@pytest.mark.slow
def test_a_robot_that_holds_still_is_listened_to_from_the_start(limit: gr.GainLimit):
    """Nothing moves, so there is nothing to wait for: neither a warning of a late move, nor a vibration that goes unheard."""
    still = STAND + "scenario: {duration: 0.5, move: {task: com, by: 0}}\n"
    quiet, shaken = simulated(still), simulated(still, 1.1 * limit.gain)
    assert not any("comes to rest late" in warning for warning in warnings(quiet))
    assert quiet.sound
    assert not shaken.sound


@pytest.mark.slow
def test_what_nothing_can_move_is_not_said_to_track():
    """The centre of mass in free fall: no motor moves it, which the warning says."""
    play = simulated(LIFTED + SAMPLED + TASKS + "scenario: {duration: 0.3, move: {task: com, by: [0.01, 0, 0], duration: 0.1}}\n")
    assert play.spec.immovable == ("com x",)
    assert re.search(r"No vibration( in this run)?\. Largest tracking error ", sentence(play))
    assert any("com x cannot move" in warning for warning in warnings(play))
    assert play.tracking.steady_state[0] == pytest.approx(0.01, rel=1e-6)


def test_a_run_too_short_to_tell_says_so():
    play = simulated(STAND + "scenario: {duration: 0.01, move: {task: com, by: 0.01}}\n")
    assert len(play.run.time) == 20
    assert any("lengthen scenario.duration" in warning for warning in warnings(play))
    assert "does not settle within 2 % of the move in this run" in sentence(play) or "do not settle" in sentence(play)


def test_hostile_names_are_escaped(tmp_path: Path):
    """A joint's, a task's and a contact state's."""
    names = json.dumps(HOSTILE)
    text = ROBOT.replace("name: com", f"name: {names}").replace(
        "sample_rate_hz: 2000, kp: 400.0, kd: 30.0", "sample_rate_hz: 2000, space: task"
    )
    links = (
        link("root") + link("upper", 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01)) + link("lower", 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01))
    )
    write_robot(tmp_path, links, hinge(escape(HOSTILE), "root", "upper") + hinge("elbow", "upper", "lower", at=(0.0, 0.0, -0.4)))
    text = text.replace("shoulder: 0.4, ", "") + "scenario: {duration: 0.2, move: {task: " + names + ", by: 0.01, duration: 0.1}}\n"
    play = simulate_study(RobotSimulation.of(parse_robot(text, "robot.yaml", tmp_path)))
    page = simulation_page(SimulationPresentation(play), f"gainroom simulate '{HOSTILE}'")
    own = without_library(page)
    assert "<img" not in own
    assert "alert(1)</script" not in own
    assert "\n" not in sentence(play)
    for trace in (trace for figure in figures(page) for trace in figure["data"]):
        assert "<" not in str(trace.get("name", ""))
        assert "<" not in str(trace.get("text", ""))


def test_parts_of_a_known_vibration():
    """Amplitudes and phases of a growing swing beside a drift, by closed form."""
    frequency, growth, tick = 300.0, 5.0, 5e-4
    t = tick * np.arange(400)
    wanted = np.array([1.0, 0.4 * np.exp(0.7j), -0.2])
    swing = np.exp((growth + 1j * frequency) * (t - t[-1]))
    signal = 0.3 + 2.0 * t[:, None] + (swing[:, None] * wanted).real
    found = parts_in(signal, tick, Vibration(frequency, growth, 1.0))
    assert found == pytest.approx(wanted, abs=1e-9)  # exact but for rounding


def test_each_channel_has_its_unit():
    spec = parse_robot(STAND + SHAKE, "biped.yaml")
    stack = (
        *spec.source.stack,
        Task(name="foot", kind="position", frame="left_sole", kp=1.0, kd=1.0),
        Task(name="rest", kind="posture", kp=1.0, kd=1.0),
    )
    setup = replace(RobotSimulation.of(spec).setup, stack=stack)
    units = channel_units(setup)
    assert units == ("m",) * 3 + ("rad",) * 3 + ("m",) * 3 + ("rad",) * 12


def test_a_slide_counts_in_metres(tmp_path: Path):
    text = ROBOT.replace("{shoulder: 0.4, elbow: 0.9}", "{}") + "scenario: {duration: 0.3, move: {joint: rail, by: 0.02, duration: 0.1}}\n"
    links = (
        link("root") + link("upper", 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01)) + link("lower", 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01))
    )
    write_robot(tmp_path, links, hinge("rail", "root", "upper", kind="prismatic") + hinge("elbow", "upper", "lower", at=(0.0, 0.0, -0.4)))
    play = simulate_study(RobotSimulation.of(parse_robot(text, "robot.yaml", tmp_path)))
    assert play.run.units == ("m", "rad")
    assert play.leading == (0,)
    assert "Prismatic joints: N and mm" in simulation_page(SimulationPresentation(play), COMMAND)


def test_falling_is_reported_and_is_exit_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path, page = tmp_path / "biped.yaml", tmp_path / "fall.html"
    path.write_text(TOPPLE, "utf-8")
    assert main(["simulate", str(path), "--json", "--report", str(page)]) == 1
    facts = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert (facts["fell"], facts["diverged"], facts["vibrates"]) == (True, False, False)
    assert 0.2 < facts["ended_at"] < 1.9
    assert facts["tracking"]["com x"]["steady_state"] is None
    assert facts["predicted"]["stable"] is True
    assert facts["slip"]["left_sole"] > 0.01
    assert "FELL" in page.read_text("utf-8")


def test_report_and_log_together_with_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path, page, log = write_arm(tmp_path), tmp_path / "run.html", tmp_path / "run.csv"
    assert main(["simulate", str(path), "--gain", "1.25", "--report", str(page), "--log", str(log)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert f"Report: {page}\n" in out  # however long, like commands to type
    assert max(len(line) for line in out.splitlines() if not line.startswith(("Report: ", "Log: ", "  gainroom "))) <= 100
    assert log.exists()
    assert f"gainroom simulate {path} --gain 1.25 --report {page}" in unescape(page.read_text("utf-8"))


def test_the_report_takes_the_place_of_neither_input_nor_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path, log = write_arm(tmp_path), tmp_path / "run.csv"
    before = path.read_text("utf-8")
    assert main(["simulate", str(path), "--report", str(path)]) == 2
    assert main(["simulate", str(path), "--report", str(log), "--log", str(log)]) == 2
    assert capsys.readouterr().err.count("\n") == 2
    assert path.read_text("utf-8") == before
    assert not log.exists()


@pytest.mark.slow
def test_an_interrupted_run_leaves_its_log_and_no_page(tmp_path: Path):
    """Stopped once it is known to be writing, far from its end."""
    path, page, log = write_arm(tmp_path, ROBOT + "scenario: {duration: 90.0}\n"), tmp_path / "run.html", tmp_path / "run.csv"
    command = [sys.executable, "-m", "gainroom", "simulate", str(path), "--log", str(log), "--report", str(page)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        while process.poll() is None and not any(part.stat().st_size > 5_000 for part in tmp_path.glob(".gainroom-*")):
            time.sleep(0.02)  # however long that takes
        process.send_signal(signal.SIGTERM)  # heard in the background, too
        _, err = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGTERM
    assert err.startswith("gainroom: interrupted at ")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["robot.urdf", "robot.yaml", "run.csv"]
