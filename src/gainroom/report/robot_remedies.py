"""Unmet requirements of a robot: what each means for several coupled loops, and how a change of gains would change it."""

import math
from dataclasses import replace

from ..errors import listed
from ..studies.robot import RobotStudy
from ..studies.state import State, margins_of
from ..system.requirements import REQUIREMENTS, Requirement
from .margin_columns import margin_value
from .number_format import hertz
from .page import Html, paragraph

MORE, LESS = 1.25, 0.8


def remedies(study: RobotStudy) -> list[Html]:
    """A paragraph for every unmet requirement."""
    paragraphs = [paragraph(" ".join(_sentences(study, name, state))) for name, state in study.unmet.items()]
    if paragraphs and any(gains.everywhere is not None for gains in study.recommended):
        paragraphs.append(paragraph("The recommended gains below meet every requirement."))
    return paragraphs


def _sentences(study: RobotStudy, name: str, state: State) -> list[str]:
    asked, one = study.system.requirements, REQUIREMENTS[name]
    value, omega = one.value(state.margins), one.frequency(state.margins)
    meaning = f"{one.label[0].upper()}{one.label[1:]} of {state.model.size} loops: {one.meaning or 'the worst of all.'}"
    if math.isnan(value):
        return [meaning, f"It is not known in {state.title}."]
    at = f", at {hertz(omega)}" if math.isfinite(omega) else ""
    return [meaning, f"It is {margin_value(asked, name, value, False, 3)} in {state.title}{at}.", _trials(study, one, state)]


def _trials(study: RobotStudy, one: Requirement, state: State) -> str:
    """The margin with 1.25 and 0.8 times the damping gains, and with 0.8 times the stiffness gains."""
    system, asked = study.system, study.system.requirements
    controller = system.controller(state.model)
    rate = controller.damping_name
    better, worse = [], []
    for gain, factor in ((rate, MORE), (rate, LESS), ("kp", LESS)):
        changed = replace(controller, **{gain: factor * getattr(controller, gain)})
        found = margins_of(system.loop(state.model, changed))
        value, own = one.value(found), one.value(state.margins)
        helps = found.stable and (value < own if one.at_most else value > own)
        known = "not known" if math.isnan(value) else margin_value(asked, one.name, value, None, 3)
        outcome = known if found.stable else "unstable"
        (better if helps else worse).append(f"{outcome} with all {gain} × {factor:g}")
    if not better:
        return f"No small change of all gains improves it ({listed(worse)}). Less delay, or stiffer or better damped gearboxes, would."
    without = f", but {listed(worse)}" if worse else ""
    return f"It would be {listed(better)}{without}."
