"""Reader of a log from a file: block by block within bounded memory, or as a whole."""

import contextlib
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import GainroomError, first_of_many, listed, named
from ...identification.excited_part import MostExcited
from ...identification.outliers import Outliers, outliers_text, without_outliers
from ...identification.record import Record
from ...io.validation import LARGEST
from ...studies.progress import Progress, quiet
from ...system.linear.arrays import Floats
from .abilities import TORQUES
from .channels import CHANNELS
from .cleaning import Cleaner, ahead
from .formats import format_of
from .formats.guarded_table import opened_table
from .mapping import map_columns
from .options import LogOptions
from .record import JointLog, Log, Origin, Quality
from .table import TIME, Table, bounded, guarded
from .units import SI, UNITS, UNKNOWN, unit_choices

MOST_BYTES = 1 << 31
"""Maximum size of a log that is read as a whole: 2 GiB are 4 h of 8 channels at 2 kHz. Longer ones are read in blocks or in part."""
EPOCH = 1e6
"""Age of a first stamp [s] from which on stamps count from an epoch, 11 days; such a log is shifted to begin at 0, with all digits."""
RATES = (9.0, 2e5)
"""Range of the sample rate [Hz] by which the unit of time stamps without one is decided."""
MOST_FILLED = 0.12
"""Maximum share of ticks without a row.

Intervals of simulated logs held the truth with a tenth missing; with a fifth, that of the delay did not.
"""
LONGEST = 1e9
"""Longest duration [s], 31 years: larger time stamps are something else."""


