"""Controllers of one joint beyond its gains on positions: torque feedback, disturbance observer, laws in plain numbers.

Everything is compared with the same law closed by hand on the exactly sampled state space of the joint, scipy's matrix exponential of its
equations of motion: response, roots, compliance, noise and every tick of a run.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.linalg import expm
from scipy.signal import dlti

import gainroom as gr
from gainroom.analysis.dynamic_stiffness import stiffness_of
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.compared_joint import control_section
from gainroom.files.joint_yaml import parse_joint
from gainroom.files.law_section import law_written
from gainroom.simulation import Friction, Scenario, Step, Testbed, simulate
from gainroom.simulation.step_response import step_response
from gainroom.system.controller import Compensator, DisturbanceObserver, TorqueFeedback
from gainroom.system.torque_noise import torque_noise, torque_per_count

FEEDBACK: Any = {"kp": "motor", "kd": "motor", "ktau": "torque"}
TICK = 5e-4


@dataclass(frozen=True)
class Arm:
    """Motor, spring, link, current loop and delay; states θ, q, their rates, and two of the current loop."""

    jm: float
    jl: float
    k: float
    b: float
    delay: float

    def sampled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B of (command, load), C of (θ, q, τ_J), in z, with the delay as past commands: the newest first."""
        w, a, entries = 4000.0, np.zeros((6, 6)), np.zeros((6, 2))
        a[0, 2] = a[1, 3] = a[4, 5] = 1.0
        spring = np.array([self.k, -self.k, self.b, -self.b, 0.0, 0.0])
        a[2], a[3] = -spring / self.jm, spring / self.jl
        a[2, 4] = 1 / self.jm
        a[5, 4], a[5, 5] = -w * w, -1.8 * w
        entries[5, 0], entries[3, 1] = w * w, 1 / self.jl

        def over(time: float) -> tuple[np.ndarray, np.ndarray]:
            both = np.zeros((8, 8))
            both[:6, :6], both[:6, 6:] = time * a, time * entries
            grown = expm(both)
            return grown[:6, :6], grown[:6, 6:]

        whole = round(self.delay / TICK * 1e9) / 1e9
        ticks, part = int(whole), (whole - int(whole)) * TICK
        step, pushed = over(TICK)
        late, early = over(TICK - part), over(part)
        size = 6 + ticks + 1
        matrix, inputs, seen = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((3, size))
        matrix[:6, :6], inputs[:6, 1] = step, pushed[:, 1]
        now, before = late[1][:, 0], late[0] @ early[1][:, 0]
        if ticks:
            matrix[:6, 6 + ticks - 1] += now
        else:
            inputs[:6, 0] += now
        matrix[:6, 6 + ticks] += before
        inputs[6, 0] = 1.0
        matrix[7:, 6:-1] = np.eye(ticks)
        seen[0, 0] = seen[1, 1] = 1.0
        seen[2, :6] = spring
        return matrix, inputs, seen

    @property
    def parts(self) -> tuple[gr.ElasticJoint, gr.Drive]:
        return gr.ElasticJoint(self.jm, self.jl, self.k, self.b), gr.Drive(4000.0, 0.9, self.delay, 7.67e-6, 0.05)


FIG9, BED = Arm(1.0, 16.0, 1e4, 1.0, 2e-3), Arm(0.2, 0.8, 1e4, 1.0, 2.174e-3)
CASES = [
    (FIG9, TorqueFeedback(2500.0, 200.0, -0.2, 0.001)),
    (FIG9, TorqueFeedback(2000.0, 150.0, 0.1)),
    (BED, TorqueFeedback(500.0, 15.0, 0.3, 0.0002)),
    (BED, TorqueFeedback(600.0, 20.0, -0.1, -0.0003)),
]


def terms(law: TorqueFeedback, z: np.ndarray) -> list[tuple[int, np.ndarray]]:
    rate = (1 - 1 / z) / TICK
    return [(0, law.kp + law.kd * rate), (2, law.ktau + law.kstau * rate)]


