"""Sampling in the core's extended precision against partial fractions in 200 digits of mpmath, and its numbers against mpmath's."""

import mpmath
import numpy as np
import pytest

import gainroom as gr
from draws import draw_setup
from gainroom.errors import GainroomError
from gainroom.system.linear.transfer_function import Factored, sample
from wide_joints import narrow, wide

DIGITS = 200
SHARES = (1e-4, 0.03, 0.2, 0.5, 0.9, 1.0)  # of the Nyquist frequency


def reference(system: Factored, step: float, fraction: float, theta: float) -> complex:
    """The response at z = e^{jθ}; coinciding poles a 1e-60 part apart, which moves it by about as much."""
    with mpmath.workdps(DIGITS):
        tick, late, z = mpmath.mpf(step), mpmath.mpf(fraction), mpmath.expj(mpmath.mpf(theta))
        poles: list = []
        for pole in system.poles.tolist():
            place = mpmath.mpmathify(pole)
            while any(abs(place - other) * tick < mpmath.mpf(10) ** -60 for other in poles):
                place += mpmath.mpf(10) ** -60 / tick
            poles.append(place)
        total = mpmath.mpf(0)
        for k, p in enumerate(poles):
            residue = system.gain * mpmath.fprod(p - mpmath.mpmathify(zero) for zero in system.zeros.tolist())
            residue /= mpmath.fprod(p - other for j, other in enumerate(poles) if j != k)
            whole, part = mpmath.exp(p * tick), mpmath.exp(p * (1 - late) * tick)
            now, before = ((part - 1) / p, (whole - part) / p) if p else (tick * (1 - late), tick * late)
            total += residue * (now * z + before) / (z * (z - whole))
        return complex(total)


def checked(system: Factored, step: float, fraction: float, tolerance: float = 1e-11) -> None:
    """Within the rounding of products of a dozen roots in double precision, more where the response passes beside a zero or a pole."""
    found = sample(system, step, fraction)
    for share in SHARES:
        theta = np.pi * share
        expected, value = reference(system, step, fraction, theta), found.response(theta / step)
        v = np.expm1(1j * theta) / step
        roots = np.concatenate([found.zeros, found.poles])
        near = np.max(np.abs(v) / np.maximum(np.abs(v - roots), 1e-300), initial=1.0)
        assert abs(value / expected - 1) < tolerance * near, (system, step, fraction, share)


@pytest.mark.parametrize("seed", range(24))
def test_drawn_joints(seed: int):
    draw = (lambda rng: draw_setup(rng, True).loop(), lambda rng: wide(rng, False).loop(), lambda rng: narrow(rng, False).loop())[seed % 3]
    loop = draw(np.random.default_rng([31, seed]))
    assert loop.unsampled is not None
    assert loop.sample_time is not None
    for fraction in (0.0, 1e-9, 0.3, 1 - 1e-12):
        checked(loop.unsampled, loop.sample_time, fraction)


@pytest.mark.parametrize("apart", [0.0, 1e-300, 1e-15, 1e-9, 1e-3])
@pytest.mark.parametrize("fraction", [0.0, 0.4])
def test_poles_that_coincide(apart: float, fraction: float):
    """Up to four at one place and double pairs: partial fractions that cancel by 1e66."""
    real = -100.0 * (1 + apart * np.arange(4))
    pair = (-50 + 300j) * (1 + apart * np.arange(2))
    checked(Factored(np.zeros(0, complex), real.astype(complex), 1e8), 1e-3, fraction)
    checked(Factored(np.array([-3.0 + 0j]), np.concatenate([[0, 0], pair, pair.conj()]), 1e9), 1e-3, fraction)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e6])
def test_units_of_time(unit: float):
    poles, zeros = np.array([0, 0, -3 + 220j, -3 - 220j, -3600 + 1743j, -3600 - 1743j]) / unit, np.array([-0.5 + 110j, -0.5 - 110j]) / unit
    checked(Factored(zeros, poles, 1e9 / unit**4), 5e-4 * unit, 0.37)
    checked(Factored(zeros, poles, 1e9 / unit**4), 1e-7 * unit, 0.37)  # the numerator is 1e-15 of its terms


def test_what_cannot_be_sampled():
    with pytest.raises(GainroomError, match="cannot be sampled every 1 ms"):
        sample(Factored(np.zeros(0, complex), np.array([-1e300 + 0j, -1.0]), 1.0), 1e-3)
    with pytest.raises(GainroomError, match="too fast to be sampled"):
        sample(Factored(np.zeros(0, complex), np.array([1e6 + 0j]), 1.0), 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_delay_margin_beside_a_fine_search(seed: int):
    """No delay up to the margin is unstable, on a grid of a 40th of it, by the closed loop's own roots."""
    rng = np.random.default_rng([32, seed])
    while True:
        case = narrow(rng, False)
        loop = case.loop()
        found = gr.margins(loop)
        if found.stable and np.isfinite(found.delay_margin):
            break
    for share in np.arange(1, 40) / 40:
        assert gr.rightmost_roots(loop.delayed(share * found.delay_margin), 1).roots.real.max() < 1e-6
    assert gr.rightmost_roots(loop.delayed(1.001 * found.delay_margin), 1).roots.real.max() > 0
