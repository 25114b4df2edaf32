"""gainroom robot: the whole robot, by posture and contact state."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import AsJson, ExitZero, Report, Strict, Verbose, exit_status, report_stream, typed_command
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..studies.progress import Progress
    from ..studies.robot import RobotStudy
    from ..system.system import System


def robot(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A robot.yaml; `gainroom example biped` prints one.", show_default=False)],
    sweep: Annotated[
        Path | None, typer.Option(metavar="DIR.zarr", help="A sweep's results: its worst postures count too, and gains are checked in all.")
    ] = None,
    as_json: AsJson = False,
    verbose: Verbose = False,
    strict: Strict = False,
    exit_zero: ExitZero = False,
    report: Report = None,
) -> int:
    """The gain limit of a robot with all loops closed, in every posture and contact state, and the joints that vibrate there.

    \b
    Example:
      gainroom robot robot.yaml --report robot.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..files.robot_yaml import load_robot_system

    system = load_robot_system(file, two_paths=True)
    if system.control.kd_path is not None:
        from .gain_paths import study_paths

        return exit_status(study_paths(system, as_json, report), exit_zero)
    with report_stream(report) as page:
        with progress_bar("robot:") as progress:
            study, elsewhere = _studied(system, sweep, progress)
        from ..report.robot_tables import RobotPresentation

        shown = RobotPresentation(study, file, **elsewhere, call=typed_command(context, "report"), files={"Report": report})
        present(shown, as_json, verbose)
        if page is not None:
            from ..report.robot import robot_page

            page.write(robot_page(shown, typed_command(context)))
    return exit_status(study.verdict, exit_zero)


def _studied(system: "System", sweep: Path | None, progress: "Progress") -> "tuple[RobotStudy, dict[str, Any]]":
    """Study of the robot, and RobotPresentation's argument about postures outside the file.

    Without a sweep a few hundred of these are looked at beside the study, in search of one that has a lower gain limit.
    """
    if sweep is not None:
        from ..studies.swept_gains import study_over

        study, swept = study_over(system, sweep, progress)
        return study, {"over_sweep": True, "swept": swept}
    from ..design.parallel import Job, in_parallel
    from ..studies.progress import after
    from ..studies.robot import study_robot
    from ..studies.sweep.workspace import glance, worse_posture

    jobs: list[Job[Any]] = [lambda checkpoint: study_robot(system, after(checkpoint, progress)), lambda checkpoint: glance(system)]
    study, seen = in_parallel(jobs, lambda: None)
    return study, {"worse": worse_posture(seen, study.tightest.limit.gain)}
