"""The tables of a robot's page, and its inputs as text."""

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from ..analysis.margin_record import Margins
from ..design.robot_gains import GainSet, RobotGains
from ..linear.arrays import Floats
from ..robot.contact import Contact
from ..robot.robot import Posture
from ..studies.robot import RobotStudy
from ..studies.state import State, TaskStudy
from ..system.requirements import REQUIREMENTS, Requirement
from ..system.system import System
from .columns import JOINT, TASK, Column, definitions, requirement, state_columns, tabulated
from .number_format import digits, hertz, quantity
from .page import Html, facts, paragraph, table
from .page_parts import filters
from .robot_text import limited_by
from .robot_units import joint_units

GRAVITY = {
    True: "its stiffness is counted",
    False: "left out",
    None: "left out; its stiffness is counted in gains to use where rigid contacts hold the base",
}
MARKS = {"yes": "met", "no": "unmet", "unstable": "unmet", "not confirmed": "unmet"}
MOST_ROWS = 600
"""Of one table: beyond it a page becomes slow; --json has everything."""
Named = tuple[str, GainSet | None]
"""A set of gains under its name."""
TASK_UNITS = "PD: kp [1/s²], kd [1/s]; P/PI: kp [1/s], kv [1/s], ki [1/s²]."


def folded(summary: str, *parts: Html) -> Html:
    """Parts that open on a click."""
    return Html(f"<details><summary>{escape(summary)}</summary>{''.join(parts)}</details>")


def state_table(study: RobotStudy) -> Html:
    """Every state: the factor on all gains together, and the margins."""
    columns = state_columns()
    return _table(columns, study.states + study.immobile, f"{definitions(columns)} Margins of an unstable robot are meaningless.")


def joint_table(states: Sequence[State], caption: str = "") -> Html:
    """Every joint in the given states."""
    rows = [(state, row) for state in states for row in state.joints]
    return _several(JOINT, rows, len(states) > 1, f"{caption} {joint_legend(states[0].model.body)}")


def joint_legend(body: Any) -> str:
    """What the columns of JOINT are, with their units."""
    units = joint_units(body)
    return f"{definitions(JOINT)} load [{units['load']}], kp [{units['kp']}], kd [{units['kd']}].{units['prismatic']}"


def task_table(states: Sequence[State]) -> Html:
    """Every task direction in the given states."""
    found = [(state, state.tasks) for state in states if state.tasks is not None]
    together = [f"{state.title}: {tasks_together(tasks)}" for state, tasks in found]
    caption = (
        f"{definitions(TASK)} {TASK_UNITS} Factors are on the gains, until the robot vibrates. Gains act on accelerations of the task: the "
        f"controller's model takes the inertia out. All directions together: {'; '.join(together)}."
    )
    return _several(TASK, [(state, row) for state, tasks in found for row in tasks.rows], True, caption)


def tasks_together(tasks: TaskStudy) -> str:
    """The factor on all gains of the tasks."""
    at = f" at {hertz(tasks.limit.frequency)}" if math.isfinite(tasks.limit.frequency) else ""
    return f"{digits(tasks.limit.gain)}{at}{'' if tasks.limit.stable else ', UNSTABLE'}"


def _several(columns: Sequence[Column], rows: Sequence[tuple[State, Any]], named: bool, caption: str) -> Html:
    """Rows of states, whose first cell has the state's name behind it where there are several."""
    headings, texts = tabulated(columns, [row for _, row in rows[:MOST_ROWS]])
    names = [f", {state.title}" if named else "" for state, _ in rows]
    return table(
        headings, [(first + name, *rest) for (first, *rest), name in zip(texts, names, strict=False)], caption + _cut(len(rows)), MARKS
    )


def _table(columns: Sequence[Column], rows: Sequence[Any], caption: str) -> Html:
    return table(*tabulated(columns, rows[:MOST_ROWS]), caption + _cut(len(rows)), MARKS)


def _cut(rows: int) -> str:
    return f" The first {MOST_ROWS} of {rows} rows; --json has them all." if rows > MOST_ROWS else ""


