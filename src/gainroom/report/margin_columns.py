"""Margins of a loop as columns, compared with requirements."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ..analysis.margin_record import Margins
from ..errors import apart
from ..io.as_typed import as_typed
from ..system.margin_units import to_db
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS, Requirements, reported
from .columns import Column, yes
from .number_format import MISSED, digits, frequency


def _lower(margins: Margins) -> str:
    return "any" if margins.stable and margins.lower_gain_margin == 0 else digits(-to_db(margins.lower_gain_margin), "dB")


MARGIN = [
    Column("gain margin", "gain_margin_db", lambda m: to_db(m.gain_margin), "dB", at=lambda m: m.phase_crossover, margin="gain_margin"),
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
    Column("delay margin", "delay_margin_ms", lambda m: 1e3 * m.delay_margin, "ms", at=lambda m: m.delay_crossover, margin="delay_margin"),
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
"""Columns of one loop's margins."""


def _own(one: Requirement, margins: Margins) -> float:
    """Margin with the requirement's name (of the gain margin the upper one); the bounded value if there is none."""
    return getattr(margins, one.name, one.value(margins))


def margin_columns() -> list[Column]:
    """Columns MARGIN, and further margins that a requirement bounds."""
    known, keys = {column.margin for column in MARGIN}, {column.key for column in MARGIN}
    further = [one for one in REQUIREMENTS.values() if one.name not in known or one.key not in keys]
    return MARGIN + [
        Column(
            "" if one.name in known else one.title,
            one.key,
            lambda m, one=one: one.in_unit(_own(one, m)),
            one.unit,
            at=one.frequency,
            margin=one.name,
        )
        for one in further
    ]


def reported_columns(required: Requirements | None, *found: Margins) -> list[Column]:
    """Margin columns of one joint without those that are neither required nor known in any of `found`."""
    known = {"", *(one.name for one in reported(required, False, *found))}
    return [column for column in margin_columns() if column.requirement in known]


def known_columns(required: Requirements) -> list[Column]:
    """Margin columns of one joint, known or not, without those of requirements that are reported only where they are asked for."""
    left_out = {one.name for one in REQUIREMENTS.values() if one.shown == "asked"} - set(required.asked)
    return [column for column in margin_columns() if column.requirement not in left_out]


def bounded_columns() -> list[Column]:
    """Margin columns that requirements bound."""
    return [column for column in margin_columns() if column.title and column.requirement]


def margin_facts(margins: Margins, asked: Requirements | None = None) -> dict[str, Any]:
    """JSON of the margins that requirements bound."""
    several = len(margins.one_loop.gain_margin) > 1
    return {key: value for one in reported(asked, several, margins) for key, value in one.facts(margins).items()}


def required_facts(required: Requirements) -> dict[str, Any]:
    """JSON of the requirements, in the units of a file; null: not required."""
    needed = required.needed
    return {one.key: as_typed(one.in_unit(needed[name])) if name in needed else None for name, one in REQUIREMENTS.items()}


def margins_text(margins: Margins, asked: Requirements | None = None) -> str:
    """Margins that requirements bound, as text: "gain margin 6.1 dB, phase margin of one loop 31°, peak sensitivity Ms 1.9"."""
    several = len(margins.one_loop.gain_margin) > 1
    named = ((one, one.titled(margins, several)) for one in reported(asked, several, margins))
    return ", ".join(f"{name} {digits(one.in_unit(one.value(margins)), one.unit, 3)}" for one, name in named)


def margin_value(asked: Requirements, name: str, value: float, met: bool | None, significant: int = 4) -> str:
    """Margin with its unit, with enough digits to distinguish it from a missed requirement; `name`: of the requirement."""
    one, needed = REQUIREMENTS[name], asked.needed.get(name)
    if met is False and needed is not None:
        significant = apart(one.in_unit(value), one.in_unit(needed), significant)
    return digits(one.in_unit(value), one.unit, significant)


def judged_columns(asked: Requirements, measured: Collection[str]) -> list[Column]:
    """Columns of an audit's joints, one for each requirement asked for and `measured`, named in the heading; missed values are marked."""

    def text(row: Any, name: str) -> str:
        missed = name in row.missed
        return f"{MISSED} " * missed + margin_value(asked, name, row.margins[name], not missed, 3)

    return [
        Column(judged_title(asked, one), "", lambda row: None, shown=lambda row, name=one.name: text(row, name))
        for one, _ in asked.asked_for
        if one.name in measured
    ]


def judged_title(asked: Requirements, one: Requirement) -> str:
    """Heading of a requirement's column: "phase ≥ 30°"."""
    return f"{one.heading.removesuffix(' margin')} {requirement(asked, one.name, 3)}"


def judged_legend(asked: Requirements, shown: Collection[str]) -> str:
    """Legend of those columns in a table with the titles `shown`; "" if there are none."""
    names = [one.heading.removesuffix(" margin") for one, _ in asked.asked_for if judged_title(asked, one) in shown]
    worse = "of the joint's own loop, others closed, or, where it takes part, of all loops, the worse"
    return f"{', '.join(names)}: {worse} ({MISSED} missed)" if names else ""


def requirement(asked: Requirements, name: str, significant: int = 4) -> str:
    """Required margin as text: "≥ 6 dB"; "" if nothing is required."""
    one, needed = REQUIREMENTS[name], asked.needed.get(name)
    return "" if needed is None else f"{one.sign} {digits(one.in_unit(needed), one.unit, significant)}"


def short_text(asked: Requirements, values: Mapping[str, float]) -> str:
    """Missed margins with the required values: "gain margin 0.916 dB (≥ 6 dB), Ms 14.4 (≤ 2)"."""
    return ", ".join(
        f"{REQUIREMENTS[name].heading} {margin_value(asked, name, value, False, 3)} ({requirement(asked, name, 3)})"
        for name, value in values.items()
    )


def lacking(asked: Requirements, margins: Margins) -> str:
    """Predicate for "these gains": "have Ms 2.25 (≤ 2)", "are unstable", "have all that is required"."""
    if not margins.stable:
        return "are unstable"
    missed = {one.name: one.value(margins) for one, needed in asked.asked_for if not one.met(needed, one.value(margins))}
    return f"have {short_text(asked, missed) or 'all that is required'}"


def margin_rows(margins: Margins, worst: Margins, required: Requirements) -> list[tuple[str, ...]]:
    """Table rows of every margin: name, value, frequency, requirement, and whether it is met at the `worst` of the uncertainty."""
    rows = []
    for column in reported_columns(required, margins, worst):
        if column.title:
            name = column.requirement
            met = required.met(name, REQUIREMENTS[name].value(worst)) if name else None
            text = margin_value(required, name, _own(REQUIREMENTS[name], margins), met) if name else column.text(margins)
            at = "" if column.at is None else frequency(column.at(margins))
            verdict = "" if met is None else yes(worst.stable and met)
            rows.append((column.title, text, at, requirement(required, name) if name else "", verdict))
    return rows


def compared_rows(found: Sequence[Margins]) -> list[tuple[str, ...]]:
    """Table rows of every margin of several loops, each with its frequency below it."""
    rows = []
    for column in reported_columns(None, *found):
        if column.title:
            rows.append((column.title, *(column.text(one) for one in found)))
            if column.at is not None:
                rows.append(("… at", *(frequency(column.at(one)) for one in found)))
    return rows
