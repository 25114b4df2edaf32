"""Whole workspace: a quick check of postures that a command was not asked for, and a check of gains in the postures of a stored sweep."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...design.parallel import cores
from ...errors import GainroomError
from ...robot.robot import Posture, Robot
from ...system.linear.arrays import Floats
from ...system.system import System
from ..progress import Progress, quiet
from .limits import StateLimits
from .local_pool import in_processes, in_this_process
from .plan import SweepPlan
from .postures import Samples, Trajectory, sampled
from .store import open_sweep
from .store_layout import require_finished
from .summary import SweepSummary, SweptPosture, summarized

GLANCE, GLANCED_JOINTS, LEAST_GLANCE = 256, 12, 32
"""Postures of a quick check per contact state, for a robot of up to GLANCED_JOINTS joints: a quarter of a second for a biped.

Larger robots get fewer, as the time of one grows with the third power of the joints, down to LEAST_GLANCE.
"""
WORSE = 0.99
"""Ratio to the lowest known limit below which a posture counts as worse."""
CHECKED = 20_000
"""Most postures of a sweep, evenly chosen, in which other gains are checked."""
PART = 65536
"""Number of postures read at a time."""


def over_workspace(system: System, samples: int, margin: float | None = None, progress: Progress = quiet) -> SweepSummary:
    """Summary of limits within the joints' limits in every contact state; `margin` in place of the gain margin that the system requires.

    Raises GainroomError as `sampled` does, and for closed loops.
    """
    robot = system.source
    if not isinstance(robot, Robot):
        raise GainroomError(f"{robot.name}: a workspace is a robot's")
    return summary_of(SweepPlan(system, _workspace(robot, samples), tuple(robot.contacts)), margin, progress)


def summary_of(plan: SweepPlan, margin: float | None = None, progress: Progress = quiet, workers: int | None = None) -> SweepSummary:
    """Summary of a plan that is computed without being stored; `workers`: processes, None: one per core."""
    tasks = map(plan.task, range(plan.tasks))
    count = min(cores() if workers is None else workers, plan.tasks)
    results = in_processes(plan, tasks, lambda: False, count) if count > 2 else in_this_process(plan, tasks, lambda: False)

    def counted() -> Iterator[Any]:
        done = 0
        for task, limits in results:
            yield task, limits
            done += task.size
            progress(done, plan.states, "workspace")

    return summarized(plan, counted(), margin)


def glance(system: System) -> SweepSummary | None:
    """Summary of limits in a few postures that were not asked for; None for robots whose limits the core does not prove in a row."""
    robot = system.source
    if not isinstance(robot, Robot) or robot.body.linkages or robot.body.passive:
        return None
    try:
        if not all(StateLimits(system, contact).quick for contact in robot.contacts):
            return None
        count = max(LEAST_GLANCE, int(GLANCE * min(1.0, (GLANCED_JOINTS / robot.body.size) ** 3)))
        box = _workspace(robot, count)
        angles = box.low + latin_hypercube(count, robot.body.size) * (box.high - box.low)
        return summary_of(SweepPlan(system, Trajectory(angles), tuple(robot.contacts)), workers=1)
    except GainroomError:  # a joint that slides without limits
        return None


def _workspace(robot: Robot, samples: int) -> Samples:
    """Samples within the joints' limits; a joint with equal limits stands as in the first posture."""
    base = robot.body.angles(robot.body.configuration(dict(next(iter(robot.postures.values())).angles)))
    return sampled(robot.body, base, samples)


def latin_hypercube(count: int, size: int) -> Floats:
    """Latin hypercube (count, size) in [0, 1).

    One point in each of `count` equal parts of each range. scipy's takes half a second to import.
    """
    draw = np.random.default_rng(0)
    parts = draw.permuted(np.tile(np.arange(count)[:, None], (1, size)), axis=0)
    return (parts + draw.random((count, size))) / count


def worse_posture(found: SweepSummary | None, known: float) -> tuple[SweepSummary, SweptPosture] | None:
    """Posture of a quick check with a limit clearly below `known`, the lowest of those asked for; None if it has none."""
    worst = None if found is None or not np.isfinite(known) else found.worst_posture
    return None if worst is None or found is None or not worst.gain < WORSE * known else (found, worst)


def with_worst_of(system: System, store: Path) -> System:
    """System with the worst posture of each contact state of a sweep added.

    Raises GainroomError if `store` is no store, or belongs to a robot with other joints or contact states.
    """
    found, contacts = _stored(system.source, store)  # type: ignore[arg-type]
    rows = dict.fromkeys(_lowest(found, contact) for contact in range(len(contacts)))
    return with_postures(system, {f"sweep {row}": found.angles[row].values for row in rows})


def with_postures(system: System, named: Mapping[str, Floats]) -> System:
    """System with further postures, joint positions (n,) by name."""
    robot: Robot = system.source  # type: ignore[assignment]
    more = {name: Posture(robot.body, dict(zip(robot.joint_names, values.tolist(), strict=True))) for name, values in named.items()}
    return replace(system, source=replace(robot, postures={**robot.postures, **more}))


def checked_on(system: System, store: Path, progress: Progress = quiet) -> SweepSummary:
    """Summary of the limits of the system's gains in the postures of a sweep, at most CHECKED of them, evenly chosen."""
    found, contacts = _stored(system.source, store)  # type: ignore[arg-type]
    count = found.sizes["posture"]
    chosen = found.angles[np.unique(np.linspace(0, count - 1, min(count, CHECKED)).astype(int))].values
    return summary_of(SweepPlan(system, Trajectory(chosen), contacts), progress=progress)


def _lowest(found: Any, contact: int) -> int:
    """Index of the posture with the lowest known limit in any draw, read in parts."""
    best, at = np.inf, 0
    for first in range(0, found.sizes["posture"], PART):
        gain = found.gain[:, contact, first : first + PART].values
        lowest = np.where(np.isnan(gain), np.inf, gain).min(axis=0)
        if lowest.min() < best:
            best, at = float(lowest.min()), first + int(np.argmin(lowest))
    return at


def _stored(robot: Robot, store: Path) -> tuple[Any, tuple[str, ...]]:
    """Labelled arrays and contact states of a store that fits the robot."""
    found = open_sweep(store)
    require_finished(store)
    if tuple(found.joint.values.tolist()) != robot.joint_names:
        raise GainroomError(f"{store}: is a sweep of a robot with other joints")
    contacts = tuple(str(name) for name in found.contact.values)
    unknown = [name for name in contacts if name not in robot.contacts]
    if unknown:
        raise GainroomError(f"{store}: has contact state {unknown[0]!r}, which this robot does not")
    return found, contacts
