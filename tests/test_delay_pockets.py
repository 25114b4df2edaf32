"""Delay margins of sampled joints that are stable again with more delay: beside eigenvalues of the loop with every delay on the way."""

import numpy as np
import pytest
from scipy.linalg import expm

import gainroom as gr

BESIDE = 2e-4
"""Relative, of a delay margin: so far beyond it the growth is looked at, which no double precision eigenvalue misses."""


def growth(joint: tuple[float, float, float, float], gains: tuple[float, float], tick: float, delay: float) -> float:
    """ln of the spectral radius of one elastic joint (J, M, K, B) under PD by backward differences, torque held and `delay` late."""
    motor, link, stiffness, damping = joint
    forces = np.array([[-stiffness, stiffness, -damping, damping], [stiffness, -stiffness, damping, -damping]])
    a = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), forces / np.array([[motor], [link]])])
    b = np.array([0, 0, 1 / motor, 0])[:, None]
    late = int(np.floor(delay / tick + 1e-12))
    rest = delay - late * tick

    def held(time: float) -> tuple[np.ndarray, np.ndarray]:
        whole = expm(np.block([[a, b], [np.zeros((1, 5))]]) * time)
        return whole[:4, :4], whole[:4, 4]

    step, input_ = held(tick)
    after = held(tick - rest)[1]
    size = 4 + 1 + late + 1  # state, the position before, torques on the way
    matrix = np.zeros((size, size))
    command = np.zeros(size)
    command[0], command[4] = -(gains[0] + gains[1] / tick), gains[1] / tick
    torques = [command, *np.eye(size)[5:]]  # of this tick, and of those before
    matrix[:4, :4] = step
    matrix[:4] += np.outer(after, torques[late]) + np.outer(input_ - after, torques[late + 1])
    matrix[4, 0], matrix[5] = 1.0, command
    for k in range(6, size):
        matrix[k, k - 1] = 1.0
    return float(np.log(np.abs(np.linalg.eigvals(matrix)).max()))


def margin_of(joint: tuple[float, float, float, float], gains: tuple[float, float], tick: float, delay: float) -> gr.Margins:
    return gr.margins(gr.build_loop(gr.ElasticJoint(*joint), gr.Drive(delay=delay), gr.PD(*gains), sample_time=tick))


def test_a_joint_that_is_stable_again_with_more_delay():
    """Between 1.25 and 3.6 ms of extra delay it vibrates at 109 Hz; 10 ms later it does so for good."""
    joint, gains, tick, delay = (0.044, 0.046, 10108.0, 1.2), (79.1, 5.76), 2e-3, 0.5e-3
    found = margin_of(joint, gains, tick, delay)
    assert found.certified
    assert growth(joint, gains, tick, delay + (1 - BESIDE) * found.delay_margin) < 0
    assert growth(joint, gains, tick, delay + (1 + BESIDE) * found.delay_margin) > 0
    extra = np.linspace(0.05e-3, 12e-3, 240)
    lost = [growth(joint, gains, tick, delay + each) > 0 for each in extra]
    assert found.delay_margin == pytest.approx(extra[lost.index(True)], abs=0.05e-3)
    assert not all(lost[lost.index(True) :])


def looked_at(seeds: range) -> int:
    """How many stable joints, of ordinary rates, whose resonance lies below half of them."""
    count = 0
    for seed in seeds:
        random = np.random.default_rng([seed, 17])
        tick, delay = 1 / random.choice([250, 500, 1000, 2000]), random.choice([0.5e-3, 1e-3, 2e-3, random.uniform(0, 5e-3)])
        motor, link, stiffness = np.exp(random.uniform(np.log([0.02, 0.02, 1e3]), np.log([2, 20, 5e4])))
        resonance = np.sqrt(stiffness * (1 / motor + 1 / link))
        if resonance * tick > 2.5:
            continue
        joint = (motor, link, stiffness, 2 * np.exp(random.uniform(np.log(0.001), np.log(0.05))) * stiffness / resonance)
        crossover = np.exp(random.uniform(np.log(0.05), np.log(0.7))) / (delay + 1.5 * tick + 1e-3)
        kd = (motor + link * random.integers(2)) * crossover
        gains = (kd * crossover * random.uniform(0.05, 0.6), kd)
        found = margin_of(joint, gains, tick, delay)
        if not found.stable or not found.certified:
            continue
        count += 1
        most = min(found.delay_margin, 10 * tick)
        inside = np.linspace(0, 1 - BESIDE, 25) * most
        assert all(growth(joint, gains, tick, delay + each) < 1e-9 for each in inside), seed
        if found.delay_margin < 10 * tick:
            assert growth(joint, gains, tick, delay + (1 + BESIDE) * found.delay_margin) > -1e-9, seed
    return count


def test_delay_margins_have_no_unstable_delay_below_them():
    assert looked_at(range(60)) > 15


@pytest.mark.population
def test_delay_margins_of_many_joints_have_no_unstable_delay_below_them():
    assert looked_at(range(60, 6000)) > 1500
