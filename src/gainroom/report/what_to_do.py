"""What to do, as one record that terminal and page show: a sentence, lines to copy, and what else is said of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from .page import Html, advice, coded, copied, details


@dataclass(frozen=True)
class Advice:
    """`heading` says what to do, with a colon before `lines`, which can be typed; `remarks` follow. What stands in `…` is typed, too.

    folded   gains that are not to be used as they are: a heading that says so, and their lines; shown where all is
    """

    heading: str
    lines: Sequence[str] = ()
    remarks: Sequence[str] = ()
    folded: tuple[str, Sequence[str]] | None = None


def advice_box(found: Advice | None, *parts: str) -> Html | str:
    """On a page; "" where there is none. `parts` stand under it."""
    if found is None:
        return ""
    folded = [] if found.folded is None else [details(found.folded[0].replace("`", ""), copied(found.folded[1]))]
    return advice(coded(found.heading), "\n".join(found.lines), *map(coded, found.remarks), *parts, *folded)
