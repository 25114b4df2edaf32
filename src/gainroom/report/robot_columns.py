"""Columns of states, joints and tasks of a robot, and of an audit."""

import math
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any

from ..errors import listed
from ..system.margin_units import to_db
from ..system.requirements import REQUIREMENTS, reported
from .columns import Column, definitions, facts, units_of, yes
from .margin_columns import judged_columns, judged_legend, margin_facts
from .number_format import digits, hertz
from .robot_units import joint_units
from .words import DASH, safe_means

if TYPE_CHECKING:
    from ..studies.analysis import Analysis
    from ..studies.audit import Audit
    from ..studies.state import State
    from ..system.system import System


def _if_moving(value: Callable[["State"], Any]) -> Callable[["State"], Any]:
    """Column value, None for a state in which the gains act on no motion."""
    return lambda state: value(state) if state.moves else None


def _mainly(state: "State") -> str:
    """Names of the joints with the largest participation factors in the vibration at the limit."""
    if not state.moves:
        return "nothing moves"
    first, *others = state.limiting_joints or ("–",)
    return f"{first}, +{len(others)}" if others else first


def _frequency(state: "State") -> str:
    return hertz(state.limit.frequency) if state.moves and math.isfinite(state.limit.frequency) else "–"


def _joint_facts(state: "State") -> list[dict[str, Any]]:
    """JSON of the joints of one state, with the dynamic stiffness of their links and its frequency."""
    found = state.margins.links
    return [
        {**facts(JOINT, row), "dynamic_stiffness": stiffness, "dynamic_stiffness_at_rad_s": omega}
        for row, stiffness, omega in zip(state.joints, found.stiffness.tolist(), found.omega.tolist(), strict=True)
    ]


def damping_facts(found: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float]]:
    """JSON of the least damping ratio of each kind of vibration, with its frequency."""
    return {kind: {"damping_ratio": ratio, "frequency_rad_s": omega} for kind, (ratio, omega) in found.items()}


STABLE = _if_moving(lambda state: state.limit.stable)
POSTURE = Column("", "posture", lambda state: state.posture)
CONTACT = Column("", "contact", lambda state: state.contact)
MOVES = Column("", "moves", lambda state: state.moves)
LIMIT = Column(
    "limit",
    "gain_limit",
    _if_moving(lambda state: state.limit.gain),
    definition="the factor on all gains together at which the robot starts to vibrate",
    margin="gain_margin",
)
AT = Column("at", "limit_frequency_rad_s", _if_moving(lambda state: state.limit.frequency), shown=_frequency)
MAINLY = Column(
    "mainly",
    "limiting_joints",
    lambda state: list(state.limiting_joints),
    definition="the joints that move most in that vibration",
    shown=_mainly,
)
CERTIFIED = Column("", "certified", _if_moving(lambda state: state.margins.certified))

STATE = [
    Column("state", "", lambda state: state.title),
    POSTURE,
    CONTACT,
    MOVES,
    Column("stable", "stable", STABLE, shown=lambda state: yes(STABLE(state))),
    LIMIT,
    Column("", "lower_gain_limit", _if_moving(lambda state: state.lower_gain)),
    AT,
    Column("", "limit_certified", _if_moving(lambda state: state.limit.certificate is not None and state.limit.certificate.holds)),
    CERTIFIED,
    Column(
        "delay",
        "delay_margin_ms",
        _if_moving(lambda state: 1e3 * state.margins.delay_margin),
        "ms",
        "the delay margin, extra delay in all loops at which the robot starts to vibrate",
        3,
        margin="delay_margin",
    ),
    Column(
        "phase",
        "phase_margin_deg",
        _if_moving(lambda state: math.degrees(state.margins.common_phase_margin)),
        "°",
        "the phase margin of all loops at once",
        3,
        margin="phase_margin",
    ),
    Column(
        "one-loop phase",
        "single_loop_phase_margin_deg",
        _if_moving(lambda state: math.degrees(state.margins.one_loop_phase_margin)),
        "°",
        "the least phase margin of one loop, other loops closed",
        3,
    ),
    Column(
        "Ms",
        "",
        _if_moving(lambda state: state.margins.peak_sensitivity),
        definition="the largest peak sensitivity of one loop, other loops closed",
        significant=3,
        margin="peak_sensitivity",
    ),
    Column(
        "disk",
        "disk_margin",
        _if_moving(lambda state: state.margins.disk_margin),
        definition="the disk margin, independent errors of gain and phase in every motor's torque (~: not certified)",
        shown=lambda state: "~" * (state.margins.disk_certified is False) + digits(state.margins.disk_margin, significant=3),
        margin="disk_margin",
    ),
    Column("", "disk_margin_certified", _if_moving(lambda state: state.margins.disk_certified)),
    MAINLY,
    Column("", "kept", _if_moving(lambda state: margin_facts(state.margins))),
    Column("", "joints", lambda state: _joint_facts(state)),
    Column("", "damping", lambda state: damping_facts(state.damping)),
    Column("", "tasks", lambda state: [] if state.tasks is None else [facts(TASK, row) for row in state.tasks.rows]),
    Column("", "tasks_gain_limit", lambda state: state.tasks.limit.gain if state.moves and state.tasks else None),
    Column("", "tasks_limit_frequency_rad_s", lambda state: state.tasks.limit.frequency if state.moves and state.tasks else None),
]
"""Columns of a posture in a contact state."""


