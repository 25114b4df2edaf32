"""Margins mean what they say: each one, applied to the loop, puts a root on the boundary; closed forms; unstable loops have none."""

from dataclasses import replace
from math import atan, degrees, hypot, inf, isinf, isnan, pi, sqrt
from typing import Any

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from draws import draw_setup
from gainroom.analysis.stability import unstable_roots
from gainroom.system.margin_units import from_db, to_db


def stable_loop(seed: int, sampled: bool) -> gr.Loop:
    """A random loop, its gains lowered until it is stable; another one where that does not help."""
    for attempt in range(20):
        loop = draw_setup(np.random.default_rng([seed, attempt]), sampled).loop()
        for _ in range(6):
            if gr.is_stable(loop):
                return loop
            loop = loop.scaled(0.4)
    raise AssertionError("no stable loop drawn")


CASES = [(seed, sampled) for seed in range(25) for sampled in (False, True)]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0]} {'sampled' if case[1] else 'continuous'}")
def loop(request):
    return stable_loop(*request.param)


def test_gain_margin_is_where_stability_ends(loop):
    found = gr.margins(loop)
    assert found.stable
    assert found.certified
    if not isinf(found.gain_margin):
        assert unstable_roots(loop.scaled(found.gain_margin * (1 - 1e-9))) == 0
        assert unstable_roots(loop.scaled(found.gain_margin * (1 + 1e-9))) > 0
    if found.lower_gain_margin > 0:
        assert unstable_roots(loop.scaled(found.lower_gain_margin * (1 + 1e-9))) == 0
        assert unstable_roots(loop.scaled(found.lower_gain_margin * (1 - 1e-9))) > 0


def test_phase_margin_is_the_angle_to_minus_one(loop):
    found = gr.margins(loop)
    for crossing in found.gain_crossings:
        value = loop.response(np.array([crossing.omega]))[0]
        assert np.angle(-value) == pytest.approx(crossing.phase_margin, abs=1e-7)
        assert crossing.delay_margin * crossing.omega == pytest.approx(crossing.phase_margin % (2 * pi), abs=1e-9)
    if found.gain_crossings:
        assert abs(found.phase_margin) == min(abs(c.phase_margin) for c in found.gain_crossings)
        by_phase = min(c.delay_margin for c in found.gain_crossings)
        if loop.sample_time is None:
            assert found.delay_margin == by_phase
        else:  # a fraction of a tick is not quite the phase that it costs
            assert found.delay_margin == pytest.approx(by_phase, rel=1e-2, abs=1e-2 * loop.sample_time)
    else:
        assert (found.phase_margin, found.delay_margin) == (inf, inf)


def test_delay_margin_is_where_stability_ends(loop):
    found = gr.margins(loop)
    parts, (drive,) = loop.parts, loop.parts.drives

    def later(delay: float) -> gr.Loop:
        slower = replace(drive, delay=drive.delay + delay)
        return gr.build_loop(parts.plant, slower, parts.controller, parts.feedback, parts.sample_time).scaled(loop.gain)

    if isinf(found.delay_margin):
        assert gr.is_stable(later(0.05))
    else:
        assert gr.is_stable(later(found.delay_margin * (1 - 1e-7)))
        assert not gr.is_stable(later(found.delay_margin * (1 + 1e-7)))


def test_margins_are_linked(loop):
    """|1 + L| ≥ 1/Ms at both crossovers: GM ≥ Ms/(Ms − 1), PM ≥ 2 asin(1/2Ms); disk margin between them (Seiler et al. 2020)."""
    found = gr.margins(loop)
    peak, other, disk = found.peak_sensitivity, found.peak_complementary, found.disk_margin
    assert peak >= 1 - 1e-12
    assert abs(peak - other) <= 1 + 1e-9  # |S| − |T| ≤ |S + T| = 1
    assert 0 < disk <= 2
    slack = 1 + 1e-9  # rounding of two numbers that can be equal
    if not isinf(found.gain_margin) and peak > 1:
        assert found.gain_margin * slack >= peak / (peak - 1)
        assert found.gain_margin * slack >= (2 + disk) / (2 - disk) if disk < 2 else True
    if found.gain_crossings:
        assert abs(found.phase_margin) * slack >= 2 * np.arcsin(1 / (2 * max(peak, other)))
        assert abs(found.phase_margin) * slack >= 2 * np.arctan(disk / 2)
    # α = 2/max|S − T| with S − T = 2S − 1 = 1 − 2T
    assert 2 / (peak + other) <= disk * slack
    assert disk <= 1 / (max(peak, other) - 0.5) * slack


