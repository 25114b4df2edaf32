"""Gains to use on a robot: one set per contact state and one that is safe in all, with every loop closed, over the stated uncertainty.

The shape of the joint gains comes from each joint alone, with the lightest load that any state gives it and the longest delay; the shape
of the task gains from the file: its kp with its kd, or with a kd that damps all directions alike. For several dampings each shape is scaled
as a whole (coupled_gains.py) until a requirement stands in the way; the stiffest is told. Not the stiffest of all shapes.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Booleans, Floats
from .controller import PD
from .coupled_gains import Case, largest_scale
from .kept import Kept
from .loop import Loop
from .plant import ElasticJoint, Plant
from .recommend import Requirements, recommend_pd
from .robot_spec import Robot, RobotSpec

if TYPE_CHECKING:
    from .robot.model import RobotModel

Family = Callable[[float, float], Loop]
"""(factor on the stiffness, factor on the damping) → loop."""
DAMPING_STEP = 1.5
"""Between the factors on the damping of a shape that are tried, up or down, as long as that helps."""
MOST_DAMPINGS = 7
"""In either direction."""
EVERYWHERE = ""
"""The contact state of the set that is safe in all."""
_JOINT = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
NOTHING_KEPT = Kept(True, math.nan, math.nan, math.nan)
ROUND_OFF = 1e-12
"""Mobility of a joint, relative to the largest, below which the contacts hold it: they leave round-off."""
HEAVIEST = 1e3  # times the motor's inertia: loads beyond this, or a joint that the contacts hold, do not change a PD's limits


@dataclass(frozen=True)
class GainSet:
    """Gains for one contact state, or for all of them (contact "").

    kp, kd    joint space: (n,) [N m/rad], [N m s/rad]; task space: (m,) K'p [1/s²], K'v [1/s]; NaN where nothing can move that joint or
              direction in any state of the set: its gains would do nothing
    ki        (m,) where a task is P/PI [1/s²]; None otherwise
    scale, damping   factors on the stiffness and on the damping of the shape; NaN where nothing moves at all
    kept      the worst of what any case keeps
    binding   posture, contact state and place in the uncertainty that stand in the way, in words
    cases     number of cases in which the requirements were checked
    """

    contact: str
    kp: Floats
    kd: Floats
    ki: Floats | None
    scale: float
    damping: float
    kept: Kept
    binding: str
    cases: int

    @property
    def moves(self) -> bool:
        """False where nothing moves in any state of the set, so that there are no gains to tell."""
        return self.cases > 0


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
        """By contact state: how much stiffer its own set is than the one that is safe everywhere, >= 1; NaN where either is missing."""
        safe = math.nan if self.everywhere is None else self.everywhere.scale
        return {name: math.nan if own is None else own.scale / safe for name, own in self.per_contact.items()}


@dataclass(frozen=True)
class _Shape:
    """Gains of stiffness and damping 1. Of a direction that is P/PI (`cascade`), whose stiffness is kp·kv, kp is their quotient."""

    kp: Floats
    kd: Floats
    ki: Floats
    cascade: Booleans

    def at(self, stiffness: float, damping: float) -> tuple[Floats, Floats, Floats]:
        """kp, kd, ki: ki/kv goes as kp does in a cascade."""
        return np.where(self.cascade, stiffness / damping, stiffness) * self.kp, damping * self.kd, stiffness * self.ki


@dataclass(frozen=True)
class _State:
    """One posture and contact state at one place in the uncertainty."""

    title: str
    contact: str
    spec: RobotSpec
    model: "RobotModel"


@dataclass(frozen=True)
class _Closed:
    """One state with its loops: `loop` by factors on stiffness and damping; `movable` (m,) which joints or directions can move."""

    title: str
    contact: str
    loop: Family
    movable: Booleans


def recommend_robot(spec: RobotSpec, space: str = "joint", progress: Callable[[], None] = lambda: None) -> RobotGains:
    """Gains for the joints, or for the file's tasks (space "task").

    Raises GainroomError where nothing is required, and in task space without tasks.
    """
    states = _states(spec)
    if space == "joint":
        shape = _joint_shape(spec, [state.model for state in states])
        names = spec.robot.joint_names
        closed = [_joint_case(state, shape) for state in states]
        first = states[0].model
        inertia = first.motor_inertia + _link_inertia(first)
    else:
        tasks = spec.robot.tasks(states[0].model, spec.control.rotors)
        shape = _Shape(tasks.kp, tasks.kd, tasks.ki, tasks.cascade)
        names, inertia = tasks.directions, None
        closed = [_task_case(state, shape) for state in states]
    required = spec.requirements
    safe = _set(EVERYWHERE, closed, shape, required, progress)
    if space == "task" and not shape.cascade.any():
        # The file's kd may fit its kp badly; the same kp, all directions as well damped, may be stiffer.
        even = replace(shape, kd=np.where(shape.kp > 0, 2 * np.sqrt(shape.kp), shape.kd))
        evenly = [_task_case(state, even) for state in states]
        other = _set(EVERYWHERE, evenly, even, required, progress)
        if other is not None and other.moves and (safe is None or other.scale > safe.scale):
            safe, shape, closed = other, even, evenly
    per_contact = {}
    for contact in spec.robot.contacts:
        chosen = [state for state in closed if state.contact == contact]
        alone = len(chosen) == len(closed)
        per_contact[contact] = safe and replace(safe, contact=contact) if alone else _set(contact, chosen, shape, required, progress, safe)
    return RobotGains(space, tuple(names), per_contact, safe, inertia)


def _set(
    contact: str,
    chosen: Sequence[_Closed],
    shape: _Shape,
    required: Requirements,
    progress: Callable[[], None],
    safe: GainSet | None = None,
) -> GainSet | None:
    """The stiffest gains that keep what is required in all `chosen` states; None where no scale of the shape does.

    safe   gains known to keep it, of the same shape: the answer is as stiff at least
    """
    acting = [state for state in chosen if np.any(state.movable & ((shape.kp != 0) | (shape.kd != 0)))]
    cascade = bool(shape.cascade.any())
    if not acting:
        nothing = np.full(len(shape.kp), math.nan)
        return GainSet(contact, nothing, nothing, nothing if cascade else None, math.nan, math.nan, NOTHING_KEPT, "", 0)
    best, damping, first = None, 0.0, 0
    start = safe.scale if safe is not None and safe.moves else 1.0

    def tried(trial: float) -> bool:
        """Whether this damping allows more stiffness than any before."""
        nonlocal best, damping, start, first
        known = safe.scale if safe is not None and safe.damping == trial else 0.0
        found = largest_scale([_damped(state.loop, trial) for state in acting], required, progress, max(start, known), first, known)
        better = found.scale > 0 and (best is None or found.scale > best.scale)
        if better:
            best, damping = found, trial
        start, first = found.scale or start, found.binding
        return better

    centre, lowered = safe.damping if safe is not None and safe.moves else 1.0, 0
    while not tried(centre) and lowered < MOST_DAMPINGS:  # too much damping may be unstable at any stiffness
        centre, lowered = centre / DAMPING_STEP, lowered + 1
    for step in (1 / DAMPING_STEP,) if lowered else (DAMPING_STEP, 1 / DAMPING_STEP):
        went = 0
        while best is not None and went < MOST_DAMPINGS and tried(centre * step ** (went + 1)):
            went += 1
        if went:
            break
    if best is None:
        return None
    still = ~np.any([state.movable for state in acting], axis=0)
    kp, kd, ki = (np.where(still, math.nan, gain) for gain in shape.at(best.scale, damping))
    binding = acting[best.binding].title
    return GainSet(contact, kp, kd, ki if cascade else None, best.scale, damping, _worst(best.kept), binding, len(acting))


def joints_that_move(model: Plant, feedback: str) -> Booleans:
    """(n,) False where contacts hold a joint, so that no gain on it is felt: rigid, or measured on the link's side."""
    own = np.diagonal(model.link_inverse_inertia)
    free = own > ROUND_OFF * np.abs(model.link_inverse_inertia).max()
    return free if feedback == "link" else free | model.elastic


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
    """(n,) 1/W_ii, bounded where the contacts hold a joint: by its motor's inertia or, without one, by the heaviest load that can move."""
    own = np.diagonal(model.link_inverse_inertia)
    free = own[own > ROUND_OFF * own.max()]
    heaviest = HEAVIEST * np.where(model.motor_inertia > 0, model.motor_inertia, 1 / free.min() if len(free) else 1.0)
    return np.minimum(1 / np.maximum(own, 1 / heaviest), heaviest)


