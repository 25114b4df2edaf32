"""Rows of a log put in order as they come: what is not finite, doubled or late is cut and counted, and the clock's evenness measured."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import GainroomError
from ...system.linear.arrays import Floats
from .record import Quality

MOST_MISSING = 0.5
"""Share of rows with a number missing from which on a log is refused: its channels were then hardly ever recorded together."""
MOST_BACKWARDS = 0.2
"""Share of rows that are late, or have a stamp that was there already, from which on a log is refused: threads that log into one file
exchange a few rows; more, and it is another column, two logs in one file, or a clock that is too coarse."""
JUDGED = 20
"""Rows from which on these shares say something."""
GAP = 1.5
"""Ticks between two rows from which on at least one is missing."""


class Cleaner:
    """Takes blocks of rows, gives back those that are good, and counts.

    names   of the columns beside time, for messages and counts
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._path, self._names = path, names
        self._rows = self._not_finite = self._duplicate = self._backwards = 0
        self._missing = np.zeros(len(names) + 1, dtype=int)
        self._latest = -np.inf
        self._clock = _Clock()

    def clean(self, time: Floats, columns: Sequence[Floats], window: tuple[float, float]) -> tuple[Floats, list[Floats]]:
        """The rows within `window` [s] that are finite and later than all before; the first row of all may lie anywhere."""
        inside = ~((time < window[0]) | (time > window[1]))  # what is no number is counted
        if not inside.all():
            time, columns = time[inside], [values[inside] for values in columns]
        holes = ~np.isfinite(np.stack([time, *columns]))
        if holes.any():
            self._missing += holes.sum(axis=1)
            finite = ~holes.any(axis=0)
        else:
            finite = np.ones(len(time), dtype=bool)
        self._rows += len(time)
        self._not_finite += len(time) - int(finite.sum())
        stamps = time[finite]
        before = np.maximum.accumulate(np.concatenate([[self._latest], stamps]))
        rising = stamps > before[:-1]
        same = int(np.sum(stamps == before[:-1]))
        self._duplicate += same
        self._backwards += len(stamps) - int(rising.sum()) - same
        self._latest = float(before[-1])
        good = np.flatnonzero(finite)[rising]
        if len(good) < len(time):
            time, columns = time[good], [values[good] for values in columns]
        self._clock.tick(time)
        return time, list(columns)

    @property
    def quality(self) -> Quality:
        """Of the rows so far."""
        return self._clock.quality(
            Quality(
                rows=self._rows,
                not_finite=self._not_finite,
                duplicate=self._duplicate,
                backwards=self._backwards,
                missing={name: int(count) for name, count in zip(("time", *self._names), self._missing, strict=True) if count},
            )
        )

    def judge(self) -> None:
        """Raises GainroomError where too little of the rows is left to be a log."""
        quality, path = self.quality, self._path
        if quality.rows < JUDGED:
            return
        if quality.not_finite > MOST_MISSING * quality.rows:
            worst = max(quality.missing, key=lambda name: quality.missing[name])
            raise GainroomError(
                f"{path}: {quality.not_finite} of {quality.rows} rows lack a number, most often {worst} ({quality.missing[worst]} rows); "
                f"at most {MOST_MISSING:.0%} may: leave that column out, or bring the columns to common time stamps"
            )
        stamped = quality.rows - quality.not_finite
        late, what = max((quality.duplicate, "have the time stamp of the row before"), (quality.backwards, "are earlier than a row before"))
        if late > MOST_BACKWARDS * stamped:
            raise GainroomError(
                f"{path}: {late} of {stamped} rows {what}; at most {MOST_BACKWARDS:.0%} may: name another column for time, cut the file "
                "where its clock begins again, or give the sample rate"
            )


class _Clock:
    """How even the time stamps of the good rows are."""

    def __init__(self) -> None:
        self._nominal = 0.0
        self._last = np.nan
        self._span = self._square = 0.0
        self._ticks = self._neighbours = self._gaps = self._dropped = 0
        self._longest = 0.0

    def tick(self, time: Floats) -> None:
        steps = np.diff(time if np.isnan(self._last) else np.concatenate([[self._last], time]))
        if len(time):
            self._last = float(time[-1])
        if not len(steps):
            return
        if self._nominal == 0:
            self._nominal = float(np.median(steps))
        gap = steps > GAP * self._nominal
        self._gaps += int(gap.sum())
        if gap.any():
            self._dropped += int((np.maximum(np.rint(steps[gap] / self._nominal), 2) - 1).sum())
            self._longest = max(self._longest, float(steps[gap].max()))
        near = steps[~gap]
        self._neighbours += len(near)
        self._span += float(near.sum())
        self._square += float(((near - self._nominal) ** 2).sum())

    def quality(self, counted: Quality) -> Quality:
        if not self._neighbours:
            return counted
        mean = self._span / self._neighbours
        variance = max(self._square / self._neighbours - (mean - self._nominal) ** 2, 0.0)
        return replace(
            counted, gaps=self._gaps, dropped=self._dropped, longest_gap=self._longest, jitter=float(np.sqrt(variance)), sample_time=mean
        )
