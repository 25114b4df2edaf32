"""What `gainroom joint` and `gainroom robot` print where kd closes on a path of its own."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import GainroomError
from .output import closing, column_table, headings, render, show, table, warned_first
from .progress import progress_bar

if TYPE_CHECKING:
    from ..studies.two_paths import PathStudy
    from ..studies.verdict import Verdict
    from ..system.system import System


def two_paths(system: "System", as_json: bool, report: Path | None) -> "Verdict":
    """The verdict, once it is shown.

    Raises GainroomError for a page.
    """
    if report is not None:
        raise GainroomError("--report: there is no page where kd closes on a path of its own; the terminal and --json have its numbers")
    from ..report.two_paths import path_study_facts
    from ..studies.two_paths import study_two_paths

    with progress_bar("states:") as progress:
        study = study_two_paths(system, progress)
    show(as_json, lambda: path_study_facts(study), lambda: _terminal(study))
    return study.verdict


def _terminal(study: "PathStudy") -> str:
    from ..report.columns import definitions
    from ..report.number_format import model_text
    from ..report.two_paths import COLUMNS, NOT_MADE, assumptions, requirement_rows, sentence, warnings

    control = study.system.control
    columns = COLUMNS if study.nominal[0].title else COLUMNS[1:]
    title = f"Nominal ({model_text(control.sample_time, control.kd_path)})"
    nominal = column_table(title, columns, study.nominal, ("at", "phase"))
    doubts, said = warned_first(warnings(study))
    return render(
        *doubts,
        sentence(study),
        "",
        nominal,
        definitions(columns, headings(nominal)),
        "",
        table("Requirements, at their worst", ("", "value", "at", "required", "met"), requirement_rows(study)),
        *closing({}, said, assumptions(study), [NOT_MADE]),
    )
