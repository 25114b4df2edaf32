"""A whole robot, studied: every posture in every contact state, all joints closed at once, joint by joint, and in task space."""

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Floats
from .controller import PD, PID, PPI, gain_matrix
from .coupled import JointMargins, joint_margins
from .limits import GainLimit, gain_limit
from .loop import Loop, build_loop
from .multiloop_disk import disk_margin
from .part_limits import part_limits
from .plant import Compliance, Plant
from .robot_gains import RobotGains, recommend_robot
from .robot_spec import RobotSpec
from .robustness import to_db
from .study import CONTINUOUS

if TYPE_CHECKING:
    from .robot.model import RobotModel
    from .robot.tasks import Tasks

STRONG = 0.5
"""A joint takes part in a vibration where it moves by at least this share of the one that moves most."""
COUPLED = 0.95
"""Below this share of the tightest joint's own limit, coupling between joints costs something worth saying."""
EXPECTED_LOOKS = 40
"""Loops that the search for gains looks at per state and corner of the uncertainty, roughly: for the progress bar."""
Progress = Callable[[int, int, str], None]
"""Called with (states done, states in all, the next one's name)."""


@dataclass(frozen=True)
class JointRow:
    """One joint in one state.

    link_inertia        1/W_ii: the load with every neighbour free [kg m²]; inf where the contacts hold the joint
    participation       its part in the vibration at the limit, relative to the largest
    single_joint_limit  factor on its gains if it were the only joint, with that load
    limit_others_closed factor on its gains with all other loops as they are; NaN for an unstable robot
    kp, kd              what the controller does on this joint alone: N m/rad, N m s/rad
    kp_max, kd_max      largest, the other gains as they are; NaN where unstable, or the controller has none
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

    kp, kd       its own gains [1/s²], [1/s]; P/PI: [1/s], [1/s], with ki [1/s²]; ki None: PD
    gain_limit   factor on them with no other direction closed
    limit_others_closed   factor on them with all others as they are; NaN where the stack is unstable
    """

    name: str
    direction: str
    kp: float
    kd: float
    ki: float | None
    gain_limit: float
    limit_others_closed: float


@dataclass(frozen=True)
class TaskStudy:
    """The operational space in one state: the limit of all tasks together, and each direction."""

    tasks: "Tasks"
    limit: GainLimit
    rows: tuple[TaskRow, ...]


@dataclass(frozen=True)
class StateStudy:
    """One posture in one contact state; `disk_margin` of all loops, changed at once and independently, NaN for an unstable robot."""

    posture: str
    contact: str
    model: "RobotModel"
    loop: Loop
    margins: JointMargins
    joints: tuple[JointRow, ...]
    tasks: TaskStudy | None
    disk_margin: float

    @property
    def limit(self) -> GainLimit:
        """Of the common factor on all gains."""
        return self.margins.limit

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """Those that take part in the vibration at the limit, the strongest first."""
        return limiting_joints(self.limit, self.model.joint_names)

    @property
    def title(self) -> str:
        """For tables and messages."""
        return f"{self.posture}, {self.contact}"


@dataclass(frozen=True)
class RobotStudy:
    """What `gainroom robot` tells; states in the file's order, `recommended` by space."""

    spec: RobotSpec
    states: tuple[StateStudy, ...]
    sentence: str
    warnings: tuple[str, ...]
    recommended: tuple[RobotGains, ...] = ()

    @property
    def stable(self) -> bool:
        """In every state."""
        return all(state.limit.stable for state in self.states)

    @property
    def tightest(self) -> StateStudy:
        """The state with the least room."""
        return min(self.states, key=lambda state: by_room(state.limit))

    @property
    def tightest_by_contact(self) -> tuple[StateStudy, ...]:
        """Of each contact state the posture with the least room, in the file's order."""
        contacts = dict.fromkeys(state.contact for state in self.states)
        groups = ([state for state in self.states if state.contact == contact] for contact in contacts)
        return tuple(min(group, key=lambda state: by_room(state.limit)) for group in groups)


def study_robot(spec: RobotSpec, progress: Progress | None = None, recommend: bool = True) -> RobotStudy:
    """Everything about one robot; `recommend`: with gains to use, which takes longest.

    Raises GainroomError for a state that cannot be linearised.
    """
    names = spec.robot.states
    tell = progress or (lambda done, total, what: None)
    states = []
    for index, (posture, contact) in enumerate(names):
        tell(index, len(names), f"state {posture}, {contact}")
        states.append(study_state(spec, posture, contact))
    tell(len(names), len(names), "")
    study = RobotStudy(spec, tuple(states), "", (), _recommended(spec, tell) if recommend and spec.requirements.asked else ())
    return replace(study, sentence=_sentence(study), warnings=_warnings(study))


