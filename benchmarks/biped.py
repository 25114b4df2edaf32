"""The simulated biped with its 2 kHz whole-body controller on real ground: how much faster than real time, and where the time goes."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from gainroom.paper.com_motion import SAMPLE_TIME, setup
from gainroom.simulation.robot_run import RobotStepper

from .table import Table

BLOCK, BLOCKS = 400, 10
AIM = 5.0


def run(seed: int) -> Table:
    """One row per part of a tick; `seed` is not used."""
    total = _tick_time(_simulation())
    timed = _simulation()
    spent = {name: _Clock(getattr(owner, attribute)) for name, (owner, attribute) in _parts(timed).items()}
    for name, (owner, attribute) in _parts(timed).items():
        setattr(owner, attribute, spent[name])
    _tick_time(timed)
    shares = {name: clock.best / BLOCK for name, clock in spent.items()}
    shares["recording, encoders, checks"] = max(total - sum(shares.values()), 0.0)
    rows = [{"part": name, "µs per tick": 1e6 * share, "share [%]": 100 * share / total} for name, share in shares.items()]
    rows.append({"part": "all", "µs per tick": 1e6 * total, "share [%]": 100.0})
    note = f"{SAMPLE_TIME / total:.1f} times faster than real time on one core (aim: {AIM:g}); best of {BLOCKS} blocks of {BLOCK} ticks."
    return Table("Biped in MuJoCo, task-space control at 2 kHz", rows, [note])


def _simulation() -> RobotStepper:
    """Standing, past what happens only at the start."""
    simulation = RobotStepper(setup("pd"))
    for _ in range(BLOCK):
        simulation.tick(np.zeros(6))
    return simulation


def _parts(simulation: RobotStepper) -> dict[str, tuple[Any, str]]:
    return {
        "MuJoCo": (simulation, "step"),
        "controller": (simulation.control, "tick"),
        "drives": (simulation.line, "tick"),
    }


def _tick_time(simulation: RobotStepper) -> float:
    """Of one tick, with what a run does besides [s]."""
    taken = []
    offset = np.zeros(6)
    for _ in range(BLOCKS):
        start = time.perf_counter()
        for _ in range(BLOCK):
            simulation.tick(offset)
            simulation.problem()
        taken.append(time.perf_counter() - start)
        for _, (owner, attribute) in _parts(simulation).items():
            clock = getattr(owner, attribute)
            if isinstance(clock, _Clock):
                clock.close()
    return min(taken) / BLOCK


class _Clock:
    """A function that counts its time; `best` is the least of all blocks [s]."""

    def __init__(self, work: Callable[..., Any]):
        self.work, self.taken, self.best = work, 0.0, np.inf

    def __call__(self, *arguments: Any) -> Any:
        start = time.perf_counter()
        result = self.work(*arguments)
        self.taken += time.perf_counter() - start
        return result

    def close(self) -> None:
        self.best, self.taken = min(self.best, self.taken), 0.0
