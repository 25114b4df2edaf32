"""Options that every command has."""

import contextlib
import inspect
import os
import shlex
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import wraps
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from ..studies.verdict import Verdict

AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="All there is to know, not only what matters first.")]
Strict = Annotated[bool, typer.Option("--strict", hidden=True, help="Without effect: a requirement that is not met is exit status 1.")]
ExitZero = Annotated[bool, typer.Option("--exit-zero", help="Exit status 0 also where the answer is unsafe or not decided.")]
Report = Annotated[Path | None, typer.Option("--report", metavar="OUT.html", help="Also write a self-contained page.")]
Number = float | None
SHOWN = ("as_json", "verbose", "strict", "exit_zero")
"""Parameters that only affect how an answer is shown."""


def number_option(flag: str, unit: str, text: str, **others: Any) -> Any:
    """Option that takes a number; other text is refused with a hint to leave out the `unit`."""
    return typer.Option(flag, parser=lambda value: _number(value, flag, unit), metavar=others.pop("metavar", "NUMBER"), help=text, **others)


def joints_option(flag: str, unit: str, text: str) -> Any:
    """Option for one number for all joints, or JOINT=NUMBER for those that match a pattern; it stays text and may be repeated."""

    def parse(value: str) -> str:
        _number(value.rpartition("=")[2], flag, unit)
        return value

    return typer.Option(flag, parser=parse, metavar="[JOINT=]NUMBER", help=text)


def _number(value: object, flag: str, unit: str) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except ValueError:
        written = f"a number {unit}, without the unit" if unit else "a number"
        raise typer.BadParameter(f"{str(value)[:60]!r} must be {written}", param_hint=f"'{flag}'") from None


def exit_status(verdict: "Verdict", exit_zero: bool) -> int:
    """Exit status of every command with a verdict; `exit_zero`: always 0."""
    return 0 if exit_zero else verdict.status


@contextlib.contextmanager
def text_output(path: Path | None, what: str, other: Path | None = None, yaml_of: str = "") -> Iterator[StringIO | None]:
    """Stream for a text (`what`: a report), or None if `path` is None; the file is replaced if the block ends without an error.

    A path that cannot be written, or that would take the place of anything read so far or of `other`, is refused before the work. The
    answer is printed inside the block, so that it is there even if the text cannot be. `yaml_of`: the option whose file must be YAML.

    Raises GainroomError.
    """
    if path is None:
        yield None
        return
    from ..errors import GainroomError
    from ..io.atomic import replacement, writing

    refuse_inputs(path, what)
    if yaml_of and path.suffix not in (".yaml", ".yml"):
        raise GainroomError(f"{path}: {yaml_of} must end in .yaml")
    if other is not None and os.path.realpath(path) == os.path.realpath(other):
        raise GainroomError(f"{path}: the {what} would overwrite another file that this command writes")
    with replacement(path) as temporary:
        text = StringIO()
        yield text
        with writing(path):
            temporary.write_text(text.getvalue(), "utf-8", newline="\n")


OTHER_PAGES = (".pdf", ".png", ".svg", ".jpg", ".docx", ".md")
"""Endings of documents and pictures that users may expect --report to write."""


def report_stream(report: Path | None, other: Path | None = None) -> "contextlib.AbstractContextManager[StringIO | None]":
    """Stream for the page. Raises GainroomError for the name of a document or picture of another kind."""
    from ..errors import GainroomError

    if report is not None and report.suffix.lower() in OTHER_PAGES:
        raise GainroomError(f"{report}: --report writes a web page, whose name must end in .html")
    return text_output(report, "report", other)


def refuse_inputs(path: Path, what: str) -> None:
    """Raise GainroomError if `path` is a file that has been read, under any name: `what` is to be written there."""
    from ..errors import GainroomError
    from ..io.run_files import read_as

    name = read_as(path)
    if name is not None:
        raise GainroomError(f"{path}: the {what} would overwrite the input" + (f" {name}" if name != str(path) else ""))


def typed_command(context: typer.Context, *left_out: str) -> str:
    """Running command as typed, for a page's last section and for continuing.

    left_out   names of parameters that it goes without, beside SHOWN
    """
    words = context.command_path.split()[1:]
    for parameter in sorted(context.command.params, key=lambda one: (one.param_type_name == "option", one.name == "report")):
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if name in (*SHOWN, *left_out) or source is None or source.name != "COMMANDLINE":
            continue
        value = context.params[name]
        values = value if isinstance(value, list | tuple) else [value]
        texts = [repr(one).removesuffix(".0") if isinstance(one, float) else str(one) for one in values]
        if parameter.param_type_name == "argument":
            words += texts
        elif isinstance(value, bool):
            words += parameter.opts if value else parameter.secondary_opts
        else:
            words += [word for text in texts for word in (parameter.opts[0], text)]
    return command_line(*words)


def command_line(*words: object) -> str:
    """Command line of `gainroom` with these words, quoted for a shell."""
    return shlex.join(["gainroom", *map(str, words)]).encode("utf-8", "backslashreplace").decode()


Command = Callable[..., int]


def with_options(command: Command) -> Command:
    """Command for typer: a parameter that is a dataclass of options is replaced by its fields.

    An option of the command's own stands for that of the record of the same name.
    """
    own = inspect.signature(command, eval_str=True).parameters
    records: dict[str, Any] = {name: each.annotation for name, each in own.items() if is_dataclass(each.annotation)}
    fields = {
        name: [option for option in inspect.signature(record, eval_str=True).parameters.values() if option.name not in own]
        for name, record in records.items()
    }

    @wraps(command)
    def called(**values: Any) -> int:
        made = {name: record(**{option.name: values.pop(option.name) for option in fields[name]}) for name, record in records.items()}
        return command(**values, **made)

    every = [option for name, each in own.items() for option in fields.get(name, [each])]
    parameters = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in every]
    called.__annotations__ = {each.name: each.annotation for each in parameters} | {"return": int}
    called.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportAttributeAccessIssue]
    return called


def kind_of(file: Path) -> Literal["joint", "robot"]:
    """Kind of a file by its sections; joint if they do not decide. Raises GainroomError if it cannot be read, or is a model."""
    from ..files.file_types import kind_of_file, wrong_kind

    found = kind_of_file(file)
    if found == "model":
        raise wrong_kind(str(file), "joint.yaml or robot.yaml", found)
    return "robot" if found == "robot" else "joint"
