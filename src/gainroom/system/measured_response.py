"""Response from torque command to measured position: polynomials of one joint, eq. (2), and the state space of n joints."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import GainroomError
from .assembly import Parts, actuated_state, current_loop
from .controller import Controller, Terms
from .drive import Drive
from .feedback import SIDES, Feedback, Side
from .linear.state_space import StateSpace, factored, hold, split_delay
from .linear.transfer_function import Factored, ratio, sample, total
from .plant import Plant

Quantity = Literal["position", "velocity"]


def measured_signals(parts: Parts) -> StateSpace:
    """State space from torque command (n) to measured positions and the signal that velocity is made from (2n), delays included.

    The second signal is velocity in continuous time; in sampled time, exactly sampled, it is position again, which the controller
    differences. Each is of the side that its gains measure.
    """
    first, second = parts.feedback.position, parts.feedback.velocity
    if parts.sample_time is None:
        return _seen(parts, (first, "position"), (second, "velocity"))
    return hold(_seen(parts, (first, "position"), (second, "position")), parts.delays, parts.sample_time)


def measured_state(parts: Parts, twists: bool = True) -> StateSpace:
    """State space from undelayed torque command (n) to measured position (n); `twists` as in Plant.mechanism."""
    parts.feedback.require_one("one measured position")
    return _seen(parts, (parts.feedback.position, "position"), twists=twists)


def _seen(parts: Parts, *signals: tuple[Side, Quantity], twists: bool = True) -> StateSpace:
    """State space from undelayed torque command (n) to signals (n each): of a side, its "position" or "velocity"."""
    size = parts.plant.size
    rows = [(2 * size if quantity == "velocity" else 0) + (size if side == "link" else 0) + np.arange(size) for side, quantity in signals]
    return actuated_state(parts.plant, parts.drives, twists).between(np.arange(size), np.concatenate(rows))


@dataclass(frozen=True)
class Sensed:
    """What the encoders of one joint see of a torque command, where gains measure both: responses over the same poles.

    sides      P C e^{−sT} of each side, behind a hold where it is sampled
    feedback   the side of each gain
    """

    sides: Mapping[Side, Factored]
    feedback: Feedback

    @classmethod
    def of(cls, parts: Parts) -> "Sensed":
        """Responses of the joint of `parts`."""
        every: dict[Side, Factored] = {side: sampled_scalar(unsampled_scalar(parts, side), parts.sample_time) for side in SIDES}
        return cls(every, parts.feedback)

    @property
    def sample_time(self) -> float | None:
        """Sample time [s]; None: continuous."""
        return self.sides["motor"].sample_time

    @property
    def delay(self) -> float:
        """Delay [s] that both have."""
        return self.sides["motor"].delay

    def under(self, controller: Controller, terms: Terms) -> Factored:
        """The one return ratio of `terms` of gains with the filters of `controller`: Σ P_i D_i over the sides i."""
        found = []
        for side in SIDES:
            own = {powers: gain if self.feedback.side_of(powers) == side else np.zeros(()) for powers, gain in terms.items()}
            if any(np.any(gain) for gain in own.values()):
                found.append(self.sides[side] * controller.combine(own, self.sample_time))
        return total(found) if found else self.sides["motor"] * controller.combine({}, self.sample_time)


def unsampled_scalar(parts: Parts, side: Side | None = None) -> Factored:
    """Response P C e^{−sT} of one joint in continuous time, from the exact polynomials of eq. (2); `side` None: of all gains."""
    drive = parts.drives[0]
    return replace(_joint_transfer(parts.plant, side or parts.feedback.position) * current_loop(drive), delay=drive.delay)


def sampled_scalar(continuous: Factored, sample_time: float | None) -> Factored:
    """`continuous` with its delay behind a zero-order hold, sampled exactly; unchanged where `sample_time` is None."""
    if sample_time is None:
        return continuous
    ticks, fraction = split_delay(continuous.delay, sample_time)
    return replace(sample(continuous, sample_time, float(fraction)), delay=float(ticks) * sample_time)  # whole ticks stay exact


def _joint_transfer(plant: Plant, side: Side) -> Factored:
    """Plant P_M or P_L of one joint by eq. (2) with w = W, a form that holds for rigid joints (K = ∞) and locked outputs (w = 0)."""
    if plant.compliance is not None:
        return _resting_transfer(plant, side)
    w, motor = plant.link_inverse_inertia[0, 0], plant.motor_inertia[0]
    stiffness, damping = plant.stiffness[0], plant.damping[0]
    motor_viscous, link_viscous = plant.motor_viscous[0], plant.link_viscous[0]
    gravity = 0.0 if plant.gravity_stiffness is None else plant.gravity_stiffness[0, 0]
    link = [1.0, w * link_viscous, w * gravity]  # s² q = w (τ_J − link_viscous s q − gravity q)
    if np.isinf(stiffness):
        return ratio([w], [1 + w * motor, w * (motor_viscous + link_viscous), w * gravity])
    if w == 0:  # output locked
        if side == "link":
            raise GainroomError("a joint with its output locked (link_inertia inf) cannot be fed back from the link side")
        return ratio([1.0], [motor, motor_viscous + damping, stiffness])
    gearbox, moved = [damping, stiffness], [1.0, link[1] + w * damping, link[2] + w * stiffness]
    denominator = np.convolve([motor, motor_viscous, 0.0], moved)
    denominator[1:] += np.convolve(gearbox, link)
    return ratio(moved if side == "motor" else [w * damping, w * stiffness], denominator)


def _resting_transfer(plant: Plant, side: Side) -> Factored:
    """Plant P_M or P_L of one joint whose links rest on springs, from its state space."""
    system = actuated_state(plant, (Drive(),)).between(np.arange(1), np.array([0 if side == "motor" else 1]))
    poles = np.linalg.eigvals(system.a)
    poles[np.abs(poles) < 1e-6 * np.abs(poles).max()] = 0.0  # a joint free to turn: its double integrator comes out to half the digits
    return factored(system, poles, None)
