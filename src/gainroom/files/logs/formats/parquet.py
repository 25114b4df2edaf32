"""Parquet, through pyarrow: row group by row group, only the columns asked for."""

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


class ParquetSink:
    """One row group per block; its index comes last, so that nothing can be read before it is closed."""

    def __init__(self, path: Path) -> None:
        self._arrow: Any = library("pyarrow", "pyarrow.parquet")
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


class ParquetTable(Table):
    """The columns of numbers of a Parquet file; others are left out."""

    def __init__(self, path: Path, arrow: Any, file: Any) -> None:
        super().__init__()
        self._path, self._arrow, self._file = path, arrow, file
        schema = file.schema_arrow
        bounded(path, "number of columns", len(schema), MOST_COLUMNS)
        bounded(path, "number of rows", file.metadata.num_rows, MOST_ROWS)
        kept = {field.name: unit for field in schema if (unit := self._unit(field)) is not None}
        self.columns = [Column(name, unit=unit) for name, unit in kept.items() if schema.names.count(name) == 1]
        others = [name for name in schema.names if name not in kept]
        self.notes = [f"columns without numbers: {first_of_many(others)}"] if others else []

    def _unit(self, field: Any) -> str | None:
        """What the file says of a column of numbers; None for one of something else."""
        types, kind = self._arrow.types, field.type
        if types.is_timestamp(kind) or types.is_duration(kind):
            return kind.unit
        if not (types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind)):
            return None
        said = {key.lower(): value for key, value in (field.metadata or {}).items()}
        text = said.get(b"unit", said.get(b"units", b"")).decode("utf-8", "replace")
        with contextlib.suppress(ValueError):
            text = str(json.loads(text))
        return text

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        if not names:
            return
        metadata = self._file.metadata
        for group in range(metadata.num_row_groups):
            chunks = [metadata.row_group(group).column(k) for k in range(metadata.num_columns)]
            for chunk in chunks:
                if chunk.path_in_schema in names:
                    for size in page_sizes(self._path, chunk):
                        bounded(self._path, f"uncompressed page of column {chunk.path_in_schema}:", size, MOST_PIECE, " bytes")
        self.taken_off = {}
        for batch in self._file.iter_batches(batch_size=BLOCK_ROWS, columns=list(names), use_threads=False):
            yield [self._values(name, batch.column(name)) for name in names]

    def _values(self, name: str, column: Any) -> Floats:
        if self._arrow.types.is_temporal(column.type):
            column = column.cast(self._arrow.int64())
        if self._arrow.types.is_integer(column.type) and not column.null_count and len(column):
            return whole_numbers(name, column.to_numpy(), self.taken_off)
        return np.asarray(column.cast(self._arrow.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=float)


class Parquet(LogFormat):
    """Apache Parquet."""

    title = "a Parquet file"
    endings = (".parquet", ".pq")
    makes = ParquetSink

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        arrow = library("pyarrow", "pyarrow.parquet")
        checked_file(path)
        # A footer may announce any number of strings: each takes a byte at least in what is read of it.
        limits = {"thrift_string_size_limit": MOST_PIECE, "thrift_container_size_limit": MOST_COLUMNS * 100}
        with arrow.parquet.ParquetFile(path, pre_buffer=False, **limits) as file:
            yield ParquetTable(path, arrow, file)
