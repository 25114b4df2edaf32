"""Unmet requirements of a robot: what each means for several coupled loops, and how a change of gains would change it."""

import math
from dataclasses import replace

from ..analysis.quick_margins import quick_margins
from ..errors import listed
from ..studies.robot import RobotStudy
from ..studies.state import State
from .number_format import hertz, margin_value
from .page import Html, paragraph

MORE, LESS = 1.25, 0.8
MEANING = {
    "gain_margin": "Gain margin of {n} loops: the smallest factor, above or below 1, at which the robot starts to vibrate, on all gains at "
    "once or on the gains of one joint.",
    "phase_margin": "Phase margin of {n} loops: the smallest phase lag or lead at which the robot starts to vibrate, in all loops at once "
    "or in one loop. It belongs to the robot, not to a joint: where legs and ground couple the loops, it may be far less than that of "
    "every joint by itself.",
    "peak_sensitivity": "Peak sensitivity Ms of {n} loops: the largest amplification of disturbances by one loop, other loops closed, at "
    "any frequency; 1/Ms is the least distance of its return ratio from −1.",
}


def remedies(study: RobotStudy) -> list[Html]:
    """A paragraph for every unmet requirement."""
    paragraphs = [paragraph(" ".join(_sentences(study, name, state))) for name, state in study.unmet.items()]
    if paragraphs and any(gains.everywhere is not None for gains in study.recommended):
        paragraphs.append(paragraph("The recommended gains below meet every requirement."))
    return paragraphs


def _sentences(study: RobotStudy, name: str, state: State) -> list[str]:
    asked, value = study.system.requirements, state.margins.least(name)
    if math.isnan(value):
        return [MEANING[name].format(n=state.model.size), f"It is not known in {state.title}."]
    least = margin_value(asked, name, value, False, 3)
    return [
        MEANING[name].format(n=state.model.size),
        f"It is {least} in {state.title}{_frequency(name, state)}.",
        _trials(study, name, state),
    ]


def _frequency(name: str, state: State) -> str:
    """The gain crossover where the phase margin is that of all loops at once."""
    margins = state.margins
    shared = name == "phase_margin" and state.margins.named(name) == "phase margin"
    return f", at {hertz(margins.gain_crossover)}" if shared else ""


def _trials(study: RobotStudy, name: str, state: State) -> str:
    """The margin with 1.25 and 0.8 times the damping gains, and with 0.8 times the stiffness gains."""
    system, asked = study.system, study.system.requirements
    controller = system.controller(state.model)
    rate = controller.damping_name
    better, worse = [], []
    for gain, factor in ((rate, MORE), (rate, LESS), ("kp", LESS)):
        changed = replace(controller, **{gain: factor * getattr(controller, gain)})
        found = quick_margins(system.loop(state.model, changed))
        value, own = found.least(name), state.margins.least(name)
        helps = found.stable and (value < own if name == "peak_sensitivity" else value > own)
        known = "not known" if math.isnan(value) else margin_value(asked, name, value, None, 3)
        outcome = known if found.stable else "unstable"
        (better if helps else worse).append(f"{outcome} with all {gain} × {factor:g}")
    if not better:
        return f"No small change of all gains improves it ({listed(worse)}). Less delay, or stiffer or better damped gearboxes, would."
    without = f", but {listed(worse)}" if worse else ""
    return f"It would be {listed(better)}{without}."
