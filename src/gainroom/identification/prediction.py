"""Prediction of a joint's positions row by row from the torques, with the noise that acts on it, for the likelihood.

    x⁺ = A x + B u + (torque noise),    y = C x + (noise and steps of the encoders)

Plant and current loop are sampled exactly, with the command's change within a tick. Torque noise is white on the motor (jitter, friction
that no model has) plus a random walk (gravity, drift): with both the predictor follows what moves slowly and judges the rest. Coulomb
friction enters as a known torque along the sign of the velocity, its size as a parameter. The gain is that of the stationary Kalman filter.
The state at the first row is free: a joint that hardly knows noise forgets it so slowly that a sweep has passed the resonance by then.

Of a weight its torque at the link's slow angle is fitted, so that slow motion alone tells it; in fast motion it is a spring of the plant,
which is as large as the fit before this one says.
"""

import math
from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ..native import _core
from ..system.assembly import actuated_state
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Floats, Integers
from ..system.linear.state_space import StateSpace, split_delay
from .motion import Motion

DOUBLINGS = 60
FORGOTTEN = 1e-5  # of the start's error
UNKNOWN = 64  # rows, on which commands from before the log may still act: longer than any delay, at 2 kHz 32 ms
TOLD = 1e-8  # of what the best known combination of a start's states moves: less is rounding
DEMAND, MOTOR, LINK = range(3)  # inputs of actuated_state


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the noise.

    torque     white torque on the motor, held for a tick [N m]
    drift      of the random walk's step per tick [N m]
    turning    white torque while a side turns round, where no law of friction is to be trusted [N m]
    readings   (o,) of the measured positions [rad]
    """

    torque: float
    drift: float
    turning: float
    readings: Floats

    @property
    def key(self) -> tuple[float, ...]:
        """Noise parameters as a tuple, readings last."""
        return (self.torque, self.drift, self.turning, *self.readings.tolist())


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of a log without gaps.

    torque        (m,) the torque's command, or the torque itself where `sampled`
    sampled       True: `torque` is what acts at the ticks, and goes straight from one to the next
    positions     (m, o) of the motor, and of the link where it is measured; or of the link alone
    motion        what friction acts along
    sample_time   [s]
    """

    torque: Floats
    sampled: bool
    positions: Floats
    motion: Motion
    sample_time: float
    _inputs: dict[tuple[int, float, float], Floats] = field(default_factory=dict, init=False, repr=False)
    _starts: dict[Hashable, Floats] = field(default_factory=dict, init=False, repr=False)

    def rows(self, part: slice) -> "Signals":
        """Signals of some of the ticks."""
        whole = self.motion
        motion = Motion(whole.along[part], whole.turning[part], whole.angle[part], whole.slow[part], whole.swinging)
        return Signals(self.torque[part], self.sampled, self.positions[part], motion, self.sample_time)

    def inputs(self, shift: int, between: "Between") -> Floats:
        """Inputs (m, 8) of each tick: two torques, the five directions of friction and weight, the link's slow angle.

        The torques are the commands `shift` + 1 and `shift` ticks ago; of a sampled torque what acts at the tick's begin and end. The last
        inputs are kept, as few parameters change them.
        """
        key = (shift, between.early, between.curved)
        if key not in self._inputs:
            rows, torque = np.arange(len(self.torque)), self.torque
            first, second = rows - shift - 1, rows - shift
            if self.sampled:
                first, second = rows, np.minimum(rows + 1, len(rows) - 1)
                torque = torque + between.early * np.gradient(torque)
                torque = torque + between.curved * np.diff(self.torque, 2, prepend=self.torque[0], append=self.torque[-1])
            self._inputs.clear()
            torques = [torque[np.maximum(rows, 0)] for rows in (first, second)]
            self._inputs[key] = np.column_stack([*torques, self.motion.along, self.motion.slow])
        return self._inputs[key]

    def starts(self, key: Hashable, found: "_Filter") -> Floats:
        """Result of _Filter.starts of the filter `found`; that of the last `key` is cached."""
        if key not in self._starts:
            self._starts.clear()
            self._starts[key] = found.starts(self.motion.turning)
        return self._starts[key]


@dataclass(frozen=True)
class Between:
    """Course of a sampled torque between its samples, relative to a straight line from one to the next.

    early    ticks by which it acts before it is logged; its measurement may be late, and what a current loop does within a tick looks so
    curved   share of its second difference; −1/12 gives back the (ωT)²/12 that a line loses of what is at ω
    """

    early: float = 0.0
    curved: float = -1 / 12


