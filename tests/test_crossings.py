"""The certified scan: it finds every crossing and peak that a dense grid sees, and its count is right."""

from math import inf, pi

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from draws import draw_setup
from gainroom.analysis.callable_scan import objective
from gainroom.analysis.crossings import LOWEST_FLOOR, scan
from gainroom.analysis.stability import scan_loop, unstable_roots
from gainroom.system.linear.transfer_function import Factored, ratio
from independent import delay_roots
from independent.joint import PDJoint
from wide_joints import Case


def pairs(rng: np.random.Generator, count: int, low: float, high: float) -> np.ndarray:
    """`count` complex pairs with damping ratios from 1e-4 to 1, half the time one of them on the boundary."""
    size = np.exp(rng.uniform(np.log(low), np.log(high), count))
    ratio_ = 10.0 ** rng.uniform(-4, 0, count)
    if count and rng.random() < 0.5:
        ratio_[0] = 0.0
    upper = size * (-ratio_ + 1j * np.sqrt(1 - ratio_**2))
    return np.concatenate([upper, upper.conj()])


def draw_factored(rng: np.random.Generator) -> Factored:
    """A proper rational function with delay: integrators, undamped and unstable poles, zeros on either side, either sign of gain."""
    poles = np.concatenate([pairs(rng, int(rng.integers(0, 4)), 1, 1e3), -(10.0 ** rng.uniform(0, 3, int(rng.integers(0, 3))))])
    if rng.random() < 0.3:
        poles = np.append(poles, 10.0 ** rng.uniform(0, 2))
    poles = np.concatenate([poles, np.zeros(int(rng.integers(0, 3)))])
    zeros = np.concatenate(
        [pairs(rng, int(rng.integers(0, 3)), 1, 1e3), rng.choice([-1, 1]) * 10.0 ** rng.uniform(0, 3, int(rng.integers(0, 3)))]
    )
    if not len(poles):
        poles = np.array([-1.0])
    while len(zeros) >= len(poles):
        zeros = zeros[np.abs(zeros.imag) == 0][: len(poles) - 1] if np.any(zeros.imag == 0) else zeros[:0]
    at = 10.0 ** rng.uniform(0, 2.5)
    plain = Factored(zeros.astype(complex), poles.astype(complex), 1.0)
    gain = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-1, 1.5) / abs(plain.response(np.array([at]))[0])
    # A slow roll-off with much delay has thousands of phase crossings, which both can list but no joint has.
    delay = 0.0 if rng.random() < 0.2 else rng.uniform(0.05, 5.0) / at
    if len(poles) - len(zeros) < 2:
        poles = np.append(poles, -3 * at)
        gain *= 3 * at
    return Factored(zeros.astype(complex), poles.astype(complex), float(gain), float(delay))


def draw_sampled(rng: np.random.Generator) -> Factored:
    """Joints under sampled control, a third of them without any damping: poles on the unit circle."""
    return draw_setup(rng, sampled=True).loop().scalar


def draw_undamped(rng: np.random.Generator) -> Factored:
    """An undamped joint, P control and an integrator: poles at ±jω and at 0, phase that jumps there."""
    joint = gr.ElasticJoint(float(rng.uniform(0.1, 1)), float(rng.uniform(0.1, 5)), 10 ** rng.uniform(2, 4.5), 0.0)
    step = None if rng.random() < 0.5 else 5e-4
    drive = gr.Drive(inf if rng.random() < 0.5 else 2000.0, 0.9, float(rng.uniform(0, 5e-3)))
    kp = 10 ** rng.uniform(1, 3)
    return gr.build_loop(joint, drive, gr.PID(kp, 0.5 * kp, kp * rng.uniform(0, 0.05)), sample_time=step).scalar


KINDS = {"any": draw_factored, "sampled": draw_sampled, "undamped": draw_undamped}


