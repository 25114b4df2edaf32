"""MCAP, through the mcap library: chunk by chunk. JSON messages and those of ROS 2 are read.

The library unpacks a chunk before it knows how large that becomes; here what is announced is checked first, and unpacking stops there.
A chunk that the file's end cuts off is read by hand, as far as its messages are whole: what is packed unpacks up to its last whole block.

A guarded child reads: rosbags' parser of IDL definitions takes time that grows by a factor with every bracket, so that a file of 300 bytes
keeps it busy for ever (rosbags 0.11, eight brackets around a constant).
"""

import contextlib
import json
import struct
import zlib
from collections.abc import Iterator, Sequence
from os import SEEK_END
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ....errors import GainroomError
from ....system.linear.arrays import Floats
from ..table import MOST_PIECE, LogFormat, Table, bounded, checked_file, library
from .messages import MessageFile, Messages, MessageTable, Topic

SCHEMA, CHANNEL, MESSAGE = 3, 4, 5
"""Records within chunks."""
CHUNK = 6


class McapSink:
    """Writer of a log as MCAP: one topic per joint with JSON messages, stamped with the run's own time; every block is one chunk."""

    def __init__(self, path: Path) -> None:
        mcap = library("mcap", "mcap.writer")
        self._file = open(path, "wb")  # noqa: SIM115 - closed in close()
        self._writer = mcap.writer.Writer(self._file)
        self._writer.start(profile="", library="gainroom")
        self._channels: list[int] = []
        self._signals: tuple[str, ...] = ()

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        names = ("time", *signals)
        units = {name: "s" if name == "time" else "rad" if name.endswith("position") else "N m" for name in names}
        properties = {name: {"type": "number", "description": f"[{unit}], joint side"} for name, unit in units.items()}
        schema = {"title": "gainroom.Joint", "type": "object", "properties": properties, "required": list(names)}
        number = self._writer.register_schema("gainroom.Joint", "jsonschema", json.dumps(schema).encode())
        self._channels = [self._writer.register_channel(f"/{joint}", "json", number) for joint in joints]
        self._signals = tuple(signals)

    def rows(self, time: Floats, signals: Sequence[Floats]) -> None:
        if len(time) and time.min() < 0:
            raise GainroomError(f"MCAP has no time before 0, and the log begins at {time.min():g} s")
        table = np.stack([np.broadcast_to(time[:, None], (len(time), len(self._channels))), *signals], axis=2)
        names = ("time", *self._signals)
        for stamp, row in zip(np.round(1e9 * time).astype(np.int64).tolist(), table.tolist(), strict=True):
            for channel, values in zip(self._channels, row, strict=True):
                data = json.dumps(dict(zip(names, values, strict=True)), allow_nan=False).encode()
                self._writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)
        self._writer.flush()

    def close(self) -> None:
        try:
            self._writer.finish()
        finally:
            self._file.close()


class Mcap(LogFormat):
    """Reader of logs in a single MCAP file."""

    name = "MCAP"
    title = "an MCAP file"
    endings = (".mcap",)
    makes = McapSink

    def is_guarded(self, path: Path) -> bool:
        return True

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        library("mcap", "mcap.stream_reader")
        checked_file(path)
        source = McapMessages(path)
        yield message_table(path, source, [source])


def message_table(path: Path, messages: Messages, files: Sequence[MessageFile]) -> MessageTable:
    """Table of `messages`, a function that begins them anew; `files`: MCAP files among their sources. Raises GainroomError."""
    try:
        table = MessageTable(path, messages)
    except GainroomError as error:
        if all(file.complete for file in files):
            raise
        raise GainroomError(f"{error}; it ends within its first chunk, before a message is whole") from error
    for file in files:
        file.table = table
        table.complete &= file.complete
    return table


