"""The tracked limit at every control tick, rigid-body terms included, and what of it can be trusted."""

import tempfile
import time
from dataclasses import replace
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio

import gainroom as gr
from gainroom.robot.linearize import linearize

from .measure import no_collection, waited
from .table import Table
from .talos import talos

TICKS, STANCE, CHECKS, RUNS = 20_000, 800, 200, 3
BESIDE, OTHER_WORK = 2_000, 1_000_000  # ticks with other work between them, and its numbers: 8 MB
LEFT, ABOVE = 1.0, 1e-6  # [%], relative
LONGEST = {"joint": (15.0, 50.0), "task": (40.0, 150.0), "TALOS": (60.0, 150.0)}  # median and p99.9 [µs]
SAMPLE_TIME = 5e-4
COM_GAINS = {"kp": 100.0, "kd": 20.0}
STATES = "{double: [left_sole_link, right_sole_link], left: [left_sole_link], right: [right_sole_link], flight: []}"


def run(seed: int) -> Table:
    """Robots in random smooth motion, contacts changing every 800 ticks of 1 ms; `seed` draws the motion."""
    table = Table("GainTracker: one tick, from posture to limit")
    for case, sample_time in product(LONGEST, (None, SAMPLE_TIME)):
        robot, control = _talos(sample_time) if case == "TALOS" else _biped(case, sample_time)
        system = replace(robot.system, source=robot, control=control)
        body, postures = robot.body, _motion(robot, seed)
        names = gr.GainTracker(robot, system.control).contacts
        contacts = [names[k // STANCE % len(names)] for k in range(TICKS)]
        motions = [gr.GainTracker(robot, system.control).replay(postures, contacts) for _ in range(RUNS)]
        gains, certified, taken = motions[0].gain, motions[0].certified, np.array([motion.seconds for motion in motions])
        if not all(np.array_equal(motion.gain, gains, equal_nan=True) for motion in motions):
            raise RuntimeError("the same motion led to other limits")
        called, tracker, rigid = np.ones(TICKS), gr.GainTracker(robot, system.control), np.ones(TICKS)  # written to already: no page is new
        with no_collection():
            for k, (q, contact) in enumerate(zip(postures, contacts, strict=True)):
                begun = time.perf_counter()
                tracker.update(q, contact)
                called[k] = time.perf_counter() - begun
        tracker, other, beside = gr.GainTracker(robot, system.control), np.zeros(OTHER_WORK), np.empty(BESIDE)
        for k in range(BESIDE):
            other += 1.0
            beside[k] = tracker.replay(postures[k : k + 1], contacts[k]).seconds[0]
        data = body.model.createData()
        for k, q in enumerate(postures):
            begun = time.perf_counter()
            pinocchio.crba(body.model, data, q, pinocchio.Convention.WORLD)
            rigid[k] = time.perf_counter() - begun
        looked = np.flatnonzero(certified)[:: max(1, np.sum(certified) // CHECKS)]
        above = max(
            gains[k] / gr.gain_limit(system.loop(linearize(body, robot.actuators, postures[k], robot.contacts[contacts[k]]))).gain - 1
            for k in looked
        )
        name = {"joint": "12 joints", "task": "12 joints, tasks", "TALOS": "32 joints"}[case]
        time_model = f"{name}, {'continuous' if sample_time is None else f'{1 / sample_time:g} Hz'}"
        median, tail = LONGEST[case]
        least = taken.min(axis=0)
        for figure, value, limit in (
            ("median [µs]", 1e6 * np.median(taken[0]), median),
            ("p99.9 [µs]", 1e6 * np.quantile(taken[0], 0.999), tail),
            (f"p99.9 of each tick's least in {RUNS} runs [µs]", 1e6 * np.quantile(least, 0.999), tail),
            ("p99.9 of waits as long as each tick's least [µs]", 1e6 * np.quantile(waited(least), 0.999), None),
            ("after other work, median [µs]", 1e6 * np.median(beside), None),
            ("called from Python, median [µs]", 1e6 * np.median(called), None),
            ("called from Python, p99.9 [µs]", 1e6 * np.quantile(called, 0.999), None),
            ("Pinocchio's mass matrix alone, median [µs]", 1e6 * np.median(rigid), None),
            ("ticks not certified [%]", 100 - 100 * np.mean(certified), LEFT),
            ("certified above gain_limit by, relative", above, ABOVE),
        ):
            table.rows.append({"figure": f"{time_model}: {figure}", "value": float(value), "at most": limit})
    table.notes = [
        f"{TICKS:,} ticks in C++, as a controller has them; {CHECKS} certified ones are computed cold by gain_limit afterwards. "
        "Tasks: centre of mass and pelvis, 6 directions, K'p 100 1/s² and K'v 20 1/s. 12 joints: the biped, 32: TALOS.",
        f"After other work: {BESIDE:,} ticks, before each of which {OTHER_WORK / 1e6:g} million numbers are rewritten: caches are empty.",
        f"The same motion {RUNS} times, with the same limits to the last digit: a tick that is long in one run alone was interrupted, on a",
        "shared machine, and its least over the runs is what it takes by itself. A wait as long, which does nothing but look at the clock,",
        "shows what the machine adds to any program. The rest is of the first run.",
    ]
    return table


def _biped(space: str, sample_time: float | None) -> tuple[Any, Any]:
    """Robot and control; the example's own gains of the centre of mass are stable at no factor in some of the postures that are drawn."""
    robot = gr.load_robot(str(files("gainroom") / "files" / "examples" / "biped.yaml"))
    control = replace(robot.system.control, sample_time=sample_time)
    if space == "joint":
        return robot, control
    robot = replace(robot, stack=(replace(robot.stack[0], **COM_GAINS), *robot.stack[1:]))
    return robot, replace(control, space=space, controller=None)


def _talos(sample_time: float | None) -> tuple[Any, Any]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "talos.yaml"
        file.write_text(talos(STATES), "utf-8")
        robot = gr.load_robot(str(file))
    return robot, replace(robot.system.control, sample_time=sample_time)


def _motion(robot: Any, seed: int) -> np.ndarray:
    """Postures about the first one: every joint a sum of three sines of 0.1 to 0.8 Hz."""
    rng, size = np.random.default_rng([5, seed]), robot.body.size
    rates, phases = rng.uniform(0.1, 0.8, (size, 3)), rng.uniform(0, 2 * np.pi, (size, 3))
    swing = rng.uniform(0.3, 1.0, (size, 1)) / (2 * np.pi * rates) / 1.5
    middle = robot.body.configuration(dict(next(iter(robot.postures.values())).angles))
    found = []
    for tick in range(TICKS):
        q = middle.copy()
        q[len(q) - size :] += np.clip(np.sum(swing * np.sin(2e-3 * np.pi * rates * tick + phases), axis=1), -0.6, 0.6)
        found.append(q)
    return np.array(found)
