"""What simulate calls a vibration, against roots, closed forms and sine fits; and that no run with unstable gains is called good."""

import math
import re
from dataclasses import dataclass

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.joint_yaml import parse_simulation
from gainroom.report.simulation import shown_ticks, simulation_page
from gainroom.report.simulation_text import SimulationPresentation, overshoots, sentence, warnings
from gainroom.simulation.tracking import track
from gainroom.studies.simulation import Outcome, simulate_study

JOINT = """
joint: {motor_inertia: 0.15, link_inertia: 0.6, stiffness: 6000, damping: 2.0}
drive: {bandwidth: 3000.0, delay_ticks: 2}
control: {type: pd, kp: 400, kd: 12, feedback: motor, sample_rate_hz: 1000}
"""
COULOMB = "friction: {motor: {coulomb: 1}}"
HIDDEN = "duration: 3, torque_limit: 50, friction: {motor: {coulomb: 5}}, reference: {type: hold}"  # nothing moves it loose
NOISY = "duration: 3, noise: 3.0e-4, torque_limit: 30"
COARSE = "duration: 3, motor_resolution: 1.0e-3, torque_limit: 30"


def text(scenario: str, joint: str = JOINT) -> str:
    return f"{joint}scenario: {{{scenario}}}\n"


def simulated(scenario: str, gain: float = 1.0, joint: str = JOINT) -> Outcome:
    return simulate_study(parse_simulation(text(scenario, joint), "joint.yaml"), gain)


def roots_of(gain: float) -> np.ndarray:
    """Of the closed loop, rightmost first [1/s]."""
    return gr.rightmost_roots(parse_simulation(text("duration: 1"), "").loop(gain)).roots


LATE = [
    *(f"duration: 3, reference: {{type: hold}}, disturbance: {{torque: 8, start: {start}}}" for start in (1.5, 2.8, 2.9, 2.95)),
    f"duration: 3, reference: {{type: hold}}, disturbance: {{torque: 8, start: 2.9}}, {COULOMB}",
    f"duration: 3, reference: {{type: step, by: 0.1, start: 2.7}}, {COULOMB}",
    f"duration: 3, reference: {{type: cubic, by: 0.1, duration: 0.3, start: 2.6}}, {COULOMB}",
    "duration: 3, reference: {type: chirp, amplitude: 0.1, first: 1, last: 9, duration: 3}, disturbance: {torque: 8, start: 2.9}, "
    + COULOMB,
]


@pytest.mark.parametrize("scenario", LATE)
def test_what_follows_a_late_event_is_no_vibration(scenario: str):
    """Every root of the loop dies away, and friction takes energy away."""
    assert roots_of(1.0)[0].real < -1
    study = simulated(scenario)
    assert study.sound, sentence(study)
    assert "No vibration" in sentence(study)


SHORT = [
    (0.3, "reference: {type: quintic, by: 0.1, duration: 0.3}, motor_resolution: 4.8e-6"),
    (1.0, "reference: {type: hold}, disturbance: {torque: 0.4, start: 0.26}, friction: {motor: {coulomb: 0.17}}"),
    (1.0, "reference: {type: step, by: 0.003, start: 0.19}, disturbance: {torque: 4.5, start: 0.14}, friction: {link: {coulomb: 0.4}}"),
    (2.0, "reference: {type: multisine, amplitude: 0.08, frequencies_hz: [0.5, 2, 7]}, friction: {motor: {coulomb: 7.2}}"),
    (
        3.3,
        "reference: {type: quintic, by: 0.1, duration: 0.3}, disturbance: {torque: 6.4, start: 0.27}, friction: {motor: {coulomb: 0.17}}",
    ),
]


@pytest.mark.parametrize(("gain", "scenario"), SHORT)
def test_what_a_short_record_catches_on_its_way_to_rest_is_no_vibration(gain: float, scenario: str):
    """0.3 s are a few periods; the loop is stable and friction takes energy away, so whatever swings then comes to rest."""
    assert roots_of(gain)[0].real < -1
    study = simulated(f"duration: 0.3, {scenario}", gain)
    assert study.sound, sentence(study)


