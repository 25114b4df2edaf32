"""What to do, as one record that terminal and page show: a sentence, lines to copy, and what else is said of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from .page import Html, advice, coded


@dataclass(frozen=True)
class Advice:
    """`heading` says what to do, with a colon before `lines`, which can be typed; `remarks` follow. What stands in `…` is typed, too."""

    heading: str
    lines: Sequence[str] = ()
    remarks: Sequence[str] = ()


def advice_box(found: Advice | None, *parts: str) -> Html | str:
    """On a page; "" where there is none. `parts` stand under it."""
    if found is None:
        return ""
    return advice(coded(found.heading), "\n".join(found.lines), *map(coded, found.remarks), *parts)
