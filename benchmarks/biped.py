"""The simulated biped with its 2 kHz whole-body controller on real ground: how much faster than real time, and where the time goes.

Parts are timed within the same ticks as the whole, so that their shares add up in every one of them.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from gainroom.paper.com_motion import setup
from gainroom.paper.joints import SAMPLE_TIME
from gainroom.simulation.robot_run import RobotStepper

from .measure import Spread
from .table import Table

WARM, TICKS = 400, 6000
AIM = 8.0  # times real time


def run(seed: int) -> Table:
    """One row per part of a tick; `seed` is not used."""
    simulation, offset = RobotStepper(setup("pd")), np.zeros(6)
    for _ in range(WARM):
        simulation.tick(offset)
    clocks = {name: _Clock(owner, attribute) for name, (owner, attribute) in _parts(simulation).items()}
    taken = np.empty((TICKS, len(clocks) + 1))
    begin = time.process_time()
    for k in range(TICKS):
        start = time.perf_counter()
        simulation.tick(offset)
        simulation.problem()
        taken[k, -1] = time.perf_counter() - start
        taken[k, :-1] = [clock.read() for clock in clocks.values()]
    busy = time.process_time() - begin
    total, rest = taken[:, -1].sum(), taken[:, -1] - taken[:, :-1].sum(axis=1)
    columns = dict(zip(clocks, taken.T, strict=False)) | {"recording, encoders, checks": rest, "all": taken[:, -1]}
    rows = [
        {"part": name, "share [%]": 100 * each.sum() / total, **Spread(each).cells("µs", limited=False)} for name, each in columns.items()
    ]
    speeds = {name: SAMPLE_TIME * TICKS / spent for name, spent in (("all", total), ("all, by the processor's time", busy))}
    rows.append({**dict.fromkeys(rows[0]), "part": "all, by the processor's time"})
    rows = [row | {"times real time": speeds.get(row["part"]), "at least": AIM if row is rows[-1] else None} for row in rows]
    notes = [
        f"{TICKS} ticks on one core; parts are timed within the same ticks. The processor's time leaves out what other work takes away."
    ]
    return Table("Biped in MuJoCo, task-space control at 2 kHz", rows, notes)


def _parts(simulation: RobotStepper) -> dict[str, tuple[Any, str]]:
    return {
        "MuJoCo": (simulation, "step"),
        "controller": (simulation.control, "tick"),
        "drives": (simulation.line, "tick"),
    }


class _Clock:
    """Takes the place of a method and counts its time [s] since it was read."""

    def __init__(self, owner: Any, attribute: str):
        self.work: Callable[..., Any] = getattr(owner, attribute)
        self.taken = 0.0
        setattr(owner, attribute, self)

    def __call__(self, *arguments: Any) -> Any:
        start = time.perf_counter()
        result = self.work(*arguments)
        self.taken += time.perf_counter() - start
        return result

    def read(self) -> float:
        taken, self.taken = self.taken, 0.0
        return taken
