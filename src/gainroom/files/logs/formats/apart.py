"""A file that is read in a process of its own, seen from ours: what its library does to itself with a damaged file is done there.

The other process runs a module that ends in `serve` (served.py says the protocol); it is gone when the block ends.
"""

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
from ..table import MOST_PIECE, bounded

MOST_LINE = 1 << 25
"""Characters of an answer: the names of 10,000 columns."""


class Apart:
    """The other process; `about` is its first answer: what the file holds."""

    def __init__(self, path: Path, title: str, process: "subprocess.Popen[bytes]") -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._path, self._title, self._in, self._out = path, title, process.stdin, process.stdout
        self.about = self._answer()

    def ask(self, request: object) -> dict[str, Any]:
        """The answer to a request. Raises GainroomError for a refusal, and where the other process has come to its end."""
        with contextlib.suppress(BrokenPipeError):  # the answer says why
            self._in.write(json.dumps(request).encode() + b"\n")
            self._in.flush()
        return self._answer()

    def numbers(self, answer: dict[str, Any]) -> Floats:
        """The array behind an answer. Raises GainroomError."""
        dtype, shape = np.dtype(answer["type"]), tuple(answer["shape"])
        size = dtype.itemsize * int(np.prod(shape))
        bounded(self._path, "a block of rows:", size, MOST_PIECE, " bytes")
        data = self._out.read(size)
        if len(data) < size:
            raise self._damaged()
        return np.frombuffer(data, dtype).reshape(shape)

    def _answer(self) -> dict[str, Any]:
        line = self._out.readline(MOST_LINE)
        if not line.endswith(b"\n"):
            raise self._damaged()
        said = json.loads(line)
        if "refused" in said:
            raise GainroomError(said["refused"].replace(str(self._path.resolve()), str(self._path), 1))
        if "failed" in said:
            raise GainroomError(f"{self._path}: is not {self._title} that can be read: {said['failed']}")
        return said

    def _damaged(self) -> GainroomError:
        return GainroomError(f"{self._path}: is damaged: the library for {self._title} fails on it")


@contextlib.contextmanager
def apart(path: Path, title: str, module: str) -> Iterator[Apart]:
    """A process that reads `path` by `module`, a module beside this one.

    Without the folder we are in among its paths for modules (-P), out of reach of Ctrl-C, and gone when the block ends.
    """
    paths = os.pathsep.join(folder for folder in sys.path if folder)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", f"{__name__.rpartition('.')[0]}.{module}", str(path.resolve())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        start_new_session=True,
    )
    try:
        yield Apart(path, title, process)
    finally:
        process.kill()
        with contextlib.suppress(OSError):
            process.communicate()
