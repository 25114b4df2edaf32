"""Gains to use, and each requirement at its worst with these gains and with those: the first part of every answer on a joint or robot."""

import math
import shlex
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis.margin_record import Margins
from ..errors import at_frequency, listed
from ..studies.analysis import Analysis
from ..studies.state import USUAL_RATE
from ..system.controller import type_of
from ..system.requirements import REQUIREMENTS, Requirements
from .columns import Column, facts, tabulated, yes
from .gains_to_use import joint_gains, kept, robot_gains
from .margin_columns import lacking, margin_value, requirement
from .number_format import digits, hertz, own_gains, rate, span, typed
from .page import Advice, Html, advice_box, table
from .presentation import Part, TextTable, do_this
from .robot_units import unit_of_gain
from .words import AT_USUAL, tone

if TYPE_CHECKING:  # what a robot's study needs is not loaded for a joint's
    from ..design.joint_gains import Recommendation
    from ..studies.joint import JointStudy
    from ..studies.robot import RobotStudy

STATE = "posture/contact"
MANY = 10.0
"""Factor on a present gain above which a recommended one comes with what the model leaves out."""
HALF = 0.5
"""Least share of a joint's gain lost to uncertainty that is reported."""


def verdict_columns(study: Analysis, to_use: Margins | None, heading: str = "new gains") -> list[Column]:
    """Columns of the table of requirements: worst value, nominal, required, met, and with the gains to use.

    A row is a requirement's name; the worst is over states and uncertainty.

    to_use   worst margins of those gains, under this `heading`; None without them
    """
    asked, step = study.system.requirements, study.system.control.sample_time
    uncertain, several = bool(study.system.uncertainty.names), len(study.states) > 1

    def text(name: str, value: float, met: bool | None = None) -> str:
        return margin_value(asked, name, value, met, 3)

    def title(name: str) -> str:
        return REQUIREMENTS[name].titled(study.worst_in(study.worst[name]).margins, len(study.system.source.joint_names) > 1)

    def met(name: str) -> bool | None:
        found = asked.met(name, study.least(study.worst[name], name))
        return found if found is None or study.stable_in_range else False

    def is_open(name: str) -> bool:
        return study.sway_is_open and name in study.swaying

    def worst(name: str) -> str:
        return text(name, study.least(study.worst[name], name), met(name)) if study.stable_in_range else "unstable"

    def nominal(name: str) -> str:
        return text(name, REQUIREMENTS[name].value(study.worst[name].counted)) if study.stable else "unstable"

    def omega(name: str) -> float:
        state = study.worst[name]
        return REQUIREMENTS[name].frequency(study.worst_in(state).margins if study.stable_in_range else state.counted)

    def after(name: str) -> str:
        value = math.nan if to_use is None else REQUIREMENTS[name].value(to_use)
        return "" if to_use is None else text(name, value, asked.met(name, value))

    return [
        Column("in continuous time" if step is None else f"at {rate(1 / step)}", "title", title),
        Column("worst case" if uncertain else "worst" if several else "these gains", "worst", worst),
        Column("nominal" if uncertain else "", "nominal", nominal),
        Column("required", "required", lambda name: requirement(asked, name, 3)),
        Column("met", "met", met, shown=lambda name: "" if met(name) is None else "open" if is_open(name) else yes(met(name))),
        Column("at", "omega", omega, shown=lambda name: "rest" if omega(name) == 0 else at_frequency(omega(name), "", hertz)),
        Column(STATE if several else "", "where", lambda name: study.worst[name].title if several else study.case_of(name)),
        Column(heading if to_use is not None else "", "to_use", after),
        Column("", "name", lambda name: name),
    ]


def verdict_facts(study: Analysis, sentence: str, to_use: Margins | None) -> dict[str, Any]:
    """JSON of the verdict for the app: sentence, tone, table of requirements, and missed ones; `to_use`: see verdict_columns."""
    columns = verdict_columns(study, to_use)
    return {
        "sentence": sentence,
        "tone": tone(study.verdict),
        "rows": [facts(columns, name) for name in study.worst],
        "stable": study.stable,
        "stable_in_range": study.stable_in_range,
        "met": study.requirements_met,
        "unmet": list(study.unmet),
    }


