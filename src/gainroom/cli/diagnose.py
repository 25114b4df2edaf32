"""gainroom diagnose: what vibrates a joint, from a recording."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from .log_options import LogCall
from .options import AsJson, ExitZero, Report, Verbose, exit_status, report_stream, typed_command, with_options
from .output import present
from .progress import progress_bar

JointFileOrName = Annotated[
    list[str] | None,
    typer.Option("--joint", metavar="FILE|NAME", help="The joint's joint.yaml; or which joint of the log. May be given again."),
]


@with_options
def diagnose(
    *,
    context: typer.Context,
    joint: JointFileOrName = None,
    as_json: AsJson = False,
    verbose: Verbose = False,
    exit_zero: ExitZero = False,
    report: Report = None,
    call: LogCall,
) -> int:
    """Does a joint vibrate in a recording, why, and which gain to change by how much.

    Causes are ranked by evidence: the loop at its gain limit, stick-slip, encoder steps, a structural resonance, torque saturation, torque
    from outside, torque ripple, backlash, a log that is too slow, an outer loop. With --joint joint.yaml the loop of that file is compared
    with the recording; without it some causes cannot be distinguished.

    \b
    Example:
      gainroom diagnose run.csv --joint joint.yaml --report diagnosis.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..errors import GainroomError, named
    from ..files.logs import read_joint

    described = [one for one in joint or [] if Path(one).suffix.lower() in (".yaml", ".yml")]
    if len(described) > 1:
        raise GainroomError(f"--joint: {described[1]}: only one joint.yaml can be given")
    names = [one for one in joint or [] if one not in described]
    call = replace(call, joint=names)
    system = None
    if described:
        from ..files.joint_yaml import load_joint

        system = load_joint(Path(described[0]))
        with named(described[0]):
            system.control.feedback.require_one("what a recording tells of the loop")
    with progress_bar("diagnose:") as progress:
        logged = read_joint(call.file, call.options(), progress)
    with report_stream(report) as page:
        from ..report.diagnosis_text import DiagnosisPresentation
        from ..studies.diagnosis import diagnose as study

        with progress_bar("diagnose:") as progress, named(str(call.file)):
            progress(0, 0, "causes")
            found = study(logged.record, system)
        shown = DiagnosisPresentation(found, logged, str(call.file), files={"Report": report})
        present(shown, as_json, verbose)
        if page is not None:
            from ..report.diagnosis import diagnosis_page

            page.write(diagnosis_page(shown, typed_command(context)))
    return exit_status(found.verdict, exit_zero)
