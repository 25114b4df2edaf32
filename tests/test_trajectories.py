"""Reference signals against their formulas, and what is said of their derivatives by differences."""

import math

import numpy as np
import pytest

from gainroom.simulation.trajectories import Chirp, Multisine, Spline, Step, Trajectory
from refusals import assert_refused

TIME = np.linspace(-0.5, 3.5, 4001)
SMOOTH = [
    Spline([0.0, 1.0], [0.2, 0.5]),
    Spline.move([0.1, -0.3], 2.0, start=0.5, order=5, base=[0.0, 1.0]),
    Spline([0.0, 0.7, 1.1, 3.0], [[0.0, 1.0], [0.4, 0.0], [0.1, -1.0], [0.2, 2.0]]),
    Spline([0.0, 0.7, 1.1, 3.0], [0.0, 0.4, 0.1, 0.2], order=5),
    Spline([0.0, 0.7, 3.0], [0.0, 0.4, 0.1], order=3, pause=True),
    Spline([0.0, 0.7, 3.0], [0.0, 0.4, 0.1], order=5, pause=True),
    Chirp([0.1, 0.2], 5.0, 60.0, 3.0, base=1.0),
    Chirp(0.1, 5.0, 60.0, 3.0, sweep="exponential", start=0.2),
    Multisine([3.0, 17.0], [0.1, 0.02], seed=3, joints=4, start=-1.0),
]


def slope(signal: Trajectory, time: np.ndarray, h: float = 1e-5) -> np.ndarray:
    """By central differences, off by h² times the third derivative, at most 60³ · 0.2 /s³ here, and rounding, 1e-16/h."""
    return (signal.position(time + h) - signal.position(time - h)) / (2 * h)


@pytest.mark.parametrize("signal", SMOOTH, ids=lambda signal: type(signal).__name__)
def test_nothing_jumps(signal: Trajectory):
    """From one time to the next, 1 ms later, no signal moves by more than its rate there allows: 60 rad/s times 0.2, or 4.5 1/s."""
    values = signal.position(TIME)
    assert values.shape == (len(TIME), signal.size)
    assert np.abs(np.diff(values, axis=0)).max() < 12e-3


def test_step():
    step = Step([0.3, -1.0], start=0.3, base=0.1)
    tick = 5e-4
    values = step.position(tick * np.arange(1000))
    assert np.array_equal(values[:600], np.full((600, 2), 0.1))
    assert values[600:] == pytest.approx(np.tile([0.4, -0.9], (400, 1)))  # 600 ticks are 0.3 s, however their product is rounded


def test_cubic_and_quintic_between_two_points():
    """3τ² − 2τ³ and 10τ³ − 15τ⁴ + 6τ⁵, still before and after."""
    tau = np.clip((TIME - 0.5) / 2.0, 0, 1)
    for order, shape in ((3, 3 * tau**2 - 2 * tau**3), (5, 10 * tau**3 - 15 * tau**4 + 6 * tau**5)):
        move = Spline.move(0.06, 2.0, start=0.5, order=order)
        assert move.position(TIME)[:, 0] == pytest.approx(0.06 * shape, abs=1e-15)
        outside = (TIME < 0.5) | (TIME > 2.5)
        assert not np.ptp(move.position(TIME[outside & (TIME < 1)]))
        assert not np.ptp(move.position(TIME[outside & (TIME > 1)]))


@pytest.mark.parametrize("order", [3, 5])
def test_spline_through_points(order):
    """It meets every point; one derivative less than its order is continuous in between; it starts and ends at rest."""
    times, points = [0.0, 0.7, 1.1, 3.0], [0.0, 0.4, 0.1, 0.2]
    running, pausing = Spline(times, points, order), Spline(times, points, order, pause=True)
    for spline in (running, pausing):
        assert spline.position(times)[:, 0] == pytest.approx(points, abs=1e-14)
        assert slope(spline, np.array([0.0, 3.0])) == pytest.approx(np.zeros((2, 1)), abs=1e-4)  # half of h times the acceleration
    near, h = np.array([0.7 - 2e-4, 0.7 + 2e-4]), 1e-4
    before, after = (slope(running, near + h) - slope(running, near - h)) / (2 * h)
    assert before == pytest.approx(after, abs=0.1)  # of accelerations of up to 20 1/s², which change by 0.04 in so short a time
    assert np.abs(slope(running, np.array([0.7, 1.1]))).min() > 0.01
    assert slope(pausing, np.array(times)) == pytest.approx(np.zeros((4, 1)), abs=1e-4)