def _joint_shape(spec: RobotSpec, models: Sequence["RobotModel"]) -> _Shape:
    """(n,) kp and kd of each joint alone: the recommended ones with its lightest load and its longest delay."""
    size = models[0].size
    lightest = np.min([_link_inertia(model) for model in models], axis=0)
    latest = [drive.delay for drive in spec.drives] if spec.uncertainty.delay is None else spec.uncertainty.delay[1].tolist()
    heaviest = float(lightest.max())
    known: dict[tuple, tuple[float, float]] = {}
    kp, kd = np.zeros(size), np.zeros(size)
    for k in range(size):
        parts: dict[str, Any] = {name: float(getattr(models[0], name)[k]) for name in _JOINT}
        share = float(f"{lightest[k] / heaviest:.3g}")  # legs that differ by round-off are one joint
        joint = ElasticJoint(link_inertia=share * heaviest, **parts)
        drive = replace(spec.drives[k], delay=latest[k])
        key = (*parts.values(), joint.link_inertia, drive)
        if key not in known:
            known[key] = _alone(spec, joint, drive)
        kp[k], kd[k] = known[key]
    return _Shape(kp, kd, np.zeros(size), np.zeros(size, dtype=bool))


def _alone(spec: RobotSpec, joint: ElasticJoint, drive) -> tuple[float, float]:
    """Recommended kp and kd of one joint; a critically damped guess where nothing limits it."""
    template = PD(1.0, 1.0, velocity_filter=spec.control.velocity_filter, notches=spec.control.notches)
    place = {"feedback": spec.control.feedback, "sample_time": spec.control.sample_time, "controller": template}
    found = recommend_pd(joint, drive, spec.requirements, **place)
    if found is not None:
        return found.kp, found.kd
    inertia, crossover = joint.motor_inertia + joint.link_inertia, 0.2 / max(drive.delay + 2 / drive.bandwidth, 1e-3)
    return inertia * crossover**2, 2 * inertia * crossover


