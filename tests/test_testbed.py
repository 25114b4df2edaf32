"""The testbed against the linear loop that it is without its hardware, and each piece of hardware against what it must do."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import gainroom as gr
from gainroom.simulation.friction import Friction
from gainroom.simulation.oscillation import response_vibration
from gainroom.simulation.run import simulate, stream
from gainroom.simulation.run_record import joined
from gainroom.simulation.scenario import Scenario, Start
from gainroom.simulation.testbed import Testbed
from gainroom.simulation.tracking import track
from gainroom.simulation.trajectories import Chirp, Spline, Step
from independent import dry_friction
from refusals import assert_refused

TICK = 5e-4
JOINT = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0, motor_viscous=0.3, link_viscous=0.7)
DRIVE = gr.Drive(4000.0, 0.9, 4.348 * TICK)
FILTER = {"velocity_filter": gr.LowPass(900.0, order=2), "notches": (gr.Notch(330.0),)}
COLUMNS = ("motor_position", "link_position", "motor_reading", "link_reading", "target_torque", "demand_torque", "actual_torque")


def pd(joint: gr.ElasticJoint = JOINT, drive: gr.Drive = DRIVE, feedback: str = "motor") -> gr.Loop:
    return gr.build_loop(joint, drive, gr.PD(900.0, 25.0), feedback, TICK)


@pytest.mark.parametrize(
    "loop",
    [
        pd(),
        pd(drive=gr.Drive(4000.0, 0.9, 0.0)),
        pd(drive=gr.Drive(math.inf, 0.9, 5 * TICK)),
        pd(drive=gr.Drive(math.inf, 0.9, 0.0)),
        pd(drive=gr.Drive(2500.0, 0.6, 0.37 * TICK), feedback="link"),
        pd(gr.ElasticJoint(0.2, 0.8, link_viscous=0.5)),
        pd(gr.ElasticJoint(0.2, math.inf, 1e4, 5.0)),
        gr.build_loop(JOINT, DRIVE, gr.PPI(20.0, 30.0, 150.0, **FILTER), sample_time=TICK),
        gr.build_loop(JOINT, DRIVE, gr.PID(600.0, 900.0, 30.0, **FILTER), sample_time=1e-3).scaled(0.6),
        gr.build_loop(
            gr.Plant(np.array([[1.25]]), 0.2, 1e4, 1.0, gravity_stiffness=np.array([[12.0]])), DRIVE, gr.PD(900.0, 25.0), sample_time=TICK
        ),
    ],
    ids=["fraction", "no delay", "ideal", "ideal, no delay", "link", "rigid", "locked", "PPI", "PID", "gravity stiffness"],
)
def test_without_its_hardware_it_is_the_linear_loop(loop):
    """Both exact, by other matrix exponentials: Taylor series over substeps, and scipy's over ticks."""
    still = math.isinf(loop.parts.plant.stiffness[0]) or loop.parts.plant.link_inverse_inertia[0, 0] == 0
    start = Start(0.0, 0.0, 0.0 if still else 0.4, 0.0 if still else -0.1)
    scenario = Scenario(
        Spline.move(0.3, 0.2, order=5),
        0.6,
        feedforward=Chirp(2.0, 10.0, 900.0, 0.5),
        motor_torque=1.0,
        link_torque=-2.0,
        noise=1e-5,
        start=start,
    )
    linear, bed = simulate(loop, scenario), simulate(Testbed(loop), scenario)
    assert np.array_equal(bed.time, linear.time)
    for name in COLUMNS:
        expected = getattr(linear, name)
        # 24 000 substeps of 1e-16, which velocities by difference multiply by kd/T_s: 1e-10 of the torque
        assert getattr(bed, name) == pytest.approx(expected, abs=1e-9 * max(np.abs(expected).max(), 1e-9)), name


def test_steps_of_the_integration_do_not_matter_without_friction():
    first, second = (simulate(Testbed(pd(), substep=h), Scenario(Step(0.1), 0.2)) for h in (25e-6, 170e-6))
    assert first.link_position == pytest.approx(second.link_position, abs=1e-12)


