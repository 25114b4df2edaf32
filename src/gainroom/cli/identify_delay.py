"""gainroom identify delay: the delay of a torque, from the torques or from set-point and position."""

from typing import Annotated

from .identify_log import joint_of_log, show
from .log_options import LogCall, Number, reads_log
from .options import AsJson, Report, command_line, number_option, report_stream


@reads_log
def delay(
    call: LogCall,
    loop_rate_hz: Annotated[
        Number, number_option("--loop-rate-hz", "in Hz", "Of the loop on kp and kd [Hz], where no torque is logged: its hold is no delay.")
    ] = None,
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """The delay from torque command to motor torque, its jitter, and the current loop's bandwidth and damping.

    From target_torque with demand_torque or actual_torque; without them from set-point (reference) and position.

    \b
    Example:
      gainroom identify delay run.csv --report delay.html

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell the delay.
    """
    with report_stream(report) as page:
        with joint_of_log(call, report) as (logged, _):
            from ..errors import GainroomError, require_positive
            from ..identification import identify_delay, identify_setpoint_delay
            from ..report.delay_text import setpoint_delay_answer, torque_delay_answer

            record = logged.record
            torques = record.has("target_torque") and (record.has("demand_torque") or record.has("actual_torque"))
            from_torques = torques or not record.has("reference")
            found = identify_delay(record) if from_torques else None
            if loop_rate_hz is not None:
                if from_torques:
                    raise GainroomError("--loop-rate-hz: is for logs without torques; here these tell the delay")
                require_positive("identify delay", "--loop-rate-hz", loop_rate_hz)
            tick = None if loop_rate_hz is None else 1 / loop_rate_hz
            answer = setpoint_delay_answer(identify_setpoint_delay(record, tick)) if found is None else torque_delay_answer(found)
        show(answer, logged, as_json, files={"Report": report})
        if page is not None:
            from ..report.identification import delay_page, setpoint_delay_page

            command = command_line("identify", "delay", *call.words(), ("--loop-rate-hz", loop_rate_hz), ("--report", report))
            page.write(setpoint_delay_page(answer, command) if found is None else delay_page(found, record, answer, command))
    return 0
