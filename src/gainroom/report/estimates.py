"""Numbers with their 95 % intervals, as people and programs read them; and the answer of a command that identifies."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ..identification import Estimate
from .columns import Column, facts
from .number_format import digits

INTERVAL = "95 % interval"
MOST_DIGITS, LEAST_DIGITS = 6, 2
TITLES = ("", "value", INTERVAL)
"""Of the table that Answer.rows make."""


def estimated(
    title: str, key: str, estimate: Callable[[Any], Estimate | None], unit: str = "", scale: float = 1.0, definition: str = ""
) -> Column:
    """A column whose value is {"value", "low", "high"} in `unit`, SI times `scale`; None where `estimate` has none."""

    def value(row: Any) -> dict[str, float] | None:
        found = estimate(row)
        return None if found is None else {name: scale * getattr(found, name) for name in ("value", "low", "high")}

    def shown(row: Any) -> str:
        found = value(row)
        return "–" if found is None else digits(found["value"], unit, told_digits(**found))

    return Column(title, key, value, unit, definition, shown=shown)


def told_digits(value: float, low: float, high: float) -> int:
    """Significant digits of a value that its interval warrants: two of its half-width."""
    half = (high - low) / 2
    if not (half > 0 and math.isfinite(half) and value):
        return 4
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(half)) + 2, LEAST_DIGITS), MOST_DIGITS)


def interval_text(column: Column, row: Any) -> str:
    """Low and high end of an estimate; empty for what is none."""
    found = column.value(row)
    if not isinstance(found, dict):
        return ""
    low, high = (digits(found[end], "", told_digits(**{**found, "value": found[end]})) for end in ("low", "high"))
    return f"{low} to {high}"


@dataclass(frozen=True)
class Answer:
    """What a command that identifies says.

    sentence   the answer, and first of all whether it can be relied on
    columns    its numbers, out of `found`
    warnings   what the reader should know, of the fit and of the log
    """

    sentence: str
    columns: Sequence[Column]
    found: Any
    warnings: tuple[str, ...] = ()

    def facts(self) -> dict[str, Any]:
        """In JSON."""
        return {"sentence": self.sentence, **facts(self.columns, self.found), "warnings": list(self.warnings)}

    def rows(self) -> list[tuple[str, str, str]]:
        """As TITLES says, of the numbers that there are."""
        shown = [column for column in self.columns if column.title and column.value(self.found) is not None]
        return [(column.title, column.text(self.found), interval_text(column, self.found)) for column in shown]