@dataclass(frozen=True)
class ToUse(Advice):
    """Advice with gains to use, or how to get some; without lines if there are none.

    margins  of the gains in `lines`; None if there are none
    column   the heading of those margins in a table
    """

    margins: Margins | None = None
    column: str = "new gains"


NOTHING = ToUse("")


def joint_to_use(study: "JointStudy", call: str = "gainroom joint FILE") -> ToUse:
    """Recommended gains; for a file without a rate whose gains fail at the usual one, those recommended there. `call`: see robot_to_use."""
    return _decide_first(study, call, _joint_gains(study, call))


def _joint_gains(study: "JointStudy", call: str) -> ToUse:
    best, usual, asked = study.recommended, study.at_usual_rate, study.system.requirements
    present = study.system.control.controller
    if best is None or (not present.has_plane and study.requirements_met is not False):  # the recommended gains are of a plain PD
        return NOTHING
    lines = _beside(best.controller, present)
    remarks = _over_ranges(best)
    if usual is not None and usual.requirements_met is False:
        again, folded = usual.recommended, (_not_at_usual_rate(usual.in_range.margins, asked, "control"), lines)
        if again is None:
            return replace(_state_rate(call), folded=folded)
        heading = f"The file has no rate, so {AT_USUAL} is assumed. For that rate alone, {_place(call, 'control')}:"
        write = f"Write your loop's rate there, and for another one run `{call}` again: {_at_half_rate(usual, asked)}"
        lines = [f"{SAMPLED}  # assumed", *_beside(again.controller, present)]
        return ToUse(heading, lines, [write, *_over_ranges(again)], folded, margins=again.worst, column=f"new gains at {AT_USUAL}")
    if usual is not None:
        remarks.append(f"At {AT_USUAL} these keep {kept(usual.in_range.margins, asked)}. {STATE_RATE}")
    if study.requirements_met and study.system.objective == "dynamic_stiffness" and not study.system.asks and _is_stiffer(study, best):
        return ToUse("The present gains may stay: no stiffer ones were found that meet the requirements.", margins=best.worst)
    remarks += _clock(study)
    return ToUse(_heading(study, _place(call, "control")), lines, remarks, margins=None if study.system.asks else best.worst)


def _is_stiffer(study: "JointStudy", best: "Recommendation") -> bool:
    """True if the link is dynamically stiffer with the present gains than with recommended ones, each in its worst case.

    The search keeps a reserve, and rounds what it finds.
    """
    stiffness = REQUIREMENTS["dynamic_stiffness"]
    return stiffness.value(study.in_range.margins) > stiffness.value(best.worst)


def _over_ranges(found: "Recommendation") -> list[str]:
    """Remark on gains for uncertain values that are not proved: what was examined, and why; [] if proved."""
    if found.proved:
        return []
    spare = f" with {100 * found.reserve:g} % of each requirement to spare" if found.reserve > 0.01 else ""
    why = "the proof for those in between did not finish" if spare else "of those in between there is no proof for such requirements"
    return [f"Not proved: the requirements are met{spare} in all cases within the ranges that were checked; {why}."]


def _at_half_rate(usual: "JointStudy", asked: Requirements) -> str:
    """Clause with the margins, in a loop half as fast, of the gains recommended at the usual rate."""
    return f"at {0.5e-3 * USUAL_RATE:g} kHz these gains {lacking(asked, usual.at_rate(0.5 * USUAL_RATE))}."


def _place(call: str, section: str) -> str:
    """Place for lines: "in joint.yaml under `control`"; the file is the last word of its command."""
    return f"in {shlex.split(call)[-1]} under `{section}`"


def other_type(controller: Any, present: Any) -> list[str]:
    """Line of `control` that changes a file's `present` controller to the type of `controller`; [] if both have one type."""
    if type(controller) is type(present):
        return []
    left_out = [name for name in (*present.gain_names(), *present.laws) if name not in controller.gain_names()]
    sensors = ["feedback: motor"] if present.torque_name or present.laws else []
    return [f"type: {type_of(controller)}" + (f"  # leave out {listed(left_out)}" if left_out else ""), *sensors]


