"""Detection of impossible sensor readings: a few rows far from those on either side, which agree with each other.

A position that is off for a row or two, a turn of the encoder or a word that was lost, has more energy than a vibration of a thousandth of
its size over the whole log. Inertia keeps a position, a velocity and a current behind its inductance from leaving and coming back
within a few rows by many times what they change by from row to row nearby; a step does not come back, and a fast vibration changes by as
much in other rows. A command may be anything, and is not judged.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..system.linear.arrays import Booleans, Floats
from .record import Record

MEASURED = ("motor_position", "link_position", "motor_velocity", "link_velocity", "actual_torque", "joint_torque", "current")
"""Signals that a sensor measures."""
POSITIONS = ("motor_position", "link_position")
TORQUES = ("actual_torque", "joint_torque", "current")
COMMANDED = ("target_torque", "demand_torque")
"""Channels of which a pulse makes a pulse of a torque."""
LONGEST = 5  # rows of one outlier
FAR = 5.0  # times the changes from row to row nearby, and the encoder's step; white Gaussian noise has less in 10⁹ rows
FAR_AT_END = 20.0  # likewise in the first and the last rows, which have neighbours on one side only: a motion that begins there is none
NEARBY = 50  # rows to either side
PASSED_OVER = 12  # of the largest changes there: each outlier makes two, and up to six are near each other
MOST = 0.02  # share of the rows, beyond LEAST_MANY of them: more are what this sensor is like
LEAST_MANY = 5
BEYOND = 5.0  # times the size that a torque has in nearly all rows, and the range of its command nearby: a step of the encoder makes pulses
PULSE = 30.0  # likewise of a command, where such rows are asked for
TURN, ALIKE = 2 * np.pi, 0.01  # [rad], and how near to a whole one, relative
MOST_LOOKED_AT = 2000  # rows that may be outliers: more, and the share above is exceeded or nearly


@dataclass(frozen=True)
class Outliers:
    """rows (m,) True where a row was left out; channels: by name, in how many rows its reading was far off.

    turned   channels whose jumps by whole turns were taken off
    """

    rows: Booleans
    channels: Mapping[str, int] = field(default_factory=dict)
    turned: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of rows that were left out."""
        return int(np.count_nonzero(self.rows))


def without_outliers(record: Record, commands: bool = False) -> tuple[Record, Outliers]:
    """Record with outlier rows interpolated: measured values between their neighbours, commands as before; and the outliers.

    commands   commanded torques too, where they have a pulse of a few rows that is many times all others: pulses may be an excitation
    """
    spoilt = {name: _pulses(record, name) for name in COMMANDED if commands and record.has(name)}
    if any(rows.any() for rows in spoilt.values()):
        record, first = _made_of_neighbours(record, spoilt)
        record, more = without_outliers(record)
        return record, Outliers(first.rows | more.rows, {**first.channels, **more.channels}, more.turned)
    found = {name: outlying(values, _ordinary(record, name) if name in TORQUES else None) for name, values in _measured(record).items()}
    record, outliers = _made_of_neighbours(record, found)
    record, turned = _without_turns(record)
    return record, replace(outliers, turned=turned)


def _without_turns(record: Record) -> tuple[Record, tuple[str, ...]]:
    """Record with positions made continuous where a reading jumps by whole turns, as of an encoder counted anew; and their channels.

    No joint turns that fast. A set-point that jumps so beside a position does it for the same reason.
    """
    turned = {}
    for name in (*POSITIONS, "reference"):
        if record.has(name) and (name != "reference" or turned):
            values = record.channels[name]
            change = np.diff(values)
            turns = np.round(change / TURN)
            sudden = np.abs(change) > FAR_AT_END * np.quantile(np.abs(change), 1 - MOST)
            jumps = (turns != 0) & (np.abs(change - turns * TURN) < ALIKE * TURN) & sudden
            if jumps.any():
                turned[name] = values - np.concatenate([[0.0], np.cumsum(np.where(jumps, turns * TURN, 0.0))])
    return (replace(record, channels={**record.channels, **turned}) if turned else record), tuple(turned)


def _made_of_neighbours(record: Record, found: Mapping[str, Booleans]) -> tuple[Record, Outliers]:
    """Record in which the rows (m,) `found` by channel are interpolated; unchanged if they are too many to be outliers."""
    found = {name: rows for name, rows in found.items() if rows.any()}
    if not found:
        return record, Outliers(np.zeros(len(record.time), dtype=bool))
    bad = np.any([*found.values()], axis=0)
    if bad.mean() > MOST and np.count_nonzero(bad) > LEAST_MANY:
        return record, Outliers(np.zeros(len(record.time), dtype=bool))
    good = np.flatnonzero(~bad)
    before = good[np.maximum(np.searchsorted(good, np.flatnonzero(bad)) - 1, 0)]
    channels = {}
    for name, values in record.channels.items():
        channels[name] = values.copy()
        channels[name][bad] = np.interp(record.time[bad], record.time[good], values[good]) if name in MEASURED else values[before]
    return Record(record.time, channels, record.sample_time), Outliers(bad, {name: int(rows.sum()) for name, rows in found.items()})


