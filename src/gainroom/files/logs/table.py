"""Table that every file format yields: named columns of numbers, block by block; and the limits of file sizes."""

import contextlib
import errno
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from ...errors import GainroomError, one_line
from ...io.run_files import note_read
from ...system.linear.arrays import Floats, Integers

BLOCK_ROWS = 1 << 16
"""Rows per block in memory beside the result: 0.5 MB a column, long enough that numpy and not Python takes the time."""
MOST_ROWS = 10**9
"""Maximum number of rows: 139 hours at 2 kHz. More is a damaged header, or belongs into several files."""
MOST_COLUMNS = 10_000
"""Maximum number of columns. A humanoid's log with every quantity of 50 joints has about 1000."""
MOST_PIECE = 1 << 28
"""Bytes of one piece that a file makes us hold at once, uncompressed: a chunk, a page, a message, an array that cannot be read in parts.
Writers make pieces of 1 kB to 64 MB; this is 256 MiB."""
MOST_RATIO = 1100
"""Maximum ratio of uncompressed to compressed size: deflate, the best of what these formats use on arrays, ends at 1032."""
MOST_WHOLE = 1 << 30
"""Maximum size of a file that can only be read as a whole (JSON, MATLAB 5, .pt) [bytes]."""


@dataclass(frozen=True)
class Column:
    """Column of numbers in a file.

    name    unique, as a user types it
    label   what it is called without its joint, where the file tells them apart; else as `name`
    joint   its joint, where the file says so
    unit    in the file's own words
    commanded   the file says that it is among commands
    """

    name: str
    label: str = ""
    joint: str = ""
    unit: str = ""
    commanded: bool = False

    @property
    def text(self) -> str:
        """Text from which the column's channel is guessed."""
        return self.label or self.name


class Table:
    """Columns of equal length in an open file.

    columns    those that hold numbers
    complete   False once reading has found that the file ends in the middle of something
    notes      what was left out, and why: texts
    share      of the file that reading has passed, 0 where that is not known
    taken_off  by column, what is to be added to what `blocks` gives: of whole numbers that are too long for a float, as time stamps in ns
    """

    def __init__(self) -> None:
        self.columns: Sequence[Column] = ()
        self.complete = True
        self.share = 0.0
        self.notes: list[str] = []
        self.taken_off: dict[str, float] = {}

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        """Columns `names`, (k,) each, block by block; NaN where a number is missing. Every call begins at the first row.

        held   those that keep their value from one time stamp to the next, where a file has columns with time stamps of their own
        """
        raise NotImplementedError


TIME = "time"
MOST_EXACT = 1 << 53
"""Largest integer up to which all integers are floats."""
FULL_SECONDS = 1 << 30
"""Step of the offset that is subtracted from time stamps: about a second in ns, so that the offset is an exact float."""


class Sink(Protocol):
    """Writer of a log file."""

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        """Begins the file: the rows will hold these signals of these joints."""

    def rows(self, time: Floats, signals: Sequence[Floats]) -> None:
        """Adds rows: time (k,) [s], and each signal (k, n)."""

    def close(self) -> None:
        """Finishes the file with the rows that it has."""


class LogFormat:
    """Format of log files. A new one is a file in formats/ with a subclass, and its line in FORMATS.

    name      as help texts list it
    title     as messages call it
    endings   of its files' names, lower case
    """

    name: ClassVar[str]
    title: ClassVar[str]
    endings: ClassVar[tuple[str, ...]]
    makes: ClassVar[type | None] = None
    """Sink of a format that can be written; made from a path."""
    episode: int | None = None
    """Number of the episode that is read, where files of the format hold several; None: the first."""

    def is_of(self, path: Path) -> bool:
        """True if the format is that of a file or a folder by where it lies, whatever its ending says."""
        return False

    def of_episode(self, path: Path, episode: int) -> "LogFormat":
        """Format that reads one episode. Raises GainroomError where the format has none."""
        raise GainroomError(f"{path}: --episode {episode}: {self.title} has no episodes; LeRobot's data sets have")

    def is_guarded(self, path: Path) -> bool:
        """True if a library parses this file: guarded_table.opened_table then calls `table` in a guarded child."""
        return False

    def table(self, path: Path, time: str | None) -> contextlib.AbstractContextManager[Table]:
        """Open table of a file; `time`: the user's name for the column of time stamps. Raises GainroomError, or what its library raises."""
        raise NotImplementedError


@contextlib.contextmanager
def guarded(path: Path, title: str) -> Iterator[None]:
    """Context that turns any error from reading a hostile file into one GainroomError about `path`."""
    try:
        yield
    except GainroomError:
        raise
    except MemoryError as error:
        raise GainroomError(f"{path}: reading it needs more memory than there is; read a part of it with start and end") from error
    except OSError as error:
        reason = f"cannot be read: {error.strerror.lower()}" if error.strerror and error.errno in errno.errorcode else ""
        raise GainroomError(f"{path}: {reason or f'is not {title} that can be read: {one_line(error, 120)}'}") from error
    except Exception as error:
        raise GainroomError(f"{path}: is not {title} that can be read: {one_line(error, 120) or type(error).__name__}") from error


def checked_file(path: Path) -> int:
    """Size of a regular file that is about to be read [bytes]; a FIFO would wait for its writer. Raises GainroomError, OSError."""
    try:
        status = os.stat(path)
    except FileNotFoundError as error:
        raise GainroomError(f"{path}: no such file") from error
    except ValueError as error:
        raise GainroomError(f"{path}: cannot be read: {one_line(error)}") from error
    if not stat.S_ISREG(status.st_mode):
        raise GainroomError(f"{path}: is {'a directory' if stat.S_ISDIR(status.st_mode) else 'not a regular file'}")
    note_read(status, path)
    if status.st_size == 0:
        raise GainroomError(f"{path}: is empty")
    return status.st_size


def bounded(path: Path, what: str, value: float, most: float, unit: str = "") -> None:
    """Refuses a size that a file announces beyond a bound."""
    if value > most:
        raise GainroomError(f"{path}: {what} {value:.15g}{unit} must be at most {most:.15g}{unit}")


def whole_file(path: Path) -> bytes:
    """Content of a file of a format that must be read at once. Raises GainroomError."""
    bounded(path, "size", checked_file(path), MOST_WHOLE, " bytes")
    return path.read_bytes()


def whole_numbers(name: str, values: Integers, taken_off: dict[str, float]) -> Floats:
    """Column of integers as floats; if they are too long for that, less the first of them, which is noted in `taken_off`."""
    if name not in taken_off and len(values) and abs(int(values[0])) > MOST_EXACT:
        taken_off[name] = float(values[0] // FULL_SECONDS * FULL_SECONDS)
    if name in taken_off:
        values = values - values.dtype.type(int(taken_off[name]))
    return np.asarray(values, dtype=float)


def library(name: str, *modules: str) -> Any:
    """Optional library with its modules. Raises GainroomError if it is not installed."""
    from importlib import import_module

    try:
        for module in modules:
            import_module(module)
        return import_module(name)
    except ImportError as error:
        raise GainroomError(f"this kind of log needs {name}: pip install 'gainroom[logs]'") from error


def column_names(joints: Sequence[str], signals: Sequence[str]) -> list[str]:
    """Column names: `time`, then signal by signal; with several joints each with its joint's name."""
    return ["time", *(signal if len(joints) == 1 else f"{signal}_{joint}" for signal in signals for joint in joints)]
