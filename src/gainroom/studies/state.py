"""Robot or joint in one posture and contact state: its loop and its numbers, each computed on first use."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis.boundary import direction_limits
from ..analysis.dynamic_stiffness import damping_by_kind
from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import joint_margins
from ..analysis.multirate import delay_of_others, path_margins
from ..analysis.stability import is_stable
from ..design.gain_cases import bounded_margins, own_case
from ..design.starting_gains import IMMOBILE, joints_that_move
from ..errors import GainroomError, computable
from ..system.controller import Controller, own_gain
from ..system.linear.arrays import Complexes, Floats, Integers, rank
from ..system.loop import Loop, build_loop
from ..system.plant import Compliance, Plant
from ..system.system import StateCase, System
from .loop_numbers import extra_delay, limit_of, margins_of
from .over_uncertainty import ExtraDelays, Worst, uncertain_cases
from .sway import Sway, sway_of, without_sway
from .worst_place import try_places

if TYPE_CHECKING:
    from ..robot.tasks import Tasks
    from ..simulation.simulated_gains import SimulatorLimit

STRONG = 0.5
"""Least motion of a joint that takes part in a vibration, relative to the joint that moves most."""
USUAL_RATE = 2000.0
"""Usual loop rate [Hz] of robots with EtherCAT drives, at which gains for continuous time are checked if no rate is given."""
RAISED = 2.0 ** np.arange(1, 11)
"""Factors on all gains at which gains that hold a toppling robot are searched."""
HELD = "no joint that has gains can move"
IDLE = "the tasks act on no motion"


@dataclass(frozen=True)
class JointRow:
    """One joint in one state.

    link_inertia        1/W_ii: the load with every neighbour free [kg m²]; inf where the contacts lock the joint
    participation       participation factor in the vibration at the limit, relative to the largest
    single_joint_limit  factor on its gains if it were the only joint, with that load
    limit_others_closed factor on its gains, other loops closed; NaN for an unstable robot
    kp, kd              the controller's gains on this joint alone: N m/rad, N m s/rad
    kp_max, kd_max      largest, other loops closed; NaN if unstable, or the controller has none
    """

    name: str
    link_inertia: float
    participation: float
    single_joint_limit: float
    limit_others_closed: float
    kp: float
    kd: float
    kp_max: float
    kd_max: float


@dataclass(frozen=True)
class TaskRow:
    """One direction of a task.

    moves        False if no joint can move it in this state: its gains have no effect, and both limits are NaN
    kp, kd       its own gains [1/s²], [1/s]; P/PI: [1/s], [1/s], with ki [1/s²]; ki None: PD
    gain_limit   factor on them, other directions open; NaN if its gains are 0, and if it is not known
    limit_others_closed   factor on them, other directions closed; NaN if the stack is unstable, or it is not confirmed
    """

    name: str
    direction: str
    moves: bool
    kp: float
    kd: float
    ki: float | None
    gain_limit: float
    limit_others_closed: float


@dataclass(frozen=True)
class TaskStudy:
    """Operational space in one state: the limit of all tasks together (NaN if they act on no motion), and each direction."""

    tasks: "Tasks"
    limit: GainLimit
    rows: tuple[TaskRow, ...]

    @property
    def moves(self) -> bool:
        """True if any direction can be moved in this state."""
        return any(row.moves for row in self.rows)


@dataclass(frozen=True, eq=False)
class State:
    """One posture in one contact state. If its gains act on no motion, all numbers of its loop are NaN.

    largest_gains   True: the margins of several joints include their largest gains, which takes a third more time
    """

    system: System
    posture: str
    contact: str
    model: Any
    largest_gains: bool = True

    @property
    def title(self) -> str:
        """Posture and contact state, for tables and messages."""
        return f"{self.posture}/{self.contact}"

    @cached_property
    def controller(self) -> Controller:
        """Controller of the file in joint space, of its tasks in task space."""
        return self.system.controller(self.model)

    @cached_property
    def loop(self) -> Loop:
        """Loop of all joints together."""
        return self.system.loop(self.model, self.controller)

    @cached_property
    def stable(self) -> bool:
        """True if stable, by a count of roots. Raises as is_stable."""
        return is_stable(self.loop)

    @cached_property
    def at_usual_rate(self) -> "State":
        """State sampled at USUAL_RATE. Its numbers may raise GainroomError: some controllers are made for continuous time alone."""
        sampled = replace(self.system, control=replace(self.system.control, sample_time=1 / USUAL_RATE))
        return State(sampled, self.posture, self.contact, self.model, largest_gains=False)

    @property
    def case(self) -> StateCase:
        """Nominal case of the state, as sampled margins take it."""
        return StateCase(self.posture, self.contact, "", self.system, self.model)

    @cached_property
    def moves(self) -> bool:
        """True if the gains act on some motion: False if contacts lock all their joints."""
        return self.loop.acts

    @property
    def reason(self) -> str:
        """Reason why the gains act on no motion, for messages; "" if they do."""
        return "" if self.moves else IDLE if self.system.control.space == "task" else HELD

    @cached_property
    def margins(self) -> Margins:
        """Margins of all loops together, and of each with the other loops closed."""
        return margins_of(self.loop, self.largest_gains) if self.moves else Margins.unknown(GainLimit.unknown(self.model.size))

    @cached_property
    def sway(self) -> Sway | None:
        """Sway of the base on its contacts, on the stiffness of the joints' position gains; None if there is none."""
        return sway_of(self.case, self.loop) if self.moves else None

    @cached_property
    def counted(self) -> Margins:
        """Margins compared with requirements: without sway if a controller damps it."""
        return without_sway(self.case, self.margins, self.loop)

    @cached_property
    def balanced(self) -> "State":
        """State in which a controller above the joints damps sway, so that sway does not count in the margins."""
        found = replace(self, system=replace(self.system, balance="controller"))
        vars(found).update({name: vars(self)[name] for name in ("controller", "loop", "moves", "margins", "sway") if name in vars(self)})
        return found

    @cached_property
    def topples_with_weight(self) -> bool:
        """True if the weight makes the joints' gains unstable, where the file does not say whether it counts."""
        source = self.system.source
        if source.body is None or source.gravity is not None or self.system.control.space == "task":
            return False
        model = source.linearize(self.model.posture, self.model.contact, weight=True)
        weighed = replace(self, model=model)
        return model.gravity_stiffness is not None and weighed.moves and not weighed.stable and self.limit.stable

    @cached_property
    def _extra_delays(self) -> ExtraDelays | None:
        """Extra delays at the corners of the uncertainty; None if the delay is known."""
        return ExtraDelays.of(self.system, self.posture, self.contact) if self.system.uncertainty.delay is not None else None

    @cached_property
    def uncertain_cases(self) -> tuple[StateCase, ...]:
        """Examined cases of the uncertainty; for several joints the last is the worst place found by a search."""
        place = self.posture, self.contact
        cases = tuple(uncertain_cases(self.system, *place, self._extra_delays))
        if self.model.size == 1 or self.system.control.kd_path is not None:
            return cases
        worst = try_places(self.system, [self]).worst.place
        return (*cases, replace(self.system.case_at(worst, *place), between=True))

    @cached_property
    def worst_case(self) -> Worst:
        """Worst margins over the nominal values and every examined case of the uncertainty."""
        nominal = [("", self.counted)]
        if not (self.system.uncertainty.names and self.moves and self.margins.stable):
            return Worst.of(nominal, self.system.requirements)
        place, extra = (self.posture, self.contact), self._extra_delays
        found = Worst.of(
            nominal + [(case.place, without_sway(case, bounded_margins(case))) for case in self.uncertain_cases], self.system.requirements
        )
        if found.unstable_at or not math.isnan(found.margins.delay_margin) or self.system.control.kd_path is not None:
            return found
        extra = ExtraDelays.of(self.system, *place) if extra is None else extra
        value, corner = extra.least(self.system)
        return found.with_delay_margin(value, self.system.case_at(corner, *place).place)

    @property
    def limit(self) -> GainLimit:
        """Limit of the common factor on all gains; its numbers are NaN if stability alone is known."""
        return self.margins.limit

    @cached_property
    def toppled_below(self) -> float | None:
        """Factor above 1 on all gains below which gravity topples the robot; NaN if no factor in RAISED stabilises it.

        None if it is stable, or some lower gains are, or it is not gravity that makes it unstable.
        """
        if self.limit.gain != 0 or not self.loop.unstable_poles or self.model.gravity_stiffness is None:
            return None
        higher = ((factor, limit_of(self.loop.scaled(factor))) for factor in RAISED.tolist())
        return next((factor * limit.lower_gain for factor, limit in higher if limit.stable), math.nan)

    @property
    def lower_gain(self) -> float:
        """Factor on all gains below which the robot does not settle; 0: none; above 1 if the gains are too low, see toppled_below."""
        return self.limit.lower_gain if self.toppled_below is None else self.toppled_below

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """Names of the joints in the vibration at the limit, the largest participation factor first."""
        return limiting_joints(self.limit, self.model.joint_names)

    @property
    def task_limit(self) -> GainLimit | None:
        """Limit of the common factor on all gains of the tasks; None if there are none, or they act on no motion."""
        return self.tasks.limit if self.tasks is not None and self.tasks.moves else None

    @cached_property
    def single_joint_limits(self) -> Floats:
        """Factor (n,) on each joint's gains if it were the only one, its load 1/W_ii.

        Inf if it cannot move; NaN without gains, or if it is not known. If kd has a separate path: on all gains, on kd alone or on the
        others alone, whichever is nearest, up or down.
        """
        control, drives = self.system.control, self.system.drives

        def loop(k: int, own: Controller) -> Loop:
            return build_loop(single_joint(self.model, k), drives[k], own, control.feedback, control.sample_time, control.kd_path)

        return self._limits_by_joint(loop)

    @cached_property
    def limits_others_open(self) -> Floats:
        """Factor (n,) on each joint's gains with the other loops open: their gains and weight are 0, their motors and gearboxes stay."""
        model, size, weight = self.model, self.model.size, self.model.gravity_stiffness

        def loop(k: int, own: Controller) -> Loop:
            if size > 1:
                own = replace(own, **{name: np.eye(size)[k] * getattr(own, name) for name in own.scaled_names()})
            if type(own) is type(self.controller) and weight is None:
                return self.loop.regained(own)
            held = None if weight is None else np.diag(np.eye(size)[k] * np.diagonal(weight))
            return self.system.loop(replace(model, gravity_stiffness=held), own)

        return self._limits_by_joint(loop)

    def _limits_by_joint(self, loop_of: Callable[[int, Controller], Loop]) -> Floats:
        """Limits (n,) of the loops that `loop_of` makes of each joint and its controller, see single_joint_limits."""
        limits, movable = np.full(self.model.size, math.nan), joints_that_move(self.model, self.system.control.feedback)
        for k in range(self.model.size):
            own = self.controller.on_joint(k, self.model.size)
            if not any(np.any(gain) for gain in own.terms().values()):
                continue
            if not movable[k]:
                limits[k] = math.inf
                continue
            try:
                limit = limit_of(loop := loop_of(k, own))
            except GainroomError:  # not known
                continue
            limits[k] = limit.gain if loop.kd_path is None or not limit.stable else min(limit.gain, path_margins(loop).headroom)
        return limits

    @cached_property
    def delay_limit(self) -> float:
        """Total delay [s] at which the robot vibrates; NaN if it is not known, 0 if it vibrates without delay.

        If kd has a separate path: of the other gains' path, kd's unchanged.
        """
        if self.loop.kd_path is not None:
            return self._delay_limit_of_others
        if self.margins.stable:
            return self.system.delay + self.margins.delay_margin
        without = extra_delay(self.system.with_values(delay=0.0).loop(self.model, self.controller))
        return 0.0 if math.isnan(without) else without

    @property
    def _delay_limit_of_others(self) -> float:
        loop = self.loop if self.margins.stable else self.system.with_values(delay=0.0).loop(self.model, self.controller)
        return delay_of_others(loop) if self.margins.stable or is_stable(loop) else 0.0

    @cached_property
    def damping(self) -> dict[str, tuple[float, float]]:
        """Least damping ratio of each kind of vibration and its frequency [rad/s] (dynamic_stiffness.py); empty for an unstable loop."""
        if not (self.moves and self.limit.stable):
            return {}
        sway = np.zeros(0) if self.sway is None else np.array([one.frequency for one in self.sway.modes])
        gears, own = np.zeros(0), own_case(self.title, self.system, self.model)
        if own is not None:
            found = own[0].compliance.peaks(own[1])
            gears = np.unique(found.omega[found.gear_limited])
        return damping_by_kind(self.loop, sway, gears)

    @cached_property
    def joints(self) -> tuple[JointRow, ...]:
        """Results per joint."""
        size, margins, model = self.model.size, self.margins, self.model
        terms = self.controller.terms()
        kp, kd = ([own_gain(terms.get(powers, 0.0), k, size) for k in range(size)] for powers in ((0, 0), (1, 0)))
        nothing = np.full(size, math.nan)
        complete = (self.largest_gains if size > 1 else self.loop.kd_path is not None) or not margins.stable
        one_loop = margins.one_loop if complete else joint_margins(self.loop).one_loop
        with np.errstate(divide="ignore"):
            load = 1 / np.diagonal(_at_least_zero(model.link_inverse_inertia, model.link_inverse_inertia))
        columns = {
            "link_inertia": load,
            "participation": np.abs(margins.limit.mode) if math.isfinite(margins.limit.frequency) else nothing,
            "single_joint_limit": self.single_joint_limits,
            "limit_others_closed": one_loop.gain_margin,
            "kp": kp,
            "kd": kd,
            "kp_max": nothing if one_loop.largest_kp is None else one_loop.largest_kp,
            "kd_max": nothing if one_loop.largest_kd is None else one_loop.largest_kd,
        }
        return tuple(JointRow(name, **{key: float(one[k]) for key, one in columns.items()}) for k, name in enumerate(model.joint_names))

    @cached_property
    def tasks(self) -> TaskStudy | None:
        """Results of all tasks together, and of each direction by itself; None without tasks."""
        system, model = self.system, self.model
        if not system.source.stack:
            return None
        tasks = system.source.tasks(model, system.control.rotors)
        count, movable = len(tasks.directions), tasks.movable
        acting = np.flatnonzero(movable & ((tasks.kp != 0) | (tasks.kd != 0) | (tasks.ki != 0))).tolist()
        loop = system.loop(model, system.filtered(tasks.controller()))
        limit = limit_of(loop) if acting else GainLimit.unknown(model.size)
        shares = [replace(tasks, torque=tasks.torque * np.eye(count)[k]) for k in acting]
        parts = [loop.regained(system.filtered(share.controller())) for share in shares]
        alone, closed = np.full(count, math.nan), np.full(count, math.nan)
        alone[acting] = [limit_of(part).gain for part in parts]
        if limit.stable and acting and loop.kd_path is None:
            gains = np.array([tasks.kp, tasks.kd, tasks.ki])[:, acting]
            closed[acting] = direction_limits(loop, tasks.torque[:, acting], tasks.jacobian[acting], gains, tasks.cascade[acting])
        owners = [tasks.tasks[owner].name for owner in tasks.owners]
        rows = tuple(
            TaskRow(
                name=owner,
                direction=tasks.directions[k].removeprefix(f"{owner} "),
                moves=bool(movable[k]),
                kp=float(tasks.kp[k]),
                kd=float(tasks.kd[k]),
                ki=float(tasks.ki[k]) if tasks.cascade[k] else None,
                gain_limit=float(alone[k]),
                limit_others_closed=float(closed[k]),
            )
            for k, owner in enumerate(owners)
        )
        return TaskStudy(tasks, limit, rows)