def _recommended(spec: RobotSpec, tell: Progress) -> tuple[RobotGains, ...]:
    """Gains to use in joint space and, where there are tasks, in task space."""
    expected = EXPECTED_LOOKS * len(spec.robot.states) * 2 ** len(spec.uncertainty.names)

    def of(space: str) -> RobotGains:
        looked = itertools.count()

        def count() -> None:
            tell(min(next(looked), expected), expected, f"gains, {space} space")

        count()
        return recommend_robot(spec, space, count)

    return tuple(of(space) for space in (("joint", "task") if spec.robot.stack else ("joint",)))


def by_room(limit: GainLimit) -> tuple[bool, float]:
    """Sorts limits: unstable ones first, then the one with the least room."""
    return limit.stable, limit.gain


def study_state(spec: RobotSpec, posture: str, contact: str) -> StateStudy:
    """One posture in one contact state."""
    model = spec.robot.linearize(posture, contact)
    controller = spec.controller(model)
    loop = spec.loop(model, controller)
    margins = joint_margins(loop)
    return StateStudy(
        posture=posture,
        contact=contact,
        model=model,
        loop=loop,
        margins=margins,
        joints=_joints(spec, model, controller, margins),
        tasks=_tasks(spec, model) if spec.robot.stack else None,
        disk_margin=disk_margin(loop).margin if margins.stable else math.nan,
    )


def limiting_joints(limit: GainLimit, names: tuple[str, ...]) -> tuple[str, ...]:
    """The joints that take part in the vibration at a limit, the strongest first; none where there is no limit."""
    if not math.isfinite(limit.frequency):
        return ()
    parts = np.abs(limit.mode)
    return tuple(names[k] for k in np.argsort(-np.round(parts / parts.max(), 6), kind="stable") if parts[k] >= STRONG * parts.max())


def single_joint_limits(spec: RobotSpec, model: "RobotModel", controller: PD | PID | PPI) -> Floats:
    """(n,) factor on each joint's gains if it were the only one, its load 1/W_ii; NaN where it has no gains, inf where it cannot move."""
    limits = np.full(model.size, math.nan)
    for k in range(model.size):
        alone = single_joint(model, k)
        own = joint_controller(controller, k, model.size)
        if not any(np.any(gain) for gain in own.terms().values()):
            continue
        if alone.link_inverse_inertia[0, 0] == 0 and (not alone.elastic[0] or spec.control.feedback == "link"):
            limits[k] = math.inf
            continue
        limits[k] = gain_limit(build_loop(alone, spec.drives[k], own, spec.control.feedback, spec.control.sample_time)).gain
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
    return np.where(entry > 1e-12 * np.abs(whole).max(), entry, 0.0)


def joint_controller(controller: PD | PID | PPI, k: int, size: int) -> PD | PID | PPI:
    """What an n-joint controller does on joint `k` alone: its diagonal. Matrices of a P/PI count as the PID that they amount to."""
    gains = {name: getattr(controller, name) for name in controller.gain_names()}
    if type(controller) is PPI and all(np.ndim(gain) < 2 for gain in gains.values()):
        return replace(controller, **{name: float(np.broadcast_to(gain, size)[k]) for name, gain in gains.items()})
    terms = {powers: float(gain_matrix("gain", gain, size)[k, k]) for powers, gain in controller.terms().items()}
    # velocity and integral of the same error make its position
    kp, ki, kd = terms.get((0, 0), 0.0) + terms.get((1, 1), 0.0), terms.get((0, 1), 0.0), terms.get((1, 0), 0.0)
    filters = {"velocity_filter": controller.velocity_filter, "notches": controller.notches}
    return PID(kp=kp, ki=ki, kd=kd, **filters) if ki else PD(kp=kp, kd=kd, **filters)


def _joints(spec: RobotSpec, model: "RobotModel", controller: PD | PID | PPI, margins: JointMargins) -> tuple[JointRow, ...]:
    size = model.size
    terms = controller.terms()
    kp, kd = (np.diagonal(gain_matrix("gain", terms.get(powers, np.zeros(())), size)) for powers in ((0, 0), (1, 0)))
    nothing = np.full(size, math.nan)
    own = np.diagonal(_at_least_zero(model.link_inverse_inertia, model.link_inverse_inertia))
    with np.errstate(divide="ignore"):
        load = 1 / own
    columns = {
        "link_inertia": load,
        "participation": np.abs(margins.limit.mode) if math.isfinite(margins.limit.frequency) else nothing,
        "single_joint_limit": single_joint_limits(spec, model, controller),
        "limit_others_closed": margins.others_closed,
        "kp": kp,
        "kd": kd,
        "kp_max": nothing if margins.largest_kp is None else margins.largest_kp,
        "kd_max": nothing if margins.largest_kd is None else margins.largest_kd,
    }
    return tuple(JointRow(name, **{key: float(column[k]) for key, column in columns.items()}) for k, name in enumerate(model.joint_names))