def test_each_column_follows_from_the_others():
    """Friction on both sides, gravity, encoder, limit and jitter at once: what is read, what is sent, what arrives; how it then moves."""
    ticks, seed, step = 300, 3, 1e-4
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(delay=3 * TICK), gr.PD(900.0, 25.0), sample_time=TICK)
    scenario = Scenario(Spline.move(0.1, 0.05), (ticks - 1) * TICK, seed=seed)
    laws = (0.5, 0.8, 0.05), (0.3, 0.4, 0.05)
    delays = np.round(3 + 2 * np.random.default_rng([seed, 1]).uniform(-1, 1, ticks))
    errors = []
    for substep in (100e-6, 3e-6):
        bed = Testbed(
            loop,
            *(Friction(*law) for law in laws),
            gravity=6.0,
            torque_limit=9.0,
            motor_resolution=step,
            jitter=2 * TICK,
            whole_ticks=True,
            substep=substep,
        )
        found = simulate(bed, scenario)
        position, reading, target, demand = (getattr(found, name)[:, 0] for name in COLUMNS[:1] + COLUMNS[2:3] + COLUMNS[4:6])
        assert np.array_equal(reading, step * np.floor(position / step + 0.5))
        error = found.reference[:, 0] - reading
        assert target == pytest.approx(900.0 * error + 25.0 * np.diff(error, prepend=error[0]) / TICK, rel=1e-12, abs=1e-12)
        newest = [max([j for j in range(k + 1) if j + delays[j] <= k], default=-1) for k in range(ticks)]
        assert np.array_equal(demand, [0.0 if j < 0 else np.clip(target[j], -9.0, 9.0) for j in newest])
        assert np.abs(demand).max() == 9.0
        truth = dry_friction.run(dry_friction.DryJoint(0.2, 0.8, 1e4, 1.0, *laws, 6.0), demand, TICK, np.zeros(4))[:ticks, :2]
        errors.append(np.abs(np.hstack([found.motor_position, found.link_position]) - truth).max() / np.abs(truth).max())
    # Sliding is of second order in the substep, 33² times better with the finer; stopping and breaking loose are placed to a substep.
    assert errors[1] < 1e-7
    assert errors[1] < errors[0] / 33


@pytest.mark.parametrize("block", [1, 3, 400])
def test_a_run_in_parts_is_the_run(block):
    """Commands under way, latches, bristles and noise all cross from one part to the next."""
    bed = Testbed(pd(), Friction(0.5, 0.8, 0.05), Friction(0.3, 0.4, 0.05, 0.0, 3e3, 5.0), jitter=1.5 * TICK, motor_resolution=1e-5)
    scenario = Scenario(Spline.move(0.1, 0.1), 0.2, noise=1e-6, seed=2)
    whole, again = simulate(bed, scenario), joined(stream(bed, scenario, block))
    for name in ("time", *COLUMNS):
        assert np.array_equal(getattr(whole, name), getattr(again, name))


def unique_commands(ticks: int) -> np.ndarray:
    """A target torque by which every command can be told from every other."""
    return 1.0 + np.random.default_rng(1).uniform(0, 5, size=(ticks, 1))


def ages(bed: Testbed, ticks: int = 1500) -> np.ndarray:
    """How many ticks old the demanded torque is at every tick at which there is one."""
    found = simulate(bed, Scenario(0.0, (ticks - 1) * TICK, feedforward=unique_commands(ticks), limit=math.inf))
    sent, demand = found.target_torque[:, 0], found.demand_torque[:, 0]
    return np.array([k - int(np.flatnonzero(sent == value)[0]) for k, value in enumerate(demand) if value != 0])


IDLE = gr.build_loop(gr.ElasticJoint(0.2, 0.8), gr.Drive(4000.0, 0.9, 5 * TICK), gr.PD(0.0, 0.0), sample_time=TICK)


