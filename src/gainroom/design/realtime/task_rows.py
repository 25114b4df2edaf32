"""Jacobians of tasks from Pinocchio, where its mass matrix was computed last."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...robot.body import RigidBody, library
from ...robot.tasks import Task
from ...system.linear.arrays import Floats

LINEAR, ANGULAR = slice(0, 3), slice(3, 6)


class TaskRows:
    """Of a stack of tasks on one body, at every tick: as Task.jacobian, without its checks."""

    def __init__(self, body: RigidBody, stack: Sequence[Task]):
        self._pin, self._model, self._floating = library("pinocchio", "Pinocchio"), body.model, body.base == "floating"
        self._axes = self._pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        self._share = 1.0 / body.total_mass
        joints = np.eye(body.nv)[body.nv - body.size :]
        self._tasks = tuple(
            (-1, joints)
            if task.kind == "posture"
            else (-1, None)
            if task.frame is None
            else (body.frame_index(task.frame), LINEAR if task.kind == "position" else ANGULAR)
            for task in stack
        )

    def __call__(self, data: Any, q: Floats) -> list[Floats]:
        """(m_i, N) of each task; `data` has the mass matrix at `q`, by the convention of the world's axes."""
        pin, model, found = self._pin, self._model, []
        for frame, rows in self._tasks:
            if frame >= 0:
                found.append(pin.getFrameJacobian(model, data, frame, self._axes)[rows])
            elif rows is not None:
                found.append(rows)
            elif self._floating:
                found.append((self._share * data.oMi[1].rotation) @ data.M[LINEAR])  # the base feels the whole momentum
            else:
                found.append(pin.jacobianCenterOfMass(model, data, q).reshape(3, -1))
        return found
