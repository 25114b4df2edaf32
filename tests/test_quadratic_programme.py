"""The quadratic programme of the search for gains: its definition on random ones, degenerate ones too, and bad input."""

import itertools

import numpy as np
import pytest
from scipy.optimize import nnls

import native_programs
from gainroom.native import _core
from test_native_headers import compiled


def drawn(seed: int) -> tuple:
    """Up to 30 gains and 200 tangents: some alike, twice the same, in units far apart; some bounds on each other, some weights nearly 0."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 31)), int(rng.choice([0, 1, 5, 40, 200]))
    weight = rng.dirichlet(np.ones(n)) * (rng.random(n) < 0.6)
    bend, pull = weight + 1e-2, -weight
    slope = rng.normal(size=(m, n)) * 10 ** rng.uniform(-3, 3, (m, 1)) * (rng.random((m, n)) < 0.5)
    value = rng.normal(size=m) * 10 ** rng.uniform(-4, 1) - 0.1
    for k in range(1, m):
        if rng.random() < 0.2:  # as from a step that hardly changed anything
            slope[k] = slope[k - 1] * (1 + 1e-7 * rng.normal(size=n) * (rng.random() < 0.5))
            value[k] = value[k - 1]
    radius = 10 ** rng.uniform(-3, 0)
    low, high = np.full(n, -radius), np.clip(rng.normal(size=n), -radius, radius)
    return bend, pull, slope, value, float(rng.choice([1.0, 10.0, 100.0])), low, high


@pytest.mark.parametrize("seed", range(200))
def test_what_is_found_is_least(seed: int):
    """The definition: no limit is passed, and what pulls further is balanced by limits that are reached (Karush, Kuhn and Tucker)."""
    bend, pull, slope, value, penalty, low, high = drawn(seed)
    (x,), t = _core.quadratic_programme(bend, pull, slope, value, penalty, low, high)
    n, size = len(bend), np.maximum(np.abs(slope).max(axis=1, initial=0.0), 1.0)  # of a tangent's own numbers
    over = (value + slope @ x - t) / size
    assert np.all((low <= x) & (x <= high))
    assert t >= 0
    near = 1e-11 * (1 + (t + penalty) ** 2)  # round-off, as what is divided by is 1 over that; and tangents are nearly alike
    assert over.max(initial=-1.0) < near
    eye = np.eye(n + 1)
    reached = [
        np.column_stack([slope, -np.ones(len(value))])[over > -10 * near],
        -eye[-1:][[t < 10 * near]],
        eye[:-1][high - x < 10 * near],
        -eye[:-1][x - low < 10 * near],
    ]
    pulled = np.append(bend * x + pull, penalty + t)
    limits = np.vstack(reached).T
    scale = np.maximum(np.abs(limits).max(axis=0, initial=0.0), 1e-300)
    left = nnls(limits / scale, -pulled)[1] if limits.size else np.linalg.norm(pulled)
    assert left < 1e-6 * penalty


def test_one_gain_as_by_hand():
    """½ x² − x + 10 t + ½ t² with 2x − 1 ≤ t: x = ½ at t = 0, as a little more costs 20 times what it wins."""
    one = np.ones(1)
    (x,), t = _core.quadratic_programme(one, -one, np.array([[2.0]]), -one, 10.0, -one, one)
    assert (x[0], t) == pytest.approx((0.5, 0.0), abs=1e-12)
    (x,), t = _core.quadratic_programme(
        one, -one, np.array([[2.0]]), 4 * one, 0.1, -one, one
    )  # (x + 2 (2x + 4)) − 1 + 0.2 < 0: as low as allowed
    assert (x[0], t) == pytest.approx((-1.0, 2.0), abs=1e-12)
    (x,), t = _core.quadratic_programme(one, -one, np.zeros((0, 1)), np.zeros(0), 1.0, -one, 0.25 * one)
    assert (x[0], t) == (0.25, 0.0)


def test_the_order_of_gains_and_tangents_does_not_matter():
    bend, pull, slope, value, penalty, low, high = drawn(7)
    (x,), t = _core.quadratic_programme(bend, pull, slope, value, penalty, low, high)
    rng = np.random.default_rng(1)
    gains, tangents = rng.permutation(len(bend)), rng.permutation(len(value))
    (again,), other = _core.quadratic_programme(
        bend[gains], pull[gains], slope[np.ix_(tangents, gains)], value[tangents], penalty, low[gains], high[gains]
    )
    assert again == pytest.approx(x[gains], abs=1e-9)
    assert other == pytest.approx(t, abs=1e-9)


def test_shapes_that_do_not_fit():
    good = drawn(3)
    for k in itertools.chain(range(4), (5, 6)):
        bad = list(good)
        bad[k] = bad[k][:-1]
        if bad[k].shape == good[k].shape:
            continue
        with pytest.raises(ValueError, match="must have"):
            _core.quadratic_programme(*bad)


def test_what_is_not_finite_is_refused():
    for k in range(7):
        for odd in (np.nan, np.inf):
            bad = [np.array(part, dtype=float) for part in drawn(7)]
            bad[k].flat[-1] = odd
            with pytest.raises(ValueError, match="finite"):
                _core.quadratic_programme(*bad[:4], float(bad[4]), *bad[5:])


def test_large_slopes_of_a_single_gain():
    """Nothing but a bound in the way: x = −pull/bend or there."""
    for bend in (1.0, 1e-2, 1e-4):
        (x,), t = _core.quadratic_programme(
            np.array([bend]), -np.ones(1), np.zeros((0, 1)), np.zeros(0), 10.0, -np.ones(1), np.array([0.7])
        )
        assert x[0] == pytest.approx(min(1 / bend, 0.7), rel=1e-6)
        assert t == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_hostile_numbers_end():
    """NaN, infinite, zero, huge and tiny ones in every place, under the sanitizers."""
    ordinary, every = native_programs.output(compiled("programmes")).split()
    assert int(ordinary) == int(every) == 100
