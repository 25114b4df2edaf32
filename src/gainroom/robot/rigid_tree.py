"""A body's tree for the native core, which places it at every tick of a controller; its frames, contacts and tasks there."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import GainroomError
from ..native._core import RigidTree
from ..system.linear.arrays import Floats
from .body import RigidBody, is_continuous
from .contact import Contact
from .tasks import Task, TaskKind

READINGS: tuple[TaskKind, ...] = ("com", "posture", "position", "orientation")
"""In the order of the core's numbers."""


class TreeRows(NamedTuple):
    """A tree in numbers, as the core's RigidTree takes them; poses are (12,).

    joints    (n, 17) of each the link that it is on (0: the base, k + 1: what joint k moves), its pose there, its axis, and 1 where it
              is prismatic, 2 where its posture is cosine and sine
    masses    (n + 1, 13) of the base, then of what each joint moves: mass, centre, inertia about it
    """

    floating: bool
    root: Floats
    joints: Floats
    masses: Floats
    gravity: Floats


def rigid_tree(body: RigidBody) -> RigidTree:
    """Of Pinocchio's model of a body without closed loops and passive joints (RigidBody.require_tree)."""
    return RigidTree(*tree_rows(body))


def tree_rows(body: RigidBody) -> TreeRows:
    """The same in numbers."""
    model, first = body.model, body.model.njoints - body.size  # the world, then a floating base, then the joints
    rows = []
    for index, joint in enumerate(body.joints, start=first):
        data = joint.createData()
        joint.calc(data, body.neutral())
        along, about = np.split(np.asarray(data.S).ravel(), 2)
        prismatic = bool(np.any(along))
        parent = max(0, model.parents[index] - first + 1)
        rows.append([parent, *pose(model.jointPlacements[index]), *(along if prismatic else about), prismatic + 2 * is_continuous(joint)])
    masses = [[link.mass, *link.lever, *link.inertia.ravel()] for link in model.inertias.tolist()[1:]]
    if body.base == "fixed":
        masses.insert(0, [0.0] * 13)
    root = pose(model.jointPlacements[first - 1])
    return TreeRows(body.base == "floating", root, np.array(rows).reshape(-1, 17), np.array(masses), np.array(model.gravity.linear))


def tree_frame(body: RigidBody, frame: str) -> Floats:
    """(13,) the link that a frame is on, and its pose there. Raises GainroomError for an unknown one, and one of the world."""
    found = body.model.frames[body.frame_index(frame)]
    link = found.parentJoint - (body.model.njoints - body.size) + 1
    if link < 0:
        raise GainroomError(f"{body.source}: frame {frame!r} is fixed to the world; it must be on the robot")
    return np.array([link, *pose(found.placement)])


def held_frames(body: RigidBody, contacts: Sequence[Contact]) -> tuple[Floats, Floats]:
    """(c, 13) frames, (c, 6) which directions of their twists are held, not 0. Raises GainroomError for an unknown frame."""
    frames = np.array([tree_frame(body, contact.frame) for contact in contacts]).reshape(-1, 13)
    return frames, np.array([np.isin(np.arange(6), contact.rows) for contact in contacts], dtype=float).reshape(-1, 6)


def tree_tasks(body: RigidBody, stack: Sequence[Task]) -> Floats:
    """(k, 14) kind and frame of each task. Raises GainroomError for an unknown frame."""
    frames = [np.zeros(13) if task.frame is None else tree_frame(body, task.frame) for task in stack]
    return np.array([[READINGS.index(task.kind), *frame] for task, frame in zip(stack, frames, strict=True)]).reshape(-1, 14)


def pose(placement: object) -> Floats:
    """(12,) of Pinocchio's SE3: the rotation's rows, then the origin."""
    return np.concatenate([placement.rotation.ravel(), placement.translation])  # pyright: ignore[reportAttributeAccessIssue]
