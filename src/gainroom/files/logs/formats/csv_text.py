"""Text with one row per line: comma, semicolon, tab, bar or spaces between the fields; the header names the columns.

The letters' encoding, the delimiter, comments before the header, a line of units below it and the decimal comma are found out from the
first lines. Without a header the columns are called 1, 2, 3, …
"""

import contextlib
import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from ....errors import MOST_PROBLEMS, MOST_SHOWN, GainroomError, first_of_many
from ....system.linear.arrays import Floats
from ..table import BLOCK_ROWS, MOST_COLUMNS, Column, LogFormat, Table, bounded, checked_file, column_names, guarded
from ..units import UNITS, known_unit
from .text_times import TextClock, is_time

MOST_LINE = 1 << 20
"""Characters: 10,000 columns of 17 digits are 0.25 MB."""
MOST_COMMENTS = 1000
"""Lines before the first row."""
COMMENTS = ("#", "%")
PROBED = 100
"""Rows that show which columns hold numbers."""
LISTED = re.compile(r"(.*\.)?([A-Za-z_]+?)_?\[?([0-9]+)\]?")
"""An entry of an array: `field.position0`, `position[0]`."""
NAMES = frozenset(("name", "names", "joint_name", "joint_names"))
WORDS = 0.5
"""Share of fields that are no number from which on a column is one of words; below it, they are damage."""
DELIMITERS = (",", ";", "\t", "|", None)
"""None: any white space."""
MOST_DAMAGED = 0.02
"""Share of rows with a field that is no number, or with too many or few fields, from which on a file is refused: a line that was torn is
left out as a row without a number is; more of them are another decimal sign, another delimiter, or two files in one."""
NOTHING = frozenset(("", "nan", "null", "none", "na", "n/a", "-", "--"))
"""What stands in a field that holds no number."""


class CsvSink:
    """Writer of a log as CSV: one line per row, numbers with all their digits; every block is flushed."""

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
    """Layout of a text file: header fields, line number of the first row (from 1), delimiter, decimal comma, encoding.

    named   False where no line names the columns
    """

    header: tuple[str, ...]
    units: tuple[str, ...]
    first_row: int
    delimiter: str | None
    comma: bool
    encoding: str
    named: bool = True


class _Damage:
    """Count of rows that are no rows of numbers, among all read so far, with the problems of the first ones."""

    def __init__(self, path: Path) -> None:
        self._path, self.rows, self._damaged = path, 0, 0
        self._first: list[str] = []

    def add(self, problem: str) -> None:
        """Counts one more damaged row with its problem."""
        self._damaged += 1
        if self._damaged <= MOST_PROBLEMS:
            self._first.append(problem)

    def note(self) -> list[str]:
        """Note on the damaged rows, which are left out; [] if there are none."""
        if not self._damaged:
            return []
        which = "; ".join(self._first[:MOST_SHOWN]) + (f"; and {more} more" if (more := self._damaged - MOST_SHOWN) > 0 else "")
        return [f"{self._damaged} damaged row{'s' * (self._damaged > 1)} left out: {which}"]

    def require_few(self) -> None:
        """Raises GainroomError, with a line for each of the first damaged rows, if these are too many to be left out."""
        if self._damaged > MOST_DAMAGED * self.rows:
            told = f"{self._damaged} of the first {self.rows} rows are damaged; up to {MOST_DAMAGED:.0%} are left out, more are refused"
            room = MOST_PROBLEMS - 1
            first = self._first if self._damaged <= room else self._first[: room - 1]
            more = [f"and {self._damaged - len(first)} more"] if self._damaged > len(first) else []
            raise GainroomError(f"{self._path}: {told}", *(f"{self._path}: {text}" for text in first), *more)


