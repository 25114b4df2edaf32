"""Exact stepping against integration by the method of steps, closed forms, and the loop's own roots and responses."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

import gainroom as gr
from gainroom.native import _core
from gainroom.simulation.oscillation import response_vibration
from gainroom.simulation.run import simulate, stream
from gainroom.simulation.run_record import Run, joined
from gainroom.simulation.scenario import Scenario, Start
from gainroom.simulation.tracking import track
from gainroom.simulation.trajectories import Multisine, Spline, Step
from independent.time_domain import Joints, run
from refusals import assert_refused

TICK = 5e-4
JOINT = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0, motor_viscous=0.3, link_viscous=0.7)
DRIVE = gr.Drive(4000.0, 0.9, 4.348 * TICK)
# The integrator holds 1e-13 per interval; over some 200 intervals, with torques of 100 N m, what is left of it stays below 1e-10 relative.
SAME = {"rel": 1e-9, "abs": 1e-13}


def as_joints(plant: gr.Plant, *drives: gr.Drive) -> Joints:
    return Joints(
        plant.motor_inertia,
        plant.link_inverse_inertia,
        plant.stiffness,
        plant.damping,
        np.array([drive.bandwidth for drive in drives]),
        np.array([drive.damping_ratio for drive in drives]),
        np.array([drive.delay for drive in drives]),
        plant.motor_viscous,
        plant.link_viscous,
        0.0 if plant.gravity_stiffness is None else plant.gravity_stiffness,
    )


def assert_agree(response: Run, truth: dict[str, np.ndarray]) -> None:
    for name, found in (
        ("motor", response.motor_position),
        ("link", response.link_position),
        ("target", response.target_torque),
        ("demand", response.demand_torque),
        ("actual", response.actual_torque),
    ):
        size = np.abs(truth[name]).max()
        assert found / size == pytest.approx(truth[name] / size, **SAME), name


class Difference:
    """(x_k − x_{k−1})/T_s, the first past being the first value unless told."""

    def __init__(self, past: np.ndarray | None = None) -> None:
        self.past = past

    def __call__(self, value: np.ndarray) -> np.ndarray:
        past = value if self.past is None else self.past
        self.past = value
        return (value - past) / TICK


@pytest.mark.slow
@pytest.mark.parametrize("feedback", ["motor", "link"])
@pytest.mark.parametrize("late", [0.0, 1.0, 4.348, 0.6])
def test_one_joint_is_fine_integration(feedback, late):
    """A quintic reference, torques on both sides, a start away from rest, measurement noise; the delay whole or not."""
    rng, ticks = np.random.default_rng(1), 81
    drive = gr.Drive(math.inf if late == 0.6 else 4000.0, 0.9, late * TICK)
    loop = gr.build_loop(JOINT, drive, gr.PD(900.0, 25.0), feedback, TICK)
    reference = Spline.move(0.3, 0.03, start=0.004, order=5, base=0.1)
    torques = rng.normal(size=(2, ticks, 1))
    start = Start(0.1, 0.101, 0.5, -0.2)
    scenario = Scenario(
        reference, (ticks - 1) * TICK, feedforward=3.0, motor_torque=torques[0], link_torque=torques[1], noise=1e-4, seed=4, start=start
    )
    found = simulate(loop, scenario)
    noise = found.measured - (found.motor_position if feedback == "motor" else found.link_position)
    target, velocity, wanted = reference.position(TICK * np.arange(ticks)), Difference(), Difference(np.array([0.1]))

    def control(k: int, motor: np.ndarray, link: np.ndarray) -> np.ndarray:
        reading = (motor if feedback == "motor" else link) + noise[k]
        return 900.0 * (target[k] - reading) + 25.0 * (wanted(target[k]) - velocity(reading)) + 3.0

    assert_agree(
        found,
        run(
            as_joints(JOINT.plant(), drive),
            control,
            ticks,
            TICK,
            np.array([[0.1], [0.101], [0.5], [-0.2]]),
            torques[0],
            torques[1],
        ),
    )
    assert np.std(noise) == pytest.approx(1e-4, rel=0.3)  # 81 draws: a standard error of 8 %


def test_coupled_joints_are_fine_integration():
    """Three joints with full gain matrices, their own delays and current loops, gravity, and links that span two motions only."""
    rng, ticks = np.random.default_rng(2), 61
    root = rng.normal(size=(3, 2))
    plant = gr.Plant(
        root @ root.T,
        motor_inertia=np.array([0.2, 0.5, 0.3]),
        stiffness=np.array([1e4, 4e3, 8e3]),
        damping=np.array([1.0, 0.5, 2.0]),
        motor_viscous=np.array([0.1, 0.2, 0.3]),
        gravity_stiffness=np.diag([3.0, 5.0, -2.0]),
    )
    drives = tuple(gr.Drive(w, 0.8, late * TICK) for w, late in ((3000.0, 2.5), (math.inf, 4.0), (5000.0, 0.25)))
    kp, kd = 300 * np.eye(3) + rng.normal(size=(3, 3)) * 20, 6 * np.eye(3) + rng.normal(size=(3, 3))
    loop = gr.build_loop(plant, drives, gr.PD(kp, kd), sample_time=TICK).scaled(0.7)
    reference = Multisine([30.0, 80.0], 0.02, seed=5, joints=3)
    found = simulate(loop, Scenario(reference, (ticks - 1) * TICK, start=Start(0.0, 0.0, np.array([0.3, 0.0, -0.2]))))
    target, rate = reference.position(TICK * np.arange(ticks)), Difference(np.zeros(3))

    def control(k: int, motor: np.ndarray, _: np.ndarray) -> np.ndarray:
        return 0.7 * (kp @ (target[k] - motor) + kd @ rate(target[k] - motor))

    start = np.zeros((4, 3))
    start[2] = [0.3, 0.0, -0.2]
    assert_agree(found, run(as_joints(plant, *drives), control, ticks, TICK, start))


def warped(num: list[float], den: list[float], frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Tustin's rule with one frequency kept, by scipy."""
    return signal.bilinear(num, den, frequency / (2 * math.tan(frequency * TICK / 2)))


