"""The command line: one file per command, each parse, call, show. Heavy imports wait until a command runs."""

import io
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated

import typer

from ..messages import printable
from .audit import audit
from .example import example
from .joint import joint
from .reproduce import reproduce
from .robot import robot
from .simulate import simulate
from .verify import verify

# Our matrices are small: on a busy machine, threads inside the linear algebra make each of them a hundred times slower.
# Read when numpy loads, so it is set before; a value of the user's own stays.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

app = typer.Typer(
    name="gainroom",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
app.command(name="joint", short_help="One joint: stable or not, margins, largest gains, gains to use.")(joint)
app.command(name="robot", short_help="A whole robot: limits with all joints closed, by posture and contact state.")(robot)
app.command(name="audit", short_help="Are the gains that a robot already has safe?")(audit)
app.command(name="simulate", short_help="Play a joint's or a robot's scenario: tracking, vibration, traces.")(simulate)
app.command(name="verify", short_help="The predicted limit against simulation.")(verify)
app.command(name="example", short_help="Print a ready file to start from.")(example)
app.command(name="reproduce", short_help="The paper's figures, computed and compared.")(reproduce)


@app.callback(invoke_without_command=True)
def _front(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """How large the gains of a torque-controlled joint or robot can be, with elasticity and time delay, exactly.

    \b
    Example:
      gainroom example testbed > joint.yaml
      gainroom joint joint.yaml --report joint.html

    Exit status: 0 done; 1 the answer is "unstable" or "not safe"; 2 the input or the call is wrong.
    """
    if version:
        from .. import __version__

        typer.echo(f"gainroom {__version__}")
        raise typer.Exit(0)
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `gainroom` with `arguments` (the process's own by default) and return the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a character still gets its answer
    try:
        with warnings.catch_warnings():
            # numpy's remarks about overflow say nothing to a user; what is not finite in a result is shown as such
            warnings.simplefilter("ignore", RuntimeWarning)
            return app(arguments, prog_name="gainroom", standalone_mode=False) or 0
    except typer.TyperException as error:
        return _complain(f"{error.format_message()} (see gainroom --help)")
    except typer.Abort:
        return 130
    except ValueError as error:
        from ..errors import GainroomError

        if not isinstance(error, GainroomError):
            raise
        return _complain(str(error))


def _complain(message: str) -> int:
    print(f"gainroom: error: {printable(message).strip()}", file=sys.stderr)
    return 2
