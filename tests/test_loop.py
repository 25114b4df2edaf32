"""The loop: the scalar form and the state space agree, joints couple as they should, eq. (4), limits of the description."""

from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from draws import Setup, draw_plant, draw_setup
from machines import chain, limbs
from refusals import assert_refused

TICK = 5e-4


def frequencies(loop: gr.Loop, rng: np.random.Generator, count: int = 40) -> np.ndarray:
    """Random ω [rad/s] from 1 to 5000, below 0.99 of the Nyquist frequency."""
    highest = 5000.0 if loop.sample_time is None else min(5000.0, 0.99 * pi / loop.sample_time)
    return np.exp(rng.uniform(0.0, np.log(highest), count))


def through_state_space(loop: gr.Loop, omega: np.ndarray) -> np.ndarray:
    """L from the state space and its delays, without the scalar form."""
    return at_complex(loop, 1j * omega)


def at_complex(loop: gr.Loop, s: np.ndarray) -> np.ndarray:
    v = s if loop.sample_time is None else np.expm1(s * loop.sample_time) / loop.sample_time
    delay = 0.0 if loop.delays is None else loop.delays[0]
    return loop.gain * loop.open_loop.at(v)[:, 0, 0] * np.exp(-s * delay)


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(60))
def test_scalar_form_is_the_state_space(seed, sampled):
    """Any joint, drive, controller, filters, feedback side, whole or fractional delay."""
    rng = np.random.default_rng([1, seed])
    loop = draw_setup(rng, sampled).loop()
    omega = frequencies(loop, rng)
    expected = through_state_space(loop, omega)
    # Solving (jω − A) costs its condition number; a joint with slow and fast modes together reaches 1e6 at 1 rad/s.
    assert np.abs(loop.response(omega) / expected - 1).max() < 1e-8


@pytest.mark.parametrize("seed", range(20))
def test_scalar_form_at_complex_points(seed):
    rng = np.random.default_rng([2, seed])
    loop = draw_setup(rng, sampled=bool(seed % 2)).loop()
    s = rng.uniform(-20, 60, 10) + 1j * rng.uniform(5, 900, 10)
    expected = at_complex(loop, s)
    assert np.abs(loop.at(s) / expected - 1).max() < 1e-8


@pytest.mark.parametrize("feedback", ["motor", "link"])
@pytest.mark.parametrize("size", [2, 5])
def test_many_joints_are_the_formula(size, feedback):
    """L = P C e^{−jωT} D with full gain matrices and one delay per joint, order (output, input)."""
    rng = np.random.default_rng([3, size])
    plant = draw_plant(rng, size, rigid=1)
    drives = [gr.Drive(3000.0, 0.8, float(delay)) for delay in rng.uniform(0, 3e-3, size)]
    kp, kd = rng.normal(size=(size, size)) * 500, rng.normal(size=(size, size)) * 20
    loop = gr.build_loop(plant, drives, gr.PD(kp, kd), feedback=feedback)
    omega = np.array([2.0, 60.0, 350.0, 1500.0])
    form = plant.mechanism()
    for w, found in zip(omega, loop.response(omega), strict=True):
        s = 1j * w
        states = np.linalg.solve(s * s * form.mass + s * form.damping + form.stiffness, form.force.astype(complex))
        position = (form.motor_position if feedback == "motor" else form.link_position) @ states
        lag = 3000.0**2 / (s * s + 2 * 0.8 * 3000 * s + 3000.0**2) * np.exp(-s * np.array([d.delay for d in drives]))
        expected = position @ np.diag(lag) @ (kp + s * kd)
        assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()  # stiff modes at 2 rad/s: condition 1e5


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_uncoupled_joints_are_single_ones(sample_time):
    """Diagonal W: each diagonal element is that joint's own loop, and nothing else."""
    joints = [gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.ElasticJoint(1.0, 16.0, 2e4, 2.0, 0.3, 0.7), gr.ElasticJoint(0.5, 2.0)]
    drives = [gr.Drive(4000.0, 0.9, 2.5e-3), gr.Drive(2000.0, 0.7, 1.3e-3), gr.Drive(inf, 0.9, 0.0)]
    filters = {"velocity_filter": gr.LowPass(900.0), "notches": (gr.Notch(300.0),), "biquads": (gr.Biquad(250.0, 0.3, 500.0, 0.7),)}
    plant = gr.Plant(
        np.diag([1 / j.link_inertia for j in joints]),
        *(
            np.array([getattr(j, name) for j in joints])
            for name in ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
        ),
    )
    gains = np.array([2000.0, 900.0, 400.0]), np.array([30.0, 20.0, 10.0])
    loop = gr.build_loop(plant, drives, gr.PID(gains[0], 2 * gains[0], gains[1], **filters), sample_time=sample_time)
    omega = np.array([2.0, 70.0, 400.0, 2500.0])
    found = loop.response(omega)
    for i, (joint, drive) in enumerate(zip(joints, drives, strict=True)):
        single = gr.build_loop(joint, drive, gr.PID(gains[0][i], 2 * gains[0][i], gains[1][i], **filters), sample_time=sample_time)
        assert found[:, i, i] == pytest.approx(single.response(omega), rel=1e-8)
        assert np.abs(np.delete(found[:, i], i, axis=1)).max() < 1e-9 * np.abs(found[:, i, i]).max()


