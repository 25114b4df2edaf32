"""Robots with another controller in one joint, as far as a robot.yaml can hold it: the type, filters and rates are those of all joints."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...system.controller import PD, PID, Controller
from ...system.system import System
from .compared_joint import ComparedJoint


def robot_with(joint: ComparedJoint, alone: System) -> System | None:
    """Robot of `joint` with the controller of `alone` in that joint; None of a single joint, and where its controller cannot hold that.

    It can hold gains of a PD, and of a PID, without filters and at one rate, as each joint has its own gains.
    """
    own, system = alone.control.controller, joint.system
    every = system.control.controller
    if joint.is_single or alone.control.kd_path is not None or not _is_plain(own) or not _is_plain(every):
        return None
    size = len(system.drives)

    def gains(name: str) -> Any:
        values = np.broadcast_to(getattr(every, name, 0.0), size).astype(float)
        values[joint.index] = getattr(own, name, 0.0)
        return values

    kind = PID if PID in (type(own), type(every)) else PD
    controller = kind(**{name: gains(name) for name in kind.gain_names()})
    return replace(system, control=replace(system.control, controller=controller))


def _is_plain(controller: Controller) -> bool:
    """True for gains of a PD or PID per joint, without filters."""
    plain = type(controller) in (PD, PID) and not any(controller.filters.values())
    return plain and all(np.ndim(getattr(controller, name)) < 2 for name in controller.gain_names())
