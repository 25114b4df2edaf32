"""Front door of `gainroom` and the list of its commands, one file each."""

from collections.abc import Callable
from functools import cache
from typing import Annotated

import typer
from typer.main import get_command

from .actuators import actuators
from .app import app as page
from .audit import audit
from .compare import compare
from .diagnose import diagnose
from .example import example
from .export import export
from .identify import identify
from .joint import joint
from .listed import ListingCommand
from .log import log
from .reproduce import reproduce
from .robot import robot
from .simulate import simulate
from .sweep import sweep
from .verify import verify

app = typer.Typer(
    name="gainroom",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
app.command(name="joint", short_help="One joint: stable or not, margins, largest gains, recommended gains.")(joint)
app.command(name="robot", short_help="A whole robot: limits with all joints closed, by posture and contact state.")(robot)
app.command(name="audit", short_help="Are the gains that a robot already has safe?")(audit)
app.command(name="sweep", short_help="A whole robot in every posture: the worst one, and how sure that is.")(sweep)
app.command(name="export", short_help="Gains into the files of simulators and controllers, as a difference first.")(export)
app.command(name="compare", short_help="Is PD the problem? Other structures at equal robustness.")(compare)
app.command(name="simulate", short_help="Simulate a joint's or a robot's scenario: tracking, vibration, traces.")(simulate)
app.command(name="verify", short_help="The predicted limit against simulation.")(verify)
app.command(name="log", short_help="What a log holds, and what can be identified from it.")(log)
app.add_typer(identify, short_help="From a log to a joint: delay, elasticity, gains.")
app.command(name="diagnose", short_help="What vibrates a joint, from a recording, and which gain to change.")(diagnose)
app.command(name="app", short_help="A page on which gains are dragged, and everything follows.")(page)
app.command(name="actuators", short_help="Published figures of motors and gearboxes, with sources.")(actuators)
app.command(name="example", short_help="Print a ready file to start from.")(example)
app.command(name="reproduce", short_help="The paper's figures, computed and compared.")(reproduce)
for _command in (*app.registered_commands, *identify.registered_commands):
    _command.cls = ListingCommand


@app.callback(invoke_without_command=True)
def _front(context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    """How large the gains of a torque-controlled joint or robot can be, with elasticity and time delay, exactly.

    \b
    Example:
      gainroom example testbed > joint.yaml
      gainroom joint joint.yaml --report joint.html

    Exit status: 0 done, and what is judged is safe; 1 not safe; 2 the input or the call is wrong; 3 not decided.
    """
    if version:
        from .. import __version__

        typer.echo(f"gainroom {__version__}")
        raise typer.Exit(0)
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


@cache
def command() -> Callable[..., int | None]:
    """Command with all its options, built once; building takes longer than a short command runs."""
    return get_command(app)
