"""Curves that pass the unit circle, or the negative real axis, and come back between samples: what they cross there comes first.

A pair of crossings that has closed again cannot be seen by counts of roots on both sides of a later one. Gains are such that a bump of a
curve goes over the line by a small part of its height; what that does is told by roots.
"""

import math
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.loop_samples import WHOLE, joint_loops, margins_of_samples, take_samples


def machine(seed: int) -> dict[str, Any]:
    """Two to six joints that hardly feel each other, most of their gearboxes or links with little damping."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    sampled = rng.random() < 0.4
    motor = rng.uniform(0.1, 1, n)
    coupling = 10 ** rng.uniform(-3, -0.5)
    inverse = np.diag(10 ** rng.uniform(-1, 1.5, n))
    own = np.sqrt(np.diag(inverse))
    ties = rng.normal(size=(n, n))
    ties = (ties + ties.T) / 2 * coupling
    np.fill_diagonal(ties, 0)
    inverse = inverse + ties * np.outer(own, own)
    least, *_, most = np.linalg.eigvalsh(inverse)
    if least < 1e-5 * most:
        inverse = inverse + np.eye(n) * (1e-3 * most - least)
    resonance = 10 ** rng.uniform(1.3, 2.9, n)
    stiffness = resonance**2 / (np.diag(inverse) + 1 / motor)
    ratio = 10 ** rng.uniform(-6, -3, n)
    wide = rng.random(n) < 0.3
    ratio = np.where(wide, 10 ** rng.uniform(-2, -0.5, n), ratio)
    viscous = np.where(rng.random(n) < 0.5, 0.0, motor * 10 ** rng.uniform(-1, 1, n))
    bandwidth = 10 ** rng.uniform(2.8, 3.6, n)
    delay = 10 ** rng.uniform(-4, -2.3) * (np.ones(n) if rng.random() < 0.5 else rng.uniform(0.5, 1.5, n))
    crossover = 10 ** rng.uniform(0.7, 2, n)
    kd = motor * crossover
    rng.uniform(size=n)  # drawn, not used
    kp = kd * crossover * 10 ** rng.uniform(-1.5, 0, n)
    step = [1e-3, 5e-4, 2e-3][int(rng.integers(3))] if sampled else None
    damping = 2 * ratio * stiffness / resonance
    return {
        "plant": (inverse, motor, stiffness, damping, viscous),
        "bandwidth": bandwidth,
        "delay": delay,
        "kp": kp,
        "kd": kd,
        "step": step,
    }


def loop_of(m: dict[str, Any], kp: Any = None, kd: Any = None) -> gr.Loop:
    drives = [gr.Drive(*row) for row in zip(m["bandwidth"], [0.9] * len(m["kp"]), m["delay"], strict=True)]
    controller = gr.PD(m["kp"] if kp is None else kp, m["kd"] if kd is None else kd)
    return gr.build_loop(gr.Plant(*m["plant"]), drives, controller, "motor", m["step"])


def scaled(seed: int, factor: float) -> gr.Loop:
    return loop_of(machine(seed)).scaled(factor)


DELAYS = [
    (10650, 10.402893350587894, 0.002742),
    (10641, 2.334087223031942, 0.007849),
    (10929, 4.519873631059288, 0.0074437),  # 500 Hz
    (11495, 5.361556195668989, 0.01176627),  # 1 kHz
    (14425, 6.820216764863812, 9.87e-5),  # 500 Hz
    (11109, 1.858791102302161, 0.015886),
]


@pytest.mark.parametrize(("seed", "factor", "late"), DELAYS)
def test_delay_margin_is_where_stability_is_first_lost(seed, factor, late):
    loop = scaled(seed, factor)
    found = gr.margins(loop)
    assert found.stable
    assert found.delay_certificate is not None
    assert found.delay_certificate.holds
    assert np.real(gr.rightmost_roots(loop.delayed(late)).roots).max() > 0
    assert found.delay_margin < late
    assert np.real(gr.rightmost_roots(loop.delayed(found.delay_margin * (1 - 1e-4))).roots).max() < 0


# seed, factor, ω [rad/s] and the lag or lead [rad] there with which a locus is at −1
PHASES = [
    (12748, 2.9583994472492927, 167.14342404256712, 1.17076648),  # 500 Hz
    (11495, 5.361556195668989, 117.23178558192662, 1.37936667),  # 1 kHz
    (13417, 8.520642187227137, 17.060600838131148, 0.722637294),
    (1806, 0.3074437825697973, 33.31474396719295, 0.724134283),  # 1 kHz
]


@pytest.mark.parametrize(("seed", "factor", "omega", "phase"), PHASES)
def test_phase_margin_is_the_least(seed, factor, omega, phase):
    """Also as a search for gains looks at loops: all margins that people are told."""
    loop = scaled(seed, factor)
    loci = np.linalg.eigvals(loop.response(np.array([omega]))[0])
    assert np.abs(loci + np.exp(1j * phase * np.sign(np.angle(-loci)))).min() < 1e-8  # phase and ω have nine digits
    found = gr.margins(loop)
    assert found.stable
    assert abs(found.phase_margin) <= phase * (1 + 1e-8)
    m = machine(seed)
    one = np.ones(loop.size)
    seen = take_samples(joint_loops(loop_of(m, one, one)), factor * np.array([m["kp"], m["kd"], 0 * one]), WHOLE)
    assert margins_of_samples(seen, loop.size).phase_margin == pytest.approx(abs(found.phase_margin), rel=1e-6)


TURNS_ON_AXIS = {
    "plant": (
        [[5.228716, 0.01560112], [0.01560112, 0.5342702]],
        [0.1908924, 0.4592511],
        [12282.63, 12624.7],
        [0.0599955, 34.07538],
        [0.0, 0.0],
    ),
    "bandwidth": [3045.545, 3197.267],
    "delay": [4.735444e-4, 2.07444e-4],
    "kp": [8.52378, 40.80026],
    "kd": [2.977682, 1.020684],
    "step": None,
}
"""With the second kp between some 2510 and 2680 it is unstable, and stable again above."""

BESIDE_A_PEAK = {
    "plant": (
        [[3.088516, 0.09282653], [0.09282653, 21.95031]],
        [0.435121, 0.423295],
        [241.8985, 1603.492],
        [0.2493277, 0.00225429],
        [0.9312292, 0.0],
    ),
    "bandwidth": [2569.171, 1244.067],
    "delay": [4.568991e-4, 4.509974e-4],
    "kp": [6.32972, 16.31679],
    "kd": [3.482386, 0.03099371],
    "step": None,
}
"""One loop's sensitivity has a peak of 1e5: what is small beside it limits the gains of the second joint."""


