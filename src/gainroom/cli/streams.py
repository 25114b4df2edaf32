"""Standard streams that may be closed, full, or abandoned by their reader: the answer and its status stay the same."""

import contextlib
import io
import os
import sys

TYPE_CHECKING = False  # as in the package itself
if TYPE_CHECKING:
    from typing import TextIO


def open_closed() -> None:
    """Opens the null device for standard streams that are closed: a file of ours must not take their place."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", errors="replace", closefd=False))  # noqa: SIM115 - for good


def show_everything() -> None:
    """Lets a terminal without some character print a replacement."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def say(line: str) -> None:
    """Writes one line to standard error, which may be closed or full."""
    try:
        print(line, file=sys.stderr or io.StringIO(), flush=True)
    except OSError:
        give_up(sys.stderr)


def give_up(stream: "TextIO | None") -> None:
    """Redirects `stream` to the null device: the rest of its buffer would fail again at exit."""
    if stream is None:
        return
    with contextlib.suppress(OSError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