def test_whole_ticks_of_jitter():
    """5 ± 1 ticks on a bus that is read once a tick: 4, 5 and 6 ticks come, never others; no command comes back once overtaken."""
    seen = ages(Testbed(IDLE, jitter=TICK, whole_ticks=True))
    assert set(seen.tolist()) == {4, 5, 6}
    assert np.all(np.diff(seen) <= 1)  # at the next tick a command is at most one tick older
    fixed = ages(
        Testbed(gr.build_loop(gr.ElasticJoint(0.2, 0.8), gr.Drive(delay=4.348 * TICK), gr.PD(0.0, 0.0), sample_time=TICK), whole_ticks=True)
    )
    assert set(fixed.tolist()) == {4}


def test_fractions_of_ticks_of_jitter():
    """Anything between 4 and 6 ticks: a command is there at the fifth tick when it took no more than 5, else at the sixth."""
    seen = ages(Testbed(IDLE, jitter=TICK))
    assert set(seen.tolist()) == {5, 6}
    assert np.mean(seen) == pytest.approx(5.5, abs=4 * 0.5 / math.sqrt(len(seen)))  # a fair coin, four standard errors


def test_jittered_torques_act_when_they_arrive():
    """A rigid joint integrated between the arrivals, which are drawn here as the testbed draws them; overtaken commands dropped."""
    ticks, seed = 300, 7
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8), gr.Drive(3000.0, 0.8, 3 * TICK), gr.PD(0.0, 0.0), sample_time=TICK)
    commands = unique_commands(ticks)
    found = simulate(Testbed(loop, jitter=2.5 * TICK), Scenario(0.0, (ticks - 1) * TICK, feedforward=commands, seed=seed))
    delay = 3 * TICK + 2.5 * TICK * np.random.default_rng([seed, 1]).uniform(-1, 1, ticks)
    arrival = TICK * np.arange(ticks) + delay
    switches, newest = [(0.0, 0.0)], -1
    for k in np.argsort(arrival, kind="stable"):
        if k > newest:
            newest = int(k)
            switches.append((arrival[k], commands[k, 0]))
    instants = [time for time, _ in switches]
    state, now, positions = np.zeros(4), 0.0, []
    for k in range(ticks):
        for until in [*(time for time in instants if now < time < k * TICK), k * TICK]:
            demand = switches[np.searchsorted(instants, (now + until) / 2, side="right") - 1][1]
            if until > now:
                slope = lambda _, x, u=demand: [x[1], x[2], x[3], 3000.0**2 * (u - x[2]) - 2 * 0.8 * 3000.0 * x[3]]  # noqa: E731
                state = solve_ivp(slope, (now, until), state, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
            now = until
        positions.append(state[0])
    assert found.motor_position[:, 0] == pytest.approx(positions, rel=1e-9, abs=1e-13)


def test_torque_limit():
    """The target asks for more; the demand is cut at the limit; the current loop overshoots it by what ζ = 0.9 allows, 0.15 %."""
    limited = simulate(Testbed(pd(), torque_limit=20.0), Scenario(Step(0.5), 1.0))
    assert np.abs(limited.target_torque).max() > 400
    assert np.abs(limited.demand_torque).max() == 20.0
    assert np.abs(limited.actual_torque).max() < 20.0 * (1 + 2.1 * math.exp(-math.pi * 0.9 / math.sqrt(1 - 0.81)))
    held = np.abs(limited.target_torque[:-5, 0]) < 20
    assert limited.demand_torque[5:, 0][held] == pytest.approx(limited.target_torque[:-5, 0][held])
    # With 20 N m it cannot get there sooner than 1 kg m² can, pushed half the way and braked the other: 2 √(0.5/20) s.
    arrived = limited.time[np.argmax(limited.link_position[:, 0] > 0.5)]
    assert arrived > 2 * math.sqrt(0.5 / 20) * 0.7


def test_a_limit_turns_divergence_into_a_limit_cycle():
    """The same gains run away in the linear loop."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(1600.0, 100.0), sample_time=TICK)
    assert simulate(loop, Scenario(Step(0.01), 3.0)).diverged
    found = simulate(Testbed(loop, torque_limit=50.0), Scenario(Step(0.01), 3.0))
    assert not found.diverged
    noise_motion = response_vibration(found)
    assert noise_motion is not None
    assert noise_motion.growth_rate == pytest.approx(0.0, abs=0.5)
    assert noise_motion.amplitude > 1e-3


def test_encoders_count_steps():
    """Readings are multiples within half a step of the truth, and the controller works with them; finer steps tend to the linear loop."""
    linear = simulate(pd(), Scenario(Spline.move(0.3, 0.2), 0.5))
    errors = []
    for step in (1e-4, 1e-6):
        found = simulate(Testbed(pd(), motor_resolution=step, link_resolution=3 * step), Scenario(Spline.move(0.3, 0.2), 0.5))
        for reading, position, size in (
            (found.motor_reading, found.motor_position, step),
            (found.link_reading, found.link_position, 3 * step),
        ):
            assert np.abs(reading - position).max() <= size / 2 * (1 + 1e-9)
            assert reading / size == pytest.approx(np.round(reading / size), abs=1e-6)
        errors.append(np.abs(found.motor_position - linear.motor_position).max())
    assert 0 < errors[1] < errors[0]
    assert errors[1] < 1e-5  # ten steps: kd/T_s times half a step is 0.025 N m against 900 N m/rad


def test_gravity_sags_and_feedforward_holds():
    """PD alone gives way by m g l sin q / kp on the motor side, and by 1/K more on the link side."""
    bed = Testbed(pd(gr.ElasticJoint(0.2, 0.8, 1e4, 5.0)), gravity=11.5)
    found = track(simulate(bed, Scenario(Spline.move(0.7, 0.3), 8.0)))
    sagged = 0.7 - found.steady_state[0]
    link = sagged - 11.5 * math.sin(sagged) / 1e4
    assert found.steady_state[0] == pytest.approx(11.5 * math.sin(link) / 900.0, rel=1e-4)


@pytest.mark.parametrize("friction", [Friction(), Friction(1.0, 1.5)])
def test_divergence_ends_the_run(friction):
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(1600.0, 300.0), sample_time=TICK)
    found = simulate(Testbed(loop, friction), Scenario(Step(0.01), 30.0))
    assert found.diverged
    assert found.diverged_at == pytest.approx(found.time[-1] + TICK)
    for name in COLUMNS:
        assert np.isfinite(getattr(found, name)).all()
    assert np.abs(found.motor_position).max() <= 1e4
    in_parts = joined(stream(Testbed(loop, friction), Scenario(Step(0.01), 30.0), block=1))  # its last part has no row at all
    assert in_parts.diverged_at == found.diverged_at
    assert np.array_equal(in_parts.motor_position, found.motor_position)


def test_log_columns_are_what_the_encoders_say():
    found = simulate(Testbed(pd(), motor_resolution=1e-3), Scenario(Step(0.1), 0.1))
    columns = found.columns()
    assert list(columns) == ["time", "target_torque", "demand_torque", "actual_torque", "motor_position", "link_position", "reference"]
    assert np.array_equal(columns["reference"], np.full((201, 1), 0.1))
    assert np.array_equal(columns["motor_position"], found.motor_reading)
    assert np.diff(columns["time"]) == pytest.approx(np.full(200, TICK))


TWO = gr.build_loop(gr.Plant(np.eye(2), 0.2, 1e4), DRIVE, gr.PD(1.0, 1.0), sample_time=TICK)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Testbed(TWO), ["testbed", "one joint"]),
        (lambda: Testbed(gr.build_loop(JOINT, DRIVE, gr.PD(1.0, 1.0))), ["testbed", "sample_time"]),
        (lambda: Testbed(pd(), torque_limit=0.0), ["torque_limit 0", "> 0"]),
        (lambda: Testbed(pd(), motor_resolution=-1.0), ["motor_resolution -1", ">= 0"]),
        (lambda: Testbed(pd(), gravity=math.nan), ["gravity", "finite"]),
        (lambda: Testbed(pd(), jitter=1.0), ["jitter 1 s", "delay"]),
        (lambda: Testbed(pd(), substep=0.0), ["substep 0", "> 0"]),
    ],
)
def test_impossible_testbeds_are_refused(make, words):
    assert_refused(make, words)


def test_damping_in_the_drive_runs_at_its_own_rate_and_delay():
    """Against a recursion by hand: every 50 µs a matrix exponential, kp each tenth time 2 ms late, damping each time 0.12 ms late.

    Between two of its samples the drive's command changes: 0.12 ms are two and four tenths of 50 µs.
    """
    inner, late, kp, kd, corner = 5e-5, 1.2e-4, 3000.0, 120.0, 1100.0
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    law = gr.PD(kp, kd, velocity_filter=gr.LowPass(corner))
    loop = gr.build_loop(joint, drive, law, sample_time=TICK, kd_path=gr.GainPath(late, inner))
    found = simulate(loop, Scenario(Step(0.01), 0.1, link_torque=2.0))

    j_m, j_l, k, b, w, z = 0.2, 0.8, 1e4, 1.0, 4000.0, 0.9
    a = np.zeros((6, 6))  # θ, q, θ', q', torque behind the current loop and its rate
    a[0, 2] = a[1, 3] = a[4, 5] = 1.0
    a[2] = np.array([-k, k, -b, b, 1.0, 0.0]) / j_m
    a[3] = np.array([k, -k, b, -b, 0.0, 0.0]) / j_l
    a[5, 4:] = -w * w, -2 * z * w
    into = np.zeros((6, 2))
    into[5, 0], into[3, 1] = w * w, 1 / j_l

    def held(width: float) -> tuple[np.ndarray, np.ndarray]:
        whole = expm(np.block([[a, into], [np.zeros((2, 8))]]) * width)
        return whole[:6, :6], whole[:6, 6:]

    parts = [held(0.4 * inner), held(0.6 * inner)]
    # Tustin's rule for corner/(s + corner), exact at the corner, on the difference of positions
    g = math.tan(corner * inner / 2)
    b0, a1 = g / (1 + g), (1 - g) / (1 + g)
    x, host, fast, last, speed, filtered = np.zeros(6), [], [], 0.0, 0.0, 0.0
    rows = []
    for n in range(round(0.1 / inner) + 1):
        if n % 10 == 0:
            host.append(kp * (0.01 - x[0]))
            rows.append(x[:2].copy())
        rate = (x[0] - last) / inner
        filtered = a1 * filtered + b0 * (rate + speed)
        last, speed = x[0], rate
        fast.append(-kd * filtered)
        first = host[n // 10 - 4] if n >= 40 else 0.0
        for (step, push), m in zip(parts, (n - 3, n - 2), strict=True):
            x = step @ x + push @ np.array([first + (fast[m] if m >= 0 else 0.0), 2.0])
    np.testing.assert_allclose(np.hstack([found.motor_position, found.link_position]), rows, rtol=0, atol=1e-12)  # 2000 exponentials


def test_damping_in_the_drive_vibrates_where_its_margins_end():
    """Just below the factor on all gains that the lifted loop's eigenvalues give, a push decays; just above it grows."""
    loop = gr.build_loop(
        gr.ElasticJoint(0.2, 0.8, 1e4, 1.0),
        gr.Drive(4000.0, 0.9, 2e-3),
        gr.PD(3000.0, 120.0, velocity_filter=gr.LowPass(1100.0)),
        sample_time=TICK,
        kd_path=gr.GainPath(1e-4, 5e-5),
    )
    limit = gr.margins(loop).limit.gain
    for factor, grows in ((0.98, False), (1.02, True)):
        run = simulate(Testbed(loop.scaled(factor * limit)), Scenario(0.0, 2.0, link_torque=np.array([[1.0], [0.0]])))
        size = np.abs(run.motor_position[:, 0])
        assert (size[-400:].max() > size[1600:2000].max()) == grows
