"""One number of the paper beside the same number computed here."""

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A comparison.

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
        """The note says what becomes of one of the paper's conclusions."""
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
    """A row of verdicts."""
    return Row(key, paper, computed, "", paper is computed, note, 0.0, "yes" if paper else "no")


def counts(rows: Iterable[Row]) -> tuple[int, int, int, int]:
    """Numbers that the paper prints: how many agree, and how many there are; the same of further checks."""
    printed, further = [], []
    for row in rows:
        (printed if row.printed else further).append(row.agrees)
    return sum(printed), len(printed), sum(further), len(further)
