"""Values of a robot far outside what actuators have."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import first_of_many
from ..system.plausibility import SIDES, of_control, of_drive, of_limits, unusual

if TYPE_CHECKING:
    from .spec import RobotSpec


def unusual_robot(spec: "RobotSpec") -> tuple[str, ...]:
    """Warnings for the joints of a robot, those of the same quantity as one that names the joints.

    Of a prismatic joint, in kg and N, only drive and rate are looked at.
    """
    names, actuators = spec.robot.joint_names, spec.robot.actuators
    common = of_control(spec.control.joints, spec.control.sample_time) | of_limits(spec.requirements)
    shared = {key: value for key, value in common.items() if not np.ndim(value)}
    found: dict[str, list[tuple[str, str]]] = {}
    for k, (name, drive, prismatic) in enumerate(zip(names, spec.drives, spec.robot.body.prismatic, strict=True)):
        values: dict[str, float] = of_drive(drive) | shared
        if not prismatic:
            values |= {key: float(getattr(actuators, key)[k]) for key in ("motor_inertia", *SIDES)}
            values |= {key: _of_joint(gain, k, len(names)) for key, gain in common.items() if np.ndim(gain)}
        for quantity, text in unusual(values).items():
            found.setdefault(quantity, []).append((name, text))
    warnings = []
    for quantity, cases in found.items():
        owners = "" if quantity in shared else f"joint {first_of_many([repr(name) for name, _ in cases])}: "
        warnings.append(owners + cases[0][1])
    return tuple(warnings)


def _of_joint(gain: Any, joint: int, size: int) -> float:
    """Of gains per joint, or of their matrix."""
    return float(np.diagonal(gain)[joint] if np.ndim(gain) == 2 else np.broadcast_to(gain, size)[joint])
