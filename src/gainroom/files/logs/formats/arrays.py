"""Named arrays in a file as columns of a log: those that have as many rows as the time stamps."""

import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....errors import GainroomError, first_of_many
from ....system.linear.arrays import Floats
from ..guessing import channel_of
from ..table import BLOCK_ROWS, MOST_COLUMNS, MOST_ROWS, TIME, Column, Table, bounded, whole_numbers

MOST_CLOCKS = 500
"""Arrays of time stamps that are compared: one for every joint of a robot, and many more."""


@dataclass(frozen=True)
class NamedArray:
    """An array of numbers in a file.

    shape   of one or two axes
    rows    (first, last, axis) → that part of it along `axis`, (k,) or (k, n)
    unit    in the file's own words
    """

    shape: tuple[int, ...]
    rows: Callable[[int, int, int], Floats]
    unit: str = ""

    @classmethod
    def of(cls, values: Floats, unit: str = "") -> "NamedArray":
        """NamedArray of an array that is in memory, with its `unit` if the file states one."""
        return cls(values.shape, lambda first, last, axis: values[first:last] if axis == 0 else values[:, first:last].T, unit)

    def along(self, first: int, last: int) -> Floats:
        """Values from index `first` to `last` of its longest axis, as a flat array."""
        return np.ravel(self.rows(first, last, int(np.argmax(self.shape))))


def _group(name: str) -> str:
    """Name of the group that an array is in: `knee` for `knee/position` and `knee.position`."""
    return name[: max(name.rfind("/"), name.rfind("."), 0)]


@dataclass(frozen=True)
class _Place:
    array: str
    axis: int
    index: int | None


class ArrayTable(Table):
    """Columns of arrays: `q` of one axis, `q[0]`, `q[1]` … of two.

    time     the user's name for the time stamps; None: guessed
    labels   names of joints, for arrays with as many columns

    Raises GainroomError where no array can be a column.
    """

    def __init__(self, path: Path, arrays: Mapping[str, NamedArray], time: str | None, labels: Sequence[str] = ()) -> None:
        super().__init__()
        self._path = path
        self._arrays = {name: array for name, array in arrays.items() if 0 < len(array.shape) <= 2}
        self._groups: dict[str, list[str]] = {}
        for name in self._arrays:
            self._groups.setdefault(_group(name), []).append(name)
        stamps = self._stamps(time)
        self._count = self._rows(stamps)
        groups, gone = self._asynchronous(stamps)
        bounded(path, "number of rows", self._count, MOST_ROWS)
        self._places: dict[str, _Place] = {}
        columns = []
        for name, array in self._arrays.items():
            if name in gone:
                continue
            for column, place in self._columns(name, array, labels):
                columns.append(column)
                self._places[column.name] = place
            bounded(path, "number of columns", len(columns), MOST_COLUMNS)
        self.columns = columns
        others = [name for name in arrays if name not in gone and not any(place.array == name for place in self._places.values())]
        self.notes = [f"arrays that have not {self._count} rows: {first_of_many(others)}"] if others else []
        for own, names in groups.items():
            flag = f"--columns {shlex.quote(f'time={own}')}"
            self.notes.append(f"left out, as they have time stamps of their own: {first_of_many(names)} (to read them: {flag})")

    def _stamps(self, time: str | None) -> str | None:
        """Name of the array of time stamps, `time` if given by the user; None if there is none."""
        if not self._arrays:
            raise GainroomError(f"{self._path}: holds no array of numbers")
        if time is not None:
            name = time if time in self._arrays else re.sub(r"\[[0-9]+\]$", "", time)
            if name not in self._arrays:
                raise GainroomError(f"{self._path}: has no column {time!r} for time; it has {first_of_many([*self._arrays])}")
            return name
        return max(self._clocks(), key=lambda name: (not _group(name), len(self._groups[_group(name)])), default=None)

    def _clocks(self) -> list[str]:
        """Names of the arrays that hold time stamps."""
        long = [name for name, array in self._arrays.items() if max(array.shape) == np.prod(array.shape)]
        return [name for name in long if (guess := channel_of(name)) is not None and guess.channel == TIME]

    def _asynchronous(self, stamps: str | None) -> tuple[dict[str, list[str]], set[str]]:
        """Groups of arrays with time stamps other than `stamps`, by the name of those; and the names of all arrays that are no column."""
        if stamps is None or not _group(stamps):
            return {}, set()
        others = [name for name in self._clocks() if _group(name) != _group(stamps)]
        bounded(self._path, "number of arrays of time stamps", len(others), MOST_CLOCKS)
        groups = {name: self._groups[_group(name)] for name in others if not self._same(stamps, name)}
        return groups, {*others, *(name for names in groups.values() for name in names)}

    def _same(self, one: str, other: str) -> bool:
        """True if two arrays begin and end with the same numbers."""
        first, second = self._arrays[one], self._arrays[other]
        count = max(first.shape)
        if max(second.shape) != count:
            return False
        ends = ((0, min(count, BLOCK_ROWS)), (max(count - BLOCK_ROWS, 0), count))
        return all(np.array_equal(first.along(*end), second.along(*end)) for end in ends)

    def _rows(self, stamps: str | None) -> int:
        """Number of rows of the log: the length of its time stamps, else the commonest length of its arrays."""
        if stamps is not None:
            return max(self._arrays[stamps].shape)
        lengths = [max(array.shape) for array in self._arrays.values()]
        return max(set(lengths), key=lambda length: (lengths.count(length), length))

    def _columns(self, name: str, array: NamedArray, labels: Sequence[str]) -> Iterator[tuple[Column, _Place]]:
        axis = next((k for k, length in enumerate(array.shape) if length == self._count), None)
        if axis is None:
            return
        if len(array.shape) == 1 or array.shape[1 - axis] == 1:
            yield Column(name, unit=array.unit), _Place(name, axis, None if len(array.shape) == 1 else 0)
            return
        many = array.shape[1 - axis]
        bounded(self._path, f"number of columns of {name}", many, MOST_COLUMNS)
        for k in range(many):
            joint = labels[k] if len(labels) == many else ""
            yield Column(f"{name}[{k}]", name if joint else "", joint, array.unit), _Place(name, axis, k)

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        self.taken_off = {}
        places = [self._places[name] for name in names]
        for first in range(0, self._count, BLOCK_ROWS):
            last = min(first + BLOCK_ROWS, self._count)
            parts = {place.array: self._arrays[place.array].rows(first, last, place.axis) for place in places}
            yield [self._column(name, parts[place.array], place) for name, place in zip(names, places, strict=True)]

    def _column(self, name: str, part: Floats, place: _Place) -> Floats:
        values = part if place.index is None else part[:, place.index]
        return whole_numbers(name, values, self.taken_off) if values.dtype.kind in "iu" else np.asarray(values, dtype=float)
