"""gainroom identify: what a log tells of a joint; and in identify_plan.py what to record."""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import GainroomError, named, require_positive
from .identify_plan import plan
from .log_options import LogCall
from .options import AsJson, Number, Report, number_option, refuse_inputs, report_stream, text_output, typed_command, with_options
from .output import render, show as shown, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..files.logs import LoggedJoint
    from ..identification import JointFit
    from ..report.estimate_columns import Answer
    from ..system.drive import Drive

GAINS = ("kp", "kd")
LOW_GAINS = "no PD gains keep the usual limits over the intervals: the gains in the file are low ones to start from"

identify = typer.Typer(name="identify", rich_markup_mode=None, context_settings={"help_option_names": ["-h", "--help"]})


@identify.callback(invoke_without_command=True)
def _front(context: typer.Context) -> None:
    """What a log tells of a joint, with 95 % intervals: delay, elasticity, gains.

    \b
    Example:
      gainroom identify delay run.csv

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


@identify.command("delay", short_help="The delay of the torque, its jitter, and the current loop.")
@with_options
def delay(
    *,
    context: typer.Context,
    loop_rate_hz: Annotated[
        Number, number_option("--loop-rate-hz", "in Hz", "Of the loop on kp and kd [Hz], where no torque is logged: its hold is no delay.")
    ] = None,
    as_json: AsJson = False,
    report: Report = None,
    call: LogCall,
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
            from ..identification import identify_delay, identify_setpoint_delay
            from ..report.identified_text import setpoint_delay_answer, torque_delay_answer

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

            command = typed_command(context)
            page.write(setpoint_delay_page(answer, command) if found is None else delay_page(found, record, answer, command))
    return 0


@identify.command("joint", short_help="Inertias, stiffness, damping, friction and delay.")
@with_options
def joint(
    *,
    context: typer.Context,
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
    call: LogCall,
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
        with joint_of_log(call, report) as (logged, progress), text_output(output, "joint.yaml", yaml_of="--output") as written:
            from ..identification import identify_joint
            from ..report.identified_text import joint_answer

            if output is not None and drive is None and not logged.record.has("target_torque"):
                raise GainroomError("has no target_torque, which tells the delay that a joint.yaml needs: give --delay-ms")
            fit = identify_joint(logged.record, drive)
            answer = joint_answer(fit)
            if written is not None:
                progress(0, 0, "gains over the intervals")
                text, met = _joint_yaml(fit, logged, drive)
                written.write(text)
                answer = answer if met else replace(answer, warnings=(*answer.warnings, LOW_GAINS))
        files = {"Joint": output, "Report": report}
        show(answer, logged, as_json, files=files, facts={"output": None if output is None else str(output)})
        if page is not None:
            from ..report.identification import joint_page

            page.write(joint_page(fit, logged.record, answer, typed_command(context)))
    return 0


@identify.command("gains", short_help="The gains that a firmware applies, beside those asked for.")
@with_options
def gains(
    *,
    context: typer.Context,
    asked: Annotated[
        str | None,
        typer.Option(metavar="kp=…,kd=…", help="What the gains should be [N m/rad, N m s/rad]; or a joint.yaml. --gear-ratio helps too."),
    ] = None,
    as_json: AsJson = False,
    report: Report = None,
    call: LogCall,
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
            from ..report.identified_text import ASKED_TITLES, asked_rows, gains_answer

            fit = identify_gains(logged.record, **wanted, gear_ratio=ratio)
        answer, beside = gains_answer(fit), [*wanted.items()]
        more = [table("Beside what was asked for", ASKED_TITLES, asked_rows(fit, beside))] if wanted else []
        facts = {"asked": {name: wanted.get(name) for name in GAINS}}
        show(answer, logged, as_json, *more, files={"Report": report}, facts=facts)
        if page is not None:
            from ..report.identification import gains_page

            page.write(gains_page(fit, logged.record, beside, answer, typed_command(context)))
    return 0


@identify.command("stiffness", short_help="Stiffness from a record with the output locked.")
@with_options
def stiffness(
    *,
    context: typer.Context,
    motor_inertia: Annotated[
        float, number_option("--motor-inertia", "in kg m²", "Joint side [kg m²]: its share is taken off the torque of quick motion.")
    ] = 0.0,
    as_json: AsJson = False,
    report: Report = None,
    call: LogCall,
) -> int:
    """The stiffness of a gearbox whose output is locked, from torque and motor position, and the hysteresis that friction makes.

    Load the joint slowly back and forth, several times, well beyond friction.

    \b
    Example:
      gainroom identify stiffness locked.csv --report stiffness.html

    Exit status: 0 done; 2 the file or the call is wrong, or the log cannot tell the stiffness.
    """
    require_positive("options", "--motor-inertia", motor_inertia, "kg·m²", zero=True)
    with report_stream(report) as page:
        with joint_of_log(call, report) as (logged, _):
            from ..identification import identify_stiffness
            from ..report.identified_text import stiffness_answer

            fit = identify_stiffness(logged.record, motor_inertia)
            answer = stiffness_answer(fit)
        show(answer, logged, as_json, files={"Report": report})
        if page is not None:
            from ..report.identification import stiffness_page

            page.write(stiffness_page(fit, answer, typed_command(context)))
    return 0


identify.command("plan", short_help="What to run on the joint before, and the accuracy to expect.")(plan)


@contextlib.contextmanager
def joint_of_log(call: LogCall, report: Path | None) -> Iterator[tuple["LoggedJoint", Callable[[int, int, str], None]]]:
    """Joint in a log, and the progress of its identification; `report`: a page that must not replace the log.

    Raises GainroomError; what is raised inside names the log.
    """
    from ..files.logs import read_joint
    from ..identification.contradictions import require_consistent

    options = call.options()
    with progress_bar("identify:") as progress:
        logged = read_joint(call.file, options, progress)
        if report is not None:
            refuse_inputs(report, "report")
        progress(0, 0, "fitting")
        with named(str(call.file)):
            logged.require_dense()
            require_consistent(logged.record)
            yield logged, progress


def show(
    answer: "Answer",
    logged: "LoggedJoint",
    as_json: bool,
    *more: Any,
    files: Mapping[str, Path | None],
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Prints the sentence, the numbers, `more`, the `files` written, and the warnings; `facts`: further keys in JSON."""
    from ..report.estimate_columns import TITLES
    from ..report.log_text import logged_facts, logged_remarks
    from ..report.presentation import closing

    def all_of_it() -> dict[str, Any]:
        found = {**answer.facts(), **(facts or {}), "log": logged_facts(logged)}
        return found | {"warnings": [*found["warnings"], *logged_remarks(logged)]}

    def text() -> str:
        numbers = table(answer.title, TITLES, answer.rows())
        return render(answer.sentence, "", numbers, *more, *closing(files, answer.warnings, notes=logged_remarks(logged)))

    shown(as_json, all_of_it, text)