@pytest.mark.parametrize("late", [0.0, 0.3, 1.0, 4.35])
@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_sampled_loop_is_a_simulation(late, feedback):
    """Impulse response of the loop, tick by tick, against scipy's exact response of the continuous plant to a held pulse."""
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 30.0, 1.0, 1.0), gr.Drive(2000.0, 0.9, late * TICK)
    kp, kd, ticks = 2000.0, 30.0, 60
    loop = gr.build_loop(joint, drive, gr.PD(kp, kd), feedback=feedback, sample_time=TICK)
    plant = equations_of_motion(30.0, 2000.0, feedback)
    # The step response between ticks, evaluated exactly at k T_s − delay and one tick earlier: their difference is the pulse.
    at = np.arange(ticks) * TICK - drive.delay
    position = step_response(plant, at) - step_response(plant, at - TICK)
    expected = kp * position + kd * np.diff(position, prepend=0.0) / TICK
    found = impulse_response(loop, ticks)
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def equations_of_motion(damping: float, bandwidth: float, feedback: str) -> scipy.signal.StateSpace:
    """Of the joint above, states (θ, θ̇, q, q̇, τ_m, τ̇_m / ω_c); torque command → fed-back position."""
    a = np.zeros((6, 6))
    spring = np.array([1e4, damping, -1e4, -damping])
    a[0, 1] = a[2, 3] = 1.0
    a[1, :4], a[3, :4] = -spring / 0.2, spring / 0.8
    a[1, 1] -= 1.0 / 0.2
    a[3, 3] -= 1.0 / 0.8
    a[1, 4] = 1 / 0.2
    a[4, 5], a[5, 4], a[5, 5] = bandwidth, -bandwidth, -2 * 0.9 * bandwidth
    b = np.array([[0.0], [0], [0], [0], [0], [bandwidth]])
    c = np.array([[1.0, 0, 0, 0, 0, 0]] if feedback == "motor" else [[0.0, 0, 1, 0, 0, 0]])
    return scipy.signal.StateSpace(a, b, c, np.zeros((1, 1)))


def step_response(system: scipy.signal.StateSpace, times: np.ndarray) -> np.ndarray:
    """Output at each time for a unit step at zero, by the augmented matrix exponential."""
    from scipy.linalg import expm

    states = len(system.A)
    augmented = np.block([[system.A, system.B], [np.zeros((1, states + 1))]])
    return np.array([(system.C @ expm(augmented * t)[:states, -1]).item() if t > 0 else 0.0 for t in times])


def impulse_response(loop: gr.Loop, ticks: int) -> np.ndarray:
    """Of the loop's sampled state space, in δ."""
    system, step = loop.open_loop, loop.sample_time
    state, outputs = np.zeros(len(system.a)), []
    for k in range(ticks):
        u = np.array([1.0 if k == 0 else 0.0])
        outputs.append((system.c @ state + system.d @ u).item())
        state = state + step * (system.a @ state + system.b @ u)
    return np.array(outputs)


def test_scaled_is_the_controller_scaled():
    setup = draw_setup(np.random.default_rng(5), sampled=False, controller="PID")
    omega = np.array([3.0, 90.0, 700.0])
    expected = replace(setup, controller=setup.controller.scaled(0.37)).loop().response(omega)
    assert setup.loop().scaled(0.37).response(omega) == pytest.approx(expected, rel=1e-12)
    assert setup.loop().scaled(0.37).scaled(2.0).gain == pytest.approx(0.74)


def test_closed_loop_adds_up():
    """Reference plus sensitivity is one; noise is the negative of the reference; the disturbance path closes on itself."""
    loop = draw_setup(np.random.default_rng(6), sampled=True).loop()
    omega = np.array([3.0, 90.0, 700.0])
    closed, value = gr.closed_loop(loop), loop.response(omega)
    assert closed.reference(omega) + 1 / (1 + value) == pytest.approx(np.ones(3), rel=1e-12)
    assert closed.noise(omega) == pytest.approx(-closed.reference(omega), rel=1e-15)
    assert closed.disturbance(omega) * loop.control.response(omega) == pytest.approx(closed.reference(omega), rel=1e-12)


