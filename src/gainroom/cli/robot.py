"""gainroom robot: the whole robot, by posture and contact state."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import model_facts, model_text
from ..report.robot_units import requirements_text
from .options import AsJson, ExitZero, Report, Strict, Verbose, exit_status, report_stream, typed_command
from .output import closing, column_table, folded_parts, headings, render, show, verdict_parts, warned_first
from .progress import progress_bar

if TYPE_CHECKING:
    from ..design.gain_sets import RobotGains
    from ..studies.progress import Progress
    from ..studies.robot import RobotStudy
    from ..studies.state import State
    from ..studies.sweep.summary import SweepSummary
    from ..system.system import System


def robot(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A robot.yaml; `gainroom example biped` prints one.", show_default=False)],
    sweep: Annotated[
        Path | None, typer.Option(metavar="DIR.zarr", help="A sweep's results: its worst postures count too, and gains are checked in all.")
    ] = None,
    as_json: AsJson = False,
    verbose: Verbose = False,
    strict: Strict = False,
    exit_zero: ExitZero = False,
    report: Report = None,
) -> int:
    """The gain limit of a robot with all loops closed, in every posture and contact state, and the joints that vibrate there.

    \b
    Example:
      gainroom robot robot.yaml --report robot.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..files.robot_yaml import load_robot_system

    system = load_robot_system(file, two_paths=True)
    if system.control.kd_path is not None:
        from .two_paths import two_paths

        return exit_status(two_paths(system, as_json, report), exit_zero)
    call = typed_command(context, "report")
    with report_stream(report) as page:
        with progress_bar("robot:") as progress:
            study, swept, elsewhere = _studied(system, sweep, progress)
        show(as_json, lambda: _facts(study, file) | elsewhere[0], lambda: _terminal(study, call, report, verbose, elsewhere[1]))
        if page is not None:
            from ..report.robot import robot_page

            page.write(robot_page(study, typed_command(context), swept, elsewhere[1], call))
    return exit_status(study.verdict, exit_zero)


Elsewhere = tuple[dict[str, Any], list[str]]
"""Of postures that the file does not name: keys of --json, and what is said."""


def _studied(system: "System", sweep: Path | None, progress: "Progress") -> "tuple[RobotStudy, SweepSummary | None, Elsewhere]":
    """The study, what recommended gains keep in a sweep's postures, and what to say of postures that the file does not name.

    Without a sweep a few hundred of these are looked at beside the study, in search of one that has a lower gain limit.
    """
    from ..report.sweep_text import checked_sentence, posture_facts, worse_note
    from ..report.workspace import workspace_facts

    if sweep is not None:
        from ..studies.swept_gains import study_over

        study, found = study_over(system, sweep, progress)
        if found is None:
            return study, None, ({"swept": None}, ["There are no recommended gains that could be checked in the sweep's postures."])
        return study, found, ({"swept": workspace_facts(found)}, [checked_sentence(found)])
    from ..design.side_by_side import Job, side_by_side
    from ..studies.progress import after
    from ..studies.robot import study_robot
    from ..studies.sweep.workspace import glance, worse_posture

    jobs: list[Job[Any]] = [lambda checkpoint: study_robot(system, after(checkpoint, progress)), lambda checkpoint: glance(system)]
    study, seen = side_by_side(jobs, lambda: None)
    known = study.tightest.limit.gain
    worse = worse_posture(seen, known)
    if worse is None:
        return study, None, ({"worse_posture": None}, [])
    return study, None, ({"worse_posture": posture_facts(*worse)}, [worse_note(*worse, known)])


