"""Units, limits that a joint tends to, and joints that decouple: what must not change the answers, and how others must."""

from dataclasses import replace
from math import cos, inf, sin, sqrt

import numpy as np
import pytest

import gainroom as gr
from independent import delay_roots
from independent.joint import PDJoint
from joint_truths import EXAMPLE, TICK, build


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_units_of_torque_do_not_matter(sample_time):
    c = 8.0  # a power of two: not a rounding changes
    scaled = PDJoint(0.2 * c, 0.8 * c, 1e4 * c, 1.0 * c, 2000 * c, 30 * c, EXAMPLE.delay, 4000)
    first, second = gr.margins(build(EXAMPLE, sample_time)), gr.margins(build(scaled, sample_time))
    for name in ("gain_margin", "phase_margin", "delay_margin", "peak_sensitivity", "disk_margin", "phase_crossover"):
        assert getattr(second, name) == pytest.approx(getattr(first, name), rel=1e-12)


@pytest.mark.parametrize("sample_time", [None, TICK])
def test_units_of_time_do_not_matter(sample_time):
    c = 3.0  # seconds become c seconds
    slow = PDJoint(0.2, 0.8, 1e4 / c**2, 1.0 / c, 2000 / c**2, 30 / c, EXAMPLE.delay * c, 4000 / c)
    first = gr.margins(build(EXAMPLE, sample_time))
    second = gr.margins(build(slow, sample_time and sample_time * c))
    for name in ("gain_margin", "phase_margin", "peak_sensitivity", "disk_margin"):
        assert getattr(second, name) == pytest.approx(getattr(first, name), rel=1e-10)
    assert second.delay_margin == pytest.approx(first.delay_margin * c, rel=1e-10)
    assert second.phase_crossover == pytest.approx(first.phase_crossover / c, rel=1e-10)


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_stiff_joint_tends_to_rigid(feedback):
    """1/k enters as (ω/ω_r)² with ω_r = 2.5e6 rad/s: below 1e-6 up to the crossover near 500 rad/s."""
    stiffness = 1e12
    damping = 2 * sqrt(stiffness * 0.16)  # critical, else link feedback rings at the far resonance
    stiff = replace(EXAMPLE, stiffness=stiffness, damping=damping, feedback=feedback)
    first, second = gr.margins(build(stiff)), gr.margins(build(replace(EXAMPLE, stiffness=inf)))
    for name in ("gain_margin", "phase_crossover", "phase_margin", "delay_margin", "peak_sensitivity"):
        assert getattr(first, name) == pytest.approx(getattr(second, name), rel=1e-6)


def test_fast_drive_is_a_short_delay():
    """C(s) = e^{−s 2ζ/ω_c} but for (ω/ω_c)²: 2.5e-7 near the crossover of 500 rad/s at ω_c = 1e6."""
    lag = 2 * EXAMPLE.damping_ratio / 1e6
    first = gr.margins(build(replace(EXAMPLE, bandwidth=1e6)))
    second = gr.margins(build(replace(EXAMPLE, bandwidth=inf, delay=EXAMPLE.delay + lag)))
    for name in ("gain_margin", "phase_crossover", "phase_margin", "delay_margin", "peak_sensitivity"):
        assert getattr(first, name) == pytest.approx(getattr(second, name), rel=1e-6)


@pytest.mark.parametrize("delay", [0.0, 2e-3])
def test_link_feedback_without_damping_is_never_stable(delay):
    joint = replace(EXAMPLE, damping=0.0, feedback="link", delay=delay, bandwidth=inf)
    for factor in (1e-4, 1e-2, 1.0):
        assert delay_roots.count_unstable(joint.scaled(factor)) > 0
        assert not gr.is_stable(build(joint.scaled(factor)))


def test_two_coupled_joints_are_two_single_ones():
    """Equal motors, springs and gains: W = R diag(w) Rᵀ decouples in the axes of R, whatever the angle."""
    weights, angle = np.array([1 / 0.8, 1 / 5.0]), 0.7
    turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
    plant = gr.Plant(
        link_inverse_inertia=turn @ np.diag(weights) @ turn.T,
        motor_inertia=np.array([0.2, 0.2]),
        stiffness=np.array([1e4, 1e4]),
        damping=np.array([1.0, 1.0]),
    )
    loop = gr.build_loop(plant, gr.Drive(4000, 0.9, 2.5e-3), gr.PD(2000, 30))
    singles = [gr.gain_limit(build(replace(EXAMPLE, link_inertia=1 / w))) for w in weights]
    lowest = min(range(2), key=lambda i: singles[i].gain)
    limit = gr.gain_limit(loop)
    assert limit.stable
    assert limit.gain == pytest.approx(singles[lowest].gain, rel=1e-9)
    assert limit.frequency == pytest.approx(singles[lowest].frequency, rel=1e-6)
    mode = limit.mode / limit.mode[np.argmax(np.abs(limit.mode))]
    axis = turn[:, lowest] / turn[np.argmax(np.abs(turn[:, lowest])), lowest]
    assert mode == pytest.approx(axis, abs=1e-6)  # the shape of the critical vibration
