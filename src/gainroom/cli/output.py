"""Output of every command: strict JSON, numbers for people, tables, one-line messages."""

import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..errors import THIN, printable
from ..io.strict_json import strict
from ..report.number_format import MISSED, UNITS
from .streams import give_up
from .table_widths import KEPT, shared

if TYPE_CHECKING:
    from rich.table import Table

    from ..report.presentation import Part, Presentation

WIDTH = 80
"""Default width without a terminal [columns]."""
WIDEST = 100
"""Maximum width [columns]."""
SCREEN_LINES = 25
"""Maximum number of lines of an answer with a shorter form, which fits on the first screen of a terminal."""
UNBROKEN = "\ue000"
"""Placeholder of THIN while lines are broken, as KEPT is for spaces: rich would break a number there."""
NARROWEST = 40
"""Minimum width [columns]: a narrower table says nothing, and a terminal of unknown width may report 0 or 1."""


def emit(text: str) -> None:
    """Writes `text` to standard output, which may be closed, or close early, without harm. Raises GainroomError on any other failure."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except OSError as error:
        give_up(sys.stdout)
        if not isinstance(error, BrokenPipeError):
            from ..errors import GainroomError

            raise GainroomError(f"standard output: {(error.strerror or str(error)).lower()}") from error


def emit_json(value: Mapping[str, Any]) -> None:
    """Prints one strict JSON object: values that are not finite (infinite margin, margin of an unstable loop) become null."""
    emit(json.dumps(strict(value), indent=2, allow_nan=False) + "\n")


def show(as_json: bool, facts: Callable[[], Mapping[str, Any]], text: Callable[[], str]) -> None:
    """Prints the answer on standard output, for a program or for a person."""
    if as_json:
        emit_json(facts())
    else:
        emit(text())


def present(shown: "Presentation", as_json: bool, verbose: bool) -> None:
    """Prints a study on standard output."""
    show(as_json, shown.facts, lambda: _fitting(shown.screens(verbose)))


def _fitting(screens: "Iterable[Sequence[Part]]") -> str:
    """First screen with at most SCREEN_LINES lines, else the last one."""
    text = ""
    for parts in screens:
        text = render(*parts)
        if text.count("\n") <= SCREEN_LINES:
            break
    return text


def columns_wide() -> int:
    """Width to print to [columns]: the terminal's, within bounds; elsewhere COLUMNS, or WIDTH."""
    from rich.console import Console

    if sys.stdout is not None and sys.stdout.isatty():
        return min(WIDEST, max(NARROWEST, Console(file=sys.stdout).width))
    columns = os.environ.get("COLUMNS", "")
    return min(WIDEST, max(NARROWEST, int(columns))) if columns.isdecimal() and len(columns) < 6 else WIDTH


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], drops: Sequence[str] = (), wide: bool = False) -> "Table":
    """Plain table: words aligned left, numbers right; yes and no are coloured. For its width see table_widths.

    drops     headings of columns that may be left out, the first first
    wide      as wide as what is read at leisure
    """
    from rich import box
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    title, across = printable(title), WIDEST if wide else columns_wide()
    cells = [[*map(printable, column)] for column in zip(columns, *rows, strict=True)]
    places = [columns.index(name) for name in drops if name in columns]
    left, cells, gap = shared(cells, across, places, cell_len)
    lines = [max(cell_len(line) for text in column for line in text.split("\n")) for column in cells]
    total = sum(lines) + gap * (len(left) - 1) + 2
    look = {"title_justify": "left", "title_style": "bold", "box": box.SIMPLE_HEAD, "pad_edge": False, "collapse_padding": gap < 3}
    result = Table(title=title or None, min_width=max(min(len(title), across), total if total > across else 0), **look)
    for place, (heading, *_) in zip(left, cells, strict=True):
        result.add_column(heading, justify="right" if place else "left", no_wrap=True)
    styles = {"yes": "bold blue", "no": "bold yellow"}  # never red against green
    for row in zip(*(column[1:] for column in cells), strict=True):
        result.add_row(*(Text(cell, style=styles.get("no" if cell.startswith(MISSED) else cell, "")) for cell in row))
    return result


def headings(table: "Table") -> list[str]:
    """Columns that a table shows."""
    return [" ".join(str(column.header).split()) for column in table.columns]


def _drawn(part: "Part | Table") -> Any:
    """Text, unbroken line or table in rich's types."""
    from rich.text import Text

    from ..report.presentation import Legend, TextTable, Unwrapped

    if isinstance(part, TextTable):
        drawn = table(part.title, part.headings, part.rows, part.drops)
        return _drawn(part.shared(headings(drawn))) if part.shares else drawn
    if isinstance(part, Legend):
        return part.text([heading for one in part.tables for heading in headings(_drawn(one))])
    return Text(printable(part), no_wrap=True) if isinstance(part, Unwrapped) else part


def render(*parts: Any, wide: bool = False) -> str:
    """Text and tables for this terminal; plain if standard output is none, or NO_COLOR is set. `wide`: see table.

    What names out of files hold that a terminal would obey (escape sequences) is shown as ?.
    """
    from io import StringIO

    from rich.console import Console

    buffer = StringIO()
    terminal = sys.stdout is not None and sys.stdout.isatty()
    probe, across = Console(file=sys.stdout), WIDEST if wide else columns_wide()
    console = Console(
        file=buffer,
        width=across,
        force_terminal=terminal,
        no_color=probe.no_color or None,
        highlight=False,
        markup=False,
        emoji=False,
    )
    for part in map(_drawn, parts):
        if isinstance(part, str):
            part = UNITS.sub(KEPT, "\n".join(map(printable, part.split("\n"))).replace(THIN, UNBROKEN))
        console.width = max(across, getattr(part, "min_width", None) or 0)  # of a table whose numbers need more
        console.print(part, soft_wrap=bool(getattr(part, "no_wrap", False)))
    return "\n".join(line.rstrip() for line in buffer.getvalue().replace(UNBROKEN, THIN).replace(KEPT, " ").splitlines()) + "\n"
