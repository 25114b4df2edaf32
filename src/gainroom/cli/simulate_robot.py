"""gainroom simulate of a whole robot."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..io.numbers import digits, frequency
from .interrupts import stop_signals
from .output import emit, emit_json, render, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..robot_simulation import RobotPlay


def simulate_robot(file: Path, as_json: bool, report: Path | None, log: Path | None, gain: float) -> int:
    """As `gainroom simulate` says. Raises GainroomError as play_robot."""
    from ..errors import GainroomError
    from ..robot_config import load_robot_spec
    from ..robot_simulation import play_robot
    from ..robot_verification import require_sampled
    from ..simulation_study import Interrupted
    from .simulate import log_rows

    if report is not None:
        raise GainroomError("--report: there is no page for the simulation of a robot; leave it out, --log keeps the run")
    spec = load_robot_spec(file)
    require_sampled(spec)
    with stop_signals() as stopped:
        try:
            with log_rows(log, file, spec.robot.joint_names) as rows, progress_bar("simulate:") as progress:
                play = play_robot(spec, gain, rows, progress, lambda: stopped() != 0)
        except Interrupted as end:
            kept = "" if log is None else f"; {log} holds what was done"
            print(f"gainroom: interrupted at {end.time:g} s of {spec.scenario.duration:g} s{kept}", file=sys.stderr)
            raise typer.Exit(128 + stopped()) from end
    warnings = [*spec.warnings]
    if as_json:
        emit_json(_facts(play, gain, log, warnings))
    else:
        emit(_terminal(play, log, warnings))
    return 0 if play.sound else 1


def _facts(play: "RobotPlay", gain: float, log: Path | None, warnings: list[str]) -> dict[str, Any]:
    """What --json prints."""
    run, seen = play.run, play.vibration
    names = ("rms", "peak", "steady_state")
    ended = float(run.time[-1]) if run.ending != "completed" and len(run.time) else None
    return {
        "diverged": run.ending == "diverged",
        "fell": run.ending == "fell",
        "ended_at": ended,
        "vibrates": play.vibrates,
        "sentence": play.sentence,
        "model": "mujoco",
        "sample_rate_hz": 1 / run.setup.sample_time,
        "gain": gain,
        "tracking": {channel: {name: getattr(play, name)[k] for name in names} for k, channel in enumerate(run.channels)},
        "vibration": None
        if seen is None
        else {"frequency_rad_s": seen.frequency, "growth_rate": seen.growth_rate, "amplitude": seen.amplitude},
        "log": None if log is None else str(log),
        "warnings": warnings,
    }


def _terminal(play: "RobotPlay", log: Path | None, warnings: list[str]) -> str:
    from .simulate import milli

    run = play.run
    rows = [
        (channel, *(milli(float(value[k])) for value in (play.rms, play.peak, play.steady_state))) for k, channel in enumerate(run.channels)
    ]
    title = f"Tracking in MuJoCo at {digits(1 / run.setup.sample_time, 'Hz')}"
    parts: list[Any] = [play.sentence, "", table(title, ("[mm, mrad]", "RMS", "peak", "steady state"), rows)]
    if play.vibration is not None:
        parts.append(f"Last vibration: {frequency(play.vibration.frequency)}, growth {digits(play.vibration.growth_rate, '1/s', 3)}")
    if log is not None:
        parts.append(f"Log: {log}")
    parts += [f"Warning: {warning}" for warning in warnings]
    return render(*parts)