def _damped(family: Family, damping: float) -> Case:
    return lambda stiffness: family(stiffness, damping)


def _joint_case(state: _State, shape: _Shape) -> _Closed:
    spec = state.spec

    def at(stiffness: float, damping: float) -> Loop:
        kp, kd, _ = shape.at(stiffness, damping)
        return spec.loop(state.model, spec.shaped(PD(kp, kd)))

    return _Closed(state.title, state.contact, at, joints_that_move(state.model, spec.control.feedback))


def _task_case(state: _State, shape: _Shape) -> _Closed:
    spec = state.spec
    tasks = spec.robot.tasks(state.model, spec.control.rotors)

    def at(stiffness: float, damping: float) -> Loop:
        kp, kd, ki = shape.at(stiffness, damping)
        return spec.loop(state.model, spec.shaped(replace(tasks, kp=kp, kd=kd, ki=ki).controller()))

    return _Closed(state.title, state.contact, at, tasks.movable)


def _worst(kept: Sequence[Kept]) -> Kept:
    """The least of every margin over all cases."""
    return Kept(
        stable=all(one.stable for one in kept),
        gain_margin=min(one.gain_margin for one in kept),
        phase_margin=min(one.phase_margin for one in kept),
        peak_sensitivity=max(one.peak_sensitivity for one in kept),
    )
