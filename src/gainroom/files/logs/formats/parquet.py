"""Parquet, through pyarrow: row group by row group, only the columns asked for.

pyarrow ends its process on some damaged files: a guarded child reads.
"""

import contextlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import first_of_many
from ....system.linear.arrays import Floats
from ..table import (
    BLOCK_ROWS,
    MOST_COLUMNS,
    MOST_PIECE,
    MOST_ROWS,
    Column,
    LogFormat,
    Table,
    bounded,
    checked_file,
    column_names,
    library,
    whole_numbers,
)
from .parquet_pages import page_sizes
from .ros_types import MOST_ENTRIES
from .text_times import TextClock, times_in

PROBED = 100
"""Rows that show how long the lists of a column are."""


class ParquetSink:
    """Writer of a log as Parquet, one row group per block; the index comes last, so that nothing can be read before it is closed."""

    def __init__(self, path: Path) -> None:
        self._arrow: Any = library("pyarrow", "pyarrow.parquet")
        self._file = open(path, "wb")  # noqa: SIM115 - closed in close()

    def begin(self, joints: Sequence[str], signals: Sequence[str]) -> None:
        names = column_names(joints, signals)
        self._schema = self._arrow.schema([(name, self._arrow.float64()) for name in names])
        self._writer: Any = self._arrow.parquet.ParquetWriter(self._file, self._schema, write_page_checksum=True)

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


