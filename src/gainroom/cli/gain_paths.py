"""Output of `gainroom joint` and `gainroom robot` where kd is closed on a path of its own."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import GainroomError
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..studies.verdict import Verdict
    from ..system.system import System


def study_paths(system: "System", as_json: bool, report: Path | None) -> "Verdict":
    """Verdict on a system whose kd has a path of its own, after it is shown.

    Raises GainroomError for a page.
    """
    if report is not None:
        raise GainroomError("--report: there is no page where kd closes on a path of its own; the terminal and --json have its numbers")
    from ..report.gain_paths import PathPresentation
    from ..studies.gain_paths import study_gain_paths

    with progress_bar("states:") as progress:
        study = study_gain_paths(system, progress)
    present(PathPresentation(study), as_json, False)
    return study.verdict