def _joint_yaml(fit: "JointFit", logged: "LoggedJoint", drive: "Drive | None") -> tuple[str, bool]:
    """Text of the joint.yaml, and True if its gains meet the usual limits. Raises GainroomError."""
    from datetime import date

    from .. import __version__
    from ..files.identified_joint import identified_text

    text, _, met = identified_text(fit, logged.path, drive, date.today().isoformat(), __version__)
    return text, met


def _drive(delay_ms: Number, bandwidth: Number) -> "Drive | None":
    """Drive that is known beforehand; None if neither option was given. Raises GainroomError."""
    if delay_ms is None and bandwidth is None:
        return None
    from ..system.drive import Drive

    if delay_ms is None:
        raise GainroomError("--bandwidth: needs --delay-ms; without both, delay and current loop are identified from the torques")
    return Drive(bandwidth=math.inf if bandwidth is None else bandwidth, delay=1e-3 * delay_ms)


def _asked(text: str | None, gear_ratio: float | None) -> tuple[dict[str, float], float | None]:
    """Gains asked for by name, and the gear ratio, from the options or from a joint.yaml. Raises GainroomError."""
    if text is None:
        return {}, gear_ratio
    if "=" not in text:
        from ..files.joint_yaml import load_joint

        system = load_joint(Path(text))
        controller = system.control.controller
        with named(text):
            system.control.feedback.require_one("the comparison with gains of a log, which are of one position,")
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
