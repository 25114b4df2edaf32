"""Foreign files, read by their libraries in a guarded child: a process of its own, which is all that a damaged or hostile file can end.

A library that aborts, loops for ever or asks for more memory than there is leaves one line about the file. The child may take no more
memory and processor time than said here, cannot write files and has no network, where the system offers such bounds; the parent kills
it when an answer takes too long, everywhere. A module that is read this way has a function `opened` (see Opened), and imports little: a
start costs what it imports.

Protocol: a request is a line of JSON. An answer is one too, with the bytes of an array behind it where the line has its type and shape.
The first answer comes unasked. A refusal, or the library's failure, is an answer, and the last one.
"""

import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import GainroomError, one_line
from .run_files import at_last, files_read, note_file

MOST_MEMORY = 3 << 30
"""Bytes of the child, addresses that are only reserved among them: some pieces of a file, and the libraries' own."""
LEAST_SECONDS = 60.0
"""Until an answer, of a file of any size: 50 times what a start and the largest model that was seen take on a loaded machine."""
SECONDS_PER_BYTE = 1e-6
"""Added to that: an answer may need the whole file, and the slowest format, JSON in MCAP, is read at 10 MB/s."""
LOOKS = 10
"""Answers whose time the processor may take in all; beyond, a child ends itself that nobody waits for any more."""
MOST_LINE = 1 << 26
"""Characters of an answer: 10,000 names of columns, or a model of 2000 bodies with 1000 postures."""
MOST_ARRAY = 1 << 28
"""Bytes of an array behind an answer."""
BEGINNING = f"import sys; sys.path = [folder for folder in sys.path if folder]; from {__name__} import serve; serve()"
"""The child's program. Python puts "" first, the folder that we are in: a file there must not pass for a module."""
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
"""linux/sched.h."""

Array = NDArray[Any]
Answer = tuple[dict[str, Any], Array | None]
Handler = Callable[[Any], Answer]
"""From a request to its answer."""
Opened = AbstractContextManager[tuple[dict[str, Any], Handler]]
"""Content of a file, and the handler of requests about it, as a module's `opened(path, *arguments)` gives them; arguments are text."""


class GuardedChild:
    """Handle of the parent to the child; the parent may do other work until it asks for the first answer."""

    def __init__(self, path: Path, title: str, seconds: float, process: "subprocess.Popen[bytes]") -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._path, self._title, self._seconds, self._process = path, title, seconds, process
        self._in, self._out = process.stdin, process.stdout
        self._late = False

    @cached_property
    def about(self) -> dict[str, Any]:
        """The first answer: what the file holds. Waits until the child has started; raises GainroomError as `ask`."""
        return self._answered(None)[0]

    def ask(self, request: object) -> Answer:
        """The answer to a request. Raises GainroomError for a refusal, for one that takes too long, and where the child has ended."""
        assert self.about is not None  # comes first
        return self._answered(json.dumps(request).encode() + b"\n")

    def _answered(self, request: bytes | None) -> Answer:
        clock = threading.Timer(self._seconds, self._stop)
        clock.daemon = True
        clock.start()
        try:
            if request is not None:
                with contextlib.suppress(BrokenPipeError):  # the answer says why
                    self._in.write(request)
                    self._in.flush()
            return self._answer()
        finally:
            clock.cancel()

    def _answer(self) -> Answer:
        line = self._out.readline(MOST_LINE)
        if not line.endswith(b"\n"):
            raise self._ended()
        answer = json.loads(line)
        for device, number, name in answer.pop("read", ()):
            note_file(device, number, name)
        if "refused" in answer:
            raise GainroomError(*answer["refused"])
        if "failed" in answer:
            raise GainroomError(f"{self._path}: is not {self._title} that can be read: {answer['failed']}")
        return answer, self._array(np.dtype(answer.pop("type")), tuple(answer.pop("shape"))) if "shape" in answer else None

    def _array(self, dtype: "np.dtype[Any]", shape: tuple[int, ...]) -> Array:
        size = dtype.itemsize * int(np.prod(shape))
        data = self._out.read(size) if 0 <= size <= MOST_ARRAY else b""
        if len(data) < size:
            raise self._ended()
        return np.frombuffer(data, dtype).reshape(shape)

    def _stop(self) -> None:
        self._late = True
        self._process.kill()

    def _ended(self) -> GainroomError:
        """Error that says why there is no answer."""
        self._process.kill()
        late = self._process.wait() == -getattr(signal, "SIGXCPU", 0) or self._late
        if late:
            return GainroomError(f"{self._path}: is not {self._title} that can be read in {self._seconds:.0f} s")
        return GainroomError(f"{self._path}: is damaged: the library for {self._title} fails on it")


