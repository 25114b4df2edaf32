"""Joints without gains: their motors, gearboxes and links are part of the plant, and the limit is proved without their loops."""

import numpy as np
import pytest

import gainroom as gr
from gainroom.system.plant import Plant

NEAR = 1e-4  # rightmost_roots finds roots to 1e-6 and better
FREE = 1e-2  # [rad/s] roots at 0, of the free motion of joints that nothing controls


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_the_limit_is_where_the_roots_of_the_whole_robot_cross(seed: int):
    """Random robots, continuous and at 1 kHz, of which one or two joints have gains: by all roots of the closed loop."""
    rng = np.random.default_rng([41, seed])
    size = int(rng.integers(2, 6))
    shape = rng.normal(size=(size, size))
    inertia = 10 ** rng.uniform(-1, 0.5, size)
    plant = Plant(shape @ shape.T / size + 0.1 * np.eye(size), inertia, 10 ** rng.uniform(3, 4.5, size), 10 ** rng.uniform(-0.5, 1, size))
    kp, kd = np.zeros(size), np.zeros(size)
    for k in rng.permutation(size)[: 1 + (size > 3)]:
        kp[k], kd[k] = 1e3 * inertia[k], 40 * inertia[k]
    drive = gr.Drive(4000.0, 0.9, rng.uniform(0.5e-3, 4e-3))
    loop = gr.build_loop(plant, drive, gr.PD(kp, kd), sample_time=(None, 1e-3)[seed % 2])
    limit = gr.gain_limit(loop)
    inside, outside = (growth(loop.scaled(limit.gain * (1 + side * NEAR)), 2 * size + 4) for side in (-1, 1))
    assert inside < 0 < outside
    assert limit.stable == (growth(loop, 2 * size + 4) < 0)
    assert limit.certificate is not None
    assert np.argmax(np.abs(limit.mode)) in np.flatnonzero(kp) or np.abs(limit.mode).max() == pytest.approx(1)


def growth(loop: gr.Loop, count: int) -> float:
    return max(root.real for root in gr.rightmost_roots(loop, count=count).roots if abs(root) > FREE)
