"""Widths of a table's columns in a terminal: columns of words wrap, numbers stay whole."""

import re
from collections.abc import Callable, Sequence
from textwrap import TextWrapper

from ..report.number_format import UNITS

KEPT = "\ue001"
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


def shared(columns: Columns, across: int, drops: Sequence[int], measure: Callable[[str], int]) -> tuple[list[int], list[list[str]], int]:
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

    while total(widest if across < NARROW else least, 2) > across and drops:
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
    parts = [part for text in column for part in _kept(text).split(" ")]
    return max(measure(part) if _NUMBER.match(part) else min(measure(part), longest) for part in parts)


def _lines(text: str, width: int) -> str:
    """`text` in lines of `width`."""
    if len(text) <= width:
        return text
    wrapper = TextWrapper(width, break_on_hyphens=False)
    wrapper.wordsep_simple_re = _BEHIND_SLASH
    return "\n".join(wrapper.wrap(_kept(text))).replace(KEPT, " ")


def _kept(text: str) -> str:
    return UNITS.sub(KEPT, text)
