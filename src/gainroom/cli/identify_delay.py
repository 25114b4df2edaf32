"""gainroom identify delay: the delay of a torque, from the torques or from set-point and position."""

from .identify_log import joint_of_log, show
from .log_options import Columns, End, GearRatio, Joints, LogFile, RateHz, RotorSide, Start, Units, log_options
from .options import AsJson


def delay(
    file: LogFile,
    columns: Columns = None,
    units: Units = None,
    rotor_side: RotorSide = None,
    gear_ratio: GearRatio = None,
    rate_hz: RateHz = None,
    start: Start = None,
    end: End = None,
    joint: Joints = None,
    as_json: AsJson = False,
) -> int:
    """The delay from torque command to motor torque, its jitter, and the current loop's bandwidth and damping.

    From target_torque with demand_torque or actual_torque; without them from set-point (reference) and position.

    \b
    Example:
      gainroom identify delay run.csv

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell the delay.
    """
    options = log_options(columns, units, rotor_side, gear_ratio, rate_hz, start, end, joint)
    with joint_of_log(file, options) as (logged, _):
        from ..identification import identify_delay, identify_setpoint_delay
        from ..report.delay_text import setpoint_delay_answer, torque_delay_answer

        record = logged.record
        torques = record.has("target_torque") and (record.has("demand_torque") or record.has("actual_torque"))
        if torques or not record.has("reference"):
            answer = torque_delay_answer(identify_delay(record))
        else:
            answer = setpoint_delay_answer(identify_setpoint_delay(record))
    show(answer, logged, as_json)
    return 0
