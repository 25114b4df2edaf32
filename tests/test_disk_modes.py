"""What bounds the multi-loop disk margin between frequencies: the modes, their expansions, the tail, and what is reported without them."""

from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest

import gainroom as gr
from draws import complex_normal, draw_robot
from gainroom.analysis import _disk_modes, disk_margin as multiloop_disk
from gainroom.analysis._disk_modes import ClosedModes, opened_at_torques
from gainroom.analysis._mu import balanced, improved, largest, scaled
from gainroom.analysis.disk_margin import TOLERANCE, disk_margin

SAME = 1e-6  # how far the peak is polished (AGREEMENT)

KINDS = {
    "delay": {},
    "full gains": {"full": True},
    "closed chain": {"rank": 3},
    "rigid joints": {"rigid": 2},
    "gravity": {"gravity": True},
    "sampled": {"sample_time": 5e-4, "delay": 2e-3},
    "sampled, part of a tick": {"sample_time": 5e-4, "delay": 1.7e-3},
    "sampled, no delay": {"sample_time": 1e-3, "delay": 0.0},
}


def expanded(modes: ClosedModes, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """M0, M1, M2 about the middles of [low, high] (k,): (3, k, n, n)."""
    size = len(modes.delays)
    return modes.core.bounds(low, high, np.zeros((len(low), size)), 0.0)[0].reshape(-1, 3, size, size).swapaxes(0, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_bounds_hold_between_frequencies(kind):
    """σ_max of D (S − T) D⁻¹ on intervals of any width, anywhere, with S − T from the state space in full, stays below the bound."""
    loop = draw_robot(21, 5, **KINDS[kind])
    modes = opened_at_torques(loop).modes()
    rng = np.random.default_rng(22)
    highest = 2e4 if loop.sample_time is None else pi / loop.sample_time
    middle = np.exp(rng.uniform(np.log(0.3), np.log(0.9 * highest), 60))
    half = np.minimum(middle * np.exp(rng.uniform(np.log(1e-3), np.log(0.9), 60)), highest - middle)
    at_middle = expanded(modes, middle - half, middle + half)[0]
    x = balanced(at_middle) + 0.3 * rng.normal(size=(60, 5))
    for enough in (0.0, inf):
        bound, rest = modes.core.bounds(middle - half, middle + half, x, enough)[1].T
        assert np.all(rest >= 0)
        for k in range(60):
            omega = np.linspace(middle[k] - half[k], middle[k] + half[k], 41)
            delta = 1j * omega if loop.sample_time is None else np.expm1(1j * omega * loop.sample_time) / loop.sample_time
            lag = 1 if loop.sample_time is not None else np.exp(-1j * omega[:, None] * loop.delays)[:, None, :]
            opened = loop.gain * loop.open_loop.at(delta) * lag
            matrix = np.linalg.solve(np.eye(5) + opened, np.eye(5) - opened)
            assert largest(scaled(matrix, np.repeat(x[k][None], 41, axis=0))).max() <= bound[k] * (1 + 1e-9)
        if enough == 0:  # not vacuous: on narrow intervals the bound is also nearly reached
            narrow = half < 0.02 * middle
            assert np.median(bound[narrow] / largest(scaled(at_middle, x))[narrow]) < 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_modes_give_back_the_response(kind):
    """S − T has the same trace wherever the loops are opened; `response` knows no state space in continuous time, nor modes."""
    loop = draw_robot(20, 5, **KINDS[kind])
    modes = opened_at_torques(loop).modes()
    omega = np.geomspace(0.1, 2e4 if loop.sample_time is None else pi / loop.sample_time, 60)
    direct = 2 * np.linalg.inv(np.eye(5) + loop.response(omega)) - np.eye(5)
    found = modes.matrices(omega)
    # what remains is rounding, largest in the response of a closed chain at low frequency
    assert np.trace(found, axis1=1, axis2=2) == pytest.approx(np.trace(direct, axis1=1, axis2=2), abs=1e-7)
    assert np.abs(np.linalg.det(found)) == pytest.approx(np.abs(np.linalg.det(direct)), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_higher_on_a_fine_grid(kind):
    """σ_max at 2000 more frequencies, of S − T from the state space, never exceeds what was proved with the D that is best there."""
    loop = draw_robot(23, 5, **KINDS[kind])
    found = disk_margin(loop)
    assert found.certified
    assert 0 <= found.gap <= TOLERANCE * (1 + 1e-9)
    assert found.lower_margin == pytest.approx(found.margin, rel=TOLERANCE)
    opened = opened_at_torques(loop)
    omega = np.geomspace(1e-2, 1e5 if loop.sample_time is None else pi / loop.sample_time, 2000)
    values = 2 * np.linalg.inv(np.eye(5) + opened.response(omega)) - np.eye(5)
    x = balanced(values)
    high = np.flatnonzero(largest(scaled(values, x)) > 2 / found.margin)
    x[high] = improved(values[high], x[high])[0]
    heights = largest(scaled(values, x))
    assert heights.max() <= 2 / found.lower_margin * (1 + 1e-9)


def test_bounds_hold_while_only_the_delay_turns():
    """N nearly constant, E turning by up to a radian on an interval: what is left out of E's expansion must be covered too."""
    rng = np.random.default_rng(27)
    delays = np.array([0.1, 0.07])
    for _ in range(40):
        turn, through = complex_normal(rng, 2, 2, 2) * 0.35
        poles = np.full(2, -1e6 + 0j)
        modes = ClosedModes(poles, turn, -through * poles, delays, np.array([0.9, 1.1]), 0.0)
        middle, half = rng.uniform(20, 200, 30), np.exp(rng.uniform(np.log(0.1), np.log(10), 30))
        expansion = expanded(modes, middle - half, middle + half)
        x = balanced(expansion[0])
        bound, rest = modes.core.bounds(middle - half, middle + half, x, 0.0)[1].T
        for k in np.flatnonzero(np.isfinite(bound)):
            delta = np.linspace(-half[k], half[k], 41)
            values, every = modes.matrices(middle[k] + delta), np.repeat(x[k][None], 41, axis=0)
            assert largest(scaled(values, every)).max() <= bound[k] * (1 + 1e-9)
            quadratic = sum(matrix[k] * delta[:, None, None] ** power for power, matrix in enumerate(expansion))
            assert largest(scaled(values - quadratic, every)).max() <= rest[k] * (1 + 1e-9) + 1e-12


@pytest.mark.parametrize("sample_time", [0.0, 0.1])
def test_distances_of_poles(sample_time):
    rng = np.random.default_rng(28)
    poles = rng.uniform(-20, 5, 40) + 1j * rng.uniform(-30, 30, 40)
    modes = ClosedModes(poles, np.ones((40, 2)), np.ones((2, 40)), np.zeros(2), np.ones(2), sample_time)
    low = rng.uniform(0, 25, 50)
    high = np.minimum(low + rng.uniform(0, 20, 50), modes.last)
    omega = np.linspace(low, high, 4001)
    variable = np.expm1(1j * omega * sample_time) / sample_time if sample_time else 1j * omega
    sampled = np.abs(variable[:, :, None] - poles).min(axis=0)
    found = modes.core.distances(low, high)
    assert np.all(found <= sampled * (1 + 1e-12))
    assert found == pytest.approx(sampled, abs=3e-3)  # the spacing of the samples


def test_tail():
    """Beyond `end` the loop is too weak, whatever the delays; and `end` is not much farther than it has to be."""
    rng = np.random.default_rng(29)
    for drive in (gr.Drive(3000.0, 0.9, 2e-3), gr.Drive(delay=2e-3)):
        modes = opened_at_torques(replace(draw_robot(24, 4), parts=replace(draw_robot(24, 4).parts, drives=(drive,) * 4))).modes()
        for height in (1.001, 1.1, 2.0):
            end = modes.core.end(height)
            later = [replace(modes, delays=rng.uniform(0, 0.01, 4)) for _ in range(20)]

            def highest(omega: np.ndarray, loops: list = later) -> float:
                return max(largest(scaled(values, balanced(values))).max() for values in (one.matrices(omega) for one in loops))

            assert highest(end * np.geomspace(1, 1e3, 200)) < height
            assert highest(end / np.geomspace(10, 12, 50)) > height or height == 2  # near the poles the expansion in 1/s is poor


def test_sharp_peaks_are_found():
    """A joint 1e-6 from its limit peaks within a few parts in a million of its frequency: |S − T| ~ 2e6, coupled or not."""
    loop = draw_robot(25, 3)
    limit = gr.gain_limit(loop)
    found = disk_margin(loop.scaled(limit.gain * (1 - 1e-6)))
    assert found.certified
    assert found.frequency == pytest.approx(limit.frequency, rel=1e-3)
    # one factor 1/(1 − 1e-6) on all loops loses them: α ≤ 2 (f − 1)/(f + 1)
    assert found.margin < 1e-6 * (1 + 1e-5)
    assert found.upper_margin == pytest.approx(found.margin, rel=1e-4)


def test_work_limit_and_modes_that_disagree(monkeypatch):
    loop = draw_robot(26, 3)
    whole = disk_margin(loop)
    monkeypatch.setattr(multiloop_disk, "MOST_INTERVALS", 1)
    stopped = disk_margin(loop)
    assert (stopped.certified, stopped.gap, stopped.lower_margin) == (False, inf, 0.0)
    assert stopped.margin == pytest.approx(whole.margin, rel=SAME)
    monkeypatch.undo()
    monkeypatch.setattr(_disk_modes, "AGREEMENT", -1.0)
    sampled = disk_margin(loop)
    assert (sampled.certified, sampled.lower_margin) == (False, 0.0)
    assert sampled.margin == pytest.approx(whole.margin, rel=SAME)
