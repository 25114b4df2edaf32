"""Cleaning of a log's rows as they arrive: rows that are not finite, repeated or late are removed and counted; the clock is measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import GainroomError
from ...system.linear.arrays import Booleans, Floats
from .clock import LEAST_ROWS, PAUSE, tick_of, ticks_of
from .record import Quality

MOST_MISSING = 0.5
"""Share of rows with a missing number above which a log is refused: its channels were then hardly ever recorded together."""
MOST_BACKWARDS = 0.2
"""Share of rows that are late, or have a stamp that was there already, from which on a log is refused: threads that log into one file
exchange a few rows; more, and it is another column, two logs in one file, or a clock that is too coarse."""
JUDGED = 20
"""Number of rows from which on these shares are judged."""
AHEAD = 100.0
"""Distance [ticks] by which a wrong stamp is later than all later ones; the rows after it are not late."""
FEW_AHEAD, SHARE_AHEAD = 3, 1e-3
"""Maximum number and share of such rows in a block; if there are more, the clock has restarted."""
BLOCK = 8192
"""Number of stamps that are evaluated together; smaller blocks of rows are collected."""


class Cleaner:
    """Filter for blocks of rows that returns the good ones and counts the others.

    names   of the columns beside time, for messages and counts
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._path, self._names = path, names
        self._rows = self._not_finite = self._duplicate = self._backwards = self._ahead = 0
        self._missing = np.zeros(len(names) + 1, dtype=int)
        self._latest = -np.inf
        self._clock = _Clock()

    def clean(self, time: Floats, columns: Sequence[Floats], window: tuple[float, float]) -> tuple[Floats, list[Floats]]:
        """Rows within `window` [s] that are finite and later than all before; the first row of all may lie anywhere."""
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
        early = ahead(time[finite])
        self._ahead += int(early.sum())
        rows = np.flatnonzero(finite)[~early]
        stamps = time[rows]
        before = np.maximum.accumulate(np.concatenate([[self._latest], stamps]))
        rising = stamps > before[:-1]
        same = int(np.sum(stamps == before[:-1]))
        self._duplicate += same
        self._backwards += len(stamps) - int(rising.sum()) - same
        self._latest = float(before[-1])
        good = rows[rising]
        if len(good) < len(time):
            time, columns = time[good], [values[good] for values in columns]
        self._clock.tick(time)
        return time, list(columns)

    @property
    def quality(self) -> Quality:
        """Quality of the rows so far."""
        return self._clock.quality(
            Quality(
                rows=self._rows,
                not_finite=self._not_finite,
                duplicate=self._duplicate,
                backwards=self._backwards,
                ahead=self._ahead,
                missing={name: int(count) for name, count in zip(("time", *self._names), self._missing, strict=True) if count},
            )
        )

    def require_enough(self) -> None:
        """Raises GainroomError if too few rows are left to be a log."""
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


def ahead(stamps: Floats) -> Booleans:
    """True (m,) for a few stamps that are far later than all later ones."""
    found = np.zeros(len(stamps), dtype=bool)
    steps = np.diff(stamps)
    if len(stamps) < JUDGED or not (steps < 0).any():
        return found
    tick = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    found[:-1] = stamps[:-1] - np.minimum.accumulate(stamps[::-1])[::-1][1:] > AHEAD * tick
    return found if tick > 0 and found.sum() <= max(FEW_AHEAD, SHARE_AHEAD * len(stamps)) else np.zeros(len(stamps), dtype=bool)


class _Clock:
    """Statistics of the time stamps of the good rows, block by block, each with the last row of the one before."""

    def __init__(self) -> None:
        self._waiting: list[Floats] = []
        self._found, self._tick = _Counted(), 0.0

    def tick(self, time: Floats) -> None:
        if len(time):
            self._waiting.append(time)
        if sum(len(block) for block in self._waiting) >= BLOCK:
            stamps = np.concatenate(self._waiting)
            self._found, self._tick = self._with(stamps)
            self._waiting = [stamps[-1:]]

    def _with(self, stamps: Floats) -> "tuple[_Counted, float]":
        """Statistics with further stamps, and their tick."""
        if len(stamps) < 2:
            return self._found, self._tick
        tick = tick_of(stamps) if len(stamps) >= LEAST_ROWS or not self._tick else self._tick
        return self._found.with_steps(stamps, tick), tick

    def quality(self, counted: Quality) -> Quality:
        found, _ = self._with(np.concatenate(self._waiting) if self._waiting else np.zeros(0))
        if not found.neighbours:
            return counted
        mean = found.near / found.neighbours
        jitter = float(np.sqrt(max(found.square / found.neighbours - (mean - found.about) ** 2, 0.0)))
        return replace(
            counted, gaps=found.gaps, dropped=found.dropped, longest_gap=found.longest, jitter=jitter, sample_time=found.span / found.ticks,
            off_ticks=float(np.sqrt(found.off / found.rows)),
        )  # fmt: skip


@dataclass(frozen=True)
class _Counted:
    """Sums over the steps so far: between neighbours (`near`, squares about `about`), over ticks, in gaps; and of stamps off their tick."""

    neighbours: int = 0
    near: float = 0.0
    square: float = 0.0
    about: float = 0.0
    ticks: int = 0
    span: float = 0.0
    gaps: int = 0
    dropped: int = 0
    longest: float = 0.0
    rows: int = 0
    off: float = 0.0

    def with_steps(self, stamps: Floats, tick: float) -> "_Counted":
        """Sums with the steps between further stamps (m,) of this tick [s]."""
        found = ticks_of(stamps, tick)
        passed, steps, about = np.diff(found.numbers), np.diff(stamps), self.about or tick
        gap, bridged = passed > 1, passed <= PAUSE  # a longer one is no measure of the tick
        near = steps[~gap]
        return _Counted(
            self.neighbours + len(near), self.near + float(near.sum()), self.square + float(((near - about) ** 2).sum()), about,
            self.ticks + int(passed[bridged].sum()), self.span + float(steps[bridged].sum()),
            self.gaps + int(gap.sum()), self.dropped + int((passed[gap] - 1).sum()), max(self.longest, float(steps[gap].max(initial=0.0))),
            self.rows + len(stamps), self.off + float(np.sum(found.off**2)),
        )  # fmt: skip
