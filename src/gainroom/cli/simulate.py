"""gainroom simulate: a scenario in time, of a joint or of a robot."""

import contextlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..simulation import Run
    from ..simulation.simulation_spec import SimulationSpec
    from ..studies.simulation import Outcome


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
        from ..report.simulation_text import SimulationPresentation

        shown = SimulationPresentation(outcome, study_call, call=call, files={"Log": log, "Report": report})
        present(shown, as_json, verbose)
        if page is not None:
            from ..report.simulation import simulation_page

            page.write(simulation_page(shown, typed_command(context, "log")))
    return exit_status(outcome.verdict, exit_zero)


def _load(file: Path, feedforward: Path | None) -> "SimulationSpec":
    """Simulation that the file describes."""
    if kind_of(file) == "robot":
        if feedforward is not None:
            from ..errors import GainroomError

            raise GainroomError(f"--feedforward: {feedforward} is one joint's torque, and {file} describes a robot")
        from ..files.robot_yaml import load_robot_system
        from ..simulation.robot_simulation import RobotSimulation

        return RobotSimulation.of(load_robot_system(file))
    from ..files.joint_yaml import load_simulation

    return load_simulation(file, feedforward, two_paths=True)


def _simulated(spec: "SimulationSpec", gain: float, log: Path | None) -> "Outcome":
    """Outcome of a simulation with progress and log; an interrupted run reports where it stopped, and exits."""
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
    """Function that writes parts of a run to `log`. Raises GainroomError if `log` cannot be written."""
    if log is None:
        yield lambda part: None
        return
    from ..files.logs import open_log

    refuse_inputs(log, "log")
    with open_log(log, spec.joint_names, spec.signals) as writer:
        yield lambda part: writer.write(part.columns())
