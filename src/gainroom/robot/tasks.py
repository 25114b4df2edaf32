"""Operational space: tasks stacked by strict priority, consistent with the contacts, and the equivalent joint gains.

The controller has its own model of the links, A' (A, or A + Sᵀ J_m S with rotors), and takes every contact as rigid. With P' and W' of
contact.py from A', a task of Jacobian J (m, N) reaches the joints through the motion that the contacts leave (Khatib 1987; Sentis, Park
and Khatib 2010, "Compliant control of multicontact and center-of-mass behaviors in humanoid robots"):

    E = W'⁺ S P' Jᵀ,    Λ = (Eᵀ W' E)⁺,    Γ = E Λ a,    a = K'p x_e + K'v ẋ_e,    x_e = Eᵀ q_e

Where the contacts hold the base, Λ = (J P' Jᵀ)⁻¹; on a fixed base E = Jᵀ: eqs. (5) to (10) of Jung et al. 2017,

    Kpq = E Λ K'p Eᵀ,    Kvq = E Λ K'v Eᵀ

Task k below others acts in their null space (N the product of I − Eᵢ Λᵢ Eᵢᵀ W' over those above, each itself so projected), and allows
for what they already do to it:

    Ê_k = N E_k,    Λ̂_k = (Ê_kᵀ W' Ê_k)⁺,    Γ_k = Ê_k Λ̂_k (a_k − E_kᵀ W' (Γ_1 + … + Γ_{k−1}))

so it does not affect the tasks above it, and tasks without conflict all get the commanded acceleration: then the whole stack obeys (9) and
(10) with one E and one Λ.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, first_of_many, nearest, require_finite
from ..native import _core
from ..system.controller import PD, PPI, Controller
from ..system.linear.arrays import Booleans, Floats, Integers
from .contact import free_motion
from .model import Stance, with_rotors

TaskKind = Literal["com", "position", "orientation", "posture"]
FRAMED = ("position", "orientation")

# A direction counts as movable when the joints move it by more than this, relative to the task's most movable direction without contact.
# Conflicts and singular legs come out at round-off (1e-13); a direction a million times harder to move than another is no task either.
MOVABLE = 1e-6
# A direction across what a task can move gets a torque of this share of the others' at most, by round-off.
ROUND_OFF = 1e-10
# Torques of unit size for directions that can all be moved are independent by more than this share: MOVABLE, with a reserve.
INDEPENDENT = 1e-8


@dataclass(frozen=True, kw_only=True)
class Task:
    """One task with its gains per direction, each a number for all directions or one per direction (m,).

    name    for tables
    kind    "com": centre of mass, "position" or "orientation" of a frame, all three along x, y, z of the world, whose axes are the base's;
            "posture": every joint's angle
    frame   for position and orientation
    kp, kd  PD: accelerations per error, K'p [1/s²] and K'v [1/s]
    ki      not None: P/PI, a = (kd + ki/s)(kp x_e − ẋ): kp [1/s], kd [1/s], ki [1/s²] (Fig. 13 of Jung et al. 2017)
    weight  > 0: of its stiffness when gains are recommended

    Raises GainroomError for an unknown kind, a frame missing or out of place, and gains that are not finite.
    """

    name: str
    kind: TaskKind
    frame: str | None = None
    kp: Any
    kd: Any
    ki: Any = None
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(TaskKind):
            raise GainroomError(f"task {self.name!r}: type {self.kind!r} must be one of {', '.join(get_args(TaskKind))}")
        if self.kind in FRAMED and self.frame is None:
            raise GainroomError(f"task {self.name!r}: type {self.kind} needs a frame")
        if self.kind not in FRAMED and self.frame is not None:
            raise GainroomError(f"task {self.name!r}: type {self.kind} takes no frame, but got {self.frame!r}")
        for gain in ("kp", "kd", "ki"):
            if getattr(self, gain) is not None:
                require_finite(f"task {self.name!r}", gain, getattr(self, gain))

    def directions(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        """Names (m,) of the directions with gains: x, y and z, or every joint."""
        return tuple(joint_names) if self.kind == "posture" else ("x", "y", "z")

    def regained(self, own: Sequence[PD | PPI]) -> "Task":
        """Task with the gains of `own`, one controller per direction as Tasks.of_direction returns it."""
        columns = {name: tuple(float(getattr(one, name)) for one in own) for name in own[0].gain_names()}
        return replace(self, kp=columns["kp"], kd=columns[own[0].damping_name], ki=columns.get("ki"))

    def scaled(self, factor: float) -> "Task":
        """Task with its torque multiplied by `factor`."""
        if self.ki is None:
            return replace(self, kp=factor * np.asarray(self.kp), kd=factor * np.asarray(self.kd))
        return replace(self, kd=factor * np.asarray(self.kd), ki=factor * np.asarray(self.ki))

    def jacobian(self, model: Stance) -> Floats:
        """Task Jacobian J (m, N), in world axes."""
        if self.kind == "posture":
            return model.selection
        if self.kind == "com":
            return model.body.com_jacobian(model.q)
        assert self.frame is not None
        rotation = model.body.frame_placement(model.q, self.frame)[0]
        local = model.body.frame_jacobian(model.q, self.frame)
        return rotation @ (local[:3] if self.kind == "position" else local[3:])


@dataclass(frozen=True)
class TaskPPI(PPI):
    """P/PI per task direction as a controller of n joints: Γ = X (Kv + Ki/s)(Kp + s) Eᵀ q_e, with kp, kv, ki (m,).

    torque     X (n, m), as Tasks
    jacobian   Eᵀ (m, n)
    """

    torque: Floats = field(kw_only=True)
    jacobian: Floats = field(kw_only=True)

    def require_size(self, size: int) -> None:
        if self.torque.shape[0] != size:
            raise GainroomError(f"tasks of a robot with {self.torque.shape[0]} joints cannot control {size}")
        super().require_size(self.torque.shape[1])

    def terms(self) -> dict[tuple[int, int], Floats]:
        return {powers: self.torque @ (gain[:, None] * self.jacobian) for powers, gain in super().terms().items()}

    def on_joint(self, k: int, size: int) -> Controller:
        """PID equivalent on joint `k`, made from the gains of all directions."""
        return self.as_pid_on_joint(k, size)


@dataclass(frozen=True)
class Tasks:
    """Stack of tasks at one posture and contact state, as a controller of n joints; m directions in all.

    tasks       by falling priority
    directions  (m,) their names, "com x" and so on; a posture's end in the joint's name
    owners      (m,) index of each direction's task
    jacobian    Eᵀ (m, n): joint errors → task errors, the base following the joints
    torque      X (n, m): commanded accelerations → joint torques; E Λ where tasks do not conflict
    follow      (N, n) motion of all degrees of freedom by the joints, see `following`
    kp, kd, ki  (m,) the tasks' own gains
    cascade     (m,) True for P/PI
    warnings    about directions that cannot be moved
    """

    tasks: tuple[Task, ...]
    directions: tuple[str, ...]
    owners: Integers
    jacobian: Floats
    torque: Floats
    follow: Floats
    kp: Floats
    kd: Floats
    ki: Floats
    cascade: Booleans
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Tasks({len(self.directions)} directions: {first_of_many(self.directions)})"

    @property
    def weight(self) -> Floats:
        """Weight (m,) of every direction, that of its task."""
        return np.array([task.weight for task in self.tasks])[self.owners]

    @property
    def movable(self) -> Booleans:
        """(m,) False where the joints cannot move a direction, or tasks of higher priority use all motions that could."""
        torques = np.linalg.norm(self.torque, axis=0)
        largest = np.array([torques[self.owners == owner].max() for owner in self.owners])
        return torques > ROUND_OFF * largest

    @property
    def motions(self) -> int:
        """Number of independent joint motions that the contacts leave: the rank of W'."""
        return int(np.count_nonzero(np.linalg.svd(self.follow, compute_uv=False) > 0.5))  # a projector on the joints: 0, or 1 and more

    @property
    def free(self) -> int:
        """Number of `motions` that no task's kp holds, so that nothing restores them."""
        columns = self.torque[:, self.movable & (self.kp != 0)]
        sizes = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
        return self.motions - int(np.count_nonzero(sizes > INDEPENDENT))

    def joint_gains(self, kp: ArrayLike | None = None, kd: ArrayLike | None = None) -> tuple[Floats, Floats]:
        """Joint gain matrices Kpq, Kvq (n, n) [N m/rad, N m s/rad] of PD gains, eqs. (9) and (10).

        kp, kd   K'p [1/s²], K'v [1/s]: a number or (m,); None: the tasks' own, which must then all be PD
        """
        return self._matrix(self._given("kp", kp)), self._matrix(self._given("kd", kd))

    def direction_gains(self, direction: str, kp: ArrayLike | None = None, kd: ArrayLike | None = None) -> tuple[Floats, Floats]:
        """Contribution (n, n) of one of `directions` to Kpq and to Kvq, each of rank one; contributions add up to joint_gains."""
        only = np.eye(len(self.directions))[self._index(direction)]
        return self._matrix(only * self._given("kp", kp)), self._matrix(only * self._given("kd", kd))

    def scaled(self, direction: str, factor: float) -> "Tasks":
        """Tasks with all gains of one direction multiplied by `factor`, PD or P/PI."""
        torque = self.torque.copy()
        torque[:, self._index(direction)] *= require_finite("tasks", "factor", factor)
        return replace(self, torque=torque)

    def controller(self) -> PD | PPI:
        """Controller of n joints with the tasks' own gains: PD, or P/PI where any task is.

        A PD direction beside P/PI ones becomes P/PI with ki 0 and kp divided by kd. Raises GainroomError where it has no kd.
        """
        if not self.cascade.any():
            return PD(*self.joint_gains())
        for direction, cascade, kp, kd in zip(self.directions, self.cascade, self.kp, self.kd, strict=True):
            if not cascade and kp and not kd:
                raise GainroomError(f"task direction {direction!r}: kd must not be 0 in a stack with P/PI tasks")
        outer = self.kp / np.where(self.cascade | (self.kd == 0), 1.0, self.kd)
        return TaskPPI(kp=outer, kv=self.kd, ki=self.ki, torque=self.torque, jacobian=self.jacobian)

    def of_direction(self, k: int) -> PD | PPI:
        """Gains of direction `k` alone, as a controller of one joint: error along it → commanded acceleration."""
        kp, kd, ki = (float(gain[k]) for gain in (self.kp, self.kd, self.ki))
        return PPI(kp, kd, ki) if self.cascade[k] else PD(kp, kd)

    def _given(self, name: str, gain: ArrayLike | None) -> Floats:
        if gain is not None:
            return _per_direction("tasks", name, gain, len(self.directions))
        if self.cascade.any():
            raise GainroomError(f"tasks: {name} of P/PI tasks is no PD gain; use controller(), or give PD gains")
        return getattr(self, name)

    def _index(self, direction: str) -> int:
        if direction not in self.directions:
            raise GainroomError(f"tasks: no direction {direction!r}{nearest(direction, self.directions, 'direction')}")
        return self.directions.index(direction)

    def _matrix(self, gains: Floats) -> Floats:
        return self.torque @ (gains[:, None] * self.jacobian)


