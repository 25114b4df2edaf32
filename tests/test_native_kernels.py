"""The core's filters against matrix algebra, and every kernel against input that does not fit."""

import math
from itertools import permutations

import numpy as np
import pytest

from gainroom.identification.current_loop import held
from gainroom.native import _core

ROWS, KINDS, NOISE, UNKNOWN = 12, 2, 0.05, 4.0


def test_the_current_loop_s_filter_is_conditioning_of_a_gaussian():
    """All torques are one Gaussian vector: the Cholesky factor of its covariance says what is left of a row under those before it."""
    rng = np.random.default_rng(3)
    command, torque, changes = rng.normal(size=ROWS), rng.normal(size=ROWS), rng.normal(size=(ROWS, KINDS))
    tick, parts, roots = rng.normal(size=(3, 3)) / 2, rng.normal(size=(KINDS, 3)), rng.normal(size=(KINDS, 3, 3)) / 3
    fresh = np.zeros(ROWS, dtype=bool)
    fresh[[0, 7]] = True
    # the state (2) and the torque as read, of each row, as a mean and as a sum of independent unit normals: two for each start, three for
    # each kind of arrival
    means, loads, at = [], [], 0
    for k in range(ROWS):
        load = np.zeros((3, ROWS * (2 + 3 * KINDS)))
        if fresh[k]:
            mean = np.array([command[k], 0.0, command[k]])
            load[[0, 1, 2], [at, at + 1, at]] = np.sqrt(UNKNOWN)  # it is read as it is
            at += 2
        else:
            mean = tick @ np.append(means[-1][:2], command[k - 1]) + changes[k] @ parts
            load = tick[:, :2] @ loads[-1][:2]
            for q in range(KINDS):
                load[:, at : at + 3] += changes[k, q] * roots[q]
                at += 3
        means.append(mean)
        loads.append(load)
    rows = 1.3 * np.array(loads)[:, 2]
    factor = np.linalg.cholesky(rows @ rows.T + NOISE**2 * np.eye(ROWS))
    rest = np.linalg.solve(factor, torque - 1.3 * np.array(means)[:, 2] - 0.2)
    error, variance = np.empty(ROWS), np.empty(ROWS)
    noises = roots @ roots.transpose(0, 2, 1)
    _core.predict_torque(command, changes, torque, fresh, tick, parts, noises, 1.3, 0.2, NOISE, UNKNOWN, error, variance)
    # Cholesky loses what the variances range over, (2 · 1.3 / 0.05)²: 1e-16 · 3e3
    assert variance == pytest.approx(np.diag(factor) ** 2, rel=1e-11)
    assert error == pytest.approx(rest * np.diag(factor), rel=1e-10)


@pytest.mark.parametrize(("first", "last"), [(0, 2), (3, 7), (5, 5)])
def test_decoding_gives_the_ages_back_that_a_torque_was_made_with(first: int, last: int):
    """Every command different, no noise: only the true history explains it."""
    rng, count = np.random.default_rng(4), 200
    target, part = rng.normal(size=count), np.array([float(value) for value in held(1.7, 0.9, 0.4)[:2]])
    ages = [last]
    while len(ages) < count:  # no older than one tick more than the one before
        ages.append(int(rng.integers(first, min(ages[-1] + 1, last) + 1)))
    whole, rate, acceleration = (float(value) for value in held(1.7, 0.9, 1.0))
    transition, full = np.array([[1 - whole, rate], [-rate, acceleration]]), np.array([whole, rate])
    state, torque = np.zeros(2), np.zeros(count)
    for k in range(last + 1, count):
        before, now = target[k - 1 - ages[k - 1]], target[k - ages[k]]
        state = transition @ state + full * before + part * (now - before)
        torque[k] = 1.1 * state[0] + 0.3
    found = np.zeros(count, dtype=np.int64)
    _core.decode(target, torque, transition, full, part, 1.1, 0.3, 1e-3, first, last, 0.0, found)
    settled = last + 40  # the state that it starts from, which is not known, is e^-30 of itself
    assert np.array_equal(found[settled:], ages[settled:])


def test_predictions_are_the_matrix_recursion():
    """With gains that change from row to row."""
    rng = np.random.default_rng(5)
    a, b, c = rng.normal(size=(5, 5)) / 4, rng.normal(size=(5, 3)), rng.normal(size=(2, 5))
    gains, regime = rng.normal(size=(3, 5, 2)) / 10, rng.integers(0, 3, 80)
    inputs, outputs, state = rng.normal(size=(80, 3)), rng.normal(size=(80, 2)), rng.normal(size=5)
    x, expected = state.copy(), []
    for k in range(80):
        expected.append(outputs[k] - c @ x)
        x = a @ x + b @ inputs[k] + gains[regime[k]] @ expected[-1]
    errors = np.empty((80, 2))
    _core.predict(a, b, c, gains, regime, inputs, outputs, state, errors)
    assert errors == pytest.approx(np.array(expected), rel=1e-9, abs=1e-11)
    assert state == pytest.approx(x, rel=1e-9, abs=1e-11)