def prediction_errors(
    signals: Signals, joint: ElasticJoint, drive: Drive, friction: Floats, noise: Noise, between: "Between | None" = None
) -> tuple[Floats, Floats]:
    """Errors (m, o) and their variances (m, o), made independent of each other, from the start under which the errors are least.

    friction   (5,) Coulomb torques on motor and link [N m], viscous friction of the motor [N m s/rad], and of the link's weight the torques
               along sine and cosine of its angle [N m]
    between    of a sampled torque

    Raises numpy.linalg.LinAlgError where there is no stationary filter.
    """
    key = (joint, drive.bandwidth, drive.damping_ratio, signals.positions.shape[1], signals.sample_time, signals.motion.swinging, noise.key)
    found = _filter(*key)
    b, inputs = _inputs(signals, drive, found, friction, Between() if between is None else between)
    rest = np.linalg.lstsq(found.system.c[[0, 1]], signals.positions[0, [0, -1]], rcond=None)[0]
    regime = signals.motion.turning
    errors = found.errors(regime, np.append(rest, 0.0), np.vstack([b, np.zeros((1, b.shape[1]))]), inputs, signals.positions)
    variances = found.variances[regime]
    basis = signals.starts(key, found)
    deviations = np.sqrt(variances[: basis.shape[1]])
    began = np.tensordot(basis, errors[: len(deviations)] / deviations, 2)
    errors[: len(deviations)] -= deviations * np.tensordot(began, basis, 1)
    return errors, variances