def tasks_of(model: Stance, tasks: Sequence[Task], rotors: bool = False) -> Tasks:
    """Operational space of `tasks`, highest priority first, on a linearised robot.

    rotors   True: the controller's model A' includes the motors' reflected inertia

    Raises GainroomError for no task at all, a name used twice, an unknown frame, and gains that do not match their directions.
    """
    tasks = tuple(tasks)
    if not tasks:
        raise GainroomError("tasks: there must be at least one")
    for name, count in Counter(task.name for task in tasks).items():
        if count > 1:
            raise GainroomError(f"task {name!r}: the name is used {count} times; give each task its own")
    jacobians = [task.jacobian(model) for task in tasks]
    sizes, joints = [len(jacobian) for jacobian in jacobians], len(model.selection)
    inertia = with_rotors(model) if rotors else model.inertia  # A'
    follow, torque, ranks, motions = _core.task_motion(inertia, model.contact_jacobian, np.vstack(jacobians), sizes, joints, MOVABLE)
    return Tasks(
        tasks=tasks,
        directions=tuple(f"{task.name} {direction}" for task in tasks for direction in task.directions(model.joint_names)),
        owners=np.repeat(np.arange(len(tasks)), sizes),
        jacobian=np.vstack([jacobian @ follow for jacobian in jacobians]),
        torque=torque,
        follow=follow,
        kp=_gains("kp", tasks, sizes),
        kd=_gains("kd", tasks, sizes),
        ki=_gains("ki", tasks, sizes),
        cascade=np.repeat([task.ki is not None for task in tasks], sizes),
        warnings=_immovable(tasks, sizes, ranks, motions),
    )


