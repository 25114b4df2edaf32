"""Run of a whole robot: MuJoCo between the controller's ticks, drives between commands and motors, encoders on the motor side."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_count, require_finite, require_positive
from ..robot.body import is_prismatic, library, put_position
from ..robot.formats.mujoco_messages import mujoco_warnings
from ..robot.tasks import Task
from ..system.linear.arrays import Floats
from .mujoco_model import MujocoRobot, build_mujoco
from .robot_setup import RobotSetup, channel_units, substeps_for
from .run_record import REFERENCE_SIGNAL, Ending, Run, Unit, ended, joined
from .torque_line import TorqueLine
from .whole_body import WholeBodyControl, values_of

MUJOCO_BLOCK = 200
"""Number of ticks per streamed part."""
TOO_FAST = 50.0
"""Motor speed [rad/s, m/s], joint side, above which, and above BEYOND_PLAN times the planned move, a run has diverged."""
BEYOND_PLAN = 5.0
"""Multiple of the fastest planned speed above which a run may have diverged."""
FALLEN = 0.5
"""Height change of a floating base relative to its height above the feet, or tilt [rad], at which the robot has fallen."""

"""Called with (ticks done, ticks in all)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotRun(Run):
    """Run of a robot, with finite values only.

    setup           the robot
    base            (k, 7) position [m] and quaternion x, y, z, w of a floating base; (k, 0) of a fixed one
    """

    setup: RobotSetup
    base: Floats

    @property
    def units(self) -> tuple[Unit, ...]:
        return channel_units(self.setup)

    @property
    def torque_units(self) -> tuple[str, ...]:
        return tuple("N" if prismatic else "N·m" for prismatic in self.setup.body.prismatic.tolist())

    @property
    def error(self) -> Floats:
        """Tracking error (k, m), see Run.error; for tasks, reference minus the value that the controller computes from its encoders."""
        return super().error if self.setup.control.space == "joint" else self.reference - self.measured

    @cached_property
    def actual(self) -> Floats:
        return super().actual if self.setup.control.space == "joint" else self._values(self.setup.stack)

    def columns(self) -> dict[str, Floats]:
        """Columns of a log, see Run.columns; without a task's reference, which belongs to no joint."""
        columns = super().columns()
        return columns if self.setup.control.space == "joint" else {name: columns[name] for name in columns if name != REFERENCE_SIGNAL}

    def posture(self, row: int) -> Floats:
        """Posture (nq,) of the links at tick `row`."""
        q = self.setup.body.neutral()
        q[: self.base.shape[1]] = self.base[row]
        for joint, position in zip(self.setup.body.joints, self.link_position[row], strict=True):
            put_position(q, joint, position)
        return q

    @cached_property
    def slip(self) -> Floats:
        """Distance (k, c) of each contact frame from its start [m]."""
        frames = [Task(name=contact.frame, kind="position", frame=contact.frame, kp=0.0, kd=0.0) for contact in self.setup.contacts]
        if not frames:
            return np.zeros((len(self.time), 0))
        start = np.concatenate([self.setup.body.frame_placement(self.setup.q, contact.frame)[1] for contact in self.setup.contacts])
        away = self._values(frames) - start
        return np.linalg.norm(away.reshape(len(self.time), len(frames), 3), axis=2)

    def _values(self, tasks: Sequence[Task]) -> Floats:
        values = values_of(self.setup.body, tasks, self.setup.q)
        return np.array([values(self.posture(row)) for row in range(len(self.time))])


def run_robot(setup: RobotSetup, offsets: ArrayLike, *, gain: float = 1.0, initial_speed: ArrayLike = 0.0) -> RobotRun:
    """Complete run; arguments and errors as stream_robot."""
    return joined(stream_robot(setup, offsets, gain=gain, initial_speed=initial_speed))


