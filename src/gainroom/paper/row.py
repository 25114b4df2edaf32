"""One number of the paper beside the same number computed here, and both as people read them."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ..report.number_format import digits


@dataclass(frozen=True)
class Row:
    """Comparison of one number of the paper with the same number computed here.

    id         figure, case and quantity, joined by dots; the quantity names its unit
    paper      the paper's number, the middle of its range, or what is expected where it prints nothing (the note says why)
    computed   the same, computed on the spot
    tolerance  how far `computed` may be from `paper`; the note says why where it is not half a unit of the last printed digit
    printed    the paper's own digits, "" where it prints none
    is_range   the paper gives a range, paper ± tolerance
    is_least   `paper` is the least that a claim asks for
    low, high  95 % interval of `computed` where it is identified from a log; None elsewhere
    """

    id: str
    paper: float | bool
    computed: float | bool
    unit: str
    agrees: bool
    note: str
    tolerance: float
    printed: str
    is_range: bool = False
    is_least: bool = False
    low: float | None = None
    high: float | None = None

    @property
    def is_claim(self) -> bool:
        """True if the note gives the result of one of the paper's conclusions."""
        return self.note.startswith("Claim ")


def compare(key: str, paper: float, computed: float, unit: str, tolerance: float, note: str = "", printed: str = "") -> Row:
    """A row that agrees when `computed` lies within `tolerance` of `paper`."""
    agrees = math.isfinite(computed) and abs(computed - paper) <= tolerance
    return Row(key, paper, float(computed), unit, agrees, note, tolerance, printed)


def within(key: str, low: float, high: float, computed: float, unit: str, note: str) -> Row:
    """A row that agrees when `computed` lies in the range that the paper gives."""
    agrees = low <= computed <= high
    return Row(key, (low + high) / 2, float(computed), unit, agrees, note, (high - low) / 2, f"{low:g} to {high:g}", is_range=True)


def at_least(key: str, least: float, computed: float, unit: str, note: str) -> Row:
    """A row that agrees when `computed` is no less than a claim asks for."""
    return Row(key, least, float(computed), unit, computed >= least, note, 0.0, "", is_least=True)


def same(key: str, paper: bool, computed: bool, note: str) -> Row:
    """Row that compares two verdicts."""
    return Row(key, paper, computed, "", paper is computed, note, 0.0, "yes" if paper else "no")


def counts(rows: Iterable[Row]) -> tuple[int, int, int, int]:
    """Numbers that the paper prints: how many agree, and how many there are; the same of further checks."""
    printed, further = [], []
    for row in rows:
        (printed if row.printed else further).append(row.agrees)
    return sum(printed), len(printed), sum(further), len(further)


COLUMNS = ("", "Paper", "Here", "Unit", "Agrees")
BRACKETS = "In brackets: not printed in the paper; the note says what it is."


def summary(rows: Iterable[Row]) -> str:
    """Numbers of rows that agree, as a sentence."""
    agree, printed, hold, further = counts(rows)
    return f"{agree} of {printed} numbers of the paper agree; {hold} of {further} further checks hold."


def cells(row: Row) -> tuple[str, ...]:
    """Table cells of a row, under the headings COLUMNS."""
    return row.id, _paper(row), value_text(row.computed), row.unit, "yes" if row.agrees else "no"


def claims(rows: Iterable[Row]) -> list[tuple[str, str]]:
    """The paper's conclusions by name, each with what becomes of it here."""
    notes = sorted(row.note for row in rows if row.is_claim)
    return [(name, text[0].upper() + text[1:]) for name, _, text in (note.partition(": ") for note in notes)]


def interval(row: Row) -> str:
    """95 % interval of a number that is identified from a log, as text; "" for other numbers."""
    return "" if row.low is None or row.high is None else f"95 % interval {digits(row.low)} to {digits(row.high, row.unit)}"


def value_text(value: float | bool) -> str:
    """Text of a number, 0 if it is round-off, or of a verdict."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "0" if abs(value) < 1e-9 else digits(value)


def _paper(row: Row) -> str:
    """Text of the paper's number or range with its tolerance; in brackets an expected value that the paper does not print."""
    text = row.printed if row.is_range else f"≥ {value_text(row.paper)}" if row.is_least else value_text(row.paper)
    if row.tolerance and not row.is_range:
        text += f" ± {digits(float(f'{row.tolerance:.2g}'))}"
    return text if row.printed else f"({text})"
