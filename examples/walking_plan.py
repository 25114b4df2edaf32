"""Two slow steps of gainroom's biped: weight to the left, right foot a step forward, weight to the right, left foot after it.

So slow that it is nearly static: the centre of mass is over the standing foot before the other lifts. Used by walking_run.py.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from gainroom.robot.body import RigidBody, put_position

STEP, LIFT = 0.06, 0.04
"""How far forward a foot is put, and how high it is lifted [m]."""
REST, SHIFT, ACROSS, SWING = 0.3, 1.5, 2.4, 1.4
"""Of standing, of moving the weight to a foot and from one to the other, and of a foot in the air [s]."""
UNSURE = 0.1
"""Within this time of lifting and landing the contact is None [s], so that the set for all states is reached before a foot lifts."""
KNOTS = 100
"""Per second."""


@dataclass(frozen=True)
class Plan:
    """One row per tick.

    time      (k,) [s]
    base      (k, 3) position of the pelvis, which stays upright [m]
    joints    (k, n) link positions [rad]
    holding   (k, n) joint torques that hold the weight, with the load that each foot carries [N m]
    contact   (k,) "double", "left", "right", or None where it is not sure
    phase     (k,) the same without None
    """

    time: np.ndarray
    base: np.ndarray
    joints: np.ndarray
    holding: np.ndarray
    contact: list
    phase: list

    def posture(self, body: RigidBody, row: int) -> np.ndarray:
        """(nq,)."""
        return posture(body, self.base[row], self.joints[row])


def posture(body: RigidBody, base: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(nq,) with an upright pelvis."""
    q = body.neutral()
    q[:3] = base
    for joint, angle in zip(body.joints, joints, strict=True):
        put_position(q, joint, angle)
    return q


def smooth(t: np.ndarray) -> np.ndarray:
    """From 0 to 1 while t goes from 0 to 1, without acceleration at the ends."""
    t = np.clip(t, 0, 1)
    return t**3 * (10 - 15 * t + 6 * t**2)


def two_steps(body: RigidBody, start: np.ndarray, sample_time: float, pace: float = 1.0) -> Plan:
    """The plan from posture `start` (nq,), both feet level; `pace`: how many times faster than usual it moves."""
    feet = np.array([body.frame_placement(start, f"{side}_sole")[1] for side in ("left", "right")])
    ends = np.cumsum([REST, *(time / pace for time in (SHIFT, SWING, ACROSS, SWING, SHIFT)), REST])
    knots = np.linspace(0, ends[-1], round(ends[-1] * KNOTS) + 1)
    part = [(knots - begin) / (end - begin) for begin, end in pairwise([0, *ends])]
    advance = {"right": smooth(part[2]), "left": smooth(part[4])}
    swing = {"right": part[2], "left": part[4]}
    placed = {}
    for side, foot in zip(("left", "right"), feet, strict=True):
        up = smooth(2 * swing[side]) - smooth(2 * swing[side] - 1)
        placed[side] = foot + STEP * np.outer(advance[side], [1, 0, 0]) + LIFT * np.outer(up, [0, 0, 1])
    # The weight goes from between the feet to the left one, to the right one where that has been put, and between them again.
    middle, left, right = feet.mean(axis=0), feet[0], feet[1] + [STEP, 0, 0]
    last = (right + feet[0] + [STEP, 0, 0]) / 2
    points = [middle, left, right, last]
    centre = middle + sum(np.outer(smooth(part[k]), after - before) for k, (before, after) in zip((1, 3, 5), pairwise(points), strict=True))
    share = (centre[:, 1] - feet[1, 1]) / (feet[0, 1] - feet[1, 1])
    base, joints, holding = _followed(body, start, placed, centre, np.clip(share, 0, 1))
    time = sample_time * np.arange(round(ends[-1] / sample_time))
    phase, contact = _contacts(time, ends)
    resampled = [CubicSpline(knots, one)(time) for one in (base, joints, holding)]
    return Plan(time, *resampled, contact=contact, phase=phase)


def _followed(body: RigidBody, start: np.ndarray, placed: dict, centre: np.ndarray, share: np.ndarray) -> tuple:
    """Pelvis, joints and holding torques at every knot; Newton on feet, centre of mass and the pelvis' height."""
    q, height, first = start.copy(), start[2], body.nv - body.size
    rows = []
    moving = [0, 1, 2, *range(first, body.nv)]  # the pelvis does not turn
    axes = {side: body.frame_placement(start, f"{side}_sole")[0] for side in placed}
    for k in range(len(centre)):
        for _ in range(6):
            error, jacobian = [centre[k, :2] - body.com(q)[:2], [height - q[2]]], [body.com_jacobian(q)[:2], np.eye(body.nv)[2:3]]
            for side, places in placed.items():
                rotation, place = body.frame_placement(q, f"{side}_sole")
                turn = rotation.T @ axes[side]
                turned = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
                error += [rotation.T @ (places[k] - place), turned]
                jacobian.append(body.frame_jacobian(q, f"{side}_sole"))
            step = np.zeros(body.nv)
            step[moving] = np.linalg.solve(np.vstack(jacobian)[:, moving], np.concatenate(error))
            q = body.integrate(q, step)
        weight = body.gravity_torque(q)
        torque = weight.copy()
        for side, part in (("left", share[k]), ("right", 1 - share[k])):
            foot = body.frame_jacobian(q, f"{side}_sole")
            torque -= part * foot.T @ np.linalg.solve(foot[:, :first].T, weight[:first])
        rows.append((q[:3].copy(), body.angles(q), torque[first:]))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def _contacts(time: np.ndarray, ends: np.ndarray) -> tuple[list, list]:
    """(phase, contact) at each tick."""
    phase = np.full(len(time), "double", dtype=object)
    phase[(time >= ends[1]) & (time < ends[2])] = "left"
    phase[(time >= ends[3]) & (time < ends[4])] = "right"
    contact = phase.copy()
    for moment in ends[1:5]:
        contact[np.abs(time - moment) < UNSURE] = None
    return phase.tolist(), contact.tolist()
