"""Tables in files, grown block by block: CSV, Parquet, MCAP. What the columns mean stands in logs.py."""

import contextlib
import csv
import json
import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Floats

Table = dict[str, Floats]
"""Columns (k,) by name."""


class Sink(Protocol):
    """A file that is being written."""

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        """Say what the rows will hold."""

    def rows(self, time: Floats, signals: Sequence[Floats]) -> None:
        """Add rows: time (k,), and per signal (k, n)."""

    def close(self) -> None:
        """Finish the file, however much of it there is."""


def column_names(joints: Sequence[str], signals: Sequence[str]) -> list[str]:
    """`time`, then signal by signal; with several joints each with its joint's name."""
    return ["time", *(signal if len(joints) == 1 else f"{signal}_{joint}" for signal in signals for joint in joints)]


class CsvSink:
    """Text, one line per row, numbers with all their digits; every block is flushed."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, "w", encoding="utf-8", newline="")  # noqa: SIM115 - closed in close()

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        csv.writer(self._file, lineterminator="\n").writerow(column_names(joints, signals))

    def rows(self, time: Floats, signals: Sequence[Floats]) -> None:
        table = np.hstack([time[:, None], *signals])
        self._file.writelines(",".join(map(repr, row)) + "\n" for row in table.tolist())
        self._file.flush()

    def close(self) -> None:
        self._file.close()


class ParquetSink:
    """One row group per block; its index comes last, so that nothing can be read before it is closed."""

    def __init__(self, path: Path) -> None:
        self._arrow: Any = _library("pyarrow", "pyarrow.parquet")
        self._file = open(path, "wb")  # noqa: SIM115 - closed in close()

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        names = column_names(joints, signals)
        self._schema = self._arrow.schema([(name, self._arrow.float64()) for name in names])
        self._writer: Any = self._arrow.parquet.ParquetWriter(self._file, self._schema)

    def rows(self, time: Floats, signals: Sequence[Floats]) -> None:
        table = np.hstack([time[:, None], *signals])
        self._writer.write_table(
            self._arrow.Table.from_arrays([self._arrow.array(values) for values in table.T.copy()], schema=self._schema)
        )

    def close(self) -> None:
        try:
            self._writer.close()
        finally:
            self._file.close()


class McapSink:
    """One topic per joint with JSON messages, stamped with the run's own time; every block is flushed as a chunk."""

    def __init__(self, path: Path) -> None:
        library = _library("mcap", "mcap.writer")
        self._file = open(path, "wb")  # noqa: SIM115 - closed in close()
        self._writer = library.writer.Writer(self._file)
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


def read_csv(path: Path) -> tuple[Table, bool]:
    """Columns, and whether the last line is whole; one that is not is left out."""
    with open(path, encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        try:
            header = [name.strip() for name in next(reader, [])]
            lines = [line for line in reader if line]
        except (csv.Error, UnicodeDecodeError) as error:
            raise GainroomError(f"{path}: line {reader.line_num + 1} is not CSV in UTF-8") from error
    if not any(header):
        raise GainroomError(f"{path}: is empty; its first line must name the columns")
    if len(set(header)) != len(header):
        raise GainroomError(f"{path}: column {next(name for name in header if header.count(name) > 1)!r} is there twice")
    complete = _ends_in_newline(path)
    if not complete and lines:
        lines.pop()  # half a number can still look like one
    table = np.empty((len(lines), len(header)))
    for k, line in enumerate(lines):
        if len(line) != len(header):
            raise GainroomError(f"{path}: row {k + 1} has {len(line)} fields, not the {len(header)} of the first line")
        try:
            table[k] = line
        except ValueError:
            wrong = next(name for name, field in zip(header, line, strict=True) if not _is_number(field))
            field = line[header.index(wrong)]
            raise GainroomError(f"{path}: {wrong} in row {k + 1}: {field[:40]!r} is not a number") from None
    return dict(zip(header, table.T, strict=True)), complete


def _ends_in_newline(path: Path) -> bool:
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        if file.tell() == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) in b"\r\n"


def _is_number(field: str) -> bool:
    with contextlib.suppress(ValueError):
        float(field)
        return True
    return False


