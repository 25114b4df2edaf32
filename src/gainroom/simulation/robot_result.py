"""What a simulated robot did, tick by tick."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Floats
from ..robot.body import put_position
from ..robot.tasks import Task
from .response import LAST, LOGGED, REFERENCE
from .robot_setup import RobotSetup
from .whole_body import values_of

Ending = Literal["completed", "fell", "diverged"]


@dataclass(frozen=True, eq=False)
class RobotRun:
    """One row per tick, k rows, all finite; of part of a run, or of all of it.

    channels        (m,) names: joints, or directions of the tasks
    time            (k,) [s]
    reference, measured   (k, m) what the controller wanted and saw
    target_torque, demand_torque, actual_torque   (k, n) what it asked for, what had arrived at the current loops, what they gave [N m]
    joint_torque    (k, n) through the gearboxes [N m]; NaN of rigid joints, where nothing measures it
    motor_position, link_position   (k, n) where the two sides are [rad]
    base            (k, 7) position [m] and quaternion x, y, z, w of a floating base; (k, 0) of a fixed one
    ending, reason  "completed" (or: goes on), or why and when it stopped by itself
    """

    setup: RobotSetup
    channels: tuple[str, ...]
    time: Floats
    reference: Floats
    measured: Floats
    target_torque: Floats
    demand_torque: Floats
    actual_torque: Floats
    joint_torque: Floats
    motor_position: Floats
    link_position: Floats
    base: Floats
    ending: Ending
    reason: str

    @property
    def error(self) -> Floats:
        """(k, m) reference less true position on the side that is fed back; of tasks, less what the controller makes of its encoders."""
        control = self.setup.control
        if control.space != "joint":
            return self.reference - self.measured
        return self.reference - (self.motor_position if control.feedback == "motor" else self.link_position)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(n,) the body's joints."""
        return self.setup.body.joint_names

    def columns(self) -> dict[str, Floats]:
        """What a log holds: `time` (k,), then `signals`, (k, n) each; positions as encoders on either side read them."""
        columns = {name: getattr(self, name) for name in ("time", *signals_of(self.setup.control.space))}
        step = self.setup.encoder_step
        if step:
            columns |= {name: np.round(columns[name] / step) * step for name in ("motor_position", "link_position")}
        return columns

    def rows(self, places: slice) -> "RobotRun":
        """Some of the ticks."""
        return replace(self, **{name: getattr(self, name)[places] for name in _ticking()})

    def steady_error(self, last: float | None = None) -> Floats:
        """(m,) mean error over the `last` seconds; None: the last tenth. Raises GainroomError for a run that did not last to its end."""
        if self.ending != "completed":
            raise GainroomError(f"simulation: no steady state: {self.reason}")
        rows = round(LAST * len(self.time)) if last is None else round(last / self.setup.sample_time)
        return self.error[-max(1, rows) :].mean(axis=0)

    def posture(self, row: int) -> Floats:
        """(nq,) of the links at one tick."""
        q = self.setup.body.neutral()
        q[: self.base.shape[1]] = self.base[row]
        for joint, position in zip(self.setup.body.joints, self.link_position[row], strict=True):
            put_position(q, joint, position)
        return q

    @cached_property
    def actual(self) -> Floats:
        """(k, m) the channels' values of the links themselves, which encoders before elastic gearboxes do not see."""
        return self.link_position if self.setup.control.space == "joint" else self._values(self.setup.stack)

    @cached_property
    def slip(self) -> Floats:
        """(k, c) how far each contact frame is from where it started [m]."""
        frames = [Task(name=contact.frame, kind="position", frame=contact.frame, kp=0.0, kd=0.0) for contact in self.setup.contacts]
        if not frames:
            return np.zeros((len(self.time), 0))
        start = np.concatenate([self.setup.body.frame_placement(self.setup.q, contact.frame)[1] for contact in self.setup.contacts])
        away = self._values(frames) - start
        return np.linalg.norm(away.reshape(len(self.time), len(frames), 3), axis=2)

    def _values(self, tasks: Sequence[Task]) -> Floats:
        values = values_of(self.setup.body, tasks, self.setup.q)
        return np.array([values(self.posture(row)) for row in range(len(self.time))])


def signals_of(space: str) -> tuple[str, ...]:
    """The signals of the log of control in `space`; the reference is in it where it is one of joints."""
    return tuple(name for name in LOGGED if name != REFERENCE or space == "joint")


def joined_runs(parts: Iterable[RobotRun]) -> RobotRun:
    """Parts of one run, one after the other. Raises GainroomError where there is none."""
    parts = list(parts)
    if not parts:
        raise GainroomError("a run needs at least one part")
    return replace(parts[-1], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _ticking()})


def _ticking() -> list[str]:
    """The fields with one row per tick."""
    return [field.name for field in fields(RobotRun) if field.name not in ("setup", "channels", "ending", "reason")]
