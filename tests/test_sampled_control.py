"""The running controller against the frequency response that limits are computed from, and against its recursion written out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.simulation.whole_body import SampledControl
from gainroom.system.controller import PD, PID, PPI
from gainroom.system.filters import Biquad, LowPass, Notch

TICK = 5e-4
FILTERED = {"velocity_filter": LowPass(600.0, 2), "notches": (Notch(400.0, 0.6, 0.2),), "biquads": (Biquad(250.0, 0.3, 500.0, 0.7),)}
CASES = {
    "pd": PD(np.array([50.0, 90.0]), np.array([1.0, 5.0])),
    "matrix": PD(np.array([[50.0, 3.0], [-2.0, 90.0]]), np.array([[1.0, 0.5], [0.2, 5.0]])),
    "pid": PID(40.0, 7.0, 2.0),
    "ppi": PPI(np.array([40.0, 20.0]), np.array([1.0, 5.0]), np.array([1.0, 0.1])),
    "filtered pd": PD(50.0, 3.0, **FILTERED),
    "filtered ppi": PPI(40.0, 2.0, 1.0, **FILTERED),
}


@pytest.mark.parametrize("name", CASES)
def test_feedback_is_the_loops_controller(name):
    """Reference at rest, a steady oscillation measured: output −D(e^{jωT_s}) x, once the start has died out."""
    controller = CASES[name]
    running = SampledControl(controller, 2, TICK)
    omega, shape = 150.0, np.array([1.0, -0.6])
    count = 4000
    times = TICK * np.arange(count)
    values = np.cos(omega * times)[:, None] * shape
    running.rest(-values[0], values[0])
    outputs = np.array([running.tick(-value, value) for value in values])
    s = np.array([1j * omega])
    response = -controller.matrix(s, np.expm1(s * TICK) / TICK, 2, TICK)[0] @ shape
    expected = (np.exp(1j * omega * times)[:, None] * response).real
    late = slice(count // 2, None)
    difference = outputs[late] - expected[late]
    difference -= difference.mean(axis=0)  # what an integrator caught at the start stays: a constant
    assert_allclose(difference, 0, atol=1e-9 * np.abs(expected).max())


def test_cascade_written_out():
    """u = Kv v + Ki Σ v T_s with v = Kp (x_d − x) − Δx/T_s: the moving reference enters by its position alone."""
    kp, kv, ki = np.array([40.0, 20.0]), np.array([1.0, 5.0]), np.array([1.0, 0.1])
    running = SampledControl(PPI(kp, kv, ki), 2, TICK)
    draw = np.random.default_rng(0)
    wanted, values = draw.normal(size=(50, 2)).cumsum(axis=0), draw.normal(size=(50, 2)).cumsum(axis=0)
    running.rest(wanted[0] - values[0], values[0])
    before, total = values[0], np.zeros(2)
    for goal, value in zip(wanted, values, strict=True):
        inner = kp * (goal - value) - (value - before) / TICK
        total, before = total + inner * TICK, value
        # The difference is a state over T_s: 1/T_s times round-off.
        assert_allclose(running.tick(goal - value, value), kv * inner + ki * total, rtol=1e-9, atol=1e-9)


def test_pd_follows_the_references_velocity():
    running = SampledControl(PD(0.0, 3.0), 1, TICK)
    running.rest(np.zeros(1), np.zeros(1))
    ramp = [running.tick(np.array([0.2 * TICK * tick]), np.zeros(1))[0] for tick in range(1, 40)]
    assert_allclose(ramp, 0.6, rtol=1e-9)  # K'v (ẋ_d − ẋ)


def test_no_kick_from_where_it_starts():
    running = SampledControl(PPI(40.0, 2.0, 1.0, **FILTERED), 1, TICK)
    running.rest(np.zeros(1), np.array([0.83]))
    assert_allclose([running.tick(np.zeros(1), np.array([0.83]))[0] for _ in range(30)], 0, atol=1e-9)
