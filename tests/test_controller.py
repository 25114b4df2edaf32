"""Controllers against direct formulas, in continuous and sampled time."""

from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy import signal

import gainroom as gr
from gainroom.robot.tasks import TaskPPI
from gainroom.system.controller import Compensator, Controller, Terms
from gainroom.system.linear.transfer_function import Factored
from refusals import assert_refused

TICK = 5e-4
OMEGA = np.array([0.5, 20.0, 118.0, 490.0, 2000.0, 6000.0])
# Each polynomial is evaluated through its roots: a few ulp per root, fewer than ten of them.
ROUNDING = 1e-13


def variables(sample_time: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(s or e^{jωT_s}, the derivative, the integral) at OMEGA."""
    s = 1j * OMEGA
    if sample_time is None:
        return s, s, 1 / s
    z = np.exp(s * sample_time)
    # 1 − 1/z = −expm1(−s T_s), without cancellation at small ω
    difference = -np.expm1(-s * sample_time)
    return z, difference / sample_time, sample_time / difference


def tustin(frequency: float, sample_time: float | None) -> np.ndarray:
    """What stands for s at OMEGA under Tustin's rule that is exact at `frequency`; for real ω: j ω₀ tan(ωT_s/2)/tan(ω₀T_s/2)."""
    if sample_time is None:
        return 1j * OMEGA
    return 1j * frequency * np.tan(OMEGA * sample_time / 2) / np.tan(frequency * sample_time / 2)


def low_pass(filtered: gr.LowPass | None, sample_time: float | None) -> np.ndarray | float:
    if filtered is None:
        return 1.0
    w = filtered.bandwidth
    s = tustin(w, sample_time)
    return w / (s + w) if filtered.order == 1 else w * w / (s * s + 2 * filtered.damping_ratio * w * s + w * w)


def notch(hole: gr.Notch, sample_time: float | None) -> np.ndarray:
    w, s = hole.frequency, tustin(hole.frequency, sample_time)
    return (s * s + hole.depth * hole.width * w * s + w * w) / (s * s + hole.width * w * s + w * w)


def biquad(one: gr.Biquad, sample_time: float | None) -> np.ndarray:
    s = tustin(one.pole_frequency, sample_time)
    zeros, poles = s / one.zero_frequency, s / one.pole_frequency
    return (zeros**2 + 2 * one.zero_damping * zeros + 1) / (poles**2 + 2 * one.pole_damping * poles + 1)


FILTERS = {
    "none": {},
    "order 1": {"velocity_filter": gr.LowPass(900.0)},
    "order 2": {"velocity_filter": gr.LowPass(1500.0, order=2, damping_ratio=0.9)},
    "notch": {"notches": (gr.Notch(500.0),)},
    "biquads": {"biquads": (gr.Biquad(400.0, 0.2, 900.0, 0.6), gr.Biquad(2000.0, 0.0, 700.0, 1.5))},
    "all": {
        "biquads": (gr.Biquad(700.0, 0.1, 500.0, 0.3),),
        "velocity_filter": gr.LowPass(1500.0, 2),
        "notches": (gr.Notch(500.0, 0.3, 0.0), gr.Notch(1200.0, 1.0, 0.3)),
    },
}


@pytest.mark.parametrize("sample_time", [None, TICK, 3e-4], ids=["continuous", "0.5 ms", "0.3 ms"])
@pytest.mark.parametrize("filters", FILTERS.values(), ids=FILTERS.keys())
@pytest.mark.parametrize("kind", ["PD", "P", "D", "PID", "PI", "I", "PPI", "PPI without ki"])
def test_transfer_is_the_formula(kind, filters, sample_time):
    _, rate, integral = variables(sample_time)
    rate = rate * low_pass(filters.get("velocity_filter"), sample_time)
    controller, expected = {
        "PD": (lambda: gr.PD(2000.0, 30.0, **filters), 2000 + 30 * rate),
        "P": (lambda: gr.PD(2000.0, 0.0, **filters), 2000 + 0 * rate),
        "D": (lambda: gr.PD(0.0, 30.0, **filters), 30 * rate),
        "PID": (lambda: gr.PID(2000.0, 500.0, 30.0, **filters), 2000 + 30 * rate + 500 * integral),
        "PI": (lambda: gr.PID(2000.0, 500.0, 0.0, **filters), 2000 + 500 * integral),
        "I": (lambda: gr.PID(0.0, 500.0, 0.0, **filters), 500 * integral),
        "PPI": (lambda: gr.PPI(40.0, 30.0, 90.0, **filters), (30 + 90 * integral) * (40 + rate)),
        "PPI without ki": (lambda: gr.PPI(40.0, 30.0, **filters), 30 * (40 + rate)),
    }[kind]
    for hole in filters.get("notches", ()):
        expected = expected * notch(hole, sample_time)
    for one in filters.get("biquads", ()):
        expected = expected * biquad(one, sample_time)
    found = controller().transfer(sample_time)
    # P without any rate is the same at all frequencies; a D term alone is relative to its own size
    assert found.response(OMEGA) == pytest.approx(expected, rel=ROUNDING if kind != "PPI" else 4 * ROUNDING)


@pytest.mark.parametrize("sample_time", [None, TICK])
@pytest.mark.parametrize("depth", [0.0, 0.1, 0.5, 1.0, 3.0])
def test_notch_depth_at_its_frequency(depth, sample_time):
    hole = gr.Notch(700.0, 0.5, depth)
    value = gr.PD(1.0, 0.0, notches=hole).transfer(sample_time).response(np.array([700.0, 1e-3]))
    assert value[0] == pytest.approx(depth, abs=1e-12)  # Tustin is exact there
    assert value[1] == pytest.approx(1.0, abs=1e-5)  # leaves low frequencies alone


@pytest.mark.parametrize("sample_time", [None, TICK, 2e-3])
def test_filters_are_exact_at_their_own_frequency(sample_time):
    for order, expected in ((1, 1 / (1 + 1j)), (2, 1 / (2j * 0.6))):
        bandwidth = 800.0
        numerator, denominator = gr.LowPass(bandwidth, order, 0.6).polynomials(sample_time)
        s = 1j * bandwidth
        v = s if sample_time is None else (np.exp(s * sample_time) - 1) / sample_time
        assert np.polyval(numerator, v) / np.polyval(denominator, v) == pytest.approx(expected, rel=1e-12)


def test_default_filter_is_butterworth():
    numerator, denominator = gr.LowPass(100.0, order=2).polynomials(None)
    assert (numerator.tolist(), denominator.tolist()) == ([1e4], pytest.approx([1.0, 100 * sqrt(2), 1e4], rel=1e-15))


def test_sampled_tends_to_continuous():
    """Backward difference and integral each lag by ωT_s/2: 5e-6 relative at T_s = 1e-8 and ω = 1000, all of it in the phase."""
    controller = gr.PID(2000.0, 500.0, 30.0, velocity_filter=gr.LowPass(900.0))
    omega = np.array([1.0, 30.0, 1000.0])
    fast, exact = controller.transfer(1e-8).response(omega), controller.transfer(None).response(omega)
    assert fast == pytest.approx(exact, rel=6e-6)


@pytest.mark.parametrize("sample_time", [None, TICK])
@pytest.mark.parametrize(
    "controller",
    [gr.PD(20.0, 3.0), gr.PID(20.0, 4.0, 3.0), gr.PPI(8.0, 3.0, 2.0, velocity_filter=gr.LowPass(300.0))],
    ids=["PD", "PID", "PPI"],
)
def test_scaled_multiplies_the_output(controller, sample_time):
    once, thrice = (c.transfer(sample_time).response(OMEGA) for c in (controller, controller.scaled(3.0)))
    assert thrice == pytest.approx(3 * once, rel=ROUNDING)


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_plane_keeps_the_other_ratios(sample_time):
    """kp and kd of the plane are torque per position and per velocity; the rest moves along."""
    _, rate, integral = variables(sample_time)
    pid, ppi = gr.PID(20.0, 4.0, 3.0), gr.PPI(8.0, 3.0, 2.0)
    assert pid.in_plane(20.0, 3.0, sample_time).response(OMEGA) == pytest.approx(pid.transfer(sample_time).response(OMEGA), rel=ROUNDING)
    assert ppi.in_plane(24.0, 3.0, sample_time).response(OMEGA) == pytest.approx(
        ppi.transfer(sample_time).response(OMEGA), rel=4 * ROUNDING
    )
    moved = pid.in_plane(40.0, 5.0, sample_time).response(OMEGA)
    assert moved == pytest.approx(40 + 8 * integral + 5 * rate, rel=ROUNDING)


def test_matrix_gains_have_no_scalar_transfer():
    with pytest.raises(gr.GainroomError, match=r"gains of shape \(2, 2\) must be single numbers for one joint"):
        gr.PD(np.eye(2), 0.0).transfer(None)


def test_cascade_of_matrices_multiplies_in_order():
    outer, inner = np.array([[1.0, 2.0], [0.0, 3.0]]), np.array([[2.0, 0.5], [0.5, 1.0]])
    assert gr.PPI(outer, inner).terms()[(0, 0)] == pytest.approx(inner @ outer)
    assert gr.PPI(outer, np.array([2.0, 5.0])).terms()[(0, 0)] == pytest.approx(np.diag([2.0, 5.0]) @ outer)
    assert gr.PPI(np.array([2.0, 5.0]), inner).terms()[(0, 0)] == pytest.approx(inner @ np.diag([2.0, 5.0]))
    assert gr.PPI(np.array([2.0, 5.0]), np.array([3.0, 7.0])).terms()[(0, 0)] == pytest.approx([6.0, 35.0])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gr.PD("stiff", 1.0), ["PD", "kp", "'stiff'", "real number"]),
        (lambda: gr.PD(1.0, float("nan")), ["PD", "kd", "nan", "finite"]),
        (lambda: gr.PID(1.0, float("inf"), 1.0), ["PID", "ki", "inf", "finite"]),
        (lambda: gr.PPI(1.0, [1.0, None]), ["PPI", "kv", "finite"]),
        (lambda: gr.PD([], 1.0).transfer(None), ["PD", "shape (0,)", "single numbers"]),
        (lambda: gr.LowPass(0.0), ["velocity filter", "bandwidth", "0", "> 0"]),
        (lambda: gr.LowPass(10.0, order=3), ["velocity filter", "order", "3", "1 or 2"]),
        (lambda: gr.LowPass(10.0, 2, -1.0), ["velocity filter", "damping_ratio", "-1", "> 0"]),
        (lambda: gr.Notch(-4.0), ["notch", "frequency", "-4", "> 0"]),
        (lambda: gr.Notch(4.0, width=0.0), ["notch", "width", "0", "> 0"]),
        (lambda: gr.Notch(4.0, depth=-0.1), ["notch", "depth", "-0.1", ">= 0"]),
        (lambda: gr.LowPass(1.001 * pi / TICK).polynomials(TICK), ["bandwidth", "6289", "below half the sample rate", "6283"]),
        (lambda: gr.Notch(pi / TICK).polynomials(TICK), ["notch", "frequency", "below half the sample rate"]),
        (lambda: gr.Biquad(0.0, 0.1, 50.0, 0.5), ["biquad", "zero_frequency", "0 rad/s", "> 0"]),
        (lambda: gr.Biquad(40.0, -0.1, 50.0, 0.5), ["biquad", "zero_damping", "-0.1", ">= 0"]),
        (lambda: gr.Biquad(40.0, 0.1, float("inf"), 0.5), ["biquad", "pole_frequency", "inf", "> 0"]),
        (lambda: gr.Biquad(40.0, 0.1, 50.0, 0.0), ["biquad", "pole_damping", "0", "> 0"]),
        (lambda: gr.Biquad(40.0, 0.1, 6300.0, 0.5).polynomials(TICK), ["biquad pole_frequency", "6300", "below half the sample rate"]),
        (lambda: gr.Biquad(6300.0, 0.1, 50.0, 0.5).polynomials(TICK), ["biquad zero_frequency", "6300", "below half the sample rate"]),
        (lambda: gr.PID(0.0, 1.0, 1.0).plane(), ["PID", "ki/kp", "1/0"]),
        (lambda: gr.PPI(1.0, 0.0, 1.0).plane(), ["PPI", "ki/kv", "1/0"]),
    ],
)
def test_errors(make, words):
    assert_refused(make, words)