@dataclass(frozen=True)
class _Filter:
    """Sampled joint with its stationary Kalman filters, one for each regime of noise.

    system        current loop and plant (actuated_state), n states
    held, ramp    (n, 3) what inputs do over a tick, see _sampled
    a, c          (n + 1, n + 1), (o, n + 1) with the random walk of the torque as last state
    gains         (2, n + 1, o)
    ratio, variances   (2,), (2, o) of the errors: what of the second the first foretells, and what is left
    start         rows until the start is forgotten
    """

    system: StateSpace
    held: Floats
    ramp: Floats
    a: Floats
    c: Floats
    gains: Floats
    ratio: Floats
    variances: Floats
    start: int

    def errors(self, regime: Integers, state: Floats, b: Floats, inputs: Floats, positions: Floats) -> Floats:
        """Errors (m, o) of `positions` (m, o) from a `state` (n + 1,), independent of each other."""
        errors = np.empty_like(positions)
        _core.predict(self.a, b, self.c, self.gains, regime, inputs, positions, state, errors)
        if errors.shape[1] == 2:
            errors[:, 1] -= self.ratio[regime] * errors[:, 0]
        return errors

    def starts(self, regime: Integers) -> Floats:
        """Orthonormal basis (k, r, o) of errors, over their deviations, due to initial states; r: rows until these are forgotten."""
        rows, outputs, size = min(len(regime), self.start), len(self.c), len(self.a)
        regime, nothing = regime[:rows], np.zeros((rows, 0))
        at_rest = np.zeros((rows, outputs))
        moved = np.array([self.errors(regime, state, np.zeros((size, 0)), nothing, at_rest) for state in np.eye(size)])
        moved /= np.sqrt(self.variances[regime])
        moved[:, : min(UNKNOWN, rows // 3)] = 0.0
        columns = moved.reshape(size, -1).T
        basis, sizes, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
        return basis.T[sizes > TOLD * sizes[0]].reshape(-1, rows, outputs)


@lru_cache(16)
def _filter(
    joint: ElasticJoint, bandwidth: float, damping_ratio: float, outputs: int, sample_time: float, swinging: float, noise: tuple[float, ...]
) -> _Filter:
    """Filter of a joint, cached: friction and delay, which are half of a fit's parameters, do not change it."""
    plant = joint.plant()
    if swinging:
        plant = replace(plant, gravity_stiffness=np.array([[swinging]]))
    system = actuated_state(plant, (Drive(bandwidth, damping_ratio),))
    transition, held, ramp = _sampled(system, sample_time)
    torque, drift, turning, *readings = noise
    push, size = held[:, [MOTOR]], len(transition)
    a = np.block([[transition, push], [np.zeros((1, size)), np.ones((1, 1))]])
    c = np.hstack([system.c[:outputs], np.zeros((outputs, 1))])
    lowest, gains, spreads = min(readings), [], []
    for white in (torque, math.hypot(torque, turning)):
        process = np.zeros((size + 1, size + 1))
        process[:size, :size] = white**2 * (push @ push.T)
        process[size, size] = drift**2
        # The equation is solved in units in which readings are about one.
        covariance = lowest**2 * stationary(a, c, process / lowest**2, np.square(readings) / lowest**2)
        spreads.append(c @ covariance @ c.T + np.diag(np.square(readings)))
        gains.append(a @ np.linalg.solve(spreads[-1], c @ covariance).T)
    radius = float(np.abs(np.linalg.eigvals(a - gains[0] @ c)).max())
    if not radius < 1:
        raise np.linalg.LinAlgError("no stationary filter")
    start = int(math.log(FORGOTTEN) / math.log(radius)) + 1
    spread = np.array(spreads)
    ratio, variances = spread[:, -1, 0] / spread[:, 0, 0], np.diagonal(spread, axis1=1, axis2=2).copy()
    if outputs == 2:
        variances[:, 1] -= ratio * spread[:, 1, 0]
    return _Filter(system, held, ramp, a, c, np.ascontiguousarray(gains), ratio, variances, start)


def stationary(a: Floats, c: Floats, process: Floats, readings: Floats) -> Floats:
    """Solution P (n, n) of P = A P Aᵀ − A P Cᵀ (C P Cᵀ + R)⁻¹ C P Aᵀ + Q, R diagonal (o,).

    Structure-preserving doubling (Chu, Fan, Lin 2005) is twice as fast as scipy's ordered Schur form, which replaces it where it does not
    converge. Raises numpy.linalg.LinAlgError if neither converges.
    """
    from scipy.linalg import solve_discrete_are

    step, gathered, found = a.T.copy(), c.T @ (c / readings[:, None]), process.copy()
    eye = np.eye(len(a))
    for _ in range(DOUBLINGS):
        inverse = np.linalg.solve(eye + gathered @ found, np.hstack([step, gathered]))
        moved, weight = inverse[:, : len(a)], inverse[:, len(a) :]
        added = step.T @ found @ moved
        gathered = gathered + step @ weight @ step.T
        found = found + (added + added.T) / 2
        step = step @ moved
        size = float(np.abs(added).max())
        if not math.isfinite(size):
            break
        if size <= 1e-13 * float(np.abs(found).max()):
            return found
    return solve_discrete_are(a.T, c.T, process, np.diag(readings))


def _sampled(system: StateSpace, step: float) -> tuple[Floats, Floats, Floats]:
    """Transition (n, n), held inputs (n, 3), and the additional effect (n, 3) of inputs that rise by one over the tick."""
    from scipy.linalg import expm

    states, inputs = system.b.shape
    block = np.zeros((states + 2 * inputs, states + 2 * inputs))
    block[:states, : states + inputs] = step * np.hstack([system.a, system.b])
    block[states : states + inputs, states + inputs :] = np.eye(inputs)
    whole = expm(block)
    return whole[:states, :states], whole[:states, states : states + inputs], whole[:states, states + inputs :]


def _inputs(signals: Signals, drive: Drive, found: _Filter, friction: Floats, between: Between) -> tuple[Floats, Floats]:
    """Input matrix B (n, i) and inputs (m, i): torque over each tick, directions of friction and weight, and the slow angle.

    The weight's torque is that at the slow angle, so that of its spring in the plant the slow angle's part is taken off.
    """
    held, along = found.held, [MOTOR, LINK, MOTOR, LINK, LINK]
    columns = np.column_stack([-friction * held[:, along], signals.motion.swinging * held[:, LINK]])
    if signals.sampled:
        rise = found.ramp[:, [DEMAND]]
        return np.hstack([held[:, [DEMAND]] - rise, rise, columns]), signals.inputs(0, between)
    ticks, fraction = split_delay(drive.delay, signals.sample_time)
    part = float(fraction)
    first = np.zeros((len(held), 1))
    if part > 0:
        over, _, _ = _sampled(found.system, (1 - part) * signals.sample_time)
        first = over @ _sampled(found.system, part * signals.sample_time)[1][:, [DEMAND]]
    return np.hstack([first, held[:, [DEMAND]] - first, columns]), signals.inputs(int(ticks), between)
