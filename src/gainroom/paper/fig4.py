"""Fig. 4: Bode plot of the joint with and without elasticity."""

import math

import numpy as np
from scipy.optimize import root_scalar

from ..linear.transfer_function import Factored
from .joints import joint_with_load, rigid, torque_to_position
from .picture import BodePicture, Mark, bode_curve
from .row import Row, compare

RATIO = 16.0  # the largest of Fig. 5; the paper does not print which one Fig. 4 shows


def rows() -> list[Row]:
    """Where the exact response has its dip and its peak, against the closed forms of the undamped joint."""
    joint = joint_with_load(RATIO)
    response = torque_to_position(joint).scalar
    assert response is not None
    inertia = joint.motor_inertia * joint.link_inertia / (joint.motor_inertia + joint.link_inertia)
    result = []
    for name, formula, text, swinging in (
        ("antiresonance", joint.antiresonance, "√(K/J_L)", joint.link_inertia),
        ("resonance", joint.resonance, "√(K (J_M + J_L)/(J_M J_L))", inertia),
    ):
        damping_ratio = joint.damping / (2 * math.sqrt(joint.stiffness * swinging))
        note = (
            f"The paper prints no number: {text}, against the extremum of the exact response, found by itself. "
            f"B moves it by a few ζ², ζ = {damping_ratio:.2g}. J_M = 1.0 (inferred: 1.0e-4 printed, behind 100:1)."
        )
        found = _extremum(response, formula)
        result.append(compare(f"fig4.{name}_rad_s", formula, found, "rad/s", 4 * damping_ratio**2 * formula, note))
    return result


def pictures() -> list[BodePicture]:
    """The figure."""
    joint = joint_with_load(RATIO)
    curves = (
        bode_curve("with elasticity", torque_to_position(joint)),
        bode_curve("without elasticity", torque_to_position(rigid(joint))),
    )
    marks = tuple(
        Mark(
            0,
            omega,
            float(np.interp(omega, curves[0].omega, curves[0].magnitude)),
            f"{name}<br>{omega:.3g} rad/s",
            above=name == "resonance",
        )
        for name, omega in (("anti-resonance", joint.antiresonance), ("resonance", joint.resonance))
    )
    whole = joint.motor_inertia + joint.link_inertia
    step = 20 * math.log10(whole / joint.motor_inertia)
    caption = (
        f"Below the anti-resonance motor and load move as one ({whole:.3g} kg m²). Above the resonance the motor moves alone "
        f"({joint.motor_inertia:.3g} kg m²), so the same torque moves it {step:.3g} dB more: that is gain margin lost to elasticity."
    )
    title = "Fig. 4. Torque to motor position: elasticity frees the motor from its load at high frequency"
    return [BodePicture("fig4", title, caption, curves, marks, (-200, 200), (-190, 10))]


def _extremum(response: Factored, near: float) -> float:
    """The ω within 5 % of `near` where |P_M(jω)| has an extremum: d log|P_M|/dω = 0."""

    def slope(omega: float) -> float:
        value, derivative = response.response_and_slope(np.array([omega]))
        return float((derivative / value).real[0])

    return float(root_scalar(slope, bracket=(0.95 * near, 1.05 * near), xtol=1e-12 * near).root)
