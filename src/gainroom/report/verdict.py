"""What stands first, of one joint and of a robot: every requirement at its worst, and the gains to use."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..analysis.margin_record import Margins
from ..studies.analysis import USUAL_RATE, Analysis
from ..studies.joint import JointStudy
from ..system.requirements import REQUIREMENTS, Requirements
from .columns import Column, tabulated, yes
from .gains_to_use import joint_gains, kept, robot_gains
from .margin_columns import margin_value, requirement
from .number_format import digits, hertz, own_gains
from .page import advice, coded, copied, table
from .robot_units import joint_units

if TYPE_CHECKING:  # what a robot's study needs is not loaded for a joint's
    from ..studies.robot import RobotStudy

MOST_WARNINGS = 3
"""That a terminal shows without being asked for all."""


@dataclass(frozen=True)
class Judged:
    """A margin: at the worst of states and uncertainty, nominally in that state, and with the gains to use; SI, None where there is none.

    name    of the requirement, or "delay_margin"
    omega   where it is, nominally [rad/s]
    where   state and case of the worst, as text
    """

    name: str
    title: str
    worst: str
    nominal: str
    required: str
    met: bool | None
    to_use: str
    omega: float
    where: str


def judged(study: Analysis, to_use: Margins | None) -> list[Judged]:
    """Every requirement, asked for or not, and the delay margin. `to_use`: the worst margins of the recommended gains."""
    asked, rows = study.system.requirements, []
    for name, state in study.worst.items():
        one, least = REQUIREMENTS[name], study.least(state, name)
        nominal, after = one.value(state.margins), None if to_use is None else one.value(to_use)
        met = asked.met(name, least) if study.stable_in_range else None if asked.met(name, least) is None else False
        value = "unstable" if not study.stable_in_range else margin_value(asked, name, least, met, 3)
        case = study.case_of(name)
        where = state.title if len(study.states) > 1 else case
        rows.append(
            Judged(
                name,
                one.label if one.named(state.margins) == one.title else one.named(state.margins),
                value,
                margin_value(asked, name, nominal, None, 3) if study.stable else "unstable",
                requirement(asked, name, 3),
                met,
                "" if after is None else margin_value(asked, name, after, asked.met(name, after), 3),
                one.frequency(state.margins),
                where,
            )
        )
    return rows + ([] if "delay_margin" in REQUIREMENTS or not study.stable_in_range else [_delay(study, to_use)])


def _delay(study: Analysis, to_use: Margins | None) -> Judged:
    """The delay margin, which nobody asks for; over a robot's uncertainty it is not computed."""

    def text(value: float) -> str:
        return digits(1e3 * value, "ms" if math.isfinite(value) else "", 3)

    state = min(study.states, key=lambda state: -math.inf if math.isnan(state.margins.delay_margin) else state.margins.delay_margin)
    after = "" if to_use is None else "–" if math.isnan(to_use.delay_margin) else text(to_use.delay_margin)
    worst, nominal = study.worst_in(state).margins.delay_margin, state.margins
    where = state.title if len(study.states) > 1 else ""
    return Judged("delay_margin", "delay margin", text(worst), text(nominal.delay_margin), "", None, after, nominal.delay_crossover, where)


def judged_columns(study: Analysis) -> list[Column]:
    """Of Judged: the nominal value beside the worst where something is uncertain, and the state where there are several."""
    uncertain, several, step = bool(study.system.uncertainty.names), len(study.states) > 1, study.system.control.sample_time
    return [
        Column("in continuous time" if step is None else f"at {digits(1e-3 / step, 'kHz', 4)}", "", lambda row: row.title),
        Column("worst case" if uncertain else "worst" if several else "these gains", "", lambda row: row.worst),
        *([Column("nominal", "", lambda row: row.nominal)] if uncertain else []),
        Column("required", "", lambda row: row.required),
        Column("met", "", lambda row: "" if row.met is None else yes(row.met)),
        Column("at", "", lambda row: hertz(row.omega) if math.isfinite(row.omega) else ""),
        *([Column("in", "", lambda row: row.where)] if several else []),
        Column("to use", "", lambda row: row.to_use),
    ]


