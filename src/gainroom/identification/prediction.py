"""A joint's positions predicted row by row from the torques, with the noise that acts on it: what the likelihood is made of.

    x⁺ = A x + B u + (torque noise),    y = C x + (noise and steps of the encoders)

Plant and current loop are sampled exactly, with the command's change within a tick. Torque noise is white on the motor (jitter, friction
that no model has) plus a random walk (gravity, drift): with both the predictor follows what moves slowly and judges the rest. Coulomb
friction enters as a known torque along the sign of the velocity, its size as a parameter. The gain is that of the stationary Kalman filter.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..linear.arrays import Floats
from ..linear.state_space import StateSpace, split_delay
from ..system.assembly import actuated_state
from ..system.drive import Drive
from ..system.plant import ElasticJoint
from ._prediction import predict
from .motion import Motion

FORGOTTEN = 1e-5  # of the start's error
DEMAND, MOTOR, LINK = range(3)  # inputs of actuated_state


@dataclass(frozen=True)
class Noise:
    """Standard deviations.

    torque     white torque on the motor, held for a tick [N m]
    drift      of the random walk's step per tick [N m]
    turning    white torque while a side turns round, where no law of friction is to be trusted [N m]
    readings   (o,) of the measured positions [rad]
    """

    torque: float
    drift: float
    turning: float
    readings: Floats


@dataclass(frozen=True)
class Signals:
    """What is known of a log without gaps.

    torque        (m,) the torque's command, or the torque itself where `sampled`
    sampled       True: `torque` is what acts at the ticks, and goes straight from one to the next
    positions     (m, o) of the motor, and of the link where it is measured; or of the link alone
    sides         which they are, indices of the outputs of actuated_state: 0 motor, 1 link
    motion        what friction acts along
    sample_time   [s]
    """

    torque: Floats
    sampled: bool
    positions: Floats
    sides: tuple[int, ...]
    motion: Motion
    sample_time: float

    def rows(self, part: slice) -> "Signals":
        """Some of the ticks."""
        motion = Motion(self.motion.along[part], self.motion.turning[part])
        return Signals(self.torque[part], self.sampled, self.positions[part], self.sides, motion, self.sample_time)


def prediction_errors(signals: Signals, joint: ElasticJoint, drive: Drive, friction: Floats, noise: Noise) -> tuple[Floats, Floats, int]:
    """Errors (m, o) and their variances (m, o), made independent of each other, and the rows that the start still acts on.

    friction   (5,) Coulomb torques on motor and link [N m], viscous friction of the motor [N m s/rad], and of the link's weight the torques
               along sine and cosine of its angle [N m]

    Raises numpy.linalg.LinAlgError where there is no stationary filter.
    """
    from scipy.linalg import solve_discrete_are

    system = actuated_state(joint.plant(), (Drive(drive.bandwidth, drive.damping_ratio),))
    transition, held, ramp = _sampled(system, signals.sample_time)
    c = system.c[list(signals.sides)]
    lowest = noise.readings.min()
    push = held[:, [MOTOR]]
    size = len(transition)
    a = np.block([[transition, push], [np.zeros((1, size)), np.ones((1, 1))]])
    c_all = np.hstack([c, np.zeros((len(c), 1))])
    gains, spreads = [], []
    for torque in (noise.torque, math.hypot(noise.torque, noise.turning)):
        process = np.zeros((size + 1, size + 1))
        process[:size, :size] = torque**2 * (push @ push.T)
        process[size, size] = noise.drift**2
        scale = 1 / lowest**2  # readings of about one
        covariance = solve_discrete_are(a.T, c_all.T, process * scale, np.diag((noise.readings / lowest) ** 2)) / scale
        spreads.append(c_all @ covariance @ c_all.T + np.diag(noise.readings**2))
        gains.append(a @ np.linalg.solve(spreads[-1], c_all @ covariance).T)
    b, inputs = _inputs(signals, drive, system, held, ramp, friction)
    b = np.vstack([b, np.zeros((1, b.shape[1]))])
    state = np.concatenate([np.linalg.lstsq(system.c[[0, 1]], signals.positions[0, [0, -1]], rcond=None)[0], [0.0]])
    errors = np.empty_like(signals.positions)
    predict(a, np.ascontiguousarray(b), c_all, np.array(gains), signals.motion.turning, inputs, signals.positions, state, errors)
    radius = float(np.abs(np.linalg.eigvals(a - gains[0] @ c_all)).max())
    start = len(errors) if radius >= 1 else int(math.log(FORGOTTEN) / math.log(radius)) + 1
    variances = np.array([np.diag(spread) for spread in spreads])
    if errors.shape[1] == 2:
        ratio = np.array([spread[1, 0] / spread[0, 0] for spread in spreads])
        errors[:, 1] -= ratio[signals.motion.turning] * errors[:, 0]
        variances[:, 1] -= ratio * np.array([spread[1, 0] for spread in spreads])
    return errors, variances[signals.motion.turning], start


def _sampled(system: StateSpace, step: float) -> tuple[Floats, Floats, Floats]:
    """Transition (n, n), held inputs (n, 3), and what a rise of the inputs by one over the tick adds beside their first value (n, 3)."""
    from scipy.linalg import expm

    states, inputs = system.b.shape
    block = np.zeros((states + 2 * inputs, states + 2 * inputs))
    block[:states, : states + inputs] = step * np.hstack([system.a, system.b])
    block[states : states + inputs, states + inputs :] = np.eye(inputs)
    whole = expm(block)
    return whole[:states, :states], whole[:states, states : states + inputs], whole[:states, states + inputs :]


def _inputs(signals: Signals, drive: Drive, system: StateSpace, held: Floats, ramp: Floats, friction: Floats) -> tuple[Floats, Floats]:
    """B (n, i) and inputs (m, i): torque over each tick, and the directions of friction."""
    columns = [-friction[0] * held[:, MOTOR], -friction[1] * held[:, LINK], -friction[2] * held[:, MOTOR]]
    columns += [-friction[3] * held[:, LINK], -friction[4] * held[:, LINK]]
    torque = signals.torque
    if signals.sampled:
        after = np.append(torque[1:], torque[-1])
        b = np.column_stack([held[:, DEMAND] - ramp[:, DEMAND], ramp[:, DEMAND], *columns])
        return b, np.column_stack([torque, after, signals.motion.along])
    ticks, fraction = split_delay(drive.delay, signals.sample_time)
    shift, part = int(ticks), float(fraction)
    rows = np.arange(len(torque))
    now, before = torque[np.maximum(rows - shift, 0)], torque[np.maximum(rows - shift - 1, 0)]
    if part == 0:
        first = np.zeros(len(held))
    else:
        over, _, _ = _sampled(system, (1 - part) * signals.sample_time)
        first = over @ _sampled(system, part * signals.sample_time)[1][:, DEMAND]
    return np.column_stack([first, held[:, DEMAND] - first, *columns]), np.column_stack([before, now, signals.motion.along])
