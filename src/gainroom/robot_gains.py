"""Gains to use on a robot: one set per contact state and one that is safe in all, with every loop closed, over the stated uncertainty.

Shapes of the joint gains: each joint alone, with the lightest load that any state gives it and the longest delay; all in proportion to the
motors' inertias; the file's own. Of the task gains: the file's kp with its kd, or with a kd that damps all directions alike. For several
dampings each shape is scaled as a whole (coupled_gains.py) until a requirement stands in the way; the stiffest is told, by the geometric
mean of kp. Not the stiffest of all shapes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Booleans, Floats
from .controller import PD
from .coupled_gains import ACCURACY, Case, Scaled, largest_scale
from .kept import Kept, kept_by
from .loop import Loop
from .plant import ElasticJoint, Plant
from .recommend import Requirements, recommend_pd
from .robot_cases import StateCase, state_cases
from .robot_spec import RobotSpec

if TYPE_CHECKING:
    from .robot.model import RobotModel
    from .robot.tasks import Tasks

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
class _Closed:
    """One state with its loops: `loop` by factors on stiffness and damping; `movable` (m,) which joints or directions can move.

    weighed   gravity counts, which asks for gains
    """

    title: str
    contact: str
    loop: Family
    movable: Booleans
    weighed: bool


@dataclass(frozen=True)
class _Shaped:
    """A shape of gains, and every state under it."""

    shape: _Shape
    states: Sequence[_Closed]

    def of(self, chosen: Callable[[_Closed], bool]) -> "_Shaped":
        """With these states alone."""
        return _Shaped(self.shape, [state for state in self.states if chosen(state)])

    def stiffness(self, found: GainSet) -> float:
        """Of gains of this shape, for comparing them with those of another: the geometric mean of kp over what has any."""
        given = self.shape.kp[self.shape.kp > 0]
        return found.scale * math.exp(float(np.mean(np.log(given)))) if len(given) else 0.0


def recommend_robot(spec: RobotSpec, space: str = "joint", progress: Callable[[], None] = lambda: None) -> RobotGains:
    """Gains for the joints, or for the file's tasks (space "task").

    Raises GainroomError where nothing is required, and in task space without tasks.
    """
    states = list(state_cases(spec))
    if space == "joint":
        first = states[0].model
        names, inertia = spec.robot.joint_names, first.motor_inertia + _link_inertia(first)
        tried = [_Shaped(shape, [_joint_case(state, shape) for state in states]) for shape in _joint_shapes(spec, states)]
    else:
        tasks = spec.robot.tasks(states[0].model, spec.control.rotors)
        names, inertia = tasks.directions, None
        tried = [_Shaped(shape, [_task_case(state, shape) for state in states]) for shape in _task_shapes(tasks)]
    required = spec.requirements
    safe, chosen = _set(EVERYWHERE, tried[0], required, progress), tried[0]
    for shaped in tried[1:]:
        near = None
        if safe is not None:  # what stands in the way of one shape is looked at first for the next: no more is possible than that allows
            near = _set(EVERYWHERE, shaped.of(lambda state, name=safe.binding: state.title == name), required, progress)
            if near is None or not shaped.stiffness(near) > chosen.stiffness(safe):
                continue
        found = _set(EVERYWHERE, shaped, required, progress, near)
        if found is not None and (safe is None or shaped.stiffness(found) > chosen.stiffness(safe)):
            safe, chosen = found, shaped
    per_contact = {}
    for contact in spec.robot.contacts:
        own = chosen.of(lambda state, contact=contact: state.contact == contact)
        alone = len(own.states) == len(chosen.states)
        whole = safe and replace(safe, contact=contact)
        per_contact[contact] = whole if alone else _set(contact, own, required, progress, safe, known=True)
    return RobotGains(space, tuple(names), per_contact, safe, inertia)


def _set(
    contact: str,
    shaped: _Shaped,
    required: Requirements,
    progress: Callable[[], None],
    near: GainSet | None = None,
    known: bool = False,
) -> GainSet | None:
    """The stiffest gains of a shape that keep what is required in all its states; None where no scale of it does.

    near    where to begin: gains of the same shape; `known`: they keep it, so that the answer is as stiff at least
    """
    shape = shaped.shape
    acting = [state for state in shaped.states if np.any(state.movable & ((shape.kp != 0) | (shape.kd != 0)))]
    cascade = bool(shape.cascade.any())
    if not acting:
        nothing = np.full(len(shape.kp), math.nan)
        return GainSet(contact, nothing, nothing, nothing if cascade else None, math.nan, math.nan, NOTHING_KEPT, "", 0)
    search = _Search(acting, required, progress, near if near is not None and near.moves else None, known)
    search.run()
    best = search.best
    if best is None:
        return None
    still = ~np.any([state.movable for state in acting], axis=0)
    kp, kd, ki = (np.where(still, math.nan, gain) for gain in shape.at(best.scale, search.damping))
    binding = acting[best.binding].title
    return GainSet(contact, kp, kd, ki if cascade else None, best.scale, search.damping, _worst(best.kept), binding, len(acting))


class _Search:
    """Over the dampings of one shape: `best` so far, at `damping`; None while nothing keeps what is required."""

    def __init__(self, states: Sequence[_Closed], required: Requirements, progress: Callable[[], None], near: GainSet | None, known: bool):
        self._states, self._required, self._progress = states, required, progress
        self._known = near if known else None
        self.best: Scaled | None = None
        self.damping, self._start = (1.0, 1.0) if near is None else (near.damping, near.scale)
        self._first = 0

    def run(self) -> None:
        """From the damping of the shape, or of what is known to be safe: up or down in steps as long as that helps, then by half a step."""
        lowered = 0
        while not self._tried(self.damping) and lowered < MOST_DAMPINGS:  # too much damping may be unstable at any stiffness
            self.damping, lowered = self.damping / DAMPING_STEP, lowered + 1
        if self.best is None:
            return
        for step in (1 / DAMPING_STEP,) if lowered else (DAMPING_STEP, 1 / DAMPING_STEP):
            if self._went(step):
                break
        for step in (math.sqrt(DAMPING_STEP), 1 / math.sqrt(DAMPING_STEP)):
            if self._tried(self.damping * step):
                break

    def _went(self, step: float) -> bool:
        """Whether one step or more of the damping helped."""
        went = 0
        while went < MOST_DAMPINGS and self._tried(self.damping * step):
            went += 1
        return went > 0

    def _tried(self, damping: float) -> bool:
        """Whether this damping allows more stiffness than any before."""
        known = self._known.scale if self._known is not None and self._known.damping == damping else 0.0
        cases = [_damped(state.loop, damping) for state in self._states]
        weighed = any(state.weighed for state in self._states)
        if self.best is not None and not weighed:  # then what does not hold at a little more stiffness does not hold at much more
            self._start = self.best.scale * (1 + ACCURACY)
            self._progress()
            if not kept_by(cases[self._first](self._start)).meets(self._required):
                return False
        found = largest_scale(cases, self._required, self._progress, max(self._start, known), self._first, known, weighed)
        better = found.scale > 0 and (self.best is None or found.scale > self.best.scale)
        if better:
            self.best, self.damping = found, damping
        self._start, self._first = found.scale or self._start, found.binding
        return better


def joints_that_move(model: Plant, feedback: str) -> Booleans:
    """(n,) False where contacts hold a joint, so that no gain on it is felt: rigid, or measured on the link's side."""
    own = np.diagonal(model.link_inverse_inertia)
    free = own > ROUND_OFF * np.abs(model.link_inverse_inertia).max()
    return free if feedback == "link" else free | model.elastic


