"""gainroom simulate of a whole robot."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..report.number_format import digits, frequency, milli, settling
from .options import command_line, report_stream
from .output import emit, emit_json, render, table
from .run_output import closing, factor_words, limit_facts, limit_words, playing, vibration_facts

if TYPE_CHECKING:
    from ..simulation.oscillation import Vibration
    from ..studies.robot_outcome import RobotPlay

TRACKING = ("", "RMS", "peak", "steady state", "overshoot", "settles in")
MOST_JOINTS = 6
"""In the terminal's table of torques."""


def simulate_robot(file: Path, as_json: bool, report: Path | None, log: Path | None, gain: float) -> int:
    """As `gainroom simulate` says. Raises GainroomError as play_robot."""
    from ..files.robot_yaml import load_robot_spec
    from ..simulation.robot_result import signals_of
    from ..studies.robot_simulation import play_robot
    from ..studies.robot_verification import require_sampled

    spec = load_robot_spec(file)
    require_sampled(spec)
    with report_stream(report, log) as page:
        with playing(log, spec.robot.joint_names, spec.scenario.duration, signals_of(spec.control.space)) as told:
            play = play_robot(spec, gain, *told)
        if as_json:
            emit_json(_facts(play, log))
        else:
            emit(_terminal(play, report, log))
        if page is not None:
            from ..report.robot_simulation import robot_simulation_page

            page.write(robot_simulation_page(play, command_line("simulate", file, *factor_words(gain), "--report", report)))
    return 0 if play.sound else 1


def _facts(play: "RobotPlay", log: Path | None) -> dict[str, Any]:
    """What --json prints."""
    run, found = play.run, play.tracking
    columns = ("rms", "peak", "steady_state", "overshoot", "settling_time")
    return {
        "diverged": run.ending == "diverged",
        "fell": run.ending == "fell",
        "ended_at": None if play.completed else play.lasted,
        "vibrates": play.vibrates,
        "unstable": play.completed and not play.vibrates and not play.stable,
        "sentence": play.sentence,
        "model": "mujoco",
        "sample_rate_hz": 1 / run.setup.sample_time,
        "gain": play.gain,
        "tracking": {channel: {name: getattr(found, name)[k] for name in columns} for k, channel in enumerate(run.channels)},
        "torque_peak": dict(zip(run.joint_names, play.torque_peak.tolist(), strict=True)),
        "slip": {contact.frame: away for contact, away in zip(run.setup.contacts, play.slip.tolist(), strict=True)},
        "vibration": vibration_facts(play.vibration, joints=[run.joint_names[k] for k in play.parts_strongest_first()]),
        "predicted": limit_facts(play.limit),
        "log": None if log is None else str(log),
        "warnings": list(play.warnings),
    }


def _terminal(play: "RobotPlay", report: Path | None, log: Path | None) -> str:
    from ..studies.robot_outcome_text import TINY

    run, found, seen = play.run, play.tracking, play.vibration
    rows = [
        (
            f"{channel} [m{play.units[k]}]",
            *(milli(float(value[k]), TINY) for value in (found.rms, found.peak, found.steady_state)),
            digits(100 * float(found.overshoot[k]), "%", 3),
            settling(float(found.settling_time[k])),
        )
        for k, channel in enumerate(run.channels)
    ]
    hardest = sorted(range(len(run.joint_names)), key=lambda k: -play.torque_peak[k])[:MOST_JOINTS]
    heard = ("none", "") if seen is None else (frequency(seen.frequency), _growth(play, seen))
    parts: list[Any] = [
        play.sentence,
        "",
        table(f"Tracking in MuJoCo at {digits(1 / run.setup.sample_time, 'Hz')}", TRACKING, rows),
        table(
            "Joints that work hardest",
            ("", "torque peak", "RMS"),
            [
                (run.joint_names[k], *(digits(float(t[k]), play.torque_units[k], 3) for t in (play.torque_peak, play.torque_rms)))
                for k in hardest
            ],
        ),
        table("Vibration", ("", "frequency", "growth"), [("simulated", *heard), ("linear loop", *limit_words(play.limit))]),
    ]
    return render(*parts, *closing(log, report, play.warnings))


def _growth(play: "RobotPlay", seen: "Vibration") -> str:
    """As it was heard; of what counts as none, why."""
    from ..studies.robot_outcome_text import uncounted

    told = digits(seen.growth_rate, "1/s", 3)
    if not play.vibrates:
        return f"{told}: none, {uncounted(play)}"
    return f"{told}, while it moves" if play.heard is not None and play.heard.moving else told
