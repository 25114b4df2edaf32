"""Torque that encoders command: the noise of a measured position through the closed sampled loop, and what one count makes.

An encoder that counts in steps q errs by ±q/2, from sample to sample as white noise of variance q²/12 where the position moves by more than
a count or so between samples (Widrow and Kollár 2008, Quantization Noise, chapter 1); at rest it errs less, or in a limit cycle. With D the
controller and P the held plant, both sampled, the noise n makes u = −D (1 + P D)⁻¹ n of the torque command, with a variance per joint of

    q²/12 · 1/2π ∫ |D/(1 + L)|² dθ = q²/12 (C X Cᵀ + D_0 D_0ᵀ),      X = A X Aᵀ + B Bᵀ,

A, B, C, D_0 a state space of the closed loop from n to u: exact, and no response has to be sampled.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from .assembly import controller_state
from .linear.arrays import Floats
from .linear.state_space import StateSpace, hold, realize
from .linear.transfer_function import Factored
from .loop import Loop
from .measured_response import measured_signals

MOST_DOUBLINGS, NOTHING = 60, 1e-14
"""Squarings of A: a mode that is left after 2^60 samples does not decay; size of a power of A after which the next ones add nothing."""


def torque_noise(loop: Loop) -> Floats:
    """Standard deviation (n,) of each joint's torque command [N m] from white noise of its sensors, in a stable sampled loop.

    Raises GainroomError without a sample time, where the resolution of an encoder or the noise of a torque sensor that gains measure is
    not known, and where kd closes on a path of its own.
    """
    noise = _noise(loop)
    a, b, c, d = _closed(loop)
    b, d = b * noise, d * noise
    state = _sum_of_powers(a, b @ b.T)
    if not np.isfinite(state).all():
        raise GainroomError("torque noise: the loop does not settle")
    return np.sqrt(np.maximum(np.diagonal(c @ state @ c.T) + (d**2).sum(axis=1), 0.0))


def torque_per_count(loop: Loop) -> Floats:
    """Torque (n,) [N m] that the controller of each joint commands at once when its encoder changes by one count; kp q + kd q/T_s for a PD.

    Where gains measure both sides of a joint: of the encoder whose count commands more. Raises GainroomError as `torque_noise`.
    """
    step, sent = _resolution(loop), _closed(loop)[3]
    if loop.sensed is not None and loop.sensed.feedback.torque:
        sent = sent[:, :-1]  # the last is the torque sensor
    return (np.abs(np.diagonal(sent)) if len(sent) == sent.shape[1] else np.abs(sent).max(axis=1)) * step


def _noise(loop: Loop) -> Floats:
    """Standard deviation of each sensor's noise, in the order of the inputs of `_closed`: encoders [rad], then the torque sensor [N m]."""
    found = _resolution(loop) / math.sqrt(12)
    if loop.sensed is None:
        return found
    assert loop.parts is not None
    found = np.tile(found, len(loop.sensed.feedback.sides))
    if not loop.sensed.feedback.torque:
        return found
    if (torque := loop.parts.drives[0].torque_noise) is None:
        raise GainroomError("torque noise: needs the noise of the torque sensor (drive.torque_noise)")
    return np.append(found, torque)


def _resolution(loop: Loop) -> Floats:
    """Step (n,) [rad] of each joint's encoder, on the joint side."""
    loop.require_one_path("the torque noise")
    if loop.sample_time is None:
        raise GainroomError("torque noise: needs a sample rate: the noise of an encoder is read once a tick")
    if loop.resolution is None:
        raise GainroomError("torque noise: needs the resolution of the encoders")
    return loop.resolution


