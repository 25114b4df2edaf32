"""Presentation of a robot study; the tables of its page, and its inputs as text."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..design.gain_sets import RobotGains
from ..errors import at_frequency, listed
from ..robot.contact import Contact
from ..robot.robot import Posture
from ..studies.robot import RobotStudy
from ..studies.state import USUAL_RATE, State, TaskStudy
from ..studies.sweep.summary import SweepSummary, SweptPosture
from ..system.system import System
from .columns import Column, definitions, facts as row_facts, tabulated, units_of
from .gain_advice import ToUse, robot_to_use, verdict_lines
from .gearboxes import gearbox_types, typed_facts
from .margin_columns import margin_facts, required_facts
from .next_commands import audit_of_found, kept
from .number_format import digits, hertz, model_facts, model_text, span
from .over_time import robot_motion_facts
from .page import Html, facts, paragraph, table
from .page_parts import filters, uncertainty_text
from .presentation import Legend, Part, Presentation, TextTable, closing, folded, warned_first
from .recommended_gains import GainSetRow, cost_text, gain_columns, gains_text, inertia_text, recommended_facts, rows, set_columns
from .robot_columns import JOINT, TASK, actuator_facts, state_columns, worst_facts
from .robot_text import notes, sentence, warnings
from .robot_units import joint_units, requirements_text
from .sweep_text import checked_sentence, posture_facts, worse_note
from .workspace import workspace_facts

GRAVITY = {
    True: "its stiffness is counted",
    False: "left out",
    None: "left out; its stiffness is counted in recommended gains where rigid contacts hold the base",
}
MOST_ROWS = 600
"""Most rows of one table: beyond it a page becomes slow; --json has everything."""
SET_CAPTION = (
    "The least of each margin over all loops, all together and one at a time with the other loops closed, in every case examined. "
    "Limited by: the requirement that fails, and where, if the softest joint or direction is made 5 % stiffer."
)
TASK_UNITS = "PD: kp [1/s²], kd [1/s]; P/PI: kp [1/s], kv [1/s], ki [1/s²]."


@dataclass(frozen=True)
class RobotPresentation(Presentation):
    """Presentation of a robot study.

    file         the robot.yaml
    over_sweep   True if postures of a sweep count, too
    swept        limits of the recommended gains in them; None without recommended gains
    worse        without a sweep, a posture with a lower limit than the file's, and the search that found it; None: none was found
    """

    study: RobotStudy
    file: Path = Path()
    over_sweep: bool = False
    swept: SweepSummary | None = None
    worse: tuple[SweepSummary, SweptPosture] | None = None

    @property
    def to_use(self) -> ToUse:
        """Recommended gains, and for joints the commands that audit them; no commands without a file."""
        from ..files.robot_yaml import robot_sections

        found = robot_to_use(self.study, self.call)
        if self.study.to_use is None or not found.margins or self.study.to_use[0].space != "joint" or not self.file.name:
            return found
        audit = audit_of_found(robot_sections(self.file), self.file.parent, self.study.system)
        return replace(found, then=("To audit these gains:", [kept(self.call), audit]))

    def facts(self) -> dict[str, Any]:
        from ..files.gain_context import gain_context
        from ..files.robot_yaml import robot_sections

        study, usual = self.study, self.study.recommended_at_usual_rate
        swept = {"swept": None if self.swept is None else workspace_facts(self.swept)}
        worse = {"worse_posture": None if self.worse is None else posture_facts(*self.worse)}
        met = usual is not None and study.system.requirements.met_by(usual)
        return {
            **study.verdict.facts,
            "robot": study.system.source.name,
            "gainroom": __version__,
            "stable": study.stable,
            "stable_in_range": study.stable_in_range,
            "unstable_at": study.unstable_case or None,
            "sentence": sentence(study),
            "requirements_met": study.requirements_met,
            "unmet": list(study.unmet),
            "required": required_facts(study.system.requirements),
            "balance": study.system.balance or None,
            "worst": {name: worst_facts(study, name) for name in study.worst},
            **model_facts(study.system.control.sample_time),
            "command_delay_ms": 1e3 * study.system.control.command_delay,
            "states": [row_facts(state_columns(), state) for state in study.every],
            "at_usual_rate": None if usual is None else {"sample_rate_hz": USUAL_RATE, **margin_facts(usual), "requirements_met": met},
            "recommended": [recommended_facts(gains) for gains in study.recommended] or None,
            "uncertainty_cost": None if study.exact is None else {"cost": study.uncertainty_cost, "exact": recommended_facts(study.exact)},
            "link_motion": robot_motion_facts(study),
            "actuators": actuator_facts(study.system),
            "gearbox_range": typed_facts(study.system),
            "rigid_gearboxes": list(study.system.source.unknown.get("gearbox_unknown", ())),
            "system": gain_context(robot_sections(self.file) if self.file.name else {}, study.system),
            "assumptions": list(study.system.assumptions),
            "warnings": [*warnings(study), *notes(study)],
            **(swept if self.over_sweep else worse),
        }

    @property
    def elsewhere(self) -> list[str]:
        """Sentences on postures outside the file: one with a lower gain limit, or those of a sweep."""
        if self.worse is not None:
            return [worse_note(*self.worse, self.study.tightest.limit.gain)]
        if self.over_sweep and self.swept is None:
            return ["There are no recommended gains that could be checked in the sweep's postures."]
        return [] if self.swept is None else [checked_sentence(self.swept)]

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        study, use = self.study, self.to_use
        doubts, others = warned_first(warnings(study), verbose)
        parts = [*doubts, sentence(study), *verdict_lines(study, use), *self.elsewhere]
        if verbose:
            parts += [*folded(use), "", *_all_there_is(study)]
            yield [*parts, *closing(self.files, others, study.system.assumptions, notes(study))]
            return
        more = "By state, joint and task: --verbose, or --report."
        yield [*parts, *closing(self.files, others), *([] if self.files.get("Report") else [more])]


def _all_there_is(study: RobotStudy) -> list[Part]:
    """Tables of every state, joint and task, and all recommended gains."""
    columns = state_columns()
    title = f"All joints together ({model_text(study.system.control.sample_time)})"
    states = TextTable.of(title, columns, study.states + study.immobile, ("delay", "one-loop phase", "disk"))
    parts: list[Part] = [states, Legend([states], lambda shown: definitions(columns, shown)), ""]
    drops = ("load", "by itself")
    joints = {state: TextTable.of(f"Joints, {state.title}", JOINT, state.joints, drops).sharing for state in study.tightest_by_contact}
    for state, shown in joints.items():
        parts += [shown, *_task_parts(state)]
    parts.append(Legend([*joints.values()], lambda shown: joint_legend(study.system.source.body, shown)))
    if len(study.system.source.postures) > 1:
        parts.append("Of several postures, these tables show the tightest; --json has them all.")
    parts.append("")
    for gains in study.recommended:
        parts += _gains_parts(gains, study.system.source.states[0])
    return [*parts, requirements_text(study.system)]


def _task_parts(state: State) -> list[Part]:
    if state.tasks is None or not state.tasks.moves:
        return []
    return [TextTable.of(f"Tasks, {state.title}; together {tasks_together(state.tasks)}", TASK, state.tasks.rows), TASK_UNITS, ""]


def _gains_parts(gains: RobotGains, first: tuple[str, str]) -> list[Part]:
    """Parts with the gains that are safe in every state, and their cost; `first`: posture and contact state."""
    safe, *_ = rows(gains)
    text: list[Part] = [*gains_text(gains, first), ""]
    if not safe.acts:
        return text
    columns = gain_columns([safe])
    if gains.inertia is not None:
        columns += gain_columns([safe], gains.inertia)[1:]
    return [TextTable.of(f"Recommended gains, {gains.space} space", columns, range(len(gains.names))).sharing, *text]


def state_table(study: RobotStudy) -> Html:
    """Table of every state: the factor on all gains together, and the margins."""
    columns = state_columns()
    rows = study.states + study.immobile
    headings, texts = tabulated(columns, rows[:MOST_ROWS])
    caption = f"{definitions(columns, headings)} An unstable state has none.{_cut(len(rows))}"
    return table(headings, texts, caption)


def joint_table(states: Sequence[State], caption: str = "") -> Html:
    """Table of every joint in the given states."""
    rows = [(state, row) for state in states for row in state.joints]
    return _several(JOINT, rows, len(states) > 1, lambda shown: f"{caption} {joint_legend(states[0].model.body, shown)}")


def joint_legend(body: Any, shown: Collection[str]) -> str:
    """Legend of the columns of JOINT with these titles, with their units."""
    units = joint_units(body)
    return f"{definitions(JOINT, shown)} {units_of(shown, {name: units[name] for name in ('load', 'kp', 'kd')})}.{units['prismatic']}"


def task_table(states: Sequence[State]) -> Html:
    """Table of every task direction in the given states."""
    found = [(state, state.tasks) for state in states if state.tasks is not None]
    together = [f"{state.title}: {tasks_together(tasks)}" for state, tasks in found]

    def caption(shown: Collection[str]) -> str:
        return (
            f"{definitions(TASK, shown)} {TASK_UNITS} Factors are on the gains, until the robot vibrates. Gains act on accelerations of "
            f"the task: the controller's model takes the inertia out. All directions together: {'; '.join(together)}."
        )

    return _several(TASK, [(state, row) for state, tasks in found for row in tasks.rows], True, caption)


def tasks_together(tasks: TaskStudy) -> str:
    """Factor on all gains of the tasks, as text."""
    return f"{digits(tasks.limit.gain)}{at_frequency(tasks.limit.frequency, text=hertz)}{'' if tasks.limit.stable else ', UNSTABLE'}"


def _several(columns: Sequence[Column], rows: Sequence[tuple[State, Any]], named: bool, caption: Callable[[Collection[str]], str]) -> Html:
    """Table of rows of states, with the state's name in the first cell if there are several. `caption`: from the titles displayed."""
    headings, texts = tabulated(columns, [row for _, row in rows[:MOST_ROWS]])
    names = [f", {state.title}" if named else "" for state, _ in rows]
    return table(
        headings,
        [(first + name, *rest) for (first, *rest), name in zip(texts, names, strict=False)],
        caption(headings) + _cut(len(rows)),
    )