def test_closed_loop_of_a_scaled_loop():
    """x = L/(1+L) x_d + P C e^{−sT}/(1+L) d: the gain is in L only, not in the path of the disturbance."""
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    omega = np.array([3.0, 90.0, 700.0])
    scaled = gr.closed_loop(gr.build_loop(joint, drive, gr.PD(1000.0, 15.0)).scaled(2.0))
    direct = gr.closed_loop(gr.build_loop(joint, drive, gr.PD(2000.0, 30.0)))
    assert scaled.disturbance(omega) == pytest.approx(direct.disturbance(omega), rel=1e-12)
    assert scaled.reference(omega) == pytest.approx(direct.reference(omega), rel=1e-12)


def test_closed_loop_of_an_lti_system():
    """Without a plant of its own the whole of L is in the path: the disturbance enters before it."""
    loop = gr.loop_from(scipy.signal.TransferFunction([4.0], [1.0, 2.0, 0.0]), delay=0.1)
    omega = np.array([0.3, 2.0])
    assert gr.closed_loop(loop).disturbance(omega) == pytest.approx(gr.closed_loop(loop).reference(omega), rel=1e-12)


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
def test_ideal_parts_are_limits(sampled):
    """ω_c = 1e7 lags by 2ζ/ω_c = 1.8e-7 s, 2e-4 rad at 1000 rad/s, and K = 1e11 leaves s² J/K = 1e-6 of compliance."""
    step = TICK if sampled else None
    near = Setup(gr.ElasticJoint(0.2, 0.8, 1e11, 1e6), gr.Drive(1e7, 0.9, 2e-3), gr.PD(900.0, 20.0), sample_time=step)
    ideal = replace(near, joint=gr.ElasticJoint(0.2, 0.8), drive=gr.Drive(delay=2e-3))
    omega = np.array([2.0, 60.0, 1000.0])
    assert np.abs(near.loop().response(omega) / ideal.loop().response(omega) - 1).max() < 3e-4


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_rigid_joint_has_one_side(feedback):
    """Nothing between motor and link: both sides read the same, and inertias add up."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8), gr.Drive(delay=1e-3), gr.PD(900.0, 20.0), feedback=feedback)
    s = 1j * np.array([2.0, 60.0, 1000.0])
    assert loop.at(s) == pytest.approx((900 + 20 * s) / (1.0 * s * s) * np.exp(-s * 1e-3), rel=1e-13)


def test_locked_output():
    """link_inertia = inf: the motor on a spring."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, inf, 1e4, 1.0), gr.Drive(delay=1e-3), gr.PD(900.0, 20.0))
    s = 1j * np.array([2.0, 60.0, 1000.0])
    assert loop.at(s) == pytest.approx((900 + 20 * s) / (0.2 * s * s + s + 1e4) * np.exp(-s * 1e-3), rel=1e-13)


def test_gravity_of_one_joint():
    """An inverted pendulum's G < 0 makes an unstable pole; the state space and the polynomials know it alike."""
    plant = gr.Plant(np.array([[1 / 0.8]]), 0.2, 1e4, 1.0, gravity_stiffness=np.array([[-40.0]]))
    loop = gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(900.0, 20.0))
    omega = np.array([0.5, 6.0, 100.0, 1000.0])
    assert loop.unstable_poles == 1
    assert loop.response(omega) == pytest.approx(through_state_space(loop, omega), rel=1e-9)
    assert gr.is_stable(loop)
    assert not gr.is_stable(gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(39.0, 20.0)))  # below the 40 that gravity asks for


LEG = gr.Plant(np.diag([1.0, 2.0, 3.0]), 1.0, 1e4)


