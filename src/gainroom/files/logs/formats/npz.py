"""numpy's .npz: a zip archive with one array per entry. Arrays of objects are pickles, and are left out: nothing in a file is run.

numpy's own reader makes an array as large as a header announces before it reads; here it is as large as the bytes that are there.
"""

import ast
import contextlib
import math
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import GainroomError, first_of_many, one_line
from ..table import LogFormat, Table, checked_file
from .arrays import ArrayTable, NamedArray
from .text_times import times_in
from .zip_entries import ZipEntries

MAGIC = b"\x93NUMPY"
MOST_HEADER = 10_000
"""Characters: a record of 200 fields has some thousand."""
LABELS = ("joint_names", "dof_names", "names", "joints", "joint_name")


class Npz(LogFormat):
    """Reader of logs in .npz files of numpy.savez."""

    name = ".npz"
    title = "an .npz file"
    endings = (".npz",)

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        size = checked_file(path)
        if not zipfile.is_zipfile(path):
            raise GainroomError(f"{path}: is not an .npz file: a zip archive, as numpy.savez writes it")
        arrays: dict[str, NamedArray] = {}
        labels: tuple[str, ...] = ()
        left = []
        with zipfile.ZipFile(path) as archive:
            entries = ZipEntries(path, archive, size)
            for entry in entries.names:
                name = entry.removesuffix(".npy")
                values = _array(path, name, entries.entry(entry)) if entry.endswith(".npy") else None
                if values is None:
                    left.append(name)
                elif values.dtype.kind in "US" and values.ndim == 1 and name.rsplit("/", 1)[-1] in LABELS:
                    labels = tuple(map(str, values.astype(str).tolist()))
                elif values.dtype.kind == "U" and values.ndim == 1 and (times := times_in(values.tolist())) is not None:
                    arrays[name] = NamedArray.of(times, "s")
                elif values.dtype.kind == "M" and values.ndim == 1:
                    arrays[name] = NamedArray.of(values.astype("M8[ns]").astype(np.int64), "ns")
                elif values.dtype.names:
                    arrays |= {f"{name}.{field}": NamedArray.of(values[field]) for field in values.dtype.names if _is_number(values[field])}
                elif _is_number(values):
                    arrays[name] = NamedArray.of(values)
        table = ArrayTable(path, arrays, time, labels)
        if left:
            table.notes.append(f"entries that are no arrays of numbers: {first_of_many(left)}")
        yield table


def _is_number(values: Any) -> bool:
    return values.dtype.kind in "fiub"


def _array(path: Path, name: str, data: bytes) -> Any:
    """Array of an entry; None if its type is not plain. Raises GainroomError if the entry does not hold all numbers that it announces."""
    if data[: len(MAGIC)] != MAGIC:
        return None
    wide = data[6] > 1
    (length,) = struct.unpack_from("<I" if wide else "<H", data, 8)
    start = (12 if wide else 10) + length
    if length > MOST_HEADER or start > len(data):
        raise GainroomError(f"{path}: array {one_line(name, 60)!r}: its header of {length} bytes must be in it, at most {MOST_HEADER}")
    header = ast.literal_eval(data[start - length : start].decode("latin-1").strip())
    described, shape, fortran = (header[key] for key in ("descr", "shape", "fortran_order"))
    dtype = _type(described)
    if dtype is None:
        return None
    if not isinstance(shape, tuple) or not all(type(each) is int and each >= 0 for each in shape):
        raise GainroomError(f"{path}: array {one_line(name, 60)!r}: shape {one_line(shape, 60)} is none")
    count = math.prod(shape)
    if not dtype.itemsize or count * dtype.itemsize > len(data) - start:
        raise GainroomError(f"{path}: array {one_line(name, 60)!r}: {count} numbers of shape {one_line(shape, 60)} must be in the file")
    return np.frombuffer(data, dtype, count, start).reshape(shape, order="F" if fortran else "C")


def _type(described: object) -> "np.dtype[Any] | None":
    """Type of numbers, texts, dates or records of numbers; None for any other, above all for objects, which are pickles."""
    if isinstance(described, list):
        fields = [each for each in described if isinstance(each, tuple) and len(each) == 2 and isinstance(each[1], str)]
        if len(fields) < len(described) or any(np.dtype(kind).kind not in "fiubUS" for _, kind in fields):
            return None
        return np.dtype(described)  # type: ignore[no-any-return]
    if not isinstance(described, str):
        return None
    dtype = np.dtype(described)
    return dtype if dtype.kind in "fiubUSM" else None
