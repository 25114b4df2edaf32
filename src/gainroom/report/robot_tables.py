"""The tables of a robot's page, and its inputs in words."""

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from ..design.robot_gains import GainSet, RobotGains
from ..linear.arrays import Floats
from ..robot.contact import Contact
from ..robot.spec import Posture, RobotSpec
from ..studies.robot_record import RobotStudy, StateStudy
from ..studies.robot_text import held_back
from .number_format import MARGIN_NAMES, decibels, digits, frequency, quantity, requirement
from .page import Html, facts, paragraph, table
from .robot_units import joint_units
from .shared import filters

GRAVITY = {
    True: "its stiffness is counted",
    False: "left out",
    None: "left out; its stiffness is counted in gains to use where rigid contacts hold the base",
}
MARKS = {"yes": "met", "no": "unmet", "UNSTABLE": "unmet", "not confirmed": "unmet"}
MOST_ROWS = 600
"""Of one table: beyond it a page becomes slow; --json has everything."""
Column = tuple[str, GainSet | None]
"""A set of gains under its name."""


def folded(summary: str, *parts: Html) -> Html:
    """Parts that open on a click."""
    return Html(f"<details><summary>{escape(summary)}</summary>{''.join(parts)}</details>")


def state_table(study: RobotStudy) -> Html:
    """Every state: how far all gains together may go, and what else is left."""
    headers = [
        "posture, contact",
        "stable",
        "limit [×]",
        "vibrates at",
        "most of all",
        "phase margin",
        "phase, one loop",
        "delay margin",
        "Ms",
        "disk margin",
    ]
    rows = [_state_row(state) for state in study.states]
    caption = (
        "Limit: the factor on all gains together. Phase and delay margin: the same change in all loops at once. Phase, one loop: the least "
        "in one loop, the others closed. Ms: the largest peak sensitivity of one loop with the others closed. Disk margin: every motor's "
        "torque off in gain and phase at once, each in its own way; not certified: only at the frequencies that were looked at. Margins of "
        "an unstable robot mean nothing."
    )
    nothing = ("–",) * (len(headers) - 2)
    rows += [(state.title.replace(" ", "\u00a0"), "nothing moves", *nothing) for state in study.still]
    return table(headers, rows[:MOST_ROWS], caption + _cut(len(rows)), MARKS)


def _state_row(state: StateStudy) -> tuple[str, ...]:
    limit, joints = state.limit, state.limiting_joints
    most = joints[0] + (f", +{len(joints) - 1}" if len(joints) > 1 else "") if joints else "–"
    return (
        state.title.replace(" ", "\u00a0"),
        "yes" if limit.stable else "UNSTABLE",
        digits(limit.gain),
        frequency(limit.frequency),
        most,
        digits(math.degrees(state.margins.common_phase_margin), "°", 3),
        digits(math.degrees(state.margins.one_loop_phase_margin), "°", 3),
        digits(1e3 * state.margins.delay_margin, "ms", 3),
        digits(state.margins.peak_sensitivity, "", 3),
        digits(state.margins.disk_margin, "", 3) + (", not certified" if state.margins.disk_certified is False else ""),
    )


def joint_table(states: Sequence[StateStudy], caption: str = "") -> Html:
    """Every joint in the given states."""
    several, units = len(states) > 1, joint_units(states[0].model.body)
    headers = ["joint", f"load [{units['load']}]", "alone [×]", "others closed [×]"]
    headers += [f"kp [{units['kp']}]", "largest kp, all else as it is", f"kd [{units['kd']}]", "largest kd, all else as it is", "share"]
    rows = []
    for state in states:
        for row in state.joints:
            numbers = (row.link_inertia, row.single_joint_limit, row.limit_others_closed, row.kp, row.kp_max, row.kd, row.kd_max)
            name = f"{row.name}, {state.title}" if several else row.name
            rows.append((name, *map(digits, numbers), digits(row.participation, "", 2) if row.participation >= 1e-3 else "–"))
    return table(headers, rows[:MOST_ROWS], caption + units["sliding"] + _cut(len(rows)), MARKS)


def _cut(rows: int) -> str:
    return f" The first {MOST_ROWS} of {rows} rows; --json has them all." if rows > MOST_ROWS else ""


