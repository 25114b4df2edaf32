"""Presentation: JSON keys and terminal lines of a study in one record, shared by command, page and app.

A further key of --json is one more entry in `facts` of the study's own record.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..system.plausibility import by_doubt
from .columns import Column, alike_rows, shared_row, tabulated

if TYPE_CHECKING:
    from .page import Advice


class Unwrapped(str):
    """Line of the terminal that is never wrapped: a path, or text to type or copy."""

    __slots__ = ()


@dataclass(frozen=True)
class TextTable:
    """Table of the terminal, as text.

    drops    headings of columns that may be left out for lack of room, the first first
    shares   True: rows that print alike share one (see `shared`)
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    drops: Sequence[str] = ()
    shares: bool = False

    @classmethod
    def of(cls, title: str, columns: Sequence[Column], rows: Iterable[Any], drops: Sequence[str] = ()) -> "TextTable":
        """Table of columns and rows."""
        return cls(title, *tabulated(columns, rows), drops)

    @property
    def sharing(self) -> "TextTable":
        """Table in which rows that print alike share one."""
        return replace(self, shares=True)

    def shared(self, shown: Sequence[str]) -> "TextTable":
        """Table of the columns `shown`, with one row for those that print alike under names that differ in one word."""
        places = [k for k, heading in enumerate(self.headings) if heading in shown]
        rows = [[row[k] for k in places] for row in self.rows]
        return replace(self, headings=[*shown], rows=[shared_row(rows, group) for group in alike_rows(rows)], shares=False)


@dataclass(frozen=True)
class Legend:
    """Text below tables; `text` takes the headings of the columns displayed."""

    tables: Sequence[TextTable]
    text: Callable[[Sequence[str]], str]


MOST_WARNINGS = 3
"""Most warnings on a terminal without --verbose."""
Part = str | TextTable | Legend
"""Part of a terminal answer: text to be wrapped, or a table or legend."""


@dataclass(frozen=True, kw_only=True)
class Presentation(ABC):
    """Study with everything displayed of it.

    call    the command that makes the study, without a page
    files   names of the files that the command writes, with their paths; None: not asked for
    """

    call: str = "gainroom COMMAND FILE"
    files: Mapping[str, Path | None] = field(default_factory=dict)

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """JSON object for --json."""

    @abstractmethod
    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        """Terminal answers, `verbose` or not, the longest first; the first that fits is displayed."""


def closing(
    files: Mapping[str, Path | None], warnings: Iterable[str] = (), assumed: Iterable[str] = (), notes: Iterable[str] = ()
) -> list[Part]:
    """Last lines of an answer; `files`: see Presentation."""
    written = [Unwrapped(f"{name}: {path}") for name, path in files.items() if path is not None]
    kinds = {"Assumed": assumed, "Warning": warnings, "Note": notes}
    return [*written, *(f"{kind}: {text}" for kind, texts in kinds.items() for text in texts)]


def warned_first(warnings: Sequence[str], every: bool) -> tuple[list[Part], list[str]]:
    """Warnings before the answer, which make its numbers doubtful; and the other warnings, with the number not displayed.

    every   True: all of either, not MOST_WARNINGS, so that many doubts hide nothing else
    """
    most = None if every else MOST_WARNINGS
    doubts, others = by_doubt(warnings)
    first, after = doubts[:most], others[:most]
    more = len(doubts) + len(others) - len(first) - len(after)
    return [*closing({}, first), ""] if first else [], [*after, *([f"{more} more: --verbose"] if more else [])]


def do_this(found: "Advice | None") -> list[Part]:
    """Advice as parts of the terminal: "Do this: …", lines to type, remarks, and commands for afterwards; [] without advice."""
    if found is None:
        return []
    plain = [text.replace("`", "") for text in (found.heading, *found.remarks)]
    then, lines = found.then or ("", ())
    return [f"Do this: {plain[0]}", *_typed(found.lines), *plain[1:], *filter(None, [then]), *_typed(lines)]


def folded(found: "Advice") -> list[Part]:
    """Gains that may not be used yet, displayed with --verbose only."""
    heading, lines = found.folded or ("", ())
    return [*filter(None, [heading.replace("`", "")]), *_typed(lines)]


def _typed(lines: Iterable[str]) -> list[Part]:
    return [Unwrapped(f"  {line}") for line in lines]