def responses(arm: Arm, z: np.ndarray) -> np.ndarray:
    """From (command, load) to (θ, q, τ_J), (k, 3, 2)."""
    a, b, c = arm.sampled()
    return c @ np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b.astype(complex), (len(z), *b.shape)))


def closed(arm: Arm, law: TorqueFeedback) -> np.ndarray:
    """Closed-loop matrix, the readings of one tick ago as two more states."""
    a, b, c = arm.sampled()
    size = len(a)
    sent = -(law.kp + law.kd / TICK) * c[0] - (law.ktau + law.kstau / TICK) * c[2]
    matrix = np.zeros((size + 2, size + 2))
    matrix[:size, :size] = a + np.outer(b[:, 0], sent)
    matrix[:size, size], matrix[:size, size + 1] = b[:, 0] * law.kd / TICK, b[:, 0] * law.kstau / TICK
    matrix[size, :size], matrix[size + 1, :size] = c[0], c[2]
    return matrix


@pytest.mark.parametrize(("arm", "law"), CASES)
def test_torque_feedback_is_the_sum_of_both_laws(arm: Arm, law: TorqueFeedback) -> None:
    loop = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    omega = np.geomspace(1.0, 0.9999 * math.pi / TICK, 3000)
    z = np.exp(1j * omega * TICK)
    plant = responses(arm, z)
    ratio = sum(gain * plant[:, k, 0] for k, gain in terms(law, z))
    # The double integrator by hand is a difference of 1 − z: at 1 rad/s 2.5e-7 of what is subtracted.
    assert loop.response(omega) == pytest.approx(ratio, rel=1e-8)
    roots = gr.rightmost_roots(loop, 8).roots
    values = np.linalg.eigvals(closed(arm, law)).astype(complex)
    by_hand = np.log(values[np.abs(values) > 1e-3]) / TICK
    assert max(np.abs(by_hand - root).min() / abs(root) for root in roots) < 1e-7
    assert gr.is_stable(loop) == bool(np.abs(values).max() < 1)
    assert loop.open_loop is not None
    assert loop.open_loop.at(loop.variable(1j * omega))[:, 0, 0] == pytest.approx(loop.response(omega), rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "law"), CASES)
def test_margins_of_torque_feedback_are_those_of_its_return_ratio(arm: Arm, law: TorqueFeedback) -> None:
    """The same return ratio as one LTI, whose zeros come from the polynomials by hand; the delay to the tick that scales its phase."""
    loop = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    assert loop.scalar is not None
    found = gr.margins(loop)
    other = gr.margins(gr.loop_from(loop.scalar))
    omega = np.geomspace(0.05, 0.999999 * math.pi / TICK, 400_000)
    z = np.exp(1j * omega * TICK)
    ratio = np.zeros(len(z), dtype=complex)
    for part in np.array_split(np.arange(len(z)), 20):
        plant = responses(arm, z[part])
        ratio[part] = sum(gain * plant[:, k, 0] for k, gain in terms(law, z[part]))
    assert found.peak_sensitivity == pytest.approx(np.abs(1 / (1 + ratio)).max(), rel=1e-6)  # between samples 3e-5 apart
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "peak_complementary", "disk_margin"):
        assert getattr(found, name) == pytest.approx(getattr(other, name), rel=1e-9)
    # At the delay margin a root lies on the unit circle.
    slower = Arm(arm.jm, arm.jl, arm.k, arm.b, arm.delay + found.delay_margin)
    assert np.abs(np.linalg.eigvals(closed(slower, law))).max() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("arm", "law"), CASES)