def test_filter_just_below_nyquist():
    """At 0.999 of the Nyquist frequency the filter is still exact at its own frequency, and stable."""
    bandwidth = 0.999 * pi / TICK
    transfer = gr.PD(0.0, 1.0, velocity_filter=gr.LowPass(bandwidth)).transfer(TICK)
    v = np.expm1(1j * bandwidth * TICK) / TICK
    difference = v / (1 + TICK * v)
    assert transfer.response(np.array([bandwidth]))[0] == pytest.approx(difference / (1 + 1j), rel=1e-9)  # tan(0.999 π/2) costs 3 digits
    assert np.all(np.abs(1 + TICK * transfer.poles) < 1)


@dataclass(frozen=True)
class Jerky(Controller):
    """A type that the package does not know: g (1 + V I/100)."""

    gain: Any
    kind = "jerky"

    @classmethod
    def gain_names(cls) -> tuple[str, ...]:
        return ("gain",)

    def terms(self) -> Terms:
        return {(0, 0): np.asarray(self.gain), (1, 1): np.asarray(self.gain) / 100}


GAIN = np.array([[3.0, 0.4], [-0.7, 2.0]])
TASK = TaskPPI(np.array([7.0, 2.0]), np.array([5.0, 3.0]), np.array([1.0, 0.0]), torque=GAIN, jacobian=GAIN.T)


