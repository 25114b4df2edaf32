"""Words for messages: on one line, printable, and no longer than a person reads."""

import difflib
from collections.abc import Sequence

MOST_SHOWN = 8
"""Names in one message."""


def printable(text: str) -> str:
    """`text` on one line: white space as spaces, and what else a terminal cannot show as ?."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)


def one_line(message: object, most: int = 240) -> str:
    """A library's message, or a value, inside one of ours: printable, runs of white space as one, at most `most` characters."""
    text = " ".join(printable(str(message)).split())
    return text if len(text) <= most else text[: most - 1] + "…"


def first_of_many(items: Sequence[str]) -> str:
    """The first of many things, and how many there are."""
    return ", ".join(items[:MOST_SHOWN]) + (f", … {len(items)} in all" if len(items) > MOST_SHOWN else "")


def nearest(name: str, names: Sequence[str], kind: str) -> str:
    """What may have been meant, and what there is: the end of a message about an unknown name."""
    close = difflib.get_close_matches(name, names, 1, cutoff=0.5)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"{hint} ({kind}s: {first_of_many(names) or 'none'})"
