"""Parquet, through pyarrow in a process of its own: row group by row group, only the columns asked for."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....system.linear.arrays import Floats
from ..table import BLOCK_ROWS, Column, LogFormat, Table, checked_file, column_names, library
from .apart import Apart, apart


class ParquetSink:
    """One row group per block; its index comes last, so that nothing can be read before it is closed."""

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
    """The columns of numbers of a Parquet file; others are left out."""

    def __init__(self, process: Apart) -> None:
        super().__init__()
        self._process = process
        self.columns = [Column(name, unit=unit) for name, unit in process.about["columns"]]
        self.notes = process.about["notes"]

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        if not names:
            return
        answer = self._process.ask({"names": [*names], "rows": BLOCK_ROWS})
        while "shape" in answer:
            self.taken_off = answer["taken_off"]
            yield list(self._process.numbers(answer))
            answer = self._process.ask({})


class Parquet(LogFormat):
    """Apache Parquet."""

    title = "a Parquet file"
    endings = (".parquet", ".pq")
    makes = ParquetSink

    @contextlib.contextmanager
    def table(self, path: Path, time: str | None) -> Iterator[Table]:
        library("pyarrow", "pyarrow.parquet")
        checked_file(path)
        with apart(path, self.title, "parquet_contents") as process:
            yield ParquetTable(process)