class ParquetTable(Table):
    """The columns of numbers of a Parquet file; others are left out.

    A column of lists is several, `action[0]`, `action[1]`, …, as many as the longest of its first lists has entries.
    """

    def __init__(self, path: Path, arrow: Any, file: Any) -> None:
        super().__init__()
        self._path, self._arrow, self._file = path, arrow, file
        schema = file.schema_arrow
        bounded(path, "number of columns", len(schema), MOST_COLUMNS)
        bounded(path, "number of rows", file.metadata.num_rows, MOST_ROWS)
        columns: list[Column] = []
        self._places: dict[str, tuple[str, int | None]] = {}
        others = []
        for field in schema:
            unit = self._unit(field, field.type) if schema.names.count(field.name) == 1 else None
            if unit is None and schema.names.count(field.name) == 1 and self._holds_times(field):
                unit = "s"
            for name, place in self._parts(field) if unit is not None else ():
                if self._places.setdefault(name, (field.name, place)) == (field.name, place):
                    columns.append(Column(name, unit=unit or ""))
            bounded(path, "number of columns", len(columns), MOST_COLUMNS)
            if field.name not in {own for own, _ in self._places.values()}:
                others.append(field.name)
        self.columns = columns
        self.notes = [f"columns without numbers: {first_of_many(others)}"] if others else []

    def _is_text(self, kind: Any) -> bool:
        return self._arrow.types.is_string(kind) or self._arrow.types.is_large_string(kind)

    def _holds_times(self, field: Any) -> bool:
        """True if a column of texts holds times, by its first rows."""
        if not self._is_text(field.type):
            return False
        self._check_pages([field.name])
        first = next(self._file.iter_batches(batch_size=PROBED, columns=[field.name], use_threads=False), None)
        return first is not None and times_in(first.column(0).to_pylist()) is not None

    def _is_list(self, kind: Any) -> bool:
        types = self._arrow.types
        return types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)

    def _unit(self, field: Any, kind: Any) -> str | None:
        """Unit ("" for none) of a column of numbers, or of lists of numbers; None for any other column."""
        types = self._arrow.types
        if self._is_list(kind):
            kind = kind.value_type
        elif types.is_timestamp(kind) or types.is_duration(kind):
            return kind.unit
        if not (types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind)):
            return None
        said = {key.lower(): value for key, value in (field.metadata or {}).items()}
        text = said.get(b"unit", said.get(b"units", b"")).decode("utf-8", "replace")
        with contextlib.suppress(ValueError):
            text = str(json.loads(text))
        return text

    def _parts(self, field: Any) -> list[tuple[str, int | None]]:
        """Names of the columns that a field makes, each with its index in the field's lists; None for a plain field."""
        if not self._is_list(field.type):
            return [(field.name, None)]
        self._check_pages([field.name])
        first = next(self._file.iter_batches(batch_size=PROBED, columns=[field.name], use_threads=False), None)
        length = 0 if first is None else int(np.max(self._lengths(first.column(0)), initial=0))
        return [(f"{field.name}[{k}]", k) for k in range(length)] if length <= MOST_ENTRIES else []

    def _check_pages(self, fields: Sequence[str]) -> None:
        metadata = self._file.metadata
        for group in range(metadata.num_row_groups):
            for chunk in (metadata.row_group(group).column(k) for k in range(metadata.num_columns)):
                if chunk.path_in_schema in fields or chunk.path_in_schema.rsplit(".", 2)[0] in fields:  # `action.list.element`
                    for size in page_sizes(self._path, chunk):
                        bounded(self._path, f"uncompressed page of column {chunk.path_in_schema}:", size, MOST_PIECE, " bytes")

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        if not names:
            return
        fields = [*dict.fromkeys(self._places[name][0] for name in names)]
        self._check_pages(fields)
        self.taken_off = {}
        clocks: dict[str, TextClock] = {}
        rows = min(BLOCK_ROWS, MOST_PIECE // (8 * len(names)))
        for batch in self._file.iter_batches(batch_size=rows, columns=fields, use_threads=False):
            found: dict[str, Floats] = {}
            for field in fields:
                wanted = {name: self._places[name][1] for name in names if self._places[name][0] == field}
                if self._is_text(batch.column(field).type):
                    clock = clocks.setdefault(field, TextClock())
                    found[field] = clock.seconds([text or "" for text in batch.column(field).to_pylist()])
                    self.taken_off[field] = float(clock.base or 0)
                else:
                    found |= self._values(field, batch.column(field), wanted)
            yield [found[name] for name in names]

    def _values(self, field: str, column: Any, wanted: dict[str, int | None]) -> dict[str, Floats]:
        """Values of the `wanted` columns of one field, by column name."""
        if self._is_list(column.type):
            return _entries(self._floats(column.flatten()), self._lengths(column), wanted)
        if self._arrow.types.is_temporal(column.type):
            column = column.cast(self._arrow.int64())
        if self._arrow.types.is_integer(column.type) and not column.null_count and len(column):
            return {field: whole_numbers(field, column.to_numpy(), self.taken_off)}
        return {field: self._floats(column)}

    def _lengths(self, column: Any) -> Any:
        """Lengths (k,) of the lists in a column; 0 where a list is missing."""
        lengths = self._arrow.compute.list_value_length(column)
        return np.asarray(self._arrow.compute.fill_null(lengths, 0).to_numpy(zero_copy_only=False), dtype=np.int64)

    def _floats(self, column: Any) -> Floats:
        return np.asarray(column.cast(self._arrow.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)


def _entries(flat: Floats, lengths: Any, wanted: dict[str, int | None]) -> dict[str, Floats]:
    """Columns by name: entry wanted[name] of each list, NaN where a list is shorter; `flat` holds the lists one after the other."""
    starts = np.cumsum(lengths) - lengths
    found = {}
    for name, place in wanted.items():
        there = lengths > place
        found[name] = np.full(len(lengths), np.nan)
        found[name][there] = flat[starts[there] + place]
    return found


class Parquet(LogFormat):
    """Reader of logs in Apache Parquet files."""

    name = "Parquet"
    title = "a Parquet file"
    endings = (".parquet", ".pq")
    makes = ParquetSink

    def is_guarded(self, path: Path) -> bool:
        return True

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        arrow = library("pyarrow", "pyarrow.parquet", "pyarrow.compute")
        checked_file(path)
        arrow.set_memory_pool(arrow.system_memory_pool())  # others reserve addresses, which are bounded
        # A footer may announce any number of strings: each takes a byte at least in what is read of it.
        limits = {"thrift_string_size_limit": MOST_PIECE, "thrift_container_size_limit": MOST_COLUMNS * 100}
        with arrow.parquet.ParquetFile(path, pre_buffer=False, page_checksum_verification=True, **limits) as file:
            yield ParquetTable(path, arrow, file)
