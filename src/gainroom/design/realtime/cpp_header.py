"""The C++17 header of a tracked robot: what native/include/gainroom/gain_tracker.hpp follows in a controller, as numbers.

Names that a robot's file gives appear in string constants alone, escaped as in c_header.py. Numbers have all their digits.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...robot.rigid_tree import READINGS, TreeRows
from ...robot.tasks import MOVABLE
from ...system.linear.arrays import Floats
from .c_header import require_identifier, string

TEMPLATE = """\
// A robot whose gain limits are tracked at every tick: GainTracker.to_header of gainroom wrote it, to be written anew and not edited.
//
//     const gainroom::TrackedRobot robot = NAME_robot();
//     gainroom::GainTracker tracker(robot);
//     if (!tracker.settle()) ...                                    // before the loop: the first limits are those of gain_limit
//     const gainroom::Limit limit = tracker.update(q, contact);     // at every tick
//
// Its headers are at gainroom.native.include_dir(); examples/posture_loop.cpp shows a control loop.
#pragma once

#include <limits>

#include "gainroom/gain_tracker.hpp"

static_assert(gainroom::kTrackedRobotFormat == 1, "another version of gainroom wrote this header: have it written anew");

static inline gainroom::TrackedRobot NAME_robot() {
    constexpr double infinite = std::numeric_limits<double>::infinity();
    (void)infinite;  // rigid joints and ideal current loops
    return {
VALUES
    };
}
"""
SPREAD, LONG = 2, 40
"""Lists in as many lists at most have a line for each value where one has more characters than this."""


class Tracked(NamedTuple):
    """A robot and its control, in the core's numbers; n joints, nq positions.

    joints     (n, 10) as JointData of joint_law.hpp
    tree       as robot/rigid_tree.py
    contacts   by name, of each state the frames (c, 13) and which directions are held (c, 6)
    sizes      directions of each task, in the order of `tasks` (k, 14); none in joint space
    gains      (2, m) K'p and K'v of the tasks' directions, (2, n) kp and kd in joint space
    rotors     whether the tasks' controller counts the motors' inertia

    sample_time is in s, 0: continuous control.
    """

    joint_names: Sequence[str]
    joints: Floats
    sample_time: float
    tree: TreeRows
    contacts: Mapping[str, tuple[Floats, Floats]]
    sizes: list[int]
    tasks: Floats
    gains: Floats
    rotors: bool


def tracked_header(
    name: str, about: Sequence[str], robot: Tracked, margin: float, limits: Sequence[tuple[str, bool, float]], posture: Floats
) -> str:
    """The header with a function `name`_robot.

    about     model, version and date
    margin    the gain margin that is asked for
    limits    of each contact state: its name, whether it is tracked, and its gain limit at `posture` (nq)

    Raises GainroomError where `name` is no identifier of C.
    """
    require_identifier("C++ header", name)
    model, version, date = about
    values = {
        "model": model,
        "version of gainroom": version,
        "date": date,
        "sample time [s]": robot.sample_time,
        "gain margin": margin,
        "joints": list(robot.joint_names),
        "JointData of each": robot.joints,
        "links": _tree(robot.tree),
        "gains of tasks": _stack(robot),
        "tasks": [[Code(f"gainroom::Reading::{CODES[int(row[0])]}"), _frame(row[1:])] for row in robot.tasks],
        "contact states": [[state, _held(*robot.contacts[state]), tracked, limit] for state, tracked, limit in limits],
        "first posture": posture,
    }
    lines = (f"        /* {what} */ {_text(value, 1)}," for what, value in values.items())
    parts = {"NAME": name, "VALUES": "\n".join(lines)}
    return re.sub("|".join(parts), lambda found: parts[found[0]], TEMPLATE)


class Code(str):
    """Text that goes into the header as C++ code; any other text becomes a string constant."""


CODES = [{"com": "center"}.get(kind, kind) for kind in READINGS]
"""Names of the core's enum Reading."""


def _tree(tree: TreeRows) -> list[Any]:
    joints = [[int(row[0]), _pose(row[1:13]), row[13:16], row[16] == 1, row[16] == 2] for row in tree.joints]
    return [tree.floating, _pose(tree.root), joints, [[row[0], row[1:4], [row[4:].reshape(3, 3)]] for row in tree.masses], tree.gravity]


def _stack(robot: Tracked) -> list[Any]:
    kp, kd = robot.gains if len(robot.sizes) else np.empty((2, 0))
    return [[int(size) for size in robot.sizes], kp, kd, robot.rotors, MOVABLE]


def _held(frames: Floats, held: Floats) -> list[Any]:
    return [[_frame(frame), [bool(one) for one in rows]] for frame, rows in zip(frames, held, strict=True)]


def _frame(row: Floats) -> list[Any]:
    return [int(row[0]), _pose(row[1:])]


def _pose(row: Floats) -> list[Any]:
    return [[row[:9].reshape(3, 3)], row[9:]]


def _text(value: Any, depth: int) -> str:
    """`value` in C++; `depth`: in how many lists it is."""
    if isinstance(value, Code):
        return value
    if isinstance(value, str):
        return string(value)
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float):
        return repr(float(value)).replace("inf", "infinite")
    inner = [_text(one, depth + 1) for one in value]
    if depth <= SPREAD and any(len(one) > LONG for one in inner):
        blank = "\n" + "    " * (depth + 2)
        return "{" + blank + ("," + blank).join(inner) + "}"
    return "{" + ", ".join(inner) + "}"
