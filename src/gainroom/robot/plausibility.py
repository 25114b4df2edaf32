"""Values of a robot far outside what actuators have."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import first_of_many
from ..system.drive import Drive
from ..system.plausibility import SIDES, of_control, of_drive, of_limits, unusual
from .actuators import Actuators

if TYPE_CHECKING:
    from ..system.requirements import Requirements


def unusual_robot(
    actuators: Actuators,
    names: Iterable[str],
    drives: Iterable[Drive],
    controller: Any,
    sample_time: float | None,
    requirements: "Requirements | None" = None,
    slides: Iterable[bool] = (),
) -> tuple[str, ...]:
    """Warnings for the joints of a robot, those of the same quantity as one that names the joints.

    slides   of each joint: of one that slides, in kg and N, only drive and rate are looked at
    """
    common = of_control(controller, sample_time) | of_limits(requirements)
    shared = {key: value for key, value in common.items() if not np.ndim(value)}
    found: dict[str, list[tuple[str, str]]] = {}
    sliding = list(slides)
    for k, (name, drive) in enumerate(zip(names, drives, strict=True)):
        values = {} if sliding and sliding[k] else {key: float(getattr(actuators, key)[k]) for key in ("motor_inertia", *SIDES)}
        own = {key: float(np.diagonal(gain)[k]) if np.ndim(gain) == 2 else float(np.broadcast_to(gain, len(actuators.stiffness))[k])
               for key, gain in common.items() if np.ndim(gain) and values}  # fmt: skip
        for quantity, text in unusual(values | of_drive(drive) | {**shared, **own}).items():
            found.setdefault(quantity, []).append((name, text))
    told = []
    for quantity, cases in found.items():
        owners = "" if quantity in shared else f"joint {first_of_many([repr(name) for name, _ in cases])}: "
        told.append(owners + cases[0][1])
    return tuple(told)
