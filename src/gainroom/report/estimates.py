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
    title: str,
    key: str,
    estimate: Callable[[Any], Estimate | None],
    unit: str = "",
    scale: float = 1.0,
    definition: str = "",
    shown_in: tuple[str, float] | None = None,
) -> Column:
    """A column whose value is {"value", "low", "high"} in `unit`, SI times `scale`; None where `estimate` has none.

    shown_in   another unit that people read, and SI's factor to it
    """
    shown_unit, shown_scale = (unit, scale) if shown_in is None else shown_in

    def scaled(row: Any, factor: float) -> dict[str, float] | None:
        found = estimate(row)
        return None if found is None else {name: factor * getattr(found, name) for name in ("value", "low", "high")}

    def shown(row: Any) -> str:
        found = scaled(row, shown_scale)
        return "–" if found is None else digits(found["value"], shown_unit, warranted_digits(**found))

    def interval(row: Any) -> str:
        found = scaled(row, shown_scale)
        return "" if found is None else interval_text(found["low"], found["high"])

    return Column(title, key, lambda row: scaled(row, scale), unit, definition, shown=shown, interval=interval)


def warranted_digits(value: float, low: float, high: float) -> int:
    """Significant digits of a value that its interval warrants: two of its half-width."""
    half = (high - low) / 2
    if not (half > 0 and math.isfinite(half) and value):
        return 4
    before_point = math.floor(math.log10(abs(value)))
    return min(max(before_point - math.floor(math.log10(half)) + 2, min(before_point, 2) + 1, LEAST_DIGITS), MOST_DIGITS)


def interval_text(low: float, high: float) -> str:
    """Two ends of an interval, with digits enough to tell them apart."""
    return f"{digits(low, '', warranted_digits(low, low, high))} to {digits(high, '', warranted_digits(high, low, high))}"


@dataclass(frozen=True)
class Answer:
    """What a command that identifies says.

    title        of its table
    sentence     the answer, and first of all whether it can be relied on
    columns      its numbers, out of `result`
    parameters   those that stand together under this key in JSON, without those that there are none of
    warnings     what the reader should know
    """

    title: str
    sentence: str
    columns: Sequence[Column]
    result: Any
    warnings: tuple[str, ...] = ()
    parameters: Sequence[Column] = ()

    def facts(self) -> dict[str, Any]:
        """In JSON."""
        together = {key: value for key, value in facts(self.parameters, self.result).items() if value is not None}
        nested = {"parameters": together} if self.parameters else {}
        return {"sentence": self.sentence, **facts(self.columns, self.result), **nested, "warnings": list(self.warnings)}

    def rows(self) -> list[tuple[str, str, str]]:
        """As TITLES says, of the numbers that there are."""
        shown = [column for column in (*self.parameters, *self.columns) if column.title and column.value(self.result) is not None]
        return [
            (column.title, column.text(self.result), "" if column.interval is None else column.interval(self.result)) for column in shown
        ]