def _link_inertia(model: "RobotModel") -> Floats:
    """(n,) 1/W_ii, bounded where the contacts hold a joint: by its motor's inertia or, without one, by the heaviest load that can move."""
    own = np.diagonal(model.link_inverse_inertia)
    free = own[own > ROUND_OFF * own.max()]
    heaviest = HEAVIEST * np.where(model.motor_inertia > 0, model.motor_inertia, 1 / free.min() if len(free) else 1.0)
    return np.minimum(1 / np.maximum(own, 1 / heaviest), heaviest)


def _joint_shapes(spec: RobotSpec, states: Sequence[StateCase]) -> list[_Shape]:
    """(n,) kp and kd: of each joint alone; in proportion to the motors' inertias; the file's own, where it has some."""
    alone = _shape_of_joints_alone(spec, [state.model for state in states])
    shapes = [alone]
    motors = states[0].model.motor_inertia
    if np.all(motors > 0):
        kp, kd = (float(np.median(gain / motors)) * motors for gain in (alone.kp, alone.kd))
        shapes.append(replace(alone, kp=kp, kd=kd))
    own = spec.control.joints
    if type(own) is PD and all(np.ndim(gain) < 2 for gain in (own.kp, own.kd)) and np.all(own.kp):  # else some joints would hold nothing
        kp, kd = (np.broadcast_to(gain, motors.shape).astype(float) for gain in (own.kp, own.kd))
        shapes.append(replace(alone, kp=kp, kd=kd))
    return shapes


def _task_shapes(tasks: "Tasks") -> list[_Shape]:
    """The file's; and its kp with all directions as well damped, as its kd may fit its kp badly."""
    own = _Shape(tasks.kp, tasks.kd, tasks.ki, tasks.cascade)
    return [own] if own.cascade.any() else [own, replace(own, kd=np.where(own.kp > 0, 2 * np.sqrt(own.kp), own.kd))]


def _shape_of_joints_alone(spec: RobotSpec, models: Sequence["RobotModel"]) -> _Shape:
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


def _joint_case(state: StateCase, shape: _Shape) -> _Closed:
    spec = state.spec

    def at(stiffness: float, damping: float) -> Loop:
        kp, kd, _ = shape.at(stiffness, damping)
        return spec.loop(state.model, spec.shaped(PD(kp, kd)))

    return _Closed(state.title, state.contact, at, joints_that_move(state.model, spec.control.feedback), spec.robot.gravity)


def _task_case(state: StateCase, shape: _Shape) -> _Closed:
    spec = state.spec
    tasks = spec.robot.tasks(state.model, spec.control.rotors)

    def at(stiffness: float, damping: float) -> Loop:
        kp, kd, ki = shape.at(stiffness, damping)
        return spec.loop(state.model, spec.shaped(replace(tasks, kp=kp, kd=kd, ki=ki).controller()))

    return _Closed(state.title, state.contact, at, tasks.movable, spec.robot.gravity)


def _worst(kept: Sequence[Kept]) -> Kept:
    """The least of every margin over all cases."""
    return Kept(
        stable=all(one.stable for one in kept),
        gain_margin=min(one.gain_margin for one in kept),
        phase_margin=min(one.phase_margin for one in kept),
        peak_sensitivity=max(one.peak_sensitivity for one in kept),
    )