def stream_robot(
    setup: RobotSetup, offsets: ArrayLike, *, gain: float = 1.0, initial_speed: ArrayLike = 0.0, block: int = MUJOCO_BLOCK
) -> Iterator[RobotRun]:
    """Run of the robot from rest, gearboxes deflected by its weight and drives holding it, in parts of `block` ticks.

    offsets   (k, m) commanded displacement of each channel from its start, one row per tick; see `hold`
    gain      common factor on all gains
    initial_speed   (n,) speed of the motors at the start [rad/s]

    It ends early if the robot falls, runs away or is no longer finite, with the reason in the last part. Raises GainroomError for input
    that does not fit.
    """
    plan = require_finite("simulation", "offsets", offsets)
    simulation = RobotStepper(setup, gain=gain, initial_speed=initial_speed)
    if plan.ndim != 2 or plan.shape[1] != len(simulation.channels) or not len(plan):
        raise GainroomError(f"simulation: offsets of shape {plan.shape} must be (ticks, {len(simulation.channels)})")
    if setup.control.space == "joint":
        planned = np.abs(np.diff(plan, axis=0)).max(initial=0.0) / setup.sample_time
        simulation.too_fast = max(TOO_FAST, BEYOND_PLAN * float(planned))
    for first in range(0, len(plan), require_count("simulation", "block", block, 1)):
        part = simulation.part(plan[first : first + block], first)
        yield part
        if part.ending != "completed":
            return


