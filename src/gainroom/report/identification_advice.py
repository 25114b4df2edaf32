"""What to record next, from what a log did not tell well."""

import math

from ..identification import Estimate, GainsFit, JointFit, StiffnessFit, TorqueDelay
from .number_format import digits, hertz

WIDE = 0.03  # relative half-width from which on an inertia or a stiffness is worth another log
WIDE_TICKS = 0.1
REMEDIES = {
    "motor_inertia": "more torque above the resonance, up to a fifth of the tick rate",
    "inertia": "more torque, and less friction beside it",
    "link_inertia": "more torque around the antiresonance, or a link position",
    "stiffness": "more torque around the resonance",
    "delay": "target_torque and actual_torque with steps, or a multisine up to a tenth of the tick rate",
}


def joint_advice(fit: JointFit) -> list[str]:
    """The widest interval and its remedy; what an inadequate model asks for."""
    found = []
    if not fit.adequate:
        found.append(
            "Part of the residual follows the torque: look for a third mass, backlash, a wrong delay or torques of another joint; record a "
            "second log at half the torque: what is linear stays as it is."
        )
    widths = {name: _relative(fit.parameters[name]) for name in REMEDIES if name in fit.parameters}
    if "delay" in widths:  # an error of the delay counts in ticks
        widths["delay"] = fit.parameters["delay"].half_width / fit.sample_time * WIDE / WIDE_TICKS
    widest = max(widths, key=lambda name: widths[name])
    if widths[widest] > WIDE:
        half = _half(fit.parameters[widest])
        found.append(f"The least known is the {widest.replace('_', ' ')}, {half}. Record {REMEDIES[widest]}.")
    if "stiffness" in fit.parameters:
        resonance = hertz(fit.parameters["resonance"].value)
        found.append(f"gainroom identify plan proposes the torque for a sharper log of this joint (resonance {resonance}).")
    return found


def delay_advice(found: TorqueDelay) -> list[str]:
    """Channels that are missing, and excitation."""
    if "actual_torque" not in found.channels:
        return ["Record actual_torque as well: it shows when within a tick a command arrives."]
    if "demand_torque" not in found.channels and found.jitter.deviation > WIDE_TICKS * found.sample_time:
        return ["Record demand_torque as well: it shows the delay of every command."]
    return []


def stiffness_advice(fit: StiffnessFit) -> list[str]:
    """More torque, or turns, where K is not well known."""
    if _relative(fit.stiffness) <= WIDE:
        return []
    return [f"The stiffness is known {_half(fit.stiffness)}. Load the joint several times back and forth, further beyond friction."]


def gains_advice(fit: GainsFit) -> list[str]:
    """Motion that shows the gain that is known worst."""
    found = []
    for name, estimate, remedy in (("kp", fit.kp, "larger set-points"), ("kd", fit.kd, "faster motion, and motor_velocity")):
        if _relative(estimate) > WIDE:
            found.append(f"{name} is known {_half(estimate)}. Record {remedy}.")
    if fit.rate_of_error is None:
        found.append("The set-point hardly moves: whether kd acts on its velocity is not known. Record moving set-points.")
    return found


def _relative(estimate: Estimate) -> float:
    return abs(estimate.half_width / estimate.value) if estimate.value else math.inf


def _half(estimate: Estimate) -> str:
    return f"to ± {digits(100 * _relative(estimate), '%', 2)}"
