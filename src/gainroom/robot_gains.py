"""Gains to use on a robot: one set per contact state and one that is safe in all, with every loop closed, over the stated uncertainty.

The shape of the joint gains comes from each joint alone, with the lightest load that any state gives it and the longest delay; the shape
of the task gains from the file. Each shape is then scaled as a whole (coupled_gains.py) until a requirement stands in the way.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Floats
from .controller import PD
from .coupled_gains import Case, Kept, largest_scale
from .loop import Loop
from .plant import ElasticJoint
from .recommend import recommend_pd
from .robot_spec import Robot, RobotSpec

if TYPE_CHECKING:
    from .robot.model import RobotModel

DAMPINGS = (1.0, 0.7, 0.45)
"""Factors on the damping of the shape that are tried."""
EVERYWHERE = ""
"""The contact state of the set that is safe in all."""
_JOINT = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
HEAVIEST = 1e3  # times the motor's inertia: loads beyond this, or a joint that the contacts hold, do not change a PD's limits


@dataclass(frozen=True)
class GainSet:
    """Gains for one contact state, or for all of them (contact "").

    kp, kd    joint space: (n,) [N m/rad], [N m s/rad]; task space: (m,) K'p [1/s²], K'v [1/s]
    kept      the worst of what any case keeps
    binding   posture, contact state and place in the uncertainty that stand in the way, in words
    cases     number of cases in which the requirements were checked
    """

    contact: str
    kp: Floats
    kd: Floats
    kept: Kept
    binding: str
    cases: int


@dataclass(frozen=True)
class RobotGains:
    """Recommended gains of one space ("joint" or "task").

    names        of the joints or of the task directions
    per_contact  one set per contact state, None where no scale of the shape keeps the requirements
    everywhere   the one set that is safe in all; None where there is none
    inertia      (n,) J_m + 1/W_ii in the first state: kp / inertia and kd / inertia are the gains in 1/s² and 1/s; None in task space
    """

    space: str
    names: tuple[str, ...]
    per_contact: dict[str, GainSet | None]
    everywhere: GainSet | None
    inertia: Floats | None

    @property
    def cost(self) -> dict[str, float]:
        """By contact state: how much stiffer (factor on kp) its own set is than the one that is safe everywhere."""
        if self.everywhere is None:
            return dict.fromkeys(self.per_contact, math.nan)
        return {
            name: math.nan if own is None else float(np.max(own.kp) / np.max(self.everywhere.kp)) for name, own in self.per_contact.items()
        }


@dataclass(frozen=True)
class _State:
    """One posture and contact state at one place in the uncertainty."""

    title: str
    contact: str
    spec: RobotSpec
    model: "RobotModel"


def recommend_robot(spec: RobotSpec, space: str = "joint", progress: Callable[[], None] = lambda: None) -> RobotGains:
    """Gains for the joints, or for the file's tasks (space "task").

    Raises GainroomError where nothing is required, and in task space without tasks.
    """
    states = _states(spec)
    if space == "joint":
        kp, kd = _joint_shape(spec, [state.model for state in states])
        names = spec.robot.joint_names
        cases = {state.title: _joint_case(state, kp, kd) for state in states}
        first = states[0].model
        inertia = first.motor_inertia + _link_inertia(first)
    else:
        tasks = spec.robot.tasks(states[0].model, spec.control.rotors)
        kp, kd, names, inertia = tasks.kp, tasks.kd, tasks.directions, None
        cases = {state.title: _task_case(state) for state in states}

    def of(contact: str, chosen: Sequence[_State]) -> GainSet | None:
        best, damping, start, first = None, 0.0, 1.0, 0
        for trial in DAMPINGS:
            own = [_damped(cases[state.title], trial) for state in chosen]
            found = largest_scale(own, spec.requirements, progress, start, first)
            if found.scale > 0 and (best is None or found.scale > best.scale):
                best, damping = found, trial
            start, first = found.scale or start, found.binding
        if best is None:
            return None
        return GainSet(contact, best.scale * kp, damping * kd, _worst(best.kept), chosen[best.binding].title, len(chosen))

    per_contact = {contact: of(contact, [state for state in states if state.contact == contact]) for contact in spec.robot.contacts}
    return RobotGains(space, tuple(names), per_contact, of(EVERYWHERE, states), inertia)


def _states(spec: RobotSpec) -> list[_State]:
    """Every posture and contact state, as stated and at the corners of the uncertainty."""
    robot, found = spec.robot, []
    places = [None, *itertools.product((0.0, 1.0), repeat=len(spec.uncertainty.names))] if spec.uncertainty.names else [None]
    for (posture, contact), place in itertools.product(robot.states, places):
        moved, title = spec, f"{posture}, {contact}"
        if place is not None:
            actuators, drives = spec.uncertainty.case(robot.actuators, spec.drives, place)
            moved = replace(spec, robot=_with(robot, actuators), drives=drives)
            ends = (
                f"{name.replace('_', ' ')} {'high' if share else 'low'}" for name, share in zip(spec.uncertainty.names, place, strict=True)
            )
            title += f" ({', '.join(ends)})"
        found.append(_State(title, contact, moved, moved.robot.linearize(posture, contact)))
    return found


def _with(robot: Robot, actuators) -> Robot:
    return replace(robot, actuators=actuators)


def _link_inertia(model: "RobotModel") -> Floats:
    """(n,) 1/W_ii, bounded where the contacts hold a joint."""
    own = np.diagonal(model.link_inverse_inertia)
    heaviest = HEAVIEST * np.where(model.motor_inertia > 0, model.motor_inertia, 1.0)
    return np.minimum(1 / np.maximum(own, 1 / heaviest), heaviest)


def _joint_shape(spec: RobotSpec, models: Sequence["RobotModel"]) -> tuple[Floats, Floats]:
    """(n,) kp and kd of each joint alone: the recommended ones with its lightest load and its longest delay."""
    size = models[0].size
    lightest = np.min([_link_inertia(model) for model in models], axis=0)
    latest = [drive.delay for drive in spec.drives] if spec.uncertainty.delay is None else spec.uncertainty.delay[1].tolist()
    known: dict[tuple, tuple[float, float]] = {}
    kp, kd = np.zeros(size), np.zeros(size)
    for k in range(size):
        parts: dict[str, Any] = {name: float(getattr(models[0], name)[k]) for name in _JOINT}
        joint = ElasticJoint(link_inertia=float(f"{lightest[k]:.3g}"), **parts)  # legs that differ by round-off are one joint
        drive = replace(spec.drives[k], delay=latest[k])
        key = (*parts.values(), joint.link_inertia, drive)
        if key not in known:
            known[key] = _alone(spec, joint, drive)
        kp[k], kd[k] = known[key]
    return kp, kd


def _alone(spec: RobotSpec, joint: ElasticJoint, drive) -> tuple[float, float]:
    """Recommended kp and kd of one joint; a critically damped guess where nothing limits it."""
    template = PD(1.0, 1.0, velocity_filter=spec.control.velocity_filter, notches=spec.control.notches)
    place = {"feedback": spec.control.feedback, "sample_time": spec.control.sample_time, "controller": template}
    found = recommend_pd(joint, drive, spec.requirements, **place)
    if found is not None:
        return found.kp, found.kd
    inertia, crossover = joint.motor_inertia + joint.link_inertia, 0.2 / max(drive.delay + 2 / drive.bandwidth, 1e-3)
    return inertia * crossover**2, 2 * inertia * crossover


Family = Callable[[float, float], Loop]
"""(factor on the stiffness, factor on the damping) → loop."""


def _damped(family: Family, damping: float) -> Case:
    return lambda stiffness: family(stiffness, damping)


def _joint_case(state: _State, kp: Floats, kd: Floats) -> Family:
    spec = state.spec
    return lambda stiffness, damping: spec.loop(state.model, spec.shaped(PD(stiffness * kp, damping * kd)))


def _task_case(state: _State) -> Family:
    """The tasks' own gains. Of a P/PI direction, whose stiffness is the product kp·kv, kp and ki/kv go with stiffness over damping."""
    spec = state.spec
    tasks = spec.robot.tasks(state.model, spec.control.rotors)

    def at(stiffness: float, damping: float) -> Loop:
        kp = np.where(tasks.cascade, stiffness / damping, stiffness) * tasks.kp
        moved = replace(tasks, kp=kp, kd=damping * tasks.kd, ki=stiffness * tasks.ki)
        return spec.loop(state.model, spec.shaped(moved.controller()))

    return at


def _worst(kept: Sequence[Kept]) -> Kept:
    """The least of every margin over all cases."""
    return Kept(
        stable=all(one.stable for one in kept),
        gain_margin=min(one.gain_margin for one in kept),
        phase_margin=min(one.phase_margin for one in kept),
        peak_sensitivity=max(one.peak_sensitivity for one in kept),
    )
