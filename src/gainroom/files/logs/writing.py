"""Writer of a run's log, row by row as CSV, Parquet or MCAP; the file's ending decides.

It is written during the run under a temporary name in its folder and renamed when the run ends, in any way: its rows up to then can be
read. A run that fails before its first row leaves the old file. A number that is not finite ends the log.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...errors import GainroomError
from ...io.atomic import replacement, writing
from ...simulation.run_record import LOGGED
from ...system.linear.arrays import Floats
from .formats import format_of
from .table import Sink


class LogWriter:
    """Log that takes the rows of a run, block after block."""

    def __init__(self, path: Path, joint_names: tuple[str, ...], signals: tuple[str, ...], sink: Sink) -> None:
        self.path, self.joint_names, self.signals, self._sink = path, joint_names, signals, sink
        self.rows = 0

    def write(self, columns: Mapping[str, Floats]) -> None:
        """Adds rows: `time` (k,) and this log's signals, (k, n) each; other columns are ignored.

        Raises GainroomError at the first number that is not finite; the rows before it are written.
        """
        if missing := [name for name in ("time", *self.signals) if name not in columns]:
            raise GainroomError(f"{self.path}: a block of rows has no {missing[0]}")
        time, *tables = (np.asarray(columns[name], dtype=float) for name in ("time", *self.signals))
        good = np.isfinite(time)
        for name, table in zip(self.signals, tables, strict=True):
            if table.shape != (len(time), len(self.joint_names)):
                raise GainroomError(f"{self.path}: {name} of shape {table.shape} must be {(len(time), len(self.joint_names))}")
            good &= np.isfinite(table).all(axis=1)
        end = len(time) if good.all() else int(np.argmin(good))
        with writing(self.path):
            self._sink.rows(time[:end], [table[:end] for table in tables])
        self.rows += end
        if end < len(time):
            wrong = [name for name, table in zip(self.signals, tables, strict=True) if not np.isfinite(table[end]).all()] or ["time"]
            raise GainroomError(f"{self.path}: {wrong[0]} at {time[end]:g} s is not a finite number; the log ends before")


@contextlib.contextmanager
def open_log(path: Path, joint_names: Sequence[str], signals: Sequence[str] = LOGGED) -> Iterator[LogWriter]:
    """Open log for writing; it is readable once the block has ended, however it ends.

    path         ends in .csv, .parquet (needs pyarrow) or .mcap (needs mcap)
    joint_names  (n,)
    signals      which of LOGGED it holds

    An older log at `path` is replaced as a whole, once this one is closed; a block that fails before its first row leaves it alone.

    Raises GainroomError for other endings, for names that are taken twice, and where `path` cannot be written.
    """
    path, names = Path(path), tuple(joint_names)
    if not names or len(set(names)) != len(names) or not all(names):
        raise GainroomError(f"{path}: joint names {', '.join(map(repr, names))} must be one or more, differ, and not be empty")
    if wrong := [signal for signal in signals if signal not in LOGGED]:
        raise GainroomError(f"{path}: signal {wrong[0]!r} must be one of {', '.join(LOGGED)}")
    make, failure = format_of(path, written=True).makes, None
    assert make is not None  # of those that can be written
    with replacement(path) as temporary:
        with writing(path):
            sink = make(temporary)
        try:
            with writing(path):
                sink.begin(names, signals)
            writer = LogWriter(path, names, tuple(signals), sink)
            try:
                yield writer
            except BaseException as error:
                if not writer.rows:
                    raise
                failure = error  # raised again when what was done is in its place
        finally:
            with writing(path):
                sink.close()
    if failure is not None:
        raise failure