def read_parquet(path: Path) -> tuple[Table, bool]:
    """Columns of numbers, others left out; a Parquet file is always whole."""
    arrow: Any = _library("pyarrow", "pyarrow.parquet")
    try:
        table = arrow.parquet.read_table(path)
        kinds = enumerate(zip(table.schema.names, table.schema.types, strict=True))
        numeric = [(k, name) for k, (name, kind) in kinds if arrow.types.is_floating(kind) or arrow.types.is_integer(kind)]
        return {name: np.asarray(table.column(k).to_numpy(), dtype=float) for k, name in numeric}, True
    except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError, UnicodeDecodeError) as error:
        raise GainroomError(f"{path}: is not a Parquet file that can be read: {one_line(error)}") from error


def read_mcap(path: Path) -> tuple[Table, bool]:
    """Numbers in JSON messages, by their topic where there are several; `time` from the messages, else their log time."""
    _library("mcap", "mcap.stream_reader")
    from mcap.exceptions import EndOfFile, McapError
    from mcap.records import Channel, Message
    from mcap.stream_reader import CRCValidationError, StreamReader
    from zstandard import ZstdError

    topics: dict[int, str] = {}
    messages: dict[str, list[dict[str, float]]] = {}
    complete = True
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=path.stat().st_size).records:
                if isinstance(record, Channel) and record.message_encoding == "json":
                    topics[record.id] = record.topic.strip("/")
                elif isinstance(record, Message) and record.channel_id in topics:
                    messages.setdefault(topics[record.channel_id], []).append(_numbers(path, record))
        except (EndOfFile, struct.error):
            complete = False
        except (McapError, CRCValidationError, UnicodeDecodeError, ZstdError, RuntimeError, MemoryError) as error:
            raise GainroomError(f"{path}: is not an MCAP file that can be read: {one_line(error)}") from error
    if not messages:
        raise GainroomError(f"{path}: holds no JSON messages")
    return _merged(path, messages), complete


def _numbers(path: Path, message: Any) -> dict[str, float]:
    try:
        content = json.loads(message.data)
    except ValueError as error:
        raise GainroomError(f"{path}: a message at {message.log_time / 1e9:g} s is not JSON") from error
    if not isinstance(content, dict):
        raise GainroomError(f"{path}: a message at {message.log_time / 1e9:g} s is not a JSON object")
    numbers = {name: float(value) for name, value in content.items() if isinstance(value, int | float) and not isinstance(value, bool)}
    return {"time": message.log_time / 1e9} | numbers


def _merged(path: Path, messages: dict[str, list[dict[str, float]]]) -> Table:
    """One table from topics that have the same times; a last tick that not every topic has is left out."""
    count = min(len(rows) for rows in messages.values())
    first = next(iter(messages.values()))
    table = {"time": np.array([row["time"] for row in first[:count]])}
    for topic, rows in messages.items():
        names = rows[0].keys()
        if any(row.keys() != names for row in rows[:count]):
            raise GainroomError(f"{path}: the messages of topic {topic!r} do not all have the fields {', '.join(names)}")
        if max(len(rows) for rows in messages.values()) > count + 1 or any(
            row["time"] != t for row, t in zip(rows, table["time"], strict=False)
        ):
            raise GainroomError(f"{path}: topics {', '.join(messages)} do not have the same times")
        for name in names:
            if name != "time":
                table[name if len(messages) == 1 else f"{name}_{topic}"] = np.array([row[name] for row in rows[:count]])
    return table


def _library(name: str, *modules: str) -> Any:
    """An optional library with its modules. Raises GainroomError where it is not installed."""
    from importlib import import_module

    try:
        for module in modules:
            import_module(module)
        return import_module(name)
    except ImportError as error:
        raise GainroomError(f"this kind of log needs {name}: pip install 'gainroom[logs]'") from error


def one_line(error: object) -> str:
    """What another library says, on one line."""
    return " ".join(str(error).split())[:120] or type(error).__name__


WRITERS: dict[str, Callable[[Path], Sink]] = {".csv": CsvSink, ".parquet": ParquetSink, ".mcap": McapSink}
READERS: dict[str, Callable[[Path], tuple[Table, bool]]] = {".csv": read_csv, ".parquet": read_parquet, ".mcap": read_mcap}
