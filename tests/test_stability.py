"""Verdicts and rightmost roots: the Lambert function's closed form, residuals, and the two ways of counting."""

from math import e, inf, pi

import numpy as np
import pytest
import scipy.signal
from scipy.special import lambertw

import gainroom as gr
from draws import draw_plant, draw_setup
from gainroom.analysis import stability
from gainroom.analysis.stability import unstable_roots


def integrator_with_delay(gain: float, delay: float) -> gr.Loop:
    return gr.loop_from(scipy.signal.TransferFunction([gain], [1.0, 0.0]), delay=delay)


def lambert_roots(gain: float, delay: float, branches: int = 12) -> np.ndarray:
    """All roots of s + g e^{−sT}: s = W_k(−g T)/T; rightmost first."""
    roots = np.array([lambertw(-gain * delay, k) for k in range(-branches, branches + 1)]) / delay
    return roots[np.argsort(-roots.real)]


@pytest.mark.parametrize("delay", [1e-4, 0.3, 1.0, 40.0])
@pytest.mark.parametrize("gain", [0.01, 0.2, 1.0, 1.5, 5.0])
def test_integrator_with_delay(gain, delay):
    gain = gain / delay  # g T decides
    expected = lambert_roots(gain, delay)
    found = gr.rightmost_roots(integrator_with_delay(gain, delay), count=9)
    for root in found.roots:
        assert np.abs(expected - root).min() < 1e-12 * abs(root)  # Newton in double precision
    assert found.roots.real == pytest.approx(expected[: len(found.roots)].real, rel=1e-11, abs=1e-12 / delay)
    assert np.all(found.residuals < 1e-12)
    assert gr.is_stable(integrator_with_delay(gain, delay)) == (gain * delay < pi / 2)


@pytest.mark.parametrize(("pole", "gain"), [(-2.0, 1.0), (-1.0, 3.0), (0.5, 1.2), (3.0, 4.0)])
def test_first_order_with_delay(pole, gain):
    """s − p + g e^{−s}: s = p + W_k(−g e^{−p})."""
    loop = gr.loop_from(scipy.signal.TransferFunction([gain], [1.0, -pole]), delay=1.0)
    expected = np.array([pole + lambertw(-gain * np.exp(-pole), k) for k in range(-8, 9)])
    expected = expected[np.argsort(-expected.real)]
    found = gr.rightmost_roots(loop, count=7).roots
    assert found.real == pytest.approx(expected[:7].real, rel=1e-11, abs=1e-12)
    assert unstable_roots(loop) == np.sum(expected.real > 0)


def test_double_root_is_found():
    """g T = 1/e: the two real roots meet at −1/T, where Newton converges slowly and sees half the digits."""
    found = gr.rightmost_roots(integrator_with_delay(1 / e, 1.0))
    assert abs(found.roots[0] + 1) < 1e-7


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(60))
def test_roots_and_count_agree(seed, sampled):
    """The Nyquist count over certified crossings against the collocated roots, for joints of every kind."""
    loop = draw_setup(np.random.default_rng([1, seed]), sampled).loop()
    count = unstable_roots(loop)
    found = gr.rightmost_roots(loop, count=count + 4)
    assert np.sum(found.roots.real > 0) == count
    assert gr.is_stable(loop) == (count == 0)
    assert np.all(found.residuals < 1e-8)


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(30))
def test_roots_close_the_loop(seed, sampled):
    """Each root is as near to a solution of L(s) = −1 as its residual says, and at least to 1e-9 of its size."""
    loop = draw_setup(np.random.default_rng([2, seed]), sampled).loop()
    found = gr.rightmost_roots(loop, count=4)
    assert np.all(np.diff(found.roots.real) < 1e-9 * np.abs(found.roots).max())
    for root, residual in zip(found.roots, found.residuals, strict=True):
        poles = loop.scalar.poles
        v = root if loop.sample_time is None else np.expm1(root * loop.sample_time) / loop.sample_time
        if np.abs(poles - v).min() < 1e-6 * abs(v):
            continue  # a pole that a zero hides is a root of the closed loop without L = −1
        step = 1e-4 * np.abs(poles - v).min()
        ahead, behind, here = loop.at(np.array([root + step, root - step, root]))
        slope = (ahead - behind) / (2 * step)  # good to 1e-8 of itself
        # A slow root among fast ones is known to the rounding of the state matrix, not to its own digits.
        rounding = stability.RESOLUTION * np.abs(loop.open_loop.a).max()
        assert abs((1 + here) / slope) <= (residual + 1e-9) * abs(root) + rounding


