"""Margins of a robot's gains in one state by samples in the core: quick, and those alone that requirements bound."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import margins
from ..errors import GainroomError
from ..system.controller import PD
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirements import SWAY_DAMPING
from ..system.system import StateCase, System
from .margin_slopes import GainCase, Gains
from .starting_gains import joints_that_move, link_inertia
from .swaying import FLOOR, Swaying


def joint_case(title: str, system: System, model: Any, contact: str = "") -> GainCase:
    """Case of PD gains of the joints, with the system's filters."""
    size = model.size
    first = system.loop(model, system.filtered(PD(np.ones(size), np.ones(size))))

    def loop(gains: Gains) -> Loop:
        return first.regained(system.filtered(PD(gains[0], gains[1])))

    sway, balanced, required = _sway(system, model, loop), system.balance == "controller", system.requirements
    if sway is not None and balanced and required.asked:
        required = required.also(SWAY_DAMPING, FLOOR)
    lag = np.array(system.torque_lags)
    return GainCase(title, loop, np.eye(size), np.eye(size), np.zeros(size, dtype=bool), required, contact, sway, balanced, lag)


def _sway(system: System, model: Any, loop: Callable[[Gains], Loop]) -> Swaying | None:
    """Sway of a floating base on its contacts; None of other models."""
    if system.source.body is None:
        return None
    from ..robot.sway import SlowMotion  # the whole robot, which a joint does without

    motion = SlowMotion.of(model)
    return None if motion is None else Swaying(motion, system, loop)


def task_case(title: str, system: System, model: Any, tasks: Any, contact: str = "") -> GainCase:
    """Case of gains of `tasks`, the operational space of the model with its weight or without."""
    first = system.loop(model, system.filtered(tasks.controller()))

    def loop(gains: Gains) -> Loop:
        kp, kd, ki = gains
        return first.regained(system.filtered(replace(tasks, kp=kp, kd=kd, ki=ki).controller()))

    return GainCase(title, loop, tasks.torque, tasks.jacobian, tasks.cascade, system.requirements, contact)


def case_of(state: StateCase, space: str) -> GainCase:
    """Case of gains of the joints (`space` "joint") or of the file's tasks in one state."""
    if space == "joint":
        return joint_case(state.title, state.system, state.model)
    return task_case(state.title, state.system, state.model, state.system.source.tasks(state.model, state.system.control.rotors))


def own_case(title: str, system: System, model: Any) -> tuple[GainCase, Gains] | None:
    """Case and gains (3, n) of a robot's own PD controller of its joints; None for other controllers, which the core does not sample."""
    control, own, size = system.control, system.control.controller, model.size
    if control.kd_path is not None or type(own) is not PD or size == 1 or np.ndim(own.kp) > 1 or np.ndim(own.kd) > 1:
        return None
    filters = replace(control, **own.filters)
    gains = np.array([np.broadcast_to(gain, size) for gain in (own.kp, own.kd, 0.0)], dtype=float)
    return joint_case(title, replace(system, control=filters), model), gains


def bounded_margins(state: StateCase, factor: float = 1.0, near: bool = False) -> Margins:
    """Margins that requirements bound, in one case, with all of the robot's own gains times `factor`; other margins are NaN.

    near   True: only those that are near a requirement, which is quicker

    PD gains of joints and gains of tasks are sampled in the core, in milliseconds; for other controllers `margins` is called.
    """
    system, control = state.system, state.system.control
    if control.space == "task":
        tasks = system.source.tasks(state.model, control.rotors)
        tasks = replace(tasks, torque=factor * tasks.torque)
        return case_margins(task_case(state.title, system, state.model, tasks), np.array([tasks.kp, tasks.kd, tasks.ki]), near)
    if (joints := own_case(state.title, system, state.model)) is not None:
        case, gains = joints
        return case_margins(case, factor * gains, near)
    return _exact(system.loop(state.model).scaled(factor))


def case_margins(case: GainCase, gains: Gains, near: bool) -> Margins:
    """Margins of a case from samples, those `near` a requirement or all; from `margins` where the samples leave a required one open."""
    found = (case.margins if near else case.all_margins)(gains)
    if found.stable and any(np.isnan(one.value(found)) for one, _ in case.required.asked_for):
        return _exact(case.loop(gains))
    return found


def _exact(loop: Loop) -> Margins:
    try:
        return margins(loop)
    except GainroomError:
        return Margins.unknown(GainLimit.unknown(loop.size, stable=False))


@dataclass(frozen=True)
class SearchedState:
    """State of a robot in a search: its loops `with_weight`, and `without` it (the same where none counts).

    moves, load   (m,) True for directions that can move, and the quantity in which alike ones agree: a joint's inertia, a task
                  direction's place
    """

    state: StateCase
    with_weight: GainCase
    without: GainCase
    weighed: bool
    moves: Booleans
    load: Floats

    @property
    def contact(self) -> str:
        return self.state.contact


def joint_state(state: StateCase) -> SearchedState:
    """State of a search for gains of the joints."""

    def case(model: Any) -> GainCase:
        return joint_case(state.title, state.system, model, state.contact)

    return _both(state, case, joints_that_move(state.model, state.system.control.feedback), link_inertia(state.model))


def task_state(state: StateCase) -> SearchedState:
    """State of a search for gains of the file's tasks."""
    tasks = state.system.source.tasks(state.model, state.system.control.rotors)

    def case(model: Any) -> GainCase:
        return task_case(state.title, state.system, model, tasks, state.contact)

    return _both(state, case, tasks.movable, np.arange(1.0, len(tasks.kp) + 1))


def _both(state: StateCase, case: Callable[[Any], GainCase], moves: Booleans, load: Floats) -> SearchedState:
    """State of a search with `case` of the model with the robot's weight, if it counts, and of the model without it."""
    weighed = state.model.gravity_stiffness is not None and bool(np.any(state.model.gravity_stiffness))
    whole = case(state.model)
    return SearchedState(state, whole, case(replace(state.model, gravity_stiffness=None)) if weighed else whole, weighed, moves, load)
