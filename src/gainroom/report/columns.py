"""Every number on screen, once: terminal, JSON, page and documentation are made from the columns here.

A further column is one more entry in a list below; nothing else has to know it.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..analysis.margin_record import Margins
from ..errors import apart, listed
from ..system.requirements import REQUIREMENTS, Requirements, to_db
from .number_format import as_typed, digits, frequency, hertz

if TYPE_CHECKING:
    from ..studies.state import State


@dataclass(frozen=True)
class Column:
    """One quantity of a row: a state, a joint, a direction of a task, a set of margins.

    title        heading; "" for what is in JSON alone
    key          name in JSON, which carries the unit where that is not SI; "" for what is shown alone
    value        row → what JSON holds: a number in the unit of `key`, a text, a list, an interval; None where there is none
    unit         shown behind the number
    definition   what it is, in a sentence without its subject
    significant  digits shown
    shown        row → the text shown, where that is not `value` with its unit
    at           row → the frequency [rad/s] that belongs to it
    margin       the field of Margins that it is, where a requirement may bound it
    interval     row → the text of its 95 % interval; None where it has none
    """

    title: str
    key: str
    value: Callable[[Any], Any]
    unit: str = ""
    definition: str = ""
    significant: int = 4
    shown: Callable[[Any], str] | None = None
    at: Callable[[Any], float] | None = None
    margin: str = ""
    interval: Callable[[Any], str] | None = None

    @property
    def requirement(self) -> str:
        """The name of the requirement that bounds it; "" where none does."""
        return self.margin if self.margin in REQUIREMENTS else ""

    def text(self, row: Any) -> str:
        """The text shown."""
        if self.shown is not None:
            return self.shown(row)
        value = self.value(row)
        return value if isinstance(value, str) else digits(value, self.unit, self.significant)


def facts(columns: Iterable[Column], row: Any) -> dict[str, Any]:
    """A row in JSON."""
    return {column.key: column.value(row) for column in columns if column.key}


def tabulated(columns: Sequence[Column], rows: Iterable[Any]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Headings and rows of a table: the first column and those with a title, without those that are empty in every row."""
    placed, rows = [column for k, column in enumerate(columns) if column.title or k == 0], [*rows]
    texts = [[column.text(row) for row in rows] for column in placed]
    filled = [k for k, cells in enumerate(texts) if k == 0 or any(cell not in ("", "–") for cell in cells)]
    return [placed[k].title for k in filled], [*zip(*(texts[k] for k in filled), strict=True)]


def definitions(columns: Sequence[Column]) -> str:
    """The definitions of columns, below a table."""
    return "; ".join(f"{column.title}: {column.definition}" for column in columns if column.title and column.definition) + "."


def yes(value: bool | None) -> str:
    """A verdict in a table; a dash where there is none."""
    return "–" if value is None else "yes" if value else "no"


def _if_moving(value: Callable[["State"], Any]) -> Callable[["State"], Any]:
    """None for a state in which the gains act on no motion."""
    return lambda state: value(state) if state.moves else None


def _mainly(state: "State") -> str:
    """The joints with the largest participation factors in the vibration at the limit."""
    if not state.moves:
        return "nothing moves"
    first, *others = state.limiting_joints or ("–",)
    return f"{first}, +{len(others)}" if others else first


def margin_facts(margins: Margins) -> dict[str, Any]:
    """The margins that requirements bound, in JSON."""
    return {key: value for one in REQUIREMENTS.values() for key, value in one.facts(margins).items()}


def required_facts(required: Requirements) -> dict[str, Any]:
    """The requirements, in JSON, in the units of a file; None where there is none."""
    needed = required.needed
    return {one.key: as_typed(one.in_unit(needed[name])) if name in needed else None for name, one in REQUIREMENTS.items()}


def margins_text(margins: Margins) -> str:
    """The margins that requirements bound, in a sentence: "gain margin 6.1 dB, phase margin of one loop 31°, peak sensitivity Ms 1.9"."""
    named = ((one, one.named(margins) if one.named(margins) != one.title else one.label) for one in REQUIREMENTS.values())
    return ", ".join(f"{name} {digits(one.in_unit(one.value(margins)), one.unit, 3)}" for one, name in named)


def _disk(state: "State") -> str:
    return ("~" if state.margins.disk_certified is False else "") + digits(state.margins.disk_margin, significant=3)


def _frequency(state: "State") -> str:
    return hertz(state.limit.frequency) if state.moves and math.isfinite(state.limit.frequency) else "–"


def margin_value(asked: Requirements, name: str, value: float, met: bool | None, significant: int = 4) -> str:
    """A margin (`name`: of a requirement) with its unit; with digits enough to tell it from a requirement that is not met."""
    one, needed = REQUIREMENTS[name], asked.needed.get(name)
    if met is False and needed is not None:
        significant = apart(one.in_unit(value), one.in_unit(needed), significant)
    return digits(one.in_unit(value), one.unit, significant)


def requirement(asked: Requirements, name: str, significant: int = 4) -> str:
    """A required margin by the requirement's name: "≥ 6 dB"; empty where nothing is required."""
    one, needed = REQUIREMENTS[name], asked.needed.get(name)
    return "" if needed is None else f"{one.sign} {digits(one.in_unit(needed), one.unit, significant)}"