def gain_tables(gains: RobotGains, system: System) -> list[Html]:
    """Gains to use: the one safe set and one per contact state, in both unit systems, and the margins of each set."""
    columns: list[Named] = [("safe in all", gains.everywhere)]
    if len(gains.per_contact) > 1:  # of one contact state the set would be the same again
        columns += gains.per_contact.items()
    margins = _margins_table(columns, system, gains)
    if all(one is None or not one.moves for _, one in columns):
        return [margins]
    if gains.inertia is None:
        return [paragraph(TASK_UNITS), _gain_table(gains, columns, None, _gain_caption(gains)), margins]
    posture, contact = system.source.states[0]
    units = joint_units(system.source.body)
    words = (
        f"The same gains, each divided by the inertia that its joint moves in the first state, {posture}, {contact}: J_m + J_L, the "
        "motor's inertia and J_L = 1/W_ii, the load with all other joints free. kp [1/s²] and kd [1/s] compare joints, and robots. In "
        "another state the loads, and with them these numbers, differ; the gains above do not."
    )
    return [
        paragraph(f"kp [{units['kp']}], kd [{units['kd']}]:{units['prismatic']}"),
        _gain_table(gains, columns, None, _gain_caption(gains)),
        paragraph(words),
        _gain_table(gains, columns, gains.inertia, ""),
        margins,
    ]


def _gain_table(gains: RobotGains, columns: Sequence[Named], divisor: Floats | None, caption: str) -> Html:
    """Rows: joints or directions; two or three columns per set."""
    cascade = any(one is not None and one.ki is not None for _, one in columns)
    headers = [gains.space if gains.space == "joint" else "direction"]
    for name, _ in columns:
        headers += [f"{name}: kp", *(("kd or kv", "ki") if cascade else ("kd",))]
    rows = []
    for k, part in enumerate(gains.names):
        scale = 1.0 if divisor is None else 1 / float(divisor[k])
        rows.append((part, *(cell for _, one in columns for cell in _cells(one, k, scale, cascade))))
    known = [one for _, one in columns if one is not None]
    if any(np.isnan(one.kp).any() for one in known):
        cause = (
            "that joint cannot move there"
            if gains.space == "joint"
            else "the joints cannot move that direction there beside the tasks before it"
        )
        caption += f" A dash: {cause}, so its gains have no effect."
    return table(headers, rows, caption)


def _cells(gains: GainSet | None, k: int, scale: float, cascade: bool) -> tuple[str, ...]:
    if gains is None:
        return ("none",) * (3 if cascade else 2)
    columns = (gains.kp, gains.kd) if gains.ki is None else (gains.kp, gains.kd, gains.ki)
    return tuple(digits(scale * float(column[k])) for column in columns)


def _gain_caption(gains: RobotGains) -> str:
    known = {name: cost for name, cost in gains.cost.items() if math.isfinite(cost) and len(gains.per_contact) > 1}
    if gains.everywhere is None:
        return "No single set meets the requirements in every state: switch gains with the contacts."
    if not known:
        return "One set for every state."
    name = max(known, key=known.__getitem__)
    if known[name] < 1.02:
        return "The one safe set costs nothing: no contact state by itself allows higher gains."
    costs = ", ".join(f"{digits(cost, '', 3)} ({contact})" for contact, cost in known.items())
    return (
        f"The cost of one safe set: gains for one contact state alone may be stiffer, by a factor of {costs} in the sum of compliances. "
        f"Switching gains with the contacts pays most in {name}."
    )


def _margins_table(columns: Sequence[Named], system: System, gains: RobotGains) -> Html:
    """The margins of every set, beside what is required."""
    needs = {one.heading: requirement(system.requirements, name, 3) for name, one in REQUIREMENTS.items()}
    dashes = ("–",) * len(needs)
    headers = ["set", *(f"{title} ({need})" if need else title for title, need in needs.items()), "limited by", "cases"]
    rows, nearest = [], {**gains.nearest, columns[0][0]: gains.nearest.get("", "")}
    for name, one in columns:
        if one is None:
            rows.append((name, *dashes, f"none found that meet the requirements; nearest: {nearest.get(name, '')}", "–"))
            continue
        if not one.moves:
            rows.append((name, *dashes, "nothing moves there: gains have no effect", "–"))
            continue
        rows.append((name, *(_least(each, one.margins) for each in REQUIREMENTS.values()), limited_by(one, gains.names), str(one.cases)))
    caption = (
        "The least of each margin over all loops, all together and one at a time with the other loops closed, in every case examined. "
        "Limited by: the requirement that fails, and where, if the softest joint or direction is made 5 % stiffer."
    )
    return table(headers, rows, caption, sorts=False)