BODY = {
    "system": np.zeros((5, 5)),
    "positions": np.eye(2),
    "rates": np.eye(2),
    "entries": np.eye(2),
    "current": np.zeros(2),
    "ideal": True,
    "coordinates": 1,
}
CONTROL = {"a": np.zeros((1, 1)), "b": np.zeros((1, 2)), "c": np.zeros(1), "d": np.zeros(2), "side": 0}
HARDWARE = {
    "tick": 1e-3,
    "cells": 2,
    "laws": np.zeros((2, 5)),
    "gravity": np.zeros(2),
    "torque_limit": 1.0,
    "resolution": np.zeros(2),
    "position_limit": 1e4,
}
RECURSION = {"transposed": np.eye(2), "forcing": np.zeros((3, 2)), "states": np.zeros((4, 2)), "limit": 1e150}
LATE = {
    "transposed": np.eye(2),
    "forcing": np.zeros((3, 2)),
    **dict.fromkeys(("rows", "before", "after"), np.zeros((1, 2))),
    "whole": np.ones(1, dtype=np.int64),
    "part": np.zeros(1),
    "states": np.zeros((4, 2)),
}
FILTER = {
    "command": np.zeros(4),
    "changes": np.zeros((4, 1)),
    "torque": np.zeros(4),
    "fresh": np.zeros(4, dtype=bool),
    "tick": np.eye(3),
    "parts": np.zeros((1, 3)),
    "noises": np.zeros((1, 3, 3)),
    **dict.fromkeys(("gain", "offset", "noise", "unknown"), 1.0),
    "error": np.zeros(4),
    "variance": np.zeros(4),
}
DECODING = {
    "target": np.zeros(9),
    "torque": np.zeros(9),
    "transition": np.eye(2),
    "full": np.zeros(2),
    "part": np.zeros(2),
    **dict.fromkeys(("gain", "offset", "noise", "change_cost"), 1.0),
    "first": 1,
    "last": 5,
    "age": np.zeros(9, dtype=np.int64),
}
PREDICTION = {
    "a": np.eye(3),
    "b": np.zeros((3, 2)),
    "c": np.zeros((1, 3)),
    "gains": np.zeros((2, 3, 1)),
    "regime": np.zeros(6, dtype=np.int64),
    "inputs": np.zeros((6, 2)),
    "outputs": np.zeros((6, 1)),
    "state": np.zeros(3),
    "errors": np.zeros((6, 1)),
}
KERNELS = [
    (_core.Body, BODY),
    (_core.Control, CONTROL),
    (_core.Hardware, HARDWARE),
    (_core.recur, RECURSION),
    (_core.recur_late, LATE),
    (_core.predict_torque, FILTER),
    (_core.decode, DECODING),
    (_core.predict, PREDICTION),
]


def grown(array: np.ndarray) -> list[np.ndarray]:
    """Arrays of another length along each axis."""
    return [np.zeros([n + (k == axis) for k, n in enumerate(array.shape)], array.dtype) for axis in range(array.ndim)]


@pytest.mark.parametrize(("kernel", "arguments"), KERNELS, ids=[kernel.__name__ for kernel, _ in KERNELS])
def test_shapes_that_do_not_fit_are_refused(kernel, arguments):
    """Each array in turn with a row or a column too many; more regimes are more to choose from, and fit."""
    kernel(**arguments)
    for name, value in arguments.items():
        if isinstance(value, np.ndarray):
            for axis, wrong in enumerate(grown(value)):
                if (name, axis) != ("gains", 0):
                    with pytest.raises(ValueError, match=r"shape|square|rows"):
                        kernel(**{**arguments, name: wrong})


@pytest.mark.parametrize(
    ("kernel", "arguments"),
    [
        (_core.Body, {**BODY, "coordinates": 2}),
        (_core.Control, {**CONTROL, "side": 2}),
        (_core.Control, {**CONTROL, "velocity": 2}),
        (_core.Hardware, {**HARDWARE, "cells": 0}),
        (_core.recur_late, {**LATE, "whole": np.zeros(1, dtype=np.int64)}),
        (_core.decode, {**DECODING, "first": -1}),
        (_core.decode, {**DECODING, "first": 6}),
        (_core.decode, {**DECODING, "last": 400}),
        (_core.predict, {**PREDICTION, "regime": np.full(6, 2)}),
        (_core.predict, {**PREDICTION, "regime": np.full(6, -1)}),
    ],
)
def test_numbers_out_of_bounds_are_refused(kernel, arguments):
    with pytest.raises(ValueError, match=r"from 0|0, the motor|at least one|at most"):
        kernel(**arguments)