def _tasks(spec: RobotSpec, model: "RobotModel") -> TaskStudy:
    """All tasks together, and each direction by itself."""
    tasks = spec.robot.tasks(model, spec.control.rotors)
    count = len(tasks.directions)
    moving = [k for k in range(count) if np.any(tasks.torque[:, k])]
    loop = spec.loop(model, spec.shaped(tasks.controller()))
    limit = gain_limit(loop) if moving else GainLimit(True, math.inf, 0.0, math.nan, np.ones(model.size, dtype=complex), None)
    shares = [replace(tasks, torque=tasks.torque * np.eye(count)[k]) for k in moving]
    parts = [spec.loop(model, spec.shaped(share.controller())) for share in shares]
    alone, closed = np.full(count, math.nan), np.full(count, math.nan)
    alone[moving] = [gain_limit(part).gain for part in parts]
    if limit.stable:
        closed[moving] = part_limits(loop, parts)
    owners = [task.name for task in tasks.tasks for _ in range(model.size if task.kind == "posture" else 3)]
    rows = tuple(
        TaskRow(
            name=owner,
            direction=tasks.directions[k].removeprefix(f"{owner} "),
            kp=float(tasks.kp[k]),
            kd=float(tasks.kd[k]),
            ki=float(tasks.ki[k]) if tasks.cascade[k] else None,
            gain_limit=float(alone[k]),
            limit_others_closed=float(closed[k]),
        )
        for k, owner in enumerate(owners)
    )
    return TaskStudy(tasks, limit, rows)


def _sentence(study: RobotStudy) -> str:
    """The answer in one sentence: verdict, room, frequency, joints, and what the coupling costs."""
    worst, count = study.tightest, len(study.states)
    where = f"in posture {worst.posture}, contact {worst.contact}"
    limit = worst.limit
    every = "" if count == 1 else f" in all {count} states"
    unstable = sum(not state.limit.stable for state in study.states)
    if not unstable and math.isinf(limit.gain):
        return f"Stable{every}: no common factor on these gains makes the modelled robot vibrate."
    at = f"{limit.frequency / (2 * math.pi):.3g} Hz ({limit.frequency:.4g} rad/s)"
    joints = _and(worst.limiting_joints)
    if not unstable:
        return (
            f"Stable{every}: these gains can be multiplied by {limit.gain:.3g} ({to_db(limit.gain):.3g} dB) before the robot vibrates, "
            f"first {where}, at {at}, most of all {joints}{_coupling(worst)}."
        )
    start = "Unstable" if count == 1 else f"Unstable in {unstable} of {count} states"
    if limit.gain > 0 and math.isfinite(limit.gain):
        return (
            f"{start}: with these gains the robot vibrates; {where} it is stable below {limit.gain:.3g} times them, where {joints} would "
            f"vibrate at {at}{_coupling(worst)}."
        )
    return f"{start}: with these gains the robot does not settle {where}, and no common factor that lowers them makes it stable."


def _coupling(state: StateStudy) -> str:
    """What the joints cost each other, against the tightest of them alone."""
    alone = min((row.single_joint_limit for row in state.joints if not math.isnan(row.single_joint_limit)), default=math.nan)
    if state.limit.gain < COUPLED * alone:
        return f"; joint by joint it would be {alone:.3g}: the coupling costs the rest"
    return ""


def _and(names: tuple[str, ...]) -> str:
    if len(names) > 4:
        return f"{', '.join(names[:4])} and {len(names) - 4} more"
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def unconfirmed(limits: Iterable[GainLimit]) -> list[str]:
    """A warning where a limit's certificate does not hold."""
    if all(limit.certificate is None or limit.certificate.holds for limit in limits):
        return []
    return ["a limit could not be confirmed from both sides: treat it as an estimate and report the input"]


def _warnings(study: RobotStudy) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    spec = study.spec
    warnings = list(spec.warnings)
    unstable = [state for state in study.states if not state.limit.stable]
    if unstable and 0 < study.tightest.limit.gain < math.inf:
        warnings.insert(0, f"these gains are unstable: multiply all of them by less than {study.tightest.limit.gain:.3g}")
    if spec.control.sample_time is None and any(drive.delay > 0 for drive in spec.drives):
        warnings.append(CONTINUOUS)
    undamped = np.isfinite(spec.robot.actuators.stiffness) & (spec.robot.actuators.damping == 0)
    if spec.control.feedback == "link" and np.any(undamped):
        warnings.append(
            "link-side feedback on undamped elastic joints is unstable at any gain: measure damping, or close the loops on the motor side"
        )
    for state in study.states:
        if state.tasks is not None:
            warnings += [f"{state.title}: {text}" for text in state.tasks.tasks.warnings]
            if not state.tasks.limit.stable and spec.control.space == "joint":
                warnings.append(f"{state.title}: the tasks' gains are unstable; they may be scaled by {state.tasks.limit.gain:.3g} at most")
    warnings += unconfirmed(state.limit for state in study.states)
    if not spec.uncertainty.names:
        warnings.append("stiffness, damping, inertia and delay are taken as exact; give uncertainty: for gains that hold over a range")
    return tuple(dict.fromkeys(warnings))
