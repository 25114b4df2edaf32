"""A whole robot: every posture in every contact state, all joints closed at once, joint by joint, and in task space; and gains to use."""

import itertools
import math
from dataclasses import dataclass

from ..design.robot_gains import RobotGains, recommend_robot
from ..errors import computable
from ..robot.spec import RobotSpec
from ..robot.state_cases import state_cases
from .state import Progress, State, Studied, by_headroom, limit_of, moves, states_of

EXPECTED_LOOKS = 250
"""Looks that the search for gains takes per state and corner of the uncertainty, roughly: for the progress bar."""
NUMBERS = ("margins", "joints", "tasks")


@dataclass(frozen=True)
class RobotStudy(Studied):
    """What `gainroom robot` reports.

    recommended   by space
    unstable_at   posture, contact state and corner of the uncertainty in which the gains as given are unstable, for messages; "" where
                  none is found, nothing is uncertain, or they are unstable at the nominal values
    """

    recommended: tuple[RobotGains, ...] = ()
    unstable_at: str = ""

    @property
    def stable(self) -> bool:
        """In every state in which the gains move something."""
        return all(state.limit.stable for state in self.states)

    @property
    def stable_in_range(self) -> bool:
        """At the nominal values, and at every corner of the uncertainty."""
        return self.stable and not self.unstable_at

    @property
    def worst(self) -> dict[str, State]:
        """By name of a requirement, the state that has least left of it; one of which that is not known comes first.

        Of mirrored states, which differ by round-off, the first.
        """

        def left(state: State, name: str) -> float:
            value = state.margins.least(name) * (-1 if name == "peak_sensitivity" else 1)
            return -math.inf if math.isnan(value) else float(f"{value:.9g}")

        names = ("gain_margin", "phase_margin", "peak_sensitivity")
        return {name: min(self.states, key=lambda state, name=name: left(state, name)) for name in names}

    @property
    def unmet(self) -> dict[str, State]:
        """The requirements that are not met in every state, each with the worst one; empty for an unstable robot."""
        asked = self.spec.requirements
        missed = {name: state for name, state in self.worst.items() if asked.met(name, state.margins.least(name)) is False}
        return missed if self.stable else {}

    @property
    def tightest_by_contact(self) -> tuple[State, ...]:
        """Of each contact state the posture with the least headroom, in the file's order."""
        contacts = dict.fromkeys(state.contact for state in self.states)
        groups = ([state for state in self.states if state.contact == contact] for contact in contacts)
        return tuple(min(group, key=lambda state: by_headroom(state.limit)) for group in groups)

    @property
    def unstable_tasks(self) -> list[State]:
        """The states in which the tasks' own gains, which the file does not close, are unstable."""
        if self.spec.control.space == "task":
            return []
        return [state for state in self.states if state.tasks is not None and state.tasks.moves and not state.tasks.limit.stable]

    @property
    def without_limit(self) -> list[State]:
        """The states of which the verdict alone is known."""
        return [state for state in self.states if math.isnan(state.limit.gain)]


def study_robot(spec: RobotSpec, progress: Progress | None = None, recommend: bool = True) -> RobotStudy:
    """Everything about one robot; `recommend`: with gains to use, which takes longest. Raises as states_of does."""
    states = states_of(spec, NUMBERS, progress)
    tell = progress or (lambda done, total, what: None)
    recommended = _recommended(spec, tell) if recommend and spec.requirements.asked else ()
    stable = all(state.limit.stable for state in states if state.moves)
    return RobotStudy(spec, states, recommended, _unstable_at(spec) if spec.uncertainty.names and stable else "")


def _unstable_at(spec: RobotSpec) -> str:
    """The first posture and contact state, at a corner of the uncertainty, in which the gains as given are unstable; "": none."""
    for case in state_cases(spec):
        loop = case.spec.loop(case.model)
        if case.place and moves(loop) and not limit_of(loop).stable:
            return case.title
    return ""


def _recommended(spec: RobotSpec, tell: Progress) -> tuple[RobotGains, ...]:
    """Gains to use in joint space and, where there are tasks, in task space."""
    expected = EXPECTED_LOOKS * len(spec.robot.states) * 2 ** len(spec.uncertainty.names)

    def of(space: str) -> RobotGains:
        looked = itertools.count()

        def count() -> None:
            tell(min(next(looked), expected), expected, f"gains, {space} space")

        count()
        with computable(f"{spec.robot.name}: gains to use, {space} space"):
            return recommend_robot(spec, space, count)

    return tuple(of(space) for space in (("joint", "task") if spec.robot.stack else ("joint",)))