def outliers_text(found: Outliers, time: Floats) -> list[str]:
    """Note on rows that were left out; [] if there are none. `time` (m,) of the record [s]."""
    turned = [f"{' and '.join(found.turned)} jumps by whole turns and goes on without them"] if found.turned else []
    if not found.count:
        return turned
    rows = np.flatnonzero(found.rows)
    at = ", ".join(f"{value:.6g}" for value in time[rows][:LEAST_MANY]) + (", …" if len(rows) > LEAST_MANY else "")
    many = "1 row was left out: its reading" if found.count == 1 else f"{found.count} rows were left out: their readings"
    return [f"{many} of {' and '.join(found.channels)} cannot be beside those of the rows before and behind (outliers, at {at} s)", *turned]


def _measured(record: Record) -> dict[str, Floats]:
    return {name: record.channels[name] for name in MEASURED if record.has(name)}


def _pulses(record: Record, name: str) -> Booleans:
    """Rows (m,) of a command many times as large as nearly all others, alone or a few together, where the set-point does not jump."""
    values = record.channels[name]
    size = np.abs(values - np.median(values))
    most = float(np.quantile(size, 1 - MOST))
    if most == 0:
        return np.zeros(len(values), dtype=bool)
    jumps = np.zeros(len(values), dtype=bool)
    if record.has("reference"):
        change = np.abs(np.diff(record.channels["reference"], prepend=record.channels["reference"][0]))
        jumps = np.convolve(change > FAR * np.quantile(change, 1 - MOST), np.ones(2 * LONGEST + 1), mode="same") > 0.5
    return outlying(values, (size <= PULSE * most) | jumps)


def _ordinary(record: Record, name: str) -> Booleans:
    """Rows (m,) of a torque that a command may have made, or that are no larger than many others."""
    values = record.channels[name]
    size = np.abs(values - np.median(values))
    most = np.full(len(values), float(np.quantile(size, 1 - MOST)))
    for command in COMMANDED:
        if record.has(command):
            near = sliding_window_view(np.pad(record.channels[command], LONGEST, mode="edge"), 2 * LONGEST + 1)
            most = np.maximum(most, np.ptp(near, axis=1))
    return size <= BEYOND * most


def outlying(values: Floats, excused: Booleans | None = None) -> Booleans:
    """Rows (m,) of `values` that are outliers; rows `excused` (m,) are none."""
    rows = np.zeros(len(values), dtype=bool)
    change = np.abs(np.diff(values))
    digits = 1e-9 * float(np.quantile(np.abs(values), 0.9))
    different = np.unique(values)
    steps = np.diff(different)
    repeats = len(different) <= 0.9 * len(values)
    least = FAR * max(float(steps[steps > digits].min(initial=np.inf)) if repeats else 0.0, digits)
    if len(values) < 4 * LONGEST or not np.isfinite(least):
        return rows
    usual = FAR * np.quantile(change, 0.5)
    for width in range(1, LONGEST + 1):
        off, bridge = _off(values, width)
        far = off > np.maximum(np.maximum(FAR * bridge, usual), least)
        places = np.flatnonzero(far)
        if len(places) > MOST_LOOKED_AT:
            return np.zeros(len(values), dtype=bool)
        for first in (places + 1).tolist():
            if not rows[first - 1 : first + width + 1].any() and off[first - 1] > FAR * _usual_change(change, first, first + width):
                rows[first : first + width] = True
    for part, order in ((values, 1), (values[::-1], -1)):
        rows |= _at_start(part, rows[::order], least)[::order]
    if excused is not None:
        rows &= ~excused
    return rows


def _off(values: Floats, width: int) -> tuple[Floats, Floats]:
    """Least distance of `width` successive rows from the straight line between the two rows around them, and the difference of those two.

    Both are arrays over the place of the first of the two.
    """
    before, behind = values[: -width - 1], values[width + 1 :]
    off = np.full(len(before), np.inf)
    for k in range(1, width + 1):
        share = k / (width + 1)
        off = np.minimum(off, np.abs(values[k : len(values) - width - 1 + k] - (1 - share) * before - share * behind))
    return off, np.abs(behind - before)


def _usual_change(change: Floats, first: int, last: int) -> float:
    """Largest usual change of neighbouring rows around those from `first` to before `last`; the few largest are ignored."""
    near = change[max(first - NEARBY, 0) : last + NEARBY]
    return float(np.partition(near, -PASSED_OVER)[-PASSED_OVER]) if len(near) > PASSED_OVER else float(near.max(initial=0.0))


def _at_start(values: Floats, known: Booleans, least: float) -> Booleans:
    """Mask (m,) of rows at the start that are far from those that follow, which hardly change."""
    rows = np.zeros(len(values), dtype=bool)
    change = np.abs(np.diff(np.where(known, np.nan, values)[: 2 * NEARBY]))
    for width in range(1, LONGEST + 1):
        behind = change[width : width + NEARBY]
        behind = behind[np.isfinite(behind)]
        off = float(np.abs(values[:width] - values[width]).min())
        if len(behind) and not known[: width + 1].any() and off > FAR_AT_END * max(float(behind.max()), least / FAR):
            rows[:width] = True
    return rows