class LogReader:
    """Open log.

    origins       where time and each channel come from
    joint_names   in the file's order
    unused        columns that are no channel's
    """

    def __init__(self, path: Path, options: LogOptions, table: Table, title: str, progress: Progress = quiet) -> None:
        self.path, self._options, self._table, self._title, self._progress = path, options, table, title, progress
        with guarded(path, title):
            mapped = map_columns(table.columns, options, path, table.notes)
            self._time, origins, notes = mapped.time, mapped.origins, [*mapped.notes]
            with contextlib.closing(self._parts(origins)) as parts:
                time, columns = next(parts, (None, []))
        empty = {origin.column for origin, values in zip(origins, columns, strict=False) if len(values) and not np.isfinite(values).any()}
        if empty and len(empty) == len(origins):
            raise GainroomError(f"{path}: {first_of_many(sorted(empty))}: no number in the first {len(columns[0])} rows")
        if empty:
            notes.append(f"columns without a number in the first {len(columns[0])} rows: {first_of_many(sorted(empty))}")
            origins = tuple(origin for origin in origins if origin.column not in empty)
        if self._time is not None and self._time.unit_from == "assumed" and time is not None:
            unit, source = guessed_time_unit(time)
            self._time = replace(self._time, unit=unit, unit_from=source, factor=UNITS["time"][unit])
        self._channels, self._own_notes, self.unused = origins, notes, mapped.unused
        self.origins: tuple[Origin, ...] = tuple(o for o in (self._time, *origins) if o is not None)
        self.joint_names = tuple(dict.fromkeys(origin.joint for origin in origins))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes about what was left out of the part read so far, with the reasons."""
        return (*self._own_notes, *self._table.notes)

    def blocks(self) -> Iterator[Log]:
        """Good rows in order, a few ten thousand at a time; each block has quality and completeness up to its end.

        The last block is empty. Raises GainroomError where the file cannot be read, or too little of it is left to be a log.
        """
        options, channels = self._options, self._channels
        cleaner = Cleaner(self.path, [origin.column for origin in channels])
        stamps: _Stamps | None = None
        latest = 0.0
        with guarded(self.path, self._title), contextlib.closing(self._parts(channels)) as parts:
            for time, columns in parts:
                stamps = stamps or _Stamps.of(self._time, time, options.sample_rate, self._table.taken_off)
                seconds = stamps.seconds(time, len(columns[0]))
                scaled = [self._scaled(values, origin) for values, origin in zip(columns, channels, strict=True)]
                begin = stamps.first + (options.start or 0.0)
                end = np.inf if options.end is None else stamps.first + options.end
                latest = float(np.max(seconds, initial=0.0, where=np.isfinite(seconds))) - stamps.first
                over = bool(np.min(seconds, initial=np.inf, where=np.isfinite(seconds)) > end)
                self._progress(round(1000 * self._table.share), 1000 if self._table.share else 0, f"reading {self.path.name}")
                kept, scaled = cleaner.clean(seconds, scaled, (begin, end))
                if len(kept):
                    bounded(self.path, "time between first and last row:", kept[-1] - stamps.first, LONGEST, " s")
                    yield self._log(kept, scaled, cleaner.quality, stamps.began)
                if over:
                    break
        if stamps is None:
            raise GainroomError(f"{self.path}: has no row: its columns are named, and nothing stands below")
        if not cleaner.quality.rows:
            raise GainroomError(f"{self.path}: has no row from {options.start or 0:g} s on; its last ones are {latest:g} s after the first")
        cleaner.require_enough()
        yield self._log(np.zeros(0), [np.zeros(0)] * len(channels), cleaner.quality, stamps.began)

    def _parts(self, channels: Sequence[Origin]) -> Generator[tuple[Floats | None, list[Floats]], None, None]:
        """Time stamps and channels as stored in the file."""
        stamped = self._time is not None
        names = [origin.column for origin in ((self._time, *channels) if self._time is not None else channels)]
        held = [origin.column for origin in channels if CHANNELS[origin.channel].commanded]
        for part in self._table.blocks(names, held):
            yield (part[0], part[1:]) if stamped else (None, part)

    def whole(self) -> Log:
        """Log as a whole. Raises GainroomError also if it is larger than MOST_BYTES."""
        time, columns = _Growing(), [_Growing() for _ in self._channels]
        quality, began = Quality(), 0.0
        for part in self.blocks():
            time.add(part.time)
            for column, origin in zip(columns, self._channels, strict=True):
                column.add(part.joints[origin.joint][origin.channel])
            size = 8 * time.count * (1 + len(columns))
            bounded(self.path, "numbers in memory:", size, MOST_BYTES, " bytes; read a part of it with start, end or joints")
            quality, began = part.quality, part.began or began
        return self._log(time.values, [column.values for column in columns], quality, began)

    def most_excited(self) -> Log:
        """Part of a single joint's log with the most excitation, all of a short log; memory does not grow with the file."""
        best, first, last = MostExcited(), 0.0, 0.0
        quality, began = Quality(), 0.0
        for part in self.blocks():
            if len(part.time):
                first, last = (first if best.seen else float(part.time[0])), float(part.time[-1])
                best.add(part.time, part.joints[self.joint_names[0]])
            quality, began = part.quality, part.began or began
        if not best.seen:
            raise GainroomError(f"{self.path}: has no row that can be used")
        time, channels = best.part()
        log = self._log(time, [channels[origin.channel] for origin in self._channels], quality, began)
        if best.seen == len(time):
            return log
        note = f"of {last - first:.4g} s the part from {time[0]:.6g} to {time[-1]:.6g} s is used, in which the command changes most"
        return replace(log, notes=(*log.notes, note))

    def _log(self, time: Floats, columns: list[Floats], quality: Quality, began: float) -> Log:
        joints: dict[str, dict[str, Floats]] = {joint: {} for joint in self.joint_names}
        for origin, values in zip(self._channels, columns, strict=True):
            joints[origin.joint][origin.channel] = values
        return Log(time, joints, self._table.complete, self.origins, quality, began, self.notes)

    def _scaled(self, values: Floats, origin: Origin) -> Floats:
        """Values in SI. Raises GainroomError for values that a joint cannot have: another unit, or damage."""
        scaled = values if origin.factor == 1 else values * origin.factor
        channel = CHANNELS[origin.channel]
        size = np.abs(scaled[np.isfinite(scaled)])
        level = float(np.median(size)) if len(size) else 0.0
        if level > channel.largest or float(np.max(size, initial=0.0)) > LARGEST:
            value, most = (level, channel.largest) if level > channel.largest else (float(np.max(size)), LARGEST)
            unit = SI[channel.dimension]
            raise GainroomError(
                f"{self.path}: column {origin.column!r}: {origin.channel} of {value:.6g} {unit} must be at most {most:g} {unit} in size; "
                f"state the column's unit (it was read as {origin.unit}, which was {origin.unit_from})"
            )
        return scaled


