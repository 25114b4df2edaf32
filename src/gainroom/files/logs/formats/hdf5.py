"""HDF5, through h5py in a process of its own: what the library does to itself with a damaged file is done there."""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import GainroomError
from ....system.linear.arrays import Floats
from ..table import MOST_PIECE, LogFormat, Table, bounded, checked_file, library
from .arrays import ArrayTable, NamedArray

HEADER = b"\x89HDF\r\n\x1a\n"
CONTENTS = f"{__name__.rpartition('.')[0]}.hdf5_contents"
MOST_LINE = 1 << 25
"""Characters of an answer: the names of 10,000 data sets."""


class Hdf5(LogFormat):
    """HDF5, as h5py, PyTables and MATLAB (`save -v7.3`) write it."""

    title = "an HDF5 file"
    endings = (".h5", ".hdf5", ".hdf", ".he5")

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        library("h5py")
        checked_file(path)
        with _process(path) as process:
            server = _Server(path, process)
            found = server.answer()
            arrays = {name: NamedArray(tuple(shape), server.rows(name), unit) for name, (shape, unit) in found["arrays"].items()}
            table = ArrayTable(path, arrays, time, found["labels"])
            table.notes += found["notes"]
            yield table


@contextlib.contextmanager
def _process(path: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """Without the folder we are in among its paths for modules (-P), out of reach of Ctrl-C, and gone when the block ends."""
    paths = os.pathsep.join(folder for folder in sys.path if folder)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", CONTENTS, str(path.resolve())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.kill()
        with contextlib.suppress(OSError):
            process.communicate()


class _Server:
    """The other process."""

    def __init__(self, path: Path, process: "subprocess.Popen[bytes]") -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._path, self._in, self._out = path, process.stdin, process.stdout

    def answer(self) -> dict[str, Any]:
        """The next one. Raises GainroomError for a refusal, and where the other process has come to its end."""
        line = self._out.readline(MOST_LINE)
        if not line.endswith(b"\n"):
            raise GainroomError(f"{self._path}: is damaged: the HDF5 library fails on it")
        said = json.loads(line)
        if "refused" in said:
            raise GainroomError(said["refused"].replace(str(self._path.resolve()), str(self._path), 1))
        if "failed" in said:
            raise GainroomError(f"{self._path}: is not an HDF5 file that can be read: {said['failed']}")
        return said

    def rows(self, name: str) -> Any:
        """What reads rows of a data set."""

        def read(first: int, last: int, axis: int) -> Floats:
            with contextlib.suppress(BrokenPipeError):  # the answer says why
                self._in.write(json.dumps([name, first, last, axis]).encode() + b"\n")
                self._in.flush()
            said = self.answer()
            dtype, shape = np.dtype(said["type"]), tuple(said["shape"])
            size = dtype.itemsize * int(np.prod(shape))
            bounded(self._path, f"a block of rows of {name}:", size, MOST_PIECE, " bytes")
            data = self._out.read(size)
            if len(data) < size:
                raise GainroomError(f"{self._path}: is damaged: the HDF5 library fails on it")
            return np.frombuffer(data, dtype).reshape(shape)

        return read
