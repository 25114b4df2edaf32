"""The structured singular value: brute force, slycot, closed forms and symmetries."""

from math import pi
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import minimize

from draws import complex_normal
from gainroom.analysis._mu import balanced, from_below, improved, largest, scaled
from gainroom.native import _core


class Bounds(NamedTuple):
    """lower ≤ μ ≤ upper; scaling (n,): log of the D that gives `upper`; phases (n,): q, with |eigenvalue| `lower` of M diag(q)."""

    lower: float
    upper: float
    scaling: np.ndarray
    phases: np.ndarray


def structured_singular_value(matrix: np.ndarray) -> Bounds:
    """Both bounds for one complex matrix (n, n), as the disk margin finds them for many."""
    scaling, upper = improved(matrix[None], balanced(matrix[None]))
    lower, phases = from_below(scaled(matrix[None], scaling)[0], float(upper[0]))
    return Bounds(min(lower, float(upper[0])), float(upper[0]), scaling[0], phases)


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_small_matrices_against_brute_force(seed, size):
    """μ = max ρ(M diag(q)) over phases q (Doyle 1982), searched on a grid and polished; for n ≤ 3 both bounds must meet it."""
    matrix = complex_normal(np.random.default_rng([1, seed, size]), size, size)

    def radius(phases: np.ndarray) -> float:
        return np.abs(np.linalg.eigvals(matrix * np.exp(1j * np.append(0.0, phases)))).max()

    grid = np.stack(np.meshgrid(*[np.linspace(-pi, pi, 37)[:-1]] * (size - 1)), axis=-1).reshape(-1, size - 1)
    tallest = sorted(grid, key=radius)[-4:]
    options = {"xatol": 1e-9, "fatol": 1e-13}
    mu = max(-minimize(lambda x: -radius(x), start, method="Nelder-Mead", options=options).fun for start in tallest)
    found = structured_singular_value(matrix)
    assert found.upper == pytest.approx(mu, rel=1e-7)  # the tolerance of the search for D
    assert found.lower == pytest.approx(mu, rel=1e-7)
    # the δ behind the lower bound makes I − M diag(δ) singular; none smaller does
    values = np.linalg.eigvals(matrix * found.phases)
    delta = found.phases / values[np.argmax(np.abs(values))]
    assert np.abs(delta) == pytest.approx(np.full(size, 1 / found.lower), rel=1e-12)
    assert abs(np.linalg.det(np.eye(size) - matrix * delta)) < 1e-10
    rng = np.random.default_rng(seed)
    for _ in range(300):
        smaller = np.exp(2j * pi * rng.random(size)) * (1 - 1e-3) / mu
        assert np.abs(np.linalg.eigvals(matrix * smaller)).max() < 1


@pytest.mark.parametrize("size", range(2, 8))
def test_slycot_finds_the_same_upper_bound(size):
    """AB13MD (Fan, Tits and Doyle 1991) minimises the same bound by another method: it may stop above the least one, never below."""
    slycot = pytest.importorskip("slycot")
    rng = np.random.default_rng([2, size])
    for _ in range(12):
        matrix = complex_normal(rng, size, size) * np.exp(2 * rng.normal(size=(size, 1)))
        found, other = structured_singular_value(matrix), slycot.ab13md(matrix, np.full(size, 1), np.full(size, 2))[0]
        assert found.upper == pytest.approx(other, rel=1e-3)
        assert found.upper <= other * (1 + 2e-7)  # the tolerance of ours
        assert 0.9 * found.upper < found.lower <= found.upper  # how good the power iteration is; no theorem


@pytest.mark.slow
@pytest.mark.parametrize("size", [4, 5, 7])
def test_both_bounds_against_general_optimizers(size):
    """From above: no D that a descent by differences finds is better. From below: no phases that a climb finds pass the bound."""
    rng = np.random.default_rng([6, size])
    for _ in range(3):
        matrix = complex_normal(rng, size, size) * np.exp(rng.normal(size=(size, 1)))
        found = structured_singular_value(matrix)
        assert largest(scaled(matrix[None], found.scaling[None]))[0] == pytest.approx(found.upper, rel=1e-12)

        def norm(x: np.ndarray, power: float, matrix: np.ndarray = matrix) -> float:
            values = np.linalg.svd(scaled(matrix[None], np.append(0.0, x)[None])[0], compute_uv=False)
            return np.log(values[0]) + np.log(np.sum((values / values[0]) ** power)) / power

        x = np.zeros(size - 1)
        for power in (8.0, 64.0, 512.0, 4096.0):
            x = minimize(norm, x, args=(power,), method="BFGS").x
        other = largest(scaled(matrix[None], np.append(0.0, x)[None]))[0]
        assert found.upper <= other * (1 + 2e-7)  # the tolerance of ours
        assert found.upper == pytest.approx(other, rel=3e-3)  # log(n)/4096, and differences that no longer tell where the descent goes

        def radius(phases: np.ndarray, matrix: np.ndarray = matrix) -> float:
            return np.abs(np.linalg.eigvals(matrix * np.exp(1j * np.append(0.0, phases)))).max()

        climbs = [-minimize(lambda p: -radius(p), start, method="BFGS").fun for start in rng.uniform(-pi, pi, (8, size - 1))]
        assert max(climbs) <= found.upper * (1 + 1e-9)
        assert found.lower >= max(climbs) * (1 - 1e-2)  # how good the power iteration is; no theorem