def state_of(system: System, posture: str, contact: str, numbers: tuple[str, ...] = ()) -> State:
    """State of one posture in one contact state; see analyze in analysis.py."""
    state = State(system, posture, contact, system.source.linearize(posture, contact), not numbers or "joints" in numbers)
    where = f": posture {posture!r}, contact {contact!r}" if posture else ""
    with computable(system.source.name + where):
        for name in ("moves", *numbers):
            getattr(state, name)
    return state


def single_joint(model: Plant, k: int) -> Plant:
    """Plant of joint `k` by itself, its neighbours free: W_kk, and its part of contact and gravity stiffness."""
    one = slice(k, k + 1)
    soft = model.compliance
    return Plant(
        link_inverse_inertia=_at_least_zero(model.link_inverse_inertia[one, one], model.link_inverse_inertia),
        **{name: getattr(model, name)[one] for name in ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")},
        gravity_stiffness=None if model.gravity_stiffness is None else model.gravity_stiffness[one, one],
        compliance=None if soft is None else Compliance(soft.coupling[one], soft.inverse_inertia, soft.stiffness, soft.damping),
        joint_names=model.joint_names[one],
    )


def _at_least_zero(entry: Floats, whole: Floats) -> Floats:
    """Diagonal entry W_kk, set to 0 if it is round-off that the contacts leave."""
    return np.where(entry > IMMOBILE * np.abs(whole).max(), entry, 0.0)


def limit_headroom(limit: GainLimit) -> tuple[bool, float]:
    """Sort key of limits: unstable ones first, then by headroom, mirrored states in their order. NaN counts as far away."""
    return limit.stable, math.inf if math.isnan(limit.gain) else rank(limit.gain)


def path_headroom(margins: Margins) -> tuple[bool, float]:
    """Sort key as limit_headroom for a loop with two gain paths: by the least factor on all gains, or on those of one path."""
    stable, gain = limit_headroom(margins.limit)
    return stable, gain if margins.paths is None else min(gain, margins.paths.headroom)


def task_headroom(state: State) -> tuple[bool, float]:
    """Sort key as limit_headroom by the limit of the tasks; states without tasks come last."""
    return (True, math.inf) if state.task_limit is None else limit_headroom(state.task_limit)


def strongest_first(mode: Complexes) -> Integers:
    """Indices of the joints by falling participation factor; those equal within round-off (left and right) in the model's order."""
    parts = np.abs(mode)
    return np.argsort(-np.round(parts / parts.max(), 6), kind="stable")


def limiting_joints(limit: "GainLimit | SimulatorLimit | Sway", names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the joints in the vibration at a limit, or in sway, the largest participation factor first; () without one."""
    if not math.isfinite(limit.frequency):
        return ()
    parts = np.abs(limit.mode)
    return tuple(names[k] for k in strongest_first(limit.mode) if parts[k] >= STRONG * parts.max())