def _closed(loop: Loop) -> tuple[Floats, Floats, Floats, Floats]:
    """State space in z from noise (n) on the measured positions to torque commands (n), all loops closed.

    Where gains of one joint measure several quantities, from the noise of each of its sensors: motor, link, spring torque.
    """
    time = loop.sample_time
    assert time is not None
    if loop.parts is not None:
        plant, size = measured_signals(loop.parts), loop.size
        controller = controller_state(loop.parts.controller, size, time)
        seen = np.vstack([np.eye(size), np.eye(size)]) if loop.sensed is None else loop.sensed.feedback.seen
    else:
        assert loop.actuated is not None
        assert loop.control is not None
        plant = _realized(loop.actuated, time)
        controller, seen = realize(loop.control), np.eye(1)
    c, d = loop.gain * controller.c, loop.gain * controller.d
    a = np.block([
        [plant.a - plant.b @ d @ plant.c, -plant.b @ c],
        [controller.b @ plant.c, controller.a],
    ])  # fmt: skip
    b = np.vstack([-plant.b @ d @ seen, controller.b @ seen])
    return np.eye(len(a)) + time * a, time * b, np.hstack([-d @ plant.c, -c]), -d @ seen


def _realized(actuated: Factored, time: float) -> StateSpace:
    """State space in v = (z − 1)/T_s of a sampled plant with its whole ticks of delay; cached, as a region of gains needs it at every gain.

    time   sample time [s]
    """
    known = vars(actuated)
    if "state_space" not in known:
        known["state_space"] = realize(actuated) @ hold(StateSpace.gain(np.eye(1)), np.array([actuated.delay]), time)
    return known["state_space"]


@dataclass(frozen=True)
class NoisePlane:
    """Torque noise of one joint at many gains of a plane, D = kp D_a + kd D_b: closed loops whose matrices are affine in the gains.

    plant        from torque command to measured position, in v = (z − 1)/T_s
    controller   from measured position to the outputs of D_a and D_b, in v; two rows
    """

    plant: StateSpace
    controller: StateSpace
    step: float
    time: float

    @classmethod
    def of(cls, actuated: Factored, first: Factored, second: Factored, step: float) -> "NoisePlane":
        """Plane of a sampled plant, D_a and D_b, for an encoder with this `step` [rad]."""
        time = actuated.sample_time
        assert time is not None
        split = StateSpace.gain(np.ones((2, 1)))
        return cls(_realized(actuated, time), realize(first.reduced).beside(realize(second.reduced)) @ split, step, time)

    def at(self, kps: Floats, kds: Floats) -> Floats:
        """Torque noise (m,) [N m] at gains kps and kds (m,); ∞ where the loop does not settle, as on the boundary of stability."""
        plant, own, count = self.plant, self.controller, len(kds)
        gains = np.stack([kps, kds], axis=1)[:, None]
        c, d = gains @ own.c, gains @ own.d  # (m, 1, states), (m, 1, 1)
        size, states = len(plant.a), len(plant.a) + len(own.a)
        a, b = np.zeros((count, states, states)), np.zeros((count, states, 1))
        a[:, :size, :size] = plant.a - plant.b @ d @ plant.c
        a[:, :size, size:] = -plant.b @ c
        a[:, size:, :size], a[:, size:, size:] = own.b @ plant.c, own.a
        b[:, :size], b[:, size:] = -plant.b @ d, own.b
        out = np.concatenate([d @ plant.c, c], axis=2)
        state = _sum_of_powers(np.eye(states) + self.time * a, self.time**2 * b @ b.swapaxes(1, 2))
        variance = (out @ state @ out.swapaxes(1, 2) + d**2)[:, 0, 0]
        variance = np.where(np.isfinite(variance), np.maximum(variance, 0.0), math.inf)
        return self.step / math.sqrt(12) * np.sqrt(variance)


def _sum_of_powers(a: Floats, q: Floats) -> Floats:
    """X = Σ Aᵏ Q (Aᵀ)ᵏ (…, m, m), by doubling (Smith 1968); not finite where it does not converge."""
    total = q
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(MOST_DOUBLINGS):
            total = total + a @ total @ a.swapaxes(-1, -2)
            a = a @ a
            if not np.any(np.abs(a) > NOTHING):  # nor of powers that overflow, which are not numbers at last
                break
    settled = np.abs(a).max(axis=(-2, -1), initial=0.0) <= NOTHING
    return np.where(settled[..., None, None], total, math.nan)
