"""Body tree for the native core, which evaluates it at every tick of a controller, with its frames, contacts and tasks."""

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
"""Task kinds, in the order of the core's enumeration."""


class TreeRows(NamedTuple):
    """Tree as numeric arrays for the core's RigidTree; poses are (12,).

    joints    (n, 17) per joint: parent link (0: the base, k + 1: that of joint k), pose there, axis, and flags: 1 prismatic, 2 posture
              stored as cosine and sine
    masses    (n + 1, 13) of the base, then of each joint's link: mass, centre, inertia about it
    """

    floating: bool
    root: Floats
    joints: Floats
    masses: Floats
    gravity: Floats


def rigid_tree(body: RigidBody) -> RigidTree:
    """Core tree of a body without closed loops and passive joints (RigidBody.require_tree)."""
    return RigidTree(*tree_rows(body))


def tree_rows(body: RigidBody) -> TreeRows:
    """Numeric arrays of the tree of a body, see TreeRows."""
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
    """Link index and pose (13,) of a frame. Raises GainroomError for an unknown frame, and for one fixed in the world."""
    found = body.model.frames[body.frame_index(frame)]
    link = found.parentJoint - (body.model.njoints - body.size) + 1
    if link < 0:
        raise GainroomError(f"{body.source}: frame {frame!r} is fixed to the world; it must be on the robot")
    return np.array([link, *pose(found.placement)])


def held_frames(body: RigidBody, contacts: Sequence[Contact]) -> tuple[Floats, Floats]:
    """Contact frames (c, 13), and their held directions (c, 6) as nonzero entries. Raises GainroomError for an unknown frame."""
    frames = np.array([tree_frame(body, contact.frame) for contact in contacts]).reshape(-1, 13)
    return frames, np.array([np.isin(np.arange(6), contact.rows) for contact in contacts], dtype=float).reshape(-1, 6)


def tree_tasks(body: RigidBody, stack: Sequence[Task]) -> Floats:
    """Kind and frame of each task (k, 14). Raises GainroomError for an unknown frame."""
    frames = [np.zeros(13) if task.frame is None else tree_frame(body, task.frame) for task in stack]
    return np.array([[READINGS.index(task.kind), *frame] for task, frame in zip(stack, frames, strict=True)]).reshape(-1, 14)


def pose(placement: object) -> Floats:
    """Pose (12,) of a Pinocchio SE3: the rotation's rows, then the origin."""
    return np.concatenate([placement.rotation.ravel(), placement.translation])  # pyright: ignore[reportAttributeAccessIssue]