def test_shown_on_one_line():
    """Of many joints too: what it is, no arrays."""
    plant = gr.Plant(np.eye(40), 1.0, 1e4)
    loop = gr.build_loop(plant, gr.Drive(), gr.PD(1.0, 1.0), sample_time=5e-4)
    for thing, words in (
        (plant, ["Plant(40 joints: joint1,"]),
        (loop.scaled(2.0), ["Loop(40 joints, sample_time 0.0005 s, PD, ", "times 2"]),
    ):
        shown = repr(thing)
        assert "\n" not in shown
        assert len(shown) < 120
        assert all(word in shown for word in words)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gr.build_loop("knee", gr.Drive(), gr.PD(1.0, 1.0)), ["str", "ElasticJoint or a Plant"]),
        (
            lambda: gr.build_loop(gr.ElasticJoint(1, 1), gr.Drive(), gr.PD(1.0, 1.0), feedback="both"),
            ["feedback", "'both'", "'motor' or 'link'"],
        ),
        (lambda: gr.build_loop(gr.ElasticJoint(1, 1), gr.Drive(), gr.PD(1.0, 1.0), sample_time=0.0), ["sample_time", "0", "> 0"]),
        (lambda: gr.build_loop(gr.ElasticJoint(1, 1), [gr.Drive()] * 2, gr.PD(1.0, 1.0)), ["2 drives", "1 joints"]),
        (lambda: gr.build_loop(gr.ElasticJoint(1, 1), "fast", gr.PD(1.0, 1.0)), ["drive 'f'", "must be a Drive"]),
        (lambda: gr.build_loop(LEG, [gr.Drive()] * 2, gr.PD(1.0, 1.0)), ["2 drives", "3 joints"]),
        (lambda: gr.build_loop(LEG, 2e-3, gr.PD(1.0, 1.0)), ["drive 0.002", "a Drive, or a list with one for each of 3 joints"]),
        (lambda: gr.build_loop(LEG, gr.Drive(), gr.PD(np.ones(2), 1.0)), ["PD: kp of shape (2,) must be a number, (3,) or (3, 3)"]),
        (lambda: gr.build_loop(LEG, gr.Drive(), gr.PD(1.0, np.ones((3, 2)))), ["PD: kd of shape (3, 2)"]),
        (lambda: gr.build_loop(LEG, gr.Drive(), gr.PID(1.0, np.ones(1), 1.0)), ["PID: ki of shape (1,)"]),
        (lambda: gr.build_loop(LEG, gr.Drive(), gr.PPI(1.0, np.ones((1, 3)))), ["PPI: kv of shape (1, 3)"]),
        (lambda: gr.build_loop(gr.ElasticJoint(1, 1), gr.Drive(), "pd"), ["str", "LTI"]),
        (lambda: gr.build_loop(gr.ElasticJoint(1, 1), gr.Drive(), gr.PD(np.eye(2), 1.0)), ["(2, 2)"]),
        (lambda: gr.build_loop(gr.ElasticJoint(1, inf, 1e4), gr.Drive(), gr.PD(1.0, 1.0), feedback="link"), ["inf", "link side"]),
        (lambda: gr.Drive(bandwidth=0.0), ["bandwidth", "0", "> 0 or inf"]),
        (lambda: gr.Drive(damping_ratio=-1.0), ["damping_ratio", "-1", "> 0"]),
        (lambda: gr.Drive(delay=-1e-3), ["delay", "-0.001", ">= 0"]),
        (lambda: gr.Drive(delay=float("nan")), ["delay", "nan", ">= 0"]),
        (lambda: gr.build_loop(gr.ElasticJoint(1, 1), gr.Drive(), gr.PD(1.0, 1.0)).scaled(float("nan")), ["factor", "nan", "finite"]),
        (lambda: gr.closed_loop(gr.loop_from(lambda s: 1 / s)), ["closed_loop", "one joint"]),
        (lambda: gr.loop_from(lambda s: 1 / s, unstable_poles=-1), ["unstable_poles", "-1", "whole number >= 0"]),
        (lambda: gr.rightmost_roots(gr.build_loop(gr.ElasticJoint(1, 1), gr.Drive(), gr.PD(1.0, 1.0)), 0), ["count", "0", ">= 1"]),
    ],
)
def test_errors(make, words):
    assert_refused(make, words)


@pytest.mark.parametrize("draw", [limbs, chain])
def test_about_the_axis_modes_give_the_same_response(draw):
    """Against W and K themselves, and in sampled time against the state space behind the hold."""
    seen = set()
    for number in range(16):
        loop = draw(7, number).loop
        if loop.exact_modes is None:
            continue
        assert loop.parts is not None
        omega = frequencies(loop, np.random.default_rng(number))
        s = 1j * omega
        if loop.sample_time is None:
            lag = s[:, None] / np.array([drive.bandwidth for drive in loop.parts.drives])
            damping = np.array([drive.damping_ratio for drive in loop.parts.drives])
            late = np.exp(-s[:, None] * [drive.delay for drive in loop.parts.drives])
            expected = loop.parts.plant.response(s, "motor") * (late / (lag**2 + 2 * damping * lag + 1))[:, None, :]
        else:
            expected = loop.held.at(loop.variable(s)) * np.exp(-s[:, None, None] * loop.ticks * loop.sample_time)
        off = np.abs(loop.actuated_at(s) - expected).max(axis=(1, 2)) / np.abs(expected).max(axis=(1, 2))
        assert off.max() < 1e-9
        seen.add(loop.sample_time is None)
    assert seen == {True, False}


def test_off_the_axis_modes_are_refused():
    modes = next(modes for number in range(16) if (modes := limbs(7, number).loop.exact_modes) is not None)
    for s in (1.0 + 1j, -1j, 0j):
        with pytest.raises(ValueError, match="about jω"):
            modes.mobility(np.array([s]))
