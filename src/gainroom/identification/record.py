"""Record of one joint's signals, tick by tick, from which identification starts."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import GainroomError, first_of_many, listed, require_finite, require_positive
from ..simulation.run_record import REFERENCE_SIGNAL
from ..system.linear.arrays import Booleans, Floats, Integers

SIGNALS = {
    "target_torque": "torque that the controller asks for",
    "demand_torque": "torque that has arrived at the drive",
    "actual_torque": "torque that the current loop makes",
    "joint_torque": "torque through the gearbox, from a sensor",
    "motor_position": "position on the motor's side of the gearbox's elasticity",
    "link_position": "position on the link's side of the gearbox's elasticity",
    REFERENCE_SIGNAL: "position set-point",
    "motor_velocity": "velocity on the motor's side",
    "link_velocity": "velocity on the link's side",
    "reference_velocity": "velocity set-point",
    "current": "motor current, torque-producing",
}
"""Signals of a joint in a log: torques [N m], positions [rad], velocities [rad/s] on the joint side, and a current [A]."""
SLOW_TICK = 1.25e-3  # [s] between rows from which on the controller may well run faster than its log
SHORTEST = 50  # ticks: less is not a log


@dataclass(frozen=True)
class Record:
    """Log of one joint on equal ticks.

    time          (m,) rising [s]; gaps are allowed, each a whole number of ticks to half a tick
    channels      (m,) by name, some of SIGNALS; joint side
    sample_time   [s]

    Raises GainroomError for unknown names, wrong shapes, numbers that are not finite, time that does not rise by ticks, too few rows.
    """

    time: Floats
    channels: Mapping[str, Floats]
    sample_time: float

    def __post_init__(self) -> None:
        require_positive("record", "sample_time", self.sample_time, "s")
        time = require_finite("record", "time", self.time)
        if time.ndim != 1 or len(time) < SHORTEST:
            raise GainroomError(f"record: time of shape {time.shape} must be one column of at least {SHORTEST} rows")
        if unknown := [name for name in self.channels if name not in SIGNALS]:
            raise GainroomError(f"record: channel {unknown[0]!r} must be one of {', '.join(SIGNALS)}")
        values = {name: require_finite("record", name, column) for name, column in self.channels.items()}
        for name, column in values.items():
            if column.shape != time.shape:
                raise GainroomError(f"record: {name} of shape {column.shape} must be of the shape of time, {time.shape}")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "channels", values)
        if np.any(np.diff(self.ticks) <= 0):
            row = int(np.argmax(np.diff(self.ticks) <= 0)) + 1
            raise GainroomError(
                f"record: time {time[row]:.9g} s in row {row + 1} must be a tick of {self.sample_time:g} s later than {time[row - 1]:.9g} s"
            )

    @cached_property
    def ticks(self) -> Integers:
        """Tick number (m,) of each row, 0 for the first."""
        return np.rint((self.time - self.time[0]) / self.sample_time).astype(int)

    @cached_property
    def fresh(self) -> Booleans:
        """Rows (m,) at the start and after every gap: True."""
        return np.concatenate([[True], np.diff(self.ticks) != 1])

    @cached_property
    def run_length(self) -> Integers:
        """Number (m,) of rows since the last gap: 0 in the first row after it."""
        rows = np.arange(len(self.time))
        return rows - np.maximum.accumulate(np.where(self.fresh, rows, 0))

    def longest_run(self) -> "Record":
        """Longest part without a gap. Raises GainroomError if it has fewer rows than a log needs."""
        starts = np.append(np.flatnonzero(self.fresh), len(self.time))
        longest = int(np.argmax(np.diff(starts)))
        part = slice(starts[longest], starts[longest + 1])
        return Record(self.time[part], {name: column[part] for name, column in self.channels.items()}, self.sample_time)

    def has(self, *names: str) -> bool:
        """True if all of these channels are in the record."""
        return all(name in self.channels for name in names)

    def need(self, owner: str, *names: str) -> list[Floats]:
        """Channels `names`. Raises GainroomError that names the missing ones."""
        if missing := [name for name in names if name not in self.channels]:
            raise GainroomError(f"{owner}: needs {missing[0]}; the record has {first_of_many(sorted(self.channels)) or 'no channel'}")
        return [self.channels[name] for name in names]

    def first_of(self, owner: str, *names: str) -> str:
        """First of the channels `names` in the record. Raises GainroomError that names them all."""
        if found := [name for name in names if name in self.channels]:
            return found[0]
        there = first_of_many(sorted(self.channels)) or "no channel"
        raise GainroomError(f"{owner}: needs {listed(names, 'or')}; the record has {there}")


def resolution(values: Floats) -> float:
    """Step of a quantised signal (m,): the smallest difference of two of its values, 0 if nothing repeats."""
    different = np.unique(values)
    if len(different) < 2 or len(different) > 0.9 * len(values):
        return 0.0
    steps = np.diff(different)
    return float(steps[steps > 1e-9 * max(abs(different[0]), abs(different[-1]))].min(initial=np.inf))


def slow_rows(sample_time: float, consequence: str, certain: bool = False) -> list[str]:
    """Warning about a log that may be slower than its controller, or is so if `certain`; [] if it is fast enough."""
    slow = certain or sample_time > SLOW_TICK
    return [f"rows come every {1e3 * sample_time:.3g} ms, and {consequence}; log every tick"] if slow else []