@pytest.mark.parametrize("seed", range(8))
def test_roots_of_many_joints(seed):
    """det(I + L) vanishes at each root, with one delay per joint; and the verdict is theirs."""
    rng = np.random.default_rng([3, seed])
    plant = draw_plant(rng, 3, rigid=int(seed % 3))
    drives = [gr.Drive(3000.0, 0.9, float(rng.uniform(0, 4e-3))) for _ in range(3)]
    loop = gr.build_loop(plant, drives, gr.PD(rng.uniform(50, 400, 3), rng.uniform(2, 20, 3)), sample_time=None if seed % 2 else 1e-3)
    found = gr.rightmost_roots(loop, count=6)
    for root in found.roots[np.abs(found.roots) > 1e-3]:
        values = np.linalg.eigvals(loop.at(np.array([root]))[0])
        assert np.abs(values + 1).min() < 1e-6
    assert gr.is_stable(loop) == (found.roots[0].real < 0)


def test_delay_free_roots_are_those_of_the_polynomial():
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9)
    found = gr.rightmost_roots(gr.build_loop(joint, drive, gr.PD(2000.0, 30.0)), count=6).roots
    spring = [1.0, 1e4]
    plant = np.polymul([1.0, 0, 0], np.polyadd([0.16, 0, 0], np.array(spring) * 1.0))
    closed = np.polyadd(np.polymul(plant, [1, 7200.0, 16e6]), 16e6 * np.polymul(np.polyadd([0.8, 0, 0], spring), [30.0, 2000.0]))
    expected = np.roots(closed)
    expected = expected[np.argsort(-expected.real)]
    assert sorted(found.imag) == pytest.approx(sorted(expected.imag), rel=1e-8, abs=1e-8)
    assert found.real == pytest.approx(expected.real, rel=1e-8)


@pytest.mark.parametrize(("feed", "stable"), [(0.5, True), (-0.5, True), (0.99, True)])
def test_neutral_loops(feed, stable):
    """L = (f s + 1)/(s + 1) e^{−s}: |L(∞)| = |f| < 1; chains of roots near ln|f|, all to the left."""
    loop = gr.loop_from(scipy.signal.TransferFunction([feed, 1.0 if feed > 0 else -0.2], [1.0, 1.0]), delay=1.0)
    found = gr.rightmost_roots(loop, count=6)
    assert gr.is_stable(loop) == stable == (found.roots[0].real < 0)
    for root in found.roots:
        assert abs(loop.at(np.array([root]))[0] + 1) < 1e-9


@pytest.mark.parametrize("feed", [1.0, -1.0, 1.7])
def test_neutral_loops_without_a_verdict_are_refused(feed):
    with pytest.raises(gr.GainroomError, match=r"L\(∞\).* must be < 1"):
        gr.loop_from(scipy.signal.TransferFunction([feed, 1.0], [1.0, 1.0]), delay=0.1)


def test_raising_the_gain_of_a_neutral_loop_loses_it():
    """Scaled beyond |L(∞)| = 1 the loop has infinitely many unstable roots: it must not be called stable."""
    loop = gr.loop_from(scipy.signal.TransferFunction([0.5, 0.1], [1.0, 1.0]), delay=0.01)
    assert gr.is_stable(loop)
    assert not gr.is_stable(loop.scaled(2.2))


def test_marginal_loops_are_not_stable():
    """On the boundary exactly: an undamped oscillator with no feedback at all, one root at the crossing."""
    assert not gr.is_stable(integrator_with_delay(pi / 2, 1.0))
    assert not gr.is_stable(gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 0.0, 0.0])))
    assert not gr.is_stable(gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(), gr.PD(0.0, 0.0)))


@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize(
    ("kp", "kd", "stable"), [(-1.0, 5.0, False), (10.0, -0.1, False), (10.0, 0.0, False), (10.0, 1.0, True), (1e-9, 1.0, True)]
)
def test_signs_of_gains(kp, kd, stable, sample_time):
    """A rigid joint without delay: both gains must be positive; sampled, the difference's half tick asks no more of these."""
    loop = gr.build_loop(gr.ElasticJoint(0.5, 0.5), gr.Drive(), gr.PD(kp, kd), sample_time=sample_time)
    assert gr.is_stable(loop) == stable


def test_callables_have_no_roots_to_list():
    with pytest.raises(gr.GainroomError, match="callable"):
        gr.rightmost_roots(gr.loop_from(lambda s: 1 / s))


def test_ideal_rigid_joint_is_a_quadratic():
    """s² + kd s + kp with J = 1."""
    loop = gr.build_loop(gr.ElasticJoint(0.4, 0.6), gr.Drive(bandwidth=inf), gr.PD(25.0, 6.0))
    assert sorted(gr.rightmost_roots(loop).roots, key=lambda z: z.imag) == pytest.approx([-3 - 4j, -3 + 4j], rel=1e-14)
    sampled = gr.build_loop(gr.ElasticJoint(0.4, 0.6), gr.Drive(bandwidth=inf), gr.PD(25.0, 6.0), sample_time=1e-5)
    roots = gr.rightmost_roots(sampled).roots
    assert roots[0].real == pytest.approx(-3.0, rel=2e-4)  # the hold and the difference each lag by half a tick of 1e-5
