"""Recommended gains of a robot as columns: of each joint or task direction in every set, and of each set its margins and what limits it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..design.robot_gains import EVERYWHERE, GainSet, RobotGains
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS, Requirement, Requirements
from .columns import Column, facts
from .margin_columns import margin_facts, requirement
from .number_format import digits
from .recommended_gains_text import limited_by


@dataclass(frozen=True)
class Row:
    """A set of gains: of one contact state, or ("") the one that is safe in all; `found` is None where there is none."""

    contact: str
    found: GainSet | None
    gains: RobotGains

    @property
    def title(self) -> str:
        """Its name in a table."""
        return self.contact or "safe in all"

    @property
    def acts(self) -> bool:
        """Whether there are gains that move something."""
        return self.found is not None and self.found.moves

    @property
    def limit(self) -> str:
        """What limits the gains, or why there are none."""
        if self.found is None:
            return f"none found that meet the requirements; nearest: {self.gains.nearest.get(self.contact, '')}"
        return limited_by(self.found, self.gains.names) if self.found.moves else "nothing moves there: gains have no effect"

    def margin_text(self, one: Requirement) -> str:
        """The least of a margin over all loops together and one at a time, and which it is where that is not plain."""
        if self.found is None or not self.acts:
            return "–"
        margins = self.found.margins
        return digits(one.in_unit(one.value(margins)), one.unit, 3) + one.named(margins).removeprefix(one.title).replace(" of", ",", 1)


def rows(gains: RobotGains) -> list[Row]:
    """All sets, the one that is safe in all first."""
    return [Row(EVERYWHERE, gains.everywhere, gains), *(Row(contact, found, gains) for contact, found in gains.per_contact.items())]


SET = [
    Column("set", "contact", lambda row: row.contact or "everywhere", shown=lambda row: row.title),
    Column("", "moves", lambda row: row.found.moves),
    Column("", "kp", lambda row: row.found.kp),
    Column("", "kd", lambda row: row.found.kd),
    Column("", "ki", lambda row: row.found.ki),
    Column("", "binding", lambda row: row.found.binding or None),
    Column("", "binding_joint", lambda row: row.gains.names[row.found.softest] if row.found.binding else None),
    Column("", "binding_margin", lambda row: row.found.margin[row.found.softest] if row.found.binding else None),
    Column(
        "",
        "held_back_by",
        lambda row: [
            {"margin": margin or None, "state": state or None} for margin, state in zip(row.found.margin, row.found.case, strict=True)
        ],
    ),
    Column("", "without_weight", lambda row: row.found.without_weight),
    Column("", "nearest_with_weight", lambda row: row.found.nearest or None),
    Column("", "topples", lambda row: list(row.found.topples)),
]
"""A set of gains; what is in JSON alone is asked of sets that were found."""


def set_columns(required: Requirements) -> list[Column]:
    """SET, the margins that requirements bound, each with what is `required`, what limits the gains, and the number of cases."""
    margins = []
    for name, one in REQUIREMENTS.items():
        needed = requirement(required, name, 3)
        margins.append(Column(f"{one.heading} ({needed})" if needed else one.heading, "", lambda row, one=one: row.margin_text(one)))
    cases = Column("cases", "", lambda row: row.found.cases if row.acts else None)
    return [*SET, *margins, Column("limited by", "", lambda row: row.limit), cases]


def recommended_facts(gains: RobotGains) -> dict[str, Any]:
    """Recommended gains of one space in JSON."""
    return {
        "space": gains.space,
        "names": list(gains.names),
        "sets": [{**facts(SET, row), **margin_facts(row.found.margins)} for row in rows(gains) if row.found is not None],
        "cost": gains.cost,
        "not_found": {name or "everywhere": text for name, text in gains.nearest.items()},
    }


def gain_columns(sets: Sequence[Row], inertia: Floats | None = None) -> list[Column]:
    """The gains of a joint or a task direction, a row by its place, in every set; with `inertia` (n,) divided by it."""
    gains = sets[0].gains
    cascade = any(row.found is not None and row.found.ki is not None for row in sets)
    titles = {"kp": "kp", "kd": "kv or kd", "ki": "ki"} if cascade else {"kp": "kp", "kd": "kd"}
    if inertia is not None:
        titles = {"kp": "kp/J [1/s²]", "kd": "kd/J [1/s]"}

    def column(row: Row, name: str, title: str) -> Column:
        values = None if row.found is None else getattr(row.found, name) / (1.0 if inertia is None else inertia)
        return Column(title, "", lambda k: "none" if values is None else values[k])

    def prefix(row: Row, name: str) -> str:
        return f"{row.title}: " if len(sets) > 1 and name == "kp" else ""

    return [
        Column("joint" if gains.space == "joint" else "direction", "", lambda k: gains.names[k]),
        *(column(row, name, prefix(row, name) + title) for row in sets for name, title in titles.items()),
    ]
