"""Directions of motion of the two sides of a joint, tick by tick, from measured positions, for laws of friction."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Complexes, Floats, Integers

TURNING = 0.15  # of the root mean square velocity: slower, a side turns round, and no law of friction is to be trusted
AFTER = 3.0  # radians of the resonance that a predictor takes to find back
PASSED = 4.0  # times the resonance: faster motion is the encoder's noise
SLOW = 0.3  # times the antiresonance: about it the fit itself tells how the link moves, and would confirm whatever weight it began with
LEAST_DAMPING = 0.02  # of critical, when the link's motion is reckoned from the motor's: noise at the antiresonance is not to ring on
STRIBECK = 0.3  # of Coulomb friction: another law that friction may have
STRIBECK_VELOCITIES = 0.2, 1.0  # times the velocity's deviation, up to which it may be larger
NO_WEIGHT = np.zeros(2)
PADDING = 4096  # rows over which a signal returns to its start


@dataclass(frozen=True)
class Motion:
    """Motion that friction depends on.

    along     (m, 5) over each tick: which way motor and link move, −1 to 1, the motor's velocity [rad/s], sine and cosine of the link's
              angle, without fast motion where that is reckoned from the motor's
    turning   (m,) 1 while motor or link is about to turn round or has just done so, else 0
    angle     (m,) of the link [rad], fast motion with it
    slow      (m,) the same without fast motion where that is reckoned from the motor's
    swinging  spring that the weight is in what is not in `slow`, at the mean angle [N m/rad]
    """

    along: Floats
    turning: Integers
    angle: Floats
    slow: Floats
    swinging: float = 0.0

    @property
    def speed(self) -> float:
        """Root mean square of the motor's velocity [rad/s]."""
        return float(np.sqrt(np.mean(self.along[:, 2] ** 2)))


def motion_of(
    positions: Floats, linked: bool, sample_time: float, joint: ElasticJoint, cautious: float = 0.0, weight: Floats = NO_WEIGHT
) -> Motion:
    """Motion from the motor's position, and if `linked` the link's in the second column (m, o) [rad]; `joint` is roughly right.

    cautious   above 0 under another law: friction that is larger near rest, up to so many times the velocity's deviation, and a wider range
               of velocities that counts as turning round
    weight     (2,) torques along sine and cosine of the link's angle [N m], roughly right; it bends the gearbox by a share of its stiffness
    """
    resonance = joint.resonance if math.isfinite(joint.resonance) else 0.2 / sample_time
    count = len(positions)
    omega, filtered = _filter(count, sample_time)
    smooth = 1 / (1 + (omega / (PASSED * resonance)) ** 4)
    raw = np.diff(positions[:, 0], append=positions[-1, 0]) / sample_time
    motor = filtered(raw, smooth)
    # The noise that passes the filter, if it is white, from what does not.
    share = min(PASSED * resonance * sample_time / math.pi, 1.0)
    least = max(2 * float(np.std(raw - motor)) * math.sqrt(share), 1e-12)
    angle, resting, swinging = positions[:, 0], positions[:, 0], 0.0
    if linked:
        angle = resting = positions[:, 1]
        link = filtered(np.diff(positions[:, 1], append=positions[-1, 1]) / sample_time, smooth)
    elif math.isfinite(joint.stiffness):
        spring = joint.stiffness + 1j * omega * max(joint.damping, 2 * LEAST_DAMPING * joint.stiffness / resonance)
        passed = spring / (spring - joint.link_inertia * omega**2)
        link = filtered(raw, smooth * passed)
        slow = 1 / (1 + (omega / (SLOW * joint.antiresonance)) ** 4)

        def reckoned(motor_side: Floats, smoothing: Floats) -> Floats:
            return motor_side[0] + filtered(motor_side - motor_side[0], smoothing * passed)

        rest = reckoned(positions[:, 0], slow)
        swinging = float(weight @ [np.mean(np.cos(rest)), -np.mean(np.sin(rest))])
        bent = weight @ [np.sin(rest), np.cos(rest)] / joint.stiffness
        angle, resting = (reckoned(positions[:, 0] - bent, smoothing) for smoothing in (smooth, slow))
    else:
        link = motor
    slow = (2 if cautious else 1) * TURNING * float(np.std(motor))
    near = (np.abs(motor) < slow) | (np.abs(link) < slow)
    after = int(AFTER / resonance / sample_time) + 1
    turning = (np.convolve(near, np.ones(after + 2))[1 : count + 1] > 0).astype(np.int64)
    along = [np.clip(velocity / least, -1, 1) for velocity in (motor, link)]
    if cautious:
        rest = cautious * float(np.std(motor))
        along = [way * (1 + STRIBECK * np.exp(-((speed / rest) ** 2))) for way, speed in zip(along, (motor, link), strict=True)]
    return Motion(np.column_stack([*along, motor, np.sin(resting), np.cos(resting)]), turning, angle, resting, swinging)


def _filter(count: int, sample_time: float):
    """Frequencies [rad/s], and a function that multiplies the spectrum of a column (count,) by a response there."""
    from scipy.fft import next_fast_len

    size: Any = next_fast_len(count + min(count, PADDING), real=True)
    omega = 2 * np.pi * np.fft.rfftfreq(size, sample_time)

    def filtered(values: Floats, response: Complexes) -> Floats:
        padded = np.concatenate([values, np.linspace(values[-1], values[0], size - count)])
        return np.fft.irfft(np.fft.rfft(padded) * response, size)[:count]

    return omega, filtered
