"""The largest and smallest factor on all gains, with a certificate from both sides; unstable loops; several joints."""

import contextlib
from itertools import pairwise
from math import inf, isinf, isnan, pi

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from draws import draw_plant, draw_setup
from gainroom.analysis import gain_limit as limits
from gainroom.analysis.stability import scan_loop, unstable_roots
from gainroom.analysis.stability_boundary import in_blocks
from independent.loci.limit import coupled_limit
from independent.loci.loci import Sweep
from independent.loci.resolution import LOCI
from independent.quick_margins import quick_margins


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(60))
def test_limit_is_confirmed_from_both_sides(seed, sampled):
    """Whatever the loop: inside the claimed interval of factors it is stable, just outside it is not, and the mode is at that frequency."""
    loop = draw_setup(np.random.default_rng([1, seed]), sampled).loop()
    limit = gr.gain_limit(loop)
    assert limit.stable == gr.is_stable(loop)
    if limit.gain == 0 or isnan(limit.lower_gain):
        assert not limit.stable
        for factor in (0.9, 0.3, 1e-2, 1e-4):
            assert not gr.is_stable(loop.scaled(factor))
        return
    assert 0 <= limit.lower_gain < limit.gain
    assert (limit.lower_gain < 1 < limit.gain) if limit.stable else (limit.gain < 1)
    if isinf(limit.gain):
        assert limit.certificate is None
        assert gr.is_stable(loop.scaled(1e4))
        return
    assert limit.certificate is not None
    assert limit.certificate.holds
    assert unstable_roots(loop.scaled(limit.gain * (1 - 1e-8))) == 0
    assert unstable_roots(loop.scaled(limit.gain * (1 + 1e-8))) > 0
    if limit.lower_gain > 0:
        assert unstable_roots(loop.scaled(limit.lower_gain * (1 + 1e-8))) == 0
        assert unstable_roots(loop.scaled(limit.lower_gain * (1 - 1e-8))) > 0
    critical = gr.rightmost_roots(loop.scaled(limit.gain), count=2).roots
    assert abs(critical[0].real) < 1e-7 * max(abs(critical[0]), 1.0)
    assert np.abs(np.abs(critical.imag) - limit.frequency).min() < 1e-6 * max(limit.frequency, 1.0)


@pytest.mark.parametrize("seed", range(25))
def test_limit_of_a_stable_loop_is_its_gain_margin(seed):
    loop = draw_setup(np.random.default_rng([2, seed]), sampled=bool(seed % 2)).loop()
    found, limit = gr.margins(loop), gr.gain_limit(loop)
    if found.stable:
        assert limit.gain == found.gain_margin
        assert limit.lower_gain == found.lower_gain_margin
        assert limit.frequency == found.phase_crossover or isinf(limit.gain)


