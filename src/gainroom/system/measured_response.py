"""Response from torque command to measured position or torque: polynomials of one joint, eq. (2), and the state space of n joints."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import GainroomError
from .assembly import Parts, actuated_state, current_loop
from .controller import Controller, Terms
from .drive import Drive
from .feedback import Feedback, Sensor, Side
from .linear.arrays import Floats
from .linear.state_space import StateSpace, factored, hold, split_delay
from .linear.transfer_function import Factored, ratio, sample, total
from .plant import Plant

Quantity = Literal["position", "velocity"]


def measured_signals(parts: Parts) -> StateSpace:
    """State space from torque command (n) to the signals of `controller_state`, delays included.

    The first (n) are measured positions, the second (n) what velocity is made from: velocity in continuous time; in sampled time, exactly
    sampled, position again, which the controller differences. Each is of the side that its gains measure. The spring's torque follows
    where gains of one joint measure it, and in continuous time its rate.
    """
    first, second, step = parts.feedback.position, parts.feedback.velocity, parts.sample_time
    seen = _seen(parts, (first, "position"), (second, "velocity" if step is None else "position"))
    if parts.feedback.torque:
        spring = spring_signals(parts.plant, actuated_state(parts.plant, parts.drives, twists=True), step)
        seen = seen.stacked(spring.between(np.arange(1), np.arange(len(spring.c))))
    return seen if step is None else hold(seen, parts.delays, step)


def spring_signals(plant: Plant, state: StateSpace, step: float | None) -> StateSpace:
    """Torque K (θ − q) + B (θ̇ − q̇) of one joint's spring, and in continuous time its rate, as outputs of `state`, its actuated_state."""
    row = spring_torque(plant, state)
    torque = StateSpace(state.a, state.b, row, np.zeros((1, state.b.shape[1])))
    # behind an ideal current loop the spring's damping lets a torque act on the rate at once
    return torque if step is not None else torque.stacked(StateSpace(state.a, state.b, row @ state.a, row @ state.b))


def measured_state(parts: Parts, twists: bool = True) -> StateSpace:
    """State space from undelayed torque command (n) to measured position (n); `twists` as in Plant.mechanism."""
    parts.feedback.require_one("one measured position")
    return _seen(parts, (parts.feedback.position, "position"), twists=twists)


def _seen(parts: Parts, *signals: tuple[Side, Quantity], twists: bool = True) -> StateSpace:
    """State space from undelayed torque command (n) to signals (n each): of a side, its "position" or "velocity"."""
    size = parts.plant.size
    rows = [(2 * size if quantity == "velocity" else 0) + (size if side == "link" else 0) + np.arange(size) for side, quantity in signals]
    return actuated_state(parts.plant, parts.drives, twists).between(np.arange(size), np.concatenate(rows))


def spring_torque(plant: Plant, state: StateSpace) -> Floats:
    """Row (1, m) of the torque K (θ − q) + B (θ̇ − q̇) of one joint's elastic spring in the states of `state`, its actuated_state."""
    motor, link, motor_rate, link_rate = (state.c[k : k + 1] for k in range(4))
    return plant.stiffness[0] * (motor - link) + plant.damping[0] * (motor_rate - link_rate)


@dataclass(frozen=True)
class Sensed:
    """What the sensors of one joint see of a torque command, where gains measure several: responses over the same poles.

    responses   P C e^{−sT} of each quantity, behind a hold where it is sampled
    feedback    the quantity that each gain measures
    """

    responses: Mapping[Sensor, Factored]
    feedback: Feedback

    @classmethod
    def of(cls, parts: Parts) -> "Sensed":
        """Responses of the joint of `parts`."""
        step = parts.sample_time
        return cls({one: sampled_scalar(unsampled_scalar(parts, one), step) for one in parts.feedback.sensors}, parts.feedback)

    @property
    def sample_time(self) -> float | None:
        """Sample time [s]; None: continuous."""
        return self._any.sample_time

    @property
    def delay(self) -> float:
        """Delay [s] that all have."""
        return self._any.delay

    @property
    def _any(self) -> Factored:
        return next(iter(self.responses.values()))

    def closed_by(self, controller: Controller) -> Factored:
        """The one return ratio of `controller`: Σ P_i D_i over the quantities i."""
        laws: dict[Sensor, Factored] = {one: controller.law(one, self.feedback, self.sample_time) for one in self.responses}
        found = [self.responses[one] * law for one, law in laws.items() if law.gain]
        return total(found) if found else self._any * controller.combine({}, self.sample_time)

    def under(self, controller: Controller, terms: Terms) -> Factored:
        """The one return ratio of `terms` of gains on positions with the filters of `controller`: Σ P_i D_i over the sides i."""
        found = []
        for side in self.feedback.sides:
            own = self.feedback.of_side(side, terms)
            if any(np.any(gain) for gain in own.values()):
                found.append(self.responses[side] * controller.combine(own, self.sample_time))
        return total(found) if found else self._any * controller.combine({}, self.sample_time)


def unsampled_scalar(parts: Parts, sensor: Sensor | None = None) -> Factored:
    """Response P C e^{−sT} of one joint in continuous time, from the exact polynomials of eq. (2); `sensor` None: of all gains."""
    drive = parts.drives[0]
    return replace(_joint_transfer(parts.plant, sensor or parts.feedback.position) * current_loop(drive), delay=drive.delay)


def sampled_scalar(continuous: Factored, sample_time: float | None) -> Factored:
    """`continuous` with its delay behind a zero-order hold, sampled exactly; unchanged where `sample_time` is None."""
    if sample_time is None:
        return continuous
    ticks, fraction = split_delay(continuous.delay, sample_time)
    found = sample(continuous.reduced, sample_time, float(fraction))
    at_rest = np.zeros(len(continuous.poles) - len(continuous.reduced.poles), dtype=complex)
    zeros, poles = (np.append(at_rest, roots) if len(at_rest) else roots for roots in (found.zeros, found.poles))
    return replace(found, zeros=zeros, poles=poles, delay=float(ticks) * sample_time)  # whole ticks stay exact


def _joint_transfer(plant: Plant, side: Sensor) -> Factored:
    """Plant P_M, P_L or P_τ of one joint by eq. (2) with w = W, a form that holds for rigid joints (K = ∞) and locked outputs (w = 0)."""
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
        return ratio([1.0] if side == "motor" else [damping, stiffness], [motor, motor_viscous + damping, stiffness])
    gearbox, moved = [damping, stiffness], [1.0, link[1] + w * damping, link[2] + w * stiffness]
    denominator = np.convolve([motor, motor_viscous, 0.0], moved)
    denominator[1:] += np.convolve(gearbox, link)
    numerators: dict[Sensor, Floats] = {
        "motor": np.array(moved),
        "link": np.array([w * damping, w * stiffness]),
        "torque": np.convolve(gearbox, link),
    }
    return ratio(numerators[side], denominator)


def _resting_transfer(plant: Plant, side: Sensor) -> Factored:
    """Plant P_M or P_L of one joint whose links rest on springs, from its state space."""
    system = actuated_state(plant, (Drive(),)).between(np.arange(1), np.array([0 if side == "motor" else 1]))
    poles = np.linalg.eigvals(system.a)
    poles[np.abs(poles) < 1e-6 * np.abs(poles).max()] = 0.0  # a joint free to turn: its double integrator comes out to half the digits
    return factored(system, poles, None)
