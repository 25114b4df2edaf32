"""Text with one row per line: comma, semicolon, tab, bar or spaces between the fields; the header names the columns.

The delimiter, comments before the header, a line of units below it and the decimal comma are found out from the first lines.
"""

import contextlib
import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from ....errors import GainroomError, first_of_many
from ....system.linear.arrays import Floats
from ..table import BLOCK_ROWS, MOST_COLUMNS, Column, LogFormat, Table, bounded, checked_file, column_names, guarded
from ..units import UNITS, known_unit

MOST_LINE = 1 << 20
"""Characters: 10,000 columns of 17 digits are 0.25 MB."""
MOST_COMMENTS = 1000
"""Lines before the first row."""
COMMENTS = ("#", "%")
PROBED = 100
"""Rows that show which columns hold numbers."""
WORDS = 0.5
"""Share of fields that are no number from which on a column is one of words; below it, they are damage."""
DELIMITERS = (",", ";", "\t", "|", None)
"""None: any white space."""
NOTHING = frozenset(("", "nan", "null", "none", "na", "n/a", "-", "--"))
"""What stands in a field that holds no number."""


class CsvSink:
    """Text, one line per row, numbers with all their digits; every block is flushed."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, "w", encoding="utf-8", newline="")  # noqa: SIM115 - closed in close()

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        csv.writer(self._file, lineterminator="\n").writerow(column_names(joints, signals))

    def rows(self, time: Floats, signals: Sequence[Floats]) -> None:
        table = np.hstack([time[:, None], *signals])
        self._file.writelines(",".join(map(repr, row)) + "\n" for row in table.tolist())
        self._file.flush()

    def close(self) -> None:
        self._file.close()


@dataclass(frozen=True)
class _Layout:
    """How the lines are built: header fields, line numbers of the header and the first row (from 1), delimiter, decimal comma."""

    header: tuple[str, ...]
    units: tuple[str, ...]
    first_row: int
    delimiter: str | None
    comma: bool


class CsvTable(Table):
    """A text file; `columns` are those that hold numbers, or nothing, in the first rows."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._layout = _layout(path)
        with guarded(path, "CSV"), _lines(path, self._layout.first_row) as lines:
            fields = [_fields(line, self._layout.delimiter) for _, line in zip(range(PROBED), lines, strict=False)]
        wrong = [
            sum(len(row) > k and _number(row[k], self._layout.comma) is None for row in fields) for k in range(len(self._layout.header))
        ]
        numeric = [k for k, count in enumerate(wrong) if count < WORDS * len(fields) or not fields]
        self.columns = [Column(self._layout.header[k], unit=self._layout.units[k]) for k in numeric]
        words = [name for k, name in enumerate(self._layout.header) if k not in numeric]
        self.notes = [f"columns without numbers: {first_of_many(words)}"] if words else []

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        layout, row = self._layout, 0
        places = [layout.header.index(name) for name in names]
        with _lines(self._path, layout.first_row) as source:
            lines: list[str] = []
            for line in source:
                if not line.endswith(("\n", "\r")):
                    self.complete = False  # half a number can still look like one
                    break
                if line.strip():
                    lines.append(line)
                if len(lines) == BLOCK_ROWS:
                    yield self._numbers(lines, places, row)
                    row += len(lines)
                    lines = []
            if lines:
                yield self._numbers(lines, places, row)

    def _numbers(self, lines: list[str], places: list[int], row: int) -> list[Floats]:
        layout = self._layout
        if not layout.comma and '"' not in "".join(lines[:1]):
            separators = None if layout.delimiter is None else {line.count(layout.delimiter) for line in lines}
            if separators is None or separators == {len(layout.header) - 1}:
                with contextlib.suppress(ValueError, IndexError):
                    return list(np.loadtxt(lines, delimiter=layout.delimiter, comments=None, usecols=places, ndmin=2).T.copy())
        return list(np.array([self._row(line, places, row + k) for k, line in enumerate(lines)], dtype=float).T)

    def _row(self, line: str, places: list[int], row: int) -> list[float]:
        """One line at a time, slowly: with missing numbers, quotes or decimal commas; and to say what is wrong."""
        fields, header = _fields(line, self._layout.delimiter), self._layout.header
        if len(fields) != len(header):
            raise GainroomError(f"{self._path}: row {row + 1} has {len(fields)} fields, not the {len(header)} of the first line")
        numbers = []
        for k in places:
            value = _number(fields[k], self._layout.comma)
            if value is None:
                raise GainroomError(f"{self._path}: {header[k]} in row {row + 1}: {fields[k][:40]!r} is not a number")
            numbers.append(value)
        return numbers


class CsvText(LogFormat):
    """CSV and its relatives."""

    title = "CSV"
    endings = (".csv", ".tsv", ".txt")
    makes = CsvSink

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        yield CsvTable(path)


