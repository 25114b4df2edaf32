"""HDF5, through h5py in a process of its own."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ....system.linear.arrays import Floats
from ..table import LogFormat, Table, checked_file, library
from .apart import Apart, apart
from .arrays import ArrayTable, NamedArray

HEADER = b"\x89HDF\r\n\x1a\n"


class Hdf5(LogFormat):
    """HDF5, as h5py, PyTables and MATLAB (`save -v7.3`) write it."""

    title = "an HDF5 file"
    endings = (".h5", ".hdf5", ".hdf", ".he5")

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        library("h5py")
        checked_file(path)
        with apart(path, self.title, "hdf5_contents") as process:
            found = process.about
            arrays = {name: NamedArray(tuple(shape), _rows(process, name), unit) for name, (shape, unit) in found["arrays"].items()}
            table = ArrayTable(path, arrays, time, found["labels"])
            table.notes += found["notes"]
            yield table


def _rows(process: Apart, name: str) -> Any:
    """What reads rows of a data set."""

    def read(first: int, last: int, axis: int) -> Floats:
        return process.numbers(process.ask([name, first, last, axis]))

    return read