def test_peaks_are_peaks(loop):
    """The reported frequency has the reported height, and a dense grid finds nothing higher than 1 %."""
    found = gr.margins(loop)
    highest = 1e5 if loop.sample_time is None else pi / loop.sample_time
    value = loop.response(np.geomspace(1e-3, highest, 50_000))
    for height, omega, measure in (
        (found.peak_sensitivity, found.peak_sensitivity_frequency, lambda x: 1 / np.abs(1 + x)),
        (found.peak_complementary, found.peak_complementary_frequency, lambda x: np.abs(x / (1 + x))),
        (1 / found.disk_margin, found.disk_margin_frequency, lambda x: np.abs(1 - x) / (2 * np.abs(1 + x))),
    ):
        assert measure(value).max() <= height * 1.01
        if omega > 0 and height > 0.5:
            assert measure(loop.response(np.array([omega])))[0] == pytest.approx(height, rel=1e-9)


def test_second_order_phase_margin():
    """L = ω²/(s (s + 2ζω)): crossover ω √(√(1 + 4ζ⁴) − 2ζ²), phase margin atan(2ζω/ω_c)."""
    for zeta in (0.05, 0.3, 0.7, 1.5):
        found = gr.margins(gr.loop_from(scipy.signal.TransferFunction([49.0], [1.0, 14 * zeta, 0.0])))
        crossover = 7 * sqrt(sqrt(1 + 4 * zeta**4) - 2 * zeta**2)
        assert found.gain_crossover == pytest.approx(crossover, rel=1e-14)
        assert found.phase_margin == pytest.approx(atan(14 * zeta / crossover), rel=1e-13)
        assert found.delay_margin == pytest.approx(found.phase_margin / crossover, rel=1e-14)
        assert isinf(found.gain_margin)
        assert isnan(found.phase_crossover)
        # |T| of the closed loop ω²/(s² + 2ζωs + ω²)
        if zeta < sqrt(0.5):
            assert found.peak_complementary == pytest.approx(1 / (2 * zeta * sqrt(1 - zeta**2)), rel=1e-12)
            assert found.peak_complementary_frequency == pytest.approx(7 * sqrt(1 - 2 * zeta**2), rel=1e-6)


def test_conditionally_stable_loop():
    """L = g (s + 1)²/s³: stable for g > 1/2 only; one phase crossing, at 1 rad/s, with |L| = 2 g."""
    found = gr.margins(gr.loop_from(scipy.signal.TransferFunction([3.0, 6.0, 3.0], [1.0, 0.0, 0.0, 0.0])))
    assert found.stable
    assert isinf(found.gain_margin)
    assert found.lower_gain_margin == pytest.approx(1 / 6, rel=1e-13)
    assert found.lower_phase_crossover == pytest.approx(1.0, rel=1e-13)
    assert not gr.is_stable(gr.loop_from(scipy.signal.TransferFunction([0.49, 0.98, 0.49], [1.0, 0.0, 0.0, 0.0])))


def test_unstable_pole_needs_gain():
    """3/(s − 1): stable above g = 1/3; Ms = 1 at infinity or 1/|1 + L(0)| = 1/2; Mt = 3/2 at ω = 0."""
    found = gr.margins(gr.loop_from(scipy.signal.TransferFunction([3.0], [1.0, -1.0])))
    assert found.stable
    assert found.lower_gain_margin == pytest.approx(1 / 3, rel=1e-14)
    assert found.lower_phase_crossover == 0.0
    assert found.peak_complementary == pytest.approx(1.5, rel=1e-12)
    assert found.gain_crossover == pytest.approx(sqrt(8), rel=1e-14)


def test_first_order_with_delay():
    """2 e^{−s/10}/(s + 1): gain margin where ω/10 + atan ω = π."""
    from scipy.optimize import brentq

    omega: Any = brentq(lambda w: w / 10 + atan(w) - pi, 1, 100, xtol=1e-14)
    found = gr.margins(gr.loop_from(scipy.signal.TransferFunction([2.0], [1.0, 1.0]), delay=0.1))
    assert found.phase_crossover == pytest.approx(omega, rel=1e-13)
    assert found.gain_margin == pytest.approx(hypot(1, omega) / 2, rel=1e-13)
    assert found.phase_margin == pytest.approx(pi - sqrt(3) / 10 - pi / 3, rel=1e-13)