class _Stamps:
    """Conversion of a file's time stamps, or of row numbers, to seconds.

    factor  of the file's unit; of rows without stamps their rate [Hz]
    zero    in the file's unit: what is taken off first, so that no digits are lost
    first   [s] the first row's time
    """

    def __init__(self, factor: float, zero: float, first: float) -> None:
        self._factor, self._zero, self.first = factor, zero, first
        self.began = zero * factor
        self._rows = 0

    @classmethod
    def of(cls, origin: Origin | None, stamps: Floats | None, rate: float | None, taken_off: Mapping[str, float]) -> "_Stamps":
        """Time base of a log with these first stamps; of a log without stamps at a `rate` [Hz]."""
        if origin is None or stamps is None:
            return cls(rate or 1.0, 0.0, 0.0)
        finite = stamps[np.isfinite(stamps)]
        finite = finite[~ahead(finite)]
        raw = float(finite[0]) if len(finite) else 0.0
        first = raw * origin.factor
        made = cls(origin.factor, 0.0, first) if abs(first) <= EPOCH else cls(origin.factor, raw, 0.0)
        made.began += taken_off.get(origin.column, 0.0) * origin.factor
        return made

    def seconds(self, stamps: Floats | None, count: int) -> Floats:
        """Seconds (count,) of the next rows."""
        if stamps is None:
            self._rows += count
            return np.arange(self._rows - count, self._rows) / self._factor
        stamps = stamps if self._zero == 0 else stamps - self._zero
        return stamps if self._factor == 1 else stamps * self._factor


def guessed_time_unit(stamps: Floats) -> tuple[str, str]:
    """Unit of time stamps without one, and the reason: seconds, unless only another unit gives a rate within RATES."""
    finite = stamps[np.isfinite(stamps)]
    steps = np.diff(finite)
    steps = steps[steps > 0]
    if not len(steps):
        return "s", "assumed"
    step = float(np.median(steps))
    if RATES[0] <= 1 / step <= RATES[1]:
        return "s", "assumed"
    for unit in ("ms", "us", "ns"):
        # Whole milliseconds at 5 kHz would repeat: of two units that are possible the larger one is the right one below 10 ms.
        if RATES[0] <= 1 / (step * UNITS["time"][unit]) <= RATES[1]:
            return unit, "values"
    return "s", "assumed"


class _Growing:
    """Column that grows in place: joining pieces at the end would take twice its memory."""

    def __init__(self) -> None:
        self._room, self.count = np.zeros(0), 0

    def add(self, piece: Floats) -> None:
        end = self.count + len(piece)
        if end > len(self._room):
            room = np.empty(max(end, 2 * len(self._room)))  # memory that is not written to is none
            room[: self.count] = self.values
            self._room = room
        self._room[self.count : end] = piece
        self.count = end

    @property
    def values(self) -> Floats:
        return self._room[: self.count]


@contextlib.contextmanager
def log_reader(path: Path, options: LogOptions | None = None, progress: Progress = quiet) -> Iterator[LogReader]:
    """Open log at `path`, for reading with `progress`; the file's ending, or that it is a folder, decides its format.

    Raises GainroomError where it cannot be read, or where no channel is found in it.
    """
    path, options = Path(path), LogOptions() if options is None else options
    form = format_of(path)
    form = form if options.episode is None else form.of_episode(path, options.episode)
    with contextlib.ExitStack() as stack:
        with guarded(path, form.title):
            table = stack.enter_context(opened_table(form, path, options.columns.get(TIME)))
        yield LogReader(path, options, table, form.title, progress)