def judged_rows(margins: Margins, worst: Margins, required: Requirements) -> list[tuple[str, ...]]:
    """Every margin of one loop: name, value, frequency, what is required, and whether it is met at the `worst` of the uncertainty."""
    rows = []
    for column in margin_columns():
        if column.title:
            name = column.requirement
            met = required.met(name, REQUIREMENTS[name].value(worst)) if name else None
            text = margin_value(required, name, getattr(margins, name), met) if name else column.text(margins)
            at = "" if column.at is None else frequency(column.at(margins))
            verdict = "" if met is None else yes(worst.stable and met)
            rows.append((column.title, text, at, requirement(required, name) if name else "", verdict))
    return rows


def compared_rows(found: Sequence[Margins]) -> list[tuple[str, ...]]:
    """Every margin of several loops side by side, each with its frequency below it."""
    rows = []
    for column in margin_columns():
        if column.title:
            rows.append((column.title, *(column.text(one) for one in found)))
            if column.at is not None:
                rows.append(("… at", *(frequency(column.at(one)) for one in found)))
    return rows


def _lower(margins: Margins) -> str:
    return "any" if margins.stable and margins.lower_gain_margin == 0 else digits(-to_db(margins.lower_gain_margin), "dB")


MARGIN = [
    Column(
        "gain margin",
        "gain_margin_db",
        lambda m: to_db(m.gain_margin),
        "dB",
        at=lambda m: m.phase_crossover,
        margin="gain_margin",
    ),
    Column("", "phase_crossover_rad_s", lambda m: m.phase_crossover),
    Column("gain may fall by", "lower_gain_margin_db", lambda m: to_db(m.lower_gain_margin), shown=_lower),
    Column(
        "phase margin",
        "phase_margin_deg",
        lambda m: math.degrees(m.phase_margin),
        "°",
        at=lambda m: m.gain_crossover,
        margin="phase_margin",
    ),
    Column("", "gain_crossover_rad_s", lambda m: m.gain_crossover),
    Column(
        "delay margin",
        "delay_margin_ms",
        lambda m: 1e3 * m.delay_margin,
        "ms",
        at=lambda m: m.delay_crossover,
        margin="delay_margin",
    ),
    Column(
        "peak sensitivity",
        "peak_sensitivity",
        lambda m: m.peak_sensitivity,
        at=lambda m: m.peak_sensitivity_frequency,
        margin="peak_sensitivity",
    ),
    Column(
        "peak complementary sensitivity",
        "",
        lambda m: m.peak_complementary,
        at=lambda m: m.peak_complementary_frequency,
        margin="peak_complementary",
    ),
    Column("disk margin", "disk_margin", lambda m: m.disk_margin, at=lambda m: m.disk_margin_frequency, margin="disk_margin"),
]
"""The margins of one loop."""


def margin_columns() -> list[Column]:
    """MARGIN, and further margins that a requirement bounds."""
    known, keys = {column.margin for column in MARGIN}, {column.key for column in MARGIN}
    further = [one for one in REQUIREMENTS.values() if one.name not in known or one.key not in keys]
    return MARGIN + [
        Column(
            "" if one.name in known else one.title,
            one.key,
            lambda m, one=one: one.in_unit(getattr(m, one.name, one.value(m))),
            one.unit,
            at=one.frequency,
            margin=one.name,
        )
        for one in further
    ]


def bounded_columns() -> list[Column]:
    """Those that requirements bound."""
    return [column for column in margin_columns() if column.title and column.requirement]


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
    Column("", "lower_gain_limit", _if_moving(lambda state: state.limit.lower_gain)),
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
        "one loop",
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
        shown=_disk,
        margin="disk_margin",
    ),
    Column("", "disk_margin_certified", _if_moving(lambda state: state.margins.disk_certified)),
    MAINLY,
    Column("", "kept", _if_moving(lambda state: margin_facts(state.margins))),
    Column("", "joints", lambda state: [facts(JOINT, row) for row in state.joints]),
    Column("", "tasks", lambda state: [] if state.tasks is None else [facts(TASK, row) for row in state.tasks.rows]),
    Column("", "tasks_gain_limit", lambda state: state.tasks.limit.gain if state.moves and state.tasks else None),
    Column("", "tasks_limit_frequency_rad_s", lambda state: state.tasks.limit.frequency if state.moves and state.tasks else None),
]
"""A posture in a contact state."""


def state_columns() -> list[Column]:
    """STATE, and further margins that a requirement bounds."""
    known = {column.margin for column in STATE}
    further = [one for one in REQUIREMENTS.values() if one.name not in known]
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
    "alone",
    "single_joint_limit",
    lambda row: row.single_joint_limit,
    definition="the factor on the joint's gains with the other loops open and its neighbours free",
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
"""A joint of a robot in one state."""

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
"""A direction of a task."""


def audited_states(safe: Callable[["State"], bool]) -> list[Column]:
    """A contact state of an audit; `safe` judges one."""
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


AUDITED_JOINT = [
    Column("joint", "name", lambda row: row.name),
    Column("safe", "safe", lambda row: row.safe, shown=lambda row: yes(row.safe)),
    KP,
    KD,
    Column("ki", "ki", lambda row: row.ki, shown=lambda row: digits(row.ki or math.nan)),
    Column("motor inertia", "motor_inertia", lambda row: row.motor_inertia, definition="on the joint side"),
    Column("alone", "gain_limit", lambda row: row.gain_limit, definition=ALONE.definition),
    CLOSED,
]
"""A joint of an audit, in its worst state."""