@pytest.mark.parametrize("scenario", [*LATE[:4], "duration: 3, reference: {type: step, by: 0.1, start: 2.7}"])
def test_a_vibration_that_a_late_event_sets_off_is_that_of_the_rightmost_root(scenario: str):
    """3 % beyond the limit; the pencil on an exact run is right to far below 1e-3."""
    root = roots_of(4.3)[0]
    assert root.real > 0
    study = simulated(scenario, 4.3)
    assert study.vibrates
    assert not study.sound
    assert study.vibration is not None
    assert study.vibration.frequency == pytest.approx(abs(root.imag), rel=1e-3)
    assert study.vibration.growth_rate == pytest.approx(root.real, rel=1e-3)


@pytest.mark.parametrize("gain", [1.0, 4.0, 4.15, 4.17, 4.3])
@pytest.mark.parametrize("scenario", ["duration: 0.05", "duration: 3", "duration: 1, noise: 1.0e-3", LATE[2]])
def test_a_linear_run_never_contradicts_the_roots(scenario: str, gain: float):
    """The limit is at 4.157."""
    study, stable = simulated(scenario, gain), roots_of(gain)[0].real < 0
    assert study.limit.stable == stable
    assert study.sound == stable
    assert not (study.vibrates and stable)


def test_a_short_run_says_that_it_is_too_short():
    study = simulated("duration: 0.02", 4.3)
    assert study.hidden
    assert "Not safe: unstable, these gains are 1.03 × the limit. This run shows no sustained vibration: the run is too short" in sentence(
        study
    )


@pytest.mark.parametrize("scenario", [NOISY, COARSE])
@pytest.mark.parametrize("gain", [1.0, 3.0, 4.3, 5.0, 6.0, 8.0])
def test_noise_and_coarse_encoders_do_not_switch_the_verdict_off(scenario: str, gain: float):
    study = simulated(scenario, gain)
    assert study.sound == (roots_of(gain)[0].real < 0), sentence(study)
    assert "friction" not in sentence(study) + "".join(warnings(study))


def test_shaking_without_a_tone_is_told_by_the_true_positions():
    """1.9 times the limit, at the torque limit more than half of the time: the link swings by 4.5 mrad, the encoders' noise is 0.3."""
    study = simulated(NOISY, 8.0)
    run = study.run
    swing = run.motor_position[-1000:, 0].std()
    assert study.vibrates
    assert study.vibration is not None
    assert study.vibration.amplitude == pytest.approx(math.sqrt(2) * swing, rel=0.1)  # noise: a thousand ticks, some 40 periods
    assert study.at_torque_limit == np.mean(np.abs(run.demand_torque) > 30 - 1e-9)
    assert study.at_torque_limit > 0.5
    assert any("the torque limit cuts" in warning for warning in warnings(study))


def test_what_is_hidden_is_called_unstable_everywhere(tmp_path, capsys: pytest.CaptureFixture[str]):
    study = simulated(HIDDEN, 6.0)
    assert not study.vibrates
    assert study.hidden
    assert not study.sound
    assert "friction may hide it" in sentence(study)
    assert "noise" not in sentence(study)
    assert "torque limit may" not in sentence(study)  # it is never reached
    page = simulation_page(SimulationPresentation(study), "gainroom simulate joint.yaml")
    assert '<body class="bad">' in page
    assert "UNSTABLE: do not run these gains" in page
    assert "stable only below" in page
    path = tmp_path / "joint.yaml"
    path.write_text(text(HIDDEN), "utf-8")
    assert main(["simulate", str(path), "--gain", "6"]) == 1
    assert "Not safe: unstable, these gains are 1.44 × the limit." in " ".join(capsys.readouterr().out.split())


def test_a_link_that_rings_behind_a_motor_that_sticks():
    """Held, the motor leaves J_L q̈ + B q̇ + K q = 0: rate −B/2J_L at √(K/J_L − (B/2J_L)²). The torque stays below the friction."""
    joint = JOINT.replace("damping: 2.0", "damping: 0.05")
    study = simulated("duration: 3, reference: {type: step, by: 0.05}, friction: {motor: {coulomb: 10}}", 1.0, joint)
    run = study.run
    assert np.ptp(run.motor_position[-500:]) == 0
    assert study.vibrates
    assert not study.sound
    assert study.oscillation is not None
    assert study.oscillation.strongest == ("the link side",)
    rate = 0.05 / (2 * 0.6)
    assert study.vibration is not None
    assert study.vibration.growth_rate == pytest.approx(-rate, rel=1e-3)  # the first tenths of a second, before it sticks, are other
    assert study.vibration.frequency == pytest.approx(math.sqrt(6000 / 0.6 - rate**2), rel=1e-5)
    swing = np.ptp(run.link_position[-126:]) / 2  # two periods, in which it falls by half a percent
    assert study.vibration.amplitude == pytest.approx(swing, rel=0.01)
    assert "halving every 16.6 s" in sentence(study)
    assert "friction sustains this vibration" in warnings(study)[0]


