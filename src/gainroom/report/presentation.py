"""A study as it is shown, in one record: the keys of --json and the lines of the terminal, for the command, the page and the app.

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


class Typed(str):
    """A line of the terminal that is not broken, however long: a path, or what is typed or copied."""

    __slots__ = ()


@dataclass(frozen=True)
class Grid:
    """A table of the terminal, as text.

    drops    headings of columns that may be left out where there is no room, the first first
    shares   rows that print alike share one (see `shared`)
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    drops: Sequence[str] = ()
    shares: bool = False

    @classmethod
    def of(cls, title: str, columns: Sequence[Column], rows: Iterable[Any], drops: Sequence[str] = ()) -> "Grid":
        """A table of columns."""
        return cls(title, *tabulated(columns, rows), drops)

    @property
    def sharing(self) -> "Grid":
        """The table in which rows that print alike share one."""
        return replace(self, shares=True)

    def shared(self, shown: Sequence[str]) -> "Grid":
        """The table of the columns `shown`, with one row for those that print alike there under names that differ in one word."""
        places = [k for k, heading in enumerate(self.headings) if heading in shown]
        rows = [[row[k] for k in places] for row in self.rows]
        return replace(self, headings=[*shown], rows=[shared_row(rows, group) for group in alike_rows(rows)], shares=False)


@dataclass(frozen=True)
class Legend:
    """A text below tables; `text` takes the headings of the columns that there was room for."""

    tables: Sequence[Grid]
    text: Callable[[Sequence[str]], str]


MOST_WARNINGS = 3
"""That a terminal shows without being asked for all."""
Part = str | Grid | Legend
"""A part of what the terminal shows: a text that is broken into lines, or what stands above."""


@dataclass(frozen=True, kw_only=True)
class Presentation(ABC):
    """A study with all that is shown of it.

    call    the command that makes the study, without a page: to go on from
    files   the names of what the command writes, with their paths; None where one is not asked for
    """

    call: str = "gainroom COMMAND FILE"
    files: Mapping[str, Path | None] = field(default_factory=dict)

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """The keys of --json."""

    @abstractmethod
    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        """The terminal's answer, `verbose` or not; of several the longest first, for the first that is short enough."""


def closing(
    files: Mapping[str, Path | None], warnings: Iterable[str] = (), assumed: Iterable[str] = (), notes: Iterable[str] = ()
) -> list[Part]:
    """The last lines of an answer; `files`: see Presentation."""
    written = [Typed(f"{name}: {path}") for name, path in files.items() if path is not None]
    kinds = {"Assumed": assumed, "Warning": warnings, "Note": notes}
    return [*written, *(f"{kind}: {text}" for kind, texts in kinds.items() for text in texts)]


def warned_first(warnings: Sequence[str], every: bool) -> tuple[list[Part], list[str]]:
    """Lines that stand before the answer, as what they warn of makes its numbers doubtful; the other warnings, and how many are not shown.

    every   all of either, not MOST_WARNINGS, so that many doubts hide nothing else
    """
    most = None if every else MOST_WARNINGS
    doubts, others = by_doubt(warnings)
    first, after = doubts[:most], others[:most]
    more = len(doubts) + len(others) - len(first) - len(after)
    return [*closing({}, first), ""] if first else [], [*after, *([f"{more} more: --verbose"] if more else [])]


def do_this(found: "Advice | None") -> list[Part]:
    """Advice as parts of the terminal: "Do this: …", the lines to type, remarks, and commands for afterwards; no parts without advice."""
    if found is None:
        return []
    plain = [text.replace("`", "") for text in (found.heading, *found.remarks)]
    then, lines = found.then or ("", ())
    return [f"Do this: {plain[0]}", *_typed(found.lines), *plain[1:], *filter(None, [then]), *_typed(lines)]


def folded(found: "Advice") -> list[Part]:
    """Gains that are shown only where all is, as they are not to be used as they are."""
    heading, lines = found.folded or ("", ())
    return [*filter(None, [heading.replace("`", "")]), *_typed(lines)]


def _typed(lines: Iterable[str]) -> list[Part]:
    return [Typed(f"  {line}") for line in lines]
