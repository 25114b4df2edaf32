"""Recommended gains over the postures of a sweep: found for the worst ones, checked in all, and found anew if others are worse."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..robot.robot import Robot
from ..system.controller import PD
from ..system.system import System
from .progress import Progress, quiet
from .robot import RobotStudy, study_robot
from .sweep.summary import SweepSummary
from .sweep.workspace import checked_on, with_postures, with_worst_of

ROUNDS = 4
"""Most rounds of finding and checking gains: the worst posture depends on the gains."""


def study_over(system: System, store: Path, progress: Progress = quiet) -> tuple[RobotStudy, SweepSummary | None]:
    """Study with the worst postures of a sweep added to the file's, and the margins of its recommended gains in the swept postures.

    None without such gains, or if they are not a PD's, joint by joint. Raises as study_robot and with_worst_of.
    """
    system = with_worst_of(system, store)
    for left in reversed(range(ROUNDS)):
        study = study_robot(system, progress)
        gains = _with_recommended(study)
        if gains is None:
            return study, None
        found = checked_on(gains, store, progress)
        if not left or not any(one.short for one in found.contacts):
            return study, found
        system = _with(system, found)
    raise AssertionError("the last round returns")


def _with_recommended(study: RobotStudy) -> System | None:
    controller, to_use = study.system.control.controller, study.to_use
    if to_use is None or not isinstance(controller, PD) or study.system.control.space != "joint":
        return None
    _, found = to_use
    return study.system.with_controller(replace(controller, kp=np.nan_to_num(found.kp), kd=np.nan_to_num(found.kd)))


def _with(system: System, found: SweepSummary) -> System:
    """System with further postures: of each contact state the worst swept one, if it misses the gain margin."""
    short = [contact.worst[0].angles for contact in found.contacts if contact.short]
    robot: Robot = system.source  # type: ignore[assignment]
    return with_postures(system, {f"swept {k}": angles for k, angles in enumerate(short, len(robot.postures) + 1)})
