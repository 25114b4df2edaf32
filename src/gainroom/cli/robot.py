"""gainroom robot: the whole robot, by posture and contact state."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..io.numbers import decibels, digits, hertz, model_in_words, model_kind
from .options import AsJson, Report, command_line, report_stream
from .output import emit, emit_json, render, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..coupled_gains import Kept
    from ..robot_gains import RobotGains
    from ..robot_study import JointRow, RobotStudy, StateStudy, TaskRow


LEGEND = (
    "Limits are factors on gains. alone: no other loop, neighbours free; closed: all other loops as they are. load: link inertia with "
    "neighbours free [kg·m²]; kp [N·m/rad], kd [N·m·s/rad], of tasks [1/s²], [1/s]; max: with all other gains as they are; part: share in "
    "the vibration at the limit; delay: what may be added before the robot vibrates; disk: disk margin of all loops, changed independently."
)


def robot(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A robot.yaml; `gainroom example biped` prints one.", show_default=False),
    ],
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """How far a robot's gains may go with all joints closed, in every posture and contact state, and which joints would vibrate.

    \b
    Example:
      gainroom robot robot.yaml --report robot.html

    Exit status: 0 stable in every state; 1 unstable; 2 the file or the call is wrong.
    """
    from ..robot_config import load_robot_spec

    spec = load_robot_spec(file)
    with report_stream(report, [file]) as stream:
        from ..robot_study import study_robot

        with progress_bar("robot:") as progress:
            study = study_robot(spec, progress)
        if stream is not None:
            from ..report.robot import robot_page

            stream.write(robot_page(study, command_line("robot", file, "--report", report)))
    if as_json:
        emit_json(_facts(study))
    else:
        emit(_terminal(study, report))
    return 0 if study.stable else 1


def _facts(study: "RobotStudy") -> dict[str, Any]:
    """What --json prints."""
    sample_time = study.spec.control.sample_time
    return {
        "stable": study.stable,
        "sentence": study.sentence,
        "model": model_kind(sample_time),
        "sample_rate_hz": None if sample_time is None else 1 / sample_time,
        "states": [_state_facts(state) for state in study.states],
        "recommended": [_gains_facts(gains) for gains in study.recommended] or None,
        "assumptions": list(study.spec.assumptions),
        "warnings": list(study.warnings),
    }


def _state_facts(state: "StateStudy") -> dict[str, Any]:
    limit, margins, tasks = state.limit, state.margins, state.tasks
    return {
        "posture": state.posture,
        "contact": state.contact,
        "stable": limit.stable,
        "gain_limit": limit.gain,
        "lower_gain_limit": limit.lower_gain,
        "limit_frequency_rad_s": limit.frequency,
        "limit_certified": limit.certificate is not None and limit.certificate.holds,
        "limiting_joints": list(state.limiting_joints),
        "phase_margin_deg": math.degrees(margins.phase_margin),
        "delay_margin_ms": 1e3 * margins.delay_margin,
        "disk_margin": state.disk_margin,
        "joints": [_row_facts(row) for row in state.joints],
        "tasks": [] if tasks is None else [_row_facts(row) for row in tasks.rows],
        "tasks_gain_limit": None if tasks is None else tasks.limit.gain,
        "tasks_limit_frequency_rad_s": None if tasks is None else tasks.limit.frequency,
    }


def _gains_facts(gains: "RobotGains") -> dict[str, Any]:
    """Recommended gains of one space: those that are safe everywhere, and by contact state."""
    sets = {"everywhere": gains.everywhere, **gains.per_contact}
    return {
        "space": gains.space,
        "names": list(gains.names),
        "sets": [
            {"contact": name, "kp": found.kp, "kd": found.kd, "binding": found.binding, **_kept_facts(found.kept)}
            for name, found in sets.items()
            if found is not None
        ],
        "cost": gains.cost,
    }


def _kept_facts(kept: "Kept") -> dict[str, float]:
    return {
        "gain_margin_db": decibels(kept.gain_margin),
        "phase_margin_deg": math.degrees(kept.phase_margin),
        "peak_sensitivity": kept.peak_sensitivity,
    }


def _row_facts(row: "JointRow | TaskRow") -> dict[str, Any]:
    return {name: getattr(row, name) for name in row.__dataclass_fields__}


def _terminal(study: "RobotStudy", report: Path | None) -> str:
    model = model_in_words(study.spec.control.sample_time)
    states = table(
        f"All joints together ({model}); factor on all gains",
        ("posture, contact", "limit", "at", "delay", "disk", "most of all", "stable"),
        [_state_row(state) for state in study.states],
    )
    parts: list[Any] = [study.sentence, "", states]
    for state in study.tightest_by_contact:
        parts += _contact_tables(state)
    for gains in study.recommended:
        parts += _gains_parts(gains)
    parts.append(LEGEND)
    if len(study.spec.robot.postures) > 1:
        parts.append("Of several postures, the tables by joint and task show the tightest; --json has them all.")
    if report is not None:
        parts.append(f"Report: {report}")
    parts += [f"Assumed: {assumption}" for assumption in study.spec.assumptions]
    parts += [f"Warning: {warning}" for warning in study.warnings]
    return render(*parts)


def _state_row(state: "StateStudy") -> tuple[str, ...]:
    limit = state.limit
    first, *others = state.limiting_joints or ("–",)
    return (
        state.title,
        digits(limit.gain),
        hertz(limit.frequency) if math.isfinite(limit.frequency) else "–",
        f"+{digits(1e3 * state.margins.delay_margin, 'ms', 3)}" if limit.stable else "–",
        digits(state.disk_margin, significant=3),
        f"{first}, +{len(others)}" if others else first,
        "yes" if limit.stable else "no",
    )


def _contact_tables(state: "StateStudy") -> list[Any]:
    columns = ("", "load", "alone", "closed", "kp", "max", "kd", "max", "part")
    parts: list[Any] = [table(f"Joints, {state.title}", columns, [_joint_row(row) for row in state.joints])]
    if state.tasks is not None and not all(math.isnan(row.gain_limit) for row in state.tasks.rows):
        title = f"Tasks, {state.title}; together {digits(state.tasks.limit.gain)}"
        columns = ("", "kp", "kd or kv", "ki", "alone", "closed")
        parts.append(table(title, columns, [_task_row(row) for row in state.tasks.rows]))
    return parts


def _joint_row(row: "JointRow") -> tuple[str, ...]:
    numbers = (row.link_inertia, row.single_joint_limit, row.limit_others_closed, row.kp, row.kp_max, row.kd, row.kd_max)
    return (row.name, *map(digits, numbers), digits(row.participation, significant=2) if row.participation >= 1e-3 else "–")


def _task_row(row: "TaskRow") -> tuple[str, ...]:
    ki = "" if row.ki is None else digits(row.ki)
    return (f"{row.name} {row.direction}", digits(row.kp), digits(row.kd), ki, digits(row.gain_limit), digits(row.limit_others_closed))


def _gains_parts(gains: "RobotGains") -> list[Any]:
    """The gains that are safe in every state, and what each contact state alone would allow."""
    found = gains.everywhere
    if found is None:
        return [f"No gains of the shape tried keep the required margins in every state, {gains.space} space."]
    columns, scale = ("", "kp", "kd"), gains.inertia
    if scale is not None:
        columns = (*columns, "kp/J [1/s²]", "kd/J [1/s]")
    rows = [
        (name, digits(kp), digits(kd), *(() if scale is None else (digits(kp / scale[k]), digits(kd / scale[k]))))
        for k, (name, kp, kd) in enumerate(zip(gains.names, found.kp, found.kd, strict=True))
    ]
    kept = found.kept
    margins = f"{digits(decibels(kept.gain_margin), 'dB', 3)}, {digits(math.degrees(kept.phase_margin), '°', 3)}"
    words = (
        f"In every state they keep {margins} and a peak sensitivity of {digits(kept.peak_sensitivity, significant=3)}, all loops together "
        f"and each with the others closed; {found.binding} stands in the way of more."
    )
    more = ", ".join(f"{name} {digits(cost, significant=3)}" for name, cost in gains.cost.items() if math.isfinite(cost))
    alone = [f"By itself each contact state would allow this many times these kp: {more}."] if len(gains.cost) > 1 and more else []
    return [table(f"Gains to use, {gains.space} space", columns, rows), words, *alone]