@dataclass(frozen=True, eq=False)
class LoggedJoint:
    """Joint of a log, prepared for identification.

    log      where it came from, what was cut, notes
    joint    its rows
    record   the same on equal ticks, without outliers
    outliers the rows of `record` that were left out
    """

    path: Path
    log: Log
    joint: JointLog
    record: Record
    outliers: Outliers

    def require_dense(self) -> None:
        """Raises GainroomError if too many ticks of the record were filled in: the arrival of commands is then not known."""
        ticks = len(self.record.time)
        missing = ticks - len(self.joint.time)
        if missing > MOST_FILLED * ticks:
            raise GainroomError(
                f"{missing} of {ticks} ticks are missing between rows; at most {MOST_FILLED:.0%} may: leave out a column that lacks "
                "numbers, or record without dropped frames"
            )


def read_joint(path: Path, options: LogOptions | None = None, progress: Progress = quiet) -> LoggedJoint:
    """Only joint of a log, or the only one that the options choose. Raises GainroomError as read_log, and if there are several."""
    path = Path(path)
    with log_reader(path, options, progress) as reader:
        if len(reader.joint_names) > 1:
            raise GainroomError(
                f"{path}: has {len(reader.joint_names)} joints and one must be chosen, by --joint NAME: {first_of_many(reader.joint_names)}"
            )
        log = reader.most_excited()
    _require_units(log, path)
    unknown = {origin.channel for origin in log.origins if origin.unit == UNKNOWN}
    with named(str(path)):
        joint = log.joint()
        joint = replace(joint, channels={name: values for name, values in joint.channels.items() if name not in unknown})
        constant = _constant_torques(joint)
        if constant:
            notes = [f"{name} is {joint.channels[name][0]:g} N·m throughout and was left out" for name in constant]
            log = replace(log, notes=(*log.notes, *notes))
            joint = replace(joint, channels={name: values for name, values in joint.channels.items() if name not in constant})
        record, outliers = without_outliers(joint.record())
        log = replace(log, notes=(*log.notes, *outliers_text(outliers, record.time)))
        return LoggedJoint(path, log, joint, record, outliers)


def unknown_units(log: Log) -> str:
    """Text on the channels whose unit the file does not say and whose numbers are not SI, with what to type; "" where there is none."""
    unknown = dict.fromkeys(origin.channel for origin in log.origins if origin.unit == UNKNOWN)
    if not unknown:
        return ""
    typed = ",".join(f"{channel}=UNIT" for channel in unknown)
    choices = " or ".join(dict.fromkeys(unit_choices(CHANNELS[channel].dimension) for channel in unknown))
    return f"the unit of {listed([*unknown])} is not said: --units {typed}, where UNIT is {choices}"


def _constant_torques(joint: JointLog) -> list[str]:
    """Constant torques beside one that changes, such as the effort 0 of position commands."""
    torques = [name for name in TORQUES if name in joint.channels]
    constant = [name for name in torques if np.ptp(joint.channels[name]) == 0]
    return constant if len(constant) < len(torques) else []


def read_log(path: Path, columns: Mapping[str, str] | None = None, options: LogOptions | None = None) -> Log:
    """Log as a whole, in SI and on the joint side.

    columns   what the file calls a column, by this package's name for it, e.g. {"target_torque": "cmd"}; LogOptions says the rest

    Raises GainroomError, one line that names the file: where it cannot be read, has no time or no channel, or cannot be a log.
    """
    options = LogOptions() if options is None else options
    if columns:
        options = replace(options, columns={**options.columns, **columns})
    with log_reader(path, options) as reader:
        log = reader.whole()
    _require_units(log, path)
    return log


def _require_units(log: Log, path: Path) -> None:
    """Raise GainroomError where the unit of a channel other than a current is not known."""
    if any(origin.unit == UNKNOWN and origin.channel != "current" for origin in log.origins):
        raise GainroomError(f"{path}: {unknown_units(log)}")
