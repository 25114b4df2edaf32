"""Fig. 4: Bode plot of the joint with and without elasticity."""

import math
from collections.abc import Iterator

import numpy as np
from scipy.optimize import root_scalar

from ..system.linear.transfer_function import Factored
from .joints import RATIO, joint_with_load, rigid, torque_to_position
from .picture import Mark, Picture, bode, decibels
from .row import Row, compare

JOINT = joint_with_load(RATIO)


def rows() -> Iterator[Row]:
    """Rows for dip and peak of the exact response, against the closed forms of the undamped joint."""
    response = torque_to_position(JOINT).scalar
    assert response is not None
    reduced = JOINT.motor_inertia * JOINT.link_inertia / (JOINT.motor_inertia + JOINT.link_inertia)
    for name, formula, text, inertia in (
        ("antiresonance", JOINT.antiresonance, "√(K/J_L)", JOINT.link_inertia),
        ("resonance", JOINT.resonance, "√(K (J_M + J_L)/(J_M J_L))", reduced),
    ):
        damping_ratio = JOINT.damping / (2 * math.sqrt(JOINT.stiffness * inertia))
        note = (
            f"The paper prints no number: {text}, against the extremum of the exact response, found by itself. "
            f"B moves it by a few ζ², ζ = {damping_ratio:.2g}. J_M = 1.0 (inferred: 1.0e-4 printed, behind 100:1)."
        )
        yield compare(f"fig4.{name}_rad_s", formula, _extremum(response, formula), "rad/s", 4 * damping_ratio**2 * formula, note)


def pictures() -> Iterator[Picture]:
    """The figure."""
    loops = {"with elasticity": torque_to_position(JOINT), "without elasticity": torque_to_position(rigid(JOINT))}
    marks = tuple(
        Mark(omega, decibels(loops["with elasticity"], omega), f"{name}<br>{omega:.3g} rad/s", side=side)
        for name, omega, side in (("anti-resonance", JOINT.antiresonance, "left below"), ("resonance", JOINT.resonance, "right above"))
    )
    whole = JOINT.motor_inertia + JOINT.link_inertia
    step = 20 * math.log10(whole / JOINT.motor_inertia)
    caption = (
        f"Below the anti-resonance motor and load move as one ({whole:.3g} kg·m²). Above the resonance the motor moves alone "
        f"({JOINT.motor_inertia:.3g} kg·m²), so the same torque moves it {step:.3g} dB more: that is gain margin lost to elasticity."
    )
    title = "Fig. 4. Torque to motor position: elasticity frees the motor from its load at high frequency"
    yield bode(title, caption, loops, (-200, 200), (-190, 10), marks)


def _extremum(response: Factored, near: float) -> float:
    """The ω within 5 % of `near` where |P_M(jω)| has an extremum: d log|P_M|/dω = 0."""

    def slope(omega: float) -> float:
        value, derivative = response.response_and_slope(np.array([omega]))
        return float((derivative / value).real[0])

    return float(root_scalar(slope, bracket=(0.95 * near, 1.05 * near), xtol=1e-12 * near).root)
