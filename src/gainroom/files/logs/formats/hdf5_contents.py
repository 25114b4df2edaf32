"""What is in an HDF5 file, read in a process of its own, started by hdf5.py.

The library fails on some damaged files, and takes its process with it. A file may refer to others (external links, raw data in other files,
virtual data sets), and name filters that the library would load code for: such data sets are left out. What a chunk unpacks to is checked
before the library unpacks it, to wherever it ends.

Protocol: lines of JSON. The first answer says what there is; then to every request [name, first, last, axis] the answer is a line with type
and shape, and the numbers.
"""

import json
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import GainroomError, first_of_many, one_line
from ....system.linear.arrays import Floats
from ..table import MOST_COLUMNS, MOST_PIECE, MOST_RATIO, MOST_ROWS, bounded, library

DEFLATE, SHUFFLE, FLETCHER32, LZF = 1, 2, 3, 32000
"""Filters by HDF5's numbers: those whose output is bounded, and that the library has built in."""
DEEPEST = 8
"""Groups within groups."""
MOST_OBJECTS = 10_000
"""Groups and data sets that are looked at."""
MOST_MEMORY = 3 << 30
"""Bytes of the process, addresses that are only reserved among them: some pieces, and the library's own."""
MOST_SECONDS = 600
"""Of processor time: 30 GB are read in that."""
LABELS = ("joint_names", "joints", "names", "joint_name", "dof_names")
"""Of a data set with the names of the columns of others."""


def serve(path: Path) -> None:
    """Answer requests on standard input until it ends."""
    _limit()
    try:
        h5py = library("h5py")
        with h5py.File(path, "r") as file:
            contents = _Contents(h5py, path, path.stat().st_size)
            contents.visit(file, "", 0)
            shapes = {name: [[*rows.shape], unit] for name, (rows, unit) in contents.arrays.items()}
            _say({"arrays": shapes, "labels": contents.labels, "notes": contents.notes})
            for line in sys.stdin:
                name, first, last, axis = json.loads(line)
                part = np.ascontiguousarray(contents.arrays[name][0](first, last, axis))
                _say({"type": part.dtype.str, "shape": part.shape}, part)
    except GainroomError as error:
        _say({"refused": str(error)})
    except Exception as error:  # noqa: BLE001 - said to the parent process, which says it to the user
        _say({"failed": one_line(error, 120) or type(error).__name__})


def _limit() -> None:
    try:
        import resource
    except ImportError:  # Windows has no such bounds
        return
    for kind, most in ((resource.RLIMIT_AS, MOST_MEMORY), (resource.RLIMIT_CPU, MOST_SECONDS), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(kind)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (most, most))


def _say(answer: dict[str, Any], part: Floats | None = None) -> None:
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\n")
    if part is not None:
        sys.stdout.buffer.write(part.data if part.size else b"")
    sys.stdout.buffer.flush()


class _Contents:
    """The data sets of numbers in a file, by path, and the names of joints."""

    def __init__(self, h5py: Any, path: Path, size: int) -> None:
        self._h5py, self._path, self._size = h5py, path, size
        self._seen = 0
        self.arrays: dict[str, tuple[_Rows, str]] = {}
        self.labels: tuple[str, ...] = ()
        self._left: list[str] = []

    @property
    def notes(self) -> list[str]:
        return [f"data sets left out: {first_of_many(self._left)}"] if self._left else []

    def visit(self, group: Any, prefix: str, depth: int) -> None:
        """A group's members. Only hard links: others lead elsewhere, or round in circles."""
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
        self.arrays[path] = (_Rows(self._path, path, data), text)

    def _why_not(self, data: Any) -> str | None:
        """What keeps a data set from being read."""
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
    """Parts of a data set along one axis; its chunks are checked at the first."""

    def __init__(self, path: Path, name: str, data: Any) -> None:
        self._path, self._name, self._data, self._checked = path, name, data, False
        self.shape = data.shape

    def __call__(self, first: int, last: int, axis: int) -> Floats:
        data = self._data
        if not self._checked:
            _check_chunks(self._path, self._name, data)
            self._checked = True
        across = data.shape[1 - axis] if data.ndim == 2 else 1
        bounded(self._path, f"a block of rows of {self._name}:", (last - first) * across * 8, MOST_PIECE, " bytes")
        return data[first:last] if axis == 0 else data[:, first:last].T


def _check_chunks(path: Path, name: str, data: Any) -> None:
    """Refuse chunks that are large, or that unpack to more than a chunk holds."""
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


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
