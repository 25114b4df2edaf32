"""The options that every command has."""

import contextlib
import os
import shlex
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="All there is to know, not only what matters first.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit status 1 also where a requirement is not met.")]
Report = Annotated[Path | None, typer.Option("--report", metavar="OUT.html", help="Also write a self-contained page.")]


def number_option(flag: str, unit: str, text: str, **others: Any) -> Any:
    """A typer.Option that takes a number; what is none is refused, with the `unit` as text, which must not be typed."""

    def parse(value: object) -> float:
        try:
            return float(value)  # type: ignore[arg-type]
        except ValueError:
            written = f"a number {unit}, without the unit" if unit else "a number"
            raise typer.BadParameter(f"{str(value)[:60]!r} must be {written}", param_hint=f"'{flag}'") from None

    return typer.Option(flag, parser=parse, metavar=others.pop("metavar", "NUMBER"), help=text, **others)


@contextlib.contextmanager
def report_stream(report: Path | None, other: Path | None = None) -> Iterator[StringIO | None]:
    """What takes the page, or None when none is asked for; it is written when the block ends well, in the place of an older one.

    A path that cannot be written, or that would take the place of anything read so far or of `other`, is refused before the work. The
    answer is printed inside the block, so that it is there even if the page cannot be.

    Raises GainroomError.
    """
    if report is None:
        yield None
        return
    from ..errors import GainroomError
    from ..io.atomic import replacement, writing

    refuse_inputs(report, "report")
    if other is not None and os.path.realpath(report) == os.path.realpath(other):
        raise GainroomError(f"{report}: the report would overwrite another file that this command writes")
    with replacement(report) as temporary:
        page = StringIO()
        yield page
        with writing(report):
            temporary.write_text(page.getvalue(), "utf-8", newline="\n")


@contextlib.contextmanager
def yaml_output(output: Path | None, option: str, what: str) -> Iterator[Path | None]:
    """A new file that takes the place of `output`, `what` (a joint.yaml), when the block ends well; None where none is asked for.

    Raises GainroomError before the work where it cannot be.
    """
    if output is None:
        yield None
        return
    from ..errors import GainroomError
    from ..io.atomic import replacement

    refuse_inputs(output, what)
    if output.suffix not in (".yaml", ".yml"):
        raise GainroomError(f"{output}: {option} must end in .yaml")
    with replacement(output) as temporary:
        yield temporary


def refuse_inputs(path: Path, what: str) -> None:
    """Raise GainroomError where `path` is a file that has been read, by whatever name: `what` is to be written there."""
    from ..errors import GainroomError
    from ..io.run_files import read_as

    name = read_as(path)
    if name is not None:
        raise GainroomError(f"{path}: the {what} would overwrite the input" + (f" {name}" if name != str(path) else ""))


def command_line(*words: str | Path | tuple[str, Any]) -> str:
    """The command that makes the same page again, for its last section; an option is (flag, value), left out where the value is None."""
    typed: list[Any] = ["gainroom"]
    for word in words:
        typed += [word] if not isinstance(word, tuple) else [*word] if word[1] is not None else []
    text = shlex.join(repr(word).removesuffix(".0") if isinstance(word, float) else str(word) for word in typed)
    return text.encode("utf-8", "backslashreplace").decode()


def kind_of(file: Path) -> Literal["joint", "robot"]:
    """By its sections; what cannot be told is refused as a joint's. Raises GainroomError where it cannot be read, or is a model."""
    from ..files.file_types import kind_of_file, wrong_kind

    found = kind_of_file(file)
    if found == "model":
        raise wrong_kind(str(file), "joint.yaml or robot.yaml", found)
    return "robot" if found == "robot" else "joint"
