"""Controller of a whole robot at its ticks: encoder readings in, motor torques out.

It uses only data that a real controller has: the encoders, its own model of the links, and the assumption that contacts do not move. The
pose of the base follows: with the joints at the encoder readings, base and joints are moved until the contact frames are in place, the
joints as little as possible (in front of elastic gearboxes, encoders of legs closed into a loop contradict each other a little). One Newton
step per tick suffices for the small motion between ticks, by

    C = (I − Y S) J_c⁺,    Y = P' Sᵀ W'⁺

so that to first order everything moves as Y θ, as in robot/tasks.py. The torques are

    Γ = X D(z) x_e + Yᵀ g(q)

the torques for the tasks' accelerations (or, in joint space, D(z) θ_e) and the smallest torques that hold the weight.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_count, require_finite
from ..native import _core
from ..robot.body import RigidBody
from ..robot.contact import REDUNDANT, Contact, contact_jacobian
from ..robot.rigid_tree import held_frames, rigid_tree, tree_tasks
from ..robot.tasks import MOVABLE, Task, TaskPPI, Tasks, following, tasks_of
from ..system.assembly import controller_state
from ..system.controller import PD, PPI, Controller
from ..system.linear.arrays import Floats
from ..system.system import Control


class SampledControl:
    """Controller with gains per channel, its filters, and the states of filters and integrators.

    controller    gains: numbers, (m,) or (m, m)
    channels      m
    sample_time   [s]

    Velocity is that of the error, or of the measured value alone (Controller.rate_of_error; P/PI, as Fig. 13 of Jung et al. 2017 draws it).
    """

    def __init__(self, controller: Controller, channels: int, sample_time: float):
        system = controller_state(controller, channels, sample_time)
        # (state, error, motion) → (next state, output), in one product
        self._step = np.block([[np.eye(len(system.a)) + sample_time * system.a, sample_time * system.b], [system.c, system.d]])
        self._of_error = controller.rate_of_error
        self._state = np.zeros(len(system.a))
        self._from = np.zeros(channels)

    def rest(self, error: Floats, value: Floats) -> None:
        """Start from rest at `error` and measured `value`, each (m,): velocity starts at 0, filters and integrators are empty."""
        self._state[:] = 0.0
        self._from = error if self._of_error else -value

    def tick(self, error: Floats, value: Floats) -> Floats:
        """Output (m,) on this tick's error x_d − x and measured value x."""
        motion = (error if self._of_error else -value) - self._from
        moved = self._step @ np.concatenate([self._state, error, motion])
        self._state = moved[: len(self._state)]
        return moved[len(self._state) :]


FIRST_NEWTON_STEPS = 4
"""Number of Newton steps at the first tick, when gearboxes that carry weight are already deflected."""


@dataclass(frozen=True)
class BodyStance:
    """Posture on its contacts as the controller's model needs it, see robot.model.Stance."""

    body: RigidBody
    q: Floats
    motor_inertia: Floats
    inertia: Floats
    contact_jacobian: Floats
    selection: Floats

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names of the body."""
        return self.body.joint_names


def stance_of(body: RigidBody, q: Floats, motor_inertia: Floats, contacts: Sequence[Contact]) -> BodyStance:
    """Stance of the body in posture `q` (nq,) on `contacts`, all taken as rigid."""
    selection = np.eye(body.nv)[body.nv - body.size :]
    return BodyStance(body, q, motor_inertia, body.mass_matrix(q), contact_jacobian(body, q, contacts), selection)


class PostureEstimate:
    """Estimate of base and joint positions from encoders, with contact frames fixed where `start` (nq,) has them.

    Base motion that neither encoders nor contacts show (in flight, on points) is integrated from tick to tick by `follow`.
    """

    def __init__(self, body: RigidBody, contacts: Sequence[Contact], start: ArrayLike):
        self.q = require_finite(body.source, "posture", start).copy()
        self._base = body.nv - body.size
        base = contact_jacobian(body, self.q, contacts)[:, : self._base]
        self._held = self._base == 0 or (len(base) > 0 and np.linalg.matrix_rank(base, tol=1e-6) == self._base)
        self._running = _core.PostureEstimate(rigid_tree(body), *held_frames(body, contacts), self.q)

    def renew(self, held: Floats, follow: Floats) -> None:
        """Set the contact Jacobian `held` (c, N) and Y = `follow` (N, n)."""
        back = _core.pseudo_inverse(held, REDUNDANT)
        self._running.renew(back - follow @ back[self._base :], None if self._held else follow[: self._base])

    def update(self, positions: Floats) -> Floats:
        """Posture (nq,) estimated from the encoders' `positions` (n,)."""
        self.q = self._running.update(positions)
        return self.q