def _facts(study: "RobotStudy", file: Path) -> dict[str, Any]:
    """What --json prints."""
    from .. import __version__
    from ..files.carried_robot import carried
    from ..files.robot_yaml import robot_sections
    from ..report.columns import facts
    from ..report.margin_columns import margin_facts, required_facts
    from ..report.recommended_gains import recommended_facts
    from ..report.robot_columns import actuator_facts, state_columns, worst_facts
    from ..report.robot_text import notes, sentence, warnings
    from ..studies.state import USUAL_RATE

    usual = study.recommended_at_usual_rate
    met = usual is not None and study.system.requirements.met_by(usual)
    return {
        **study.verdict.facts,
        "robot": study.system.source.name,
        "gainroom": __version__,
        "stable": study.stable,
        "stable_in_range": study.stable_in_range,
        "unstable_at": study.unstable_case or None,
        "sentence": sentence(study),
        "requirements_met": study.requirements_met,
        "unmet": list(study.unmet),
        "required": required_facts(study.system.requirements),
        "worst": {name: worst_facts(study, name) for name in study.worst},
        **model_facts(study.system.control.sample_time),
        "command_delay_ms": 1e3 * study.system.control.command_delay,
        "states": [facts(state_columns(), state) for state in study.every],
        "at_usual_rate": None if usual is None else {"sample_rate_hz": USUAL_RATE, **margin_facts(usual), "requirements_met": met},
        "recommended": [recommended_facts(gains) for gains in study.recommended] or None,
        "uncertainty_cost": None if study.exact is None else {"cost": study.uncertainty_cost, "exact": recommended_facts(study.exact)},
        "actuators": actuator_facts(study.system),
        "system": carried(robot_sections(file), study.system),
        "assumptions": list(study.system.assumptions),
        "warnings": [*warnings(study), *notes(study)],
    }


def _terminal(study: "RobotStudy", call: str, report: Path | None, verbose: bool, elsewhere: list[str]) -> str:
    """`call`: this command; `verbose`: also every state, joint and task, and all recommended gains."""
    from ..report.robot_text import notes, sentence, warnings
    from ..report.verdict import MOST_WARNINGS, robot_to_use

    doubts, said = warned_first(warnings(study), None if verbose else MOST_WARNINGS)
    use, assumed = robot_to_use(study, call), study.system.assumptions
    parts = [*doubts, sentence(study), *verdict_parts(study, use), *elsewhere]
    if verbose:
        return render(*parts, *folded_parts(use), "", *_all_there_is(study), *closing({"Report": report}, said, assumed, notes(study)))
    more = [] if report is not None else ["By state, joint and task: --verbose, or --report."]
    return render(*parts, *closing({"Report": report}, said), *more)


def _all_there_is(study: "RobotStudy") -> list[Any]:
    from ..report.columns import definitions
    from ..report.robot_columns import JOINT, state_columns
    from ..report.robot_tables import joint_legend

    title = f"All joints together ({model_text(study.system.control.sample_time)})"
    columns = state_columns()
    states = column_table(title, columns, study.states + study.immobile, ("delay", "one-loop phase", "disk"))
    parts: list[Any] = [states, definitions(columns, headings(states)), ""]
    joints = {
        state: column_table(f"Joints, {state.title}", JOINT, state.joints, ("load", "by itself")) for state in study.tightest_by_contact
    }
    for state, shown in joints.items():
        parts += [shown, *_task_parts(state)]
    parts.append(joint_legend(study.system.source.body, {title for shown in joints.values() for title in headings(shown)}))
    if len(study.system.source.postures) > 1:
        parts.append("Of several postures, these tables show the tightest; --json has them all.")
    parts.append("")
    for gains in study.recommended:
        parts += _gains_parts(gains, study.system.source.states[0])
    return [*parts, requirements_text(study.system)]


def _task_parts(state: "State") -> list[Any]:
    from ..report.robot_columns import TASK
    from ..report.robot_tables import TASK_UNITS, tasks_together

    if state.tasks is None or not state.tasks.moves:
        return []
    return [column_table(f"Tasks, {state.title}; together {tasks_together(state.tasks)}", TASK, state.tasks.rows), TASK_UNITS, ""]


def _gains_parts(gains: "RobotGains", first: tuple[str, str]) -> list[Any]:
    """The gains that are safe in every state, and their cost; `first`: posture and contact state."""
    from ..report.recommended_gains import gain_columns, gains_text, rows

    safe, *_ = rows(gains)
    text = [*gains_text(gains, first), ""]
    if not safe.acts:
        return text
    columns = gain_columns([safe])
    if gains.inertia is not None:
        columns += gain_columns([safe], gains.inertia)[1:]
    return [column_table(f"Recommended gains, {gains.space} space", columns, range(len(gains.names))), *text]