def _least(one: Requirement, found: Margins) -> str:
    """The margin that a requirement bounds, and which it is where that is not plain."""
    return digits(one.in_unit(one.value(found)), one.unit, 3) + one.named(found).removeprefix(one.title).replace(" of", ",", 1)


def inputs(system: System) -> Html:
    """The robot, its actuators, drives and control as used on this page."""
    pairs = [
        *machine(system),
        ("gravity", GRAVITY[system.source.gravity]),
        *((f"posture {name}", angles_text(posture)) for name, posture in list(system.source.postures.items())[:12]),
        *((f"contact {name}", contacts_text(contacts)) for name, contacts in list(system.source.contacts.items())[:12]),
        ("uncertainty", _uncertainty(system)),
    ]
    return facts(pairs)


def machine(system: System) -> list[tuple[str, str]]:
    """The robot, its actuators, drives and control."""
    body, actuators = system.source.body, system.source.actuators
    rigid = int(np.count_nonzero(np.isinf(actuators.stiffness)))
    drives, units = system.drives, joint_units(body)
    return [
        *([] if system.source.name == body.source else [("file", system.source.name)]),
        ("model", body.source),
        ("joints", f"{body.size} actuated, {len(body.locked)} locked; {body.base} base; {digits(body.total_mass, 'kg')}"),
        ("motor inertia, joint side", span(actuators.motor_inertia, units["load"])),
        (
            "gearbox stiffness",
            span(actuators.stiffness[np.isfinite(actuators.stiffness)], units["kp"]) + (f"; {rigid} rigid" if rigid else ""),
        ),
        ("gearbox damping", span(actuators.damping, units["kd"])),
        ("viscous friction, motor and link", f"{span(actuators.motor_viscous)} and {span(actuators.link_viscous, units['kd'])}"),
        ("current loops", span([d.bandwidth for d in drives], "rad/s") + f", ζ {span([d.damping_ratio for d in drives])}"),
        ("delay, target to demand torque", span([1e3 * drive.delay for drive in drives], "ms")),
        ("control", _control(system)),
        ("encoders", f"{system.control.feedback} side of the gearboxes"),
    ]


def span(values, unit: str = "") -> str:
    """One value where all are the same, else from the least to the largest."""
    values = np.asarray(values, dtype=float)
    if not len(values):
        return "none"
    low, high = float(values.min()), float(values.max())
    return digits(low, unit) if low == high else f"{digits(low)} to {digits(high, unit)}"


def _control(system: System) -> str:
    control = system.control
    kind = "tasks" if control.controller is None else type(control.controller).__name__
    time = "continuous" if control.sample_time is None else f"sampled at {digits(1 / control.sample_time, 'Hz')}"
    rotors = "" if not system.source.stack else f"; the tasks' model {'counts' if control.rotors else 'leaves out'} the rotors"
    return f"{kind} in {control.space} space; {filters(control)}; {time}{rotors}"


def angles_text(posture: Posture) -> str:
    """Its joint angles as text."""
    angles, unit = posture.angles, "rad, m" if posture.body.prismatic.any() else "rad"
    text = ", ".join(f"{name} {digits(angle, '', 3)}" for name, angle in list(angles.items())[:40])
    return f"{text} {unit}; others 0" if text else "all joints at 0"


def contacts_text(contacts: Sequence[Contact]) -> str:
    """The contacts of a state as text."""
    return "; ".join(f"{one.frame}, {one.kind}, {'rigid' if one.stiffness is None else 'on springs'}" for one in contacts) or "none"


def _uncertainty(system: System) -> str:
    ranges = []
    for name in system.uncertainty.names:
        low, high = getattr(system.uncertainty, name)
        finite = np.isfinite(high)
        ranges.append(quantity(name, float(np.min(low[finite])), float(np.max(high[finite]))) if finite.any() else f"{name}: rigid")
    return ", ".join(ranges) or "none given: every value is taken as exact"
