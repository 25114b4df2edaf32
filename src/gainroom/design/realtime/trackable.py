"""Robots that the gain tracker can follow: their data as the core's arrays, and refusals of all others before the first tick."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import GainroomError
from ...robot.tasks import Tasks
from ...system.controller import PD
from ...system.linear.arrays import Floats
from ...system.system import System

if TYPE_CHECKING:
    from ...robot.robot import Robot


def joint_table(robot: "Robot", system: System) -> Floats:
    """Data of n joints (n, 10) as JointData of joint_law.hpp: inertia, friction, gearbox, drive and gains."""
    actuators, drives = robot.actuators, system.drives
    size = len(drives)
    kp, kd = (0.0, 0.0) if system.control.space == "task" else joint_gains(system)  # tasks bring theirs
    columns = (
        actuators.motor_inertia,
        actuators.motor_viscous,
        actuators.link_viscous,
        actuators.stiffness,
        np.where(np.isfinite(actuators.stiffness), actuators.damping, 0.0),
        [drive.bandwidth for drive in drives],
        [drive.damping_ratio for drive in drives],
        [drive.delay for drive in drives],
        np.broadcast_to(kp, size),
        np.broadcast_to(kd, size),
    )
    return np.ascontiguousarray(np.column_stack([np.asarray(column, dtype=float) for column in columns]))


def joint_gains(system: System) -> tuple[Floats, Floats]:
    """Gains kp (n,) [N m/rad] and kd (n,) [N m s/rad] of a PD. Raises GainroomError for gain matrices."""
    pd, size = system.control.controller, len(system.drives)
    for name, gains in (("kp", pd.kp), ("kd", pd.kd)):
        if np.shape(gains) not in ((), (1,), (size,)):
            raise GainroomError(f"gain tracker: {name} of shape {np.shape(gains)} must be one number, or one for each of {size} joints")
    return np.broadcast_to(pd.kp, size).astype(float), np.broadcast_to(pd.kd, size).astype(float)


def require_trackable(robot: "Robot", system: System, contacts: Sequence[str]) -> None:
    """Raises GainroomError that names the first property of robot or control that the tracker cannot follow."""
    control, actuators = system.control, robot.actuators
    pd, tasks = control.controller, control.space == "task"
    elastic = np.isfinite(actuators.stiffness)
    soft = [name for name in contacts if any(contact.stiffness is not None for contact in robot.contacts[name])]
    refused = {
        "a controller other than PD": not (tasks or isinstance(pd, PD)),
        "tasks with P/PI": tasks and any(task.ki is not None for task in robot.stack),
        "filters": tasks and any(control.filters.values()),
        "a path of its own for kd": control.kd_path is not None,
        "encoders on the link's side": not control.feedback.motor,
        "gravity stiffness": bool(robot.gravity),
        "springs of the joints' own": any(robot.body.springs.values()),
        f"springs under contact {', '.join(map(repr, soft))}": bool(soft),
        "elastic joints without damping": bool(np.any(elastic & (actuators.damping == 0))),
        "joints without motor inertia": bool(np.any(actuators.motor_inertia == 0)),
        "rigid among elastic joints under sampled control": bool(control.sample_time and elastic.any() and not elastic.all()),
    }
    if isinstance(pd, PD) and not tasks:
        refused["filters"] = any(pd.filters.values())
        refused["gain matrices"] = np.ndim(pd.kp) > 1 or np.ndim(pd.kd) > 1
    for what, there in refused.items():
        if there:
            raise GainroomError(f"gain tracker: {what} cannot be tracked; ask gain_limit posture by posture")


def require_lead(owner: str, kp: float, kd: float, lag: float) -> None:
    """Raises GainroomError where kd/kp [s] is at most the loop's `lag` [s]: at low frequency the control then puts energy into the joint.

    Also raises it for negative gains, for kp = kd = 0, and without any lag, where there is no limit to follow.
    """
    if kp < 0 or kd < 0 or kp == kd == 0:
        raise GainroomError(f"gain tracker: {owner}: kp {kp:g} and kd {kd:g} must be >= 0, and not both 0")
    if not lag:
        raise GainroomError(f"gain tracker: {owner}: without delay, current loop and sampling there is no limit to track")
    if kd <= kp * lag:
        raise GainroomError(f"gain tracker: {owner}: kd/kp {kd / kp:.3g} s must be more than the loop's lag of {lag:.3g} s")


def require_leads(robot: "Robot", system: System, tasks: Tasks | None) -> None:
    """Raises GainroomError as require_lead does, for every joint, or for every direction of `tasks` with the lag of the slowest drive."""
    step = system.control.sample_time or 0.0
    lags = [drive.delay + (0.0 if drive.is_ideal else 2 * drive.damping_ratio / drive.bandwidth) + step for drive in system.drives]
    if tasks is None:
        for name, kp, kd, lag in zip(robot.joint_names, *joint_gains(system), lags, strict=True):
            require_lead(f"joint {name!r}", kp, kd, lag)
    else:
        for name, kp, kd in zip(tasks.directions, tasks.kp, tasks.kd, strict=True):
            require_lead(f"task direction {name!r}", kp, kd, max(lags))
