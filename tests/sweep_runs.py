"""Small sweeps with short tasks, here or in a process to be killed: python sweep_runs.py FILE STORE POSTURES WORKERS [ADDRESS]."""

import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

from gainroom.files.robot_yaml import load_robot_system
from gainroom.files.sweep_options import standing
from gainroom.studies.sweep.limits import Limits
from gainroom.studies.sweep.plan import SweepPlan, SweepTask
from gainroom.studies.sweep.postures import sampled
from gainroom.studies.sweep.run import Done, run
from gainroom.studies.sweep.store import Store

CHUNK = 32


def small_plan(file: Path, postures: int, contacts: tuple[str, ...] = (), **others) -> SweepPlan:
    system = load_robot_system(file)
    robot = system.source
    return SweepPlan(system, sampled(robot.body, standing(robot), postures), contacts or tuple(robot.contacts), chunk=CHUNK, **others)


def ran(plan: SweepPlan, path: Path, **how) -> Done:
    return run(Store.of(path, plan), **how)


def contents(path: Path) -> dict[str, bytes]:
    """Every file of a store, but for those that a killed process was in the middle of."""
    return {str(one.relative_to(path)): one.read_bytes() for one in sorted(path.rglob("*")) if one.is_file() and ".partial" not in one.name}


@dataclass(frozen=True, eq=False)
class Deadly(SweepPlan):
    """The process that computes task `deadly` is killed, always or, where there is a file `once`, the first time."""

    deadly: int = 0
    once: str = ""

    def computed(self, task: SweepTask) -> Limits:
        if task == self.task(self.deadly) and not (self.once and os.path.exists(self.once)):
            if self.once:
                Path(self.once).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().computed(task)


if __name__ == "__main__":
    file, store, postures, workers, *address = sys.argv[1:]
    ran(small_plan(Path(file), int(postures)), Path(store), workers=int(workers), scheduler=address[0] if address else "")
