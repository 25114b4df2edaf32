"""Most excited part of a long log: the part in which the command changes most.

What a minute tells, an hour tells hardly better: what is left is the law of friction, not noise. So the most excited part of a long log is
used and the rest is not, which bounds time and memory; the answer says which part it was.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..system.linear.arrays import Floats
from .record import Record

SHOWN_BY = ("target_torque", "demand_torque", "actual_torque", "reference", "motor_position", "link_position")
MOST_ROWS = 240_000  # of a log that are kept in memory: 2 min at 2 kHz


def excitation(channels: Mapping[str, Floats]) -> Floats:
    """Change (m,) of each row from the row before, of the first channel of SHOWN_BY in the log."""
    name = next((name for name in SHOWN_BY if name in channels), None)
    values = next(iter(channels.values())) if name is None else channels[name]
    # The change itself, not its square, so that one crash does not outweigh a minute of excitation.
    return np.abs(np.diff(values, prepend=values[:1]))


def busiest(changes: Floats, rows: int) -> slice:
    """Window of `rows` consecutive rows with the largest sum of `changes` (m,)."""
    if len(changes) <= rows:
        return slice(0, len(changes))
    total = np.concatenate([[0.0], np.cumsum(changes)])
    first = int(np.argmax(total[rows:] - total[:-rows]))
    return slice(first, first + rows)


def most_excited(record: Record, rows: int) -> Record:
    """Window of `rows` consecutive rows that change most; all of a shorter record."""
    if len(record.time) <= rows:
        return record
    part = busiest(excitation(record.channels), rows)
    return Record(record.time[part], {name: column[part] for name, column in record.channels.items()}, record.sample_time)


@dataclass
class MostExcited:
    """Search for the most excited part of a log that comes in blocks, to within a block; memory: two windows of `rows` rows and a block.

    seen   rows that were given
    """

    rows: int = MOST_ROWS
    seen: int = 0
    _window: "deque[tuple[Floats, Mapping[str, Floats], float]]" = field(default_factory=deque)
    _best: "list[tuple[Floats, Mapping[str, Floats], float]]" = field(default_factory=list)
    _most: float = -1.0

    def add(self, time: Floats, channels: Mapping[str, Floats]) -> None:
        """Adds the next rows: time (k,) [s] and channels (k,) by name."""
        window, self.seen = self._window, self.seen + len(time)
        window.append((time, channels, float(excitation(channels).sum())))
        while len(window) > 1 and sum(len(block[0]) for block in window) - len(window[0][0]) >= self.rows:
            window.popleft()
        most = sum(block[2] for block in window)
        if most > self._most:
            self._most, self._best = most, list(window)

    def part(self) -> tuple[Floats, dict[str, Floats]]:
        """Time and channels of the best window, in order."""
        if not self._best:
            return np.zeros(0), {}
        names = list(self._best[0][1])
        time = np.concatenate([block[0] for block in self._best])
        return time, {name: np.concatenate([block[1][name] for block in self._best]) for name in names}
