"""Estimates with 95 % intervals as columns and text; and the presentation of an identification."""

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
"""Headings of the table from Answer.rows."""


def estimated(
    title: str,
    key: str,
    estimate: Callable[[Any], Estimate | None],
    unit: str = "",
    scale: float = 1.0,
    definition: str = "",
    shown_in: tuple[str, float] | None = None,
) -> Column:
    """Column whose value is {"value", "low", "high"} in `unit`, SI times `scale`; None if `estimate` returns None.

    shown_in   another displayed unit, and the factor to it from SI
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
    """Number of significant digits that an interval warrants: two of its half-width."""
    half = (high - low) / 2
    if not (half > 0 and math.isfinite(half) and value):
        return 4
    before_point = math.floor(math.log10(abs(value)))
    return min(max(before_point - math.floor(math.log10(half)) + 2, min(before_point, 2) + 1, LEAST_DIGITS), MOST_DIGITS)


def interval_text(low: float, high: float) -> str:
    """Interval as text, with enough digits to distinguish its ends."""
    return f"{digits(low, '', warranted_digits(low, low, high))} to {digits(high, '', warranted_digits(high, low, high))}"


@dataclass(frozen=True)
class Answer:
    """Answer of an identification.

    title        of its table
    sentence     answer, beginning with whether it can be relied on
    columns      its numbers, from `result`
    parameters   columns collected under the JSON key `parameters`, without absent ones
    warnings     for the user
    """

    title: str
    sentence: str
    columns: Sequence[Column]
    result: Any
    warnings: tuple[str, ...] = ()
    parameters: Sequence[Column] = ()

    def facts(self) -> dict[str, Any]:
        """JSON object of the answer."""
        together = {key: value for key, value in facts(self.parameters, self.result).items() if value is not None}
        nested = {"parameters": together} if self.parameters else {}
        return {"sentence": self.sentence, **facts(self.columns, self.result), **nested, "warnings": list(self.warnings)}

    def rows(self) -> list[tuple[str, str, str]]:
        """Table rows (TITLES) of the numbers that exist."""
        shown = [column for column in (*self.parameters, *self.columns) if column.title and column.value(self.result) is not None]
        return [
            (column.title, column.text(self.result), "" if column.interval is None else column.interval(self.result)) for column in shown
        ]