def _beside(controller: Any, present: Any) -> list[str]:
    """Lines of gains with units and present values, preceded by the type if it changes."""
    now = {name: value for name, value, _ in own_gains(present)} if type(present) is type(controller) and present != controller else {}
    lines, units = joint_gains(controller), [unit for _, _, unit in own_gains(controller)]
    width = max(map(len, lines))
    present_values = [f"now {typed(now[name])}" if name in now else "" for name, _, _ in own_gains(controller)]
    gains = [
        f"{line:{width}}  # {', '.join(filter(None, parts))}".rstrip(" #")
        for line, *parts in zip(lines, units, present_values, strict=True)
    ]
    return other_type(controller, present) + gains


def robot_to_use(study: "RobotStudy", call: str = "gainroom robot FILE") -> ToUse:
    """Recommended gains of the space that the file's controller acts in. `call`: the command that finds them once the file has a rate."""
    return _decide_first(study, call, _robot_gains(study, call))


TO_WRITE = {
    "rate_unknown": "your loop's rate under `control` (sample_rate_hz)",
    "gearbox_unknown": "`stiffness` and `damping` of the gearboxes under `joints` (`stiffness: rigid` where there is none)",
    "motor_inertia_unknown": "the motors' inertia under `joints` (motor_inertia)",
    "sway": "who damps the sway: `balance: joints` where nothing else holds the robot up, or `balance: controller`",
    "topples_with_weight": "under `model` whether the weight counts (`gravity_stiffness`: false where the controller compensates it)",
    "nothing_required": "what is required under `limits`",
}
"""Instruction to add missing data to a file, by the code of the finding."""


def _decide_first(study: Analysis, call: str, found: ToUse) -> ToUse:
    """Advice to give missing data if that decides, with `found` folded: its gains apply to the robot as read only."""
    missing = [TO_WRITE[one.code] for one in study.verdict.deciding if one.code in TO_WRITE]
    if study.verdict.level != "undecided" or not missing or (found.folded and not found.margins):
        return found
    text = " ".join([f"Gains of the model as it was read: {found.heading[:1].lower()}{found.heading[1:].rstrip(':')}.", *found.remarks])
    folded = (text, found.lines) if found.lines else found.folded
    return ToUse(f"Write into {shlex.split(call)[-1]} {listed(missing)}, and run:", [call], folded=folded)


def _robot_gains(study: "RobotStudy", call: str) -> ToUse:
    from .recommended_gains import links_text, none_text, sway_text  # loads the search for gains, which audits do without

    if study.to_use is None:
        return ToUse(none_text(study))

    gains, found = study.to_use
    remarks, usual, asked = [], study.recommended_at_usual_rate, study.system.requirements
    own, joints = study.controllers_to_use, gains.space == "joint"
    lines, place, now = robot_gains(gains.names, own, gains.space), "control" if joints else "tasks", _now(study, own[0]) if joints else ""
    if joints:
        lines = other_type(own[0], study.system.control.controller) + lines
    if usual is not None and not asked.met_by(usual):
        return replace(_state_rate(call), folded=(_not_at_usual_rate(usual, asked, f"{place}{now}"), lines))
    if found.without_weight and found.topples:
        remarks.append(f"With the weight the robot topples on these in {found.topples[0]}.")
    if joints:
        remarks += filter(None, [sway_text(gains, found, asked, study.system.balance == "controller"), *links_text(study)])
    remarks += _cost_of_ranges(study)
    if usual is not None:
        remarks.append(f"At {AT_USUAL} these keep {kept(usual, asked)}. {STATE_RATE}")
    remarks += _clock(study)
    if study.most_raised > MANY:
        left_out = [*["the stiffness of gearboxes that count as rigid"] * bool(np.isinf(study.system.source.actuators.stiffness).any())]
        left_out += ["encoder noise"] * (not all(one.resolution for one in study.system.drives)) + ["torque limits"]
        remarks.append(
            f"These are up to {digits(study.most_raised, '×', 2)} the present ones, as far as this model's margins go. What it leaves out, "
            f"{listed(left_out)}, may end sooner: bound the gains (`gain_bounds`), and raise them in steps."
        )
    elif study.raised:
        remarks.append(
            f"Some are more than {digits(study.tightest.limit.gain, '×', 3)} the present ones: that limit is of one factor on all gains."
        )
    where = f"{_place(call, place)}{now}"
    heading = _without_weight(found.nearest, where) if found.without_weight else _heading(study, where)
    return ToUse(heading, lines, remarks, margins=study.margins_to_use)


