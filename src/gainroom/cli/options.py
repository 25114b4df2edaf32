"""The options that every command has."""

import contextlib
import os
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
Report = Annotated[Path | None, typer.Option("--report", metavar="OUT.html", help="Also write a self-contained page.")]


def number_option(flag: str, unit: str, text: str, **others: Any) -> Any:
    """A typer.Option that takes a number; what is none is refused with the `unit` in words, which must not be typed."""

    def parse(value: object) -> float:
        try:
            return float(value)  # type: ignore[arg-type]
        except ValueError:
            written = f"a number {unit}, without the unit" if unit else "a number"
            raise typer.BadParameter(f"{str(value)[:60]!r} must be {written}", param_hint=f"'{flag}'") from None

    return typer.Option(flag, parser=parse, metavar=others.pop("metavar", "NUMBER"), help=text, **others)


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
