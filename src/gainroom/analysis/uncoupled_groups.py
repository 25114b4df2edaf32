"""Uncoupled groups of joints of a loop, such as limbs on a fixed base: each has a loop of its own, and a vibration is of one group."""

from dataclasses import replace

import numpy as np

from ..system.controller import PD
from ..system.linear.apart import parts_of
from ..system.linear.arrays import Integers
from ..system.loop import Loop, build_loop
from ..system.plant import Plant


def uncoupled_groups(loop: Loop) -> list[tuple[Integers, Loop]]:
    """Indices (g,) of the joints, rising, and the loop of each group of joints that W and gravity do not couple to others.

    [] if all joints are one group, and if the gains are not one kp and kd per joint of a PD on one path.
    """
    parts = loop.parts
    if parts is None or type(parts.controller) is not PD or parts.kd_path is not None or parts.plant.compliance is not None:
        return []
    if np.ndim(parts.controller.kp) > 1 or np.ndim(parts.controller.kd) > 1:
        return []
    gravity = parts.plant.gravity_stiffness
    coupled = (parts.plant.link_inverse_inertia != 0) | (np.zeros(()) if gravity is None else gravity).astype(bool)
    groups = [joints for alike in parts_of(coupled) for joints in alike]
    return [(joints, _alone(loop, joints)) for joints in groups] if len(groups) > 1 else []


def _alone(loop: Loop, joints: Integers) -> Loop:
    """Loop of `joints` (g,) alone, which no other joint acts on."""
    assert loop.parts is not None
    parts, square, controller = loop.parts, np.ix_(joints, joints), loop.parts.controller
    assert isinstance(controller, PD)
    whole = parts.plant
    plant = Plant(
        whole.link_inverse_inertia[square],
        whole.motor_inertia[joints],
        whole.stiffness[joints],
        whole.damping[joints],
        whole.motor_viscous[joints],
        whole.link_viscous[joints],
        None if whole.gravity_stiffness is None else whole.gravity_stiffness[square],
        joint_names=tuple(whole.joint_names[k] for k in joints),
    )
    kp, kd = (np.broadcast_to(gain, loop.size)[joints] for gain in (controller.kp, controller.kd))
    if len(joints) == 1:
        kp, kd = float(kp[0]), float(kd[0])
    own = replace(controller, kp=kp, kd=kd)
    return build_loop(plant, [parts.drives[k] for k in joints], own, parts.feedback, parts.sample_time).scaled(loop.gain)
