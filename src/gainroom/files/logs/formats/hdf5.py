"""HDF5, through h5py.

The library fails on some damaged files, and takes its process with it: a guarded child reads. A file may refer to others (external links,
raw data in other files, virtual data sets), and name filters that the library would load code for: such data sets are left out. What a
chunk unpacks to is checked before the library unpacks it, to wherever it ends.
"""

import contextlib
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import GainroomError, first_of_many
from ....system.linear.arrays import Floats
from ..table import MOST_COLUMNS, MOST_PIECE, MOST_RATIO, MOST_ROWS, LogFormat, Table, bounded, checked_file, library
from .arrays import ArrayTable, NamedArray

HEADER = b"\x89HDF\r\n\x1a\n"
DEFLATE, SHUFFLE, FLETCHER32, LZF = 1, 2, 3, 32000
"""Filters by HDF5's numbers: those whose output is bounded, and that the library has built in."""
DEEPEST = 8
"""Groups within groups."""
MOST_OBJECTS = 10_000
"""Groups and data sets that are looked at."""
LABELS = ("joint_names", "joints", "names", "joint_name", "dof_names")
"""Of a data set with the names of the columns of others."""


class Hdf5(LogFormat):
    """Reader of logs in HDF5, as h5py, PyTables and MATLAB (`save -v7.3`) write it."""

    name = "HDF5"
    title = "an HDF5 file"
    endings = (".h5", ".hdf5", ".hdf", ".he5")

    def is_guarded(self, path: Path) -> bool:
        return True

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        h5py = library("h5py")
        size = checked_file(path)
        with h5py.File(path, "r") as file:
            contents = _Contents(h5py, path, size)
            contents.visit(file, "", 0)
            table = ArrayTable(path, contents.arrays, time, contents.labels)
            table.notes += contents.notes
            yield table


class _Contents:
    """Data sets of numbers in a file, by path, and joint names that it holds."""

    def __init__(self, h5py: Any, path: Path, size: int) -> None:
        self._h5py, self._path, self._size = h5py, path, size
        self._seen = 0
        self.arrays: dict[str, NamedArray] = {}
        self.labels: tuple[str, ...] = ()
        self._left: list[str] = []

    @property
    def notes(self) -> list[str]:
        return [f"data sets left out: {first_of_many(self._left)}"] if self._left else []

    def visit(self, group: Any, prefix: str, depth: int) -> None:
        """Collects the members of a group by hard links only: soft and external links lead elsewhere, or in circles."""
        for name in group:
            self._seen += 1
            bounded(self._path, "number of objects", self._seen, MOST_OBJECTS)
            path = f"{prefix}{name}"
            if name.startswith("#"):
                continue  # MATLAB's own bookkeeping
            if not isinstance(group.get(name, getlink=True), self._h5py.HardLink):
                self._left.append(f"{path} (a link)")
                continue
            entry = group[name]
            if isinstance(entry, self._h5py.Group):
                if depth < DEEPEST:
                    self.visit(entry, f"{path}/", depth + 1)
            elif isinstance(entry, self._h5py.Dataset):
                self._take(path, entry)

    def _take(self, path: str, data: Any) -> None:
        if data.dtype.kind in "OS" and path.rsplit("/", 1)[-1] in LABELS and data.ndim == 1 and data.shape[0] <= MOST_COLUMNS:
            if self._why_not(data) is None:
                self.labels = tuple(str(each) for each in data.asstr(errors="replace")[:])
            return
        if data.dtype.kind not in "fiub" or data.ndim not in (1, 2) or not data.size:
            return
        why = self._why_not(data)
        if why is not None:
            self._left.append(f"{path} ({why})")
            return
        bounded(self._path, f"number of rows of {path}:", max(data.shape), MOST_ROWS)
        unit = data.attrs.get("units", data.attrs.get("unit", ""))
        text = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit if isinstance(unit, str) else ""
        self.arrays[path] = NamedArray(data.shape, _Rows(self._path, path, data), text)

    def _why_not(self, data: Any) -> str | None:
        """Reason why a data set is not read; None if it is."""
        plist = data.id.get_create_plist()
        if data.is_virtual or plist.get_external_count():
            return "its numbers are in another file"
        filters = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
        if set(filters) - {DEFLATE, SHUFFLE, FLETCHER32, LZF}:
            return f"filter {next(each for each in filters if each not in (DEFLATE, SHUFFLE, FLETCHER32, LZF))} is not read"
        packers = [each for each in filters if each in (DEFLATE, LZF)]
        if len(packers) > 1 or (packers and set(filters[filters.index(packers[0]) + 1 :]) - {FLETCHER32}):
            return "packed more than once"
        bounded(
            self._path, f"size of {data.name}:", data.size * data.dtype.itemsize, self._size * MOST_RATIO, " bytes in a file of this size"
        )
        return None


class _Rows:
    """Rows of a data set along one axis; the sizes of its chunks are checked at the first access."""

    def __init__(self, path: Path, name: str, data: Any) -> None:
        self._path, self._name, self._data, self._checked = path, name, data, False

    def __call__(self, first: int, last: int, axis: int) -> Floats:
        data = self._data
        if not self._checked:
            _check_chunks(self._path, self._name, data)
            self._checked = True
        across = data.shape[1 - axis] if data.ndim == 2 else 1
        bounded(self._path, f"a block of rows of {self._name}:", (last - first) * across * 8, MOST_PIECE, " bytes")
        return data[first:last] if axis == 0 else data[:, first:last].T


def _check_chunks(path: Path, name: str, data: Any) -> None:
    """Raises GainroomError if a chunk of a data set is too large, or unpacks to more than a chunk holds."""
    if data.chunks is None:
        return
    whole = int(np.prod(data.chunks, dtype=float)) * data.dtype.itemsize
    bounded(path, f"chunk of {name}:", whole, MOST_PIECE, " bytes")
    filters = data.id.get_create_plist()
    deflated = any(filters.get_filter(k)[0] == DEFLATE for k in range(filters.get_nfilters()))

    def check(chunk: Any) -> None:
        bounded(path, f"packed chunk of {name}:", chunk.size, 2 * whole + 1024, " bytes")  # no filter makes it that much larger
        if deflated and chunk.size * MOST_RATIO > MOST_PIECE:
            mask, packed = data.id.read_direct_chunk(chunk.chunk_offset)
            if mask == 0 and len(zlib.decompressobj().decompress(packed, whole + 1)) > whole:
                raise GainroomError(f"{path}: a chunk of {name} unpacks to more than the {whole} bytes that it holds")

    if data.id.get_num_chunks():
        data.id.chunk_iter(check)
