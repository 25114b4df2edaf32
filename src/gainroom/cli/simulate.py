"""gainroom simulate: a scenario, played."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import digits, frequency, milli, settling
from .kinds import kind_of
from .options import AsJson, Report, command_line, number_option, report_stream
from .output import emit, emit_json, render, table
from .run_output import closing, factor_words, limit_facts, limit_words, playing, vibration_facts

if TYPE_CHECKING:
    from ..studies.joint_simulation import SimulationStudy


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
    from ..files.joint_yaml import load_simulation

    spec = load_simulation(file)
    with report_stream(report, log) as page:
        from ..studies.joint_simulation import simulate_joint

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


def _row(study: "SimulationStudy", k: int) -> tuple[str, ...]:
    found = study.tracking
    return (
        study.response.joint_names[k],
        *(milli(float(value[k])) for value in (found.rms, found.peak, found.steady_state)),
        digits(100 * float(found.overshoot[k]), "%", 3),
        settling(float(found.settling_time[k])),
        digits(float(study.torque_peak[k]), "N·m", 3),
    )
