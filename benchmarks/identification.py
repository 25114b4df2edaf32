"""Joints from virtual logs: gainroom and mujoco.sysid on the same rows, errors and coverage of the 95 % intervals.

mujoco.sysid (pip install 'mujoco[sysid]') is given its best chance: the true states at the start of every window of 0.5 s, the logged
actual torque with the average over each tick (no delay is left to find), friction and damping to fit, and a start 30 % off. It fits a
two-hinge model (motor with armature, link behind a spring) and a rigid one. gainroom gets the columns of the log, and no start.
"""

import contextlib
import io
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import gainroom as gr
from gainroom.identification import Record, identify_joint

from .table import Table

LOGS, SECONDS, WINDOW = 20, 6.0, 0.5
NAMES = ("motor_inertia", "link_inertia", "stiffness", "resonance")
XML = """
<mujoco>
  <option timestep="{tick}" integrator="RK4"><flag contact="disable" gravity="disable"/></option>
  <worldbody>
    <body name="motor">
      <inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>
      <joint name="motor" type="hinge" axis="0 0 1" armature="1"/>
      {link}
    </body>
  </worldbody>
  <actuator><motor name="torque" joint="motor"/></actuator>
  <sensor><jointpos name="position" joint="motor"/></sensor>
</mujoco>
"""
LINK = """
<body name="link">
  <inertial pos="0 0 0" mass="1e-6" diaginertia="1 1 1"/>
  <joint name="spring" type="hinge" axis="0 0 1" stiffness="1" damping="0"/>
</body>
"""


