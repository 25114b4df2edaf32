"""The multi-loop disk margin: closed forms, brute force, other libraries, symmetries, and roots of the loops that it speaks about."""

from dataclasses import replace
from math import inf, isinf, pi, sqrt

import numpy as np
import pytest
from scipy.linalg import matrix_balance
from scipy.optimize import minimize

import gainroom as gr
from draws import draw_plant, draw_setup
from gainroom import _disk_modes, multiloop_disk
from gainroom._disk_modes import Modes, expanded, opened_at_torques
from gainroom._mu import balanced, improved, largest, scaled, structured_singular_value
from gainroom.multiloop_disk import TOLERANCE, disk_margin, disk_margin_of

SAME = 1e-6  # how far the peak is polished (AGREEMENT)


def complex_normal(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def robot(seed: int, size: int, delay: float = 2e-3, sample_time: float | None = None, full: bool = False, **plant) -> gr.Loop:
    """A stable loop of coupled joints of any gains, lowered until it has some room."""
    rng = np.random.default_rng([11, seed])
    kp, kd = rng.uniform(50, 200, size), rng.uniform(2, 10, size)
    if full:
        turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
        kp, kd = (turn @ np.diag(gain) @ turn.T for gain in (kp, kd))
    drive = gr.Drive(3000.0, 0.9, delay)
    loop = gr.build_loop(draw_plant(rng, size, **plant), drive, gr.PD(kp, kd), sample_time=sample_time)
    return next(loop.scaled(factor) for factor in 0.5 ** np.arange(20) if gr.is_stable(loop.scaled(factor * 1.2)))


def torque_side(loop: gr.Loop, omega: np.ndarray) -> np.ndarray:
    """L opened at the motor torques (k, n, n), continuous time."""
    return loop.gain * loop.open_loop.at(1j * omega) * np.exp(-1j * omega[:, None] * loop.delays)[:, None, :]


# --- the structured singular value of one matrix -------------------------------------------------------------------------------------


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
    # the infimum is not reached: D stays within what ROOM = 1e-9 leaves it
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


def test_many_at_once_are_as_good_as_one_by_one():
    rng = np.random.default_rng(5)
    matrices = complex_normal(rng, 9, 6, 6) * np.exp(2 * rng.normal(size=(9, 6, 1)))
    x, upper = improved(matrices, balanced(matrices))
    assert upper == pytest.approx(largest(scaled(matrices, x)), rel=1e-12)
    assert upper == pytest.approx([structured_singular_value(one).upper for one in matrices], rel=5e-7)


# --- loops: known answers -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(8))
def test_one_joint_has_its_own_margin(seed, sampled):
    """n = 1: the number that `margins` gives, and the search for any response finds it too."""
    drawn = (draw_setup(np.random.default_rng([12, seed, attempt]), sampled).loop() for attempt in range(50))
    loop = next(loop.scaled(factor) for loop in drawn for factor in 0.4 ** np.arange(6) if gr.is_stable(loop.scaled(factor)))
    found, disk = gr.margins(loop), disk_margin(loop)
    assert disk.margin == found.disk_margin
    assert disk.frequency == found.disk_margin_frequency
    assert disk.certified
    if disk.margin < 2:
        assert np.abs((disk.factors - 1) / (disk.factors + 1)) * 2 == pytest.approx([disk.margin], rel=1e-9)
        around = disk.frequency if disk.frequency > 0 else 1.0
        last = pi / loop.sample_time if sampled else inf
        searched = disk_margin_of(loop.response, np.geomspace(1e-4 * around, min(1e4 * around, last), 400))
        assert searched.margin == pytest.approx(disk.margin, rel=SAME)
        assert not searched.certified


@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", range(5))
def test_joints_that_do_not_feel_each_other(seed, sample_time):
    """Diagonal L: the smallest of the single margins, which the certified scan of one loop knows; loops near their limit peak sharply."""
    rng = np.random.default_rng([13, seed])
    size = int(rng.integers(2, 5))
    joints = [gr.ElasticJoint(*rng.uniform(0.2, 1.0, 2), rng.uniform(3e3, 3e4), rng.uniform(0.1, 1.0)) for _ in range(size)]
    drives = [gr.Drive(rng.uniform(1500, 4000), 0.9, rng.uniform(0, 3e-3)) for _ in joints]
    kp, kd = rng.uniform(20, 60, size), rng.uniform(1, 4, size)
    singles = [gr.build_loop(j, d, gr.PD(p, v), sample_time=sample_time) for j, d, p, v in zip(joints, drives, kp, kd, strict=True)]
    plant = gr.Plant(
        np.diag([1 / joint.link_inertia for joint in joints]),
        *(np.array([getattr(joint, name) for joint in joints]) for name in ("motor_inertia", "stiffness", "damping")),
    )
    limit = min(gr.gain_limit(single).gain for single in singles)
    for factor in (0.5 * limit, 0.9999 * limit):
        found = disk_margin(gr.build_loop(plant, drives, gr.PD(kp * factor, kd * factor), sample_time=sample_time))
        margins = [gr.margins(single.scaled(factor)) for single in singles]
        assert all(one.stable for one in margins)
        assert found.margin == pytest.approx(min(one.disk_margin for one in margins), rel=2 * SAME)
        assert found.certified
        assert found.lower_margin <= found.margin <= found.upper_margin * (1 + 1e-12)


def test_spinning_satellite():
    """MATLAB's example of diskmargin peaks at ω = 0, where by hand S − T = [[0.19, −4.2], [0.2, −0.21]]/0.21.

    λ² − tr λ + det = 0 of M diag(1, q) has |λ| − |det|/|λ| = |0.19| + |0.21| at the best q, so μ = (0.2 + √(0.04 + 0.8001))/0.21.
    """

    def plant_times_gain(omega: np.ndarray) -> np.ndarray:
        s = 1j * omega[:, None, None]
        plant = np.array([[-100, 10], [-10, -100]]) + s * np.array([[1, 10], [-10, 1]])
        return plant @ np.array([[1, -2], [0, 1]]) / (s**2 + 100)

    found = disk_margin_of(plant_times_gain, np.append(0.0, np.geomspace(1e-2, 9.9, 100)))
    assert found.margin == pytest.approx(0.42 / (0.2 + sqrt(0.8401)), rel=1e-7)
    assert found.upper_margin == pytest.approx(found.margin, rel=1e-7)
    assert found.frequency == 0.0
    assert (isinf(found.gap), found.lower_margin, found.certified) == (True, 0.0, False)


@pytest.mark.parametrize("sample_time", [None, 1e-3])
def test_peak_at_zero_frequency(sample_time):
    """Gravity that pulls over, g A, held by 1.5 g A: L(0) = −1.5 I, S − T = −5 I, so α = 0.4, for any inertia and any positive A."""
    rng = np.random.default_rng(14)
    half = rng.normal(size=(3, 3))
    shape = half @ half.T + np.eye(3)
    plant = gr.Plant(np.linalg.inv(2 * np.eye(3) + 0.5), 0.1, gravity_stiffness=-10 * shape)
    loop = gr.build_loop(plant, gr.Drive(), gr.PD(15 * shape, 40 * np.eye(3) + 5 * shape), sample_time=sample_time)
    assert gr.is_stable(loop)
    found = disk_margin(loop)
    assert found.frequency == 0.0
    assert found.margin == pytest.approx(0.4, rel=1e-9)
    assert found.upper_margin == pytest.approx(0.4, rel=1e-9)
    assert found.certified


def test_passive_loops_have_the_largest_margin():
    """With enough friction L + Lᴴ ≥ 0: then ‖S − T‖ ≤ 1 everywhere and → 1 as ω → ∞, so α = 2, factors from 0 to ∞."""
    loop = gr.build_loop(gr.Plant(np.array([[1.0, 0.3], [0.3, 0.7]]), 0.1, motor_viscous=20.0), gr.Drive(), gr.PD(1.0, 5.0))
    omega = np.geomspace(1e-3, 1e5, 200)
    value = loop.response(omega)
    assert np.linalg.eigvalsh(value + value.conj().swapaxes(1, 2)).min() >= 0
    found = disk_margin(loop)
    assert found.margin == pytest.approx(2.0, rel=1e-9)
    assert found.lower_margin == pytest.approx(2.0, rel=TOLERANCE)
    assert found.certified


def test_no_gains_at_all():
    plant = gr.Plant(np.eye(2), 0.1)
    found = disk_margin(gr.build_loop(plant, gr.Drive(), gr.PD(0.0, 0.0)))
    assert (found.margin, found.certified) == (2.0, True)
    # one joint without a controller is free to drift: the verdict is "unstable", but asking still does no harm
    assert disk_margin(gr.build_loop(plant, gr.Drive(), gr.PD(np.array([1.0, 0.0]), np.array([1.0, 0.0])))).margin <= 2


# --- loops: what the margin promises ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("full", [False, True], ids=["diagonal", "full"])
@pytest.mark.parametrize("size", [2, 3])
def test_factors_move_a_root_to_the_axis(size, full):
    """Without delay the roots with complex factors are eigenvalues of a − b diag(f) c: on the axis at α, all left of it below."""
    loop = robot(size, size, delay=0.0, full=full)
    found = disk_margin(loop)
    assert found.upper_margin == pytest.approx(found.margin, rel=10 * SAME)  # n ≤ 3
    system, rng = loop.open_loop, np.random.default_rng(size)

    def roots(delta: np.ndarray) -> np.ndarray:
        return np.linalg.eigvals(system.a - loop.gain * system.b @ np.diag((2 + delta) / (2 - delta)) @ system.c)

    critical = 2 * (found.factors - 1) / (found.factors + 1)
    assert np.abs(critical) == pytest.approx(np.full(size, found.upper_margin), rel=1e-9)
    # a root is a few digits worse than the eigenvalue solver's rounding of the fastest pole
    assert np.abs(roots(critical) - 1j * found.frequency).min() < 1e-6 * found.frequency
    assert roots(critical * (1 + 1e-3)).real.max() > 0
    for _ in range(200):
        assert roots(np.exp(2j * pi * rng.random(size)) * found.margin * (1 - 1e-3)).real.max() < 0


@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", range(3))
def test_gains_within_the_disk_keep_the_loop_stable(seed, sample_time):
    """Every joint's torque multiplied by its own factor, anywhere in [(2 − α)/(2 + α), (2 + α)/(2 − α)]: stable at the corners drawn."""
    loop = robot(seed, 4, sample_time=sample_time)
    found = disk_margin(loop)
    assert found.certified
    rng = np.random.default_rng([15, seed])
    ends = (2 - found.lower_margin) / (2 + found.lower_margin), (2 + found.lower_margin) / (2 - found.lower_margin)
    for _ in range(6):
        factors = rng.choice(ends, size=4)
        changed = gr.PD(loop.gain * factors * loop.parts.controller.kp, loop.gain * factors * loop.parts.controller.kd)
        assert gr.is_stable(gr.build_loop(loop.parts.plant, loop.parts.drives, changed, sample_time=sample_time))


@pytest.mark.parametrize("full", [False, True], ids=["diagonal", "full"])
def test_factors_with_delay(full):
    """At the peak det(I + L diag(f)) = 0, with L from the state space and the exact delay; with diagonal gains also from the response."""
    loop = robot(7, 7, full=full)
    found = disk_margin(loop)
    at = np.array([found.frequency])
    opened = [torque_side(loop, at)[0]] if full else [torque_side(loop, at)[0], loop.response(at)[0]]
    for value in opened:
        singular = np.linalg.svd(np.eye(7) + value * found.factors, compute_uv=False)
        assert singular[-1] < 1e-9 * singular[0]
    assert 0.99 * found.upper_margin < found.margin <= found.upper_margin * (1 + 1e-12)


# --- loops: between frequencies --------------------------------------------------------------------------------------------------------

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


@pytest.mark.parametrize("kind", KINDS)
def test_bounds_hold_between_frequencies(kind):
    """σ_max of D (S − T) D⁻¹ on intervals of any width, anywhere, with S − T from the state space in full, stays below the bound."""
    loop = robot(21, 5, **KINDS[kind])
    modes = opened_at_torques(loop).modes()
    rng = np.random.default_rng(22)
    highest = 2e4 if loop.sample_time is None else pi / loop.sample_time
    middle = np.exp(rng.uniform(np.log(0.3), np.log(0.9 * highest), 60))
    half = np.minimum(middle * np.exp(rng.uniform(np.log(1e-3), np.log(0.9), 60)), highest - middle)
    expansion = expanded(modes, middle - half, middle + half)
    x = balanced(expansion.matrices[0]) + 0.3 * rng.normal(size=(60, 5))
    for enough in (0.0, inf):
        bound, rest = expansion.bounds(np.arange(60), x, enough)
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
            assert np.median(bound[narrow] / largest(scaled(expansion.matrices[0], x))[narrow]) < 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_modes_give_back_the_response(kind):
    """S − T has the same trace wherever the loops are opened; `response` knows no state space in continuous time, nor modes."""
    loop = robot(20, 5, **KINDS[kind])
    modes = opened_at_torques(loop).modes()
    omega = np.geomspace(0.1, 2e4 if loop.sample_time is None else pi / loop.sample_time, 60)
    direct = 2 * np.linalg.inv(np.eye(5) + loop.response(omega)) - np.eye(5)
    found = modes.matrices(omega)
    # what remains is rounding, largest in the response of a closed chain at low frequency
    assert np.trace(found, axis1=1, axis2=2) == pytest.approx(np.trace(direct, axis1=1, axis2=2), abs=1e-7)
    assert np.abs(np.linalg.det(found)) == pytest.approx(np.abs(np.linalg.det(direct)), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_higher_on_a_fine_grid(kind):
    """The least σ_max over D at 2000 more frequencies never exceeds what was proved, and the proof is within its tolerance."""
    loop = robot(23, 5, **KINDS[kind])
    found = disk_margin(loop)
    assert found.certified
    assert 0 <= found.gap <= TOLERANCE * (1 + 1e-9)
    assert found.lower_margin == pytest.approx(found.margin, rel=TOLERANCE)
    modes = opened_at_torques(loop).modes()
    omega = np.geomspace(1e-2, min(1e5, modes.last), 2000)
    values = modes.matrices(omega)
    x = balanced(values)
    heights = largest(scaled(values, x))
    high = np.flatnonzero(heights > 2 / found.margin)
    heights[high] = improved(values[high], x[high])[1] if len(high) else heights[high]
    assert heights.max() <= 2 / found.lower_margin * (1 + 1e-9)


def test_bounds_hold_while_only_the_delay_turns():
    """N nearly constant, E turning by up to a radian on an interval: what is left out of E's expansion must be covered too."""
    rng = np.random.default_rng(27)
    delays = np.array([0.1, 0.07])
    for _ in range(40):
        turn, through = complex_normal(rng, 2, 2, 2) * 0.35
        poles = np.full(2, -1e6 + 0j)
        modes = Modes(poles, turn, -through * poles, delays, np.array([0.9, 1.1]), 0.0)
        middle, half = rng.uniform(20, 200, 30), np.exp(rng.uniform(np.log(0.1), np.log(10), 30))
        expansion = expanded(modes, middle - half, middle + half)
        x = balanced(expansion.matrices[0])
        bound, rest = expansion.bounds(np.arange(30), x, 0.0)
        for k in np.flatnonzero(np.isfinite(bound)):
            delta = np.linspace(-half[k], half[k], 41)
            values, every = modes.matrices(middle[k] + delta), np.repeat(x[k][None], 41, axis=0)
            assert largest(scaled(values, every)).max() <= bound[k] * (1 + 1e-9)
            quadratic = sum(matrix[k] * delta[:, None, None] ** power for power, matrix in enumerate(expansion.matrices))
            assert largest(scaled(values - quadratic, every)).max() <= rest[k] * (1 + 1e-9) + 1e-12


@pytest.mark.parametrize("sample_time", [0.0, 0.1])
def test_distances_of_poles(sample_time):
    rng = np.random.default_rng(28)
    poles = rng.uniform(-20, 5, 40) + 1j * rng.uniform(-30, 30, 40)
    modes = Modes(poles, np.ones((40, 2)), np.ones((2, 40)), np.zeros(2), np.ones(2), sample_time)
    low = rng.uniform(0, 25, 50)
    high = np.minimum(low + rng.uniform(0, 20, 50), modes.last)
    omega = np.linspace(low, high, 4001)
    sampled = np.abs(modes.variable(omega.ravel())[:, None] - poles).reshape(4001, 50, 40).min(axis=0)
    found = modes.distances(low, high)
    assert np.all(found <= sampled * (1 + 1e-12))
    assert found == pytest.approx(sampled, abs=3e-3)  # the spacing of the samples


def test_tail():
    """Beyond `end` the loop is too weak, whatever the delays; and `end` is not much farther than it has to be."""
    rng = np.random.default_rng(29)
    for drive in (gr.Drive(3000.0, 0.9, 2e-3), gr.Drive(delay=2e-3)):
        modes = opened_at_torques(replace(robot(24, 4), parts=replace(robot(24, 4).parts, drives=(drive,) * 4))).modes()
        for height in (1.001, 1.1, 2.0):
            end = modes.end(height)
            later = [replace(modes, delays=rng.uniform(0, 0.01, 4)) for _ in range(20)]

            def highest(omega: np.ndarray, loops: list = later) -> float:
                return max(largest(scaled(values, balanced(values))).max() for values in (one.matrices(omega) for one in loops))

            assert highest(end * np.geomspace(1, 1e3, 200)) < height
            assert highest(end / np.geomspace(10, 12, 50)) > height or height == 2  # near the poles the expansion in 1/s is poor


def test_sharp_peaks_are_found():
    """A joint 1e-6 from its limit peaks within a few parts in a million of its frequency: |S − T| ~ 2e6, coupled or not."""
    loop = robot(25, 3)
    limit = gr.gain_limit(loop)
    found = disk_margin(loop.scaled(limit.gain * (1 - 1e-6)))
    assert found.certified
    assert found.frequency == pytest.approx(limit.frequency, rel=1e-3)
    # one factor 1/(1 − 1e-6) on all loops loses them: α ≤ 2 (f − 1)/(f + 1)
    assert found.margin < 1e-6 * (1 + 1e-5)
    assert found.upper_margin == pytest.approx(found.margin, rel=1e-4)


def test_work_limit_and_modes_that_disagree(monkeypatch):
    loop = robot(26, 3)
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


# --- loops: symmetries and other libraries ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sample_time", [None, 5e-4])
def test_order_and_units_of_the_joints_do_not_matter(sample_time):
    """Joints renumbered, and joint k measured in units u_k: W → u W u, inertias, stiffness and gains → ·/u², torques ·/u."""
    rng = np.random.default_rng(31)
    plant = draw_plant(rng, 4)
    kp, kd = np.diag(rng.uniform(20, 60, 4)) + 3.0, np.diag(rng.uniform(1, 3, 4)) + 0.1
    units, order = np.exp(rng.normal(size=4)), np.array([2, 0, 3, 1])

    def margin(plant: gr.Plant, kp: np.ndarray, kd: np.ndarray) -> float:
        loop = gr.build_loop(plant, gr.Drive(3000.0, 0.9, 1e-3), gr.PD(kp, kd), sample_time=sample_time)
        assert gr.is_stable(loop)
        found = disk_margin(loop)
        assert found.certified
        return found.margin

    names = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
    pick = np.ix_(order, order)
    renamed = replace(
        plant,
        joint_names=(),
        link_inverse_inertia=plant.link_inverse_inertia[pick],
        **{name: getattr(plant, name)[order] for name in names},
    )
    squares = np.outer(units, units)
    rescaled = replace(
        plant,
        link_inverse_inertia=plant.link_inverse_inertia * squares,
        **{name: getattr(plant, name) / units**2 for name in names},
    )
    here = margin(plant, kp, kd)
    assert margin(renamed, kp[pick], kd[pick]) == pytest.approx(here, rel=SAME)
    assert margin(rescaled, kp / squares, kd / squares) == pytest.approx(here, rel=SAME)


def test_equal_legs():
    """Two equal legs that hardly feel each other: every singular value comes twice, and the margin is that of one leg."""
    rng = np.random.default_rng(32)
    leg = draw_plant(rng, 3)
    kp, kd = rng.uniform(20, 60, 3), rng.uniform(1, 3, 3)
    names = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
    drive = gr.Drive(3000.0, 0.9, 2e-3)
    one = disk_margin(gr.build_loop(leg, drive, gr.PD(kp, kd)))
    for coupling, tolerance in ((0.0, SAME), (1e-6, 1e-4)):
        both = gr.Plant(np.kron(np.eye(2), leg.link_inverse_inertia) + coupling, **{name: np.tile(getattr(leg, name), 2) for name in names})
        two = disk_margin(gr.build_loop(both, drive, gr.PD(np.tile(kp, 2), np.tile(kd, 2))))
        assert two.certified
        assert two.margin == pytest.approx(one.margin, rel=tolerance)


@pytest.mark.parametrize(("size", "full"), [(2, False), (4, True), (7, False)])
def test_python_control_finds_the_same(size, full):
    """Rational loops, opened at the torques. Its answer is the least on a grid that holds our peak: never below what we proved."""
    pytest.importorskip("slycot")
    control = pytest.importorskip("control")
    loop = robot(41, size, delay=0.0, full=full)
    found = disk_margin(loop)
    system = loop.open_loop
    # slycot's frequency response of S loses digits where states are badly scaled: they are given to it balanced
    scale = matrix_balance(system.a - loop.gain * system.b @ system.c, permute=False, separate=True)[1][0]
    opened = control.ss(system.a * scale / scale[:, None], system.b / scale[:, None], loop.gain * system.c * scale, system.d)
    grid = np.sort(np.append(np.geomspace(1, 1e4, 40), found.frequency))
    least = control.disk_margins(opened, grid)[0]
    assert least == pytest.approx(found.margin, rel=1e-3)
    assert least > found.lower_margin * (1 - 1e-5)


@pytest.mark.parametrize(
    ("response", "omega", "words"),
    [
        (lambda w: np.ones((len(w), 2, 3)), [1.0, 2.0, 3.0], r"shape \(3, 2, 3\) must be finite, of shape \(3, n, n\)"),
        (lambda w: np.full((len(w), 2, 2), np.nan), [1.0, 2.0, 3.0], "must be finite"),
        (lambda w: np.ones((len(w), 2, 2)), [1.0, 2.0], "at least three finite frequencies >= 0"),
        (lambda w: np.ones((len(w), 2, 2)), [-1.0, 2.0, 3.0], "at least three finite frequencies >= 0"),
        (lambda w: np.ones((len(w), 2, 2)), [1.0, 2.0, inf], "at least three finite frequencies >= 0"),
    ],
)
def test_bad_responses_are_named(response, omega, words):
    with pytest.raises(gr.GainroomError, match=words):
        disk_margin_of(response, np.array(omega))