def state_columns() -> list[Column]:
    """Columns STATE, and further margins that a requirement bounds."""
    known = {column.margin for column in STATE}
    further = [one for one in reported(None, several=True) if one.name not in known]
    return STATE + [
        Column(
            one.heading,
            "",
            _if_moving(lambda state, one=one: one.in_unit(one.value(state.margins))),
            one.unit,
            f"the {one.title}, the worst of all loops",
            3,
            margin=one.name,
        )
        for one in further
    ]


ALONE = Column(
    "by itself",
    "single_joint_limit",
    lambda row: row.single_joint_limit,
    definition="the factor on the joint's gains if it were the only joint, with that load: its neighbours move freely, without motors",
)
CLOSED = Column(
    "one loop",
    "limit_others_closed",
    lambda row: row.limit_others_closed,
    definition="the factor on the gains of this loop alone, other loops closed",
)
KP = Column("kp", "kp", lambda row: row.kp)
KD = Column("kd", "kd", lambda row: row.kd)

JOINT = [
    Column("joint", "name", lambda row: row.name),
    Column("load", "link_inertia", lambda row: row.link_inertia, definition="1/W_ii, the inertia moved with the neighbours free"),
    ALONE,
    CLOSED,
    KP,
    Column("kp max", "kp_max", lambda row: row.kp_max, definition="the largest, other gains unchanged"),
    KD,
    Column("kd max", "kd_max", lambda row: row.kd_max, definition="likewise"),
    Column(
        "participation",
        "participation",
        lambda row: row.participation,
        definition="participation factor in the vibration at the limit, 1 for the joint that moves most",
        shown=lambda row: digits(row.participation, significant=2) if row.participation >= 1e-3 else "–",
    ),
]
"""Columns of a robot's joint in one state."""

TASK = [
    Column("direction", "", lambda row: f"{row.name} {row.direction}"),
    Column("", "name", lambda row: row.name),
    Column("", "direction", lambda row: row.direction),
    Column("", "moves", lambda row: row.moves),
    KP,
    Column("kd, kv", "kd", lambda row: row.kd),
    Column("ki", "ki", lambda row: row.ki),
    Column("alone", "gain_limit", lambda row: row.gain_limit, definition="the factor on its gains, other directions open"),
    CLOSED,
]
"""Columns of a direction of a task."""


def audited_states(safe: Callable[["State"], bool]) -> list[Column]:
    """Columns of an audit's contact state; `safe` judges one."""
    return [
        Column("contact", "contact", lambda state: state.contact),
        POSTURE,
        MOVES,
        Column("", "stable", STABLE),
        Column("safe", "", _if_moving(safe), shown=lambda state: yes(safe(state) if state.moves else None)),
        LIMIT,
        AT,
        Column(
            "mainly", "", lambda state: None, shown=lambda state: listed(state.limiting_joints) or "–" if state.moves else "nothing moves"
        ),
        Column(
            "delay limit",
            "delay_limit_ms",
            _if_moving(lambda state: 1e3 * state.delay_limit),
            "ms",
            "the total delay, of every joint's drive at once, at which the robot vibrates",
        ),
        CERTIFIED,
    ]


def worst_facts(study: "Analysis", name: str) -> dict[str, Any]:
    """JSON of a requirement's worst value over states and uncertainty, with the nominal value there."""
    one, state = REQUIREMENTS[name], study.worst[name]
    value, nominal = study.least(state, name), one.value(state.counted)
    case = study.case_of(name) or None
    return {one.key: one.in_unit(value), "nominal": one.in_unit(nominal), "posture": state.posture, "contact": state.contact, "case": case}


