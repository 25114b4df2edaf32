"""What stands first, of one joint and of a robot: every requirement at its worst, and the gains to use."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..analysis.margin_record import Margins
from ..studies.analysis import USUAL_RATE, Analysis
from ..studies.joint import JointStudy
from ..studies.robot import RobotStudy
from ..system.requirements import REQUIREMENTS, Requirements
from .columns import Column, tabulated, yes
from .gains_to_use import joint_gains, kept, robot_gains
from .margin_columns import margin_value, requirement
from .number_format import digits, hertz
from .page import advice, table

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
    after = "" if to_use is None or math.isnan(to_use.delay_margin) else text(to_use.delay_margin)
    worst, nominal = study.worst_in(state).margins.delay_margin, state.margins
    where = state.title if len(study.states) > 1 else ""
    return Judged("delay_margin", "delay margin", text(worst), text(nominal.delay_margin), "", None, after, nominal.delay_crossover, where)


def judged_columns(study: Analysis) -> list[Column]:
    """Of Judged: the nominal value beside the worst where something is uncertain, and the state where there are several."""
    uncertain, several = bool(study.system.uncertainty.names), len(study.states) > 1
    columns = [
        Column("", "", lambda row: row.title),
        Column("worst case" if uncertain else "worst" if several else "these gains", "", lambda row: row.worst),
        *([Column("nominal", "", lambda row: row.nominal)] if uncertain else []),
        Column("required", "", lambda row: row.required),
        Column("met", "", lambda row: "" if row.met is None else yes(row.met)),
        Column("to use", "", lambda row: row.to_use),
        Column("at", "", lambda row: hertz(row.omega) if math.isfinite(row.omega) else ""),
    ]
    return [*columns, *([Column("in", "", lambda row: row.where)] if several else [])]


@dataclass(frozen=True)
class ToUse:
    """Gains to use: a heading, lines that can be typed into the file, and sentences about them; no lines where there are none."""

    heading: str
    lines: Sequence[str]
    remarks: Sequence[str]
    margins: Margins | None


def to_use(study: JointStudy | RobotStudy) -> ToUse:
    """Of a joint and of a robot."""
    return joint_to_use(study) if isinstance(study, JointStudy) else robot_to_use(study)


def joint_to_use(study: JointStudy) -> ToUse:
    """Recommended gains, and what they keep at the usual rate where the file has none."""
    best, usual = study.recommended, study.at_usual_rate
    if best is None:
        return ToUse("", (), (), None)
    remarks = []
    if usual is not None:
        met, again = usual.requirements_met is not False, usual.recommended
        there = "" if met or again is None else f" There use {', '.join(joint_gains(again.controller))}."
        remarks = [_at_rate(usual.in_range.margins, study.system.requirements, met) + there, STATE_RATE]
    if not best.proved:
        remarks.append("Searched over the uncertainty, not proved.")
    return ToUse(_heading(study, "control"), joint_gains(best.controller), remarks, best.worst)


def robot_to_use(study: RobotStudy) -> ToUse:
    """Recommended gains of the space that the file's controller acts in."""
    if study.to_use is None:
        return ToUse("", (), (), None)
    gains, found = study.to_use
    remarks, usual, asked = [], study.at_usual_rate, study.system.requirements
    if usual is not None:
        remarks = [_at_rate(usual, asked, asked.met_by(usual)), STATE_RATE]
    if found.without_weight:
        remarks.append("Found without the robot's weight: see the warning.")
    return ToUse(_heading(study, "control" if gains.space == "joint" else "tasks"), robot_gains(found, gains), remarks, found.margins)


STATE_RATE = f"State the loop's rate under `control:`, as sample_rate_hz: {USUAL_RATE:.0f}."


def _at_rate(margins: Margins, asked: Requirements, met: bool) -> str:
    return f"At {USUAL_RATE / 1e3:g} kHz they keep {kept(margins, asked)}: {'met' if met else 'not met'}."


def _heading(study: Analysis, place: str) -> str:
    if study.requirements_met is False:
        return f"Use instead, under `{place}:`"
    return f"These gains may stay. The stiffest that meet the requirements, under `{place}:`"


def advice_box(study: JointStudy | RobotStudy, found: ToUse) -> str:
    """What to do, on a page: gains to copy, with every requirement before and after; "" where there are none."""
    if not found.lines:
        return ""
    columns = [column for column in judged_columns(study) if column.title not in ("at", "in")]
    marks = {"yes": "met", "no": "unmet"}
    beside = table(*tabulated(columns, judged(study, found.margins)), marks=marks, sorts=False)
    remarks = [text.replace("`", "") for text in found.remarks]
    return advice(found.heading.replace("`", ""), "\n".join(found.lines), *remarks, beside)