def run(seed: int) -> Table:
    """One row per fit; `seed` is not used: the logs are the first of the tests' population."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from identified import joint_run

    fits: dict[str, list[dict[str, tuple[float, float, float, float]]]] = {"gainroom": [], "sysid, two hinges": [], "sysid, rigid": []}
    spent = dict.fromkeys(fits, 0.0)
    for index in range(LOGS):
        case, simulated = joint_run(index)
        tick = case.record.sample_time
        rows = slice(0, int(SECONDS / tick))
        log = Record(case.record.time[rows], {name: column[rows] for name, column in case.record.channels.items()}, tick)
        for name in fits:
            start = time.process_time()
            try:
                found = _ours(log) if name == "gainroom" else _sysid(log, simulated, case.truth, name != "sysid, rigid")
            except gr.GainroomError:
                continue  # it says why
            if found is None:
                return Table("Joints from virtual logs", [{"fit": name, "result": "not installed: pip install 'mujoco[sysid]'"}])
            spent[name] += time.process_time() - start
            truth = case.truth | {"inertia": case.truth["motor_inertia"] + case.truth["link_inertia"]}
            fits[name].append({key: (value / truth[key] - 1, low, high, truth[key]) for key, (value, low, high) in found.items()})
    table = [_row(name, key, fits[name], spent[name]) for name in fits if fits[name] for key in fits[name][0]]
    ratio = spent["gainroom"] / spent["sysid, two hinges"]
    note = f"{LOGS} logs of {SECONDS:g} s; gainroom took {ratio:.2g} times mujoco.sysid's processor time with two hinges."
    return Table("Joints from virtual logs: errors and how often the 95 % interval holds", table, [note])


def _row(name: str, key: str, results: list[dict[str, tuple[float, float, float, float]]], spent: float) -> dict[str, Any]:
    errors = np.array([abs(result[key][0]) for result in results])
    inside = np.mean([result[key][1] <= result[key][3] <= result[key][2] for result in results])
    return {
        "fit": name,
        "parameter": key,
        "answered": f"{len(results)}/{LOGS}",
        "median error [%]": 100 * float(np.median(errors)),
        "largest [%]": 100 * float(errors.max()),
        "coverage [%]": 100 * float(inside),
        "time per log [s]": spent / len(results),
    }


def _ours(log: Record) -> dict[str, tuple[float, float, float]]:
    found = identify_joint(log).parameters
    return {name: (found[name].value, found[name].low, found[name].high) for name in NAMES}


def _sysid(log: Record, simulated: Any, truth: dict[str, Any], elastic: bool) -> dict[str, tuple[float, float, float]] | None:
    import mujoco
    from mujoco import sysid

    if not hasattr(sysid, "ParameterDict"):  # its own requirements are missing
        return None
    tick, torque, position = log.sample_time, log.channels["actual_torque"], log.channels["motor_position"]
    spec = mujoco.MjSpec.from_string(XML.format(tick=tick, link=LINK if elastic else ""))
    model = spec.compile()
    params = sysid.ParameterDict()
    for name, (value, modifier) in _parameters(truth, float(np.std(torque)), elastic).items():
        lowest = 0.0 if name in ("damping", "coulomb") else value / 5
        params.add(sysid.Parameter(name, value, lowest, 20 * value, modifier=modifier))
    motor, link = simulated.motor_position[:, 0], simulated.link_position[:, 0]
    states = np.column_stack([motor, link - motor])
    rates = np.gradient(states, tick, axis=0)
    acting, size = np.append((torque[1:] + torque[:-1]) / 2, torque[-1]), int(WINDOW / tick)
    starts, time_ = range(0, len(torque) - size, size), np.arange(size) * tick
    windows = sysid.ModelSequences(
        "joint",
        spec,
        [f"window {k}" for k in starts],
        [sysid.create_initial_state(model, states[k, : model.nq], rates[k, : model.nv], np.zeros(0)) for k in starts],
        [sysid.TimeSeries(time_, acting[k : k + size, None]) for k in starts],
        [sysid.TimeSeries.from_names(time_, position[k : k + size, None], model) for k in starts],
    )
    residual = sysid.build_residual_fn(models_sequences=[windows])
    with contextlib.redirect_stdout(io.StringIO()):  # its searches print
        found, result = sysid.optimize(initial_params=params, residual_fn=residual, optimizer="scipy", verbose=False, max_iters=30)
    variance, half = sysid.calculate_intervals(residual(result.x, found)[0], np.asarray(result.jac))
    best = {name: (float(x), float(x - h), float(x + h)) for name, x, h in zip(found.keys(), result.x, half, strict=True)}
    if not elastic:
        return {"inertia": best["inertia"]}
    return {name: best[name] for name in NAMES[:3]} | {"resonance": _resonance(result.x[:3], variance[:3, :3])}


def _resonance(point: np.ndarray, variance: np.ndarray) -> tuple[float, float, float]:
    """√(K (1/J_M + 1/J_L)), with its interval to first order."""
    motor, link, stiffness = point
    value = float(np.sqrt(stiffness * (1 / motor + 1 / link)))
    slope = np.array([-stiffness / motor**2, -stiffness / link**2, 1 / motor + 1 / link]) / (2 * value)
    half = 1.96 * float(np.sqrt(slope @ variance @ slope))
    return value, value - half, value + half


def _parameters(truth: dict[str, Any], torque: float, elastic: bool) -> dict[str, tuple[float, Any]]:
    """Start and what it changes in the model, by name."""

    def joint(name: str, attribute: str) -> Any:
        def change(spec: Any, parameter: Any) -> None:
            before = getattr(spec.joint(name), attribute)  # some are polynomials' coefficients
            value = float(parameter.value[0])
            setattr(spec.joint(name), attribute, np.append(value, np.zeros(len(before) - 1)) if np.ndim(before) else value)

        return change

    def link(spec: Any, parameter: Any) -> None:
        spec.body("link").inertia = [float(parameter.value[0])] * 3

    friction = {"coulomb": (0.05 * torque, joint("motor", "frictionloss"))}
    if not elastic:
        return {"inertia": (1.3 * (truth["motor_inertia"] + truth["link_inertia"]), joint("motor", "armature"))} | friction
    return {
        "motor_inertia": (1.3 * truth["motor_inertia"], joint("motor", "armature")),
        "link_inertia": (0.8 * truth["link_inertia"], link),
        "stiffness": (1.3 * truth["stiffness"], joint("spring", "stiffness")),
        "damping": (1.3 * truth["damping"], joint("spring", "damping")),
    } | friction