@pytest.mark.parametrize("factor", [1.5, 4.0, 50.0])
def test_too_high_gains_get_a_factor_below_one(factor):
    """Of an unstable loop the limit is the way back: the same gains, the same frequency."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2.5e-3), gr.PD(2000.0, 30.0))
    first = gr.gain_limit(loop)
    lost = gr.gain_limit(loop.scaled(first.gain * factor))
    assert not lost.stable
    assert lost.gain == pytest.approx(1 / factor, rel=1e-11)
    assert lost.frequency == pytest.approx(first.frequency, rel=1e-11)
    assert lost.certificate.holds


def test_integrator_with_delay():
    """s + g e^{−s}: g < π/2, at π/2 rad/s."""
    loop = gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 0.0]), delay=1.0)
    limit = gr.gain_limit(loop)
    assert limit.gain == pytest.approx(pi / 2, rel=1e-14)
    assert limit.frequency == pytest.approx(pi / 2, rel=1e-14)
    assert limit.lower_gain == 0.0
    assert limit.mode == pytest.approx([1.0])


def test_thousands_of_crossings_are_not_counted_one_by_one(monkeypatch):
    """g e^{−s}/s, with a root that crosses at every g = π/2 + 2πk: from g = 10 000 the way back is still π/2, found in a few counts."""
    counts = []

    def counted(loop, *scan):
        counts.append(loop)
        return unstable_roots(loop, *scan)

    monkeypatch.setattr(limits, "unstable_roots", counted)
    limit = gr.gain_limit(gr.loop_from(scipy.signal.TransferFunction([1e4], [1.0, 0.0]), delay=1.0))
    assert limit.gain == pytest.approx(pi / 2 / 1e4, rel=1e-14)
    assert limit.certificate.holds
    assert len(counts) <= 5  # at g = 1, at the upper interval, at the one that is found, and the certificate


@pytest.mark.parametrize("seed", range(40))
def test_the_way_back_is_the_same_when_every_interval_is_counted(seed):
    """Loops with unstable poles and zeros: roots carried from interval to interval against a count in each."""
    rng = np.random.default_rng([8, seed])
    poles = [*rng.uniform(-5, 1, 2), *(rng.uniform(-2, 0.3) + rng.uniform(1, 30) * np.array([1j, -1j])), 0.0]
    zeros = rng.uniform(-5, 1, int(rng.integers(0, 4)))
    system = scipy.signal.TransferFunction(10 ** rng.uniform(1, 3) * np.poly(zeros), np.real(np.poly(poles)))
    loop = gr.loop_from(system, delay=float(rng.uniform(0, 0.2)))
    limit = gr.gain_limit(loop)
    if limit.stable:
        return
    crossings = sorted(1 / size for _, size, _ in scan_loop(loop, with_peaks=False).phases.tolist() if 1 / size <= 1)
    edges = [0.5 * crossings[0], *crossings] if crossings else []
    inside = [high for low, high in pairwise(edges) if unstable_roots(loop.scaled((low * high) ** 0.5)) == 0]
    assert limit.gain == pytest.approx(max(inside, default=0.0), rel=1e-14)


def test_conditionally_stable_loops_have_both_ends():
    """g (s + 1)²/s³ · 1/(s/50 + 1)²: stable between two factors, both roots of a polynomial in ω²."""
    numerator, denominator = np.array([1.0, 2.0, 1.0]), np.polymul([1.0, 0, 0, 0], np.polymul([0.02, 1.0], [0.02, 1.0]))
    limit = gr.gain_limit(gr.loop_from(scipy.signal.TransferFunction(3 * numerator, denominator)))
    factors = []
    for omega in np.roots(imaginary_part(numerator, denominator)):
        if abs(omega.imag) < 1e-9 and omega.real > 1e-6:
            s = 1j * omega.real
            factors.append(-np.real(np.polyval(denominator, s) / np.polyval(numerator, s)) / 3)
    assert [limit.lower_gain, limit.gain] == pytest.approx(sorted(factors), rel=1e-9)  # roots of a polynomial of degree seven
    assert limit.stable


def imaginary_part(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    """Polynomial in ω of Im(denominator(jω) · conj(numerator(jω)))."""
    along = [p * (1j ** np.arange(len(p) - 1, -1, -1)) for p in (denominator, numerator)]
    return np.imag(np.polymul(along[0], along[1].conj()))


def test_unstable_at_any_gain():
    """Link-side PD on an undamped joint: no factor helps."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 0.0), gr.Drive(delay=1e-3), gr.PD(100.0, 1.0), feedback="link")
    limit = gr.gain_limit(loop)
    assert (limit.stable, limit.gain, limit.certificate) == (False, 0.0, None)
    assert isnan(limit.lower_gain)
    assert isnan(limit.frequency)


def test_stable_at_any_gain():
    limit = gr.gain_limit(gr.build_loop(gr.ElasticJoint(0.4, 0.6), gr.Drive(), gr.PD(25.0, 6.0)))
    assert (limit.stable, limit.gain, limit.lower_gain, limit.certificate) == (True, inf, 0.0, None)