@pytest.mark.parametrize(
    ("kernel", "arguments", "name"),
    [
        (_core.recur, RECURSION, "states"),
        (_core.recur_late, LATE, "states"),
        (_core.predict_torque, FILTER, "error"),
        (_core.predict_torque, FILTER, "variance"),
        (_core.decode, DECODING, "age"),
        (_core.predict, PREDICTION, "state"),
        (_core.predict, PREDICTION, "errors"),
    ],
)
def test_results_are_never_written_into_a_copy(kernel, arguments, name):
    """What cannot be written in place is refused: another type, gaps between the numbers, read-only."""
    good = arguments[name]
    frozen = good.copy()
    frozen.setflags(write=False)
    for wrong in (good.astype(np.float32), np.repeat(good, 2, axis=-1)[..., ::2], frozen):
        with pytest.raises(TypeError):
            kernel(**{**arguments, name: wrong})


def bed(longest: int = 3) -> _core.Testbed:
    return _core.Testbed(_core.Body(**BODY), _core.Control(**CONTROL), _core.Hardware(**HARDWARE), np.zeros(2), longest)


@pytest.mark.parametrize(
    ("given", "whole", "fraction"),
    [((4, 6), 4, 4), ((4, 7), 3, 4), ((4, 7), 4, 5)],
)
def test_a_testbed_s_rows_have_to_fit(given, whole, fraction):
    assert bed().advance(np.zeros((4, 7)), np.zeros(4, dtype=np.int64), np.zeros(4)).shape == (4, 7)
    with pytest.raises(ValueError, match="shape"):
        bed().advance(np.zeros(given), np.zeros(whole, dtype=np.int64), np.zeros(fraction))


@pytest.mark.parametrize("whole", [-1, 4, 2**62])
def test_no_command_is_later_than_the_testbed_remembers(whole):
    with pytest.raises(ValueError, match="longest"):
        bed().advance(np.zeros((1, 7)), np.array([whole]), np.zeros(1))


def test_late_outputs_are_a_longer_state():
    """With every earlier output in the state, a line of ones that shifts, it is one matrix: y of `whole` steps ago and of one more."""
    rng, m, whole, part = np.random.default_rng(4), 3, np.array([1, 4]), np.array([0.25, 0.7])
    a, rows, before, after = 0.5 * rng.normal(size=(m, m)), *rng.normal(size=(3, 2, m))
    forcing, depth = rng.normal(size=(40, m)), int(whole.max()) + 1
    size = m + 2 * depth  # y of 1 … depth steps ago of either output behind the state
    now, then, shift = np.zeros((2, size)), np.zeros((2, size)), np.zeros((size, size))
    for j in range(2):
        line = np.zeros((depth + 1, size))  # y of k steps ago, 0: of now
        line[0, :m] = rows[j]
        for k in range(1, depth + 1):
            line[k, m + j * depth + k - 1] = 1.0
            shift[m + j * depth + k - 1] = line[k - 1]
        now[j] = (1 - part[j]) * line[whole[j]] + part[j] * line[whole[j] + 1]
        then[j] = (1 - part[j]) * line[whole[j] - 1] + part[j] * line[whole[j]]
    shift[:m, :m] = a
    shift[:m] -= before.T @ now + after.T @ then
    state, expected = np.zeros(size), [np.zeros(m)]
    for row in forcing:
        state = shift @ state + np.concatenate([row, np.zeros(size - m)])
        expected.append(state[:m])
    states = np.zeros((41, m))
    assert _core.recur_late(a.T.copy(), forcing, rows, before, after, whole, part, states) == 40
    scale = np.abs(expected).max()  # the loop grows: forty steps of round-off of what is largest
    np.testing.assert_allclose(states, expected, rtol=1e-10, atol=1e-11 * scale)


def test_numbers_that_are_none_end_a_run_and_hang_nothing():
    """A system without bounds has no exponential; a reading that is no number makes a torque that is none, and the next row is left out."""
    state, bent = np.ones(2), np.zeros(2)
    for value in (np.nan, np.inf, 1e300):
        body = _core.Body(**{**BODY, "system": np.full((5, 5), value)})
        _core.substep(body, _core.Hardware(**{**HARDWARE, "laws": np.full((2, 5), value)}), state, bent, 1.0, np.full(3, value))
    assert not np.isfinite(state).any()
    given = np.zeros((5, 7))
    given[2] = np.nan
    found = _core.Testbed(
        _core.Body(**{**BODY, "system": np.pad(np.ones((2, 5)), ((0, 3), (0, 0)))}),
        _core.Control(**{**CONTROL, "d": np.ones(2)}),
        _core.Hardware(**HARDWARE),
        np.zeros(2),
        3,
    ).advance(given, np.zeros(5, dtype=np.int64), np.zeros(5))
    assert len(found) == 3
    assert np.isfinite(found[:2]).all()
    assert np.isnan(found[2, 4])


