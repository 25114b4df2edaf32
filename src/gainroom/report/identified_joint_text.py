"""The joint that `gainroom identify joint` finds, and the stiffness of a locked output, in numbers and in a sentence."""

import math
from collections.abc import Callable
from typing import Any

from ..identification import Estimate, JointFit, StiffnessFit
from ..identification.parameters import PARAMETERS
from .columns import Column
from .estimates import Answer, estimated, interval_text
from .number_format import digits, hertz

HERTZ = ("Hz", 1 / (2 * math.pi))
TITLES = {
    "motor_inertia": "motor inertia J_M",
    "link_inertia": "link inertia J_L",
    "inertia": "inertia",
    "stiffness": "stiffness K",
    "damping": "damping B",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction, motor",
    "link_coulomb": "Coulomb friction, link",
    "weight_sine": "weight along sin q",
    "weight_cosine": "weight along cos q",
    "delay": "delay",
    "resonance": "resonance",
    "antiresonance": "antiresonance",
}
MODELS = {"rigid": "One inertia", "two-mass": "Two masses and a spring", "two-mass with friction": "Two masses and a spring, with friction"}


def _parameter(name: str) -> Callable[[Any], Estimate | None]:
    return lambda fit: fit.parameters.get(name)


def _parameter_column(name: str) -> Column:
    if name == "delay":
        return estimated(TITLES[name], "delay_ms", _parameter(name), "ms", 1e3)
    if PARAMETERS[name] == "rad/s":
        return estimated(TITLES[name], f"{name}_rad_s", _parameter(name), "rad/s", shown_in=HERTZ)
    return estimated(TITLES[name], name, _parameter(name), PARAMETERS[name])


PARAMETER_COLUMNS = tuple(_parameter_column(name) for name in TITLES)
JOINT_COLUMNS = (
    Column("", "model", lambda fit: fit.model),
    Column("", "adequate", lambda fit: fit.adequate),
    Column(
        "explained residual",
        "residual_explained",
        lambda fit: fit.residuals.explained,
        definition="share of the residual that is coherent with the torque: what the model should have explained",
        shown=lambda fit: digits(100 * fit.residuals.explained, "%", 2),
    ),
    Column("", "torque", lambda fit: fit.torque),
)
STIFFNESS_COLUMNS = (
    estimated("stiffness K", "stiffness", lambda fit: fit.stiffness, "N·m/rad", definition="slope of torque over deflection"),
    estimated("friction", "friction", lambda fit: fit.friction, "N·m", definition="half the width of the hysteresis in torque"),
    estimated("hysteresis", "hysteresis", lambda fit: fit.hysteresis, "rad", definition="its width in deflection", shown_in=("mrad", 1e3)),
    estimated("hardening", "hardening", lambda fit: fit.hardening, definition="rise of the slope towards the ends", shown_in=("%", 100.0)),
    Column("offset", "offset", lambda fit: fit.offset, "N·m", "torque at deflection 0", significant=3),
    Column("", "rows", lambda fit: len(fit.torque)),
)


def joint_answer(fit: JointFit) -> Answer:
    """Whether the model is adequate, and what it is."""
    first = ""
    if not fit.adequate:
        share = f"{digits(100 * fit.residuals.explained, '%', 2)} of "
        what = f"{share}what the model leaves follows the torque" if fit.residuals.follows else "what the model leaves repeats itself"
        first = f"Not adequate: {what}: something in the joint is not in the model, and the intervals do not allow for it. "
    return Answer("Joint", first + _model_text(fit), JOINT_COLUMNS, fit, fit.warnings, PARAMETER_COLUMNS)


def _model_text(fit: JointFit) -> str:
    found = fit.parameters
    delay = "" if "delay" not in found else f", delay {digits(1e3 * found['delay'].value, 'ms', 3)}"
    if "stiffness" not in found:
        return f"{MODELS[fit.model]} of {digits(found['inertia'].value, 'kg·m²', 3)}{delay}."
    stiffness = found["stiffness"]
    return (
        f"{MODELS[fit.model]}: resonance {hertz(found['resonance'].value)}, stiffness {digits(stiffness.value, 'N·m/rad')} "
        f"({interval_text(stiffness.low, stiffness.high)}){delay}."
    )


def stiffness_answer(fit: StiffnessFit) -> Answer:
    """The slope, and how wide the hysteresis is."""
    sentence = (
        f"The stiffness is {digits(fit.stiffness.value, 'N·m/rad')} ({interval_text(fit.stiffness.low, fit.stiffness.high)}); friction of "
        f"{digits(fit.friction.value, 'N·m', 3)} makes a hysteresis of {digits(1e3 * fit.hysteresis.value, 'mrad', 3)}."
    )
    assumed = "the output is taken as locked: on a joint whose link moves, this is not its stiffness"
    return Answer("Locked output", sentence, STIFFNESS_COLUMNS, fit, (assumed, *fit.warnings))