@dataclass(frozen=True)
class ToUse:
    """Gains to use: a heading, lines that can be typed into the file, and sentences about them; no lines where there are none.

    at_usual_rate   lines for USUAL_RATE, where the file has no rate and `lines` would miss a requirement there; the last remark is theirs
    """

    heading: str
    lines: Sequence[str]
    remarks: Sequence[str]
    margins: Margins | None
    at_usual_rate: Sequence[str] = ()


NOTHING = ToUse("", (), (), None)


def joint_to_use(study: JointStudy) -> ToUse:
    """Recommended gains, and where the file has no rate what they keep at the usual one, and what is recommended there."""
    best, usual = study.recommended, study.at_usual_rate
    if best is None:
        return NOTHING
    remarks, there = [] if best.proved else ["Searched over the uncertainty, not proved."], []
    if usual is not None:
        met, again = usual.requirements_met is not False, usual.recommended
        if not met and again is not None:
            there = [SAMPLED, *joint_gains(again.controller)]
        remarks.append(f"{_at_rate(usual.in_range.margins, study.system.requirements, met)} {FOR_THE_RATE if there else STATE_RATE}")
    lines = _beside(best.controller, study.system.control.controller)
    return ToUse(_heading(study, "control"), lines, remarks, best.worst, there)


def _beside(controller: Any, present: Any) -> list[str]:
    """Lines of gains with their units and what they are now."""
    now = {name: value for name, value, _ in own_gains(present)} if type(present) is type(controller) else {}
    lines, units = joint_gains(controller), [unit for _, _, unit in own_gains(controller)]
    width = max(map(len, lines))
    said = [f"now {digits(now[name], '', 4)}" if name in now else "" for name, _, _ in own_gains(controller)]
    return [f"{line:{width}}  # {', '.join(filter(None, parts))}".rstrip(" #") for line, *parts in zip(lines, units, said, strict=True)]


def robot_to_use(study: "RobotStudy") -> ToUse:
    """Recommended gains of the space that the file's controller acts in."""
    if study.to_use is None:
        return NOTHING
    gains, found = study.to_use
    remarks, usual, asked = [], study.at_usual_rate, study.system.requirements
    if found.without_weight:
        remarks.append("Found without the robot's weight: see the warning.")
    if usual is not None:
        met = asked.met_by(usual)
        remarks.append(f"{_at_rate(usual, asked, met)} {STATE_RATE}{'' if met else SEARCHED_THERE}")
    own, joints = study.controllers_to_use, gains.space == "joint"
    units = joint_units(study.system.source.body)
    named = [units.get(name, unit) if own[0].damping_name == "kd" else unit for name, _, unit in own_gains(own[0])]
    heading = _heading(study, "control" if joints else "tasks", f" ({', '.join(named)})" if joints else "")
    return ToUse(heading, robot_gains(gains.names, own, gains.space), remarks, found.margins)


SAMPLED = f"sample_rate_hz: {USUAL_RATE:.0f}"
STATE_RATE = f"State the loop's rate under `control`, such as `{SAMPLED}`."
SEARCHED_THERE = " Gains are then searched for that rate."
FOR_THE_RATE = f"If the loop runs at {USUAL_RATE / 1e3:g} kHz, use there, under `control`:"


def _at_rate(margins: Margins, asked: Requirements, met: bool) -> str:
    start = f"That is for continuous time, as the file has no rate. At {USUAL_RATE / 1e3:g} kHz these gains would keep"
    return f"{start} {kept(margins, asked)}: {'met' if met else 'not met'}."


def _heading(study: Analysis, place: str, units: str = "") -> str:
    if study.requirements_met is False:
        return f"Use instead, under `{place}`{units}:"
    return f"The present gains may stay. The stiffest that meet the requirements, under `{place}`{units}:"


def advice_box(study: "JointStudy | RobotStudy", found: ToUse) -> str:
    """What to do, on a page: gains to copy, with every requirement before and after; "" where there are none."""
    if not found.lines:
        return ""
    columns = [column for column in judged_columns(study) if column.title not in ("at", "in")]
    marks = {"yes": "met", "no": "unmet"}
    beside = table(*tabulated(columns, judged(study, found.margins)), marks=marks, sorts=False)
    there = [copied(found.at_usual_rate)] if found.at_usual_rate else []
    return advice(coded(found.heading), "\n".join(found.lines), *map(coded, found.remarks), *there, beside)
