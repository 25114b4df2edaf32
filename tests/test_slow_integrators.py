"""Coupled joints under PID whose zeros are lightly damped, far below all resonances: beside eigenvalues of the same loop without delay.

There a locus falls as steeply as round-off makes one fall, and what lies below must be looked at all the same.
"""

import numpy as np
import pytest
from numpy.linalg import eigvals

import gainroom as gr

SLACK = 1e-4
"""[1/s] of a root beside the boundary, for which either answer may stand: a root count has no digits there."""


def joints(random: np.random.Generator) -> tuple[gr.Plant, np.ndarray]:
    """Two or three elastic joints, motors' inertias near their loads', and gains (3, n): zeros of damping ratio 0.05 to 0.6."""
    size = int(random.integers(2, 4))
    mixing = random.normal(size=(size, size))
    mobility = np.eye(size) * np.exp(random.uniform(-1, 1)) + 0.2 * mixing @ mixing.T
    inertia, stiffness = np.exp(random.uniform(-1, 1, size)), np.exp(random.uniform(8, 11, size))
    plant = gr.Plant(mobility, inertia, stiffness, 1e-3 * stiffness)
    corner, ratio = np.exp(random.uniform(-1, 2.5)), np.exp(random.uniform(np.log(0.05), np.log(0.6)))
    rigid = inertia + 1 / np.diag(mobility)
    kd = np.exp(random.normal(0, 0.3, size)) * np.exp(random.uniform(-1, 2)) * rigid * corner / (2 * ratio)  # Routh: 1 or more is stable
    return plant, np.array([2 * ratio * corner * kd, corner**2 * kd, kd])


def growth(plant: gr.Plant, gains: np.ndarray, factor: float) -> float:
    """The largest real part [1/s] of the eigenvalues of the closed loop: states θ, q, their rates, and ∫θ."""
    n = plant.size
    kp, ki, kd = factor * gains
    nothing, eye = np.zeros((n, n)), np.eye(n)
    stiff, damped = np.diag(plant.stiffness), np.diag(plant.damping)
    motor, link = np.diag(1 / plant.motor_inertia), plant.link_inverse_inertia
    rows = [
        [nothing, nothing, eye, nothing, nothing],
        [nothing, nothing, nothing, eye, nothing],
        [-motor @ (stiff + np.diag(kp)), motor @ stiff, -motor @ (damped + np.diag(kd)), motor @ damped, -motor @ np.diag(ki)],
        [link @ stiff, -link @ stiff, link @ damped, -link @ damped, nothing],
        [eye, nothing, nothing, nothing, nothing],
    ]
    return float(eigvals(np.block(rows)).real.max())


def checked(seeds: range) -> tuple[int, int]:
    """How many loops are stable, and how many are not."""
    counts = [0, 0]
    for seed in seeds:
        plant, gains = joints(np.random.default_rng([seed, 61]))
        loop = gr.build_loop(plant, gr.Drive(), gr.PID(*(gains[k] for k in (0, 1, 2))))
        rate = growth(plant, gains, 1.0)
        if abs(rate) < SLACK:
            continue
        margins = gr.margins(loop)
        assert gr.is_stable(loop) is (rate < 0), seed
        assert margins.stable is (rate < 0), seed
        counts[int(rate > 0)] += 1
        if not margins.stable:
            continue
        lower = margins.lower_gain_margin
        assert margins.certified, seed
        inside = max(lower, 1e-3) ** np.linspace(0.001, 0.999, 40)
        assert all(growth(plant, gains, factor) < SLACK for factor in inside), seed
        if lower > 0:
            assert growth(plant, gains, 0.999 * lower) > -SLACK, seed
    return counts[0], counts[1]


@pytest.mark.slow
def test_slow_roots_that_integrators_make_are_counted():
    stable, unstable = checked(range(40))
    assert min(stable, unstable) > 5


@pytest.mark.population
def test_slow_roots_of_many_loops_are_counted():
    stable, unstable = checked(range(40, 3000))
    assert min(stable, unstable) > 300


def test_two_joints_that_were_called_stable():
    """Double every 6.4 s, from one 16th of the lowest sampled frequency on; Routh's kd kp − J ki is below 0."""
    plant = gr.Plant(np.array([[1, 0.1], [0.1, 1]]), np.ones(2), np.full(2, 3e4), np.full(2, 30.0))
    gains = np.array([np.full(2, value) for value in (0.4, 0.4, 0.8)])
    assert growth(plant, gains, 1.0) == pytest.approx(0.1082, abs=1e-4)
    for sample_time in (None, 1e-3):
        loop = gr.build_loop(plant, gr.Drive(), gr.PID(0.4, 0.4, 0.8), sample_time=sample_time)
        assert not gr.is_stable(loop)
        assert not gr.margins(loop).stable
