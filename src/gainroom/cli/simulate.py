"""gainroom simulate: a scenario, played."""

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..io.numbers import digits, frequency, gain_factor, milli, settling
from .interrupts import Stopped, stop_signals
from .kinds import kind_of
from .options import AsJson, Report, command_line, number_option, refuse_inputs, report_stream
from .output import emit, emit_json, file_line, render, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..limits import GainLimit
    from ..simulation import Response, Vibration
    from ..simulation.robot_result import RobotRun
    from ..simulation_study import SimulationStudy
    from ..verification import Progress


def simulate(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A joint.yaml or robot.yaml; see `gainroom example`.", show_default=False),
    ],
    as_json: AsJson = False,
    report: Report = None,
    log: Annotated[Path | None, typer.Option("--log", metavar="LOG", help="Also write every tick: .csv, .parquet or .mcap.")] = None,
    gain: Annotated[float, number_option("--gain", "", "Multiply all gains by this.", metavar="FACTOR")] = 1.0,
) -> int:
    """Play the scenario of a joint or a robot: how well it tracks, and whether it vibrates or runs away.

    \b
    Example:
      gainroom simulate joint.yaml --gain 1.2 --log run.csv --report run.html

    Exit status: 0 no vibration, and stable; 1 diverges, vibrates or is unstable;
    2 the file or the call is wrong; 130 interrupted (the log holds what was done).
    """
    from ..errors import GainroomError

    if not 1e-6 <= gain <= 1e6:  # not a number is refused too
        raise GainroomError(f"--gain: {gain:g} must be a factor from 1e-06 to 1e+06")
    if kind_of(file) == "robot":
        from .simulate_robot import simulate_robot

        return simulate_robot(file, as_json, report, log, gain)
    from ..config import load_simulation

    spec = load_simulation(file)
    with report_stream(report, log) as page:
        from ..simulation_study import simulate_joint

        with playing(log, [spec.joint.joint.name], spec.scenario.duration) as told:
            study = simulate_joint(spec, gain, *told)
        if as_json:
            emit_json(_facts(study, log))
        else:
            emit(_terminal(study, report, log))
        if page is not None:
            from ..report.simulation import simulation_page

            page.write(simulation_page(study, command_line("simulate", file, *factor_words(gain), "--report", report)))
    return 0 if study.sound else 1


def factor_words(gain: float) -> tuple[str, ...]:
    """`--gain` as it was typed, if it was."""
    return ("--gain", repr(gain).removesuffix(".0")) if gain != 1 else ()


@contextlib.contextmanager
def playing(
    log: Path | None, joints: Sequence[str], duration: float, signals: Sequence[str] | None = None
) -> Iterator["tuple[Callable[[Response | RobotRun], None], Progress, Callable[[], bool]]"]:
    """What takes a run's rows, what is told of its progress, and what says whether to stop; one that is stopped says so, and exits."""
    from ..simulation_study import Interrupted

    with stop_signals() as stopped:
        kept = "" if log is None else f"; {log} holds what was done"
        try:
            with log_rows(log, joints, signals) as rows, progress_bar("simulate:") as progress:
                yield rows, progress, lambda: stopped() != 0
        except Interrupted as end:
            raise Stopped(stopped(), f" at {end.time:g} s of {duration:g} s{kept}") from end
        except KeyboardInterrupt as end:  # asked twice
            raise Stopped(stopped() or signal.SIGINT) from end
    if stopped():  # after the run, while it was being judged
        raise Stopped(stopped(), kept)


@contextlib.contextmanager
def log_rows(
    log: Path | None, joints: Sequence[str], signals: Sequence[str] | None = None
) -> Iterator[Callable[["Response | RobotRun"], None]]:
    """What takes the parts of a run and writes their `signals`, None: all. Raises GainroomError where `log` cannot be written."""
    if log is None:
        yield lambda part: None
        return
    from ..io.logs import open_log
    from ..simulation.response import LOGGED

    refuse_inputs(log, "log")
    with open_log(log, joints, LOGGED if signals is None else signals) as writer:
        yield lambda part: writer.write(part.columns())