class McapMessages:
    """Messages of an MCAP file, in its order. `complete`: False once its end has turned out to be missing."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.complete = True
        self.table: Table | None = None
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._topics: dict[int, Topic] = {}

    def __call__(self) -> Iterator[tuple[Topic, int, bytes]]:
        from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
        from mcap.records import Channel, Chunk, Message, Schema
        from mcap.stream_reader import StreamReader

        with open(self._path, "rb") as file:
            limit = min(self._path.stat().st_size, MOST_PIECE)
            records = StreamReader(file, validate_crcs=True, record_size_limit=limit, emit_chunks=True).records
            while True:
                start = file.tell()
                try:
                    record = next(records, None)
                except (EndOfFile, struct.error, RecordLengthLimitExceeded) as error:
                    chunk = _cut_chunk(file, start)
                    if chunk is None and isinstance(error, RecordLengthLimitExceeded):
                        if limit == MOST_PIECE:
                            raise
                        raise GainroomError(f"{self._path}: {error} bytes, all that the file has: it is cut off, or damaged") from error
                    self.complete = False
                    if self.table is not None:
                        self.table.complete = False
                    if chunk is not None:
                        yield from self._in_chunk(self._unpacked(chunk, cut=True), cut=True)
                    return
                if record is None:
                    return
                if isinstance(record, Chunk):
                    yield from self._in_chunk(self._unpacked(record))
                elif isinstance(record, Schema):
                    self._schemas[record.id] = (record.name, record.encoding, record.data.decode("utf-8", "replace"))
                elif isinstance(record, Channel):
                    self._add(record.id, record.topic, record.message_encoding, record.schema_id)
                elif isinstance(record, Message) and record.channel_id in self._topics:
                    yield self._topics[record.channel_id], record.log_time, record.data

    def _add(self, number: int, topic: str, encoding: str, schema: int) -> None:
        self._topics[number] = Topic(topic.strip("/"), encoding, *self._schemas.get(schema, ()))

    def _unpacked(self, chunk: Any, cut: bool = False) -> bytes:
        """Unpacked records of a chunk; if it is `cut`, as far as they go. Raises GainroomError if size or checksum are not as announced."""
        bounded(self._path, "unpacked chunk:", chunk.uncompressed_size, MOST_PIECE, " bytes")
        size = chunk.uncompressed_size
        if chunk.compression == "lz4":
            data = library("lz4", "lz4.frame").frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        elif chunk.compression == "zstd":
            with library("zstandard").ZstdDecompressor().stream_reader(chunk.data) as stream:
                data = stream.read(size + 1)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise GainroomError(f"{self._path}: chunks packed by {chunk.compression[:20]!r} must be packed by lz4 or zstd, or not at all")
        if cut and len(data) <= size:
            return data
        if len(data) != size:
            raise GainroomError(f"{self._path}: a chunk of {size} bytes unpacks to {'more' if len(data) > size else len(data)}")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise GainroomError(f"{self._path}: the checksum of a chunk is not that of what it holds")
        return data

    def _in_chunk(self, data: bytes, cut: bool = False) -> Iterator[tuple[Topic, int, bytes]]:
        """Messages in the records of a chunk: topic, time [ns] and content. `cut`: the last record may be incomplete."""
        place = 0
        while place + 9 <= len(data):
            opcode, length = struct.unpack_from("<BQ", data, place)
            place += 9
            if place + length > len(data):
                if cut:
                    return
                raise GainroomError(f"{self._path}: a record of {length} bytes goes beyond its chunk")
            if opcode == MESSAGE:
                channel, _, stamp, _ = struct.unpack_from("<HIQQ", data, place)
                if channel in self._topics:
                    yield self._topics[channel], stamp, data[place + 22 : place + length]
            elif opcode in (SCHEMA, CHANNEL):
                self._describe(opcode, data[place : place + length])
            place += length

    def _describe(self, opcode: int, data: bytes) -> None:
        from io import BytesIO

        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        stream = ReadDataStream(BytesIO(data))
        if opcode == SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = (schema.name, schema.encoding, schema.data.decode("utf-8", "replace"))
        else:
            channel = Channel.read(stream)
            self._add(channel.id, channel.topic, channel.message_encoding, channel.schema_id)


def _cut_chunk(file: BinaryIO, start: int) -> Any:
    """The chunk that begins at `start` and that the file's end cuts off; None where no such chunk is there.

    Record: opcode, length, then start and end time, unpacked size, checksum, packing, size of the data, the data
    (https://mcap.dev/spec#chunk-op0x06).
    """
    from mcap.records import Chunk

    size = file.seek(0, SEEK_END)
    file.seek(start)
    head = file.read(41)
    if len(head) < 41 or head[0] != CHUNK:
        return None
    (length,) = struct.unpack_from("<Q", head, 1)
    begin, end, unpacked, checksum, letters = struct.unpack_from("<QQQII", head, 9)
    rest = file.read(letters + 8) if letters < 20 else b""
    announced = int.from_bytes(rest[letters:], "little")
    if len(rest) < letters + 8 or length != 40 + letters + announced or not file.tell() + announced > size or length > MOST_PIECE:
        return None
    return Chunk(rest[:letters].decode("ascii", "replace"), file.read(), end, begin, checksum, unpacked)
