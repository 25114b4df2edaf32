"""MATLAB's .mat files: version 5 to 7 by the reader below, version 7.3 as the HDF5 it is.

scipy.io reads version 5 too, but believes what a file announces: 184 bytes, a cell array of 2²⁸ entries, make it take 2 GiB and 14 s. Here
nothing is made that the bytes at hand do not fill. Structures become paths (`log.q`); what is not a number is passed over.
Format: MathWorks, MAT-File Format, 2019.
"""

import contextlib
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....errors import GainroomError
from ....system.linear.arrays import Floats
from ..table import MOST_COLUMNS, MOST_RATIO, MOST_WHOLE, LogFormat, Table, bounded, whole_file
from .arrays import ArrayTable, NamedArray
from .hdf5 import HEADER, Hdf5

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Data types of elements (miINT8 …)."""
MATRIX, COMPRESSED = 14, 15
STRUCT = 2
NUMERIC = range(6, 16)
"""Classes of arrays (mxDOUBLE …)."""
COMPLEX = 0x0800
DEEPEST = 8


class Matlab(LogFormat):
    """Reader of logs in MATLAB files, version 5 and later."""

    name = "MATLAB"
    title = "a MATLAB file"
    endings = (".mat",)

    def is_guarded(self, path: Path) -> bool:
        return path.is_file() and _is_hdf5(path)

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        content = whole_file(path) if path.is_file() and not _is_hdf5(path) else b""
        if not content:
            with Hdf5().table(path, time) as table:
                yield table
            return
        yield ArrayTable(path, _Reader(path, content).arrays(), time)


def _is_hdf5(path: Path) -> bool:
    """True if a MATLAB file is HDF5 (version 7.3), which begins behind 512 bytes of MATLAB's own."""
    with open(path, "rb") as file:
        head = file.read(520)
    return HEADER in (head[:8], head[512:])


class _Reader:
    """Reader of version 5: a header of 128 bytes, then elements, each a tag (type and size) and data."""

    def __init__(self, path: Path, content: bytes) -> None:
        if len(content) < 136 or content[126:128] not in (b"IM", b"MI"):
            raise GainroomError(f"{path}: is not a MATLAB file of version 5 or later; save it with -v7 or -v7.3")
        self._path, self._content = path, content
        self._order = "<" if content[126:128] == b"IM" else ">"
        self._found: dict[str, NamedArray] = {}
        self._total = 0

    def arrays(self) -> dict[str, NamedArray]:
        """Arrays of numbers in the file, by name. Raises GainroomError, and for damaged files ValueError and struct.error."""
        for kind, data in self._elements(memoryview(self._content)[128:]):
            if kind == COMPRESSED:
                kind, data = self._unpacked(data)
            if kind == MATRIX:
                self._matrix(data, "", 0)
        return self._found

    def _unpacked(self, data: memoryview) -> tuple[int, memoryview]:
        """Type and data of the element inside a compressed one, no longer than announced. Raises GainroomError if that is too large."""
        unpacker = zlib.decompressobj()
        kind, size = struct.unpack(f"{self._order}II", unpacker.decompress(data, 8))
        bounded(self._path, "unpacked variable:", size, len(data) * MOST_RATIO, " bytes in a file of this size")
        self._total += size
        bounded(self._path, "unpacked variables:", self._total, MOST_WHOLE, " bytes")
        return kind, memoryview(unpacker.decompress(unpacker.unconsumed_tail, size)) if size else memoryview(b"")

    def _elements(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        place = 0
        while place + 8 <= len(data):
            kind, size = struct.unpack_from(f"{self._order}II", data, place)
            if kind >> 16:  # up to four bytes, within the tag
                kind, size = kind & 0xFFFF, kind >> 16
                start, step = place + 4, 8
            else:
                start, step = place + 8, 8 + (size if kind == COMPRESSED else -(-size // 8) * 8)
            if size > (4 if start == place + 4 else len(data) - start):
                raise ValueError(f"an element of {size} bytes goes beyond the end")
            yield kind, data[start : start + size]
            place += step

    def _matrix(self, data: memoryview, prefix: str, depth: int) -> None:
        elements = self._elements(data)
        flags = struct.unpack_from(f"{self._order}I", next(elements)[1])[0]
        shape = tuple(int(each) for each in self._numbers(*next(elements)))
        name = prefix + bytes(next(elements)[1]).decode("utf-8", "replace")
        kind = flags & 0xFF
        if kind == STRUCT and shape == (1, 1):
            self._structure(elements, name, depth)
        elif kind in NUMERIC and not flags & COMPLEX and len(shape) == 2:
            values = self._numbers(*next(elements))
            if min(shape) < 0 or shape[0] * shape[1] != len(values):
                raise ValueError(f"{name} of shape {shape} has {len(values)} numbers")
            bounded(self._path, "number of variables", len(self._found), MOST_COLUMNS)
            self._found[name] = NamedArray.of(values.reshape(shape, order="F"))

    def _structure(self, elements: Iterator[tuple[int, memoryview]], name: str, depth: int) -> None:
        if depth == DEEPEST:
            return
        length = int(self._numbers(*next(elements))[0])
        names = bytes(next(elements)[1])
        if not 0 < length <= 64:
            raise ValueError(f"names of {length} letters in {name}")
        for k, (kind, data) in enumerate(elements):
            field = names[k * length : (k + 1) * length].split(b"\0")[0].decode("utf-8", "replace")
            if kind == MATRIX and field and data:
                self._matrix(data, f"{name}.{field}", depth + 1)

    def _numbers(self, kind: int, data: memoryview) -> Floats:
        if kind not in STORED:
            raise ValueError(f"numbers of type {kind}")
        dtype = np.dtype(self._order + STORED[kind])
        return np.frombuffer(data[: len(data) // dtype.itemsize * dtype.itemsize], dtype)
