"""gainroom robot: the whole robot, by posture and contact state."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import digits, model_in_words, model_kind
from ..report.robot_units import judged
from .options import AsJson, Report, command_line, report_stream
from .output import column_table, emit, emit_json, file_line, render, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..design.robot_gains import GainSet, RobotGains
    from ..studies.robot import RobotStudy
    from ..studies.state import State


def robot(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A robot.yaml; `gainroom example biped` prints one.", show_default=False),
    ],
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """The gain limit of a robot with all loops closed, in every posture and contact state, and the joints that vibrate there.

    \b
    Example:
      gainroom robot robot.yaml --report robot.html

    Exit status: 0 stable in every state, also at the corners of `uncertainty`; 1 unstable; 2 the file or the call is wrong.
    """
    from ..files.robot_yaml import load_robot_system

    system = load_robot_system(file)
    with report_stream(report) as page:
        from ..studies.robot import study_robot

        with progress_bar("robot:") as progress:
            study = study_robot(system, progress)
        if as_json:
            emit_json(_facts(study))
        else:
            emit(_terminal(study, report))
        if page is not None:
            from ..report.robot import robot_page

            page.write(robot_page(study, command_line("robot", file, "--report", report)))
    return 0 if study.stable_in_range else 1


def _facts(study: "RobotStudy") -> dict[str, Any]:
    """What --json prints."""
    from ..report.columns import facts, state_columns
    from ..report.robot_text import sentence, warnings

    sample_time = study.system.control.sample_time
    return {
        "stable": study.stable,
        "stable_in_range": study.stable_in_range,
        "unstable_at": study.unstable_at or None,
        "sentence": sentence(study),
        "requirements_met": study.requirements_met,
        "unmet": list(study.unmet),
        "model": model_kind(sample_time),
        "sample_rate_hz": None if sample_time is None else 1 / sample_time,
        "states": [facts(state_columns(), state) for state in study.every],
        "recommended": [_gains_facts(gains) for gains in study.recommended] or None,
        "assumptions": list(study.system.assumptions),
        "warnings": list(warnings(study)),
    }


def _gains_facts(gains: "RobotGains") -> dict[str, Any]:
    """Recommended gains of one space: those that are safe everywhere, and by contact state."""
    from ..report.columns import margin_facts

    sets = [("everywhere", gains.everywhere), *gains.per_contact.items()]  # a contact state may have that name, too
    return {
        "space": gains.space,
        "names": list(gains.names),
        "sets": [
            {
                "contact": name,
                "moves": found.moves,
                "kp": found.kp,
                "kd": found.kd,
                "ki": found.ki,
                "binding": found.binding or None,
                "binding_joint": gains.names[found.softest] if found.binding else None,
                "binding_margin": found.margin[found.softest] if found.binding else None,
                "held_back_by": [
                    {"margin": margin or None, "state": state or None} for margin, state in zip(found.margin, found.case, strict=True)
                ],
                "without_weight": found.without_weight,
                "nearest_with_weight": found.nearest or None,
                "topples": list(found.topples),
                **margin_facts(found.margins),
            }
            for name, found in sets
            if found is not None
        ],
        "cost": gains.cost,
        "not_found": {name or "everywhere": text for name, text in gains.nearest.items()},
    }


def _terminal(study: "RobotStudy", report: Path | None) -> str:
    from ..report.columns import definitions, state_columns
    from ..report.robot_tables import joint_legend
    from ..report.robot_text import sentence, warnings

    title = f"All joints together ({model_in_words(study.system.control.sample_time)})"
    columns = state_columns()
    parts: list[Any] = [sentence(study), "", column_table(title, columns, study.states + study.immobile), definitions(columns), ""]
    for state in study.tightest_by_contact:
        parts += _contact_tables(state)
    parts.append(joint_legend(study.system.source.body))
    if len(study.system.source.postures) > 1:
        parts.append("Of several postures, these tables show the tightest; --json has them all.")
    parts.append("")
    for gains in study.recommended:
        parts += _gains_parts(gains, study.system.source.states[0])
    parts.append(judged(study.system))
    if report is not None:
        parts.append(file_line("Report", report))
    parts += [f"Assumed: {assumption}" for assumption in study.system.assumptions]
    parts += [f"Warning: {warning}" for warning in warnings(study)]
    return render(*parts)


def _contact_tables(state: "State") -> list[Any]:
    from ..report.columns import JOINT, TASK
    from ..report.robot_tables import TASK_UNITS, tasks_together

    parts: list[Any] = [column_table(f"Joints, {state.title}", JOINT, state.joints)]
    if state.tasks is not None and state.tasks.moves:
        parts += [column_table(f"Tasks, {state.title}; together {tasks_together(state.tasks)}", TASK, state.tasks.rows), TASK_UNITS, ""]
    return parts


def _gains_parts(gains: "RobotGains", first: tuple[str, str]) -> list[Any]:
    """The gains that are safe in every state, and their cost; `first`: posture and contact state."""
    from ..report.columns import margins_in_words

    found = gains.everywhere
    if found is None:
        text = f"No gains were found that meet the requirements in every state, {gains.space} space; nearest: {gains.nearest['']}."
        return [text, *_own_text(gains), ""]
    if not found.moves:
        return [f"No recommended gains in {gains.space} space: nothing moves in any posture and contact state."]
    columns, scale = ("", "kp", "kd"), gains.inertia
    numbers = [found.kp, found.kd]
    if found.ki is not None:
        columns, numbers = ("", "kp", "kv or kd", "ki"), [*numbers, found.ki]
    if scale is not None:
        columns, numbers = (*columns, "kp/J [1/s²]", "kd/J [1/s]"), [*numbers, found.kp / scale, found.kd / scale]
    rows = [(name, *map(digits, row)) for name, *row in zip(gains.names, *(column.tolist() for column in numbers), strict=True)]
    where = "Without the weight" if found.without_weight else "In every state"
    words = (
        f"{where} they have: {margins_in_words(found.margins)}; all loops together and one loop at a time with the other loops closed. "
        f"None can be raised by 5 %: {_limits_text(found, gains.names)}."
    )
    if scale is not None:
        words += f" J: the motor's inertia and the load 1/W_ii in {', '.join(first)}, the first state; in another, kp/J and kd/J differ."
    return [table(f"Recommended gains, {gains.space} space", columns, rows), words, *_immobile_text(gains), *_cost_text(gains), ""]


def _limits_text(found: "GainSet", names: Sequence[str]) -> str:
    """The limit of the softest joint or direction, and the number of joints limited by each margin."""
    from ..report.robot_text import limited_by
    from ..system.requirements import title_of

    reasons = Counter(f"{title_of(margin)} in {state}" for margin, state in zip(found.margin, found.case, strict=True) if margin)
    counted = ", ".join(f"{reason} {count}" for reason, count in reasons.most_common(4))
    return f"the softest is limited by {limited_by(found, names)}; of all, {counted}"


def _own_text(gains: "RobotGains") -> list[str]:
    """The contact states that have gains of their own where no set is safe in all."""
    found = [name for name, one in gains.per_contact.items() if one is not None and one.moves]
    return [f"Contact {', '.join(found)} by itself has recommended gains: see --json and --report."] if found else []


def _immobile_text(gains: "RobotGains") -> list[str]:
    """Joints or directions without gains, as they cannot move."""
    found = gains.everywhere
    still = [] if found is None else [name for name, kp in zip(gains.names, found.kp.tolist(), strict=True) if math.isnan(kp)]
    nowhere = [name for name, one in gains.per_contact.items() if one is not None and not one.moves]
    why = "nothing can move there in any state" + ("" if gains.space == "joint" else ", or tasks above take all that could")
    words = [f"No gains for {', '.join(still)}: {why}."] if still else []
    return words + ([f"Nothing moves in contact {', '.join(nowhere)}: gains have no effect there."] if nowhere else [])


def _cost_text(gains: "RobotGains") -> list[str]:
    more = [f"{name} {digits(cost, significant=3)}" for name, cost in gains.cost.items() if math.isfinite(cost)]
    if len(more) < 2:
        return []
    return [f"Gains for one contact state alone are stiffer, by the sum of inertia over kp, this many times: {', '.join(more)}."]
