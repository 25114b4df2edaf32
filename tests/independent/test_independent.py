"""The independent checks agree with each other and with numbers that are known."""

from dataclasses import replace

import numpy as np
import pytest

from independent import delay_roots, margins, sampled
from independent.joint import PDJoint, random_joint

# Known: gain margin 2.5650059284821042 continuous, 1.8760807 sampled at 0.5 ms
EXAMPLE = PDJoint(0.2, 0.8, 1e4, 1.0, kp=2000, kd=30, delay=2.5e-3, bandwidth=4000, damping_ratio=0.9)


def test_example_limit_continuous():
    assert delay_roots.count_unstable(EXAMPLE.scaled(2.5650059284821042 * (1 - 1e-14))) == 0
    assert delay_roots.count_unstable(EXAMPLE.scaled(2.5650059284821042 * (1 + 1e-14))) == 2


def bisect(stable, low=1.0, high=3.0):
    """The gain factor, to 1e-9, at which the example stops being stable."""
    while high - low > 1e-9:
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def test_example_limit_sampled():
    by_polynomial = bisect(lambda factor: sampled.is_stable(EXAMPLE.scaled(factor), 5e-4))
    by_eigenvalues = bisect(lambda factor: sampled.spectral_radius(EXAMPLE.scaled(factor), 5e-4) < 1)
    assert by_polynomial == pytest.approx(1.8760807, abs=1e-7)  # as many digits as are known
    assert by_eigenvalues == pytest.approx(by_polynomial, abs=1e-8)


def test_example_rightmost_root():
    roots = delay_roots.roots_in_box(delay_roots.characteristic(EXAMPLE), -150 - 1j, 50 + 2000j)
    assert roots[0] == pytest.approx(-10.00435468 + 43.00809677j, abs=1e-8)


def test_known_entire_function():
    roots = delay_roots.roots_in_box(lambda s: s + np.exp(-s), -3 - 0.5j, 1 + 20j)
    assert roots[0] == pytest.approx(-0.3181315052047641 + 1.337235701430689j, abs=1e-14)


@pytest.mark.parametrize("seed", range(60))
def test_continuous_counts_agree(seed):
    rng = np.random.default_rng([1, seed])
    joint = random_joint(rng).scaled(10 ** rng.uniform(-3, 1))
    assert delay_roots.count_unstable(joint) == delay_roots.count_unstable_mikhailov(joint)


@pytest.mark.parametrize("seed", range(60))
def test_sampled_verdicts_agree(seed):
    rng = np.random.default_rng([2, seed])
    joint = random_joint(rng).scaled(10 ** rng.uniform(-3, 1))
    sample_time = rng.uniform(0.25e-3, 2e-3)
    radius = sampled.spectral_radius(joint, sample_time)
    if abs(radius - 1) > 1e-9:  # eigenvalues cannot tell nearer ones
        assert sampled.is_stable(joint, sample_time) == (radius < 1)


def test_sampled_tends_to_continuous():
    """A short tick T_s costs T_s/2 of hold on both gains and T_s/2 of difference on kd alone."""
    sample_time = 5e-5
    low = bisect(lambda factor: sampled.spectral_radius(EXAMPLE.scaled(factor), sample_time) < 1)
    slower = replace(EXAMPLE, delay=EXAMPLE.delay + sample_time)
    tolerance = EXAMPLE.kp * sample_time / (2 * EXAMPLE.kd)  # 1.7e-3: the phase by which kp is delayed too much here
    assert delay_roots.count_unstable(slower.scaled(low * (1 - tolerance))) == 0
    assert delay_roots.count_unstable(slower.scaled(low * (1 + tolerance))) == 2


def test_grid_margins_of_the_example():
    found = margins.grid_margins(EXAMPLE)
    assert found.gain_margin == pytest.approx(2.5650059284821042, rel=1e-6)  # straight lines, steps of 3e-4 in log ω
    assert np.degrees(found.phase_margin) == pytest.approx(25.7489, abs=1e-4)  # digits given
    assert margins.grid_margins(EXAMPLE, 5e-4).gain_margin == pytest.approx(1.8760807, rel=1e-6)


def test_sampled_response_meets_the_closed_loop_matrix():
    """1 + L(z) vanishes at the eigenvalues of the closed-loop matrix."""
    joint = replace(EXAMPLE, delay=2.2e-3)
    eigenvalues = np.linalg.eigvals(sampled.closed_loop_matrix(joint, 5e-4))
    z = eigenvalues[np.abs(eigenvalues) > 0.5]
    difference = (1 - 1 / z) / 5e-4
    loop = (joint.kp + joint.kd * difference) * margins.sampled_plant(joint, z, 5e-4)
    assert np.abs(1 + loop).max() < 1e-7  # eigenvalues to 1e-11, |dL/dz| up to 1e3