def task_table(states: Sequence[StateStudy]) -> Html:
    """Every task direction in the given states."""
    found = [(state, state.tasks) for state in states if state.tasks is not None]
    cascade = any(bool(tasks.tasks.cascade.any()) for _, tasks in found)
    gains = ["kp [1/s² or 1/s]", "kd, kv [1/s]", "ki [1/s²]"] if cascade else ["kp [1/s²]", "kd [1/s]"]
    rows = []
    for state, tasks in found:
        for row in tasks.rows:
            own = (row.kp, row.kd, row.ki) if cascade else (row.kp, row.kd)
            together = digits(tasks.limit.gain) if tasks.limit.stable else f"{digits(tasks.limit.gain)} UNSTABLE"
            name = f"{row.name} {row.direction}, {state.title}"
            rows.append(
                (
                    name,
                    *map(digits, own),
                    digits(row.gain_limit),
                    digits(row.limit_others_closed),
                    together,
                    frequency(tasks.limit.frequency),
                )
            )
    marks = {row[-2]: "unmet" for row in rows if row[-2].endswith("UNSTABLE")}
    caption = (
        "Factors on the gains until the robot vibrates: this direction with no other closed, with the others as they are, and all "
        "directions together. Gains act on accelerations of the task: inertia is taken out by the controller's model."
    )
    headers = ["direction", *gains, "alone [×]", "others closed [×]", "all together [×]", "vibrates at"]
    return table(headers, rows[:MOST_ROWS], caption + _cut(len(rows)), marks)


def gain_tables(gains: RobotGains, spec: RobotSpec) -> list[Html]:
    """Gains to use: the one safe set and one per contact state, in both unit systems, and what each set keeps."""
    columns: list[Column] = [("safe in all", gains.everywhere)]
    if len(gains.per_contact) > 1:  # of one contact state the set would be the same again
        columns += gains.per_contact.items()
    kept = _kept_table(columns, spec, gains)
    if all(one is None or not one.moves for _, one in columns):
        return [kept]
    if gains.inertia is None:
        return [paragraph(_units(columns)), _gain_table(gains, columns, None, _gain_caption(gains)), kept]
    posture, contact = spec.robot.states[0]
    units = joint_units(spec.robot.body)
    words = (
        f"The same, in every column divided by what each joint has to move in {posture}, {contact}, the first state: J_m + J_L, the "
        "motor's inertia and J_L = 1/W_ii, the load with all other joints free. kp [1/s²], kd [1/s]: joints of one robot, and robots, can "
        "be compared in these. In another state the loads, and with them these numbers, differ; the gains above do not."
    )
    return [
        paragraph(f"kp [{units['kp']}], kd [{units['kd']}]:{units['sliding']}"),
        _gain_table(gains, columns, None, _gain_caption(gains)),
        paragraph(words),
        _gain_table(gains, columns, gains.inertia, ""),
        kept,
    ]


def _units(columns: Sequence[Column]) -> str:
    if any(one is not None and one.ki is not None for _, one in columns):
        return "PD: kp [1/s²], kd [1/s]; P/PI: kp [1/s], kv [1/s], ki [1/s²]:"
    return "kp [1/s²], kd [1/s]:"


def _gain_table(gains: RobotGains, columns: Sequence[Column], divisor: Floats | None, caption: str) -> Html:
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
            "nothing can move that joint there"
            if gains.space == "joint"
            else "the joints cannot move that direction there beside the tasks above"
        )
        caption += f" A dash: {cause}, so its gains do nothing."
    return table(headers, rows, caption)


def _cells(gains: GainSet | None, k: int, scale: float, cascade: bool) -> tuple[str, ...]:
    if gains is None:
        return ("none",) * (3 if cascade else 2)
    columns = (gains.kp, gains.kd) if gains.ki is None else (gains.kp, gains.kd, gains.ki)
    return tuple(digits(scale * float(column[k])) for column in columns)


def _gain_caption(gains: RobotGains) -> str:
    known = {name: cost for name, cost in gains.cost.items() if math.isfinite(cost) and len(gains.per_contact) > 1}
    if gains.everywhere is None:
        return "No single set keeps the requirements in every state: change gains with the contacts."
    if not known:
        return "One set for every state."
    name = max(known, key=known.__getitem__)
    if known[name] < 1.02:
        return "The one safe set costs nothing: every contact state of its own would allow the same gains."
    costs = ", ".join(f"{digits(cost, '', 3)} ({contact})" for contact, cost in known.items())
    return (
        f"What the one safe set costs: gains chosen for each contact state by itself may have a kp larger by a factor of {costs}. "
        f"Switching gains with the contacts pays most in {name}."
    )