def test_nothing_at_all_is_no_row():
    none, empty = np.zeros(0), np.zeros((0, 1))
    assert bed().advance(np.zeros((0, 7)), np.zeros(0, dtype=np.int64), none).shape == (0, 7)
    assert _core.recur(np.zeros((0, 0)), np.zeros((3, 0)), np.zeros((4, 0)), 1.0) == 3
    assert _core.recur(np.eye(2), np.zeros((0, 2)), np.ones((1, 2)), 1e150) == 0
    rows = dict.fromkeys(("command", "torque", "error", "variance"), none)
    _core.predict_torque(**{**FILTER, **rows, "changes": empty, "fresh": np.zeros(0, dtype=bool)})
    for count in range(8):  # fewer rows than ages
        age = np.zeros(count, dtype=np.int64)
        _core.decode(**{**DECODING, "target": np.zeros(count), "torque": np.zeros(count), "age": age})
        assert np.all((age >= 1) & (age <= 5))


def test_assignments_cost_the_least_of_all_permutations():
    """Of random costs, and of whole numbers, where many are equally cheap; of no joints at all too."""
    rng = np.random.default_rng(5)
    for size in range(7):
        orders = np.array(list(permutations(range(size))), dtype=int).reshape(math.factorial(size), size)
        for cost in (rng.normal(size=(size, size)), rng.integers(0, 3, (size, size)).astype(float)):
            found = _core.assigned(cost)
            assert sorted(found) == list(range(size))
            assert cost[range(size), found].sum() == pytest.approx(cost[range(size), orders].sum(axis=1).min(), abs=1e-12)


def test_assignments_of_costs_that_are_none_are_refused():
    for cost in (np.zeros((2, 3)), np.array([[0.0, np.nan], [1.0, 2.0]]), np.array([[0.0, np.inf], [1.0, 2.0]])):
        with pytest.raises(ValueError, match="cost must be"):
            _core.assigned(cost)


def test_eigenvalues_continue_the_nearest_as_a_whole():
    """Against all permutations, by size and direction; what is not finite, or not as many, is refused."""
    rng = np.random.default_rng(7)
    before = rng.normal(size=(40, 4)) + 1j * rng.normal(size=(40, 4))
    after = rng.permuted(before, axis=1) * np.exp(rng.normal(size=(40, 4, 2)) @ [0.7, 0.7j])
    orders = np.array(list(permutations(range(4))))
    for low, high, found in zip(before, after, _core.paired(before, after), strict=True):
        distance = np.abs(np.log(high / low[:, None])) ** 2  # its imaginary part the angle between them
        assert distance[range(4), found].sum() == pytest.approx(distance[range(4), orders].sum(axis=1).min(), abs=1e-12)
    for wrong in (before[:, :3], before[:1], np.full_like(before, np.nan), np.full_like(before, np.inf)):
        with pytest.raises(ValueError, match=r"before and after must be|must be finite"):
            _core.paired(before, wrong)
    assert _core.paired(before[:0], after[:0]).shape == (0, 4)


@pytest.mark.parametrize("seed", range(20))
def test_pseudo_inverses_are_numpys(seed):
    """Of any rank: by singular values there, by reflections here."""
    draw = np.random.default_rng(seed)
    rows, columns, rank = draw.integers(1, 10, 3)
    matrix = draw.normal(size=(rows, rank)) @ draw.normal(size=(rank, columns))
    wanted = np.linalg.pinv(matrix, rcond=1e-9)
    # both lose digits where the smallest singular value that counts is small, and here it is above 1e-3
    assert np.allclose(_core.pseudo_inverse(matrix, 1e-9), wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())


@pytest.mark.parametrize("seed", range(12))
def test_exponentials_in_units_that_differ(seed):
    """e^{S A S⁻¹} = S e^A S⁻¹, entry by entry; e^A of small A by its series."""
    draw = np.random.default_rng(seed)
    size = int(draw.integers(1, 12))
    small = draw.normal(size=(size, size)) / size
    units = 2.0 ** draw.integers(-20, 20, size)  # powers of two: no digit of A is lost
    wanted, term = np.eye(size), np.eye(size)
    for k in range(1, 40):
        term = term @ small / k
        wanted = wanted + term
    found = _core.exponential(small * units[:, None] / units)
    assert np.allclose(found * units / units[:, None], wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
    assert np.isnan(_core.exponential(np.full((2, 2), np.nan))).all()
