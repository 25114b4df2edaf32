"""Largest factors on the gains of one direction, all others as they are: eigenvalues or roots of the whole loop on both sides of each."""

import math
from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.boundary import direction_limits
from gainroom.system.loop import build_loop
from independent.coupled import Coupled, count_unstable, sampled_radius

TICK, TICKS = 5e-4, 4
ASIDE = 1e-5  # of a limit: an eigenvalue there is 1e-9 and more from the unit circle, far above their round-off
BANDWIDTH, RATIO = 4000.0, 0.9


def drawn(seed: int, sampled: bool) -> tuple[gr.Loop, Coupled, np.ndarray, np.ndarray, np.ndarray]:
    """A loop of 3 to 6 joints under gains along directions that leave some motions alone; X (n, m), E (m, n), and gains (2, m)."""
    rng = np.random.default_rng((2017, seed))
    n = int(rng.integers(3, 7))
    m = int(rng.integers(1, n + 1))
    root = rng.normal(size=(n, n))
    mobility = root @ root.T / n + 0.2 * np.eye(n)
    motor, stiffness = rng.uniform(0.2, 2.0, n), rng.uniform(3e3, 3e4, n)
    damping = rng.uniform(1.0, 10.0, n)
    jacobian = rng.normal(size=(m, n))
    torque = np.linalg.solve(mobility + np.diag(1 / motor), jacobian.T) if rng.random() < 0.5 else jacobian.T
    kp = rng.uniform(100.0, 400.0, m)
    kp[: m // 2] = kp[0]  # equal ones, whose directions no eigenvector tells apart
    gains = np.array([kp, 2 * rng.uniform(0.3, 1.0) * np.sqrt(kp)])

    def matrices(gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return torque * gains[0] @ jacobian, torque * gains[1] @ jacobian

    truth = Coupled(mobility, motor, stiffness, damping, *matrices(gains), TICKS * TICK, BANDWIDTH, RATIO)
    while not is_stable(truth, sampled):
        gains = gains * 0.7
        truth = replace(truth, kp=0.7 * truth.kp, kd=0.7 * truth.kd)
    plant = gr.Plant(link_inverse_inertia=mobility, motor_inertia=motor, stiffness=stiffness, damping=damping)
    drive = gr.Drive(bandwidth=BANDWIDTH, damping_ratio=RATIO, delay=TICKS * TICK)
    loop = build_loop(plant, drive, gr.PD(*matrices(gains)), sample_time=TICK if sampled else None)
    return loop, truth, torque, jacobian, gains


def is_stable(joints: Coupled, sampled: bool, near: float = 0.0) -> bool:
    return sampled_radius(joints, TICK, TICKS) < 1 if sampled else count_unstable(joints, near) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "sampled"), [*((seed, True) for seed in range(12)), *((seed, False) for seed in range(4))])
def test_stability_ends_at_the_limit_of_a_direction(seed: int, sampled: bool):
    loop, truth, torque, jacobian, gains = drawn(seed, sampled)
    found = direction_limits(loop, torque, jacobian, np.vstack([gains, np.zeros(gains.shape[1])]), np.zeros(gains.shape[1], dtype=bool))

    def stable(direction: int, factor: float) -> bool:
        own = gains.copy()
        own[:, direction] *= factor
        return is_stable(replace(truth, kp=torque * own[0] @ jacobian, kd=torque * own[1] @ jacobian), sampled)

    assert np.all(found > 1)
    for direction, limit in enumerate(found.tolist()):
        if math.isinf(limit):
            assert stable(direction, 900.0)
            continue
        assert stable(direction, limit * (1 - ASIDE))
        assert not stable(direction, limit * (1 + ASIDE))
        assert all(stable(direction, factor) for factor in np.geomspace(1, limit, 8)[1:-1].tolist())


def test_an_unstable_loop_has_no_limits_of_directions():
    loop, _, torque, jacobian, gains = drawn(0, sampled=True)
    gains = np.vstack([1e3 * gains, np.zeros(gains.shape[1])])
    found = direction_limits(loop.scaled(1e3), torque, jacobian, gains, np.zeros(gains.shape[1], dtype=bool))
    assert np.isnan(found).all()