@pytest.mark.parametrize("sample_time", [None, TICK])
@pytest.mark.parametrize(
    "make",
    [
        lambda time: gr.PD([3.0, 2.0], GAIN, velocity_filter=gr.LowPass(800.0, 2)),
        lambda time: gr.PID(GAIN, [1.0, 0.0], 0.3),
        lambda time: gr.PPI([7.0, 2.0], 5.0, [1.0, 0.0]),
        lambda time: gr.PPI(GAIN, GAIN.T, GAIN, notches=(gr.Notch(300.0, 0.5, 0.1),)),
        lambda time: TASK,
        lambda time: Jerky([3.0, 2.0]),
        lambda time: Compensator(
            signal.TransferFunction([1.0, 2.0], [1.0, 30.0]) if time is None else signal.dlti([1.0], [1.0, -0.5], dt=time)
        ),
    ],
)
def test_on_one_joint_it_does_what_it_does_on_that_joint_of_many(make, sample_time):
    """D_kk of the whole is D of the part: a Compensator, and a type of one's own, once became a PD there."""
    whole, s = make(sample_time), 1j * OMEGA[:-1]
    v = s if sample_time is None else np.expm1(s * sample_time) / sample_time
    for k in range(2):
        alone = whole.on_joint(k, 2).matrix(s, v, 1, sample_time)[:, 0, 0]
        np.testing.assert_allclose(alone, whole.matrix(s, v, 2, sample_time)[:, k, k], rtol=1e-12)