def dense_grid(system: Factored, points: int) -> np.ndarray:
    """ω over everything that matters, and dense around every root near the boundary."""
    roots = np.concatenate([system.zeros, system.poles])
    if system.sample_time is not None:
        z = 1 + system.sample_time * roots
        roots = np.log(z[np.abs(z) > 1e-12]) / system.sample_time
    sizes = np.append(np.abs(roots[np.abs(roots) > 0]), 1 / system.delay if system.delay else 1.0)
    low, high = 1e-4 * sizes.min(), 30 * sizes.max()
    if system.sample_time is not None:
        high = pi / system.sample_time
    parts = [np.geomspace(low, high, points)]
    for root in roots[roots.imag > 0]:
        width = max(abs(root.real), 1e-7 * abs(root))
        parts.append(root.imag + width * np.sinh(np.linspace(-11, 11, points // 20)))
    grid = np.unique(np.concatenate(parts))
    return grid[(grid > low) & (grid < high)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(25))
def test_a_dense_grid_sees_nothing_else(kind, seed):
    system = KINDS[kind](np.random.default_rng([2, seed]))
    found = scan(system)
    omega = dense_grid(system, 100_000)
    value = system.response(omega)
    steps = np.flatnonzero((np.abs(value[1:]) > 1) != (np.abs(value[:-1]) > 1))
    for k in steps:
        assert np.any((found.gains[:, 0] >= omega[k] * (1 - 1e-9)) & (found.gains[:, 0] <= omega[k + 1] * (1 + 1e-9))), omega[k]
    # The walk may end where |L| stays below 1e-3 in continuous time.
    strong = np.abs(value) > (1e-3 if system.sample_time is None else 0.0)
    turns = np.angle(-value[1:]) * np.angle(-value[:-1]) < 0
    turns &= (np.abs(np.angle(value[1:] / value[:-1])) < 1) & strong[1:] & strong[:-1] & (value[1:].real < 0) & (value[:-1].real < 0)
    for k in np.flatnonzero(turns):
        assert np.any((found.phases[:, 0] >= omega[k] * (1 - 1e-9)) & (found.phases[:, 0] <= omega[k + 1] * (1 + 1e-9))), omega[k]
    for kind_ in range(3):
        # The claim is a minimum that nothing undercuts by more than 1 %, and that is reached.
        assert objective(kind_, value).min() >= 0.99 * found.peaks[kind_, 1] - 1e-12
        if found.peaks[kind_, 0] > 0:
            assert objective(kind_, system.response(found.peaks[kind_, :1]))[0] == pytest.approx(found.peaks[kind_, 1], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(60))
def test_listed_crossings_are_crossings(seed):
    system = draw_factored(np.random.default_rng([3, seed]))
    found = scan(system)
    at_gain, at_phase = system.response(found.gains[:, 0]), system.response(found.phases[:, 0])
    _, slope = system.response_and_slope(found.gains[:, 0])
    # Newton stops within 1e-15 of ω, whose rounding and that of ωT add a third; near an undamped root the slope magnifies it.
    assert np.all(np.abs(np.abs(at_gain) - 1) < 1e-13 + 1.5e-15 * found.gains[:, 0] * np.abs(slope))
    assert np.abs(np.exp(1j * found.gains[:, 1]) - at_gain / np.abs(at_gain)).max(initial=0.0) < 1e-6
    inner = found.phases[:, 0] > 0
    _, slope = system.response_and_slope(found.phases[:, 0][inner])
    off = np.abs(at_phase.imag / np.abs(at_phase))[inner]
    assert np.all(off < 1e-13 + 1.5e-15 * found.phases[inner, 0] * np.abs(slope / at_phase[inner]))
    assert found.phases[:, 1] == pytest.approx(np.abs(at_phase), rel=1e-9)


@pytest.mark.parametrize("seed", range(80))
def test_encirclements_of_a_rational_loop(seed):
    """Without delay the closed-loop roots are those of a polynomial; unstable ones = unstable poles − half turns."""
    rng = np.random.default_rng([4, seed])
    roots = np.array([1j])
    while np.abs(roots.real / np.abs(roots)).min() < 1e-7:  # too near the axis for polynomial roots to tell
        drawn = draw_factored(rng)
        system = Factored(drawn.zeros, drawn.poles, drawn.gain)
        roots = np.roots(np.polyadd(np.real(np.poly(system.poles)), system.gain * np.real(np.poly(system.zeros))))
    assert scan(system).half_turns == pytest.approx(system.unstable_poles - np.sum(roots.real > 0), abs=1e-6)


def test_narrow_resonance_between_grid_points():
    """A mode of damping ratio 1e-7 is 6e-5 rad/s wide at 314 rad/s; it lifts |L| over one and back within that width."""
    mode = np.array([1.0, 2e-7 * 314.0, 314.0**2])
    system = ratio([30.0], np.polymul([1.0, 0.0], mode)) * ratio([100.0], [1.0, 100.0])
    found = scan(system)
    assert found.certified
    near = found.gains[np.abs(found.gains[:, 0] - 314) < 1, 0]
    assert len(near) == 2
    assert near[0] < 314 < near[1]


def test_peak_at_low_frequency():
    """An integrator with the wrong sign: |1 + L|/|L| falls to one as ω → 0, and the search for it must end there, above zero."""
    found = scan(Factored(np.zeros(0, complex), np.zeros(1, complex), -105.48217392216715, 0.008518043908368026))
    assert found.peaks[1, 1] == pytest.approx(1.0, abs=1e-6)
    assert np.all(found.peaks[:, 0] >= 0)


def test_undamped_sampled_zero_is_passed_once():
    """A zero of the hold 1e-12 beside the unit circle: the walk must not count its turn several times."""
    joint = gr.ElasticJoint(0.4, 4.0, 100.0, 0.0)
    system = gr.build_loop(joint, gr.Drive(delay=4e-3), gr.PID(100.0, 50.0, 3.0), sample_time=5e-4).scalar
    found = scan(system)
    assert np.abs(system.response(found.gains[:, 0])) == pytest.approx(1.0, rel=1e-6)
    assert np.abs(found.gains[:, 1]).max() < 4 * pi  # one turn each for the zero and the pole, little for the delay


def test_delay_alone():
    """2 e^{-s}/(s + 1): |L| = 1 at √3; phase crossings where ω + atan ω = (2k+1)π."""
    found = scan(Factored(np.zeros(0, complex), np.array([-1.0 + 0j]), 2.0, 1.0))
    assert found.gains[:, 0] == pytest.approx([np.sqrt(3)], rel=1e-15)
    omega = found.phases[:, 0]
    turns = (omega + np.arctan(omega) - pi) / (2 * pi)
    assert len(omega) > 100  # down to |L| = 1e-3
    assert turns == pytest.approx(np.arange(len(omega)), abs=1e-12)
    assert found.phases[:, 1] == pytest.approx(2 / np.hypot(1, omega), rel=1e-13)
    assert set(found.phases[:, 2]) == {-1.0}


def test_ends_of_the_boundary():
    """L(0) < 0 and L at the Nyquist frequency < 0 are crossings, with slope sign zero."""
    found = scan(ratio([-3.0], [1.0, 1.0]))
    assert found.phases[0].tolist() == [0.0, 3.0, 0.0]
    step = 0.1  # 0.5/(z + 0.5): L(−1) = −1
    sampled = scan(Factored(np.zeros(0, complex), np.array([-1.5 / step + 0j]), 0.4 / step, 0.0, step))
    assert sampled.phases[-1] == pytest.approx([pi / step, 0.8, 0.0], rel=1e-12)


@pytest.mark.parametrize("growth", [0.0, 0.1])
@pytest.mark.parametrize("gain", [10.0, 1.2e3, 5e3, 9e3, 1e6])
def test_loops_that_vanish_at_rest(gain, growth):
    """g s/((s + 1)³ (s² − 2 a s + 1)) may be large at the lowest frequency looked at; counted by the roots of its polynomial."""
    denominator = np.polymul(np.poly([-1.0, -1.0, -1.0]), [1.0, 0.2 - 2 * growth, 1.0])
    expected = np.count_nonzero(np.roots(np.polyadd(denominator, [gain, 0.0])).real > 0)
    assert unstable_roots(gr.loop_from(scipy.signal.TransferFunction([gain, 0.0], denominator))) == expected


@pytest.mark.parametrize("kp", [0.0, 50.0])
def test_pole_and_zero_at_rest_that_cancel(kp):
    """Friction leaves one pole at 0, and without kp the controller has a zero there: a root at 0 that no gain moves."""
    joint = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0, motor_viscous=0.3)
    loop = gr.build_loop(joint, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(kp, 5.0))
    found = gr.margins(loop)
    assert found.unstable_roots == 0
    assert gr.rightmost_roots(loop).unmoved == pytest.approx([0.0] if kp == 0 else [])
    assert gr.gain_limit(loop).stable


def test_a_sample_on_an_undamped_resonance():
    """Resonances at 1 and 2 rad/s: the search for the highest frequency doubles from the slowest, and meets the other."""
    found = scan(Factored(np.zeros(0, dtype=complex), np.array([1j, -1j, 2j, -2j]), 1.0, 0.1))
    assert found.certified
    squares = (5 + np.array([-np.sqrt(13), -np.sqrt(5), np.sqrt(5), np.sqrt(13)])) / 2  # (1 − ω²)(4 − ω²) = ±1
    assert found.gains[:, 0] == pytest.approx(np.sqrt(squares), rel=1e-13)
    passed = np.array([0, 1, 1, 2])  # poles passed on their right, half a turn each
    assert found.gains[:, 1] == pytest.approx(-0.1 * np.sqrt(squares) - pi * passed, rel=1e-12)


def test_poles_on_the_boundary_close_together():
    """Two undamped modes 1e-13 apart are passed as one, and neither is counted twice; a mode whose zero lies on it is none."""
    far = np.array([-50.0 + 0j])
    pair = np.array([10j, -10j])
    twice = scan(Factored(np.zeros(0, complex), np.concatenate([pair, pair * (1 + 1e-13), far]), 1e6))
    assert twice.certified
    assert twice.gains[-1, 1] == pytest.approx(-2 * pi - np.arctan(twice.gains[-1, 0] / 50), abs=1e-6)
    hidden = scan(Factored(pair, np.concatenate([pair, far]), 100.0))
    alone = scan(Factored(np.zeros(0, complex), far, 100.0))
    assert hidden.gains == pytest.approx(alone.gains, rel=1e-12)
    assert hidden.half_turns == alone.half_turns


def test_a_pole_at_the_nyquist_frequency():
    """g/(z + 1)(z − p) has a pole at z = −1; unstable roots are those of z² + (1 − p) z + g − p outside the unit circle."""
    step, p = 1e-2, 0.5
    for g in (0.2, 0.8, 1.4, 1.6, 3.0, -0.2):
        found = scan(Factored(np.zeros(0, complex), np.array([-2.0, p - 1], dtype=complex) / step, g / step**2, 0.0, step))
        outside = int(np.sum(np.abs(np.roots([1.0, 1 - p, g - p])) > 1))
        assert -found.half_turns == pytest.approx(outside, abs=1e-9), g


@pytest.mark.filterwarnings("error")
def test_the_search_for_the_highest_frequency_stays_within_range():
    """Nine zeros and ten poles, 120 doublings beyond the slowest: each product alone is far beyond 1e308."""
    system = Factored(-np.full(9, 1e3 + 0j), -np.geomspace(1.0, 1e3, 10).astype(complex), 1.0)
    assert scan(system).certified


# --- the nearest crossing lies below where the walk first ends -----------------------------------------------------------


def test_narrow_resonance_far_beyond_the_first_crossing():
    """At 2880 rad/s a load of 85 kg·m² swings at damping ratio 2e-3 and comes nearer to −1 than the first crossing, 1/4642 at 34 rad/s."""
    joint = gr.ElasticJoint(1.878237949653454, 85.19219446645083, 15251267.605866635, 19.385373300644897, link_viscous=20.99234257459169)
    drive = gr.Drive(291.134256320297, 3.0, 4.627336100287973e-3)
    gains = (35.27621125676721, 0.5285269229881536, 0.011942206441965163)
    loop = gr.build_loop(joint, drive, gr.PPI(*gains))
    margin = gr.margins(loop).gain_margin
    assert gr.gain_limit(loop).gain == margin
    drawn = PDJoint(
        joint.motor_inertia, joint.link_inertia, joint.stiffness, joint.damping, 0.0, 0.0, drive.delay, drive.bandwidth, 3.0,
        link_viscous=joint.link_viscous,
    )  # fmt: skip
    kp, kv, ki = gains
    for factor, unstable in ((margin * (1 - 1e-6), False), (margin * (1 + 1e-6), True)):
        above = [factor * ki * kp, factor * (kv * kp + ki), factor * kv]
        assert (delay_roots.count_unstable_with(drawn, above, [0.0, 1.0]) > 0) == unstable


@pytest.mark.parametrize("seed", range(40))
def test_no_crossing_lies_nearer_than_the_nearest(seed):
    """Weak loops, a crossing at √20 rad/s, lightly damped modes further out that come about as near to −1; against a dense grid."""
    rng = np.random.default_rng([6, seed])
    modes, apart = 10.0 ** rng.uniform(1, 2, 2), 10.0 ** rng.uniform(-1, 1, 2)
    upper = modes * (1j - 10.0 ** rng.uniform(-4, -2, 2))
    zeros = upper * apart
    poles = np.concatenate([[0.0, -1.0, -20.0], upper, upper.conj()]).astype(complex)
    system = Factored(np.concatenate([zeros, zeros.conj()]), poles, 1.0)
    system = system.scaled(10.0 ** rng.uniform(-7, -4) / abs(system.response(np.array([20**0.5]))[0]))
    found = scan_loop(gr.loop_from(system))
    omega = dense_grid(system, 200_000)
    value = system.response(omega)
    crossed = (value.imag[1:] * value.imag[:-1] < 0) & (value.real[1:] < 0) & (value.real[:-1] < 0)
    smaller = np.minimum(np.abs(value[1:]), np.abs(value[:-1]))[crossed & (np.abs(value[1:]) < 1)]
    nearest = found.phases[found.phases[:, 1] < 1, 1].max(initial=LOWEST_FLOOR)
    assert smaller.max(initial=0.0) <= nearest * 1.01  # the smaller end of a step across the axis


@pytest.mark.parametrize(
    ("zeros", "poles", "gain", "delay", "limit"),
    [
        ([-1], [-2], 0.5, 0.1, 2.0),  # 1 + g L tends to a circle around 1 of radius g/2
        ([-1], [-2], -0.5, 0.0, 2.0),  # s + 2 − g/2 (s + 1): the root leaves through infinity
        ([-1], [-3], -0.5, 0.0, 2.0),
        ([-4, 1], [-3, -2], -0.9, 0.0, 1 / 0.9),
        ([-1], [-2], 0.5, 0.0, inf),
    ],
)
def test_as_many_zeros_as_poles(zeros, poles, gain, delay, limit):
    loop = gr.loop_from(Factored(np.array(zeros, complex), np.array(poles, complex), gain, delay))
    found = gr.gain_limit(loop)
    assert found.gain == pytest.approx(limit, rel=1e-12)
    assert gr.margins(loop).gain_margin == found.gain
    assert found.certificate is None or found.certificate.holds


def test_crossings_that_gather_above_their_limit():
    """|L| falls to 0.9 from above as it turns: the largest crossing, near 2 rad/s·turns of a delay of 0.1 s, is the margin."""
    system = Factored(np.array([-4, -1], complex), np.array([-3, -2], complex), -0.9, 0.1)
    omega = np.linspace(0.1, 4000, 4_000_000)
    value = system.response(omega)
    crossed = np.flatnonzero((value.imag[1:] > 0) != (value.imag[:-1] > 0))
    largest = -value.real[crossed].min()
    assert gr.margins(gr.loop_from(system)).gain_margin == pytest.approx(1 / largest, rel=1e-4)  # one step turns L by 1e-4 rad


@pytest.mark.parametrize("gain", [-0.3, -2.0, 0.7])
def test_count_with_as_many_zeros_as_poles(gain):
    """s + 3 + g (s + 1) has its root at −(3 + g)/(1 + g)."""
    loop = gr.loop_from(Factored(np.array([-1.0 + 0j]), np.array([-3.0 + 0j]), gain))
    assert unstable_roots(loop) == (-(3 + gain) / (1 + gain) > 0)


def test_phase_that_crosses_and_turns_back():
    """Between 5 and 30 rad/s arg L falls to 0.4° beyond −π and comes back, with no root of L in between to stop at."""
    joint = PDJoint(
        98.59709051578074, 6.638918337193685, 2042247.3176428135, 2132.8146078585396, 0.0, 0.0, 0.00017220027109475058, 2007.196995667014,
        0.978153913053912, 1.3217282425753978, 1.351283639632097,
    )  # fmt: skip
    gains, low_pass = (49.85687641681, 934.29507293776, 5624.8407878932), (46.403274032735, 2, 0.62502199436096)
    case = Case(joint, "PPI", gains, low_pass)
    found = gr.margins(case.loop())
    for factor, stable in (
        (found.gain_margin * (1 - 1e-6), True),
        (found.gain_margin * (1 + 1e-6), False),
        (found.lower_gain_margin * (1 + 1e-6), True),
        (found.lower_gain_margin * (1 - 1e-6), False),
    ):
        assert (case.truth(factor).count() == 0) == stable
