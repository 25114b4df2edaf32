"""Messages of several topics, each with time stamps of its own, as one table: at the time stamps of the topic that comes most often."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from ....errors import GainroomError, first_of_many
from ....system.linear.arrays import Floats
from ..guessing import WORD, channel_of, is_commanding, joint_in
from ..record import aligned
from ..table import MOST_COLUMNS, TIME, Column, Table, bounded
from .decoding import Decoder, JsonDecoder, Part, RosDecoder
from .ros_types import types_of

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
        """Name of a message's field as a column of the table."""
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
        """Waiting rows as times (k,) and values (k, c); rising: only rows later than all before."""
        time = np.concatenate(self.times) if self.times else np.zeros(0)
        values = np.concatenate(self.values) if self.values else np.zeros((0, len(self.part.labels)))
        return _rising(time, values) if rising else (time, values)

    def keep(self, time: Floats, values: Floats) -> None:
        """Replaces the waiting rows by these."""
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
        """Rows of the base stream, with the other streams' values, up to the time that all streams have reached; final: all rows left."""
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
    """Time stamps and values of the rows that are later than all rows before them."""
    good = np.isfinite(stamps)
    good[1:] &= stamps[1:] > np.maximum.accumulate(np.where(good, stamps, -np.inf))[:-1]
    return (stamps, values) if good.all() else (stamps[good], values[good])


def _at(time: Floats, stamps: Floats, values: Floats, held: bool) -> Floats:
    """Values resampled at `time`: the last before if `held`, else interpolated. NaN before the first row; after the last unless held."""
    if not len(stamps):
        return np.full(len(time), np.nan)
    found = aligned(time, stamps, values, held)
    outside = (time < stamps[0]) | ((time > stamps[-1]) & (not held))
    return np.where(outside, np.nan, found) if outside.any() else found


PROBED = 20_000
"""Messages from the beginning in which topics and joints are looked for: 2 s of ten topics at 1 kHz."""
BATCH = 1 << 16
"""Messages that are decoded together."""
BATCH_BYTES = 1 << 25
"""Of all messages that wait to be decoded: 32 MiB."""
MOST_MESSAGE = 1 << 20
"""Bytes: the state of 500 joints has 20 kB; longer messages are pictures and points, and passed over."""
EPOCH = 1e6
"""[s] Stamps beyond count from an epoch; they are then taken from the first on, with all their digits."""
STAMP = re.compile(r"(header\.)?stamp\.(sec|nanosec)|header\.seq")
WRAPPED = re.compile(r"(?:data|value|values|msg)((?:\[[0-9]+\])?)")
"""Fields that say nothing: what they hold is what the topic is called."""


@dataclass(frozen=True)
class Topic:
    """Topic as a file describes it: name without slashes at the ends, and type and encoding of its messages."""

    name: str
    encoding: str
    type: str = ""
    definition_encoding: str = ""
    definition: str = ""


Messages = Callable[[], Iterator[tuple[Topic, int, bytes]]]
"""From the start at every call: topic, time of recording [ns], content."""


class MessageFile(Protocol):
    """Interface of a file of messages, which may turn out to be cut off; the table then notes it."""

    complete: bool
    table: Table | None