@pytest.mark.parametrize("kind", ["ppi", "pid"])
def test_filters_and_integrator_are_difference_equations(kind):
    """scipy filters the velocity and the torque, through a notch and a biquad; P/PI follows Fig. 13.

    Its velocity gains never see the reference.
    """
    ticks, low_pass, notch = 81, gr.LowPass(900.0, order=2, damping_ratio=0.7), gr.Notch(330.0, width=0.5, depth=0.2)
    shaped = {"velocity_filter": low_pass, "notches": (notch,), "biquads": (gr.Biquad(280.0, 0.15, 420.0, 0.6),)}
    controllers = {
        "ppi": gr.PPI(20.0, 30.0, 150.0, **shaped),
        "pid": gr.PID(600.0, 900.0, 30.0, **shaped),
    }
    loop = gr.build_loop(JOINT, DRIVE, controllers[kind], sample_time=TICK)
    reference = Spline.move(0.1, 0.03)
    found = simulate(loop, Scenario(reference, (ticks - 1) * TICK))
    target = reference.position(TICK * np.arange(ticks))[:, 0]
    filters = {
        "velocity": warped([900.0**2], [1.0, 2 * 0.7 * 900.0, 900.0**2], 900.0),
        "notch": warped([1.0, 0.2 * 0.5 * 330.0, 330.0**2], [1.0, 0.5 * 330.0, 330.0**2], 330.0),
        "biquad": warped([1 / 280.0**2, 2 * 0.15 / 280.0, 1.0], [1 / 420.0**2, 2 * 0.6 / 420.0, 1.0], 420.0),
    }
    memory = {name: np.zeros(2) for name in filters}
    integral, rate = 0.0, Difference(np.zeros(1))

    def filtered(name: str, value: float) -> float:
        output, memory[name] = signal.lfilter(*filters[name], [value], zi=memory[name])
        return output[0]

    def control(k: int, motor: np.ndarray, _: np.ndarray) -> np.ndarray:
        nonlocal integral
        error = target[k] - motor[0]
        if kind == "ppi":
            slip = 20.0 * error - filtered("velocity", rate(motor)[0])
            integral += TICK * slip
            return np.array([filtered("biquad", filtered("notch", 30.0 * slip + 150.0 * integral))])
        integral += TICK * error
        torque = 600.0 * error + 900.0 * integral + 30.0 * filtered("velocity", rate(target[[k]] - motor)[0])
        return np.array([filtered("biquad", filtered("notch", torque))])

    assert_agree(found, run(as_joints(JOINT.plant(), DRIVE), control, ticks, TICK, np.zeros((4, 1))))


