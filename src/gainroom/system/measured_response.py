"""Response from torque command to measured position: polynomials of one joint, eq. (2), and the state space of n joints."""

from dataclasses import replace

import numpy as np

from ..errors import GainroomError
from .assembly import Feedback, Parts, actuated_state, current_loop
from .drive import Drive
from .linear.state_space import StateSpace, factored, hold, split_delay
from .linear.transfer_function import Factored, ratio, sample
from .plant import Plant


def measured_signals(parts: Parts) -> StateSpace:
    """State space from torque command (n) to measured positions and the signal that velocity is made from (2n), delays included.

    The second signal is velocity in continuous time; in sampled time, exactly sampled, it is position again, which the controller
    differences.
    """
    if parts.sample_time is None:
        return measured_state(parts, "position", "velocity")
    return hold(measured_state(parts, "position", "position"), parts.delays, parts.sample_time)


def measured_state(parts: Parts, *quantities: str, twists: bool = True) -> StateSpace:
    """State space from undelayed torque command (n) to measured "position" or "velocity" (n each); `twists` as in Plant.mechanism."""
    size = parts.plant.size
    first = {"position": 0, "velocity": 2 * size}
    side = 0 if parts.feedback == "motor" else size
    rows = [first[quantity] + side + np.arange(size) for quantity in quantities]
    return actuated_state(parts.plant, parts.drives, twists).between(np.arange(size), np.concatenate(rows))


def unsampled_scalar(parts: Parts) -> Factored:
    """Response P C e^{−sT} of one joint in continuous time, from the exact polynomials of eq. (2)."""
    drive = parts.drives[0]
    return replace(_joint_transfer(parts.plant, parts.feedback) * current_loop(drive), delay=drive.delay)


def sampled_scalar(continuous: Factored, sample_time: float | None) -> Factored:
    """`continuous` with its delay behind a zero-order hold, sampled exactly; unchanged where `sample_time` is None."""
    if sample_time is None:
        return continuous
    ticks, fraction = split_delay(continuous.delay, sample_time)
    return replace(sample(continuous, sample_time, float(fraction)), delay=float(ticks) * sample_time)  # whole ticks stay exact


def _joint_transfer(plant: Plant, feedback: Feedback) -> Factored:
    """Plant P_M or P_L of one joint by eq. (2) with w = W, a form that holds for rigid joints (K = ∞) and locked outputs (w = 0)."""
    if plant.compliance is not None:
        return _resting_transfer(plant, feedback)
    w, motor = plant.link_inverse_inertia[0, 0], plant.motor_inertia[0]
    stiffness, damping = plant.stiffness[0], plant.damping[0]
    motor_viscous, link_viscous = plant.motor_viscous[0], plant.link_viscous[0]
    gravity = 0.0 if plant.gravity_stiffness is None else plant.gravity_stiffness[0, 0]
    link = [1.0, w * link_viscous, w * gravity]  # s² q = w (τ_J − link_viscous s q − gravity q)
    if np.isinf(stiffness):
        return ratio([w], [1 + w * motor, w * (motor_viscous + link_viscous), w * gravity])
    if w == 0:  # output locked
        if feedback == "link":
            raise GainroomError("a joint with its output locked (link_inertia inf) cannot be fed back from the link side")
        return ratio([1.0], [motor, motor_viscous + damping, stiffness])
    gearbox, moved = [damping, stiffness], [1.0, link[1] + w * damping, link[2] + w * stiffness]
    denominator = np.convolve([motor, motor_viscous, 0.0], moved)
    denominator[1:] += np.convolve(gearbox, link)
    return ratio(moved if feedback == "motor" else [w * damping, w * stiffness], denominator)


def _resting_transfer(plant: Plant, feedback: Feedback) -> Factored:
    """Plant P_M or P_L of one joint whose links rest on springs, from its state space."""
    system = actuated_state(plant, (Drive(),)).between(np.arange(1), np.array([0 if feedback == "motor" else 1]))
    poles = np.linalg.eigvals(system.a)
    poles[np.abs(poles) < 1e-6 * np.abs(poles).max()] = 0.0  # a joint free to turn: its double integrator comes out to half the digits
    return factored(system, poles, None)