def test_compliance_and_noise_of_torque_feedback(arm: Arm, law: TorqueFeedback) -> None:
    loop = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    if not gr.is_stable(loop):
        pytest.skip("an unstable loop has neither")
    omega = np.geomspace(1.0, 0.9999 * math.pi / TICK, 20_000)
    z = np.exp(1j * omega * TICK)
    plant, gains = responses(arm, z), terms(law, z)
    sensitivity = 1 / (1 + sum(gain * plant[:, k, 0] for k, gain in gains))
    compliance = plant[:, 1, 1] - plant[:, 1, 0] * sensitivity * sum(gain * plant[:, k, 1] for k, gain in gains)
    found = stiffness_of(loop, True)
    assert found.stiffness[0] == pytest.approx(1 / np.abs(compliance).max(), rel=1e-4)  # alias terms, and samples 5e-4 apart
    assert found.static[0] == pytest.approx(1 / ((1 + law.ktau) / law.kp + 1 / arm.k), rel=1e-6)
    matrix, size = closed(arm, law), len(arm.sampled()[0])
    _, b, c = arm.sampled()
    row = np.concatenate([-(law.kp + law.kd / TICK) * c[0] - (law.ktau + law.kstau / TICK) * c[2], [law.kd / TICK, law.kstau / TICK]])
    variance = 0.0
    for noise, now, last in ((7.67e-6 / math.sqrt(12), law.kp + law.kd / TICK, 0), (0.05, law.ktau + law.kstau / TICK, 1)):
        push = np.zeros(size + 2)
        push[:size], push[size + last] = -now * b[:, 0], 1.0
        spread, power = np.outer(push, push), matrix.copy()
        for _ in range(40):
            spread, power = spread + power @ spread @ power.T, power @ power
        variance += noise**2 * (row @ spread @ row + now**2)
    assert torque_noise(loop)[0] == pytest.approx(math.sqrt(variance), rel=1e-6)
    assert torque_per_count(loop)[0] == pytest.approx(7.67e-6 * (law.kp + law.kd / TICK))


def recursion(arm: Arm, law: TorqueFeedback, ticks: int, height: float, noise: np.ndarray) -> np.ndarray:
    """θ, q, τ_J of `ticks` ticks after a step of the reference, the velocity's left out; noise of the torque's reading."""
    a, b, c = arm.sampled()
    state, position, torque, rows = np.zeros(len(a)), 0.0, 0.0, []
    for k in range(ticks):
        seen = c @ state
        rows.append(seen)
        sprung = seen[2] + noise[k]
        rate, turned = (seen[0] - position) / TICK, (sprung - torque) / TICK
        sent = law.kp * (height - seen[0]) - law.kd * rate - law.ktau * sprung - law.kstau * turned
        position, torque = seen[0], sprung
        state = a @ state + b[:, 0] * sent
    return np.array(rows)


@pytest.mark.parametrize(("arm", "law"), CASES)
def test_a_run_of_torque_feedback_is_the_recursion_by_hand(arm: Arm, law: TorqueFeedback) -> None:
    ticks = 400
    loop = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    scenario = Scenario(duration=ticks * TICK, reference=Step(0.1), reference_velocity=False)
    rows = recursion(arm, law, ticks, 0.1, np.zeros(ticks))
    scale = np.abs(rows[:, :2]).max()
    for run in (simulate(loop, scenario), simulate(Testbed(loop), scenario)):
        assert run.motor_position[:ticks, 0] == pytest.approx(rows[:, 0], abs=1e-9 * scale)
        assert run.link_position[:ticks, 0] == pytest.approx(rows[:, 1], abs=1e-9 * scale)
    stepped = step_response(loop, ticks * TICK)
    assert 0.1 * stepped.reference.link[:ticks] == pytest.approx(rows[:, 1], abs=1e-9 * scale)