def test_negative_phase_margin_of_a_stable_loop_keeps_its_sign():
    """A resonance that lifts |L| over one with the phase beyond −π, harmlessly: crossings of both signs."""
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2.5e-3), gr.PD(2000.0, 30.0))
    signs = [np.sign(c.phase_margin) for c in gr.margins(loop).gain_crossings]
    assert signs == [1, -1, 1]
    assert [degrees(c.delay_margin * c.omega) for c in gr.margins(loop).gain_crossings] == pytest.approx(
        [26.7536, 360 - 146.151, 25.7489], abs=5e-4
    )


@pytest.mark.parametrize("sample_time", [None, 5e-4])
def test_unstable_loops_have_no_margins(sample_time):
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2.5e-3), gr.PD(2000.0, 30.0), sample_time=sample_time)
    found = gr.margins(loop.scaled(3.0))
    assert not found.stable
    assert found.unstable_roots == 2
    numbers = [value for value in vars(found).values() if isinstance(value, float)]
    numbers += [found.gain_margin, found.phase_crossover, found.lower_gain_margin, found.lower_phase_crossover]
    assert len(numbers) == 15
    assert all(isnan(value) for value in numbers)
    assert found.phase_crossings
    assert found.gain_crossings


def test_scaling_moves_the_gain_margin_only():
    loop = stable_loop(3, sampled=False)
    whole, half = gr.margins(loop), gr.margins(loop.scaled(0.5))
    if half.stable:
        factors = [c.gain for c in whole.phase_crossings]
        strong = [c.gain / 2 for c in half.phase_crossings][: len(factors)]
        assert strong == pytest.approx(factors[: len(strong)], rel=1e-12)


def test_decibels():
    assert to_db(10.0) == 20.0
    assert to_db(0.0) == -inf
    assert from_db(6.0) == pytest.approx(1.9952623149688795, rel=1e-15)
    assert from_db(to_db(3.7)) == pytest.approx(3.7, rel=1e-15)


def test_margins_of_several_joints_are_one_record():
    """Two joints that do not couple: of each margin the lesser, and joint by joint its own."""
    joints = [gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.ElasticJoint(0.5, 0.3, 4e3, 0.5)]
    names = ("motor_inertia", "stiffness", "damping")
    motors, springs, dampers = (np.array([getattr(joint, name) for joint in joints]) for name in names)
    plant = gr.Plant(np.diag([1 / joint.link_inertia for joint in joints]), motors, springs, dampers)
    drive, kp, kd = gr.Drive(4000.0, 0.9, 2e-3), np.array([200.0, 500.0]), np.array([10.0, 12.0])
    found = gr.margins(gr.build_loop(plant, drive, gr.PD(kp, kd)))
    alone = [gr.margins(gr.build_loop(joint, drive, gr.PD(*gains))) for joint, *gains in zip(joints, kp, kd, strict=True)]
    assert found.certified
    assert found.disk_certified
    for name, rel in (("gain_margin", 1e-9), ("delay_margin", 1e-8), ("disk_margin", 2e-3), ("least_gain_margin", 1e-8)):
        assert getattr(found, name) == pytest.approx(min(getattr(one, name) for one in alone), rel=rel)
    assert found.peak_sensitivity == pytest.approx(max(one.peak_sensitivity for one in alone), rel=1e-7)
    assert found.one_loop.gain_margin == pytest.approx([one.gain_margin for one in alone], rel=1e-8)
    assert found.one_loop.phase_margin == pytest.approx([abs(one.phase_margin) for one in alone], rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [lambda s: 25 / (s**3 + 10 * s**2 + 10 * s + 10), lambda s: 2 * np.exp(-0.1 * s) / (s + 1), lambda s: 30 / (s * (s + 3))]
)
def test_callables_give_the_same(make):
    """A callable is sampled, not certified; on smooth loops its crossings are as exact, and its peaks good to the search's 1e-8."""
    systems = {
        25: gr.loop_from(scipy.signal.TransferFunction([25.0], [1.0, 10.0, 10.0, 10.0])),
        2: gr.loop_from(scipy.signal.TransferFunction([2.0], [1.0, 1.0]), delay=0.1),
        30: gr.loop_from(scipy.signal.TransferFunction([30.0], [1.0, 3.0, 0.0])),
    }
    found = gr.margins(gr.loop_from(make))
    expected = gr.margins(min(systems.values(), key=lambda loop: abs(loop.at(np.array([1 + 2j]))[0] - make(np.array([1 + 2j]))[0])))
    assert not found.certified
    assert found.stable == expected.stable
    for name in ("gain_margin", "phase_margin", "delay_margin"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9)
    for name in ("peak_sensitivity", "peak_complementary", "disk_margin"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-7)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (lambda s: np.full(len(s), np.nan), "finite, nonzero values"),
        (lambda s: np.zeros(len(s)), "finite, nonzero values"),
        (lambda s: s[:2], "one value per s: shape"),
        (lambda s: 1.0, "one value per s: shape"),
    ],
)
def test_callables_that_fail_are_named(bad, words):
    with pytest.raises(gr.GainroomError, match=words):
        gr.margins(gr.loop_from(bad))