class MessageTable(Table):
    """Table of messages: columns `topic/field` or `topic/field[joint]`, time stamps those in the messages, else the times of recording."""

    def __init__(self, path: Path, messages: Messages) -> None:
        super().__init__()
        self._path, self._messages = path, messages
        self._decoders: dict[str, Decoder | None] = {}
        self._left: dict[str, str] = {}
        self._streams: dict[tuple[str, tuple[str, ...]], Stream] = {}
        self._zero = 0.0
        self._begun = False
        self._probe()
        self.taken_off = {TIME: self._zero}
        self.columns = [Column(TIME, unit="s"), *self._columns()]
        bounded(path, "number of columns", len(self.columns), MOST_COLUMNS)

    def _decoder(self, topic: Topic) -> Decoder | None:
        if topic.name not in self._decoders:
            self._decoders[topic.name] = None
            try:
                if topic.encoding == "json":
                    self._decoders[topic.name] = JsonDecoder()
                elif topic.encoding in ("cdr", "ros1"):
                    # `sensor_msgs/JointState`, as ROS 1 and the first ROS 2 write it, is `sensor_msgs/msg/JointState`.
                    kind = topic.type.replace("/", "/msg/") if topic.type.count("/") == 1 else topic.type
                    types = types_of(kind, topic.definition_encoding, topic.definition)
                    self._decoders[topic.name] = RosDecoder(kind, types, topic.encoding == "ros1")
                else:
                    self._left[topic.name] = f"{topic.encoding or 'unknown'} messages"
            except GainroomError as error:
                if "pip install" in str(error):
                    raise
                self._left[topic.name] = str(error)
        return self._decoders[topic.name]

    def _decoded(self, topic: Topic, stamps: Sequence[int], batch: Sequence[bytes]) -> Iterator[tuple[Stream, Floats, Floats]]:
        """Streams of a topic with the times [s] and numbers of a batch of its messages."""
        decoder = self._decoder(topic)
        if decoder is None:
            return
        recorded = np.array(stamps, dtype=np.int64)
        for part, numbers, places in decoder.decode(batch):
            stream = self._streams.get((topic.name, part.key))
            if stream is None:
                stream = Stream(topic.name, part)
                stream.own_clock = decoder.seconds(part, numbers, 0.0) is not None
                if not self._begun:
                    self._streams[stream.key] = stream
            own = decoder.seconds(part, numbers, self._zero) if stream.own_clock else None
            yield stream, (recorded[places] - int(self._zero * 1e9)) / 1e9 if own is None else own, numbers

    def _probe(self) -> None:
        waiting = _Waiting()
        for number, (topic, stamp, data) in enumerate(self._messages()):
            if len(data) <= MOST_MESSAGE and self._decoder(topic) is not None:
                waiting.add(topic, stamp, data)
            if number >= PROBED or waiting.large:
                break
        first = np.inf
        for topic, stamps, batch in waiting.taken():
            try:
                for stream, time, _ in self._decoded(topic, stamps, batch):
                    stream.count += len(time)
                    first = min(first, float(np.min(time, initial=np.inf, where=np.isfinite(time))))
            except (GainroomError, ValueError, KeyError, IndexError, OverflowError) as error:
                self._left[topic.name] = str(error) or type(error).__name__
                self._decoders[topic.name] = None
                self._streams = {key: stream for key, stream in self._streams.items() if key[0] != topic.name}
        if not any(stream.part.labels for stream in self._streams.values()):
            raise GainroomError(f"{self._path}: holds no messages with numbers{self._left_out('; ')}")
        self._zero = float(np.floor(first)) if EPOCH < first < np.inf else 0.0
        self._begun = True
        if self._left:
            self.notes.append(self._left_out())

    def _left_out(self, before: str = "") -> str:
        """Text on topics that are not read, with the reasons, behind `before`; "" if all are."""
        topics = [f"{name} ({why})" for name, why in self._left.items()]
        return f"{before}topics left out: {first_of_many(topics)}" if topics else ""

    def _columns(self) -> Iterator[Column]:
        """Columns of the table; the joint comes from the topic's name if several topics have the same field and name no joints."""
        streams = [*self._streams.values()]
        fields: dict[str, set[str]] = {}
        for stream in streams:
            for path in stream.part.labels:
                fields.setdefault(path, set()).add(stream.topic)
        seen: set[str] = set()
        for stream in streams:
            for path, (label, joint) in stream.part.labels.items():
                name, commanded = stream.column(path), is_commanding(stream.topic)
                guess = channel_of(path)
                if name in seen or STAMP.fullmatch(path) or (guess is not None and guess.channel == TIME):
                    continue  # stamps within messages are those of the column `time`
                seen.add(name)
                if joint:
                    yield Column(name, label, joint, commanded=commanded)
                elif wrapped := WRAPPED.fullmatch(path):
                    alone = path.endswith("[0]") and f"{path[:-2]}1]" not in stream.part.labels
                    yield Column(name, _field_of(stream.topic) + ("" if alone else wrapped[1]), commanded=commanded)
                elif len(fields[path]) > 1:
                    yield Column(name, label, _joint_of(stream.topic, fields[path]), commanded=commanded)
                else:
                    yield Column(name, label, commanded=commanded)

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        places = [self._place(name) for name in names]
        alignment = Alignment(places, [name in held for name in names], next(iter(self._streams.values())))
        topics = {stream.topic for stream in alignment.streams.values()}
        waiting = _Waiting()
        for topic, stamp, data in self._messages():
            if topic.name in topics and len(data) <= MOST_MESSAGE:
                waiting.add(topic, stamp, data)
                if waiting.full:
                    self._pass_on(waiting, alignment)
                    yield from alignment.rows()
        self._pass_on(waiting, alignment)
        yield from alignment.rows(final=True)

    def _place(self, name: str) -> tuple[Stream, int] | None:
        """Stream of a column and the index in it; None for the time stamps."""
        if name == TIME:
            return None
        return next(
            (stream, k) for stream in self._streams.values() for k, path in enumerate(stream.part.labels) if stream.column(path) == name
        )

    def _pass_on(self, waiting: "_Waiting", alignment: Alignment) -> None:
        for topic, stamps, batch in waiting.taken():
            for stream, time, numbers in self._decoded(topic, stamps, batch):
                if stream.key in alignment.streams:
                    stream.add(time, numbers)


class _Waiting:
    """Messages not yet decoded, by topic."""

    def __init__(self) -> None:
        self._topics: dict[str, tuple[Topic, list[int], list[bytes]]] = {}
        self._size = self._count = 0

    def add(self, topic: Topic, stamp: int, data: bytes) -> None:
        _, stamps, batch = self._topics.setdefault(topic.name, (topic, [], []))
        stamps.append(stamp)
        batch.append(data)
        self._size, self._count = self._size + len(data), self._count + 1

    @property
    def large(self) -> bool:
        return self._size > BATCH_BYTES

    @property
    def full(self) -> bool:
        return self._count >= BATCH or self.large

    def taken(self) -> list[tuple[Topic, list[int], list[bytes]]]:
        """Removes and returns all waiting messages: topic, times [ns] and contents."""
        topics, self._topics, self._size, self._count = [*self._topics.values()], {}, 0, 0
        return topics


def _field_of(topic: str) -> str:
    """Text of a topic that names its only field: the whole topic, or one word, as "effort" in `forward_effort_controller/commands`."""
    if channel_of(topic) is not None or not is_commanding(topic):
        return topic
    return next((word[0] for word in WORD.finditer(topic) if channel_of(word[0]) is not None), topic)


def _joint_of(topic: str, others: set[str]) -> str:
    """Joint that a topic names, see joint_in; the whole topic if two of `others`, the topics with that field, would name the same joint."""
    paths = {"/".join(filter(None, map(joint_in, name.split("/")))) for name in others}
    return joint_in(topic) if len({joint_in(path) for path in paths}) == len(paths) else topic