def test_noise_of_the_torque_sensor_is_in_both_simulations() -> None:
    arm, law = CASES[0]
    loop = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    scenario = Scenario(duration=200 * TICK, reference=0.0, torque_noise=0.5, seed=3)
    one, other = simulate(loop, scenario), simulate(Testbed(loop), scenario)
    assert np.std(one.target_torque) > 0.3
    assert other.target_torque == pytest.approx(one.target_torque, abs=1e-9)
    count = len(one.time)
    rows = recursion(arm, law, count, 0.0, 0.5 * np.random.default_rng([3, 2]).standard_normal(count))
    assert one.link_position[:, 0] == pytest.approx(rows[:, 1], abs=1e-12)


def test_friction_and_encoder_steps_go_with_torque_feedback() -> None:
    arm, law = CASES[0]
    loop = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    scenario = Scenario(duration=0.5, reference=Step(0.01))
    exact = simulate(Testbed(loop), scenario)
    rough = simulate(Testbed(loop, motor_friction=Friction(coulomb=0.1), motor_resolution=1e-6), scenario)
    assert 0 < np.abs(rough.link_position - exact.link_position).max() < 1e-3
    assert rough.motor_reading[:, 0] / 1e-6 == pytest.approx(np.round(rough.motor_reading[:, 0] / 1e-6), abs=1e-6)


def test_torque_feedback_without_its_torque_gains_is_a_pd() -> None:
    arm = FIG9
    plain = gr.margins(gr.build_loop(*arm.parts, gr.PD(2000.0, 150.0), sample_time=TICK))
    found = gr.margins(gr.build_loop(*arm.parts, TorqueFeedback(2000.0, 150.0, 0.0), FEEDBACK, TICK))
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin"):
        assert getattr(found, name) == pytest.approx(getattr(plain, name), rel=1e-9)


def test_filters_shape_torque_feedback() -> None:
    """A biquad on the whole torque, and the velocity's low-pass on velocity and torque, each by Tustin's rule."""
    law = TorqueFeedback(1500.0, 120.0, -0.2, 0.001, velocity_filter=gr.LowPass(800.0), biquads=(gr.Biquad(160, 0.15, 420, 0.6),))
    loop = gr.build_loop(*FIG9.parts, law, FEEDBACK, TICK)
    omega = np.geomspace(1.0, 6000.0, 500)
    z = np.exp(1j * omega * TICK)

    def mapped(above: list[float], below: list[float], kept: float) -> np.ndarray:
        s = kept / math.tan(kept * TICK / 2) * (z - 1) / (z + 1)
        return np.polyval(above, s) / np.polyval(below, s)

    plant, rate, low = responses(FIG9, z), (1 - 1 / z) / TICK, mapped([800.0], [1.0, 800.0], 800.0)
    shaped = mapped([1 / 160**2, 0.3 / 160, 1.0], [1 / 420**2, 1.2 / 420, 1.0], 420.0)
    ratio = shaped * ((1500 + 120 * rate * low) * plant[:, 0, 0] + low * (-0.2 + 0.001 * rate) * plant[:, 2, 0])
    assert loop.response(omega) == pytest.approx(ratio, rel=1e-8)
    assert loop.open_loop is not None
    assert loop.open_loop.at(loop.variable(1j * omega))[:, 0, 0] == pytest.approx(ratio, rel=1e-8)


def test_in_continuous_time_torque_feedback_has_the_response_of_the_equations() -> None:
    arm = FIG9
    omega = np.geomspace(0.01, 1e4, 2000)
    s = 1j * omega
    spring, current = arm.k + arm.b * s, 4000.0**2 / (s * s + 7200.0 * s + 4000.0**2) * np.exp(-s * arm.delay)
    below = arm.jm * s**2 * (arm.jl * s**2 + spring) + spring * arm.jl * s**2
    motor, torque = (arm.jl * s**2 + spring) / below * current, spring * arm.jl * s**2 / below * current
    for low_pass in (None, gr.LowPass(500.0)):
        law = TorqueFeedback(2500.0, 200.0, -0.2, 0.001, velocity_filter=low_pass)
        held = 1.0 if low_pass is None else 500 / (s + 500)
        loop = gr.build_loop(*arm.parts, law, FEEDBACK)
        ratio = (2500 + 200 * s * held) * motor + (-0.2 + 0.001 * s) * held * torque
        assert loop.response(omega) == pytest.approx(ratio, rel=1e-9)
        assert loop.open_loop is not None
        assert loop.open_loop.at(s)[:, 0, 0] * np.exp(-s * arm.delay) == pytest.approx(ratio, rel=1e-9)


