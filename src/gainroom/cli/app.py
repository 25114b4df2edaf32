"""gainroom app: the interactive page."""

import contextlib
import gc
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .model_options import ModelCall, audited_text
from .options import AsJson, Number, kind_of, number_option, report_stream, text_output, typed_command, with_options
from .output import emit, emit_json
from .progress import at_rest

if TYPE_CHECKING:
    from ..app.bench import Bench, Opened
    from ..files.audit_options import AuditOptions

DEFAULT = "testbed"
OTHERS = ("host", "port", "browser", "export", "view", "write_robot")
"""Parameters that do not describe a model."""
MISSING = "the page needs a web server: pip install 'gainroom[app]'"


@with_options
def app(
    *,
    context: typer.Context,
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="FILE",
            help="A joint.yaml or robot.yaml; a model (URDF, MJCF) with --delay-ms and audit's other options; else shipped examples.",
            show_default=False,
        ),
    ] = None,
    host: Annotated[str, typer.Option(metavar="NAME", help="Where it listens; elsewhere than on this machine the address has a token.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(metavar="NUMBER", min=0, max=65535, help="0: any that is free.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page.")] = True,
    export: Annotated[Path | None, typer.Option("--export", metavar="OUT.html", help="Write the report of a view and end.")] = None,
    view: Annotated[str, typer.Option(metavar="TEXT", help="For --export: what stands behind the # of the page's address.")] = "",
    delay_ms: Annotated[
        Number,
        number_option("--delay-ms", "in milliseconds", "Of a model, as of audit: from the host to motor torque [ms]; see --gains-run."),
    ] = None,
    given: ModelCall,
    write_robot: Annotated[
        Path | None, typer.Option(metavar="ROBOT.yaml", help="Of a model: write the robot there first; the page then saves to it.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """A page on which gains are dragged; verdict, gain map, Bode plot and step follow. It stays on this machine.

    \b
    Example:
      gainroom app joint.yaml
      gainroom app robot.xml --delay-ms 2 --gains gains.yaml

    Exit status: 0 done; 2 the file or the call is wrong; 130 ended by Ctrl-C.
    """
    if delay_ms is None:
        _refuse_without_model(context)
    options = None if delay_ms is None else given.options(delay_ms)

    def opened() -> "contextlib.AbstractContextManager[Bench]":
        if options is None:
            return contextlib.nullcontext(_bench(file))
        return _audited(file, given, options, typed_command(context, *OTHERS), write_robot)

    if export is not None:
        from ..app.address import view_of

        with report_stream(export, write_robot) as page, opened() as bench:
            assert page is not None
            page.write(bench.page(view_of(view)))
        return 0
    _serve(opened, host, port, browser, as_json, examples() if file is None else {})
    return 0


def _serve(
    opened: "Callable[[], contextlib.AbstractContextManager[Bench]]",
    host: str,
    port: int,
    browser: bool,
    as_json: bool,
    others: "dict[str, Callable[[], Bench]]",
) -> None:
    """Serves the page until it is ended; `others`: further files by name. Raises GainroomError if there is no web server."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ImportError:
        from ..errors import GainroomError

        raise GainroomError(MISSING) from None
    from ..app.server import serve

    def ready(address: str) -> None:
        if as_json:
            emit_json({"address": address, "file": bench.opened.source, "kind": bench.opening()["kind"]})
        else:
            emit(f"{bench.opened.source}: {address}\nCtrl-C ends it.\n")
        if browser:
            import webbrowser

            webbrowser.open(address)

    with opened() as bench:
        pass  # what is written stands before the page is served
    gc.freeze()  # what is loaded stays; from here on garbage is looked for in small portions, so that no answer waits for it
    gc.set_threshold(20_000)
    at_rest()
    serve(bench, host, port, ready, others)


def _refuse_without_model(context: typer.Context) -> None:
    """Raise GainroomError for options of audit without --delay-ms, which every model needs."""
    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in ("file", "as_json", *OTHERS) and source is not None and source.name == "COMMANDLINE":
            from ..errors import GainroomError, option_name

            needed = "is of a model, a URDF or MJCF, and needs --delay-ms: how long from the host to motor torque [ms]"
            raise GainroomError(f"{option_name(name)}: {needed}")


@contextlib.contextmanager
def _audited(file: str | None, given: ModelCall, options: "AuditOptions", call: str, target: Path | None) -> "Iterator[Bench]":
    """Opened robot.yaml as `gainroom audit MODEL --write-robot` writes it; it is written to `target` if the block ends without an error."""
    from ..app.bench import Opened
    from ..app.robot_bench import RobotBench
    from ..errors import GainroomError
    from ..files.audit_options import audited
    from .audit import RequirementCall

    if file is None:
        raise GainroomError(f"--delay-ms {options.delay_ms:g}: is of a model; name a URDF or MJCF before it")
    found = audited(file, given.gains, options)
    if found.options.gains_run == "split":
        raise GainroomError("--gains-run split: the page has one rate and delay for all gains; gainroom audit judges two")
    required = RequirementCall().of(given.margin_db, found.options.required)
    place = Path(f"{Path(file).stem}.yaml") if target is None else target
    text = audited_text(found, None, file, required, call.replace(" app ", " audit ", 1), place)
    with text_output(target, "robot.yaml", yaml_of="--write-robot") as robot:
        source = file if target is None else str(target)
        yield RobotBench(Opened(text, source, place.parent, target, call))
        if robot is not None:
            robot.write(text)


def examples() -> "dict[str, Callable[[], Bench]]":
    """Shipped files, opened once when they are asked for; robots only if the library that reads them is installed."""
    from importlib.util import find_spec

    from ..app.bench import Opened
    from .example import example_texts, joint_examples

    joints = joint_examples()
    texts = joints if find_spec("pinocchio") is None else example_texts()

    def opener(name: str) -> "Callable[[], Bench]":
        return cache(lambda: _bench_of(Opened(texts[name], f"{name}.yaml", Path()), "joint" if name in joints else "robot"))

    return {name: opener(name) for name in texts}


def _bench(name: str | None) -> "Bench":
    """Opened file, or the first example."""
    from ..app.bench import Opened
    from ..errors import GainroomError
    from ..files.file_types import kind_of_file
    from ..io.yaml_text import read_text

    if name is None:
        return examples()[DEFAULT]()
    file = Path(name)
    if kind_of_file(file) == "model":
        raise GainroomError(
            f"{name}: is a robot's model; its delay is needed, too: gainroom app {name} --delay-ms 2, and --gains for its gains"
        )
    return _bench_of(Opened(read_text(file), str(file), file.parent, file), kind_of(file))


def _bench_of(opened: "Opened", kind: str) -> "Bench":
    if kind == "robot":
        from ..app.robot_bench import RobotBench

        return RobotBench(opened)
    from ..app.joint_bench import JointBench

    return JointBench(opened)
