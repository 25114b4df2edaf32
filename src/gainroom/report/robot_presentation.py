"""A robot's study as it is shown: keys of --json, lines of the terminal, page."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..design.gain_sets import RobotGains
from ..studies.robot import RobotStudy
from ..studies.state import USUAL_RATE, State
from ..studies.sweep.summary import SweepSummary, SweptPosture
from .columns import definitions, facts
from .margin_columns import margin_facts, required_facts
from .number_format import model_facts, model_text
from .presentation import Grid, Legend, Part, Presentation, closing, folded, warned_first
from .recommended_gains import gain_columns, gains_text, recommended_facts, rows
from .robot_columns import JOINT, TASK, actuator_facts, state_columns, worst_facts
from .robot_tables import TASK_UNITS, joint_legend, tasks_together
from .robot_text import notes, sentence, warnings
from .robot_units import requirements_text
from .sweep_text import checked_sentence, posture_facts, worse_note
from .verdict import robot_to_use, verdict_lines
from .workspace import workspace_facts


@dataclass(frozen=True)
class RobotPresentation(Presentation):
    """All that is shown of a robot's study.

    file         the robot.yaml
    over_sweep   whether postures of a sweep count, too
    swept        what recommended gains keep in them; None where there are none
    worse        without a sweep a posture with a lower limit than the file's, and the search that found it; None where none was found
    """

    study: RobotStudy
    file: Path
    over_sweep: bool = False
    swept: SweepSummary | None = None
    worse: tuple[SweepSummary, SweptPosture] | None = None

    def facts(self) -> dict[str, Any]:
        from ..files.carried_robot import carried
        from ..files.robot_yaml import robot_sections

        study, usual = self.study, self.study.recommended_at_usual_rate
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
            "balance": study.system.balance or None,
            "worst": {name: worst_facts(study, name) for name in study.worst},
            **model_facts(study.system.control.sample_time),
            "command_delay_ms": 1e3 * study.system.control.command_delay,
            "states": [facts(state_columns(), state) for state in study.every],
            "at_usual_rate": None if usual is None else {"sample_rate_hz": USUAL_RATE, **margin_facts(usual), "requirements_met": met},
            "recommended": [recommended_facts(gains) for gains in study.recommended] or None,
            "uncertainty_cost": None if study.exact is None else {"cost": study.uncertainty_cost, "exact": recommended_facts(study.exact)},
            "actuators": actuator_facts(study.system),
            "system": carried(robot_sections(self.file), study.system),
            "assumptions": list(study.system.assumptions),
            "warnings": [*warnings(study), *notes(study)],
            **self._elsewhere_facts(),
        }

    def _elsewhere_facts(self) -> dict[str, Any]:
        if self.over_sweep:
            return {"swept": None if self.swept is None else workspace_facts(self.swept)}
        return {"worse_posture": None if self.worse is None else posture_facts(*self.worse)}

    def _elsewhere(self) -> list[str]:
        """What is said of postures that the file does not name."""
        if self.worse is not None:
            return [worse_note(*self.worse, self.study.tightest.limit.gain)]
        if self.over_sweep and self.swept is None:
            return ["There are no recommended gains that could be checked in the sweep's postures."]
        return [] if self.swept is None else [checked_sentence(self.swept)]

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        study, use = self.study, robot_to_use(self.study, self.call)
        doubts, said = warned_first(warnings(study), verbose)
        parts = [*doubts, sentence(study), *verdict_lines(study, use), *self._elsewhere()]
        if verbose:
            parts += [*folded(use), "", *_all_there_is(study)]
            yield [*parts, *closing(self.files, said, study.system.assumptions, notes(study))]
            return
        more = "By state, joint and task: --verbose, or --report."
        yield [*parts, *closing(self.files, said), *([] if self.files.get("Report") else [more])]

    def page(self, command: str) -> str:
        from .robot import robot_page  # loads the pictures

        return robot_page(self.study, command, self.swept, self._elsewhere(), self.call)


def _all_there_is(study: RobotStudy) -> list[Part]:
    """Every state, joint and task, and all recommended gains."""
    columns = state_columns()
    title = f"All joints together ({model_text(study.system.control.sample_time)})"
    states = Grid.of(title, columns, study.states + study.immobile, ("delay", "one-loop phase", "disk"))
    parts: list[Part] = [states, Legend([states], lambda shown: definitions(columns, shown)), ""]
    drops = ("load", "by itself")
    joints = {state: Grid.of(f"Joints, {state.title}", JOINT, state.joints, drops) for state in study.tightest_by_contact}
    for state, shown in joints.items():
        parts += [shown, *_task_parts(state)]
    parts.append(Legend([*joints.values()], lambda shown: joint_legend(study.system.source.body, shown)))
    if len(study.system.source.postures) > 1:
        parts.append("Of several postures, these tables show the tightest; --json has them all.")
    parts.append("")
    for gains in study.recommended:
        parts += _gains_parts(gains, study.system.source.states[0])
    return [*parts, requirements_text(study.system)]


def _task_parts(state: State) -> list[Part]:
    if state.tasks is None or not state.tasks.moves:
        return []
    return [Grid.of(f"Tasks, {state.title}; together {tasks_together(state.tasks)}", TASK, state.tasks.rows), TASK_UNITS, ""]


def _gains_parts(gains: RobotGains, first: tuple[str, str]) -> list[Part]:
    """The gains that are safe in every state, and their cost; `first`: posture and contact state."""
    safe, *_ = rows(gains)
    text: list[Part] = [*gains_text(gains, first), ""]
    if not safe.acts:
        return text
    columns = gain_columns([safe])
    if gains.inertia is not None:
        columns += gain_columns([safe], gains.inertia)[1:]
    return [Grid.of(f"Recommended gains, {gains.space} space", columns, range(len(gains.names))), *text]
