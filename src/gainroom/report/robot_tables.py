"""The tables of a robot's page, and its inputs as text."""

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from ..design.gain_sets import RobotGains
from ..errors import at_frequency
from ..robot.contact import Contact
from ..robot.robot import Posture
from ..studies.robot import RobotStudy
from ..studies.state import State, TaskStudy
from ..system.system import System
from .columns import Column, definitions, tabulated, units_of
from .number_format import digits, hertz, span
from .page import Html, facts, paragraph, table
from .page_parts import filters, uncertainty_text
from .recommended_gains import Row, cost_text, gain_columns, inertia_text, rows, set_columns
from .robot_columns import JOINT, TASK, state_columns
from .robot_units import joint_units

GRAVITY = {
    True: "its stiffness is counted",
    False: "left out",
    None: "left out; its stiffness is counted in recommended gains where rigid contacts hold the base",
}
MOST_ROWS = 600
"""Of one table: beyond it a page becomes slow; --json has everything."""
SET_CAPTION = (
    "The least of each margin over all loops, all together and one at a time with the other loops closed, in every case examined. "
    "Limited by: the requirement that fails, and where, if the softest joint or direction is made 5 % stiffer."
)
TASK_UNITS = "PD: kp [1/s²], kd [1/s]; P/PI: kp [1/s], kv [1/s], ki [1/s²]."


def state_table(study: RobotStudy) -> Html:
    """Every state: the factor on all gains together, and the margins."""
    columns = state_columns()
    rows = study.states + study.immobile
    headings, texts = tabulated(columns, rows[:MOST_ROWS])
    caption = f"{definitions(columns, headings)} An unstable state has none.{_cut(len(rows))}"
    return table(headings, texts, caption)


def joint_table(states: Sequence[State], caption: str = "") -> Html:
    """Every joint in the given states."""
    rows = [(state, row) for state in states for row in state.joints]
    return _several(JOINT, rows, len(states) > 1, lambda shown: f"{caption} {joint_legend(states[0].model.body, shown)}")


def joint_legend(body: Any, shown: Collection[str]) -> str:
    """What the columns of JOINT with these titles are, with their units."""
    units = joint_units(body)
    return f"{definitions(JOINT, shown)} {units_of(shown, {name: units[name] for name in ('load', 'kp', 'kd')})}.{units['prismatic']}"


def task_table(states: Sequence[State]) -> Html:
    """Every task direction in the given states."""
    found = [(state, state.tasks) for state in states if state.tasks is not None]
    together = [f"{state.title}: {tasks_together(tasks)}" for state, tasks in found]

    def caption(shown: Collection[str]) -> str:
        return (
            f"{definitions(TASK, shown)} {TASK_UNITS} Factors are on the gains, until the robot vibrates. Gains act on accelerations of "
            f"the task: the controller's model takes the inertia out. All directions together: {'; '.join(together)}."
        )

    return _several(TASK, [(state, row) for state, tasks in found for row in tasks.rows], True, caption)


def tasks_together(tasks: TaskStudy) -> str:
    """The factor on all gains of the tasks."""
    return f"{digits(tasks.limit.gain)}{at_frequency(tasks.limit.frequency, text=hertz)}{'' if tasks.limit.stable else ', UNSTABLE'}"


def _several(columns: Sequence[Column], rows: Sequence[tuple[State, Any]], named: bool, caption: Callable[[Collection[str]], str]) -> Html:
    """Rows of states, whose first cell has the state's name behind it where there are several. `caption`: of the titles shown."""
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
    """Recommended gains: the one safe set and one per contact state, of joints over their inertia, too, and the margins of each set."""
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


def _gain_caption(gains: RobotGains, shown: Sequence[Row]) -> str:
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
    """The robot, its actuators, drives and control as used on this page."""
    pairs = [
        *machine(system),
        ("gravity", GRAVITY[system.source.gravity]),
        *((f"posture {name}", angles_text(posture)) for name, posture in list(system.source.postures.items())[:12]),
        *((f"contact {name}", contacts_text(contacts)) for name, contacts in list(system.source.contacts.items())[:12]),
        ("uncertainty", uncertainty_text(system)),
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
        *(("payload, in that mass", f"{digits(mass, 'kg')} at {frame}") for frame, mass in body.payload.items() if mass),
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
