"""gainroom app: the interactive page."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import AsJson, kind_of, report_stream
from .output import emit, emit_json

if TYPE_CHECKING:
    from ..app.bench import Bench

DEFAULT = "testbed"
MISSING = "the page needs a web server: pip install 'gainroom[app]'"


def app(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", help="A joint.yaml or robot.yaml; without it, an example.", show_default=False),
    ] = None,
    host: Annotated[str, typer.Option(metavar="NAME", help="Where it listens; elsewhere than on this machine the address has a token.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(metavar="NUMBER", min=0, max=65535, help="0: any that is free.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page.")] = True,
    export: Annotated[Path | None, typer.Option("--export", metavar="OUT.html", help="Write the report of a view and end.")] = None,
    view: Annotated[str, typer.Option(metavar="TEXT", help="For --export: what stands behind the # of the page's address.")] = "",
    as_json: AsJson = False,
) -> int:
    """A page on which gains are dragged; verdict, gain map, Bode plot and step follow. It stays on this machine.

    \b
    Example:
      gainroom app joint.yaml

    Exit status: 0 done; 2 the file or the call is wrong; 130 ended by Ctrl-C.
    """
    if export is not None:
        from ..app.address import view_of

        with report_stream(export) as page:
            bench = _bench(file)
            assert page is not None
            page.write(bench.page(view_of(view)))
        return 0
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ImportError:
        from ..errors import GainroomError

        raise GainroomError(MISSING) from None
    from ..app.server import serve

    bench = _bench(file)

    def ready(address: str) -> None:
        if as_json:
            emit_json({"address": address, "file": bench.opened.source, "kind": bench.opening()["kind"]})
        else:
            emit(f"{bench.opened.source}: {address}\nCtrl-C ends it.\n")
        if browser:
            import webbrowser

            webbrowser.open(address)

    serve(bench, host, port, ready)
    return 0


def _bench(file: Path | None) -> "Bench":
    """The file, opened."""
    from ..app.bench import Opened
    from ..app.joint_bench import JointBench
    from ..io.yaml_text import read_text
    from .example import example_texts

    if file is None:
        return JointBench(Opened(example_texts()[DEFAULT], f"{DEFAULT}.yaml", Path()))
    opened = Opened(read_text(file), str(file), file.parent, file)
    if kind_of(file) == "robot":
        from ..app.robot_bench import RobotBench

        return RobotBench(opened)
    return JointBench(opened)