class RobotStepper:
    """Tick-by-tick simulation of plant (`robot`, `data`, `step`), drives (`line`) and controller (`control`)."""

    def __init__(self, setup: RobotSetup, *, gain: float = 1.0, initial_speed: ArrayLike = 0.0):
        self._mujoco = library("mujoco", "MuJoCo")
        self.step: Callable[[Any, Any], None] = self._mujoco.mj_step
        substeps = substeps_for(setup) if setup.substeps is None else require_count("simulation", "substeps", setup.substeps, 1)
        require_positive("simulation", "encoder_step", setup.encoder_step, "rad", zero=True)
        self.setup = setup
        self.robot: MujocoRobot = build_mujoco(
            setup.body,
            setup.actuators,
            setup.q,
            setup.contacts,
            timestep=setup.sample_time / substeps,
            coulomb=setup.coulomb,
            gravity=setup.gravity,
            ground=setup.ground,
        )
        self.control = WholeBodyControl(
            setup.body,
            setup.actuators.motor_inertia,
            setup.contacts,
            setup.q,
            setup.control,
            setup.stack,
            gravity=setup.gravity,
            refresh=setup.refresh,
            gain=gain,
        )
        self.channels = self.control.channels
        start = self.control.holding_torque
        self.line = TorqueLine(setup.drives, setup.sample_time, substeps, setup.torque_limit)
        self.line.rest(start)
        self.data: Any = self.robot.new_data(setup.q, start)
        self.data.qvel[self.robot.motor_v] = require_finite("simulation", "initial_speed", initial_speed)
        self.too_fast = TOO_FAST
        self._size = setup.body.size
        self._upright = _upright(setup)

    def part(self, offsets: Floats, first: int) -> RobotRun:
        """Run over the ticks of `offsets` (k, m), numbered from `first`, or until the robot cannot go on."""
        rows, problem = [], None
        with mujoco_warnings(self._mujoco):  # about numbers that are too large: the run reports them itself
            for offset in offsets:
                rows.append(self.tick(offset))
                problem = self.problem()
                if problem is not None:
                    break
        run = self._run(first, [np.array(column) for column in zip(*rows, strict=True)])
        return run if problem is None else ended(run, problem[0], (first + len(rows)) * self.setup.sample_time, problem[1])

    def tick(self, offset: Floats) -> tuple[Floats, ...]:
        """Advance by one tick of the controller; returns the columns of `_run`."""
        data, robot, model = self.data, self.robot, self.robot.model
        positions = (robot.motor_position if self.setup.control.feedback.motor else robot.link_position)(data.qpos)
        target, reference, measured = self.control.tick(self.read(positions), offset)
        before = data.qpos.copy(), data.qvel.copy(), reference, measured, target, self.line.torque
        means = self.line.tick(target)
        step, inputs = self.step, data.ctrl
        for mean in means:
            inputs[: self._size] = mean
            step(model, data)
        return *before, self.line.demand

    def _run(self, first: int, columns: Sequence[Floats]) -> RobotRun:
        """Run record from tick `first` on, from the columns of `tick`, cut before the first value that is not finite."""
        finite = np.logical_and.reduce([np.isfinite(column).all(axis=1) for column in columns])
        count = len(finite) if finite.all() else int(np.argmin(finite))
        qpos, qvel, reference, measured, target, actual, demand = (column[:count] for column in columns)
        robot, setup = self.robot, self.setup
        motors, links = robot.motor_position(qpos), robot.link_position(qpos)
        return RobotRun(
            setup=setup,
            channels=self.channels,
            time=setup.sample_time * (first + np.arange(count)),
            reference=reference,
            measured=measured,
            motor_position=motors,
            link_position=links,
            motor_reading=self.read(motors),
            link_reading=self.read(links),
            target_torque=target,
            demand_torque=demand,
            actual_torque=actual,
            joint_torque=robot.joint_torque(qpos, qvel),
            base=qpos[:, [0, 1, 2, 4, 5, 6, 3]] if setup.body.base == "floating" else np.zeros((count, 0)),
            sample_time=setup.sample_time,
            feedback=setup.control.feedback.position,
            joint_names=setup.body.joint_names,
        )

    def read(self, positions: Floats) -> Floats:
        """Encoder readings, (n,) or (k, n) [rad]."""
        step = self.setup.encoder_step
        return np.rint(positions / step) * step if step else positions

    def problem(self) -> tuple[Ending, str] | None:
        """Ending and reason if the simulation cannot go on; None while it can."""
        data = self.data
        if not data.qvel @ data.qvel <= self.too_fast**2 and (found := self._runaway()) is not None:
            return found
        if self._upright is not None and not self._upright.holds(data.qpos[:7].tolist()):
            return "fell", "the robot fell"
        return None

    def _runaway(self) -> tuple[Ending, str] | None:
        """Ending "diverged" and its reason if a value is not finite or a motor too fast; otherwise None."""
        data, robot = self.data, self.robot
        if not np.isfinite(data.qvel).all():
            return "diverged", "the simulation diverged: its numbers are no longer finite"
        speeds = np.abs(data.qvel[robot.motor_v])
        worst = int(np.argmax(speeds))
        if speeds[worst] > self.too_fast:
            unit = "m/s" if is_prismatic(robot.body.joints[worst]) else "rad/s"
            name = robot.body.joint_names[worst]
            return "diverged", f"the simulation diverged: joint {name!r} moves faster than {self.too_fast:.3g} {unit}"
        return None


@dataclass(frozen=True)
class _Upright:
    """Initial pose of a floating base: height over the contacts, their height, and the vertical in its own axes."""

    height: float
    ground: float
    up: tuple[float, float, float]

    def holds(self, base: list[float]) -> bool:
        """True if the base, at position and quaternion w, x, y, z, is near its initial height and tilt."""
        _, _, z, qw, qx, qy, qz = base
        a, b, c = self.up
        vertical = 2 * (qx * qz - qy * qw) * a + 2 * (qy * qz + qx * qw) * b + (1 - 2 * (qx * qx + qy * qy)) * c
        return abs(z - self.ground - self.height) < FALLEN * self.height and vertical > math.cos(FALLEN)


def _upright(setup: RobotSetup) -> _Upright | None:
    """Initial pose of the base; None where nothing can fall: a fixed base, no contacts or no gravity."""
    if setup.body.base == "fixed" or not setup.contacts or not setup.gravity:
        return None
    ground = float(np.mean([setup.body.frame_placement(setup.q, contact.frame)[1][2] for contact in setup.contacts]))
    x, y, z, w = setup.q[3:7]
    up = (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y))
    return _Upright(float(setup.q[2]) - ground, ground, up)
