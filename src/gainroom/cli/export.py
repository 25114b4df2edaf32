"""gainroom export: gains into the files of simulators and controllers."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import printable
from .options import AsJson, refuse_inputs
from .output import show
from .streams import say

if TYPE_CHECKING:
    from ..files.gain_export import Export


def export(
    gains: Annotated[
        Path,
        typer.Argument(
            metavar="GAINS",
            help="What `gainroom robot --json` or `audit --json` wrote (unsafe gains: those to use instead), or gains that `audit` reads; "
            "or a joint.yaml, whose controller of any type goes to c or markdown, and gains of a PD or PID to all forms.",
            show_default=False,
        ),
    ],
    to: Annotated[
        str,
        typer.Option("--to", metavar="FORM", help="{export forms}. Of a joint.yaml or robot.yaml also {whole forms}.", show_default=False),
    ],
    onto: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A file of {forms onto} whose gains are replaced; the rest of it stays.")
    ] = None,
    output: Annotated[Path | None, typer.Option(metavar="OUT", help="Where it goes; without it, the file of --onto.")] = None,
    write: Annotated[bool, typer.Option("--write", help="Write the file; without it, only the difference is shown.")] = False,
    model: Annotated[str | None, typer.Option(metavar="MODEL", help="The robot's model, where GAINS names joints by patterns.")] = None,
    contact: Annotated[str, typer.Option(metavar="NAME", help="The recommended set of this contact state, not the one for all.")] = "",
    as_json: AsJson = False,
) -> int:
    """Gains for simulators and controllers, as `gainroom audit` reads them again: with where they come from, as a difference first.

    \b
    Example:
      gainroom export answer.json --to mjlab                 # of: gainroom robot robot.yaml --json > answer.json
      gainroom export answer.json --to mjcf --onto robot.xml --output robot-safe.xml --write

    Exit status: 0 done; 2 a file or the call is wrong, or the form cannot hold these gains.
    """
    import datetime

    from .. import __version__
    from ..errors import GainroomError
    from ..files.export_forms import OF_WHOLE_FILES
    from ..files.file_types import kind_of_file
    from ..files.gain_export import export_gains
    from ..files.gain_files import read_gains
    from ..files.law_export import LAW_FORMS, export_law
    from ..robot.formats.model_names import locate

    if to in OF_WHOLE_FILES:
        from ..files.actuator_export import export_actuators

        made = export_actuators(gains, to, onto, __version__, datetime.date.today())
    elif to in LAW_FORMS and gains.suffix.lower() in (".yaml", ".yml") and gains.exists() and kind_of_file(gains) == "joint":
        made = export_law(gains, to, onto, __version__, datetime.date.today())
    else:
        file = read_gains(gains, contact, to_use=True)
        made = export_gains(file, to, onto, None if model is None else locate(model), __version__, datetime.date.today())
    target = output or onto
    if write and target is None:
        raise GainroomError("--write: needs --output FILE, or --onto FILE")
    if target is not None and target != onto:
        refuse_inputs(target, "export")
    difference = _difference(made, target, onto)
    where = {"form": to, "file": None if target is None else str(target), "written": write}
    show(as_json, lambda: where | made.facts(difference), lambda: _terminal(made, target, write, difference))
    if write and target is not None:
        from ..io.atomic import write_text

        write_text(target, made.text)
    return 0


def _difference(made: "Export", target: Path | None, onto: Path | None) -> str:
    """Unified diff between the target's present content and the new one, as `diff -u`."""
    import difflib

    from ..io.bounded_text import bounded_text
    from ..robot.formats.xml_text import MAX_BYTES

    before = made.before if target == onto else bounded_text(target, MAX_BYTES, "a file of gains") if target and target.exists() else ""
    name = "new" if target is None else str(target)
    lines = difflib.unified_diff(before.splitlines(), made.text.splitlines(), name if before else "/dev/null", name, lineterm="")
    return "".join(f"{line}\n" for line in lines)


def _terminal(made: "Export", target: Path | None, written: bool, difference: str) -> str:
    """Text for the terminal: a file to be piped if there is no target; else the difference and what was done with it."""
    if target is None:
        for note in made.notes:
            say(f"gainroom: note: {printable(note)}")
        return made.text
    state = f"Written: {target}" if written else f"Not written: add --write to write {target}"
    lines = [*difference.splitlines(), "", state, *(f"Note: {note}" for note in made.notes)]  # not wrapped: flags are typed again
    return "".join(f"{printable(line)}\n" for line in lines)