def _without_weight(nearest: str, place: str) -> str:
    """Heading of gains that hold without the robot's weight only: what prevents others, and where these may be used."""
    return (
        f"With the robot's weight no gains were found that meet everything; the nearest: {nearest}. Where the controller compensates the "
        f"weight (`gravity_stiffness: false` under `model`), these do, {place}:"
    )


def _cost_of_ranges(study: "RobotStudy") -> list[str]:
    """Remark on the uncertainty's cost to the joint that loses most, if that is half of its gain or more; [] otherwise."""
    costs = study.uncertainty_cost
    if costs is None or study.exact is None or not np.any(costs >= HALF):
        return []
    k, names = int(np.nanargmax(costs)), [name.replace("_", " ") for name in study.system.uncertainty.names]
    what = "gain" if study.system.objective == "largest_kp" else "dynamic stiffness"
    lost = f"{study.exact.names[k]} {100 * costs[k]:.0f} % of its {what}"
    if len(names) == 1:
        return [f"The range of {names[0]} costs {lost}; a measurement that narrows it gives some back."]
    return [f"The ranges of {listed(names)} cost {lost}; measurements that narrow them give some back."]


def _now(study: "RobotStudy", recommended: Any) -> str:
    """Present gains of the joints with units: " (now kp 2 000 N·m/rad, kd 100 N·m·s/rad)"; the units alone for another controller type."""
    body, present = study.system.source.body, study.system.control.controller
    parts = []
    for key in recommended.gain_keys():
        unit = unit_of_gain(key, body)
        parts.append(f"{key.name} {span(np.atleast_1d(getattr(present, key.name)), unit)}" if type(present) is type(recommended) else unit)
    return f" ({'now ' if type(present) is type(recommended) else ''}{', '.join(parts)})"


SAMPLED = f"sample_rate_hz: {USUAL_RATE:.0f}"
STATE_RATE = f"State the loop's rate under `control`, such as `{SAMPLED}`."


def _state_rate(call: str) -> ToUse:
    """Advice to give the rate if gains hold at no rate yet."""
    reason = f"The file has no rate, and gains found for continuous time would fail at {AT_USUAL}."
    return ToUse(f"{reason} Write your loop's rate {_place(call, 'control')}, such as `{SAMPLED}`, and run:", [call])


def _clock(study: Analysis) -> list[str]:
    """Remark on the loop for which gains found without a rate hold, if the file states it; [] otherwise."""
    if study.system.control.sampling_in_delay:
        return ["The file's delay already contains hold and velocity difference, so all this holds for the sampled loop, too."]
    if study.system.control.continuous:
        return ["All this holds for the continuous loop that the file states (drive.clock); a loop with a rate has less margin."]
    return []


def _not_at_usual_rate(margins: Margins, asked: Requirements, place: str) -> str:
    """Reason why gains for continuous time are not to be used."""
    return f"Gains for continuous time, under {place}; at {AT_USUAL} they {lacking(asked, margins)}:"


def _heading(study: Analysis, place: str) -> str:
    """Heading of recommended gains: whether they replace the present ones, and their file and section."""
    if study.system.asks:
        return f"Write {place}:"
    if study.requirements_met is False:
        return f"Use instead, {place}:"
    return f"The present gains may stay. The stiffest that meet the requirements, {place}:"


def verdict_lines(study: Analysis, to_use: ToUse) -> list[Part]:
    """First parts of the terminal's answer: gains to use with remarks, and the table of every requirement at its worst."""
    drops = ("at", "nominal", to_use.column, "required")
    rows = TextTable.of("", verdict_columns(study, to_use.margins, to_use.column), study.worst, drops)
    return [*do_this(to_use), rows] if to_use.heading else [rows]


def gains_box(study: "JointStudy | RobotStudy", found: ToUse) -> Html | str:
    """Advice box of a page: gains to copy, with every requirement before and after; "" without gains."""
    if not found.heading:
        return ""
    if found.margins is None:  # the cards say as much
        return advice_box(found)
    columns = [one for one in verdict_columns(study, found.margins, found.column) if one.title not in ("at", STATE)]
    return advice_box(found, table(*tabulated(columns, study.worst), sorts=False))
