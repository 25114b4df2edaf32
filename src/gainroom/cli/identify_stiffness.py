"""gainroom identify stiffness: a gearbox's stiffness from a record with the output locked."""

from typing import Annotated

from .identify_log import joint_of_log, show
from .log_options import Columns, End, GearRatio, Joints, LogFile, RateHz, RotorSide, Start, Units, log_options
from .options import AsJson, number_option


def stiffness(
    file: LogFile,
    motor_inertia: Annotated[
        float, number_option("--motor-inertia", "in kg m²", "Joint side [kg m²]: its share is taken off the torque of quick motion.")
    ] = 0.0,
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
    """The stiffness of a gearbox whose output is locked, from torque and motor position, and the hysteresis that friction makes.

    Load the joint slowly back and forth, several times, well beyond friction.

    \b
    Example:
      gainroom identify stiffness locked.csv

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell the stiffness.
    """
    from ..errors import require_positive

    require_positive("options", "--motor-inertia", motor_inertia, "kg·m²", zero=True)
    options = log_options(columns, units, rotor_side, gear_ratio, rate_hz, start, end, joint)
    with joint_of_log(file, options) as (logged, _):
        from ..identification import identify_stiffness
        from ..report.identified_joint_text import stiffness_answer

        answer = stiffness_answer(identify_stiffness(logged.record, motor_inertia))
    show(answer, logged, as_json)
    return 0
