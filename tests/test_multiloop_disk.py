"""The multi-loop disk margin: closed forms, other libraries, symmetries, and roots of the loops that it speaks about."""

from dataclasses import replace
from math import inf, isinf, pi, sqrt

import numpy as np
import pytest
from scipy.linalg import matrix_balance

import gainroom as gr
from draws import draw_plant, draw_robot, draw_setup
from gainroom.analysis.disk_margin import TOLERANCE, _result, disk_margin, disk_margin_of

SAME = 1e-6  # how far the peak is polished (AGREEMENT)


def torque_side(loop: gr.Loop, omega: np.ndarray) -> np.ndarray:
    """L opened at the motor torques (k, n, n), continuous time."""
    return loop.gain * loop.open_loop.at(1j * omega) * np.exp(-1j * omega[:, None] * loop.delays)[:, None, :]


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
    assert disk.margin * 0.99 <= disk.lower_margin * (1 + 1e-12)  # what is proved of one loop: 1 %
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
    loop = draw_robot(size, size, delay=0.0, full=full)
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
    loop = draw_robot(seed, 4, sample_time=sample_time)
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
    loop = draw_robot(7, 7, full=full)
    found = disk_margin(loop)
    at = np.array([found.frequency])
    opened = [torque_side(loop, at)[0]] if full else [torque_side(loop, at)[0], loop.response(at)[0]]
    for value in opened:
        singular = np.linalg.svd(np.eye(7) + value * found.factors, compute_uv=False)
        assert singular[-1] < 1e-9 * singular[0]
    assert 0.99 * found.upper_margin < found.margin <= found.upper_margin * (1 + 1e-12)


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


@pytest.mark.parametrize("size", [2, 4])
def test_what_is_certified_is_proved_to_a_thousandth(size: int):
    """Of the peak, as is documented: wider proofs are none. A gap of twice that is not called certified, one just within it is."""
    for seed in range(41, 45):
        found = disk_margin(draw_robot(seed, size))
        assert found.certified
        assert found.gap <= 1e-3 * (1 + 1e-9)
        assert found.margin * (1 - 1.001e-3) <= found.lower_margin <= found.margin
    matrix = np.diag([2.5, 1.0]).astype(complex)
    assert _result(matrix, 2.5, 10.0, np.zeros(2), 0.9e-3).certified
    assert not _result(matrix, 2.5, 10.0, np.zeros(2), 2e-3).certified


@pytest.mark.parametrize(("size", "full"), [(2, False), (4, True), (7, False)])
def test_python_control_finds_the_same(size, full):
    """Rational loops, opened at the torques. Its answer is the least on a grid that holds our peak: never below what we proved."""
    pytest.importorskip("slycot")
    control = pytest.importorskip("control")
    loop = draw_robot(41, size, delay=0.0, full=full)
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