@pytest.mark.parametrize("place", [0.1, 1.0, 3.0, 7.0, 100.0])
def test_a_crossing_at_a_round_number(place):
    """L = p³/(s(s + p)²) is −1/2 at s = jp, exactly so in doubles: where the walk looks, its sign does not tell the way that it goes."""
    found = gr.margins(gr.loop_from(scipy.signal.ZerosPolesGain([], [0.0, -place, -place], place**3)))
    assert found.gain_margin == pytest.approx(2, rel=1e-12)
    assert found.phase_crossover == pytest.approx(place, rel=1e-12)


def test_gain_margins_of_round_numbers():
    """Of 200 loops with an integrator and whole poles: stable a millionth below, not so a millionth above, by the polynomial's roots."""
    rng = np.random.default_rng(0)

    def stable(poles: np.ndarray, gain: float) -> bool:
        own = np.poly(poles)
        return bool(np.roots(np.append(own[:-1], own[-1] + gain)).real.max() < 0)

    for _ in range(200):
        poles, gain = np.append(0.0, -rng.integers(1, 6, size=rng.integers(2, 5))), float(rng.integers(1, 4))
        found = gr.margins(gr.loop_from(scipy.signal.ZerosPolesGain([], poles, gain)))
        assert found.stable == stable(poles, gain)
        if found.stable:
            assert stable(poles, gain * found.gain_margin * (1 - 1e-6))
            assert not stable(poles, gain * found.gain_margin * (1 + 1e-6))


def test_margins_are_shown_in_one_line():
    """Of L = g/(s(s + 1)(s + 2)): real at √2 rad/s, −g/6 there."""
    poles = [0.0, -1.0, -2.0]
    found = gr.margins(gr.loop_from(scipy.signal.ZerosPolesGain([], poles, 1.0)))
    shown = repr(found)
    assert shown.startswith(f"Margins(stable, gain margin {20 * np.log10(6):.4g} dB at {sqrt(2) / (2 * pi):.3g} Hz, phase margin ")
    for text in (f"{degrees(found.phase_margin):.4g}°", f"{1e3 * found.delay_margin:.4g} ms", f"Ms {found.peak_sensitivity:.4g})"):
        assert text in shown
    unstable = gr.margins(gr.loop_from(scipy.signal.ZerosPolesGain([], poles, 12.0)))
    assert repr(unstable) == "Margins(unstable, gain limit 0.5 times the gains)"


def test_margins_of_several_joints_are_shown_in_one_line():
    """Two alike on one plant each: as one alone, and one loop at a time the same."""
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    alone = gr.margins(gr.build_loop(joint, drive, gr.PD(1e4, 300.0)))
    plant = gr.Plant(np.eye(2) / 16.0, np.array(1.0), np.array(1e4), np.array(1.0))
    both = gr.margins(gr.build_loop(plant, drive, gr.PD(1e4, 300.0)))
    shown, margin = repr(both), 20 * np.log10(alone.gain_margin)
    assert shown.startswith(f"Margins(2 joints, stable, gain margin {margin:.4g} dB at ")
    assert f"one loop at a time {margin:.4g} dB and {degrees(abs(alone.phase_margin)):.4g}°)" in shown
    assert "\n" not in shown
    assert len(shown) < 250


def test_a_limit_above_1000_of_several_joints_is_shown_as_that():
    """Of two joints whose gains are a millionth of what they may be, alone and together: none up to 1000 is known, 60 dB."""
    plant, drive = gr.Plant(np.eye(2) / 16.0, np.array(1.0), np.array(1e4), np.array(1.0)), gr.Drive(4000.0, 0.9, 2e-3)
    loop = gr.build_loop(plant, drive, gr.PD(1e-2, 3e-4))
    assert 1e3 < gr.gain_limit(gr.build_loop(gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), drive, gr.PD(1e-2, 3e-4))).gain < inf
    assert gr.gain_limit(loop).gain == inf
    assert "gain margin above 60 dB, " in repr(gr.margins(loop))
    assert "up to 1000" in str(gr.gain_limit.__doc__)