@pytest.mark.parametrize(
    ("controller", "corner"),
    [
        (gr.PD(12.0, 3.0), 12 / 3),  # kp = ω kd
        (gr.PID(kp=0.0, kd=2.0, ki=50.0), sqrt(50 / 2)),  # ki/ω = ω kd
        (gr.PID(kp=10.0, kd=2.0, ki=8.0), 8 / 10),  # ki/ω = kp, before kp = ω kd at 5 and ki/ω = ω kd at 2
        (gr.PID(kp=10.0, kd=40.0, ki=80.0), 10 / 40),  # kp = ω kd, before ki/ω = kp at 8
        (gr.PD(12.0, 0.0), float("inf")),
    ],
)
def test_the_slowest_corner_is_where_two_terms_are_equally_large(controller, corner):
    assert controller.slowest(1) == pytest.approx(corner, rel=1e-15)


def test_gains_for_a_plain_pd_are_those_of_a_pd_where_the_controller_filters_its_output():
    """A lead in series is no gain: with it the same kp and kd are another control law."""

    @dataclass(frozen=True)
    class Led(gr.PD):
        def shaping(self, sample_time):
            return Factored(np.array([-60.0 + 0j]), np.array([-600.0 + 0j]), 10.0) * gr.PD.shaping(self, sample_time)

    assert type(Led(100.0, 10.0).of_pd(50.0, 5.0)) is gr.PD
    assert type(gr.PD(100.0, 10.0, notches=(gr.Notch(300.0),)).of_pd(50.0, 5.0)) is gr.PD
    led = gr.PPI(10.0, 10.0, 2.0, biquads=(gr.Biquad(60.0, 0.5, 600.0, 0.7),)).of_pd(50.0, 5.0)
    assert (type(led), len(led.biquads), led.lead_rises) == (gr.PPI, 1, False)
    assert type(gr.PPI(10.0, 10.0, 2.0).of_pd(50.0, 5.0)) is gr.PPI
