"""Joints from virtual logs: gainroom and mujoco.sysid on the same logs, errors and how often the 95 % intervals hold.

gainroom reads the columns of the log. mujoco.sysid (pip install 'mujoco[sysid]') knows the weight, starts 30 % off, and is given

- with true states: angles and velocities of motor and link at the start of every window, and the actual torque without noise;
- from rest: motor position and actual torque of the log, which begins at rest, so that the link's state is known there, and only there;
- rigid: one hinge, the target torque as if nothing were late, and states smoothed from the motor's position.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

import gainroom as gr
from gainroom.identification import Record, identify_joint

from .sysid_peer import Given, Intervals, fit, is_installed, over_ticks, true_rates
from .table import Table

SECONDS = 6.0  # length of each log [s]
SPREAD = ((0.05, 20), (0.1, 20))  # windows [s] and their number, stage after stage
FROM_REST = tuple((length, 1) for length in (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8))
RIGID = ((2.0, 2),)
SMOOTHED = (9, 4)  # ticks and order
NAMES = ("motor_inertia", "link_inertia", "stiffness", "resonance", "damping", "coulomb")
OFF = {"inertia": 1.3, "motor_inertia": 1.3, "link_inertia": 0.8, "stiffness": 1.3, "damping": 1.3, "coulomb": 0.7, "link_coulomb": 1.3}
Errors = dict[str, tuple[float, bool]]


def run(seed: int, logs: int = 3) -> Table:
    """One row per fit and parameter; `seed` is not used: the logs are the first of the tests' population."""
    title = "Joints from virtual logs"
    if not is_installed():
        return Table(title, [{"fit": "mujoco.sysid", "result": "not installed: pip install 'mujoco[sysid]'"}])
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from identified import joint_run

    results: dict[str, list[tuple[Errors, float]]] = {}
    for index in range(logs):
        case, simulated = joint_run(index)
        truth = case.truth | {"inertia": case.truth["motor_inertia"] + case.truth["link_inertia"]}
        rows = slice(0, int(SECONDS / case.record.sample_time))
        log = Record(case.record.time[rows], {name: each[rows] for name, each in case.record.channels.items()}, case.record.sample_time)
        for name, work in _fits(log, simulated, truth).items():
            begin = time.process_time()
            try:
                found = work()
            except gr.GainroomError:
                continue  # it says why
            errors = {key: (abs(value / truth[key] - 1), low <= truth[key] <= high) for key, (value, low, high) in found.items()}
            results.setdefault(name, []).append((errors, time.process_time() - begin))
    table = [_row(name, key, each) for name, each in results.items() for key in dict.fromkeys(key for errors, _ in each for key in errors)]
    notes = [f"{logs} logs of {SECONDS:g} s (--logs). What each fit is given stands in benchmarks/identification.py."]
    return Table(f"{title}: errors, and how often the 95 % interval holds", table, notes)


def _row(name: str, key: str, results: list[tuple[Errors, float]]) -> dict[str, Any]:
    found = [errors[key] for errors, _ in results if key in errors]
    errors = np.array([error for error, _ in found])
    return {
        "fit": name,
        "parameter": key,
        "logs": len(found),
        "median error [%]": 100 * float(np.median(errors)),
        "largest [%]": 100 * float(errors.max()),
        "holds [%]": 100 * float(np.mean([holds for _, holds in found])),
        "time per log [s]": float(np.mean([taken for _, taken in results])),
    }


def _fits(log: Record, simulated: Any, truth: dict[str, Any]) -> dict[str, Any]:
    """Fits to be timed on this log, by name."""
    return {
        "gainroom": lambda: _ours(log),
        "sysid, true states": lambda: _elastic(_true_states(log, simulated, truth), SPREAD, truth),
        "sysid, from rest": lambda: _elastic(_from_rest(log, truth), FROM_REST, truth),
        "sysid, rigid": lambda: fit(_rigid(log, truth), RIGID, {name: OFF[name] * truth[name] for name in ("inertia", "coulomb")}),
    }


def _ours(log: Record) -> Intervals:
    found = identify_joint(log).parameters
    return {name: (found[name].value, found[name].low, found[name].high) for name in NAMES if name in found}


def _elastic(given: Given, stages: Sequence[tuple[float, int]], truth: dict[str, Any]) -> Intervals:
    sizes = truth | {"link_coulomb": max(truth["link_coulomb"], 0.05 * truth["coulomb"])}  # none is no scale
    found = fit(given, stages, {name: off * sizes[name] for name, off in OFF.items() if name != "inertia"})
    return {name: found[name] for name in NAMES}


def _true_states(log: Record, simulated: Any, truth: dict[str, Any]) -> Given:
    tick, rows = log.sample_time, slice(0, len(log.time))
    angles, torque = np.hstack([simulated.motor_position, simulated.link_position])[rows], simulated.actual_torque[rows, 0]
    rates = true_rates(angles, torque, truth["motor_inertia"], tick)
    return Given(tick, over_ticks(torque), log.channels["motor_position"], angles, rates, truth["weight"])


def _from_rest(log: Record, truth: dict[str, Any]) -> Given:
    position, torque = log.channels["motor_position"], over_ticks(log.channels["actual_torque"])
    rest = np.full((len(position), 2), position[0])
    return Given(log.sample_time, torque, position, rest, np.zeros_like(rest), truth["weight"])


def _rigid(log: Record, truth: dict[str, Any]) -> Given:
    position, torque, tick = log.channels["motor_position"], log.channels["target_torque"], log.sample_time
    angles, rates = savgol_filter(position, *SMOOTHED), savgol_filter(position, *SMOOTHED, deriv=1, delta=tick)
    return Given(tick, torque, position, angles[:, None], rates[:, None], truth["weight"])
