"""gainroom identify: what a log tells of a joint, one file per question (identify_….py)."""

import typer

from .identify_delay import delay
from .identify_gains import gains
from .identify_joint import joint
from .identify_plan import plan
from .identify_stiffness import stiffness

identify = typer.Typer(name="identify", rich_markup_mode=None, context_settings={"help_option_names": ["-h", "--help"]})
identify.command(name="delay", short_help="The delay of the torque, its jitter, and the current loop.")(delay)
identify.command(name="joint", short_help="Inertias, stiffness, damping, friction and delay.")(joint)
identify.command(name="gains", short_help="The gains that a firmware applies, beside those asked for.")(gains)
identify.command(name="stiffness", short_help="Stiffness from a record with the output locked.")(stiffness)
identify.command(name="plan", short_help="What to run on the joint before, and the accuracy to expect.")(plan)


@identify.callback(invoke_without_command=True)
def _front(context: typer.Context) -> None:
    """What a log tells of a joint, with 95 % intervals: delay, elasticity, gains.

    \b
    Example:
      gainroom identify delay run.csv

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)
