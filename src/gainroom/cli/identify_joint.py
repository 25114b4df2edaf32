"""gainroom identify joint: inertias, stiffness, damping, friction and delay of a joint."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import GainroomError
from .identify_log import joint_of_log, show
from .log_options import LogCall, reads_log
from .options import AsJson, Report, command_line, number_option, report_stream, yaml_output

if TYPE_CHECKING:
    from ..files.logs import LoggedJoint
    from ..identification import JointFit
    from ..system.drive import Drive

Number = float | None


@reads_log
def joint(
    call: LogCall,
    output: Annotated[
        Path | None, typer.Option(metavar="JOINT.yaml", help="Also write a joint.yaml: values, intervals, covariance, gains to start from.")
    ] = None,
    delay_ms: Annotated[
        Number, number_option("--delay-ms", "in milliseconds", "From torque command to motor torque [ms], where it is known.")
    ] = None,
    bandwidth: Annotated[
        Number, number_option("--bandwidth", "in rad/s", "Of the current loop [rad/s], with --delay-ms; without it, ideal.")
    ] = None,
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """Inertias, stiffness, damping, friction and delay of a joint from torque and position, with 95 % intervals.

    From target_torque or actual_torque (both: the delay too) and motor_position; link_position makes it sharper.

    \b
    Example:
      gainroom identify joint run.csv --output joint.yaml --report joint.html

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell the joint.
    """
    drive = _drive(delay_ms, bandwidth)
    with report_stream(report, output) as page:
        with joint_of_log(call, report) as (logged, progress), yaml_output(output, "--output", "joint.yaml") as temporary:
            from ..identification import identify_joint
            from ..report.identified_joint_text import joint_answer

            if output is not None and drive is None and not logged.record.has("target_torque"):
                raise GainroomError("has no target_torque, which tells the delay that a joint.yaml needs: give --delay-ms")
            fit = identify_joint(logged.record, drive)
            answer = joint_answer(fit)
            if temporary is not None:
                progress(2, 3, "gains over the intervals")
                answer = replace(answer, warnings=(*answer.warnings, *_write(temporary, fit, logged, drive)))
        files = {"Joint": output, "Report": report}
        show(answer, logged, as_json, files=files, facts={"output": None if output is None else str(output)})
        if page is not None:
            from ..report.identification import joint_page

            known = (("--delay-ms", delay_ms), ("--bandwidth", bandwidth), ("--output", output))
            command = command_line("identify", "joint", *call.words(), *known, ("--report", report))
            page.write(joint_page(fit, logged.record, answer, command))
    return 0


def _write(temporary: Path, fit: "JointFit", logged: "LoggedJoint", drive: "Drive | None") -> list[str]:
    """The joint.yaml; what is to be said of it. Raises GainroomError."""
    from datetime import date

    from .. import __version__
    from ..files.identified_joint import identified_text
    from ..io.atomic import writing

    text, _, met = identified_text(fit, logged.path, drive, date.today().isoformat(), __version__)
    with writing(temporary):
        temporary.write_text(text, "utf-8", newline="\n")
    return [] if met else ["no PD gains keep the usual limits over the intervals: the gains in the file are low ones to start from"]


def _drive(delay_ms: Number, bandwidth: Number) -> "Drive | None":
    """What is known beforehand. Raises GainroomError."""
    if delay_ms is None and bandwidth is None:
        return None
    from ..system.drive import Drive

    if delay_ms is None:
        raise GainroomError("--bandwidth: needs --delay-ms; without both, delay and current loop are identified from the torques")
    return Drive(bandwidth=math.inf if bandwidth is None else bandwidth, delay=1e-3 * delay_ms)
