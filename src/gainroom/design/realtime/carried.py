"""What the tracker carries, and what it refuses before the first tick."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import GainroomError
from ...system.controller import PD
from ...system.linear.arrays import Floats
from ...system.system import System

if TYPE_CHECKING:
    from ...robot.robot import Robot


def joint_table(robot: "Robot", system: System) -> Floats:
    """(n, 10) as JointData of joint_law.hpp: inertia, friction, gearbox, drive and gains of each joint."""
    actuators, drives, pd = robot.actuators, system.drives, system.control.controller
    size = len(drives)
    columns = (
        actuators.motor_inertia,
        actuators.motor_viscous,
        actuators.link_viscous,
        actuators.stiffness,
        np.where(np.isfinite(actuators.stiffness), actuators.damping, 0.0),
        [drive.bandwidth for drive in drives],
        [drive.damping_ratio for drive in drives],
        [drive.delay for drive in drives],
        np.broadcast_to(pd.kp, size),
        np.broadcast_to(pd.kd, size),
    )
    return np.ascontiguousarray(np.column_stack([np.asarray(column, dtype=float) for column in columns]))


def require_carried(robot: "Robot", system: System, contacts: Sequence[str]) -> None:
    """Raise GainroomError, one line, for what the tracker does not carry."""
    control, actuators = system.control, robot.actuators
    pd = control.controller
    elastic = np.isfinite(actuators.stiffness)
    soft = [name for name in contacts if any(contact.stiffness is not None for contact in robot.contacts[name])]
    refused = {
        "control in task space": pd is None,
        "a controller other than PD": pd is not None and not isinstance(pd, PD),
        "encoders on the link's side": control.feedback != "motor",
        "gravity stiffness": bool(robot.gravity),
        "springs of the joints' own": bool(robot.body.springs),
        f"springs under contact {', '.join(map(repr, soft))}": bool(soft),
        "elastic joints without damping": bool(np.any(elastic & (actuators.damping == 0))),
        "joints without motor inertia": bool(np.any(actuators.motor_inertia == 0)),
        "rigid among elastic joints under sampled control": bool(control.sample_time and elastic.any() and not elastic.all()),
    }
    if isinstance(pd, PD):
        refused["filters"] = pd.velocity_filter is not None or bool(pd.notches)
        refused["gain matrices"] = np.ndim(pd.kp) > 1 or np.ndim(pd.kd) > 1
    for what, there in refused.items():
        if there:
            raise GainroomError(f"gain tracker: {what} cannot be tracked; ask gain_limit posture by posture")
    require_lead(robot, system)


def require_lead(robot: "Robot", system: System) -> None:
    """Raise GainroomError where some joint's control does not take energy out at low frequency: kd over kp is less than all that lags."""
    control = system.control
    size = len(system.drives)
    gains = zip(np.broadcast_to(control.controller.kp, size), np.broadcast_to(control.controller.kd, size), strict=True)
    for name, drive, (kp, kd) in zip(robot.joint_names, system.drives, gains, strict=True):
        if kp < 0 or kd < 0 or kp == kd == 0:
            raise GainroomError(f"gain tracker: joint {name!r}: kp {kp:g} and kd {kd:g} must be >= 0, and not both 0")
        step = control.sample_time or 0.0
        lag = drive.delay + (0.0 if drive.is_ideal else 2 * drive.damping_ratio / drive.bandwidth) + step
        if not lag:
            raise GainroomError(f"gain tracker: joint {name!r}: without delay, current loop and sampling there is no limit to track")
        if kd <= kp * lag:
            raise GainroomError(f"gain tracker: joint {name!r}: kd/kp {kd / kp:.3g} s must be more than the loop's lag of {lag:.3g} s")
