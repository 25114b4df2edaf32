"""What the commands of `gainroom identify` share: a joint read from a log with progress, and the answer shown."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .log_options import LogCall
from .options import refuse_inputs
from .output import closing, emit, emit_json, render, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..files.logs import LoggedJoint
    from ..report.estimates import Answer


@contextlib.contextmanager
def joint_of_log(call: LogCall, report: Path | None = None) -> Iterator[tuple["LoggedJoint", Callable[[int, int, str], None]]]:
    """The joint that a log holds, and the progress of what is done with it; `report`: a page that must not take the log's place.

    Raises GainroomError; what is raised inside names the log.
    """
    from ..errors import named
    from ..files.logs import read_joint
    from ..identification.contradictions import require_consistent

    options = call.options()
    with progress_bar("identify:") as progress:
        progress(0, 2, "reading the log")
        logged = read_joint(call.file, options)
        if report is not None:
            refuse_inputs(report, "report")
        progress(1, 2, "fitting")
        with named(str(call.file)):
            logged.require_dense()
            require_consistent(logged.record)
            yield logged, progress


def show(
    answer: "Answer",
    logged: "LoggedJoint",
    as_json: bool,
    *more: Any,
    files: Mapping[str, Path | None] | None = None,
    facts: Mapping[str, Any] | None = None,
) -> None:
    """On standard output: the sentence, the numbers, `more`, the `files` written, and the warnings; `facts`: more in JSON."""
    from ..report.estimates import TITLES
    from ..report.log_text import logged_facts, logged_remarks

    if as_json:
        all_of_it = {**answer.facts(), **(facts or {}), "log": logged_facts(logged)}
        all_of_it["warnings"] += logged_remarks(logged)
        emit_json(all_of_it)
        return
    emit(
        render(
            answer.sentence,
            "",
            table(answer.title, TITLES, answer.rows()),
            *more,
            *closing(files or {}, answer.warnings, notes=logged_remarks(logged)),
        )
    )