def following(inertia: Floats, held: Floats, joints: int) -> Floats:
    """Matrix P' Sᵀ W'⁺ (N, n): motion of all degrees of freedom by the joints, the last n, on contacts `held` (c, N), without the rotors.

    Its transpose maps forces on all degrees of freedom to the smallest equivalent joint torques.
    """
    motion = free_motion(inertia, held)
    return motion @ _core.pseudo_inverse(motion[len(inertia) - joints :], MOVABLE)


def _immovable(tasks: Sequence[Task], sizes: Sequence[int], ranks: Sequence[int], motions: int) -> tuple[str, ...]:
    """Warnings, one for each task that the joints cannot move in all its directions.

    sizes, ranks   number of directions of each task, and of movable ones
    motions        number of joint motions; if it suffices for all directions so far and some are immovable, the posture is singular
    """
    warnings, start = [], 0
    for task, size, rank in zip(tasks, sizes, ranks, strict=True):
        start += size
        if rank < size and (task.kind != "posture" or not rank):  # a posture fills what others leave
            beside = " beside the tasks above it" if start > size else ""
            warnings.append(
                f"task {task.name!r}: the joints can move {rank} of its {size} directions in this posture and contact{beside}; "
                f"its gains {'act on those alone' if rank else 'do nothing there'}"
                f"{'; the joints are enough for more, so the posture may be singular: try another' if rank and start <= motions else ''}"
            )
    return tuple(warnings)


def _gains(name: str, tasks: Sequence[Task], sizes: Sequence[int]) -> Floats:
    """One gain of all tasks (m,); 0 where a task has none."""
    given = ((task, getattr(task, name), size) for task, size in zip(tasks, sizes, strict=True))
    return np.concatenate([_per_direction(f"task {task.name!r}", name, 0.0 if gain is None else gain, size) for task, gain, size in given])


def _per_direction(owner: str, name: str, gain: ArrayLike, size: int) -> Floats:
    values = require_finite(owner, name, gain)
    if values.ndim and values.shape != (size,):
        raise GainroomError(f"{owner}: {name} of shape {values.shape} must be a number or {size} numbers, one per direction")
    return np.broadcast_to(values, (size,)).copy()
