"""A played robot is sound only if the linear loop is stable, too: what friction hides, what shows only in the move, what a fall ends."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system, parse_robot
from gainroom.report.simulation import simulation_page
from gainroom.report.simulation_text import SimulationPresentation, sentence, warnings
from gainroom.simulation.robot_simulation import RobotSimulation
from gainroom.studies.oscillation import torque_ripple_of
from gainroom.studies.simulation import Outcome, simulate_study
from robot_files import ROBOT, SOLO, write_arm, written

pytest.importorskip("mujoco")

STILL = ROBOT + "scenario: {duration: 0.4, move: {joint: elbow, by: 0.0}, friction: {coulomb: 5.0}}\n"
MOVING = ROBOT + "scenario: {duration: 1.5, move: {joint: '.*', by: 0.5, duration: 0.5}, friction: {coulomb: 6.0}}\n"


def limit_of(folder: Path, text: str) -> float:
    """By the front door."""
    spec = load_robot_system(write_arm(folder, text))
    return gr.gain_limit(spec.loop(spec.source.linearize(None, None))).gain


def simulated(folder: Path, text: str, gain: float) -> Outcome:
    return simulate_study(RobotSimulation.of(load_robot_system(write_arm(folder, text))), gain)


def root_of(play: Outcome) -> complex:
    """The rightmost of the linear loop that is played, with the scenario's viscous friction."""
    assert isinstance(play.spec, RobotSimulation)
    spec = play.spec.system
    robot = replace(spec.source, actuators=play.spec.setup.actuators)
    model = robot.linearize(spec.scenario.posture, spec.scenario.contact)
    return complex(gr.rightmost_roots(spec.loop(model).scaled(play.gain)).roots[0])