def _kept_table(columns: Sequence[Column], spec: RobotSpec, gains: RobotGains) -> Html:
    """What every set keeps, beside what is required."""
    needs = {title: requirement(spec.requirements, name, 3) for name, title in MARGIN_NAMES.items()}
    headers = ["set", *(f"{title} ({need})" if need else title for title, need in needs.items()), "held back by", "cases"]
    rows, nearest = [], {**gains.nearest, columns[0][0]: gains.nearest.get("", "")}
    for name, one in columns:
        if one is None:
            rows.append((name, "–", "–", "–", f"none found that keep the requirements; the nearest: {nearest.get(name, '')}", "–"))
            continue
        if not one.moves:
            rows.append((name, "–", "–", "–", "nothing moves there: gains do nothing", "–"))
            continue
        margins = one.margins
        margins = (
            digits(decibels(margins.least_gain_margin), "dB", 3),
            digits(math.degrees(margins.least_phase_margin), "°", 3)
            + (", one loop" if margins.one_loop_phase_margin < margins.common_phase_margin else ""),
            digits(margins.peak_sensitivity, "", 3),
        )
        rows.append((name, *margins, held_back(one, gains.names), str(one.cases)))
    caption = (
        "The least of each margin over all loops, all together and one by one with the others closed, in every case that was looked at. "
        "Held back by: what would be missed, and where, if the softest joint or direction were 5 % stiffer."
    )
    return table(headers, rows, caption, sorts=False)


def inputs(spec: RobotSpec) -> Html:
    """The robot, its actuators, drives and control as the page has used them."""
    pairs = [
        *machine(spec),
        ("gravity", GRAVITY[spec.robot.gravity]),
        *((f"posture {name}", angles_in_words(posture)) for name, posture in list(spec.robot.postures.items())[:12]),
        *((f"contact {name}", contacts_in_words(contacts)) for name, contacts in list(spec.robot.contacts.items())[:12]),
        ("uncertainty", _uncertainty(spec)),
    ]
    return facts(pairs)


def machine(spec: RobotSpec) -> list[tuple[str, str]]:
    """The robot, its actuators, drives and control."""
    body, actuators = spec.robot.body, spec.robot.actuators
    rigid = int(np.count_nonzero(np.isinf(actuators.stiffness)))
    drives, units = spec.drives, joint_units(body)
    return [
        *([] if spec.robot.name == body.source else [("file", spec.robot.name)]),
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
        ("control", _control(spec)),
        ("encoders", f"{spec.control.feedback} side of the gearboxes"),
    ]


def span(values, unit: str = "") -> str:
    """One value where all are the same, else from the least to the largest."""
    values = np.asarray(values, dtype=float)
    if not len(values):
        return "none"
    low, high = float(values.min()), float(values.max())
    return digits(low, unit) if low == high else f"{digits(low)} to {digits(high, unit)}"


def _control(spec: RobotSpec) -> str:
    control = spec.control
    kind = "tasks" if control.joints is None else type(control.joints).__name__
    time = "continuous" if control.sample_time is None else f"sampled at {digits(1 / control.sample_time, 'Hz')}"
    rotors = "" if not spec.robot.stack else f"; the tasks' model {'counts' if control.rotors else 'leaves out'} the rotors"
    return f"{kind} in {control.space} space; {filters(control)}; {time}{rotors}"


def angles_in_words(posture: Posture) -> str:
    """Where its joints stand."""
    angles, unit = posture.angles, "rad, m" if posture.body.prismatic.any() else "rad"
    told = ", ".join(f"{name} {digits(angle, '', 3)}" for name, angle in list(angles.items())[:40])
    return f"{told} {unit}; others 0" if told else "all joints at 0"


def contacts_in_words(contacts: Sequence[Contact]) -> str:
    """A contact state's."""
    return "; ".join(f"{one.frame}, {one.kind}, {'rigid' if one.stiffness is None else 'on springs'}" for one in contacts) or "none"


def _uncertainty(spec: RobotSpec) -> str:
    told = []
    for name in spec.uncertainty.names:
        low, high = getattr(spec.uncertainty, name)
        finite = np.isfinite(high)
        told.append(quantity(name, float(np.min(low[finite])), float(np.max(high[finite]))) if finite.any() else f"{name}: rigid")
    return ", ".join(told) or "none stated: every value is taken as exact"