OBSERVER = DisturbanceObserver(1500.0, 180.0, 1.0, 5.0, 5)


def observed(law: DisturbanceObserver, z: np.ndarray) -> np.ndarray:
    """The law as its block diagram has it."""
    tangent = math.tan(law.bandwidth * TICK / 2)
    pole, gain, rate = (1 - tangent) / (1 + tangent), tangent / (1 + tangent), (1 - 1 / z) / TICK
    low = (gain * (1 + 1 / z) / (1 - pole / z)) ** 2
    return (law.kp + law.kd * rate + low * law.nominal_inertia * rate**2) / (1 - low * z**-law.delay_ticks)


@pytest.mark.parametrize("ticks", [0, 1, 2, 5, 12, 13, 60])
@pytest.mark.parametrize("bandwidth", [20.0, 300.0, 3000.0])
def test_a_disturbance_observer_is_its_block_diagram(ticks: int, bandwidth: float) -> None:
    law = DisturbanceObserver(1500.0, 180.0, 1.0, bandwidth, ticks)
    z = np.exp(1j * np.geomspace(30.0, 0.999 * math.pi / TICK, 500) * TICK)
    system = law.transfer(TICK)
    # By hand 1 − Q z^−n and D² lose digits near z = 1: 1e-16/(30 · 5e-4)² is 4e-13.
    assert system.at(np.log(z) / TICK) == pytest.approx(observed(law, z), rel=1e-9)
    assert np.count_nonzero(system.poles == 0) == 1
    assert len(system.zeros) == len(system.poles)


def test_a_disturbance_observer_has_the_margins_of_the_same_lti() -> None:
    """Numerator and denominator by polynomial algebra in z; and a load at rest does not turn the motor."""
    law, tangent = OBSERVER, math.tan(OBSERVER.bandwidth * TICK / 2)
    pole, gain = (1 - tangent) / (1 + tangent), tangent / (1 + tangent)
    lag, rate = np.polymul([1, -pole], [1, -pole]), np.array([1, -1]) / TICK
    shift = np.eye(1, 4)[0]  # z³: of n = 5 ticks, two are in the differences
    above = np.polymul(np.polymul(np.polyadd(law.kp * np.array([1, 0, 0]), np.append(law.kd * rate, 0.0)), lag), shift)
    above = np.polyadd(
        above, np.polymul(law.nominal_inertia * gain**2 * np.polymul(np.polymul([1, 1], [1, 1]), np.polymul(rate, rate)), shift)
    )
    below = np.append(lag, np.zeros(5))
    below[-3:] -= gain**2 * np.array([1, 2, 1])
    other = gr.build_loop(*FIG9.parts, Compensator(dlti(above, below, dt=TICK)), sample_time=TICK)
    loop = gr.build_loop(*FIG9.parts, law, sample_time=TICK)
    found, same = gr.margins(loop), gr.margins(other)
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin"):
        assert getattr(found, name) == pytest.approx(getattr(same, name), rel=1e-7)  # coefficients of order 7 near z = 1
    assert found.stable
    assert step_response(loop).load.motor_rest == pytest.approx(0.0, abs=1e-9)


