"""Friction against closed forms, against integration from event to event, and against what it may never do: create energy, or creep."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk

import gainroom as gr
from gainroom.native import _core
from gainroom.simulation import testbed_stepping
from gainroom.simulation.friction import Friction
from gainroom.simulation.run import simulate
from gainroom.simulation.run_record import Run
from gainroom.simulation.scenario import Scenario, Start
from gainroom.simulation.testbed import Testbed
from gainroom.simulation.trajectories import Spline
from independent import dry_friction
from refusals import assert_refused

TICK = 5e-4
JOINT = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0)
RIGID = gr.ElasticJoint(0.2, 0.8)
DRY = Friction(2.0, 3.0, 0.05)
LUGRE = Friction(2.0, 3.0, 0.05, bristle_stiffness=2e4, bristle_damping=60.0)


def free(joint: gr.ElasticJoint, **parts) -> Testbed:
    """A joint whose motor gets the feedforward torque at once, and no control."""
    return Testbed(gr.build_loop(joint, gr.Drive(), gr.PD(0.0, 0.0), sample_time=TICK), **parts)


def pushed(bed: Testbed, torque, ticks: int, start: Start | None = None) -> Run:
    return simulate(bed, Scenario(0.0, (ticks - 1) * TICK, feedforward=torque, start=start or Start(0.0, 0.0)))


def test_both_sides_stick_and_slide_as_from_event_to_event():
    """Two sines on the motor, friction on both sides, gravity. Breaking loose is placed to a substep: the error falls with it."""
    ticks = 600
    time = TICK * np.arange(ticks)
    torque = 9 * np.sin(2 * np.pi * 6 * time) + 3 * np.sin(2 * np.pi * 17 * time + 1)
    truth = dry_friction.run(dry_friction.DryJoint(0.2, 0.8, 1e4, 1.0, (2.0, 3.0, 0.05), (1.0, 1.6, 0.02), 6.0), torque, TICK, np.zeros(4))
    assert np.count_nonzero(np.diff(truth[:, 1]) == 0) > 10  # the link sticks part of the time, the motor too
    assert np.count_nonzero(np.diff(truth[:, 0]) == 0) > 10
    size, errors = np.abs(truth[:, :2]).max(), []
    for substep in (100e-6, 25e-6, 3e-6):
        found = pushed(
            free(JOINT, motor_friction=DRY, link_friction=Friction(1.0, 1.6, 0.02), gravity=6.0, substep=substep), torque[:, None], ticks
        )
        both = np.hstack([found.motor_position, found.link_position])
        errors.append(np.abs(both - truth[:ticks, :2]).max() / size)
    # One substep late at 50 rad/s² and 25 µs is 1e-3 rad/s: over 0.1 s of sliding 1e-4 rad of 0.014, a hundredth, at the very most.
    assert errors[1] < 1e-2
    assert errors[2] < errors[0] / 10


def test_a_sliding_joint_stops_where_its_energy_is_used_up():
    """J v²/2 = F d, in the time J v / F; then it does not move by one digit."""
    found = pushed(free(RIGID, motor_friction=Friction(2.0)), 0.0, 4000, Start(0.0, 0.0, 1.5, 1.5))
    position = found.motor_position[:, 0]
    stop = 1.0 * 1.5 / 2.0
    sliding = found.time < stop
    assert position[sliding] == pytest.approx(
        1.5 * found.time[sliding] - found.time[sliding] ** 2, abs=1e-11
    )  # exact, but for 30 000 roundings
    # The substep in which it stops ends up to F h²/J away from where it should.
    assert position[-1] == pytest.approx(1.5**2 / (2 * 2.0), abs=2.0 * (25e-6) ** 2)
    assert len(np.unique(position[found.time > stop + TICK])) == 1


@pytest.mark.parametrize("joint", [JOINT, RIGID], ids=["elastic", "rigid"])
def test_friction_holds_a_joint_at_rest(joint):
    """20 s under 95 % of the breakaway torque: no drift and no chatter, not by one digit."""
    found = pushed(free(joint, motor_friction=DRY), 0.95 * 3.0, 40_000)
    assert not found.motor_position.any()
    assert np.abs(found.link_position).max() < 1e-20  # friction and torque cancel up to 1e-16 of 2.85 N m, over K within a substep


@pytest.mark.parametrize("joint", [JOINT, RIGID], ids=["elastic", "rigid"])
def test_bristles_hold_a_joint_at_rest(joint):
    """They swing first, and slide while they do; under less than F_C they then hold for the rest of 20 s."""
    found = pushed(free(joint, motor_friction=LUGRE), 1.8, 40_000)
    # Held to the rounding of 20 000 substeps a second that each add a torque and a spring of the same size.
    assert np.ptp(found.motor_position[10_000:]) < 1e-12
    assert 1.8 / 2e4 < found.motor_position[-1, 0] < 1e-2


def test_gravity_is_held_and_the_gearbox_twists():
    """Friction on the link, a torque on the motor: the link stays where it is to the last digit, the twist becomes τ/K."""
    found = pushed(free(JOINT, link_friction=Friction(20.0, 25.0), gravity=10.0), 8.0, 8000, Start(1.2, 1.2))
    # 8 N m and gravity's 9.3 N m, overshooting by less than 8 N m, stay below 25
    assert np.all(found.link_position == found.link_position[0])
    assert found.motor_position[-1, 0] - found.link_position[-1, 0] == pytest.approx(8.0 / 1e4, rel=1e-4)  # e^-10 of the swing is left


def test_control_does_not_chatter_in_its_dead_zone():
    """PD pulls with less than the breakaway torque after a move: position and torque stand still, every tick the same."""
    bed = Testbed(
        gr.build_loop(JOINT, gr.Drive(4000.0, 0.9, 2.174e-3), gr.PD(900.0, 25.0), sample_time=TICK), motor_friction=Friction(4.0, 6.0)
    )
    found = simulate(bed, Scenario(Spline.move(0.2, 0.3), 3.0))
    last = found.time > 2.0
    assert np.all(found.motor_position[last] == found.motor_position[-1])
    # the link's swing dies as e^{-0.6 t}: it moves the motor's torque, not the motor
    assert 0 < abs(found.error[-1, 0]) * 900.0 < 6.0
    assert np.ptp(found.target_torque[last]) < 1e-12


@pytest.mark.parametrize("friction", [DRY, LUGRE], ids=["dry", "LuGre"])
def test_breakaway(friction):
    """A torque that rises by 1 N m/s moves the joint away when it passes F_S, not before."""
    time = TICK * np.arange(7000)
    found = pushed(free(RIGID, motor_friction=friction), time[:, None], 7000)
    away = found.time[np.argmax(np.abs(found.motor_position[:, 0]) > (2e-3 if friction is LUGRE else 0.0))]
    if friction is DRY:
        assert away == pytest.approx(3.0, abs=2 * TICK)
        return
    # Bristles bend: 2 mrad are beyond what they can. If it still held F_S, it would take t³/6 = 2 mrad from there.
    assert 3.0 < away < 3.0 + (6 * 2e-3) ** (1 / 3)


@pytest.mark.parametrize("friction", [Friction(2.0, 3.0, 0.05, 0.4), Friction(2.0, 3.0, 0.5, 0.4, 2e4, 60.0)], ids=["dry", "LuGre"])
def test_steady_sliding_is_the_friction_curve(friction):
    """Under a constant torque the speed becomes that at which F(v) + viscous v is the torque."""
    found = pushed(free(RIGID, motor_friction=friction), 4.0, 40_000)
    speed = brentq(lambda v: float(friction.torque(v)) - 4.0, 0.2, 10.0)
    # e^{-0.4 · 20} of the way is left to go, and it is that much that the mean over the last second differs by
    rate = np.diff(found.motor_position[-2001:, 0]) / TICK
    assert rate[-1] == pytest.approx(speed, rel=5e-4)


def test_stick_slip_has_its_period():
    """A link dragged by a spring whose other end runs on at V: sticking 2ΔF/KV, sliding 2/ω (π − atan(ΔF ω/KV)), F_S falling at once."""
    stiffness, inertia, speed, drop = 200.0, 0.8, 0.1, 1.5
    joint = gr.ElasticJoint(1e9, inertia, stiffness)
    bed = free(joint, link_friction=Friction(2.0, 2.0 + drop, stribeck_velocity=1e-5), substep=10e-6)
    found = pushed(bed, 0.0, 12_000, Start(0.0, 0.0, speed, 0.0))
    omega = math.sqrt(stiffness / inertia)
    expected = 2 * drop / (stiffness * speed) + 2 / omega * (math.pi - math.atan(drop * omega / (stiffness * speed)))
    still = np.diff(found.link_position[:, 0]) == 0
    starts = found.time[1:][np.diff(still.astype(int), prepend=1) == -1]
    assert len(starts) > 8
    periods = np.diff(starts[2:])
    assert periods.mean() == pytest.approx(expected, rel=1e-3)  # a tick in half a second
    assert np.ptp(periods) < 2.1 * TICK


def mechanical_energy(body: _core.Body, joint: gr.ElasticJoint, moment: float, state: np.ndarray) -> float:
    motor, link = body.positions @ state
    motor_rate, link_rate = body.rates @ state
    twist = 0.0 if math.isinf(joint.stiffness) else joint.stiffness * (motor - link) ** 2
    kinetic = joint.motor_inertia * motor_rate**2 + joint.link_inertia * link_rate**2
    return 0.5 * (kinetic + twist) + moment * (1 - math.cos(link))


@pytest.mark.parametrize("bristles", [False, True], ids=["dry", "LuGre"])
@pytest.mark.parametrize("joint", [JOINT, RIGID], ids=["elastic", "rigid"])
@pytest.mark.parametrize("width", [25e-6, 2e-3])
def test_friction_creates_no_energy(joint, bristles, width):
    """From twenty random states, no torque from outside: every substep, however coarse, loses energy or keeps it.

    With bristles their ½σ_0 z² counts, and σ_1 is taken as 0: a constant σ_1 is passive only where it is small (Barabanov and Ortega 2000).
    """
    moment = 6.0
    friction = Friction(0.5, 0.8, 0.1, bristle_stiffness=3e3) if bristles else Friction(0.5, 0.8, 0.1)
    bed = free(joint, motor_friction=friction, link_friction=friction, gravity=moment)
    body, hardware = testbed_stepping._body(bed)[0], testbed_stepping._hardware(bed, TICK, math.inf)
    for seed in range(20):
        rng = np.random.default_rng([8, seed])
        state, bent = np.zeros(body.positions.shape[1]), np.zeros(2)
        pair = rng.normal(size=2) * [1.0, 0.02]
        state[-2 * body.coordinates :] = np.linalg.lstsq(
            np.vstack([body.positions, body.rates])[:, -2 * body.coordinates :],
            np.array([pair[0], pair[0] + (0 if joint is RIGID else pair[1]), 2.0, 2.0]),
            rcond=None,
        )[0]
        energy = [mechanical_energy(body, joint, moment, state)]
        for _ in range(400):
            _core.substep(body, hardware, state, bent, width, np.zeros(3))
            energy.append(mechanical_energy(body, joint, moment, state) + (1.5e3 * bent @ bent if bristles else 0.0))
        # Rounding: a double knows the energy to 1e-16 of its largest term, which springs and motion exchange 400 times.
        assert np.diff(energy).max() <= 1e-12 * energy[0]
        assert energy[-1] < energy[0]


def test_pendulum_keeps_its_energy_and_its_period():
    """No friction: 4 √(J/mgl) K(sin²(a/2)), with an error that falls with the substep squared; the energy does not leave its value."""
    joint, moment, swing = RIGID, 11.5, 2.0
    expected = 4 * math.sqrt(1.0 / moment) * ellipk(math.sin(swing / 2) ** 2)
    errors = []
    for substep in (5e-4, 2.5e-4):
        found = pushed(free(joint, gravity=moment, substep=substep), 0.0, 40_000, Start(swing, swing))
        position, time = found.link_position[:, 0], found.time
        down = np.flatnonzero((position[:-1] > 0) & (position[1:] <= 0))
        at = time[down] + TICK * position[down] / (position[down] - position[down + 1])  # straight between ticks: bent by 1e-7 s
        errors.append(abs(np.mean(np.diff(at)) - expected))
        assert np.abs(position).max() <= swing * (1 + 1e-12)
    assert errors[0] < 1e-6
    assert errors[1] < errors[0] / 3


def test_hanging_elsewhere():
    """Level at 0: gravity pulls with all of m g l."""
    found = pushed(free(RIGID, gravity=11.5, hanging_at=-math.pi / 2), 11.5, 400)
    assert found.link_position == pytest.approx(np.zeros((400, 1)), abs=1e-13)


def test_bristles_bend_as_they_should():
    """Loaded slowly, x = −F_S/σ_0 ln(1 − τ/F_S); at first a spring of σ_0."""
    ramp = 1.5 * np.linspace(0, 1, 20_001)[:, None]
    found = pushed(free(RIGID, motor_friction=LUGRE), ramp, 20_001)
    expected = -3.0 / 2e4 * np.log(1 - ramp / 3.0)
    # The ramp's inertia and damping lag behind: σ_1 ẋ is 60 · 1.5e-5 of 1.5 N m, the swing at its start a little more.
    assert found.motor_position == pytest.approx(expected, abs=2e-7)
    assert found.motor_position[2000, 0] == pytest.approx(ramp[2000, 0] / 2e4, rel=0.03)  # τ/2F_S off, 2.5 % there


def test_lugre_is_its_differential_equation():
    """Sines that break it loose time and again, against a stiff integrator at 1e-11: second order."""
    ticks = 500

    def torque(t: float) -> float:
        return 6.0 * math.sin(2 * math.pi * 9 * TICK * math.floor(t / TICK + 1e-9))

    def slope(t: float, x: np.ndarray) -> list[float]:
        steady = 2.0 + math.exp(-((x[1] / 0.05) ** 2))
        bending = x[1] - 2e4 * abs(x[1]) / steady * x[2]
        return [x[1], (torque(t) - 2e4 * x[2] - 60.0 * bending) / 1.0, bending]

    state, truth = np.zeros(3), [0.0]
    for k in range(ticks - 1):
        solved = solve_ivp(slope, (k * TICK + 1e-15, (k + 1) * TICK - 1e-15), state, method="LSODA", rtol=1e-11, atol=1e-14)
        state = solved.y[:, -1]
        truth.append(state[0])
    errors = []
    for substep in (100e-6, 50e-6, 25e-6):
        given = np.array([[torque(TICK * k)] for k in range(ticks)])
        found = pushed(free(RIGID, motor_friction=LUGRE, substep=substep), given, ticks)
        errors.append(np.abs(found.motor_position[:, 0] - truth).max() / np.abs(truth).max())
    assert errors[2] < 1e-5
    assert errors[2] < errors[0] / 8  # not quite evenly: |v| has a kink where the motion turns


def test_friction_on_both_sides_of_a_rigid_joint_adds():
    """One body, two contacts: it breaks loose at the sum, slides against the sum."""
    both = {"motor_friction": Friction(1.0, 1.5), "link_friction": Friction(0.7, 1.0)}
    assert not pushed(free(RIGID, **both), 2.45, 400).motor_position.any()
    found = pushed(free(RIGID, **both), 2.6, 400)
    # Static friction is left within the first substep, F_S falls to F_C over 0.1 rad/s: 0.9 N m push 1 kg m² in the end.
    slope = np.diff(found.motor_position[:, 0], 2)[-1] / TICK**2
    assert slope == pytest.approx(2.6 - 1.7 - 0.8 * math.exp(-((np.diff(found.motor_position[-2:, 0])[0] / TICK / 0.1) ** 2)), rel=0.01)


def test_the_steady_curve():
    friction = Friction(2.0, 3.0, 0.05, 0.4)
    assert friction.torque([0.0, 1e-9, -1e-9, 10.0, -10.0]) == pytest.approx([0.0, 3.0, -3.0, 6.0, -6.0])
    assert float(friction.torque(0.05)) == pytest.approx(2.0 + math.exp(-1) + 0.02)
    assert Friction(2.0).breakaway == 2.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Friction(-1.0), ["friction", "coulomb -1", ">= 0"]),
        (lambda: Friction(2.0, 1.0), ["static 1 N·m", "coulomb 2 N·m"]),
        (lambda: Friction(0.0, 1.0), ["coulomb must be > 0", "static is 1"]),
        (lambda: Friction(2.0, stribeck_velocity=0.0), ["stribeck_velocity 0", "> 0"]),
        (lambda: Friction(2.0, bristle_damping=1.0), ["bristle_damping", "bristle_stiffness"]),
        (lambda: Friction(2.0, viscous=math.nan), ["viscous nan"]),
    ],
)
def test_impossible_friction_is_refused(make, words):
    assert_refused(make, words)
