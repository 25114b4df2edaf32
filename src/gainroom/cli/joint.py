"""gainroom joint: one joint, exactly."""

from pathlib import Path
from typing import Annotated

import typer

from .options import AsJson, ExitZero, Report, Strict, Verbose, exit_status, report_stream, typed_command
from .output import present
from .progress import progress_bar


def joint(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A joint.yaml; `gainroom example testbed` prints one.", show_default=False)],
    as_json: AsJson = False,
    verbose: Verbose = False,
    strict: Strict = False,
    exit_zero: ExitZero = False,
    report: Report = None,
) -> int:
    """Stability of a joint, its margins, what limits its gains, and recommended gains. A file without gains asks which may be used.

    \b
    Example:
      gainroom joint joint.yaml --report joint.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..files.joint_yaml import load_joint

    system = load_joint(file, two_paths=True, may_ask=True)
    if system.control.kd_path is not None:
        from .gain_paths import study_paths

        return exit_status(study_paths(system, as_json, report), exit_zero)
    with report_stream(report) as page:
        from ..report.joint_tables import JointPresentation, NoGains
        from ..studies.joint import NoGainsError, study_joint

        try:
            with progress_bar("joint:") as progress:
                progress(0, 0, "margins and gains")
                study = study_joint(system)
        except NoGainsError as nothing:
            present(NoGains(nothing), as_json, verbose)
            return exit_status(nothing.verdict, exit_zero)
        shown = JointPresentation(study, call=typed_command(context, "report"), files={"Report": report})
        present(shown, as_json, verbose)
        if page is not None:
            from ..report.joint import joint_page

            page.write(joint_page(shown, typed_command(context)))
    return exit_status(study.verdict, exit_zero)
