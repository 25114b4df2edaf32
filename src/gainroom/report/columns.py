"""Columns: one definition per displayed number, from which terminal, JSON, page and documentation are made.

Margins are in margin_columns.py, states, joints and tasks of a robot in robot_columns.py, a robot's recommended gains in
recommended_gains.py. A further column is one more entry in one of those lists.
"""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import THIN
from ..system.requirements import REQUIREMENTS
from .number_format import digits


@dataclass(frozen=True)
class Column:
    """One quantity of a row: of a state, a joint, a direction of a task, a set of margins.

    title        heading; "": in JSON alone
    key          name in JSON, with the unit if it is not SI; "": displayed alone
    value        row → JSON value: a number in the unit of `key`, a text, a list, an interval; None: no value
    unit         displayed behind the number
    definition   definition, a sentence without its subject
    significant  number of digits displayed
    shown        row → displayed text, if that is not `value` with its unit
    at           row → frequency [rad/s] of the quantity
    margin       field of Margins, which a requirement may bound
    interval     row → text of its 95 % interval; None: no interval
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
        """Name of the requirement that bounds the column; "" if none does."""
        return self.margin if self.margin in REQUIREMENTS else ""

    def text(self, row: Any) -> str:
        """Displayed text of a row."""
        if self.shown is not None:
            return self.shown(row)
        value = self.value(row)
        return value if isinstance(value, str) else digits(value, self.unit, self.significant)


def facts(columns: Iterable[Column], row: Any) -> dict[str, Any]:
    """JSON object of a row."""
    return {column.key: column.value(row) for column in columns if column.key}


def tabulated(columns: Sequence[Column], rows: Iterable[Any]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Headings and rows of a table: the first column and those with a title, without columns that are empty in every row."""
    placed, rows = [column for k, column in enumerate(columns) if column.title or k == 0], [*rows]
    texts = [[column.text(row) for row in rows] for column in placed]
    filled = [k for k, cells in enumerate(texts) if k == 0 or any(cell not in ("", "–") for cell in cells)]
    return [placed[k].title for k in filled], [*zip(*(texts[k] for k in filled), strict=True)]


ALIKE = 1e-3
"""Relative difference of numbers, as of a left and a right leg, up to which two rows share one."""
_WORDS, _NUMBER = re.compile(r"[^\W_]+|[\W_]+"), re.compile(r"\d+(?:\.\d+)?")


def alike_rows(texts: Sequence[Sequence[str]]) -> list[list[int]]:
    """Groups of row indices that may share one row: first cells differ in one word, all other cells print alike."""
    groups: list[list[int]] = []
    for k, row in enumerate(texts):
        alike = (
            group
            for group in groups
            if _shared_name([texts[j][0] for j in (*group, k)]) and all(map(_prints_alike, texts[group[0]][1:], row[1:]))
        )
        group = next(alike, None)
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return groups


def shared_row(texts: Sequence[Sequence[str]], group: Sequence[int]) -> tuple[str, ...]:
    """Row that represents a group of alike_rows, named after all: "left/right_knee"."""
    return (_shared_name([texts[k][0] for k in group]), *texts[group[0]][1:])


def _prints_alike(one: str, other: str) -> bool:
    """True if two cells have the same text, except for numbers that differ by less than ALIKE."""
    if one == other:
        return True
    numbers = [[float(found) for found in _NUMBER.findall(text.replace(THIN, ""))] for text in (one, other)]
    same = _NUMBER.sub("", one.replace(THIN, "")) == _NUMBER.sub("", other.replace(THIN, ""))
    return same and all(math.isclose(a, b, rel_tol=ALIKE) for a, b in zip(*numbers, strict=True))


def _shared_name(names: Sequence[str]) -> str:
    """Common name, "left/right_knee"; "" if names differ in more than one word."""
    words = [_WORDS.findall(name) for name in names]
    if len({len(each) for each in words}) > 1:
        return ""
    places = [sorted(set(place)) for place in zip(*words, strict=True)]
    return "".join(map("/".join, places)) if sum(len(each) > 1 for each in places) <= 1 else ""


def definitions(columns: Sequence[Column], shown: Collection[str]) -> str:
    """Definitions of the columns with these titles, as a text below a table."""
    found = "; ".join(f"{column.title}: {column.definition}" for column in columns if column.title in shown and column.definition)
    return found and f"{found}."


def units_of(shown: Collection[str], units: Mapping[str, str]) -> str:
    """Units of the columns with these titles: "kp [N·m/rad], kd [N·m·s/rad]"."""
    return ", ".join(f"{title} [{unit}]" for title, unit in units.items() if title in shown)


def yes(value: bool | None) -> str:
    """Table cell of a truth value: "yes", "no", or a dash for None."""
    return "–" if value is None else "yes" if value else "no"
