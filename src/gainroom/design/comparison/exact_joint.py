"""Exactly sampled responses of one joint, at every place where a sensor may be: motor position, link position, spring torque.

The torque command goes through hold, delay and current loop; the load torque on the link is held over each tick. A controller of any
structure closes on these responses, u = −Σ K_i y_i, with one return ratio L = Σ K_i G_i at the motor torque.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...errors import GainroomError
from ...system.assembly import Parts, actuated_state
from ...system.linear.arrays import Complexes, Floats
from ...system.linear.state_space import StateSpace, hold
from ...system.measured_response import spring_torque

SENSORS = ("motor", "link", "torque")
"""Outputs of an ExactJoint: motor position [rad], link position [rad], spring torque [N m]."""
COMMAND, LOAD = 0, 1
"""Inputs of an ExactJoint: torque command [N m], load torque on the link [N m]."""


@dataclass(frozen=True)
class ExactJoint:
    """Sampled state space of one joint, in δ = (z − 1)/T_s: inputs COMMAND and LOAD, outputs SENSORS; delays are states.

    The spring torque is K (θ − q) + B (θ̇ − q̇). Of a rigid gearbox it is no state, and its output is NaN.
    """

    state_space: StateSpace
    sample_time: float

    @classmethod
    def of(cls, parts: Parts) -> "ExactJoint":
        """Responses of the joint of `parts`. Raises GainroomError for several joints, and for a loop in continuous time."""
        plant = parts.plant
        if plant.size != 1:
            raise GainroomError(f"a comparison is of one joint, not of {plant.size}")
        if parts.sample_time is None:
            raise GainroomError("control.sample_rate_hz is missing: structures are compared as they run, sampled")
        system = sensed_state(parts)
        return cls(hold(system, np.array([parts.delays[0], 0.0]), parts.sample_time), parts.sample_time)

    def at(self, omega: Floats) -> Complexes:
        """Responses (k, 3, 2) from inputs to outputs at omega [rad/s] (k,)."""
        return self.state_space.at(np.expm1(1j * omega * self.sample_time) / self.sample_time)


def sensed_state(parts: Parts) -> StateSpace:
    """Continuous state space of one joint from (torque into the current loop, load torque) to SENSORS, without delay."""
    plant, found = parts.plant, actuated_state(parts.plant, parts.drives)
    spring = spring_torque(plant, found) if math.isfinite(plant.stiffness[0]) else np.full((1, len(found.a)), np.nan)
    return StateSpace(found.a, found.b[:, [0, 2]], np.vstack([found.c[:2], spring]), np.zeros((3, 2)))