def _cut(rows: int) -> str:
    return f" The first {MOST_ROWS} of {rows} rows; --json has them all." if rows > MOST_ROWS else ""


def gain_tables(gains: RobotGains, system: System) -> list[Html]:
    """Tables of recommended gains: the common set and one per contact state, for joints also over their inertia, and their margins."""
    sets = rows(gains) if len(gains.per_contact) > 1 else rows(gains)[:1]  # of one contact state the set would be the same again
    margins = table(*tabulated(set_columns(system.requirements), sets), SET_CAPTION, sorts=False)
    if not any(row.acts for row in sets):
        return [margins]
    shown, places = [row for row in sets if row.acts or row.gain_set is None], range(len(gains.names))
    plain = table(*tabulated(gain_columns(shown), places), _gain_caption(gains, shown))
    if gains.inertia is None:
        return [paragraph(TASK_UNITS), plain, margins]
    units = joint_units(system.source.body)
    divided = table(*tabulated(gain_columns(shown, gains.inertia), places), inertia_text(system.source.states[0]))
    return [paragraph(f"kp [{units['kp']}], kd [{units['kd']}]:{units['prismatic']}"), plain, divided, margins]


def _gain_caption(gains: RobotGains, shown: Sequence[GainSetRow]) -> str:
    text = cost_text(gains) or "One set for every state."
    if gains.everywhere is None:
        text = "No single set meets the requirements in every state: switch gains with the contacts."
    if any(row.gain_set is not None and np.isnan(row.gain_set.kp).any() for row in shown):
        cause = "that joint cannot move there"
        if gains.space == "task":
            cause = "the joints cannot move that direction there beside the tasks before it"
        text += f" A dash: {cause}, so its gains have no effect."
    return text


