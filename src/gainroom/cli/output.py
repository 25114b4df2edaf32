"""Output of every command: strict JSON, numbers for people, tables, one-line messages."""

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any

from ..errors import THIN, printable
from ..io.strict_json import strict
from ..report.number_format import MISSED, UNITS
from .streams import give_up

if TYPE_CHECKING:
    from rich.table import Table

    from ..report.presentation import Part, Presentation

WIDTH = 80
"""Default width without a terminal [columns]."""
WIDEST = 100
"""Maximum width [columns]."""
SCREEN_LINES = 25
"""Maximum number of lines of an answer with a shorter form, which fits on the first screen of a terminal."""
UNBROKEN_THIN = "\ue000"
"""Placeholder of THIN while lines are broken, as UNBROKEN_SPACE is for spaces: rich would break a number there."""
NARROWEST = 40
"""Minimum width [columns]: a narrower table says nothing, and a terminal of unknown width may report 0 or 1."""
UNBROKEN_SPACE = "\ue001"
"""Placeholder of a space at which no line is broken, as those in UNITS."""
LONG_WORD = 28
"""Length above which a word, such as a name, is broken before a column is left out."""
SHORT_WORD = 8
"""Length above which a word is broken if the table is too wide even without the columns that may be left out."""
_NUMBER = re.compile(r"\W*\d")
_BEHIND_SLASH = re.compile(r"( +|(?<=\w{3}/)(?=\w{3}))")  # between posture and contact; not inside a unit
Columns = Sequence[Sequence[str]]
"""Heading and cells of each column."""
NARROW = 80
"""Width below which columns are left out before text is broken into lines, which would be hard to read."""


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
    """Plain table: words aligned left, numbers right; yes and no are coloured. For its width see shared_widths.

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
    left, cells, gap = shared_widths(cells, across, places, cell_len)
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
            part = UNITS.sub(UNBROKEN_SPACE, "\n".join(map(printable, part.split("\n"))).replace(THIN, UNBROKEN_THIN))
        console.width = max(across, getattr(part, "min_width", None) or 0)  # of a table whose numbers need more
        console.print(part, soft_wrap=bool(getattr(part, "no_wrap", False)))
    return (
        "\n".join(line.rstrip() for line in buffer.getvalue().replace(UNBROKEN_THIN, THIN).replace(UNBROKEN_SPACE, " ").splitlines()) + "\n"
    )


def shared_widths(
    columns: Columns, across: int, drops: Sequence[int], measure: Callable[[str], int]
) -> tuple[list[int], list[list[str]], int]:
    """Indices of the columns shown; their texts in lines; and the number of blanks between two columns.

    across    the width of all, the edges of a table with them
    drops     places of columns that are left out where whole words find no room, the first first
    measure   the width of a text

    No number is broken or cut: where not even the numbers find room, the table is wider than `across`.
    """
    left, drops = list(range(len(columns))), list(drops)
    widest = [max(map(measure, column)) for column in columns]
    least = [_least(column, LONG_WORD, measure) for column in columns]

    def total(widths: Sequence[int], gap: int) -> int:
        return sum(widths[k] for k in left) + gap * (len(left) - 1) + 2

    whole = [widest[0], *least[1:]]  # columns are left out before names are broken
    while total(widest if across < NARROW else whole, 2) > across and drops:
        left.remove(drops.pop(0))
    if total(widest, 3) <= across:
        return left, [list(columns[k]) for k in left], 3
    if total(least, 2) > across:
        least = [_least(column, SHORT_WORD, measure) for column in columns]
    widths = [min(width, across) for width in widest]
    while total(widths, 2) > across:
        k = max(left, key=lambda k: widths[k] if widths[k] > least[k] else 0)
        if widths[k] <= least[k]:
            break
        widths[k] -= 1
    return left, [[_lines(text, widths[k]) for text in columns[k]] for k in left], 2


def _least(column: Sequence[str], longest: int, measure: Callable[[str], int]) -> int:
    """Width that whole numbers need, and words up to the `longest`."""
    parts = [part for text in column for part in _unbroken_units(text).split(" ")]
    return max(measure(part) if _NUMBER.match(part) else min(measure(part), longest) for part in parts)


def _lines(text: str, width: int) -> str:
    """`text` in lines of `width`."""
    if len(text) <= width:
        return text
    wrapper = TextWrapper(width, break_on_hyphens=False)
    wrapper.wordsep_simple_re = _BEHIND_SLASH
    return "\n".join(wrapper.wrap(_unbroken_units(text))).replace(UNBROKEN_SPACE, " ")


def _unbroken_units(text: str) -> str:
    return UNITS.sub(UNBROKEN_SPACE, text)