def _facts(study: "SimulationStudy", log: Path | None) -> dict[str, Any]:
    """What --json prints."""
    response, found, limit, vibration = study.response, study.tracking, study.limit, study.vibration
    names = response.joint_names
    columns = ("rms", "peak", "steady_state", "overshoot", "settling_time")
    return {
        "diverged": response.diverged,
        "diverged_at": response.diverged_at,
        "vibrates": study.vibrates,
        "unstable": study.hidden,
        "sentence": study.sentence,
        "model": "linear" if study.spec.is_linear else "testbed",
        "sample_rate_hz": 1 / response.sample_time,
        "gain": study.gain,
        "tracking": {name: {column: getattr(found, column)[k] for column in columns} for k, name in enumerate(names)},
        "at_torque_limit": dict.fromkeys(names, study.at_torque_limit),
        "torque_peak": dict(zip(names, study.torque_peak.tolist(), strict=True)),
        "vibration": vibration_facts(vibration),
        "predicted": limit_facts(limit),
        "log": None if log is None else str(log),
        "warnings": list(study.warnings),
    }


def vibration_facts(found: "Vibration | None", **more: Any) -> dict[str, Any] | None:
    """A vibration in JSON."""
    if found is None:
        return None
    return {"frequency_rad_s": found.frequency, "growth_rate": found.growth_rate, "amplitude": found.amplitude, **more}


def limit_facts(limit: "GainLimit | None") -> dict[str, Any] | None:
    """What the linear loop predicts, in JSON; None: the gains move nothing."""
    if limit is None:
        return None
    return {"stable": limit.stable, "gain_limit": limit.gain, "limit_frequency_rad_s": limit.frequency}


def closing(log: Path | None, report: Path | None, warnings: Sequence[str]) -> list[Any]:
    """The last lines on the terminal: what was written, and what to look at."""
    written = [file_line(name, path) for name, path in (("Log", log), ("Report", report)) if path is not None]
    return [*written, *(f"Warning: {warning}" for warning in warnings)]


def _terminal(study: "SimulationStudy", report: Path | None, log: Path | None) -> str:
    response, vibration, limit = study.response, study.vibration, study.limit
    kind = "linear, exact" if study.spec.is_linear else "testbed"
    title = f"Tracking of the {response.feedback} side ({kind}, {digits(1 / response.sample_time, 'Hz')})"
    columns = ("[mrad]", "RMS", "peak", "steady state", "overshoot", "settles in", "torque peak")
    seen = ("none", "")
    if vibration is not None:
        growth = "keeps up" if study.keeps_up else digits(vibration.growth_rate, "1/s", 3)
        seen = frequency(vibration.frequency), f"{growth}, irregular" if study.seen.irregular else growth
    parts: list[Any] = [
        study.sentence,
        "",
        *([] if response.diverged else [table(title, columns, [_row(study, k) for k in range(len(response.joint_names))])]),
        table("Vibration", ("", "frequency", "growth"), [("simulated", *seen), ("linear loop", *limit_words(limit))]),
    ]
    return render(*parts, *closing(log, report, study.warnings))


def limit_words(limit: "GainLimit | None") -> tuple[str, str]:
    """Where the linear loop begins to vibrate: frequency, and factor on the gains played; None: they move nothing."""
    if limit is None:
        return "none", "the gains move nothing"
    return frequency(limit.frequency), "at all gains" if limit.gain <= 0 else f"from {gain_factor(limit.gain)} × these gains on"


def _row(study: "SimulationStudy", k: int) -> tuple[str, ...]:
    found = study.tracking
    return (
        study.response.joint_names[k],
        *(milli(float(value[k])) for value in (found.rms, found.peak, found.steady_state)),
        digits(100 * float(found.overshoot[k]), "%", 3),
        settling(float(found.settling_time[k])),
        digits(float(study.torque_peak[k]), "N·m", 3),
    )