@contextlib.contextmanager
def guarded_child(path: Path, title: str, module: str, *arguments: str) -> Iterator[GuardedChild]:
    """A child that reads `path`, called `title` in messages, by `opened(path, *arguments)` of the package's module of this name.

    Without the folder we are in among its paths for modules, out of reach of Ctrl-C, and gone when the block ends, or this process.
    Raises GainroomError.
    """
    process = subprocess.Popen(
        [sys.executable, "-c", BEGINNING, module, str(path), *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder),
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        },
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # the same on Windows
    )
    with at_last(process.kill):
        try:
            yield GuardedChild(path, title, _seconds(path), process)
        finally:
            process.kill()
            with contextlib.suppress(OSError):
                process.communicate()


def _seconds(path: Path) -> float:
    """Time limit [s] for an answer about a file, or about the files of a folder; it grows with their size."""
    with contextlib.suppress(OSError):
        files = path.iterdir() if path.is_dir() else (path,)
        return LEAST_SECONDS + SECONDS_PER_BYTE * sum(file.stat().st_size for file in files)
    return LEAST_SECONDS


def serve() -> None:
    """Read a file as the child, by the module and the arguments of its command line, and answer requests until there are no more."""
    module, path, *arguments = sys.argv[1:]
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _limit(LOOKS * _seconds(Path(path)))

    def say(answer: dict[str, Any], array: Array | None = None) -> None:
        read = [[*place, name] for place, name in files_read().items()]
        if array is not None:
            array = np.ascontiguousarray(array)
            answer = {**answer, "type": array.dtype.str, "shape": array.shape}
        answers.write(json.dumps({**answer, "read": read}).encode() + b"\n")
        if array is not None and array.size:
            answers.write(array.data)
        answers.flush()

    try:
        with importlib.import_module(module).opened(Path(path), *arguments) as (about, handler):
            say(about)
            for line in sys.stdin.buffer:
                say(*handler(json.loads(line)))
    except GainroomError as error:
        say({"refused": error.problems})
    except MemoryError:
        say({"refused": [f"{path}: reading it takes more than {MOST_MEMORY >> 30} GiB of memory"]})
    except Exception as error:  # noqa: BLE001 - said to the parent, which says it to the user
        say({"failed": one_line(error, 120) or type(error).__name__})


def _limit(seconds: float) -> None:
    """Limits time, memory, files and network of this process: all on Linux, not memory and network on macOS, none on Windows."""
    try:
        import ctypes
        import resource
    except ImportError:
        return
    limits = {resource.RLIMIT_AS: MOST_MEMORY, resource.RLIMIT_CPU: int(seconds), resource.RLIMIT_CORE: 0, resource.RLIMIT_FSIZE: 0}
    for kind, most in limits.items():
        hard = resource.getrlimit(kind)[1]
        with contextlib.suppress(ValueError, OSError):  # macOS refuses some
            resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    if sys.platform == "linux":
        # A network of its own has no way out. Only a user space of its own may make one, except for root. Files stay readable as before.
        ctypes.CDLL(None).unshare(CLONE_NEWNET if os.geteuid() == 0 else CLONE_NEWUSER | CLONE_NEWNET)
