"""A log's table, opened in this process, or in a guarded child where a library parses the file (LogFormat.is_guarded).

Requests to the child: {"names", "held"} as of Table.blocks, answered by the first rows as (columns, rows); {} by the next ones, and by no
array after the last. Every answer has what reading has changed of the table.
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....io.guarded_child import MOST_ARRAY, Answer, GuardedChild, Handler, guarded_child
from ....system.linear.arrays import Floats
from ..table import Column, LogFormat, Table, guarded
from . import format_of


@contextlib.contextmanager
def opened_table(form: LogFormat, path: Path, time: str | None) -> Iterator[Table]:
    """Table of a log, as LogFormat.table gives it, from a guarded child if the format asks for one. Raises GainroomError."""
    if form.is_guarded(path):
        episode = "" if form.episode is None else str(form.episode)
        with guarded_child(path, form.title, __name__, time or "", episode) as child:
            yield _GuardedTable(child)
    else:
        with form.table(path, time) as table:
            yield table


class _GuardedTable(Table):
    """Table whose blocks are read from the table that a guarded child has open."""

    def __init__(self, child: GuardedChild) -> None:
        super().__init__()
        self._child = child
        self.columns = [Column(*column) for column in child.about["columns"]]
        self._take(child.about)

    def _take(self, answer: dict[str, Any]) -> None:
        self.complete, self.share, self.taken_off = answer["complete"], answer["share"], answer["taken_off"]
        self.notes[:] = answer["notes"]

    def blocks(self, names: Sequence[str], held: Sequence[str] = ()) -> Iterator[list[Floats]]:
        if not names:
            return
        answer, rows = self._child.ask({"names": [*names], "held": [*held]})
        while rows is not None:
            self._take(answer)
            yield [*rows]
            answer, rows = self._child.ask({})
        self._take(answer)


@contextlib.contextmanager
def opened(path: Path, time: str, episode: str) -> Iterator[tuple[dict[str, Any], Handler]]:
    """Description of a log's table, opened in the child, and the handler of requests for its blocks.

    time, episode   as LogFormat.table and of_episode have them; "" where they are not given
    """
    form = format_of(path)
    form = form.of_episode(path, int(episode)) if episode else form
    with guarded(path, form.title), form.table(path, time or None) as table:
        blocks: Iterator[Floats] = iter(())

        def rows_of(request: Any) -> Answer:
            nonlocal blocks
            if request:
                blocks = _pieces(table.blocks(request["names"], request["held"]), len(request["names"]))
            rows = next(blocks, None)
            return _state(table), rows

        yield {"columns": [[one.name, one.label, one.joint, one.unit, one.commanded] for one in table.columns], **_state(table)}, rows_of


def _state(table: Table) -> dict[str, Any]:
    """Fields of a table that reading changes."""
    return {"complete": table.complete, "share": table.share, "taken_off": table.taken_off, "notes": table.notes}


def _pieces(blocks: Iterator[list[Floats]], columns: int) -> Iterator[Floats]:
    """Blocks as arrays (columns, rows), in parts where one is too large for an answer."""
    most = max(MOST_ARRAY // (8 * columns), 1)
    for block in blocks:
        for first in range(0, max(len(block[0]), 1), most):
            yield np.array([values[first : first + most] for values in block], dtype=float)
