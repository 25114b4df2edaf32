"""Survey of a whole log, block by block: its contents without the rows."""

import math
from dataclasses import dataclass

from .abilities import Ability, abilities
from .reading import LogReader
from .record import Log


@dataclass(frozen=True)
class Survey:
    """Findings of one pass over a log.

    last         the reader's last block: origins, quality, notes, and the joints by name with their channels
    duration     [s] between first and last row
    ranges       by (joint, channel) the least and the largest value [SI]
    unused       columns that are no channel's
    """

    path: str
    last: Log
    duration: float
    ranges: dict[tuple[str, str], tuple[float, float]]
    unused: tuple[str, ...] = ()

    @classmethod
    def of(cls, reader: LogReader) -> "Survey":
        """Survey of an open log, block by block. Raises GainroomError."""
        first, end, last = None, 0.0, None
        ranges: dict[tuple[str, str], tuple[float, float]] = {}
        for last in reader.blocks():
            if not len(last.time):
                continue
            first, end = last.time[0] if first is None else first, last.time[-1]
            for joint, channels in last.joints.items():
                for name, values in channels.items():
                    least, largest = ranges.get((joint, name), (math.inf, -math.inf))
                    ranges[joint, name] = (min(least, float(values.min())), max(largest, float(values.max())))
        assert last is not None  # the last block is there, and empty
        return cls(str(reader.path), last, float(end - first) if first is not None else 0.0, ranges, reader.unused)

    @property
    def rate(self) -> float:
        """Rows per second [Hz]; 0 where fewer than two rows are."""
        return 1 / self.last.sample_time if self.last.sample_time else 0.0

    def abilities(self) -> tuple[Ability, ...]:
        """Answerable questions for the joint with the most changing channels."""
        changing = {
            joint: [name for name in channels if (span := self.ranges.get((joint, name))) is not None and span[0] < span[1]]
            for joint, channels in self.last.joints.items()
        }
        joint = max(changing, key=lambda joint: (len(changing[joint]), len(self.last.joints[joint])))
        there = set(self.last.joints[joint])
        return abilities(there, there - {*changing[joint]}, self.last.quality.rows - self.last.quality.cut)
