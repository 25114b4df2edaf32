"""The options that every command has."""

import contextlib
import os
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, TextIO

import typer

AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
Report = Annotated[Path | None, typer.Option("--report", metavar="OUT.html", help="Also write a self-contained page.")]


@contextlib.contextmanager
def report_stream(report: Path | None, inputs: Sequence[Path] = ()) -> Iterator[TextIO | None]:
    """Where the page goes, or None when none is asked for. A path that cannot be written fails before the work.

    Raises GainroomError, also where the page would overwrite one of `inputs`.
    """
    if report is None:
        yield None
        return
    from ..errors import GainroomError
    from ..io.atomic import replacing

    for path in inputs:
        if os.path.realpath(report) == os.path.realpath(path):
            raise GainroomError(f"{report}: the report would overwrite the input")
    with replacing(report) as stream:
        yield stream


def command_line(*words: str | Path | None) -> str:
    """The command that makes the same page again, for its last section."""
    text = shlex.join(["gainroom", *(str(word) for word in words if word is not None)])
    return text.encode("utf-8", "backslashreplace").decode()
