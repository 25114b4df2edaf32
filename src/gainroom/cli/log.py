"""gainroom log: what a log holds, and what can be identified from it."""

from typing import Any

from .log_options import LogCall
from .options import AsJson, Verbose, with_options
from .output import render, show, table
from .progress import progress_bar

MOST_JOINTS = 3
"""Maximum number of joints in the terminal's table."""


@with_options
def log(*, as_json: AsJson = False, verbose: Verbose = False, call: LogCall) -> int:
    """What a log holds: joints, channels, units, how each was found out, what had to be cut, and which questions it has channels for.

    \b
    Example:
      gainroom log run.csv --columns target_torque=cmd --units motor_position=deg

    Exit status: 0 done; 2 the file or the call is wrong.
    """
    from ..files.logs import Survey, log_reader
    from ..report.log_text import facts

    with progress_bar("log:") as progress, log_reader(call.file, call.options(), progress) as reader:
        survey = Survey.of(reader)
    show(as_json, lambda: facts(survey), lambda: _terminal(survey, None if verbose else MOST_JOINTS))
    return 0


def _terminal(survey: Any, most: int | None) -> str:
    from ..report.log_text import CHANNEL_TITLES, ability_text, channel_rows, remarks, sentence
    from ..report.number_format import digits

    more = len(survey.last.joint_names) - (most or len(survey.last.joint_names))
    questions = [(each.question, ability_text(each), "yes" if each.possible else "no") for each in survey.abilities()]
    parts: list[Any] = [
        sentence(survey),
        "",
        table("Channels", CHANNEL_TITLES, channel_rows(survey, most)),
        *([f"and {digits(more)} more joints (--verbose)", ""] if more > 0 else []),
        table("What it has channels for", ("", "", "has them"), questions),
        "Whether their motion is enough, each command says.",
        *(f"Note: {text}" for text in remarks(survey.last)),
    ]
    return render(*parts)