def test_chirp_sweeps_its_frequencies():
    """The phase's rate at both ends and in the middle: arithmetic or geometric mean."""
    for sweep, middle in (("linear", 32.5), ("exponential", math.sqrt(5 * 60))):
        chirp = Chirp(1.0, 5.0, 60.0, 3.0, sweep)
        for time, omega in ((0.0, 5.0), (1.5, middle), (3.0, 60.0)):
            inside = np.array([min(max(time, 1e-5), 3.0 - 1e-5)])
            position, velocity = chirp.position(inside)[0, 0], slope(chirp, inside)[0, 0]
            # ẋ/ω and x lie on the unit circle when ω is the phase's rate; in the 1e-5 s from the ends that grows by 4e-5 of itself
            assert (velocity / omega) ** 2 + position**2 == pytest.approx(1.0, abs=1e-4)
    assert Chirp(1.0, 5.0, 60.0, 3.0).position([4.0]) == pytest.approx(Chirp(1.0, 5.0, 60.0, 3.0).position([3.0]))


def test_multisine_has_its_lines_and_no_others():
    """Over whole periods the spectrum is the amplitudes; phases come from the seed and differ between joints."""
    count, tick = 1000, 1e-3
    lines = np.array([3, 10, 11])
    signal = Multisine(2 * np.pi * lines, [0.3, 0.1, 0.2], seed=5, joints=2)
    values = signal.position(tick * np.arange(count))
    assert values[0] == pytest.approx([0.0, 0.0], abs=1e-15)
    spectrum = 2 * np.abs(np.fft.rfft(values, axis=0)) / count
    assert spectrum[lines] == pytest.approx(np.array([[0.3, 0.3], [0.1, 0.1], [0.2, 0.2]]), rel=1e-10)
    assert np.delete(spectrum, [0, *lines], axis=0) == pytest.approx(np.zeros((497, 2)), abs=1e-13)
    assert np.abs(values[:, 0] - values[:, 1]).max() > 0.05
    assert np.array_equal(values, Multisine(2 * np.pi * lines, [0.3, 0.1, 0.2], seed=5, joints=2).position(tick * np.arange(count)))
    assert not np.array_equal(values, Multisine(2 * np.pi * lines, [0.3, 0.1, 0.2], seed=6, joints=2).position(tick * np.arange(count)))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Step(math.nan), ["step", "height", "finite"]),
        (lambda: Step([1.0, 2.0], base=[1.0, 2.0, 3.0]), ["step", "shape (2,)", "3 numbers"]),
        (lambda: Step(1.0, start=[0.0, 1.0]), ["step", "start"]),
        (lambda: Spline([0.0], [1.0]), ["spline", "two or more"]),
        (lambda: Spline([0.0, 0.0], [1.0, 2.0]), ["spline", "rising"]),
        (lambda: Spline([0.0, 1.0], [1.0, 2.0, 3.0]), ["spline", "points", "2 times"]),
        (lambda: Spline([0.0, 1.0], [1.0, 2.0], order=4), ["spline", "order 4", "3 or 5"]),
        (lambda: Spline.move(1.0, 0.0), ["spline", "duration", "> 0"]),
        (lambda: Chirp(1.0, 0.0, 1.0, 1.0), ["chirp", "first", "> 0"]),
        (lambda: Chirp(1.0, 1.0, 2.0, 1.0, sweep="up"), ["chirp", "'up'", "'linear' or 'exponential'"]),
        (lambda: Multisine([-1.0], 1.0), ["multisine", "frequencies", "> 0"]),
        (lambda: Multisine([1.0, 2.0], [1.0, 2.0, 3.0]), ["multisine", "amplitudes", "2 frequencies"]),
        (lambda: Multisine([1.0], 1.0, seed=-1), ["multisine", "seed", ">= 0"]),
    ],
)
def test_bad_signals_are_refused(make, words):
    assert_refused(make, words)
