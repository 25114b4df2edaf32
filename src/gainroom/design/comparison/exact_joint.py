"""Exactly sampled responses of one joint, at every place where a sensor may be: motor position, link position, spring torque.

The torque command goes through hold, delay and current loop; the load torque on the link is held over each tick. A controller of any
structure closes on these responses, u = −Σ K_i y_i, with one return ratio L = Σ K_i G_i at the motor torque. Of a robot, the other joints'
loops are closed by the laws of `parts`, so that G is what is left for this joint's controller; a single joint has no others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import GainroomError
from ...system.assembly import Parts, actuated_state, controller_state
from ...system.linear.arrays import Complexes, Floats
from ...system.linear.state_space import StateSpace, hold

SENSORS = ("motor", "link", "torque")
"""Outputs of an ExactJoint: motor position [rad], link position [rad], spring torque [N m]."""
COMMAND, LOAD = 0, 1
"""Inputs of an ExactJoint: torque command [N m], load torque on the link [N m]."""
OWN = 2
"""Inputs of sensed_state per joint that belong to the joints themselves."""


@dataclass(frozen=True)
class ExactJoint:
    """Sampled state space of one joint, in δ = (z − 1)/T_s: inputs COMMAND and LOAD, outputs SENSORS; delays are states.

    The spring torque is K (θ − q) + B (θ̇ − q̇). Of a rigid gearbox it is no state, and its output is NaN.

    held    kp [N m/rad] and kd [N m s/rad] of a PD on the position that is measured, which is known to stabilise it; None: none is known
    """

    state_space: StateSpace
    sample_time: float
    held: tuple[float, float] | None = None

    @classmethod
    def of(cls, parts: Parts, joint: int = 0, held: tuple[float, float] | None = None) -> "ExactJoint":
        """Responses of a joint of `parts`, by its index. Raises GainroomError for a loop in continuous time."""
        if parts.sample_time is None:
            raise GainroomError("control.sample_rate_hz is missing: structures are compared as they run, sampled")
        return cls(sampled_state(parts, [joint], parts.delays[[joint]]), parts.sample_time, held)

    def at(self, omega: Floats) -> Complexes:
        """Responses (k, 3, 2) from inputs to outputs at omega [rad/s] (k,)."""
        return self.state_space.at(np.expm1(1j * omega * self.sample_time) / self.sample_time)


def others_of(parts: Parts, joints: Sequence[int]) -> list[int]:
    """Indices of the joints beside `joints`, whose loops are closed."""
    return [k for k in range(parts.plant.size) if k not in joints]


def sensed_state(parts: Parts, joints: Sequence[int] = (0,)) -> StateSpace:
    """Continuous state space about some joints (n), without delay, all loops open.

    Inputs: torques (n) into their current loops, load torques (n) on their links, then torques into the current loops of others_of.
    Outputs: SENSORS, (n) each, then the positions of all joints that the laws measure; without others these are left out.
    """
    plant, found = parts.plant, actuated_state(parts.plant, parts.drives)
    size, own, others = plant.size, list(joints), others_of(parts, joints)
    motor, link, motor_rate, link_rate = (found.c[[k * size + joint for joint in own]] for k in range(4))
    stiffness, damping = (one[own, None] for one in (plant.stiffness, plant.damping))
    springs = np.full_like(motor, np.nan)
    with np.errstate(invalid="ignore"):
        np.copyto(springs, stiffness * (motor - link) + damping * (motor_rate - link_rate), where=np.isfinite(stiffness))
    rows = [motor, link, springs]
    if others:
        side = size if parts.feedback.position == "link" else 0
        rows.append(found.c[side : side + size])
    b, c = found.b[:, [*own, *(2 * size + joint for joint in own), *others]], np.vstack(rows)
    return StateSpace(found.a, b, c, np.zeros((len(c), b.shape[1])))


def sampled_state(parts: Parts, joints: Sequence[int], delays: Floats) -> StateSpace:
    """Sampled state space in δ from COMMAND of `joints`, `delays` (n,) [s] late, and LOAD to SENSORS, the loops of all others closed."""
    assert parts.sample_time is not None
    count, others, step = len(joints), others_of(parts, joints), parts.sample_time
    held = hold(sensed_state(parts, joints), np.concatenate([delays, np.zeros(count), parts.delays[others]]), step)
    if not others:
        return held
    size, own, sensors = parts.plant.size, OWN * count, len(SENSORS) * count
    law = controller_state(parts.controller, size, step)
    # Position gains and velocity's difference act on one measured position (n); only the outputs of the others close.
    heard, through = law.b[:, :size] + law.b[:, size:], (law.d[:, :size] + law.d[:, size:])[others]
    seen, pushed = held.c[sensors:], held.b[:, own:]
    a = np.block([[held.a - pushed @ through @ seen, -pushed @ law.c[others]], [heard @ seen, law.a]])
    b = np.vstack([held.b[:, :own], np.zeros((len(law.a), own))])
    c = np.hstack([held.c[:sensors], np.zeros((sensors, len(law.a)))])
    return StateSpace(a, b, c, np.zeros((sensors, own)))