def test_friction_that_hides_an_unstable_loop_is_not_sound(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Stuck in the friction of its motors it moves not at all, at 1.07 times the limit."""
    gain = 1.07 * limit_of(tmp_path, STILL)
    path, page = write_arm(tmp_path, STILL), tmp_path / "page.html"
    assert main(["simulate", str(path), "--gain", f"{gain:.9g}", "--json", "--report", str(page)]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert (facts["diverged"], facts["fell"], facts["vibrates"], facts["predicted"]["stable"]) == (False, False, False, False)
    assert facts["unstable"] is True
    assert facts["sentence"].startswith(
        "Not safe: unstable, these gains are 1.07 × the limit. This run shows no sustained vibration: friction may hide it, or the run is "
        "too short. "
    )
    assert "UNSTABLE: do not run these gains" in page.read_text("utf-8")
    assert '<body class="bad">' in page.read_text("utf-8")
    stable = simulated(tmp_path, STILL, 0.9 * gain / 1.07)
    assert stable.sound
    assert sentence(stable).startswith("Not safe: stable, but 3 requirements fail in ")  # 0.9 of the limit is not 6 dB below it
    assert "No vibration in this run. " in sentence(stable)


def test_only_what_the_file_has_is_said_to_hide_it(tmp_path: Path):
    gain = 1.07 * limit_of(tmp_path, STILL)
    for friction, words in (
        ("duration: 0.03, move: {joint: elbow, by: 0.0}}", "the run is too short, or excites it too little"),
        (
            "duration: 0.4, torque_limit: 900.0, resolution: 1.0e-6, move: {joint: elbow, by: 0.0}, friction: {coulomb: 5.0}}",
            "friction or encoder steps may hide it",  # the torque limit is never reached
        ),
    ):
        play = simulated(tmp_path, ROBOT + "scenario: {" + friction + "\n", gain)
        assert not play.sound
        assert words in sentence(play)


def test_a_vibration_in_the_move_counts(tmp_path: Path):
    """While it moves Coulomb friction is a constant and the loop linear: it vibrates there as the rightmost root says; then it sticks."""
    play = simulated(tmp_path, MOVING, 1.04 * limit_of(tmp_path, MOVING))
    assert play.completed
    assert play.oscillation is not None
    assert play.oscillation.moving
    assert play.vibrates
    assert not play.sound
    assert play.oscillation.vibration.frequency == pytest.approx(root_of(play).imag, rel=0.03)
    after = play.run.motor_position[round(1.2 / play.run.sample_time) :]
    assert np.ptp(after, axis=0).max() < 1e-5  # it has decayed after the move
    assert "while it moves" in sentence(play)
    assert "VIBRATES" in simulation_page(SimulationPresentation(play), "gainroom simulate robot.yaml")


@pytest.mark.parametrize("share", [0.4, 0.8])
def test_below_the_limit_a_move_under_friction_is_no_vibration(tmp_path: Path, share: float):
    play = simulated(tmp_path, MOVING, share * limit_of(tmp_path, MOVING))
    assert play.sound


@pytest.mark.slow
def test_a_vibration_before_a_fall_is_reported(tmp_path: Path):
    """Two feet cannot carry it; until it has fallen it vibrates as the linear loop says."""
    text = SOLO.replace("contacts: {all: [", "contacts: {diag: [").replace(
        "{frame: FR_FOOT, type: point}, {frame: HL_FOOT, type: point}, ", ""
    )
    text = text.replace("duration: 1.0,", "duration: 2.0, move: {joint: '.*_HFE', by: 0.1, duration: 0.5},")
    play = simulate_study(RobotSimulation.of(load_robot_system(written(tmp_path, text))))
    assert play.run.ending == "fell"
    assert play.vibration is not None
    assert play.vibration.frequency == pytest.approx(root_of(play).imag, rel=0.05)  # of the posture it began in: it has tilted since
    assert "vibrating at 16" in sentence(play)
    assert any("it vibrates before it falls" in warning for warning in warnings(play))
    slow = simulate_study(RobotSimulation.of(load_robot_system(written(tmp_path, text))), 0.5)
    assert slow.run.ending == "fell"
    assert slow.vibration is None


def test_each_error_is_its_own_channels(tmp_path: Path):
    """The elbow lags most in its move; the shoulder, with much friction, is left furthest off."""
    text = ROBOT + "scenario: {duration: 1.5, move: {joint: '.*', by: [0.02, 0.9], duration: 0.4}, friction: {coulomb: {shoulder: 5.0}}}\n"
    play = simulate_study(RobotSimulation.of(parse_robot(text, "robot.yaml", write_arm(tmp_path).parent)))
    assert play.leading[0] == int(np.argmax(play.tracking.peak)) == 1
    left = np.abs(play.tracking.steady_state)
    assert play.worst_at_end == int(np.argmax(left)) == 0
    assert f"steady-state error {1e3 * left[0]:.3g} mrad (shoulder)" in sentence(play)
    page = simulation_page(SimulationPresentation(play), "gainroom simulate robot.yaml")
    assert f"elbow; steady-state error {1e3 * left[0]:.3g} mrad, shoulder" in page


def test_torque_ripple_is_reported(tmp_path: Path):
    """Coarse encoders times kd: kicks at every tick, far above the move's frequencies. Of a known sine it is the RMS, by closed form."""
    text = ROBOT + "scenario: {duration: 1.0, move: {joint: elbow, by: 0.1, duration: 0.5}, resolution: 1.0e-3}\n"
    play = simulated(tmp_path, text, 1.0)
    assert play.rippling is not None
    assert any("the torque ripple of" in warning and "finer encoders" in warning for warning in warnings(play))
    smooth = simulated(tmp_path, text.replace(", resolution: 1.0e-3", ""), 1.0)
    assert smooth.rippling is None
    time = smooth.run.time
    slow, fast = 9.0 * np.sin(4 * np.pi * time), 2.0 * np.sin(600.0 * time)  # 4 pi/0.5 s and its fivefold lie between them
    made = replace(smooth.run, actual_torque=np.column_stack([slow + fast, slow]))
    assert torque_ripple_of(made, 0.5) == pytest.approx([2.0 / np.sqrt(2), 0.0], abs=1e-3)  # what the taper lets through of the slow one
