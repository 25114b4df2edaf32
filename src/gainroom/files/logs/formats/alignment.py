"""Topics with time stamps of their own, brought to those of one of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ....system.linear.arrays import Floats
from ..record import aligned
from .decoding import Part

MOST_WAITING = 1 << 27
"""Bytes of rows that wait for another topic to come as far: 128 MiB. It may have ended, or stand behind all others in the file."""
LONGEST_NAME = 500


@dataclass
class Stream:
    """One part of a topic: its columns, and rows that wait for those of other streams.

    count   of messages in the probe
    last    [s] the latest time stamp so far
    """

    topic: str
    part: Part
    own_clock: bool = False
    count: int = 0
    last: float = -np.inf
    waiting: int = 0
    times: list[Floats] = field(default_factory=list)
    values: list[Floats] = field(default_factory=list)

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        return self.topic, self.part.key

    def column(self, path: str) -> str:
        """What a field is called in the table."""
        return f"{self.topic}/{path}"[:LONGEST_NAME]

    def begin(self) -> None:
        self.last, self.waiting, self.times, self.values = -np.inf, 0, [], []

    def add(self, time: Floats, values: Floats) -> None:
        if len(time):
            self.times.append(time)
            self.values.append(values)
            self.waiting += values.nbytes
            self.last = max(self.last, float(np.max(time, initial=-np.inf, where=np.isfinite(time))))

    def joined(self, rising: bool) -> tuple[Floats, Floats]:
        """What waits, as two arrays; rising: without rows that are not later than all before."""
        time = np.concatenate(self.times) if self.times else np.zeros(0)
        values = np.concatenate(self.values) if self.values else np.zeros((0, len(self.part.labels)))
        return _rising(time, values) if rising else (time, values)

    def keep(self, time: Floats, values: Floats) -> None:
        """Only these rows wait on."""
        self.times, self.values, self.waiting = ([time], [values], values.nbytes) if len(time) else ([], [], 0)


class Alignment:
    """Columns of several streams at the time stamps of the one that comes most often, as their messages come in.

    places   of the columns: a stream and a place among its numbers; None for time
    held     whether each keeps its value until the next
    base     the stream that gives the time stamps, where no column needs one
    """

    def __init__(self, places: Sequence[tuple[Stream, int] | None], held: Sequence[bool], base: Stream) -> None:
        self._places, self._held = places, held
        self.streams = {place[0].key: place[0] for place in places if place is not None}
        self._base = max(self.streams.values(), key=lambda stream: stream.count, default=base)
        self.streams.setdefault(self._base.key, self._base)
        for stream in self.streams.values():
            stream.begin()

    def rows(self, final: bool = False) -> Iterator[list[Floats]]:
        """Those rows of the base that no stream can add anything to any more; final: all that are left."""
        base, streams = self._base, self.streams
        until = min(stream.last for stream in streams.values())
        if final or sum(stream.waiting for stream in streams.values()) > MOST_WAITING:
            until = np.inf
        if not base.times or base.times[0][0] > until:
            return
        time, values = base.joined(rising=False)
        late = time > until
        count = int(np.argmax(late)) if late.any() else len(time)
        others = {key: stream.joined(rising=True) for key, stream in streams.items() if stream is not base}
        block = []
        for place, held in zip(self._places, self._held, strict=True):
            if place is None:
                block.append(time[:count])
            elif place[0] is base:
                block.append(np.ascontiguousarray(values[:count, place[1]]))
            else:
                stamps, numbers = others[place[0].key]
                block.append(_at(time[:count], stamps, numbers[:, place[1]], held))
        yield block
        base.keep(time[count:], values[count:])
        done = np.max(time[:count], initial=-np.inf, where=np.isfinite(time[:count]))
        for key, (stamps, numbers) in others.items():
            first = max(int(np.searchsorted(stamps, done, side="right")) - 1, 0)  # the last row before is needed on
            streams[key].keep(stamps[first:], numbers[first:])


def _rising(stamps: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Without rows that are not later than all before."""
    good = np.isfinite(stamps)
    good[1:] &= stamps[1:] > np.maximum.accumulate(np.where(good, stamps, -np.inf))[:-1]
    return (stamps, values) if good.all() else (stamps[good], values[good])


def _at(time: Floats, stamps: Floats, values: Floats, held: bool) -> Floats:
    """A column at other times; NaN before its first row, and behind its last where it is not held."""
    if not len(stamps):
        return np.full(len(time), np.nan)
    found = aligned(time, stamps, values, held)
    outside = (time < stamps[0]) | ((time > stamps[-1]) & (not held))
    return np.where(outside, np.nan, found) if outside.any() else found
