"""Audit in the training simulator as sentences and JSON."""

import math
from typing import Any

import numpy as np

from ..errors import listed
from ..robot.body import library
from ..simulation.simulated_gains import FURTHEST
from ..studies.simulator_audit import SimulatorAudit

PD = {"explicit": "explicit PD", "implicit": "its own actuators", "joint-damping": "its own actuators, kd as joint damping"}
VERDICT = {
    "both": "The simulator and the robot both hold these gains.",
    "simulator": "Only the simulator holds these gains; the robot vibrates.",
    "robot": "Only the robot holds these gains; the simulation explodes.",
    "neither": "Neither the simulator nor the robot holds these gains.",
}
ONE_SIDED = {
    "simulator": "are stable in the simulator and vibrate on the robot",
    "robot": "are stable on the robot and explode in the simulator",
}
ASSUMED = (
    "the simulator's answer, too, is for small motions, without gravity, dry friction, and limits of position and torque",
    "in the simulator joints are rigid, and no torque is late but by --decimation",
)
HELD = "in the simulator frames in contact are held, as softly as MuJoCo's contacts are by default; nothing else touches"


def simulator_sentence(result: SimulatorAudit) -> str:
    """Sentences on which of simulator and robot holds the gains, both limits, and gains that only one holds."""
    robot = result.audit.tightest.limit.gain
    vibrates = "vibrates at no factor up to 1000" if math.isinf(robot) else f"vibrates from {robot:.3g} × on"
    parts = [VERDICT[result.held_by], _simulated(result), f"The robot {'has no known limit' if math.isnan(robot) else vibrates}."]
    if result.one_sided is not None:
        holder, low, high = result.one_sided
        low = max(low, 1 / FURTHEST)  # no search goes farther down
        factors = f"from {low:.3g} × to {high:.3g} ×" if math.isfinite(high) else f"above {low:.3g} ×"
        parts.append(f"Gains {factors} {ONE_SIDED[holder]}.")
    for holder in ("simulator", "robot"):
        names = [joint.name for joint in result.joints if joint.held_by == holder]
        if names:
            parts.append(f"Of joints by themselves, only the {holder} holds the gains of {listed(names)}.")
    return " ".join(parts)


def _simulated(result: SimulatorAudit) -> str:
    """Sentence on the simulator's limit."""
    limit, simulator = result.limit, result.simulator
    held = f" held for {simulator.decimation} steps" if simulator.decimation > 1 else ""
    name = f"MuJoCo ({1e3 * simulator.timestep:.4g} ms, {simulator.integrator}, {PD[simulator.pd]}{held})"
    if math.isinf(limit.gain):
        return f"{name} is stable up to 1000 × these gains."
    at = f"at {limit.frequency / (2 * math.pi):.3g} Hz" if limit.frequency else "without oscillation"
    grows = f"{at}, mainly {listed(result.limiting_joints)}"
    if limit.stable:
        return f"{name} explodes from {limit.gain:.3g} × these gains on, {grows}."
    factors = f"below {limit.gain:.3g} × these gains" if limit.gain else f"at no factor down to {1 / FURTHEST:g}"
    step = f", or with time steps below {1e3 * result.largest_timestep:.3g} ms" if result.largest_timestep else ""
    return f"{name} explodes {grows}; it is stable {factors}{step}."


def simulator_assumptions(result: SimulatorAudit) -> tuple[str, ...]:
    """Assumptions about the simulator."""
    notes = [*result.assumed, *ASSUMED]
    if any(result.audit.system.source.contacts[state.contact] for state in result.states):
        notes.append(HELD)
    if result.armature_differs:
        names = listed(result.armature_differs)
        notes.append(f"the simulator has the file's armature, which is not the motor inertia, on {names}: or give --armature motor")
    if any(joint.ki for joint in result.audit.joints):
        notes.append("ki is left out in the simulator")
    if result.simulator.pd != "joint-damping" and np.any(result.audit.system.source.body.damping):
        part = "a part of kd" if result.simulator.damping_in_kd else "beside kd"
        notes.append(f"in the simulator the joints' own damping in the model file acts: it is {part}")
    return tuple(notes)


def simulator_facts(result: SimulatorAudit) -> dict[str, Any]:
    """JSON under the key `simulator`."""
    simulator, limit = result.simulator, result.limit
    one_sided = None if result.one_sided is None else dict(zip(("held_by", "from", "to"), result.one_sided, strict=True))
    return {
        "name": "mujoco",
        "version": library("mujoco", "MuJoCo").__version__,
        "timestep_s": simulator.timestep,
        "integrator": simulator.integrator,
        "pd": simulator.pd,
        "decimation": simulator.decimation,
        "armature": simulator.armature,
        "sentence": simulator_sentence(result),
        "held_by": result.held_by,
        "stable": limit.stable,
        "gain_limit": limit.gain,
        "limit_frequency_rad_s": limit.frequency,
        "limiting_joints": list(result.limiting_joints),
        "contact": result.tightest.contact,
        "largest_timestep_s": result.largest_timestep,
        "one_sided": one_sided,
        "joints": [vars(joint) for joint in result.joints],
        "assumptions": list(simulator_assumptions(result)),
    }
