"""Rows as people read them, on the terminal and on the page."""

from collections.abc import Iterable

from ..report.number_format import digits
from .row import Row, counts

COLUMNS = ("", "Paper", "Here", "Unit", "Agrees")
BRACKETS = "In brackets: not printed in the paper; the note says what it is."


def summary(rows: Iterable[Row]) -> str:
    """How many rows agree."""
    agree, printed, hold, further = counts(rows)
    return f"{agree} of {printed} numbers of the paper agree; {hold} of {further} further checks hold."


def cells(row: Row) -> tuple[str, ...]:
    """A row under COLUMNS."""
    return row.id, _paper(row), value_text(row.computed), row.unit, "yes" if row.agrees else "no"


def claims(rows: Iterable[Row]) -> list[tuple[str, str]]:
    """The paper's conclusions by name, each with what becomes of it here."""
    notes = sorted(row.note for row in rows if row.is_claim)
    return [(name, text[0].upper() + text[1:]) for name, _, text in (note.partition(": ") for note in notes)]


def interval(row: Row) -> str:
    """Of a number that is identified from a log; "" of others."""
    return "" if row.low is None or row.high is None else f"95 % interval {digits(row.low)} to {digits(row.high, row.unit)}"


def value_text(value: float | bool) -> str:
    """A number or a verdict; what is round-off is 0."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "0" if abs(value) < 1e-9 else digits(value)


def _paper(row: Row) -> str:
    """The paper's number or range with the tolerance; in brackets what is expected where the paper prints nothing."""
    text = row.printed if row.is_range else f"≥ {value_text(row.paper)}" if row.is_least else value_text(row.paper)
    if row.tolerance and not row.is_range:
        text += f" ± {digits(float(f'{row.tolerance:.2g}'))}"
    return text if row.printed else f"({text})"