def test_needs_gain_only():
    """3/(s − 1): the lower end 1/3, no upper one; below it, unstable with no stable factor below."""
    limit = gr.gain_limit(gr.loop_from(scipy.signal.TransferFunction([3.0], [1.0, -1.0])))
    assert limit.lower_gain == pytest.approx(1 / 3, rel=1e-14)
    assert isinf(limit.gain)
    weak = gr.gain_limit(gr.loop_from(scipy.signal.TransferFunction([0.5], [1.0, -1.0])))
    assert (weak.stable, weak.gain) == (False, 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_several_joints(seed):
    """A critical root at the limit, its mode in the kernel of I + L, stable just below and not just above."""
    rng = np.random.default_rng([3, seed])
    size = int(rng.integers(2, 5))
    plant = draw_plant(rng, size, rigid=int(seed % 2))
    loop = gr.build_loop(plant, gr.Drive(3000.0, 0.9, 2e-3), gr.PD(rng.uniform(30, 90, size), rng.uniform(1, 4, size)))
    limit = gr.gain_limit(loop)
    assert limit.certificate.holds
    if limit.stable:
        assert gr.is_stable(loop)
    assert gr.is_stable(loop.scaled(limit.gain * (1 - 1e-6)))
    assert not gr.is_stable(loop.scaled(limit.gain * (1 + 1e-6)))
    values = np.linalg.eigvals(loop.scaled(limit.gain).response(np.array([limit.frequency]))[0])
    assert np.abs(values + 1).min() < 1e-7
    assert np.abs(limit.mode).max() == pytest.approx(1.0, rel=1e-12)


def test_zero_gains_have_no_limit():
    with pytest.raises(gr.GainroomError, match="all gains are zero"):
        gr.gain_limit(gr.build_loop(gr.ElasticJoint(0.4, 0.6), gr.Drive(), gr.PD(0.0, 0.0)))


@pytest.mark.parametrize(("feedback", "stable"), [("motor", True), ("link", False)])
def test_several_joints_without_damping(feedback, stable):
    """Poles on the boundary itself: without delay the link side drives the resonances whatever the gains, the motor side damps them."""
    plant = gr.Plant(np.array([[2.0, -0.7], [-0.7, 1.5]]), np.array([0.5, 0.4]), 5e3, 0.0)
    loop = gr.build_loop(plant, gr.Drive(), gr.PD(40.0, 20.0), feedback=feedback)
    limit = gr.gain_limit(loop)
    assert limit.stable is stable
    assert bool(gr.rightmost_roots(loop).roots.real.max() < 0) is stable
    if not stable:
        assert limit.gain == 0


@pytest.mark.parametrize("seed", range(8))
def test_undamped_joints_that_do_not_couple_are_single_joints(seed):
    """Poles on the boundary, link side, with delay: the stable factors of two such joints are those that both of them stand."""
    rng = np.random.default_rng([5, seed])
    joints = [gr.ElasticJoint(rng.uniform(0.1, 0.5), rng.uniform(0.2, 2), rng.uniform(2e3, 9e3)) for _ in range(2)]
    gains = [(rng.uniform(50, 400), rng.uniform(0.0, 1.0)) for _ in joints]
    drive, side = gr.Drive(4000.0, 0.9, rng.uniform(1e-3, 4e-3)), "link" if seed % 2 else "motor"
    plant = gr.Plant(
        np.diag([1 / joint.link_inertia for joint in joints]),
        np.array([joint.motor_inertia for joint in joints]),
        np.array([joint.stiffness for joint in joints]),
    )
    together = gr.gain_limit(gr.build_loop(plant, drive, gr.PD(*np.array(gains).T), feedback=side))
    alone = [gr.gain_limit(gr.build_loop(joint, drive, gr.PD(*gain), feedback=side)) for joint, gain in zip(joints, gains, strict=True)]
    if all(one.stable for one in alone):
        assert together.gain == pytest.approx(min(one.gain for one in alone), rel=1e-7)
        assert together.lower_gain == pytest.approx(max(one.lower_gain for one in alone), rel=1e-7)
    assert together.stable == all(one.stable for one in alone)


def test_no_work_is_done_on_more_matrices_than_fit():
    blocks = []

    def function(omega):
        blocks.append(len(omega))
        return omega[:, None] * np.ones(3)

    size = 40
    omega = np.linspace(1, 2, 3 * LOCI.at_once // size**2 + 5)
    assert np.array_equal(in_blocks(function, omega, size), omega[:, None] * np.ones(3))
    assert max(blocks) * size**2 <= LOCI.at_once
    assert in_blocks(function, omega[:0], size).shape == (0, 3)


@pytest.mark.parametrize("seed", range(6))
def test_wild_gains_are_bounded_work(seed):
    """Gains over five decades on a closed chain: an answer or one clear sentence, from a bounded number of samples."""
    rng = np.random.default_rng([6, seed])
    plant = draw_plant(rng, 6, rank=4)
    controller = gr.PPI(10 ** rng.uniform(-1, 3, 6), 10 ** rng.uniform(-1, 4, 6), 10 ** rng.uniform(-2, 5, 6))
    loop = gr.build_loop(plant, gr.Drive(2000.0, 0.3, 1e-2), controller)
    sweep = Sweep(loop)
    with contextlib.suppress(gr.GainroomError):
        limit = coupled_limit(sweep)
        assert limit.gain == 0 or limit.certificate is None or limit.certificate.holds
    assert len(sweep.omega) < 3 * LOCI.most


@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
def test_pendula_topple_below_a_factor(sample_time):
    """Rigid inverted pendula that do not couple: each stands while g kp > m g l, and the first to topple sets the lower end."""
    plant = gr.Plant(np.eye(2), np.zeros(2), gravity_stiffness=np.diag([-500.0, -400.0]))
    for kp in (450.0, 550.0, 1000.0):
        loop = gr.build_loop(plant, gr.Drive(delay=1e-3), gr.PD(kp, 40.0), sample_time=sample_time)
        limit = gr.gain_limit(loop)
        if kp < 500:
            assert not limit.stable
            continue
        assert limit.stable
        assert limit.lower_gain == pytest.approx(500 / kp, rel=1e-10)
        assert quick_margins(loop).least_gain_margin == pytest.approx(kp / 500, rel=1e-6)  # read next to ω = 0


@pytest.mark.parametrize("seed", range(8))
def test_gravity_holds_coupled_joints_up_to_their_static_balance(seed):
    """The lower end: where g Kp in series with the gearboxes no longer holds the weight, det((g Kp)⁻¹ + K⁻¹ + G⁻¹) = 0 by scalars."""
    rng = np.random.default_rng([8, seed])
    half = rng.normal(size=(2, 2))
    weight = -(half @ half.T) * 120 - 40 * np.eye(2)
    stiffness, kp = rng.uniform(4e3, 9e3, 2), rng.uniform(900, 1500, 2)
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), stiffness, np.full(2, 2.0), gravity_stiffness=weight)
    limit = gr.gain_limit(gr.build_loop(plant, gr.Drive(4000.0, 0.9, 1e-3), gr.PD(kp, 60.0)))

    def upright(factor: float) -> bool:  # both sides in one: the potential has a minimum
        springs = np.diag(stiffness)
        return bool(np.linalg.eigvalsh(np.block([[np.diag(factor * kp) + springs, -springs], [-springs, springs + weight]]))[0] > 0)

    low, high = 0.0, 1.0
    for _ in range(60):
        low, high = (low, 0.5 * (low + high)) if upright(0.5 * (low + high)) else (0.5 * (low + high), high)
    assert upright(1.0)
    assert limit.stable
    assert limit.lower_gain == pytest.approx(high, rel=1e-9)


def test_no_gain_is_stable_beside_an_undamped_gearbox_that_is_driven():
    """Sampled, undamped, motor side, at a frequency where delay outweighs the lead: however small the gain, the resonance grows with it."""
    plant = gr.Plant(np.diag([5.0, 3.0]), np.full(2, 0.05), 5e4, 0.0)
    limit = gr.gain_limit(gr.build_loop(plant, gr.Drive(delay=2e-3), gr.PD(100.0, 1.0), sample_time=1e-3))
    for factor in (1.0, 1e-2, 1e-4):
        loop = gr.build_loop(plant, gr.Drive(delay=2e-3), gr.PD(100.0 * factor, factor), sample_time=1e-3)
        assert gr.rightmost_roots(loop).roots.real.max() > 0
    assert (limit.stable, limit.gain) == (False, 0.0)
