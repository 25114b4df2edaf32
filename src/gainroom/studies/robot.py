"""A whole robot, studied: every posture in every contact state, all joints closed at once, joint by joint, and in task space."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..analysis.loci import Sweep
from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import joint_margins
from ..analysis.partial_limits import part_limits
from ..analysis.stability import has_growing_root, unstable_roots
from ..design.robot_gains import ROUND_OFF, RobotGains, joints_that_move, recommend_robot
from ..errors import GainroomError, computable
from ..linear.arrays import Floats
from ..robot.spec import RobotSpec
from ..robot.state_cases import state_cases
from ..system.controller import PD, PID, PPI, gain_matrix
from ..system.loop import Loop, build_loop
from ..system.plant import Compliance, Plant
from .robot_record import JointRow, RobotStudy, StateStudy, StillState, TaskRow, TaskStudy
from .robot_text import sentence, warnings

if TYPE_CHECKING:
    from ..robot.model import RobotModel

EXPECTED_LOOKS = 250
"""Looks that the search for gains takes per state and corner of the uncertainty, roughly: for the progress bar."""
ANYWHERE = np.array([0.7, 1.3, 2.1])
"""Frequencies [rad/s] at which a loop that moves anything does not vanish altogether."""
HELD = "no joint that has gains can move"
IDLE = "the tasks move nothing"
Progress = Callable[[int, int, str], None]
"""Called with (states done, states in all, the next one's name)."""


def study_robot(spec: RobotSpec, progress: Progress | None = None, recommend: bool = True) -> RobotStudy:
    """Everything about one robot; `recommend`: with gains to use, which takes longest.

    Raises GainroomError for a state that cannot be linearised, and where the gains move nothing in any state.
    """
    names = spec.robot.states
    tell = progress or (lambda done, total, what: None)
    found = []
    for index, (posture, contact) in enumerate(names):
        tell(index, len(names), f"state {posture}, {contact}")
        found.append(study_state(spec, posture, contact))
    tell(len(names), len(names), "")
    states = tuple(state for state in found if isinstance(state, StateStudy))
    still = tuple(state for state in found if isinstance(state, StillState))
    if not states:
        raise GainroomError(f"{spec.robot.name}: {still[0].reason} in any posture and contact state, so there is nothing to study")
    recommended = _recommended(spec, tell) if recommend and spec.requirements.asked else ()
    unstable_at = _unstable_at(spec) if spec.uncertainty.names and all(state.limit.stable for state in states) else ""
    study = RobotStudy(spec, states, "", (), recommended, still, unstable_at)
    return replace(study, sentence=sentence(study), warnings=warnings(study))


def _unstable_at(spec: RobotSpec) -> str:
    """The first posture and contact state, at a corner of the uncertainty, in which the gains as given are unstable, in words; "": none."""
    for case in state_cases(spec):
        loop = case.spec.loop(case.model)
        if case.place and moves(loop) and not limit_of(loop).stable:
            return case.title
    return ""


def _recommended(spec: RobotSpec, tell: Progress) -> tuple[RobotGains, ...]:
    """Gains to use in joint space and, where there are tasks, in task space."""
    expected = EXPECTED_LOOKS * len(spec.robot.states) * 2 ** len(spec.uncertainty.names)

    def of(space: str) -> RobotGains:
        looked = itertools.count()

        def count() -> None:
            tell(min(next(looked), expected), expected, f"gains, {space} space")

        count()
        with computable(f"{spec.robot.name}: gains to use, {space} space"):
            return recommend_robot(spec, space, count)

    return tuple(of(space) for space in (("joint", "task") if spec.robot.stack else ("joint",)))


def study_state(spec: RobotSpec, posture: str, contact: str) -> StateStudy | StillState:
    """One posture in one contact state. Raises GainroomError where its numbers are too far apart to compute with."""
    model = spec.robot.linearize(posture, contact)
    with computable(f"{spec.robot.name}: posture {posture!r}, contact {contact!r}"):
        return _studied(spec, model, posture, contact)


def _studied(spec: RobotSpec, model: "RobotModel", posture: str, contact: str) -> StateStudy | StillState:
    controller = spec.controller(model)
    loop = spec.loop(model, controller)
    tasks = _tasks(spec, model) if spec.robot.stack else None
    if not moves(loop):
        reason = IDLE if spec.control.space == "task" else HELD
        return StillState(posture, contact, reason, _joints(spec, model, controller, Margins.unknown(GainLimit.unknown(model.size))), tasks)
    margins = margins_of(loop)
    rows = _joints(spec, model, controller, margins)
    return StateStudy(posture=posture, contact=contact, model=model, loop=loop, margins=margins, joints=rows, tasks=tasks)


def moves(loop: Loop) -> bool:
    """Whether the gains move anything at all: not where contacts hold all that they act on."""
    return bool(np.any(loop.response(ANYWHERE)))


def margins_of(loop: Loop) -> Margins:
    """joint_margins; where the loci cannot be followed, the verdict alone, with NaN for all else."""
    try:
        return joint_margins(loop)
    except GainroomError as error:
        return Margins.unknown(_verdict(loop, error))


def limit_of(loop: Loop) -> GainLimit:
    """gain_limit, or the verdict alone."""
    try:
        return gain_limit(loop)
    except GainroomError as error:
        return _verdict(loop, error)


def _verdict(loop: Loop, error: GainroomError) -> GainLimit:
    """Whether the loop is stable where nothing else could be found: as gain_limit has it, roots that no gain moves are not counted.

    Raises `error` where the roots cannot be found, either.
    """
    try:
        stable = not has_growing_root(loop) and (unstable_roots(loop) == 0 or Sweep(loop).unstable(1.0) == 0)
    except (np.linalg.LinAlgError, ValueError):  # gains so absurd that the state matrix is not finite
        raise error from None
    return GainLimit.unknown(loop.size, stable)


def single_joint_limits(spec: RobotSpec, model: "RobotModel", controller: PD | PID | PPI) -> Floats:
    """(n,) factor on each joint's gains if it were the only one, its load 1/W_ii; NaN where it has no gains, inf where it cannot move."""
    limits = np.full(model.size, math.nan)
    movable = joints_that_move(model, spec.control.feedback)
    for k in range(model.size):
        own = joint_controller(controller, k, model.size)
        if not any(np.any(gain) for gain in own.terms().values()):
            continue
        if not movable[k]:
            limits[k] = math.inf
            continue
        alone = single_joint(model, k)
        limits[k] = limit_of(build_loop(alone, spec.drives[k], own, spec.control.feedback, spec.control.sample_time)).gain
    return limits


def single_joint(model: Plant, k: int) -> Plant:
    """Joint `k` by itself, its neighbours free: W_kk, and what of contact and gravity acts on it."""
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
    """W_kk, 0 where the contacts leave round-off."""
    return np.where(entry > ROUND_OFF * np.abs(whole).max(), entry, 0.0)


def joint_controller(controller: PD | PID | PPI, k: int, size: int) -> PD | PID | PPI:
    """What an n-joint controller does on joint `k` alone: its diagonal. Matrices of a P/PI count as the PID that they amount to."""
    gains = {name: getattr(controller, name) for name in controller.gain_names()}
    if type(controller) is PPI and all(np.ndim(gain) < 2 for gain in gains.values()):
        return replace(controller, **{name: float(np.broadcast_to(gain, size)[k]) for name, gain in gains.items()})
    terms = {powers: float(_own(gain, size)[k]) for powers, gain in controller.terms().items()}
    # velocity and integral of the same error make its position
    kp, ki, kd = terms.get((0, 0), 0.0) + terms.get((1, 1), 0.0), terms.get((0, 1), 0.0), terms.get((1, 0), 0.0)
    filters = {"velocity_filter": controller.velocity_filter, "notches": controller.notches}
    return PID(kp=kp, ki=ki, kd=kd, **filters) if ki else PD(kp=kp, kd=kd, **filters)


def _own(gain: Floats, size: int) -> Floats:
    """(n,) what a gain does on each joint alone. Matrices of tasks leave round-off on joints that no task moves."""
    matrix = gain_matrix("gain", gain, size)
    own = np.diagonal(matrix)
    return own if np.ndim(gain) < 2 else np.where(np.abs(own) > ROUND_OFF * np.abs(matrix).max(), own, 0.0)


def _joints(spec: RobotSpec, model: "RobotModel", controller: PD | PID | PPI, margins: Margins) -> tuple[JointRow, ...]:
    size = model.size
    terms = controller.terms()
    kp, kd = (_own(terms.get(powers, np.zeros(())), size) for powers in ((0, 0), (1, 0)))
    nothing = np.full(size, math.nan)
    own = np.diagonal(_at_least_zero(model.link_inverse_inertia, model.link_inverse_inertia))
    with np.errstate(divide="ignore"):
        load = 1 / own
    columns = {
        "link_inertia": load,
        "participation": np.abs(margins.limit.mode) if math.isfinite(margins.limit.frequency) else nothing,
        "single_joint_limit": single_joint_limits(spec, model, controller),
        "limit_others_closed": margins.one_loop.gain_margin,
        "kp": kp,
        "kd": kd,
        "kp_max": nothing if margins.one_loop.largest_kp is None else margins.one_loop.largest_kp,
        "kd_max": nothing if margins.one_loop.largest_kd is None else margins.one_loop.largest_kd,
    }
    return tuple(JointRow(name, **{key: float(column[k]) for key, column in columns.items()}) for k, name in enumerate(model.joint_names))


def _tasks(spec: RobotSpec, model: "RobotModel") -> TaskStudy:
    """All tasks together, and each direction by itself."""
    tasks = spec.robot.tasks(model, spec.control.rotors)
    count = len(tasks.directions)
    movable = tasks.movable
    acting = np.flatnonzero(movable & ((tasks.kp != 0) | (tasks.kd != 0) | (tasks.ki != 0))).tolist()
    loop = spec.loop(model, spec.shaped(tasks.controller()))
    limit = limit_of(loop) if acting else GainLimit.unknown(model.size)
    shares = [replace(tasks, torque=tasks.torque * np.eye(count)[k]) for k in acting]
    parts = [spec.loop(model, spec.shaped(share.controller())) for share in shares]
    alone, closed = np.full(count, math.nan), np.full(count, math.nan)
    alone[acting] = [limit_of(part).gain for part in parts]
    if limit.stable:
        closed[acting] = part_limits(loop, parts)
    owners = [task.name for task in tasks.tasks for _ in range(model.size if task.kind == "posture" else 3)]
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