class WholeBodyControl:
    """Control program of a whole robot.

    body, motor_inertia   its model of the robot; the inertia is used if control.rotors is set
    contacts    frames on the ground; springs under them are not known to it
    start       (nq,) posture at the first tick
    control     joint or task space, filters, feedback, sample time
    stack       tasks by falling priority, in task space
    gravity     True: the weight is compensated
    refresh     ticks between updates of Jacobians and inertia; errors and weight are updated at every tick
    gain        common factor on all gains

    Orientations are rotation vectors from the first tick's, in world axes. Raises GainroomError as tasks_of, and for control without a
    sample time.
    """

    def __init__(
        self,
        body: RigidBody,
        motor_inertia: Floats,
        contacts: Sequence[Contact],
        start: ArrayLike,
        control: Control,
        stack: Sequence[Task] = (),
        *,
        gravity: bool = True,
        refresh: int = 40,
        gain: float = 1.0,
    ):
        if control.sample_time is None:
            raise GainroomError("control: the simulation runs a sampled controller; give sample_rate_hz")
        self._body, self._control, self._stack = body, control, tuple(stack) if control.space == "task" else ()
        self._gravity, self._gain = gravity, gain
        self._refresh, self._age = require_count("simulation", "refresh", refresh, 1), 0
        self._estimate = PostureEstimate(body, contacts, start)
        self._tree, self._frames, self._readings = rigid_tree(body), held_frames(body, contacts), tree_tasks(body, self._stack)
        self._rotors = np.diag(np.concatenate([np.zeros(body.nv - body.size), motor_inertia if control.rotors else np.zeros(body.size)]))
        stance = stance_of(body, self._estimate.q, motor_inertia, tuple(contacts))
        self._tasks: Tasks | None = tasks_of(stance, self._stack, control.rotors) if self._stack else None
        self._renew()
        self._values = values_of(body, self._stack, self._estimate.q)
        self.channels = self._tasks.directions if self._tasks else body.joint_names
        self._running = SampledControl(self._law(), len(self.channels), control.sample_time)
        self._start: Floats | None = None

    @property
    def holding_torque(self) -> Floats:
        """Joint torques (n,) that hold the weight in the latest posture [N m]; zeros if gravity is not compensated."""
        if not self._gravity:
            return np.zeros(self._body.size)
        return self._tree.weight(self._estimate.q) @ self._follow

    def tick(self, positions: Floats, offset: Floats) -> tuple[Floats, Floats, Floats]:
        """Torques (n,) for the encoders' `positions` (n,), then reference and measured values (m,).

        offset   (m,) commanded displacement of each channel from its value at the first tick
        """
        first = self._start is None
        if self._stack or self._gravity:
            self._age += 1
            if self._age > self._refresh:
                self._renew()
            for _ in range(FIRST_NEWTON_STEPS if first else 1):
                self._estimate.update(positions)
        value = self._values(self._estimate.q) if self._stack else positions
        if first:
            self._start = value
            self._running.rest(np.zeros(len(value)), value)
        reference = self._start + offset
        wanted = self._gain * self._running.tick(reference - value, value)
        torque = wanted if self._torque is None else self._torque @ wanted
        return torque + self.holding_torque if self._gravity else torque, reference, value

    def _renew(self) -> None:
        """Update Jacobians and inertia to the present posture."""
        self._age, joints = 1, self._body.size
        inertia, held, rows = self._tree.dynamics(self._estimate.q, *self._frames, self._readings)
        if self._tasks:
            sizes = np.bincount(self._tasks.owners).tolist()
            self._follow, self._torque, _, _ = _core.task_motion(inertia + self._rotors, held, rows, sizes, joints, MOVABLE)
        else:
            self._follow, self._torque = following(inertia, held, joints), None
        self._estimate.renew(held, self._follow)

    def _law(self) -> Any:
        """Control law D(z) of the channels."""
        control = self._control
        if not self._tasks:
            return control.controller
        law = self._tasks.controller()
        if isinstance(law, TaskPPI):
            return PPI(law.kp, law.kv, law.ki, **control.filters)
        return PD(self._tasks.kp, self._tasks.kd, **control.filters)


def values_of(body: RigidBody, stack: Sequence[Task], start: Floats) -> Callable[[Floats], Floats]:
    """Function from a posture (nq,) to the tasks' values (m,); orientations as rotation vectors from posture `start`, in world axes."""
    return _core.TaskValues(rigid_tree(body), tree_tasks(body, stack), start).read
