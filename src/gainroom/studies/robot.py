"""A whole robot: every posture in every contact state, all joints at once, joint by joint, and in task space; and recommended gains."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

from ..design.robot_gains import RobotGains, recommend_robot
from ..design.side_by_side import Job, side_by_side
from ..errors import computable
from ..system.system import System
from .analysis import Analysis, analyze
from .state import Progress, State, limit_of, moves

EXPECTED_LOOKS = 250
"""Looks that the search for gains takes per state and corner of the uncertainty, roughly: for the progress bar."""
NUMBERS = ("margins", "joints", "tasks")


@dataclass(frozen=True)
class RobotStudy(Analysis):
    """What `gainroom robot` reports.

    recommended   by space
    unstable_at   posture, contact state and corner of the uncertainty in which the gains as given are unstable, for messages; "" where
                  none is found, nothing is uncertain, or they are unstable at the nominal values
    """

    recommended: tuple[RobotGains, ...] = ()
    unstable_at: str = ""

    @property
    def stable_in_range(self) -> bool:
        """At the nominal values, and at every corner of the uncertainty."""
        return self.stable and not self.unstable_at

    @property
    def requirements_met(self) -> bool | None:
        """At the nominal values; None where they are met there and something is uncertain: margins within the ranges are not computed."""
        met = bool(super().requirements_met) and self.stable_in_range
        return None if met and self.system.uncertainty.names else met

    @property
    def unstable_tasks(self) -> list[State]:
        """The states in which the tasks' own gains, which the file does not close, are unstable."""
        if self.system.control.space == "task":
            return []
        return [state for state in self.states if state.task_limit is not None and not state.task_limit.stable]


def study_robot(system: System, progress: Progress | None = None, recommend: bool = True) -> RobotStudy:
    """Everything about one robot; `recommend`: with recommended gains, which takes longest. Raises as analyze does."""
    found = analyze(system, progress, NUMBERS)
    tell = progress or (lambda done, total, what: None)
    recommended = _recommended(system, tell) if recommend and system.requirements.asked else ()
    return RobotStudy(system, found.every, recommended, _unstable_at(system) if system.uncertainty.names and found.stable else "")


def _unstable_at(system: System) -> str:
    """The first posture and contact state, at a corner of the uncertainty, in which the gains as given are unstable; "": none."""
    for case in system.cases():
        loop = case.system.loop(case.model)
        if case.place and moves(loop) and not limit_of(loop).stable:
            return case.title
    return ""


def _recommended(system: System, tell: Progress) -> tuple[RobotGains, ...]:
    """Recommended gains in joint space and, where there are tasks, in task space."""
    spaces = ("joint", "task") if system.source.stack else ("joint",)
    expected = EXPECTED_LOOKS * len(system.source.states) * 2 ** len(system.uncertainty.names) * len(spaces)
    looked = itertools.count()

    def count() -> None:
        tell(min(next(looked), expected), expected, "gains")

    def of(space: str) -> Job[RobotGains]:
        def job(told: Callable[[], None]) -> RobotGains:
            with computable(f"{system.source.name}: recommended gains, {space} space"):
                return recommend_robot(system, space, told)

        return job

    count()
    return tuple(side_by_side([of(space) for space in spaces], count))