def test_a_law_of_two_sensors_is_their_sum() -> None:
    """Torque feedback as two transfer functions, one per sensor."""
    arm, law = CASES[0]
    motor = dlti([law.kp + law.kd / TICK, -law.kd / TICK], [1, 0], dt=TICK)
    torque = dlti([law.ktau + law.kstau / TICK, -law.kstau / TICK], [1, 0], dt=TICK)
    loop = gr.build_loop(*arm.parts, Compensator(motor=motor, torque=torque), sample_time=TICK)
    same = gr.build_loop(*arm.parts, law, FEEDBACK, TICK)
    one, other = gr.margins(loop), gr.margins(same)
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-9)
    assert stiffness_of(loop, True).least == pytest.approx(stiffness_of(same, True).least, rel=1e-9)
    assert torque_noise(loop) == pytest.approx(torque_noise(same), rel=1e-9)
    scenario = Scenario(duration=0.1, reference=Step(0.1), torque_noise=0.1)
    runs = [simulate(kind(each), scenario).link_position for each in (loop, same) for kind in (Testbed, lambda bed: bed)]
    for run in runs[1:]:
        assert run == pytest.approx(runs[0], abs=1e-10)


def kalman(arm: Arm) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C in z of a Kalman filter with a random-walk load torque, cancelled, and an LQ law: order 12, of the motor's position."""
    from scipy.linalg import solve_discrete_are

    a, b, c = arm.sampled()
    size = len(a)
    cost = np.zeros((size, size))
    cost[1, 1], cost[3, 3] = 1.0, 1e-2
    riccati = solve_discrete_are(a, b[:, :1], cost, np.array([[1e-7]]))
    law = np.linalg.solve(1e-7 + b[:, :1].T @ riccati @ b[:, :1], b[:, :1].T @ riccati @ a)
    whole = np.block([[a, b[:, 1:]], [np.zeros((1, size)), np.eye(1)]])
    seen, noise = np.append(c[0], 0.0)[None], np.zeros((size + 1, size + 1))
    noise[:size, :size] = 1e-2 * np.outer(b[:, 1], b[:, 1])
    noise[6, 6], noise[size, size] = 1e-4, 1e-2
    spread = solve_discrete_are(whole.T, seen.T, noise, np.array([[1e-11]]))
    gain = whole @ spread @ seen.T / (seen @ spread @ seen.T + 1e-11)
    sent = np.append(law[0], 1.0)[None]
    return whole - np.append(b[:, 0], 0.0)[:, None] @ sent - gain @ seen, gain, sent


def test_an_observer_goes_through_a_file_with_its_digits(tmp_path: Path) -> None:
    """Zeros, poles and gain in z: margins of what is read are those of the state space, and the law is read as it was written."""
    a, b, c = kalman(FIG9)
    law = Compensator(motor=dlti(a, b, c, np.zeros((1, 1)), dt=TICK))
    loop = gr.build_loop(*FIG9.parts, law, sample_time=TICK)
    path = tmp_path / "joint.yaml"
    path.write_text(
        JOINT.replace("CONTROL", yaml.safe_dump({"type": "lti", "motor": law_written(law.motor)}, default_flow_style=True).strip(" \n{}"))
    )
    system: Any = parse_joint(path.read_text(), "joint.yaml")
    z = np.exp(1j * np.geomspace(1.0, 0.999 * math.pi / TICK, 300) * TICK)
    by_hand = (c @ np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b.astype(complex), (len(z), *b.shape))))[:, 0, 0]
    read = system.control.controller.transfer(TICK)
    assert read.at(np.log(z) / TICK) == pytest.approx(law.motor.at(np.log(z) / TICK), rel=1e-12)
    assert read.at(np.log(z) / TICK) == pytest.approx(by_hand, rel=1e-10)  # eigenvalues of A in z: 1e-16 beside |z − p| of 1e-3
    one, other = gr.margins(loop), gr.margins(system.loop())
    assert one.stable
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-9)