@contextlib.contextmanager
def _lines(path: Path, first: int = 1) -> Iterator[Iterator[str]]:
    """The lines from line number `first` on, each with its end. Latin-1 reads any byte; only names hold other letters, and are decoded."""
    with open(path, encoding="latin-1", newline="") as file:
        source = _bounded_lines(path, file)
        for _ in range(first - 1):
            next(source, None)
        yield source


def _bounded_lines(path: Path, file: IO[str]) -> Iterator[str]:
    """Raises GainroomError for what no text has."""
    number = 0
    while line := file.readline(MOST_LINE):
        number += 1
        if len(line) >= MOST_LINE:
            raise GainroomError(f"{path}: line {number} is longer than {MOST_LINE} characters; this is not CSV")
        if "\0" in line:
            raise GainroomError(f"{path}: line {number} is binary, not CSV")
        yield line


def _layout(path: Path) -> _Layout:
    """Raises GainroomError where there is no header."""
    checked_file(path)
    with guarded(path, "CSV"), _lines(path) as lines:
        head = _decoded([line for _, line in zip(range(MOST_COMMENTS), lines, strict=False)])
    filled = [k for k, line in enumerate(head) if line.strip()]
    plain = [k for k in filled if not head[k].lstrip().startswith(COMMENTS)]
    if not plain:
        raise GainroomError(f"{path}: is empty; its first line must name the columns")
    place = plain[0]
    delimiter, comma = _delimiter([head[k] for k in plain[1:4]] or [head[place]])
    if place > 0 and _all_numbers(_fields(head[place], delimiter), comma):  # the header itself stands behind a #
        place = max(k for k in filled if k < place)
        head[place] = head[place].lstrip().lstrip("#%").lstrip()
    header = _header(path, head[place], delimiter, comma)
    below = next((k for k in plain if k > place), None)
    units = [] if below is None else [field.strip().strip("[]()") for field in _fields(head[below], delimiter)]
    known = any(known_unit(text, dimension) for text in units for dimension in UNITS)
    if below is not None and len(units) == len(header) and known and all(_number(text, comma) is None or not text for text in units):
        return _Layout(header, tuple(units), below + 2, delimiter, comma)
    return _Layout(header, ("",) * len(header), place + 2, delimiter, comma)


def _header(path: Path, line: str, delimiter: str | None, comma: bool) -> tuple[str, ...]:
    """The names of the columns. Raises GainroomError where they are none."""
    names = [name.strip() for name in _fields(line, delimiter)]
    bounded(path, "number of columns", len(names), MOST_COLUMNS)
    if not any(names) or not "".join(names).isprintable():
        raise GainroomError(f"{path}: is empty or not text; its first line must name the columns")
    if _all_numbers(names, comma):
        raise GainroomError(f"{path}: has no header: its first line {line.strip()[:40]!r} must name the columns")
    names = [name or f"column {k + 1}" for k, name in enumerate(names)]
    if len(set(names)) != len(names):
        raise GainroomError(f"{path}: column {next(name for name in names if names.count(name) > 1)!r} is there twice")
    return tuple(names)


def _all_numbers(fields: Sequence[str], comma: bool) -> bool:
    return all(_number(field, comma) is not None for field in fields)


def _decoded(lines: Sequence[str]) -> list[str]:
    """Lines that were read as Latin-1, with the letters that were meant."""
    try:
        return [line.encode("latin-1").decode("utf-8-sig" if k == 0 else "utf-8") for k, line in enumerate(lines)]
    except UnicodeDecodeError:
        return list(lines)  # Latin-1 itself: a degree sign from a spreadsheet


def _delimiter(lines: Sequence[str]) -> tuple[str | None, bool]:
    """What stands between the fields of these lines of numbers, and whether their decimal sign is a comma."""
    decimal = re.compile(r"[-+]?[0-9]+,[0-9]+")
    for delimiter in (";", "\t", "|", None):
        rows = [_fields(line, delimiter) for line in lines]
        if all(len(row) > 1 for row in rows) and any(decimal.fullmatch(field.strip()) for row in rows for field in row):
            return delimiter, True
    counts = {delimiter: [len(_fields(line, delimiter)) for line in lines] for delimiter in DELIMITERS}
    best = max(DELIMITERS, key=lambda delimiter: (len(set(counts[delimiter])) == 1 and counts[delimiter][0] > 1, counts[delimiter][0]))
    return (best if counts[best][0] > 1 else ","), False


def _fields(line: str, delimiter: str | None) -> list[str]:
    line = line.rstrip("\r\n")
    if delimiter is None:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return line.split(delimiter)


def _number(field: str, comma: bool) -> float | None:
    """A field's number; NaN where it holds none, None where it holds something else."""
    plain = field.strip()
    if plain.lower() in NOTHING:
        return np.nan
    if plain in ("True", "False", "true", "false"):
        return float(plain.lower() == "true")
    try:
        return float(plain.replace(",", ".") if comma else plain)
    except ValueError:
        return None
