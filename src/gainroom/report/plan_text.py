"""The excitation that `gainroom identify plan` proposes, in numbers and in sentences."""

import math
from typing import Any

from ..identification.plan import NAMES, Plan
from .identified_joint_text import TITLES
from .number_format import digits

EXPECTED = ("motor_inertia", "link_inertia", "stiffness", "damping", "resonance", "antiresonance", "delay")
UNITS = {"torque": "N·m", "speed": "rad/s", "travel": "rad"}
MEANT = {"friction": "no friction", "encoder_step": "an encoder step of {}", "torque_noise": "torque noise of {}"}
LIMIT_TITLES = ("", "reached", "allowed", "binds")
EXPECTED_TITLES = ("", "95 % interval")


def sentence(plan: Plan) -> str:
    """What to run, and how well the stiffness will be known."""
    low, high = (digits(omega / (2 * math.pi), "", 3) for omega in (plan.excitation.frequencies[0], plan.excitation.frequencies[-1]))
    return (
        f"Run a {plan.kind} of {digits(plan.amplitude, 'N·m', 3)} peak from {low} to {high} Hz for "
        f"{digits(float(plan.excitation.time[-1]), 's', 3)}: its log will tell the stiffness to ± {percent(plan.expected['stiffness'])}."
    )


def percent(share: float) -> str:
    """Of one, in two digits."""
    return digits(100 * share, "%", 2)


def limit_rows(plan: Plan) -> list[tuple[str, ...]]:
    """As LIMIT_TITLES says."""
    rows = []
    for name in NAMES:
        allowed = getattr(plan.bounds, name)
        shown = "any" if math.isinf(allowed) else digits(allowed, UNITS[name], 3)
        rows.append((name, digits(plan.reached[name], UNITS[name], 3), shown, "yes" if name == plan.binding else ""))
    return rows


def expected_rows(plan: Plan) -> list[tuple[str, str]]:
    """As EXPECTED_TITLES says."""
    widths = {name: f"± {percent(plan.expected[name])}" for name in EXPECTED}
    if plan.expected["damping"] >= 1:
        widths["damping"] = "not told"
    return [(TITLES[name], width) for name, width in widths.items()]


def assumptions(plan: Plan) -> list[str]:
    """What limits and accuracy rest on."""
    shown = {"encoder_step": digits(plan.hardware.encoder_step, "rad", 2), "torque_noise": digits(plan.hardware.torque_noise, "N·m", 2)}
    assumed = [MEANT[name].format(shown.get(name, "")) for name in plan.assumed]
    held = "the controller of the file holds the joint" if plan.closed else "nothing holds the joint"
    where = "at the nominal values" if plan.cases == 1 else f"in {plan.cases} cases of the ranges"
    found = [
        f"The limits hold {where}, by the linear model without friction and weight; {held} meanwhile.",
        "The accuracy is the Cramér–Rao bound of the model that identify joint fits; log target_torque, actual_torque and motor_position.",
    ]
    if plan.hardware.dry:
        sides = (("motor", plan.hardware.friction), ("link", plan.hardware.link_friction))
        sizes = [f"{digits(size, 'N·m', 3)} on the {side}" for side, size in sides if size]
        found.append(f"Coulomb friction of {' and '.join(sizes)} is included; the damping's interval has what friction may hide of it.")
    elif "friction" not in plan.assumed:
        found.append("It holds for a joint without friction.")
    return found + ([f"Assumed, as nothing was said: {', '.join(assumed)}."] if assumed else [])


def facts(plan: Plan) -> dict[str, Any]:
    """In JSON."""
    return {
        "sentence": sentence(plan),
        "kind": plan.kind,
        "frequencies_hz": (plan.excitation.frequencies / (2 * math.pi)).tolist(),
        "amplitude": plan.amplitude,
        "crest_factor": plan.excitation.crest_factor,
        "duration": float(plan.excitation.time[-1]),
        "limits": {name: {"allowed": getattr(plan.bounds, name), "reached": plan.reached[name]} for name in NAMES},
        "binding": plan.binding,
        "closed_loop": plan.closed,
        "expected": dict(plan.expected),
        "hardware": {**vars(plan.hardware), "assumed": list(plan.assumed)},
        "warnings": list(plan.warnings),
    }
