"""ROS 1 bags (format 2.0): record by record, chunk by chunk, without the index at the end, so that a bag that was cut is read up to there.

rosbags reads them too, but needs the index, unpacks chunks to wherever they end, and runs a program that it writes for each type.
Format: http://wiki.ros.org/Bags/Format/2.0
"""

import bz2
import contextlib
import struct
from collections.abc import Iterator
from os import SEEK_CUR
from pathlib import Path
from typing import BinaryIO

from ....errors import GainroomError, one_line
from ..table import MOST_PIECE, LogFormat, Table, bounded, checked_file, library
from .mcap_file import message_table
from .messages import Topic

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 2, 5, 7
"""Operations of records; others (the index, and what leads to it) are passed over."""
MOST_HEADER = 1 << 16
"""Bytes of a record's header: numbers, and a topic."""
MOST_CONNECTIONS = 10_000
Fields = dict[bytes, bytes]


class Ros1Bag(LogFormat):
    """Reader of ROS 1 bags, also of unfinished ones (`.active`)."""

    name = "ROS 1 bag"
    title = "a ROS 1 bag"
    endings = (".bag", ".active")

    def is_guarded(self, path: Path) -> bool:
        return True

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        checked_file(path)
        library("rosbags", "rosbags.typesys")
        messages = Ros1Messages(path)
        yield message_table(path, messages, [messages])


class Ros1Messages:
    """Messages of a ROS 1 bag, in its order. `complete`: False once its end has turned out to be missing."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.complete = True
        self.table: Table | None = None
        self._topics: dict[int, Topic] = {}

    def __call__(self) -> Iterator[tuple[Topic, int, bytes]]:
        with open(self._path, "rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise GainroomError(f"{self._path}: is not a ROS 1 bag of format 2.0")
            try:
                while (head := file.read(4)) != b"":
                    yield from self._record(file, head)
            except EOFError:
                self.complete = False
                if self.table is not None:
                    self.table.complete = False

    def _record(self, file: BinaryIO, head: bytes) -> Iterator[tuple[Topic, int, bytes]]:
        """Messages in the next record; `head`: the bytes with the length of its header, which have been read."""
        fields = self._fields(_whole(file, self._length(head, MOST_HEADER, "header")))
        size = self._length(file.read(4), MOST_PIECE, "record")
        kind = fields.get(b"op", b"\0")[0]
        if kind == CHUNK:
            data = file.read(size)
            yield from self._in_chunk(fields, data, len(data) < size)
            if len(data) < size:
                raise EOFError
        elif kind in (MESSAGE, CONNECTION):
            yield from self._one(kind, fields, _whole(file, size))
        elif file.seek(size, SEEK_CUR) > self._path.stat().st_size:
            raise EOFError

    def _length(self, four: bytes, most: int, what: str) -> int:
        if len(four) < 4:
            raise EOFError
        (length,) = struct.unpack("<I", four)
        bounded(self._path, f"size of a {what}:", length, most, " bytes")
        return length

    def _fields(self, data: bytes) -> Fields:
        """Fields of a record's header by name: each is its length, then `name=value`."""
        fields, place = {}, 0
        while place < len(data):
            (length,) = struct.unpack_from("<I", data, place)
            name, sign, value = data[place + 4 : place + 4 + length].partition(b"=")
            if not sign or place + 4 + length > len(data):
                raise GainroomError(f"{self._path}: a record's header has a field that is none")
            fields[name] = value
            place += 4 + length
        return fields

    def _in_chunk(self, fields: Fields, packed: bytes, cut: bool) -> Iterator[tuple[Topic, int, bytes]]:
        """Messages in a chunk; `cut`: the last one may be incomplete."""
        data, place = self._unpacked(fields, packed, cut), 0
        while place + 8 <= len(data):
            (length,) = struct.unpack_from("<I", data, place)
            header = data[place + 4 : place + 4 + length]
            place += 4 + length
            (size,) = struct.unpack_from("<I", data, place) if place + 4 <= len(data) else (len(data),)
            if place + 4 + size > len(data):
                if cut:
                    return
                raise GainroomError(f"{self._path}: a record of {size} bytes goes beyond its chunk")
            within = self._fields(header)
            yield from self._one(within.get(b"op", b"\0")[0], within, data[place + 4 : place + 4 + size])
            place += 4 + size

    def _unpacked(self, fields: Fields, packed: bytes, cut: bool) -> bytes:
        """Unpacked content of a chunk; if it is `cut`, as far as it goes. Raises GainroomError if its size is not as announced."""
        kind = fields.get(b"compression", b"none")
        (size,) = struct.unpack("<I", fields.get(b"size", b""))
        bounded(self._path, "unpacked chunk:", size, MOST_PIECE, " bytes")
        if kind == b"bz2":
            data = bz2.BZ2Decompressor().decompress(packed, size + 1) if packed else b""
        elif kind == b"lz4":
            data = library("lz4", "lz4.frame").frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1) if packed else b""
        elif kind == b"none":
            data = packed
        else:
            raise GainroomError(f"{self._path}: chunks packed by {one_line(repr(kind), 20)} must be packed by bz2 or lz4, or not at all")
        if len(data) != size and not (cut and len(data) < size):
            raise GainroomError(f"{self._path}: a chunk of {size} bytes unpacks to {'more' if len(data) > size else len(data)}")
        return data

    def _one(self, kind: int, fields: Fields, data: bytes) -> Iterator[tuple[Topic, int, bytes]]:
        """Message of one record; none for a record that describes a connection, which is noted."""
        if kind == MESSAGE:
            seconds, nanoseconds = struct.unpack("<II", fields.get(b"time", b""))
            topic = self._topics.get(_number(fields))
            if topic is not None:
                yield topic, seconds * 10**9 + nanoseconds, data
        elif kind == CONNECTION:
            about = self._fields(data)
            bounded(self._path, "number of connections", len(self._topics), MOST_CONNECTIONS)
            topic, name, text = (
                value.decode("utf-8", "replace") for value in (fields[b"topic"], about[b"type"], about[b"message_definition"])
            )
            self._topics[_number(fields)] = Topic(topic.strip("/"), "ros1", name, "ros1msg", text)


def _number(fields: Fields) -> int:
    return struct.unpack("<I", fields.get(b"conn", b""))[0]


def _whole(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise EOFError
    return data
