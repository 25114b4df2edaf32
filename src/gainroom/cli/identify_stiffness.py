"""gainroom identify stiffness: a gearbox's stiffness from a record with the output locked."""

from typing import Annotated

from .identify_log import joint_of_log, show
from .log_options import LogCall, reads_log
from .options import AsJson, Report, command_line, number_option, report_stream


@reads_log
def stiffness(
    call: LogCall,
    motor_inertia: Annotated[
        float, number_option("--motor-inertia", "in kg m²", "Joint side [kg m²]: its share is taken off the torque of quick motion.")
    ] = 0.0,
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """The stiffness of a gearbox whose output is locked, from torque and motor position, and the hysteresis that friction makes.

    Load the joint slowly back and forth, several times, well beyond friction.

    \b
    Example:
      gainroom identify stiffness locked.csv --report stiffness.html

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell the stiffness.
    """
    from ..errors import require_positive

    require_positive("options", "--motor-inertia", motor_inertia, "kg·m²", zero=True)
    with report_stream(report) as page:
        with joint_of_log(call, report) as (logged, _):
            from ..identification import identify_stiffness
            from ..report.identified_joint_text import stiffness_answer

            fit = identify_stiffness(logged.record, motor_inertia)
            answer = stiffness_answer(fit)
        show(answer, logged, as_json, files={"Report": report})
        if page is not None:
            from ..report.identification import stiffness_page

            known = ("--motor-inertia", motor_inertia or None)
            page.write(stiffness_page(fit, answer, command_line("identify", "stiffness", *call.words(), known, ("--report", report))))
    return 0