@pytest.mark.parametrize("size", [2, 5, 12, 32])
def test_closed_forms(size):
    """Diagonal: the largest entry. u vᴴ: Σ|u_i v_i|. Unitary: 1. Upper triangular: the largest of the diagonal (D sends the rest to 0)."""
    rng = np.random.default_rng([3, size])
    u, v = complex_normal(rng, size), complex_normal(rng, size)
    unitary = np.linalg.qr(complex_normal(rng, size, size))[0]
    for matrix, mu in (
        (np.diag(u), np.abs(u).max()),
        (np.outer(u, v.conj()), np.abs(u * v).sum()),
        (unitary, 1.0),
        (np.zeros((size, size), dtype=complex), 0.0),
    ):
        found = structured_singular_value(matrix)
        assert found.upper == pytest.approx(mu, rel=1e-6, abs=1e-12)
        assert found.lower <= found.upper
    triangular = np.triu(complex_normal(rng, size, size))
    # the infimum is not reached: D stays within what SMALLEST_ENTRY = 1e-9 leaves it
    assert structured_singular_value(triangular).upper == pytest.approx(np.abs(np.diag(triangular)).max(), rel=1e-3)


@pytest.mark.parametrize("size", [2, 3, 6, 12])
def test_symmetries(size):
    """μ does not change under D M D⁻¹, diagonal unitary factors, permutation, transposition; it scales with M; equal blocks add nothing."""
    rng = np.random.default_rng([4, size])
    matrix = complex_normal(rng, size, size)
    mu = structured_singular_value(matrix).upper
    scale, order = np.exp(3 * rng.normal(size=size)), rng.permutation(size)
    turned = np.exp(2j * pi * rng.random((2, size)))
    same = (
        matrix * scale[:, None] / scale,
        matrix * turned[0][:, None] * turned[1],
        matrix[np.ix_(order, order)],
        matrix.T,
        matrix.conj().T,
        np.kron(np.eye(2), matrix),
    )
    for other in same:
        assert structured_singular_value(other).upper == pytest.approx(mu, rel=5e-7)  # both within TOLERANCE of the least
    assert structured_singular_value(1e-7j * matrix).upper == pytest.approx(1e-7 * mu, rel=5e-7)


@pytest.mark.parametrize(
    "call",
    [
        lambda: _core.balanced(np.ones((2, 3, 4), dtype=complex)),
        lambda: _core.balanced(np.ones((2, 0, 0), dtype=complex)),
        lambda: _core.improved(np.ones((2, 3, 3), dtype=complex), np.zeros((1, 3)), 1e-7),
        lambda: _core.from_below(np.ones((2, 3), dtype=complex), 1.0),
        lambda: _core.disk_peak(np.arange(3.0), np.ones((2, 2, 2), dtype=complex), lambda _: np.eye(2, dtype=complex)),
        lambda: _core.disk_peak(np.arange(3.0), np.ones((3, 2, 2), dtype=complex), lambda _: np.eye(3, dtype=complex)),
        lambda: _core.DiskModes(np.ones(2, dtype=complex), *[np.ones((1, 3), dtype=complex)] * 2, np.ones(3), np.ones(3), 0.0),
        lambda: _core.DiskModes(np.ones(1, dtype=complex), *[np.ones((1, 3), dtype=complex)] * 2, np.ones(2), np.ones(3), 0.0),
    ],
)
def test_shapes_that_do_not_fit(call):
    with pytest.raises(ValueError, match=r"must be|do not fit"):
        call()


def test_many_at_once_are_as_good_as_one_by_one():
    rng = np.random.default_rng(5)
    matrices = complex_normal(rng, 9, 6, 6) * np.exp(2 * rng.normal(size=(9, 6, 1)))
    x, upper = improved(matrices, balanced(matrices))
    assert upper == pytest.approx(largest(scaled(matrices, x)), rel=1e-12)
    assert upper == pytest.approx([structured_singular_value(one).upper for one in matrices], rel=5e-7)