JOINT = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000, delay_ms: 2, encoder_resolution: 7.67e-6, torque_noise: 0.05}
control: {CONTROL, sample_rate_hz: 2000}
"""
TORQUE = "type: torque_feedback, feedback: {kp: motor, kd: motor, ktau: torque}, kp: 2500, kd: 200, ktau: -0.2, kstau: 0.001"
DOB = "type: dob, feedback: motor, kp: 1500, kd: 180, nominal_inertia: 1.0, bandwidth: 5"
LAW = "type: lti, motor: {zeros: [0.95], poles: [0.0], gain: 4.0e5}"


@pytest.mark.slow
@pytest.mark.parametrize("control", [TORQUE, DOB, LAW])
def test_every_command_of_a_joint_takes_it(control: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, page, log = tmp_path / "joint.yaml", tmp_path / "page.html", tmp_path / "run.csv"
    path.write_text(
        JOINT.replace("CONTROL", control) + "scenario: {duration: 0.5, friction: {motor: {coulomb: 1}}, motor_resolution: 1e-6}\n"
    )
    assert main(["joint", str(path), "--json", "--report", str(page)]) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    system: Any = parse_joint(path.read_text(), "joint.yaml")
    assert found["peak_sensitivity"] == pytest.approx(gr.margins(system.loop()).peak_sensitivity, rel=1e-9)
    assert found["torque_noise"] == pytest.approx(torque_noise(system.loop())[0], rel=1e-9)
    assert main(["joint", str(path), "--verbose"]) in (0, 1)
    assert "plain PD" in capsys.readouterr().out
    assert main(["simulate", str(path), "--log", str(log), "--report", str(page), "--gain", "0.5"]) in (0, 1)
    assert log.read_text().count("\n") > 900


def test_the_delay_of_a_disturbance_observer_is_the_drives(tmp_path: Path) -> None:
    for delay, ticks in (("2", 5.0), ("2.174", 5.0), ("0", 1.0)):
        system: Any = parse_joint(
            JOINT.replace("CONTROL", DOB.replace("bandwidth: 5", "bandwidth_hz: 1")).replace("delay_ms: 2", f"delay_ms: {delay}"), "j"
        )
        assert system.control.controller == DisturbanceObserver(1500.0, 180.0, 1.0, 2 * math.pi, ticks)


@pytest.mark.parametrize(
    ("control", "problem"),
    [
        (TORQUE.replace("ktau: torque", "ktau: torqe"), "control.feedback.ktau: 'torqe' must be torque"),
        (TORQUE.replace(", ktau: torque", ""), "control.feedback.ktau is missing: torque"),
        (
            TORQUE.replace("{kp: motor, kd: motor, ktau: torque}", "motor"),
            "control.feedback.ktau is missing: torque; give {kp: motor, kd: motor, ktau: torque}",
        ),
        (TORQUE.replace("ktau: torque", "ktau: torque, ktua: torque"), "control.feedback.ktua: must be one of kp, ki, kd, ktau"),
        (
            TORQUE.replace(", ktau: -0.2", ""),
            "control.ktau is missing: the gain on the spring's torque, a number; type torque_feedback has kp, kd, ktau, kstau",
        ),
        ("type: pd, feedback: {kp: motor, kd: motor, ktau: torque}, kp: 1, kd: 1", "control.feedback.ktau: must be one of kp, ki, kd"),
        ("type: pd, feedback: motor, kp: 1, kd: 1, ktau: 1", "control.ktau is not a gain of type pd, which has kp, kd"),
        (DOB.replace("bandwidth: 5", "bandwidth: 7000"), "bandwidth 7000 rad/s must be below half the sample rate, 6283.19 rad/s"),
        (DOB.replace(", bandwidth: 5", ""), "control: give either bandwidth [rad/s] of the disturbance observer or bandwidth_hz"),
        (f"{DOB}, delay_ticks: 2.5", "delay_ticks 2.5 must be a whole number from 0 to 1000"),
        (LAW.replace("motor:", "motr:"), "control.motr: unknown key; did you mean motor?"),
        (
            "type: lti",
            "control.motor is missing: the law of the motor's position, {zeros, poles, gain} in z; or give link, torque or several",
        ),
        (f"{LAW}, feedback: motor", "control.feedback has no meaning for type lti, whose laws name their sensors: motor, link, torque"),
        (
            LAW.replace("[0.95]", "[0.95, 0.5]"),
            "control.motor has 2 zeros and 1 poles in z: more zeros than poles would need readings of the future",
        ),
        (
            LAW.replace("[0.95]", "[[0.9, -0.1]]"),
            "control.motor.zeros[0]: [0.9, -0.1]: the second number must be > 0: the pair has one of either sign",
        ),
        (LAW.replace(", gain: 4.0e5", ""), "control.motor.gain is missing: a number, in z"),
        (
            LAW.replace("gain: 4.0e5", "gain: 1, numerator: [1]"),
            "control.motor: must have either zeros, poles and gain, or numerator and denominator, in z",
        ),
        (
            f"{LAW.replace('poles: [0.0]', 'poles: [1.0]')}, torque: {{zeros: [], poles: [1.0], gain: 1}}",
            "share the pole 1, which does not decay",
        ),
        (
            "type: pd, feedback: motor, kp: 1, kd: 1, motor: {numerator: [1], denominator: [1]}",
            "control.motor is a law in plain numbers, for type lti, not for type pd",
        ),
    ],
)
def test_wrong_files_are_refused_in_one_line(control: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL", control))
    assert main(["joint", str(path)]) == 2
    error = capsys.readouterr().err
    assert problem in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("control", [DOB, LAW])
def test_what_is_sampled_needs_a_rate(control: str) -> None:
    with pytest.raises(GainroomError, match=r"control\.sample_rate_hz is missing"):
        parse_joint(JOINT.replace("CONTROL, sample_rate_hz: 2000", control), "joint.yaml")


def test_a_rigid_gearbox_has_no_torque_to_measure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("CONTROL", TORQUE).replace("1.0e4, damping: 1.0", "rigid"))
    assert main(["joint", str(path)]) == 2
    assert "a rigid gearbox has no spring whose torque could be measured" in capsys.readouterr().err


def test_robots_have_none_of_these_types(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example", "biped"]) == 0
    text = capsys.readouterr().out
    path = tmp_path / "biped.yaml"
    for kind in ("torque_feedback", "dob", "lti"):
        path.write_text(text.replace("type: pd", f"type: {kind}", 1))
        assert main(["robot", str(path)]) == 2
        error = capsys.readouterr().err
        assert "control.type" in error
        assert error.count("\n") == 1
    plant = gr.Plant(np.eye(2), np.ones(2), np.full(2, 100.0))
    with pytest.raises(GainroomError, match="the torque of a spring is for single joints"):
        gr.build_loop(plant, gr.Drive(1000.0), TorqueFeedback(1.0, 1.0, 0.1), FEEDBACK)


@pytest.mark.parametrize("control", [TORQUE, DOB, LAW])
def test_what_a_comparison_would_write_is_the_same_controller(control: str) -> None:
    text = JOINT.replace("CONTROL", control)
    system: Any = parse_joint(text, "joint.yaml")
    written = yaml.safe_dump({**yaml.safe_load(text), "control": control_section(system)})
    again: Any = parse_joint(written, "joint.yaml")
    assert again.control.feedback == system.control.feedback
    one, other = gr.margins(system.loop()), gr.margins(again.loop())
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-12, nan_ok=True)


@pytest.mark.parametrize(
    "law",
    [
        lambda low: gr.DisturbanceObserver(500.0, 150.0, 1.0, 20.0, 5, velocity_filter=low),
        lambda low: gr.Compensator(dlti([1.0], [1.0, -0.5], dt=TICK), velocity_filter=low),
    ],
    ids=["dob", "lti"],
)
def test_a_filter_that_would_act_on_nothing_is_refused(law):
    """Both laws make no velocity of their own: the loop would be the same without it."""
    with pytest.raises(gr.GainroomError, match="velocity_filter"):
        law(gr.LowPass(300.0))
