"""gainroom diagnose: what vibrates a joint, from a recording."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .log_options import LogCall
from .options import AsJson, ExitZero, Report, Verbose, exit_status, report_stream, typed_command, with_options
from .output import closing, render, show
from .progress import progress_bar

if TYPE_CHECKING:
    from ..files.logs import LoggedJoint
    from ..studies.diagnosis import Diagnosis

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
    from ..errors import GainroomError
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
    with progress_bar("diagnose:") as progress:
        logged = read_joint(call.file, call.options(), progress)
    with report_stream(report) as page:
        from ..errors import named
        from ..studies.diagnosis import diagnose as study

        with progress_bar("diagnose:") as progress, named(str(call.file)):
            progress(0, 0, "causes")
            found = study(logged.record, system)
        show(as_json, lambda: _facts(found, logged), lambda: _terminal(found, logged, verbose, report))
        if page is not None:
            from ..report.diagnosis import diagnosis_page

            page.write(diagnosis_page(found, str(call.file), typed_command(context)))
    return exit_status(found.verdict, exit_zero)


def _facts(found: "Diagnosis", logged: "LoggedJoint") -> dict[str, Any]:
    """What --json prints."""
    from ..report.diagnosis_text import facts
    from ..report.log_text import logged_facts, logged_remarks

    answer = {**found.verdict.facts, **facts(found)}
    answer["warnings"] += logged_remarks(logged)
    return {**answer, "log": logged_facts(logged)}


def _terminal(found: "Diagnosis", logged: "LoggedJoint", verbose: bool, report: Path | None) -> str:
    from ..report.diagnosis_advice import advice
    from ..report.diagnosis_text import evidence_lines, sentence, warnings
    from ..report.log_text import logged_remarks

    evidence = evidence_lines(found, everything=verbose)
    return render(
        sentence(found),
        *(f"→ {text}" for text in advice(found)),
        *(["", *evidence] if evidence else []),
        *([""] if report is not None else []),
        *closing({"Report": report}, warnings(found), notes=logged_remarks(logged)),
    )
