"""The inputs and assumptions of each kind of simulation, and the sections that only its page has."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..robot.ground import Sole
from ..simulation.robot_run import RobotRun
from ..simulation.robot_simulation import RobotSimulation
from ..simulation.simulation_spec import JointSimulation
from ..studies.simulation import Outcome
from . import joint_tables
from .number_format import digits, milli, span, typed_gains
from .page import Section
from .page_parts import filters
from .robot_tables import angles_text, contacts_text, machine
from .simulation_figures import pose

Pair = tuple[str, str]


def inputs(outcome: Outcome) -> list[Pair]:
    """In the units of the file."""
    spec, run = outcome.spec, outcome.run
    ticks = f"{digits(1 / run.sample_time, 'Hz')}, {len(run.time)} rows over {digits(outcome.duration, 's')}"
    return [*KINDS[spec.kind].inputs(outcome), ("ticks", ticks)]


def _joint(outcome: Outcome) -> list[Pair]:
    spec = outcome.spec
    assert isinstance(spec, JointSimulation)
    system, controller = spec.system, spec.system.control.controller
    return [
        *joint_tables.machine(system),
        ("control", f"{typed_gains(controller)}, all × {outcome.gain:g}; {filters(controller)}"),
        *((f"scenario.{key}", text) for key, text in spec.described.items()),
    ]


def _robot(outcome: Outcome) -> list[Pair]:
    simulation = outcome.spec
    assert isinstance(simulation, RobotSimulation)
    system, setup, scenario = simulation.system, simulation.setup, simulation.system.scenario
    posture, contact = scenario.posture or next(iter(system.source.postures)), scenario.contact or next(iter(system.source.contacts))
    size, channels = setup.body.size, zip(outcome.run.channels, simulation.displacement, outcome.run.units, strict=True)
    move = ", ".join(f"{name} {milli(float(by))} m{unit}" for name, by, unit in channels if by)
    footings = ", ".join(f"{one.frame} {math.degrees(one.slope):.3g}°, {milli(one.height, 1e-6)} mm high" for one in simulation.footings)
    return [
        *machine(system),
        ("gains", f"{_gains(simulation)}; all × {outcome.gain:g}"),
        (f"posture {posture}", angles_text(system.source.postures[posture])),
        (f"contact {contact}", f"{contacts_text(setup.contacts)}{_ground(simulation) if setup.contacts else ''}"),
        *([("ground under the feet, slope and height", footings)] if footings else []),
        ("move", f"{move} in {digits(simulation.moves_until, 's')}, quintic, from rest to rest" if move else "none"),
        ("Coulomb friction of the motors", span(np.broadcast_to(setup.coulomb, size), "N·m")),
        ("viscous friction added to the motors", span(np.broadcast_to(scenario.viscous, size), "N·m·s/rad")),
        ("torque limit", _limits(np.broadcast_to(setup.torque_limit, size))),
        ("encoder steps, joint side", digits(1e3 * setup.encoder_step, "mrad", 3) if setup.encoder_step else "none"),
        *(("assumed", text) for text in system.assumptions),
    ]


def _ground(simulation: RobotSimulation) -> str:
    ground = simulation.setup.ground
    if ground is None:
        return "; fixed: they cannot slip or lift"
    feet = [(one, ground.soles.get(one.frame, Sole())) for one in simulation.setup.contacts if one.kind != "point"]
    soles = ", ".join(f"{one.frame} {_sole(sole) if one.kind == 'flat' else f'{sole.width:g} m wide'}" for one, sole in feet)
    return f"; they may slip and lift: friction {ground.friction:g}{', soles ' if soles else ''}{soles}"


def _sole(sole: Sole) -> str:
    centre = f" about ({sole.center[0]:g}, {sole.center[1]:g}) m" if any(sole.center) else ""
    return f"{sole.length:g} m × {sole.width:g} m{centre}"


def _limits(limits: np.ndarray) -> str:
    """The torque limits of the joints that have one."""
    limited = np.isfinite(limits)
    which = "" if limited.all() else f", {int(limited.sum())} of {len(limits)} joints"
    return span(limits[limited], "N·m") + which if limited.any() else "none"


def _gains(simulation: RobotSimulation) -> str:
    """The gains of the file."""
    law = simulation.system.control.controller
    if law is not None:
        return ", ".join(f"{name} {span(np.broadcast_to(getattr(law, name), simulation.setup.body.size))}" for name in law.gain_names())
    tasks = []
    for task in simulation.setup.stack:
        gains = {"kp": task.kp} | ({"kd": task.kd} if task.ki is None else {"kv": task.kd, "ki": task.ki})
        tasks.append(
            f"{task.name}: " + ", ".join(f"{name} {'/'.join(f'{g:g}' for g in np.atleast_1d(value))}" for name, value in gains.items())
        )
    return "; ".join(tasks)


def _linear(outcome: Outcome) -> str:
    return (
        "Linear two-mass joint, stepped exactly from tick to tick: torque held between ticks, velocity by the controller's own difference, "
        "exact delay. No dry friction, gravity, torque limit or encoder steps: the file's scenario adds them."
    )


def _testbed(outcome: Outcome) -> str:
    text = (
        "The same loop on a virtual testbed. Between ticks linear parts are exact; friction and gravity are constant over substeps of "
        "25 µs and create no energy. No backlash, no thermal effects."
    )
    start = (
        " The run starts at rest at the reference and without torque, so gravity first pulls the joint down; peaks and RMS include this."
    )
    return text + (start if "gravity" in outcome.spec.effects else "")


def _mujoco(outcome: Outcome) -> str:
    assert isinstance(outcome.spec, RobotSimulation)
    setup = outcome.spec.setup
    contact = (
        "fixed contacts are constraints that yield by a ten-thousandth"
        if setup.ground is None
        else "the ground force builds up within 2 ms"
    )
    text = (
        "MuJoCo between the controller's ticks, its semi-implicit Euler steps taken as leapfrog steps, so short that the frequency of the "
        f"fastest vibration of the plant is at most 1 % too high. Every elastic joint is a motor behind a spring and a damper; {contact}. "
        "Torques pass the delay and the current loop; no backlash. The controller has an exact model of the links, measures the "
        f"{setup.control.feedback} side of the gearboxes, assumes fixed contacts and compensates gravity; its Jacobians are updated "
        f"every {setup.refresh} ticks."
    )
    if outcome.limit is None:
        return text
    return (
        f"{text} The linear limit is that of small motions about the initial posture with fixed contacts, without this run's Coulomb "
        "friction, torque limit and encoder steps; its viscous friction is included."
    )


def _poses(outcome: Outcome) -> list[Section]:
    assert isinstance(outcome.spec, RobotSimulation)
    assert isinstance(outcome.run, RobotRun)
    return [Section("Initial and final posture", [pose(outcome, outcome.spec, outcome.run)])]


@dataclass(frozen=True)
class Kind:
    """One kind of simulation: title, inputs, assumptions, and sections that only its page has."""

    title: str
    inputs: Callable[[Outcome], list[Pair]]
    assumptions: Callable[[Outcome], str]
    sections: Callable[[Outcome], list[Section]] = lambda outcome: []


KINDS = {
    "linear": Kind("linear sampled model", _joint, _linear),
    "testbed": Kind("virtual testbed", _joint, _testbed),
    "mujoco": Kind("MuJoCo", _robot, _mujoco, _poses),
}
"""By SimulationSpec.kind."""