def second_kp(kp: float) -> gr.Loop:
    return loop_of(TURNS_ON_AXIS, kp=[TURNS_ON_AXIS["kp"][0], kp])


def test_largest_gain_of_one_joint_is_the_first():
    found = gr.joint_margins(loop_of(TURNS_ON_AXIS)).one_loop
    assert found.certified[1]
    assert found.largest_kp is not None
    assert np.real(gr.rightmost_roots(second_kp(2600.0)).roots).max() > 0
    assert np.real(gr.rightmost_roots(second_kp(3000.0)).roots).max() < 0  # which is no reason to call 10 000 safe
    assert gr.is_stable(second_kp(found.largest_kp[1] * (1 - 1e-5)))
    assert found.largest_kp[1] < 2600.0


def test_factor_on_one_joint_counts_beside_a_peak():
    loop = loop_of(BESIDE_A_PEAK)
    found = gr.margins(loop).one_loop.gain_margin[1]
    assert math.isfinite(found)
    for factor, stable in ((0.99 * found, True), (56.0, False), (280.0, False)):
        own = np.array([1.0, factor])
        assert gr.is_stable(loop_of(BESIDE_A_PEAK, own * BESIDE_A_PEAK["kp"], own * BESIDE_A_PEAK["kd"])) == stable
    assert found < 56.0