def actuator_facts(system: "System") -> list[dict[str, Any]]:
    """JSON of motor, gearbox, friction and delay of each joint; null for an assumed inertia, a rigid gearbox, and no friction."""
    columns = system.source.actuators.known
    rows = zip(system.source.joint_names, system.drives, *(column.tolist() for column in columns.values()), strict=True)
    return [{"name": name, "delay_ms": 1e3 * drive.delay, **dict(zip(columns, values, strict=True))} for name, drive, *values in rows]


AUDITED_JOINT = [
    Column("joint", "name", lambda row: row.name),
    Column("safe", "safe", lambda row: row.safe, shown=lambda row: yes(row.safe)),
    KP,
    KD,
    Column("ki", "ki", lambda row: row.ki, shown=lambda row: digits(row.ki or math.nan)),
    Column("motor inertia", "motor_inertia", lambda row: row.motor_inertia, definition="on the joint side"),
    *(Column("", key, lambda row, key=key: getattr(row, key)) for key in ("effort_limit", "stiffness", "damping", "link_viscous")),
    Column("alone", "gain_limit", lambda row: row.gain_limit, definition="the factor on the joint's gains with the other loops open"),
    CLOSED,
    Column("", "margins", lambda row: {REQUIREMENTS[name].key: REQUIREMENTS[name].in_unit(value) for name, value in row.margins.items()}),
    Column("", "unmet", lambda row: list(row.missed)),
]
"""Columns of an audit's joint, in its worst state."""


USE = "gains times this factor"
KEPT = "; × 1 on a joint that fails now: it has enough with the others lowered"


def audited_joints(result: "Audit") -> list[Column]:
    """Columns AUDITED_JOINT, with the factor on gains if that differs, and with required margins."""
    use = result.ready_to_use
    columns = list(AUDITED_JOINT)
    if use is not None and (len(use.joints) < len(result.joints) or use.factor is None):

        def factor(row: Any) -> str:
            return f"× {use.factors[result.joints.index(row)]:.4g}"

        unchanged = any(joint.safe is False and joint.name not in use.joints for joint in result.joints)
        columns.insert(4, Column("use", "", lambda row: None, shown=factor, definition=f"{USE}{KEPT}" if unchanged else USE))
    place = next(k for k, one in enumerate(columns) if one.key == "motor_inertia")
    return [*columns[:place], *judged_columns(result.required, _measured(result)), *columns[place:]]


def _measured(result: "Audit") -> set[str]:
    """Names of the requirements that an audit has a value of for some joint; of unstable gains all."""
    names = (one.name for one, _ in result.required.asked_for)
    return {name for name in names if not (result.stable and all(math.isnan(row.margins[name]) for row in result.joints))}


def _left_open(result: "Audit") -> str:
    """Legend of a dash in the column "safe" of an audit's joints; "" if no joint has one."""
    some = any(row.safe is None for row in result.joints)
    return DASH if some else ""


def legend(result: "Audit", shown: Collection[str]) -> str:
    """Legend of the columns with these titles, in a line or two."""
    units = joint_units(result.system.source.body)
    endless = " (∞: none up to 1000)" if any(math.isinf(joint.limit_others_closed) for joint in result.joints) else ""
    parts = {
        "use": f"use: {USE}",
        "alone": "alone: factor on a joint's gains until vibration, the others switched off",
        "one loop": f"one loop: the factor on one joint's gains until vibration, the other loops closed{endless}",
    }
    gains, margins = units_of(shown, {name: units[name] for name in ("kp", "kd", "ki")}), judged_legend(result.required, shown)
    clauses = [gains, *(text for title, text in parts.items() if title in shown), *filter(None, [margins])]
    return f"{'; '.join(clauses)}{_left_open(result)}.{'' if margins else f' {safe_means(asked(result))}.'}"


def joint_caption(result: "Audit", shown: Collection[str]) -> str:
    """Caption of the columns of AUDITED_JOINT with these titles, with their units."""
    units = joint_units(result.system.source.body)
    by_title = {**{name: units[name] for name in ("kp", "kd", "ki")}, "motor inertia": units["load"]}
    margins = judged_legend(result.required, shown)
    caption = f"{margins}. {safe_means(asked(result), True)}" if margins else safe_means(asked(result))
    caption = f"{units_of(shown, by_title)}.{units['prismatic']} {caption}{_left_open(result)}."
    return " ".join(filter(None, ["In the worst state.", definitions(audited_joints(result), shown), caption]))


def asked(result: "Audit") -> str:
    """Gain margin that an audit requires, as text."""
    return f"{digits(result.margin, '', 4)} ({digits(to_db(result.margin), 'dB', 3)})"
