"""A body's tree for the native core, which places it at every tick of a controller, and its frames there."""

import numpy as np

from ..native._core import RigidTree
from ..system.linear.arrays import Floats
from .body import RigidBody, is_continuous


def rigid_tree(body: RigidBody) -> RigidTree:
    """Of Pinocchio's model. Raises GainroomError for closed loops and passive joints."""
    body.require_tree("simulation")
    model, first = body.model, body.model.njoints - body.size  # the world, then a floating base, then the joints
    rows = []
    for index, joint in enumerate(body.joints, start=first):
        data = joint.createData()
        joint.calc(data, body.neutral())
        along, about = np.split(np.asarray(data.S).ravel(), 2)
        prismatic = bool(np.any(along))
        parent = max(0, model.parents[index] - first + 1)
        rows.append([parent, *pose(model.jointPlacements[index]), *(along if prismatic else about), prismatic + 2 * is_continuous(joint)])
    masses = [[link.mass, *link.lever] for link in model.inertias.tolist()[1:]]
    if body.base == "fixed":
        masses.insert(0, [0.0] * 4)
    root = pose(model.jointPlacements[first - 1])
    return RigidTree(body.base == "floating", root, np.array(rows).reshape(-1, 17), np.array(masses), np.array(model.gravity.linear))


def tree_frame(body: RigidBody, frame: str) -> Floats:
    """(13,) the link that a frame is on, and its pose there. Raises GainroomError for an unknown frame."""
    found = body.model.frames[body.frame_index(frame)]
    return np.array([max(0, found.parentJoint - (body.model.njoints - body.size) + 1), *pose(found.placement)])


def pose(placement: object) -> Floats:
    """(12,) of Pinocchio's SE3: the rotation's rows, then the origin."""
    return np.concatenate([placement.rotation.ravel(), placement.translation])  # pyright: ignore[reportAttributeAccessIssue]
