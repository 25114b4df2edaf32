"""gainroom identify: what a log tells of a joint, one file per question (identify_….py)."""

import typer

from .identify_delay import delay

identify = typer.Typer(name="identify", rich_markup_mode=None, context_settings={"help_option_names": ["-h", "--help"]})
identify.command(name="delay", short_help="The delay of the torque, its jitter, and the current loop.")(delay)


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
