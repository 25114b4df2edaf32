"""What a requirement that a robot does not keep means for several loops at once, and what a change of its gains would do to it."""

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
    "gain_margin": "Gain margin of {n} loops: the smallest factor, up or down, at which the robot vibrates when it multiplies all gains at "
    "once, or those of one joint while the others stay.",
    "phase_margin": "Phase margin of {n} loops: the smallest angle at which the robot vibrates when all loops lag or lead by it at once, "
    "or one loop while the others stay. It belongs to the robot, not to a joint: where legs and ground couple the loops, it may be far "
    "less than every joint has by itself.",
    "peak_sensitivity": "Peak sensitivity Ms of {n} loops: the most by which one loop, the others closed, magnifies disturbances at some "
    "frequency; 1/Ms is how near its return ratio comes to −1.",
}


def remedies(study: RobotStudy) -> list[Html]:
    """A paragraph for every requirement that is not kept."""
    told = [paragraph(" ".join(_words(study, name, state))) for name, state in study.unmet.items()]
    keep = "Gains to use, further down, keep all that is required."
    return [*told, paragraph(keep)] if told and any(gains.everywhere is not None for gains in study.recommended) else told


def _words(study: RobotStudy, name: str, state: State) -> list[str]:
    asked, value = study.spec.requirements, state.margins.least(name)
    if math.isnan(value):
        return [MEANING[name].format(n=state.model.size), f"In {state.title} it is not known."]
    least = margin_value(asked, name, value, False, 3)
    return [
        MEANING[name].format(n=state.model.size),
        f"Here it is {least} in {state.title}{_frequency(name, state)}.",
        _trials(study, name, state),
    ]


def _frequency(name: str, state: State) -> str:
    """Where a phase margin that all loops share is lost."""
    margins = state.margins
    shared = name == "phase_margin" and state.margins.named(name) == "phase margin"
    return f", at {hertz(margins.gain_crossover)}" if shared else ""


def _trials(study: RobotStudy, name: str, state: State) -> str:
    """The margin with more and with less damping, and with less stiffness."""
    spec, asked = study.spec, study.spec.requirements
    controller = spec.controller(state.model)
    rate = controller.damping_name
    better, worse = [], []
    for gain, factor in ((rate, MORE), (rate, LESS), ("kp", LESS)):
        changed = replace(controller, **{gain: factor * getattr(controller, gain)})
        found = quick_margins(spec.loop(state.model, changed))
        value, own = found.least(name), state.margins.least(name)
        helps = found.stable and (value < own if name == "peak_sensitivity" else value > own)
        known = "not known" if math.isnan(value) else margin_value(asked, name, value, None, 3)
        told = known if found.stable else "vibration"
        (better if helps else worse).append(f"{told} with all {gain} times {factor:g}")
    if not better:
        return f"No small change of all gains mends it ({listed(worse)}): less delay or stiffer, better damped gearboxes would."
    without = f", but {listed(worse)}" if worse else ""
    return f"It would be {listed(better)}{without}."