def inputs(system: System) -> Html:
    """Inputs used on the page: robot, actuators, drives and control."""
    pairs = [
        *machine(system),
        ("gravity", GRAVITY[system.source.gravity]),
        *((f"posture {name}", angles_text(posture)) for name, posture in list(system.source.postures.items())[:12]),
        *((f"contact {name}", contacts_text(contacts)) for name, contacts in list(system.source.contacts.items())[:12]),
        ("uncertainty", uncertainty_text(system)),
    ]
    return facts(pairs)


def machine(system: System) -> list[tuple[str, str]]:
    """Names and values of the robot, its actuators, drives and control."""
    body, actuators = system.source.body, system.source.actuators
    rigid = int(np.count_nonzero(np.isinf(actuators.stiffness)))
    drives, units = system.drives, joint_units(body)
    return [
        *([] if system.source.name == body.source else [("file", system.source.name)]),
        ("model", body.source),
        ("joints", f"{body.size} actuated, {len(body.locked)} locked; {body.base} base; {digits(body.total_mass, 'kg')}"),
        *(("payload, in that mass", f"{digits(mass, 'kg')} at {frame}") for frame, mass in body.payload.items() if mass),
        ("motor inertia, joint side", span(actuators.motor_inertia, units["load"])),
        (
            "gearbox stiffness",
            span(actuators.stiffness[np.isfinite(actuators.stiffness)], units["kp"])
            + (f"; {rigid} rigid" if rigid else "")
            + (f"; the middle of the range of {listed(kinds)} gearboxes" if (kinds := gearbox_types(system)) else ""),
        ),
        ("gearbox damping", span(actuators.damping, units["kd"])),
        ("viscous friction, motor and link", f"{span(actuators.motor_viscous)} and {span(actuators.link_viscous, units['kd'])}"),
        ("current loops", span([d.bandwidth for d in drives], "rad/s") + f", ζ {span([d.damping_ratio for d in drives])}"),
        ("delay, target to demand torque", span([1e3 * drive.delay for drive in drives], "ms")),
        ("control", _control(system)),
        ("encoders", f"{system.control.feedback} side of the gearboxes"),
    ]


def _control(system: System) -> str:
    control = system.control
    kind = "tasks" if control.controller is None else type(control.controller).__name__
    time = "continuous" if control.sample_time is None else f"sampled at {digits(1 / control.sample_time, 'Hz')}"
    rotors = "" if not system.source.stack else f"; the tasks' model {'counts' if control.rotors else 'leaves out'} the rotors"
    return f"{kind} in {control.space} space; {filters(control)}; {time}{rotors}"


def angles_text(posture: Posture) -> str:
    """Joint angles of a posture as text."""
    angles, unit = posture.angles, "rad, m" if posture.body.prismatic.any() else "rad"
    text = ", ".join(f"{name} {digits(angle, '', 3)}" for name, angle in list(angles.items())[:40])
    return f"{text} {unit}; others 0" if text else "all joints at 0"


def contacts_text(contacts: Sequence[Contact]) -> str:
    """Contacts of a state as text."""
    return "; ".join(f"{one.frame}, {one.kind}, {'rigid' if one.stiffness is None else 'on springs'}" for one in contacts) or "none"