class CsvTable(Table):
    """Table of a text file; its `columns` are those with numbers, or nothing, in the first rows."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path, self._size, self._passed = path, checked_file(path), 0
        self._layout = layout = _layout(path)
        with guarded(path, "CSV"), _lines(path, layout.encoding, layout.first_row) as lines:
            fields = [_fields(line, layout.delimiter) for _, line in zip(range(PROBED), lines, strict=False) if line.strip()]
        columns = [[row[k] for row in fields if len(row) > k] for k in range(len(layout.header))]
        wrong = [sum(_number(field, layout.comma) is None for field in column) for column in columns]
        numeric = [k for k, count in enumerate(wrong) if count < WORDS * len(fields) or not fields]
        self._clocks = {
            k for k, column in enumerate(columns) if k not in numeric and sum(map(is_time, column)) >= WORDS * len(column) and column
        }
        joints = _joints_of(layout.header, columns, numeric)
        self.columns = [
            Column(name, *joints.get(name, ("", "")), unit="s" if k in self._clocks else layout.units[k])
            for k, name in enumerate(layout.header)
            if k in numeric or k in self._clocks
        ]
        words = [name for k, name in enumerate(layout.header) if k not in numeric and k not in self._clocks]
        self._damage = _Damage(path)
        self.notes = [f"columns without numbers: {first_of_many(words)}"] if words else []
        if not layout.named:
            self.notes.append(f"no header: its columns are called 1 to {len(layout.header)} (--columns time=1,motor_position=2)")
        self._own_notes = self.notes

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        layout, self._damage, self._passed = self._layout, _Damage(self._path), 0
        places = [layout.header.index(name) for name in names]
        clocks = {place: TextClock() for place in places if place in self._clocks}
        self.taken_off = {}
        with _lines(self._path, layout.encoding, layout.first_row) as source:
            lines: list[str] = []
            for line in source:
                if not line.endswith(("\n", "\r")):
                    self.complete = False  # half a number can still look like one
                    break
                if line.strip():
                    lines.append(line)
                if len(lines) == BLOCK_ROWS:
                    yield self._block(lines, places, clocks)
                    lines = []
            if lines:
                yield self._block(lines, places, clocks)

    def _block(self, lines: list[str], places: list[int], clocks: dict[int, TextClock]) -> list[Floats]:
        """Columns (rows,) at `places` of a block of lines, times in seconds. Raises GainroomError if too many rows are damaged by then."""
        others = [place for place in places if place not in clocks]
        found = dict(zip(others, self._numbers(lines, others), strict=True)) if others else {}
        self._damage.rows += len(lines)
        self._passed += sum(map(len, lines))
        self.share = min(self._passed / self._size, 1.0)
        self._damage.require_few()
        self.notes = self._own_notes + self._damage.note()
        for place, clock in clocks.items():
            fields = (_fields(line, self._layout.delimiter) for line in lines)
            found[place] = clock.seconds([each[place] if place < len(each) else "" for each in fields])
            self.taken_off[self._layout.header[place]] = float(clock.base or 0)
        return [found[place] for place in places]

    def _numbers(self, lines: list[str], places: list[int]) -> list[Floats]:
        layout = self._layout
        if not layout.comma and '"' not in "".join(lines[:1]):
            separators = None if layout.delimiter is None else {line.count(layout.delimiter) for line in lines}
            if separators is None or separators == {len(layout.header) - 1}:
                with contextlib.suppress(ValueError, IndexError):
                    return list(np.loadtxt(lines, delimiter=layout.delimiter, comments=None, usecols=places, ndmin=2).T.copy())
        return list(np.array([self._row(line, places, self._damage.rows + k) for k, line in enumerate(lines)], dtype=float).T)

    def _row(self, line: str, places: list[int], row: int) -> list[float]:
        """Numbers of one line, which may have quotes, missing fields or decimal commas; NaN where it is damaged, which is counted."""
        fields, header = _fields(line, self._layout.delimiter), self._layout.header
        if len(fields) != len(header):
            self._damage.add(f"row {row + 1} has {len(fields)} fields, not the {len(header)} of the first line")
            return [np.nan] * len(places)
        numbers = [_number(fields[k], self._layout.comma) for k in places]
        if None in numbers:
            wrong = (f"{header[k]}: {_decoded([fields[k]])[0][:40]!r}" for k, value in zip(places, numbers, strict=True) if value is None)
            self._damage.add(f"row {row + 1}: {first_of_many(list(wrong))} is not a number")
        return [np.nan if value is None else value for value in numbers]


class CsvText(LogFormat):
    """Reader of logs in text files with one row per line."""

    name = "CSV"
    title = "CSV"
    endings = (".csv", ".tsv", ".txt")
    makes = CsvSink

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        yield CsvTable(path)


@contextlib.contextmanager
def _lines(path: Path, encoding: str, first: int = 1) -> Iterator[Iterator[str]]:
    """Context with the lines of a file from number `first` on, line ends included. As Latin-1, which reads any byte, unless UTF-16."""
    with open(path, encoding=encoding, newline="") as file:
        source = _bounded_lines(path, file)
        for _ in range(first - 1):
            next(source, None)
        yield source


def _encoding(path: Path) -> str:
    """Encoding of a text file: UTF-16 if it has its mark, or if every other byte at its beginning is 0; else Latin-1."""
    with open(path, "rb") as file:
        head = file.read(64)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    for name, zeros, letters in (("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2])):
        if len(head) >= 8 and not any(zeros) and all(letters):
            return name
    return "latin-1"


def _bounded_lines(path: Path, file: IO[str]) -> Iterator[str]:
    """Lines of a text file. Raises GainroomError for a line that is too long, or holds bytes that no text has."""
    number = 0
    while line := file.readline(MOST_LINE):
        number += 1
        if len(line) >= MOST_LINE:
            raise GainroomError(f"{path}: line {number} is longer than {MOST_LINE} characters; this is not CSV")
        if "\0" in line:
            raise GainroomError(f"{path}: line {number} is binary, not CSV")
        yield line


def _layout(path: Path) -> _Layout:
    """Layout of a text file, from its first lines. Raises GainroomError if there is neither a header nor a number."""
    checked_file(path)
    encoding = _encoding(path)
    with guarded(path, "CSV"), _lines(path, encoding) as lines:
        head = [line for _, line in zip(range(MOST_COMMENTS), lines, strict=False)]
    head = _decoded(head) if encoding == "latin-1" else head
    filled = [k for k, line in enumerate(head) if line.strip()]
    plain = [k for k in filled if not head[k].lstrip().startswith(COMMENTS)]
    place = _header_place(head, filled, plain)
    if place is None:
        raise GainroomError(f"{path}: is empty; its first line must name the columns")
    delimiter, comma = _delimiter([head[k] for k in plain if k > place][:3] or [head[place]])
    head[place] = head[place].lstrip().lstrip("#%").lstrip()
    fields = _fields(head[place], delimiter)
    if any(field.strip() for field in fields) and _all_numbers(fields, comma):
        bounded(path, "number of columns", len(fields), MOST_COLUMNS)
        names = tuple(str(k + 1) for k in range(len(fields)))
        return _Layout(names, ("",) * len(names), place + 1, delimiter, comma, encoding, named=False)
    header = _header(path, head[place], delimiter)
    below = next((k for k in plain if k > place), None)
    units = [] if below is None else [field.strip().strip("[]()") for field in _fields(head[below], delimiter)]
    known = any(known_unit(text, dimension) for text in units for dimension in UNITS)
    if below is not None and len(units) == len(header) and known and all(_number(text, comma) is None or not text for text in units):
        return _Layout(header, tuple(units), below + 2, delimiter, comma, encoding)
    return _Layout(header, ("",) * len(header), place + 2, delimiter, comma, encoding)


def _header_place(head: Sequence[str], filled: Sequence[int], plain: Sequence[int]) -> int | None:
    """The line that names the columns: the first that is no comment, or the comment above it where that is a row of as many fields.

    `rostopic echo -p` writes `%time,field.position0`, numpy `# time, q`. None where there is none.
    """
    if not plain:
        written = [k for k in filled if len(head) == len(filled) == 1]
        return written[0] if written else None
    first = plain[0]
    above = max((k for k in filled if k < first), default=None)
    if above is None:
        return first
    delimiter, comma = _delimiter([head[k] for k in plain[:3]])
    names = _fields(head[above].lstrip().lstrip("#%").lstrip(), delimiter)
    row = _fields(head[first], delimiter)
    numbers = [field for field in row if field.strip() and _number(field, comma) is not None]
    named = len(names) == len(row) and all(_number(name, comma) is None for name in names)
    return above if named and (numbers or any(map(is_time, row))) else first


def _joints_of(header: Sequence[str], columns: Sequence[Sequence[str]], numeric: Sequence[int]) -> dict[str, tuple[str, str]]:
    """Label and joint of columns that a list of names stands beside: `field.position0` and `field.name0`, as of `rostopic echo -p`."""
    names: dict[tuple[str, str], str] = {}
    for k, name in enumerate(header):
        found = LISTED.fullmatch(name)
        if found and k not in numeric and columns[k] and len(set(columns[k])) == 1 and found[2].lower() in NAMES:
            names[found[1] or "", found[3]] = columns[k][0].strip().strip('"')
    if len(set(names.values())) < len(names):
        return {}
    labelled = {}
    for k in numeric:
        found = LISTED.fullmatch(header[k])
        joint = names.get((found[1] or "", found[3])) if found else None
        if found and joint:
            labelled[header[k]] = (f"{found[1] or ''}{found[2]}", joint)
    return labelled


def _header(path: Path, line: str, delimiter: str | None) -> tuple[str, ...]:
    """Column names in the header line. Raises GainroomError if the line holds none."""
    names = [name.strip() for name in _fields(line, delimiter)]
    bounded(path, "number of columns", len(names), MOST_COLUMNS)
    if not any(names) or not "".join(names).isprintable():
        raise GainroomError(f"{path}: is empty or not text; its first line must name the columns")
    names = [name or f"column {k + 1}" for k, name in enumerate(names)]
    if len(set(names)) != len(names):
        raise GainroomError(f"{path}: column {next(name for name in names if names.count(name) > 1)!r} is there twice")
    return tuple(names)


def _all_numbers(fields: Sequence[str], comma: bool) -> bool:
    return all(_number(field, comma) is not None for field in fields)


def _decoded(lines: Sequence[str]) -> list[str]:
    """Lines read as Latin-1, decoded as UTF-8 where they are that."""
    try:
        return [line.encode("latin-1").decode("utf-8-sig" if k == 0 else "utf-8") for k, line in enumerate(lines)]
    except UnicodeDecodeError:
        return list(lines)  # Latin-1 itself: a degree sign from a spreadsheet


def _delimiter(lines: Sequence[str]) -> tuple[str | None, bool]:
    """Delimiter of the fields in these lines of numbers, None for spaces, and True if their decimal sign is a comma."""
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
    """Number in a field; NaN if it is empty or states a missing value, None if it holds anything else."""
    plain = field.strip()
    if plain.lower() in NOTHING:
        return np.nan
    if plain in ("True", "False", "true", "false"):
        return float(plain.lower() == "true")
    try:
        return float(plain.replace(",", ".") if comma else plain)
    except ValueError:
        return None