def test_rigid_joint_is_the_double_integrator():
    """No current loop, no delay: x⁺ = x + T v + T²/2J u, v⁺ = v + T/J u; the reference's velocity left out."""
    loop = gr.build_loop(gr.ElasticJoint(0.3, 0.9), gr.Drive(), gr.PD(200.0, 15.0), sample_time=TICK)
    found = simulate(loop, Scenario(0.5, 0.2, reference_velocity=False, link_torque=2.0, start=Start(0.0, 0.0)))
    x, v, past, positions = 0.0, 0.0, 0.0, []
    for _ in range(401):
        positions.append(x)
        u = 200.0 * (0.5 - x) - 15.0 * (x - past) / TICK + 2.0
        past, x, v = x, x + TICK * v + TICK**2 / 2 / 1.2 * u, v + TICK / 1.2 * u
    assert found.link_position[:, 0] == pytest.approx(positions, rel=1e-11)  # two orders of the same 400 sums
    assert np.array_equal(found.motor_position, found.link_position)


def test_joints_that_do_not_touch_each_other_are_single_joints():
    """Two in one loop, with gains on the diagonal, against each by itself."""
    other = gr.ElasticJoint(0.5, 2.0, 6e3, 2.0)
    both = gr.Plant(np.diag([1 / 0.8, 1 / 2.0]), np.array([0.2, 0.5]), np.array([1e4, 6e3]), np.array([1.0, 2.0]), np.array([0.3, 0.0]),
                    np.array([0.7, 0.0]))  # fmt: skip
    drives = (DRIVE, gr.Drive(3000.0, 0.7, 2.5 * TICK))
    gains = gr.PPI(np.array([10.0, 6.0]), np.array([40.0, 50.0]), np.array([300.0, 0.0]), velocity_filter=gr.LowPass(1000.0))
    together = simulate(gr.build_loop(both, drives, gains, sample_time=TICK), Scenario(Step(np.array([0.1, -0.2])), 0.5, motor_torque=1.0))
    for j, (joint, height) in enumerate(((JOINT, 0.1), (other, -0.2))):
        control = gr.PPI(gains.kp[j], gains.kv[j], gains.ki[j], velocity_filter=gr.LowPass(1000.0))
        alone = simulate(gr.build_loop(joint, drives[j], control, sample_time=TICK), Scenario(Step(height), 0.5, motor_torque=1.0))
        for name in ("motor_position", "link_position", "target_torque", "demand_torque", "actual_torque"):
            expected = getattr(alone, name)[:, 0]
            # the same sums in another order, a thousand of them
            assert getattr(together, name)[:, j] == pytest.approx(expected, rel=1e-9, abs=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("kd", [70.0, 78.2, 78.3, 80.0, 90.0])
def test_vibration_is_the_rightmost_root(kd):
    """After the other roots have died away the error is one exponential, whose rate is the root."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(1600.0, kd), sample_time=TICK)
    found = response_vibration(simulate(loop, Scenario(Step(0.01), 1.2)))
    root = gr.rightmost_roots(loop).roots[0]
    assert found is not None
    # At 1.2 s the next root has fallen to e^-10 of the first and is told apart as a second exponential.
    assert found.growth_rate == pytest.approx(root.real, abs=1e-7)
    assert found.frequency == pytest.approx(abs(root.imag), abs=1e-7)


def test_a_sine_comes_out_as_the_closed_loop_says():
    """Reference, noise and torque at the command, each a sine: eq. (4)'s transfer functions of the sampled loop."""
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(900.0, 25.0), sample_time=TICK)
    omega, ticks = 2 * math.pi / (100 * TICK), 6000
    wave = np.exp(1j * omega * TICK * np.arange(ticks + 1))
    for name, expected in (
        ("reference", gr.closed_loop(loop).reference(omega)[0]),
        ("feedforward", gr.closed_loop(loop).disturbance(omega)[0]),
    ):
        given = {"reference": 0.0, "feedforward": 0.0} | {name: wave.imag[:, None]}
        found = simulate(loop, Scenario(given.pop("reference"), ticks * TICK, **given)).motor_position[-1000:, 0]
        # ten whole periods: the rest of the transient is e^-40
        share = 2j * np.mean(found * wave[-1000:].conj())
        assert share == pytest.approx(expected, rel=1e-9)


