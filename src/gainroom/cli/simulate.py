"""gainroom simulate: a scenario in time, of a joint or of a robot."""

import contextlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import digits
from .interrupts import Stopped, stop_signals
from .options import (
    AsJson,
    ExitZero,
    Report,
    Verbose,
    command_line,
    exit_status,
    kind_of,
    number_option,
    refuse_inputs,
    report_stream,
    typed_command,
)
from .output import closing, column_table, do_this, render, show, table, warned_first
from .progress import progress_bar

if TYPE_CHECKING:
    from ..simulation import Run
    from ..simulation.simulation_spec import SimulationSpec
    from ..studies.simulation import Outcome

MOST_JOINTS = 6
"""In the terminal's table of torques."""
NUMBERS = ("rms", "peak", "steady_state", "overshoot", "settling_time")
"""Of Tracking, in JSON."""


def simulate(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A joint.yaml or robot.yaml; see `gainroom example`.", show_default=False)],
    as_json: AsJson = False,
    verbose: Verbose = False,
    exit_zero: ExitZero = False,
    report: Report = None,
    log: Annotated[Path | None, typer.Option("--log", metavar="LOG", help="Also write every tick: .csv, .parquet or .mcap.")] = None,
    feedforward: Annotated[
        Path | None,
        typer.Option("--feedforward", metavar="LOG", help="Hold the joint under this target_torque, as of `gainroom identify plan`."),
    ] = None,
    gain: Annotated[float, number_option("--gain", "", "Multiply all gains by this.", metavar="FACTOR")] = 1.0,
) -> int:
    """Simulate the scenario of a joint or a robot: how well it tracks, and whether it vibrates or diverges.

    \b
    Example:
      gainroom simulate joint.yaml --gain 1.2 --log run.csv --report run.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..errors import GainroomError

    if not 1e-6 <= gain <= 1e6:  # not a number is refused too
        raise GainroomError(f"--gain: {gain:g} must be a factor from 1e-06 to 1e+06")
    spec = _load(file, feedforward)
    call = typed_command(context, "log", "gain", "report")
    study_call = command_line("robot" if spec.kind == "mujoco" else "joint", file)
    with report_stream(report, log) as page:
        outcome = _simulated(spec, gain, log)
        show(as_json, lambda: _facts(outcome, log), lambda: _terminal(outcome, call, study_call, report, log, verbose))
        if page is not None:
            from ..report.simulation import simulation_page

            page.write(simulation_page(outcome, typed_command(context, "log"), call, study_call))
    return exit_status(outcome.verdict, exit_zero)


def _load(file: Path, feedforward: Path | None) -> "SimulationSpec":
    """What the file describes."""
    if kind_of(file) == "robot":
        if feedforward is not None:
            from ..errors import GainroomError

            raise GainroomError(f"--feedforward: {feedforward} is one joint's torque, and {file} describes a robot")
        from ..files.robot_yaml import load_robot_system
        from ..simulation.robot_simulation import RobotSimulation

        return RobotSimulation.of(load_robot_system(file))
    from ..files.joint_yaml import load_simulation

    return load_simulation(file, feedforward)


def _simulated(spec: "SimulationSpec", gain: float, log: Path | None) -> "Outcome":
    """With progress, and the log as it goes; an interrupted run reports where it stopped, and exits."""
    from ..studies.simulation import Interrupted, simulate_study

    with stop_signals() as stopped:
        written = "" if log is None else f"; {log} has the rows up to then"
        try:
            with _log_rows(log, spec) as rows, progress_bar("simulate:") as progress:
                outcome = simulate_study(spec, gain, rows, progress, lambda: stopped() != 0)
        except Interrupted as end:
            raise Stopped(stopped(), f" at {end.time:g} s of {spec.duration:g} s{written}") from end
        except KeyboardInterrupt as end:  # asked twice
            raise Stopped(stopped() or signal.SIGINT) from end
    if stopped():  # after the run, while it was being judged
        raise Stopped(stopped(), written)
    return outcome


@contextlib.contextmanager
def _log_rows(log: Path | None, spec: "SimulationSpec") -> Iterator[Callable[["Run"], None]]:
    """A function that takes the parts of a run. Raises GainroomError where `log` cannot be written."""
    if log is None:
        yield lambda part: None
        return
    from ..files.logs import open_log

    refuse_inputs(log, "log")
    with open_log(log, spec.joint_names, spec.signals) as writer:
        yield lambda part: writer.write(part.columns())


def _facts(outcome: "Outcome", log: Path | None) -> dict[str, Any]:
    """What --json prints."""
    from ..report.simulation_text import sentence, unsettled, warnings

    run, found, limit, seen = outcome.run, outcome.tracking, outcome.limit, outcome.oscillation
    by_joint = {
        name: dict(zip(run.joint_names, getattr(outcome, name).tolist(), strict=True)) for name in ("at_torque_limit", "torque_peak")
    }
    return {
        **outcome.verdict.facts,
        "diverged": run.diverged,
        "diverged_at": run.diverged_at,
        "fell": run.ending == "fell",
        "ended_at": run.ended_at,
        "vibrates": outcome.vibrates,
        "unstable": outcome.hidden,
        "sentence": sentence(outcome),
        "model": outcome.spec.kind,
        "sample_rate_hz": 1 / run.sample_time,
        "gain": outcome.gain,
        "tracking": {channel: {name: getattr(found, name)[k] for name in NUMBERS} for k, channel in enumerate(run.channels)},
        **by_joint,
        "slip": dict(zip(outcome.spec.contact_frames, outcome.slip.tolist(), strict=True)),
        "vibration": None
        if seen is None
        else {
            "frequency_rad_s": seen.vibration.frequency,
            "growth_rate": seen.vibration.growth_rate,
            "amplitude": seen.vibration.amplitude,
            "joints": [name for name in seen.strongest if name in run.joint_names] or list(run.joint_names),
        },
        "predicted": None
        if limit is None
        else {"stable": limit.stable, "gain_limit": limit.gain, "limit_frequency_rad_s": limit.frequency},
        "log": None if log is None else str(log),
        "settled": not unsettled(outcome) if any(time == time for time in found.settling_time.tolist()) else None,
        "warnings": list(warnings(outcome)),
    }


def _terminal(outcome: "Outcome", call: str, study_call: str, report: Path | None, log: Path | None, verbose: bool) -> str:
    """`call`, `study_call`: see what_to_do; `verbose`: also torques, and the vibration beside the linear loop's."""
    from ..report.columns import Column
    from ..report.simulation_advice import what_to_do
    from ..report.simulation_text import TRACKING, limit_text, sentence, tracking_cells, vibration_text, warnings

    run = outcome.run
    tracking = [(f"{channel} [m{run.units[k]}]", *tracking_cells(outcome, k)) for k, channel in enumerate(run.channels)]
    columns = [Column(title, "", lambda row, k=k: row[k]) for k, title in enumerate(("", *TRACKING))]
    hardest = sorted(range(len(run.joint_names)), key=lambda k: -outcome.torque_peak[k])[:MOST_JOINTS]
    torques = [
        (run.joint_names[k], *(digits(float(values[k]), run.torque_units[k], 3) for values in (outcome.torque_peak, outcome.torque_rms)))
        for k in hardest
    ]
    rate = digits(1 / run.sample_time, "Hz")
    doubts, said = warned_first(warnings(outcome), None if verbose else 3)
    parts: list[Any] = [
        *doubts,
        sentence(outcome),
        *do_this(what_to_do(outcome, call, study_call)),
        "",
        column_table(f"Tracking ({outcome.spec.kind}, {rate}, encoders on the {run.feedback} side)", columns, tracking),
    ]
    more = [
        table("Joints with the largest torques" if len(run.joint_names) > 1 else "Torque", ("", "torque peak", "RMS"), torques),
        table(
            "Vibration", ("", "frequency", "growth"), [("simulated", *vibration_text(outcome)), ("linear loop", *limit_text(outcome.limit))]
        ),
    ]
    shown = closing({"Log": log, "Report": report}, said)
    return render(*parts, *(more if verbose else []), *shown, *([] if verbose else ["Torques and vibration: --verbose."]))
