"""Logs of joints: one row per tick, as CSV, Parquet or MCAP; the file's ending says which.

Columns: `time` [s]; `target_torque`, `demand_torque`, `actual_torque` [N m, joint side]; `motor_position`, `link_position`, `reference`
[rad, joint side]. Any but `time` may be missing. In CSV and Parquet a log of several joints has them once per joint, its name behind an
underscore: `motor_position_l_knee`. In MCAP every joint has its topic, `/l_knee`, with JSON messages of the plain names.

A log is written during the run under a temporary name in its folder and renamed when the run ends, in any way: its rows up to then can be
read. A run that fails before its first row leaves the old file. A number that is not finite ends the log.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..errors import GainroomError
from ..io.atomic import replacement, writing
from ..linear.arrays import Floats
from ..simulation.run_record import LOGGED, REFERENCE_SIGNAL
from .log_formats import READERS, WRITERS, Sink, one_line

Choice = TypeVar("Choice")
ONE_JOINT = "joint"
"""The name of the joint of a log that names none."""


@dataclass(frozen=True)
class Log:
    """The content of a log.

    time          (k,) rising [s]
    signals       (k, n) by name, those of LOGGED that the file has
    joint_names   (n,)
    complete      False where the file ends in the middle of a record, as after a power cut
    """

    time: Floats
    signals: Mapping[str, Floats]
    joint_names: tuple[str, ...]
    complete: bool = True


class LogWriter:
    """Takes the rows of a run, block after block."""

    def __init__(self, path: Path, joint_names: tuple[str, ...], signals: tuple[str, ...], sink: Sink) -> None:
        self.path, self.joint_names, self.signals, self._sink = path, joint_names, signals, sink
        self.rows = 0

    def write(self, columns: Mapping[str, Floats]) -> None:
        """Add rows: `time` (k,) and this log's signals, (k, n) each; others are passed over.

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
    """Open a log for writing; it can be read when the block has ended, however it ends.

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
    make, failure = _by_ending(path, WRITERS), None
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


def read_log(path: Path, columns: Mapping[str, str] | None = None) -> Log:
    """A log of this module, or any CSV, Parquet or JSON-in-MCAP file with such columns.

    columns   what the file calls a column, by this module's name for it, e.g. {"target_torque": "cmd"}

    Raises GainroomError where the file cannot be read, has no time or no signal, or holds numbers that are not finite.
    """
    path = Path(path)
    read = _by_ending(path, READERS)
    try:
        table, complete = read(path)
    except FileNotFoundError as error:
        raise GainroomError(f"{path}: no such file") from error
    except OSError as error:
        raise GainroomError(f"{path}: cannot be read: {one_line(error.strerror or error).lower()}") from error
    for name, given in (columns or {}).items():
        if given not in table:
            raise GainroomError(f"{path}: has no column {given!r} for {name}; it has {', '.join(table)}")
        table[name] = table.pop(given)
    if "time" not in table:
        raise GainroomError(f"{path}: has no column time; it has {', '.join(table)}")
    time = table.pop("time")
    names, signals = _by_joint(path, table)
    for name, values in (("time", time), *signals.items()):
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values.reshape(len(values), -1)).all(axis=1)))
            raise GainroomError(f"{path}: {name} in row {row + 1} is not a finite number")
    if np.any(np.diff(time) <= 0):
        row = int(np.argmax(np.diff(time) <= 0)) + 1
        raise GainroomError(f"{path}: time {time[row]:.9g} s in row {row + 1} must be later than {time[row - 1]:.9g} s before it")
    return Log(time, signals, names, complete)


def _by_joint(path: Path, table: Mapping[str, Floats]) -> tuple[tuple[str, ...], dict[str, Floats]]:
    """Joint names, and each signal (k, n), from columns with or without a joint's name; other columns are left out."""
    found: dict[str, dict[str, Floats]] = {}
    for name, values in table.items():
        for signal in LOGGED:
            if name == signal or name.startswith(f"{signal}_"):
                found.setdefault(name[len(signal) + 1 :], {})[signal] = values
    if not found:
        raise GainroomError(f"{path}: has none of the columns {', '.join(LOGGED)}; it has {', '.join(table) or 'only time'}")
    if any(set(signals) != {REFERENCE_SIGNAL} for signals in found.values()):  # another's "reference_velocity" is no joint
        found = {joint: signals for joint, signals in found.items() if set(signals) != {REFERENCE_SIGNAL}}
    every = set().union(*found.values())
    for joint, signals in found.items():
        if missing := sorted(every - set(signals)):
            raise GainroomError(f"{path}: joint {joint!r} has no {missing[0]}, which other joints have")
    names = tuple(joint or ONE_JOINT for joint in found)
    return names, {signal: np.stack([found[joint][signal] for joint in found], axis=1) for signal in LOGGED if signal in every}


def _by_ending(path: Path, choices: Mapping[str, Choice]) -> Choice:
    if path.suffix.lower() not in choices:
        raise GainroomError(f"{path}: a log must end in {', '.join(choices)}")
    return choices[path.suffix.lower()]