@pytest.mark.parametrize("extra", ["", ", coulomb: 1"])
@pytest.mark.parametrize("side", ["motor", "link"])
def test_viscous_friction_counts_as_the_joints_own(side: str, extra: str):
    """The same joint with the friction in its joint section has the same limit, and runs alike where nothing else rubs."""
    scenario = f"duration: 1, friction: {{{side}: {{viscous: 10{extra}}}}}"
    other = JOINT.replace("damping: 2.0", f"damping: 2.0, {side}_viscous: 10")
    study, same = simulated(scenario, 4.4), simulated("duration: 1", 4.4, other)
    assert study.limit.gain == same.limit.gain
    assert study.limit.gain != simulated("duration: 1", 4.4).limit.gain
    assert study.spec.is_linear == (extra == "")
    if not extra:
        assert np.array_equal(study.run.motor_position, same.run.motor_position)


def test_a_limit_cycle_is_as_large_as_a_sine_fits():
    """Least squares over the last 150 ticks, 9 periods, beside a parabola, at the best of frequencies within 1 %."""
    study = simulated("duration: 3, friction: {motor: {coulomb: 5}}, torque_limit: 50", 6.0)
    assert study.oscillation is not None
    assert study.oscillation.sustained
    assert study.vibration is not None
    time, error = study.run.time[-150:], study.run.error[-150:, 0]
    fits = []
    for omega in np.linspace(0.99, 1.01, 41) * study.vibration.frequency:
        basis = np.column_stack([np.cos(omega * time), np.sin(omega * time), np.vander(time - time[-1], 3)])
        weights, left, *_ = np.linalg.lstsq(basis, error, rcond=None)
        fits.append((float(left[0]), float(np.hypot(*weights[:2]))))
    assert study.vibration.amplitude == pytest.approx(min(fits)[1], rel=0.01)


def test_a_later_disturbance_is_not_the_moves_overshoot():
    calm, pushed = simulated("duration: 3").tracking, simulated("duration: 3, disturbance: {torque: 30, start: 1.5}").tracking
    # Of the link beyond its rest, the mean over the last tenth of what is judged: half a run is less at rest than all of it
    assert pushed.overshoot[0] == pytest.approx(calm.overshoot[0], abs=1e-4)
    assert calm.overshoot[0] < 0.1
    assert pushed.settling_time[0] == pytest.approx(calm.settling_time[0], abs=5e-3)
    assert calm.settling_time[0] < 1.0
    assert pushed.steady_state[0] == pytest.approx(-30 / 400, rel=1e-3)  # of the whole run, at rest against kp
    soon = simulated("duration: 3, disturbance: {torque: 30, start: 0.51}").tracking
    assert math.isnan(soon.settling_time[0])  # cut short


@dataclass(frozen=True)
class Rows:
    time: np.ndarray
    reference: np.ndarray
    error: np.ndarray


def tracked(reference: np.ndarray, position: np.ndarray) -> Rows:
    return Rows(0.01 * np.arange(len(reference)), reference[:, None], (reference - position)[:, None])


def test_settling_counts_from_where_the_reference_sets_out():
    """Perfect tracking: a jump has arrived at once; 3τ² − 2τ³ is within 2 % of its goal from τ = 0.917 on, 100 ticks after it begins."""
    time = 0.01 * np.arange(400)
    step, tau = np.where(time >= 1 - 1e-9, 1.0, 0.0), np.clip(time - 1, 0, 1)
    assert track(tracked(step, step)).settling_time[0] == 0
    cubic = 3 * tau**2 - 2 * tau**3
    arrived = next(k for k in range(400) if 1 - cubic[k] <= 0.02)
    assert track(tracked(cubic, cubic)).settling_time[0] == pytest.approx(time[arrived] - 1, abs=1e-9)


