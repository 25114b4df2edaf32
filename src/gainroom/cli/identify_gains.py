"""gainroom identify gains: the gains that a firmware applies, beside those asked for."""

from pathlib import Path
from typing import Annotated

import typer

from .identify_log import joint_of_log, show
from .log_options import LogCall, reads_log
from .options import AsJson, Report, command_line, report_stream
from .output import table

GAINS = ("kp", "kd")


@reads_log
def gains(
    call: LogCall,
    asked: Annotated[
        str | None,
        typer.Option(metavar="kp=…,kd=…", help="What the gains should be [N m/rad, N m s/rad]; or a joint.yaml. --gear-ratio helps too."),
    ] = None,
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """The kp and kd that the firmware applies, joint side, from set-point, position and torque; and which unit makes them differ.

    \b
    Example:
      gainroom identify gains run.csv --asked kp=1600,kd=70 --gear-ratio 100 --report gains.html

    Exit status: 0 done; 2 a file or the call is wrong, or the log cannot tell the gains.
    """
    wanted, ratio = _asked(asked, call.gear_ratio)
    with report_stream(report) as page:
        with joint_of_log(call, report) as (logged, _):
            from ..identification import identify_gains
            from ..report.identified_gains_text import ASKED_TITLES, asked_rows, gains_answer

            fit = identify_gains(logged.record, **wanted, gear_ratio=ratio)
        answer, beside = gains_answer(fit), [*wanted.items()]
        more = [table("Beside what was asked for", ASKED_TITLES, asked_rows(fit, beside))] if wanted else []
        facts = {"asked": {name: wanted.get(name) for name in GAINS}}
        show(answer, logged, as_json, *more, files={"Report": report}, facts=facts)
        if page is not None:
            from ..report.identification import gains_page

            command = command_line("identify", "gains", *call.words(), ("--asked", asked), ("--report", report))
            page.write(gains_page(fit, logged.record, beside, answer, command))
    return 0


def _asked(text: str | None, gear_ratio: float | None) -> tuple[dict[str, float], float | None]:
    """The gains that were asked for by name, and the gear ratio, from the options or from a joint.yaml. Raises GainroomError."""
    if text is None:
        return {}, gear_ratio
    from ..errors import GainroomError

    if "=" not in text:
        from ..files.joint_yaml import load_joint

        system = load_joint(Path(text))
        controller = system.control.controller
        if not controller.has_plane:
            raise GainroomError(f"{text}: control.type: its gains have no kp and kd to compare with")
        return dict(zip(GAINS, map(float, controller.plane_gains()), strict=True)), gear_ratio or system.entered.get("gear_ratio")
    from ..files.logs.options import assignments
    from ..io.validation import checked, number

    found = {}
    for name, value in assignments([text], "--asked").items():
        if name not in GAINS:
            raise GainroomError(f"--asked: {name!r} must be kp or kd")
        try:
            typed: object = float(value)
        except ValueError:
            typed = value
        found[name] = checked(f"--asked: {name}", typed, number(above=0))
    return found, gear_ratio
