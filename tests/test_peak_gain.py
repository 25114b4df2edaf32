"""The peak of σ_max over the unit circle, where it is known: of normal matrices it is 1 over the distance to the nearest eigenvalue."""

import numpy as np
import pytest
from pytest import approx

from gainroom.analysis import peak_gain as module
from gainroom.analysis.peak_gain import peak_gain, scaled_peak_gain
from gainroom.system.linear.state_space import StateSpace

ROUND_OFF = 2.2e-16


def resonances(rng: np.random.Generator, count: int) -> tuple[StateSpace, float, float, float]:
    """Lightly damped poles, down to 1e-10 inside the circle, in random coordinates; its peak, where, and how sure that can be."""
    angles, gaps = rng.uniform(0.01, 3.13, count), 10.0 ** rng.uniform(-10, -1, count)
    sizes = gaps * rng.uniform(0.5, 2, count)  # so the peaks are of a size
    a, b = np.zeros((2 * count, 2 * count)), np.repeat(sizes, 2)
    for k, (angle, gap) in enumerate(zip(angles, gaps, strict=True)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = (1 - gap) * turn
    mixing, left, right = (np.linalg.qr(rng.normal(size=a.shape))[0] for _ in range(3))
    mixing = mixing * 10 ** rng.uniform(-3, 3, len(a))
    system = StateSpace(np.linalg.solve(mixing, a @ mixing), np.linalg.solve(mixing, np.diag(b) @ right), left @ mixing, np.zeros_like(a))
    highest = int(np.argmax(sizes / gaps))
    return system, sizes[highest] / gaps[highest], angles[highest], 500 * ROUND_OFF / gaps[highest]


@pytest.mark.parametrize("count", [1, 2, 5])
def test_no_narrow_peak_is_missed(count: int):
    rng = np.random.default_rng(count)
    for _ in range(60):
        system, peak, angle, sure = resonances(rng, count)
        found = peak_gain(system)
        assert found.certified
        assert found.height == approx(peak, rel=1e-8 + sure)
        assert found.angle == approx(angle, abs=1e-6) or found.height == approx(peak, rel=1e-12)
        matrix = system.c @ np.linalg.solve(np.exp(1j * found.angle) * np.eye(len(system.a)) - system.a, system.b)
        assert np.linalg.norm(matrix @ found.input) == approx(found.height, rel=1e-8 + sure)


def test_a_peak_between_all_that_is_looked_at_first_is_found(monkeypatch: pytest.MonkeyPatch):
    """Without looks beside poles the level alone leads to the peak."""
    monkeypatch.setattr(module.OnCircle, "angles", lambda self: np.array([0.0, 1.0, np.pi]))
    rng = np.random.default_rng(3)
    for _ in range(20):
        system, peak, _, sure = resonances(rng, 3)
        assert peak_gain(system).height == approx(peak, rel=1e-8 + sure)


def test_large_systems_give_what_small_ones_do(monkeypatch: pytest.MonkeyPatch):
    """Lanczos' method and the bilinear map in place of all singular values and the pencil."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        a = rng.normal(size=(30, 30))
        system = StateSpace(0.9 * a / np.abs(np.linalg.eigvals(a)).max(), *(rng.normal(size=(30, 30)) for _ in range(3)))
        monkeypatch.setattr(module, "DIRECT", 150)
        direct = peak_gain(system)
        monkeypatch.setattr(module, "DIRECT", 5)
        assert peak_gain(system).height == approx(direct.height, rel=1e-9)


def test_what_no_state_makes_is_the_same_everywhere():
    matrix = np.array([[1.0, 2.0], [0.0, 1.0]])
    nothing = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), matrix)
    assert peak_gain(nothing).height == approx(np.linalg.norm(matrix, 2))
    idle = StateSpace(0.5 * np.eye(1), np.zeros((1, 2)), np.ones((2, 1)), matrix)
    assert peak_gain(idle).height == approx(np.linalg.norm(matrix, 2))


def test_a_scaled_peak_takes_units_of_blocks_back():
    """D⁻¹ M D for an M whose σ_max no D lowers: a direct sum of a block of any size and 1 × 1 ones."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        first, second = resonances(rng, 2)[0], resonances(rng, 1)[0]
        sum_of = first.beside(second)
        block = np.array([0] * 4 + [1] * 2)
        units = 10.0 ** rng.uniform(-2, 2, 2)[block]
        given = StateSpace(sum_of.a, sum_of.b * units, sum_of.c / units[:, None], sum_of.d)
        found = scaled_peak_gain(given, block)
        assert found.height == approx(max(peak_gain(first).height, peak_gain(second).height), rel=1e-4)
        assert found.certified
