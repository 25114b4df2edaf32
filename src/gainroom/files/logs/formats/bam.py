"""JSON: BAM's logs (github.com/Rhoban/bam), a list `entries` with one object per sample; or an object of lists, one per column."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....errors import GainroomError, one_line
from ..table import MOST_COLUMNS, LogFormat, Table, bounded, checked_file
from .arrays import ArrayTable, NamedArray
from .text_times import is_time, times_in

MOST_TEXT = 1 << 28
"""Bytes: a parsed JSON takes some ten times its text in memory, and a minute of BAM's samples is 2 MB."""


class Bam(LogFormat):
    """Reader of logs in JSON: a list of samples, or an object of lists."""

    name = "JSON (BAM)"
    title = "a log in JSON"
    endings = (".json",)

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        bounded(path, "size", checked_file(path), MOST_TEXT, " bytes")
        try:
            data = json.loads(path.read_bytes())
        except (ValueError, RecursionError) as error:
            raise GainroomError(f"{path}: is not JSON: {one_line(error, 120)}") from error
        entries = data.get("entries") if isinstance(data, dict) else data
        arrays = _columns(path, entries) if isinstance(entries, list) else _lists(data) if isinstance(data, dict) else {}
        if not arrays:
            raise GainroomError(
                f"{path}: holds no samples: a list `entries` of objects with numbers, as BAM writes it, or lists of numbers"
            )
        yield ArrayTable(path, arrays, time)


def _columns(path: Path, entries: list[object]) -> dict[str, NamedArray]:
    """Columns by key, one for each key with a number in any entry; NaN for entries without one."""
    names: dict[str, None] = {}
    for entry in entries:
        if not isinstance(entry, dict):
            raise GainroomError(f"{path}: entries must be objects with numbers; one is {one_line(repr(entry), 40)}")
        names.update(dict.fromkeys(key for key, value in entry.items() if _may_be(value)))
        bounded(path, "number of columns", len(names), MOST_COLUMNS)
    return _named({name: [entry.get(name) for entry in entries] for name in names})  # type: ignore[attr-defined]


def _lists(data: dict[str, object]) -> dict[str, NamedArray]:
    return _named(
        {
            name: values
            for name, values in data.items()
            if isinstance(values, list) and values and all(each is None or _may_be(each) for each in values)
        }
    )


def _may_be(value: object) -> bool:
    """True if a value is a number, or a text that is a time."""
    return isinstance(value, bool | int | float) or (isinstance(value, str) and is_time(value))


def _named(columns: dict[str, list[object]]) -> dict[str, NamedArray]:
    """Arrays by column name: seconds for texts that are times, otherwise numbers; NaN for any other value."""
    found = {}
    for name, values in columns.items():
        times = times_in(values)
        numbers = [_number(value) for value in values] if times is None else times
        found[name] = NamedArray.of(np.array(numbers), "" if times is None else "s")
    return found


def _number(value: object) -> float:
    """Value as a float; NaN if it is no number, or one that a float cannot hold."""
    try:
        return float(value) if isinstance(value, bool | int | float) else np.nan
    except OverflowError:
        return np.nan