def test_free_masses_keep_energy_and_momentum():
    """No damping, no control: after a kick, J_M v + J_L w and the energy stay, and the centre of mass runs straight on."""
    joint = gr.ElasticJoint(0.2, 0.8, 1e4)
    loop = gr.build_loop(joint, DRIVE, gr.PD(0.0, 0.0), sample_time=TICK)
    found = simulate(loop, Scenario(0.0, 5.0, start=Start(motor_velocity=3.0)))
    motor, link = found.motor_position[:, 0], found.link_position[:, 0]
    assert (0.2 * motor + 0.8 * link) == pytest.approx(0.6 * found.time, abs=1e-11)  # 10 000 roundings of 3 rad
    # Between mass centre and spring the energy is that of the twist alone: its amplitude and phase are the free oscillation's.
    omega = joint.resonance
    assert (motor - link) == pytest.approx(3.0 / omega * np.sin(omega * found.time), abs=1e-11)


def test_momentum_and_work_of_a_torque():
    """A constant torque on the link: the momentum grows as τt and the mass centre as τt²/2J."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(0.0, 0.0), sample_time=TICK)
    found = simulate(loop, Scenario(0.0, 1.0, link_torque=4.0))
    centre = 0.2 * found.motor_position[:, 0] + 0.8 * found.link_position[:, 0]
    assert centre == pytest.approx(2.0 * found.time**2, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("gain", [1.2, 30.0, 1e6])
def test_divergence_ends_the_run(gain):
    """It says when, and not one number is missing or infinite; however fast it goes."""
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(1600.0, 80.0), sample_time=TICK).scaled(gain)
    found = simulate(loop, Scenario(Step(0.01), 30.0))
    assert found.diverged
    assert found.diverged_at == pytest.approx(found.time[-1] + TICK)
    for name in ("motor_position", "link_position", "target_torque", "demand_torque", "actual_torque"):
        assert np.isfinite(getattr(found, name)).all()
    assert np.abs(found.motor_position).max() <= 1e4
    further = simulate(loop, Scenario(Step(0.01), found.diverged_at + TICK, limit=math.inf))
    assert max(np.abs(further.motor_position[-2:]).max(), np.abs(further.link_position[-2:]).max()) > 1e4


def test_overflow_ends_the_run_too():
    """With no limit at all it goes on to the largest numbers, and stops before they run out."""
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(1600.0, 80.0), sample_time=TICK).scaled(1e6)
    found = simulate(loop, Scenario(Step(0.01), 30.0, limit=math.inf))
    assert found.diverged
    assert np.isfinite(found.motor_position).all()
    assert np.abs(found.target_torque).max() > 1e100


@pytest.mark.parametrize("full", [1.0, 0.1])
@pytest.mark.parametrize("count", [1, 7, 60])
def test_the_core_s_recursion_is_the_matrix_s(count: int, full: float):
    """Against matrix products; up to 60 states, of which the largest grow, full and mostly zeros."""
    rng = np.random.default_rng(6)
    matrix, forcing = rng.normal(size=(count, count)) / np.sqrt(0.8 * count * full), rng.normal(size=(300, count))
    matrix *= rng.uniform(size=matrix.shape) < full
    expected = [rng.normal(size=count)]
    for f in forcing:
        expected.append(matrix @ expected[-1] + f)
    size = np.abs(expected).max(axis=1, keepdims=True)
    states = np.full((301, count), np.nan)
    states[0] = expected[0]
    assert _core.recur(matrix.T, forcing, states, 1e150) == 300
    assert states / size == pytest.approx(np.array(expected) / size, abs=1e-11)  # 300 products of 60 terms


def test_recursion_stops_before_it_overflows():
    """Tenfold each step: 1e149 is the last below 1e150; a state that is no number is not counted either."""
    states = np.full((401, 2), np.nan)
    states[0] = [1.0, 0.0]
    assert _core.recur(np.diag([10.0, 0.5]), np.zeros((400, 2)), states, 1e150) == 149
    assert states[149, 0] == pytest.approx(1e149)
    forcing = np.zeros((400, 2))
    forcing[7, 1] = np.nan
    assert _core.recur(np.diag([0.9, 0.5]), forcing, states, 1e150) == 7


@pytest.mark.parametrize("block", [1, 7, 400])
def test_a_run_in_parts_is_the_run(block):
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(900.0, 25.0), sample_time=TICK)
    scenario = Scenario(Spline.move(0.1, 0.1), 0.25, noise=1e-5, seed=3)
    whole, parts = simulate(loop, scenario), list(stream(loop, scenario, block))
    assert [len(part.time) for part in parts[:-1]] == [block] * (len(parts) - 1)
    again = joined(parts)
    assert len(again.time) == 501
    for name in ("time", "motor_position", "measured", "demand_torque"):
        expected = getattr(whole, name)
        # matrix products over blocks of other sizes add in another order
        assert getattr(again, name) == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())


def test_noise_is_repeatable_and_reaches_only_the_measured_side():
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(900.0, 25.0), sample_time=TICK)
    first, second, other = (simulate(loop, Scenario(0.0, 1.0, noise=1e-4, seed=seed)) for seed in (1, 1, 2))
    assert np.array_equal(first.motor_position, second.motor_position)
    assert not np.array_equal(first.motor_position, other.motor_position)
    assert np.array_equal(first.link_reading, first.link_position)
    assert np.std(first.motor_reading - first.motor_position) == pytest.approx(1e-4, rel=0.1)  # 2000 draws: 1.6 %


def test_nothing_moves_where_nothing_happens():
    """Away from zero too: no jump from a controller that starts with an empty memory."""
    loop = gr.build_loop(JOINT, DRIVE, gr.PID(900.0, 500.0, 25.0, velocity_filter=gr.LowPass(500.0)), sample_time=TICK)
    found = simulate(loop, Scenario(0.7, 0.5))
    assert found.motor_position == pytest.approx(np.full((1001, 1), 0.7), rel=1e-13)
    assert np.abs(found.target_torque).max() < 1e-9  # rounding of 0.7 rad times kd/T_s


def test_tracking_of_a_known_response():
    """A second-order answer that overshoots by e^{−π/√3} and settles: written down, not simulated."""
    zeta, omega = 0.5, 20.0
    time = TICK * np.arange(4001)
    shaken = omega * math.sqrt(1 - zeta**2)
    position = 3 - 2 * np.exp(-zeta * omega * time) * (np.cos(shaken * time) + zeta / math.sqrt(1 - zeta**2) * np.sin(shaken * time))
    found = track(SimpleNamespace(time=time, reference=np.full((4001, 1), 3.0), error=3.0 - position[:, None]))
    assert found.overshoot[0] == pytest.approx(math.exp(-math.pi / math.sqrt(3)), rel=1e-5)  # the peak falls between two ticks
    assert found.peak[0] == pytest.approx(2.0)
    assert found.steady_state[0] == pytest.approx(0.0, abs=1e-7)  # e^-18 is left
    outside = np.abs(position - 3) > 0.04
    assert not outside[time >= found.settling_time[0]].any()
    assert outside[time < found.settling_time[0]][-1]
    assert found.rms[0] == pytest.approx(math.sqrt(np.mean((position - 3) ** 2)))


def test_overshoot_and_settling_are_of_the_link_where_it_is_known():
    """The motor goes where it is sent within a tick; the link swings, and rests 0.1 short of it, as under a load on its gearbox."""
    zeta, omega, tick = 0.2, 20.0, TICK
    time = tick * np.arange(8001)
    shaken = omega * math.sqrt(1 - zeta**2)
    link = 1.9 * (1 - np.exp(-zeta * omega * time) * (np.cos(shaken * time) + zeta / math.sqrt(1 - zeta**2) * np.sin(shaken * time)))
    motor = np.where(time > 0, 2.0, 0.0)
    run = SimpleNamespace(time=time, reference=np.full((8001, 1), 2.0), error=2.0 - motor[:, None])
    found, blind = track(run, links=link[:, None]), track(run)
    assert found.overshoot[0] == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2)), rel=1e-4)
    late = time[np.flatnonzero(np.abs(link / 1.9 - 1) > 0.02)[-1] + 1]
    assert found.settling_time[0] == pytest.approx(late, abs=tick)
    assert (blind.overshoot[0], blind.settling_time[0]) == (0.0, tick)
    assert found.peak[0] == blind.peak[0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: simulate(gr.build_loop(JOINT, DRIVE, gr.PD(1.0, 1.0)), Scenario(0.0, 1.0)), ["sample_time"]),
        (lambda: simulate(gr.loop_from(signal.dlti([1.0], [1.0, -0.5], dt=TICK)), Scenario(0.0, 1.0)), ["build_loop"]),
        (lambda: Scenario(0.0, -1.0), ["duration", "-1", "> 0"]),
        (lambda: Scenario(math.nan, 1.0), ["reference", "finite"]),
        (lambda: Scenario(np.zeros((2, 2, 2)), 1.0), ["reference", "(2, 2, 2)"]),
        (lambda: Scenario(0.0, 1.0, noise=-1.0), ["noise", ">= 0"]),
        (lambda: Scenario(0.0, 1.0, seed=-1), ["seed", ">= 0"]),
        (lambda: simulate(SAMPLED, Scenario(0.0, 1e9)), ["duration 1e+09 s", "at most 1000 s", "2000000 ticks", "stream()"]),
        (lambda: next(stream(SAMPLED, Scenario(0.0, 1e300))), ["duration 1e+300 s", "1e+12 ticks"]),
        (lambda: simulate(gr.simulation.Testbed(SAMPLED), Scenario(0.0, 1001.0)), ["duration 1001 s", "at most 1000 s"]),
        (lambda: simulate(SAMPLED, Scenario(Step(np.ones(2)), 1.0)), ["reference for 2 joints", "loop of 1"]),
        (lambda: simulate(SAMPLED, Scenario(0.0, 1.0, noise=np.ones(3))), ["noise of shape (3,)"]),
        (lambda: simulate(SAMPLED, Scenario(0.0, 1.0, start=Start(motor_position=np.ones(2)))), ["start.motor_position"]),
        (lambda: simulate(RIGID, Scenario(0.0, 1.0, start=Start(0.1, 0.2))), ["motor_position", "link_position", "not possible together"]),
    ],
)
def test_what_cannot_be_run_is_refused(make, words):
    assert_refused(make, words)


SAMPLED = gr.build_loop(JOINT, DRIVE, gr.PD(1.0, 1.0), sample_time=TICK)
RIGID = gr.build_loop(gr.ElasticJoint(0.2, 0.8), DRIVE, gr.PD(1.0, 1.0), sample_time=TICK)
