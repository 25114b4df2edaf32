"""Setup of a simulated robot: links, actuators, drives, controller, ground, and step length."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_positive
from ..robot.actuators import Actuators
from ..robot.body import RigidBody, is_prismatic
from ..robot.contact import Contact
from ..robot.ground import Ground
from ..robot.linearize import linearize
from ..robot.tasks import Task
from ..system.drive import Drive
from ..system.linear.arrays import Floats
from ..system.system import Control, System
from .run_record import Unit
from .scenario import MOST_TICKS

LARGEST_STEP_ANGLE = 0.5
"""Largest phase of the plant's fastest vibration per step [rad]: it is then simulated 1 % too fast."""
MOST_SUBSTEPS = 64


@dataclass(frozen=True, kw_only=True)
class RobotSetup:
    """Simulated robot, without its references.

    q           (nq,) posture at the start
    contacts    frames on the ground
    ground      None: rigid contacts are fixed; otherwise feet may slip and lift
    coulomb     (n,) or one for all: Coulomb friction on the motor side [N m]
    torque_limit  (n,) or one for all: limit of the commands [N m]
    encoder_step  resolution of the encoders, joint side; 0: ideal [rad]
    gravity     False: no gravity, and none is compensated
    substeps    of MuJoCo per tick; None: as many as the fastest vibration needs
    refresh     ticks between new Jacobians and inertia in the controller
    """

    body: RigidBody
    actuators: Actuators
    drives: tuple[Drive, ...]
    control: Control
    q: Floats
    contacts: tuple[Contact, ...] = ()
    stack: tuple[Task, ...] = ()
    coulomb: ArrayLike = 0.0
    torque_limit: ArrayLike = math.inf
    encoder_step: float = 0.0
    gravity: bool = True
    ground: Ground | None = None
    substeps: int | None = None
    refresh: int = 40

    @property
    def sample_time(self) -> float:
        """Sample time of the controller [s]. Raises GainroomError if it is continuous."""
        if self.control.sample_time is None:
            raise GainroomError("control: the simulation runs a sampled controller; give sample_rate_hz")
        return self.control.sample_time


def robot_setup(system: System, posture: str | None = None, contact: str | None = None, **options: Any) -> RobotSetup:
    """Setup of one state of a robot.yaml; `options` are fields of RobotSetup."""
    model = system.source.linearize(posture, contact)
    return RobotSetup(
        body=model.body,
        actuators=system.source.actuators,
        drives=system.drives,
        control=system.control,
        q=model.q,
        contacts=model.contacts,
        stack=system.source.stack,
        **options,
    )


def hold(setup: RobotSetup, duration: float) -> Floats:
    """Offsets (k, m) of zero for `duration` [s]. Raises GainroomError for more than MOST_TICKS rows, over all channels together."""
    duration = require_positive("simulation", "duration", duration, "s")
    channels = len(channel_units(setup))
    longest = MOST_TICKS / channels * setup.sample_time
    if duration > longest:
        raise GainroomError(
            f"simulation: duration {duration:g} s must be at most {longest:g} s at a sample time of {setup.sample_time:g} s"
        )
    ticks = math.ceil(duration / setup.sample_time - 1e-9)
    return np.zeros((ticks, channels))


def channel_units(setup: RobotSetup) -> tuple[Unit, ...]:
    """Units (m,) of the channels, "rad" or "m"."""
    joints: tuple[Unit, ...] = tuple("m" if is_prismatic(joint) else "rad" for joint in setup.body.joints)
    if setup.control.space == "joint":
        return joints
    turned: tuple[Unit, ...] = ("rad", "rad", "rad")
    shifted: tuple[Unit, ...] = ("m", "m", "m")
    of_kind = {"posture": joints, "orientation": turned, "position": shifted, "com": shifted}
    return tuple(unit for task in setup.stack for unit in of_kind[task.kind])


def substeps_for(setup: RobotSetup) -> int:
    """Number of steps per tick that the fastest vibration of the linear model needs. Raises GainroomError if it exceeds MOST_SUBSTEPS."""
    poles = linearize(setup.body, setup.actuators, setup.q, setup.contacts).corners().poles
    fastest = np.abs(poles[poles.imag > 0]).max(initial=0.0)
    needed = max(1, math.ceil(fastest * setup.sample_time / LARGEST_STEP_ANGLE))
    if needed > MOST_SUBSTEPS:
        raise GainroomError(
            f"simulation: the fastest vibration, {fastest:.3g} rad/s, needs {needed} steps per tick, at most {MOST_SUBSTEPS} are taken: "
            "a stiff gearbox on a light link; make the joint rigid, or its stiffness fit its inertia"
        )
    return needed