def test_inside_by_chance_is_not_settled():
    """Within the band for less than the last tenth of the run."""
    reference, position = np.ones(400), np.ones(400)
    position[0], position[365] = 0.0, 1.05
    assert math.isinf(track(tracked(reference, position)).settling_time[0])
    position[365], position[300] = 1.0, 1.05
    assert track(tracked(reference, position)).settling_time[0] == pytest.approx(3.01)


def test_a_reference_that_swings_to_the_end_has_no_steady_state():
    for reference in (
        "{type: multisine, amplitude: 0.01, frequencies: [3.0, 9.0]}",
        "{type: chirp, amplitude: 0.1, first: 1, last: 9, duration: 2}",
    ):
        study = simulated(f"duration: 2, reference: {reference}")
        assert np.isnan(study.tracking.steady_state).all()
        assert "last tenth" not in sentence(study)
        assert "steady-state" not in simulation_page(SimulationPresentation(study), "")
    rests = simulated("duration: 4, reference: {type: chirp, amplitude: 0.1, first: 1, last: 9, duration: 2}")
    assert abs(rests.tracking.steady_state[0]) < 1e-6  # 1.6 s after it stops the slowest root, 7/s, has left 1e-5 of some 10 mrad


def test_the_picture_of_a_step_that_diverges_is_not_empty():
    """The reference is constant from t = 0 on; the picture reaches to where the joint is three times the step away."""
    study = simulated("duration: 1, reference: {type: step, by: 0.1}", 40.0)
    run = study.run
    assert run.diverged
    shown = shown_ticks(run.reference, run.error)
    assert np.abs(run.error[: shown - 1]).max() <= 0.3 < abs(run.error[shown - 1, 0])
    assert shown > 4  # growing this fast it is out of the picture within 6 ms


def test_a_limit_just_above_the_gains_is_told_apart_from_them(tmp_path, capsys: pytest.CaptureFixture[str]):
    """4.157 / 4.155 = 1.0005: not "from 4.16 × (this run: 4.16 ×)"."""
    path = tmp_path / "joint.yaml"
    path.write_text(text("duration: 0.5"), "utf-8")
    main(["simulate", str(path), "--gain", "4.155", "--verbose"])
    out = " ".join(capsys.readouterr().out.split())
    factor = simulated("duration: 0.5", 4.155).limit.gain
    assert 1 < factor < 1.001
    told = re.search(r"vibrates from (\S+) × the file's gains \(this run: (\S+) ×\)", out)
    assert told is not None
    assert float(told[1]) > float(told[2]) == 4.155
    assert float(re.search(r"\) *from (\S+) × the file's", out)[1]) > 4.155  # type: ignore[index]


def test_a_torque_above_its_limit_is_explained():
    """ζ = 0.9: the current loop overshoots a step by e^{−πζ/√(1−ζ²)} = 0.15 %, of at most twice the limit."""
    study = simulated("duration: 1, torque_limit: 30, reference: {type: step, by: 0.5}", 6.0)
    assert 30 < study.torque_peak[0] < 30 * 1.003
    assert overshoots(study)
    assert any("the current loop overshoots it" in warning for warning in warnings(study))
    assert "the current loop overshoots" in simulation_page(SimulationPresentation(study), "")
    assert "pulls the joint down" not in simulation_page(SimulationPresentation(study), "")
    assert "pulls the joint down" in simulation_page(SimulationPresentation(simulated("duration: 1, gravity: 5")), "")


@pytest.mark.parametrize(
    ("hertz", "angular"),
    [
        (
            "{type: chirp, amplitude: 0.1, first_hz: 0.5, last: 30, duration: 1}",
            f"{{type: chirp, amplitude: 0.1, first: {math.pi}, last: 30, duration: 1}}",
        ),
        (
            "{type: multisine, amplitude: 0.1, frequencies_hz: [1, 2]}",
            f"{{type: multisine, amplitude: 0.1, frequencies: [{2 * math.pi}, {4 * math.pi}]}}",
        ),
    ],
)
def test_frequencies_in_hertz(hertz: str, angular: str):
    one, other = (parse_simulation(text(f"reference: {given}"), "").scenario.reference for given in (hertz, angular))
    time = np.linspace(0, 1, 50)
    assert one.position(time) == pytest.approx(other.position(time), abs=1e-12)
