"""Every closed loop that a linear controller can make of a joint, as maps that are affine in one free, stable Q (Youla, Kučera).

An observer with gains E and the feedback u = −F x̂ + v stabilise the sampled joint x⁺ = A x + b u + b_d d, y = C x, and v = −Q e of the
innovation e = y − C x̂, Q any stable row, makes of them every controller that does (Zhou, Doyle and Glover, Robust and Optimal Control, th.
12.8): e does not depend on v, so that all maps are affine in Q. With R_F = (zI − A + bF)⁻¹, R_E = (zI − A + EC)⁻¹ and the stable factors

    M = 1 − F R_F b,   N = C R_F b,   M̃ = 1 − C R_E E,   Ñ = C R_E b,   Ñ_d = C R_E b_d

the loop broken at the torque command, the noise of sensor i in the torque, and the link's compliance are

    S = M (1 + F R_E b − Q Ñ),   T = 1 − S = N (F R_E E + Q M̃),   u/n_i = −M (F R_E E + Q M̃)_i,
    q/d = c_q R_F (b_d + b F R_E b_d) − c_q R_F b Q Ñ_d

No term is a difference of large numbers near z = 1, as products of the open loop's responses are.

A joint of a robot has a hundred states that it hardly moves or sees, and an observer's gains on them leave no digits. There the stable PD K
that `held` names takes the place of observer and feedback, u = −K y + v, v = −Q (y − N v), which makes all controllers as well: with the
responses of the loop that it closes, N from v to y, S₀ = 1 − K N, and those from the load,

    S = S₀ − S₀ Q N,   T = K N + S₀ Q N,   u/n = −S₀ K − S₀ Q S₀,   q/d = q₀/d − (q₀/v) Q (y₀/d)
"""

import math
from dataclasses import dataclass

import numpy as np

from ...errors import GainroomError
from ...system.linear.arrays import Complexes, Floats
from ...system.linear.state_space import StateSpace
from ...system.linear.triangular import TriangularForm
from .exact_joint import COMMAND, LOAD, SENSORS, ExactJoint

DECAY = 0.98
"""Bound of the closed loop's poles: responses to an impulse then end after some 2000 ticks, and their transforms are polynomials."""
LINK = SENSORS.index("link")


@dataclass(frozen=True)
class AffineMap:
    """Closed-loop response fixed + free @ Q: `fixed` (k,), `free` (k, sensors), at k frequencies."""

    fixed: Complexes
    free: Complexes

    def of(self, q: Complexes) -> Complexes:
        """Response (k,) with Q (k, sensors)."""
        return self.fixed + (self.free * q).sum(axis=-1)


@dataclass(frozen=True)
class ClosedMaps:
    """Closed-loop maps that a comparison bounds, of all stabilising controllers on `sensors`: torque noise has one per sensor."""

    compliance: AffineMap
    sensitivity: AffineMap
    complementary: AffineMap
    noise: tuple[AffineMap, ...]


@dataclass(frozen=True)
class Stabilised:
    """A joint held by an observer on some sensors and feedback of its state: responses to impulses, all decayed.

    forward (k, 2 + sensors, 2): outputs (F, link, sensors) of R_F at each tick, from command and load torque;
    observed (k, 1 + sensors, 2 + sensors): outputs (F, sensors) of R_E, from command, load torque and the observer's gains.
    """

    forward: Floats
    observed: Floats

    @classmethod
    def of(cls, joint: ExactJoint, sensors: tuple[str, ...]) -> "Stabilised":
        """Joint as seen by `sensors`. Raises GainroomError where they see too little to stabilise it."""
        space, step = joint.state_space, joint.sample_time
        a, b = np.eye(len(space.a)) + step * space.a, step * space.b
        rows = [SENSORS.index(name) for name in sensors]
        c, link = space.c[rows], space.c[LINK : LINK + 1]
        # Weights as large as what one unit of torque moves at the rate of decay: neither cheap nor dear.
        size = np.abs(joint.at(np.array([-math.log(DECAY) / step]))[0, rows, COMMAND])
        try:
            feedback = _regulator(a, b[:, [COMMAND]], c / size[:, None])
            gains = _regulator(a.T, (c / size[:, None]).T, b.T).T / size
            held, seen = a - b[:, [COMMAND]] @ feedback, a - gains @ c
            slowest = max(np.abs(np.linalg.eigvals(part)).max() for part in (held, seen))
        except (np.linalg.LinAlgError, ValueError) as error:
            raise GainroomError(f"the joint cannot be stabilised from {' and '.join(sensors)} alone") from error
        if slowest > (1 + DECAY) / 2:  # what cannot be moved, or seen, stays where it was
            raise GainroomError(f"the joint cannot be stabilised from {' and '.join(sensors)} alone")
        forward = _impulses(held, b, np.vstack([feedback, link, c]))
        return cls(forward, _impulses(seen, np.hstack([b, gains]), np.vstack([feedback, c])))

    @property
    def ticks(self) -> int:
        """Ticks until all has decayed: the fewest points of a grid."""
        return max(len(self.forward), len(self.observed))

    def halves(self, points: int) -> ClosedMaps:
        """Maps at the angles π (k + ½)/points, k = 0 … points − 1: middles of equal parts of the upper half circle."""
        return self._maps(_on_halves(self.forward, points), _on_halves(self.observed, points))

    def _maps(self, forward: Complexes, observed: Complexes) -> ClosedMaps:
        """Formulas of the module's docstring; responses (k, outputs, inputs)."""
        m = 1 - forward[:, 0, COMMAND]
        link, n = forward[:, 1], forward[:, 2:, COMMAND]
        from_command, from_load, from_gains = observed[:, :, COMMAND], observed[:, :, LOAD], observed[:, :, 2:]
        law, innovation = from_gains[:, 0], np.eye(n.shape[1]) - from_gains[:, 1:]
        compliance = AffineMap(link[:, LOAD] + link[:, COMMAND] * from_load[:, 0], -link[:, [COMMAND]] * from_load[:, 1:])
        sensitivity = AffineMap(m * (1 + from_command[:, 0]), -m[:, None] * from_command[:, 1:])
        complementary = AffineMap((law * n).sum(axis=1), (innovation @ n[:, :, None])[:, :, 0])
        noise = tuple(AffineMap(m * law[:, i], m[:, None] * innovation[:, :, i]) for i in range(n.shape[1]))
        return ClosedMaps(compliance, sensitivity, complementary, noise)


@dataclass(frozen=True)
class HeldByPD:
    """A joint held by its PD on one sensor.

    form     the closed loop, from v and load torque to link, sensor, and what the PD makes of the sensor
    gains    kp, kd; sample_time [s]; ticks until its slowest motion has decayed, but for 1e-3
    """

    form: TriangularForm
    gains: tuple[float, float]
    sample_time: float
    ticks: int

    @classmethod
    def of(cls, joint: ExactJoint, sensor: str) -> "HeldByPD":
        """Joint held by `joint.held` on `sensor`. Raises GainroomError where that does not stabilise it."""
        assert joint.held is not None
        space, step, (kp, kd) = joint.state_space, joint.sample_time, joint.held
        seen, link = space.c[SENSORS.index(sensor)], space.c[LINK]
        now, before, states = kp + kd / step, kd / step, len(space.a)
        command = space.b[:, COMMAND]
        a = np.block(
            [[space.a - now * np.outer(command, seen), before * command[:, None]], [seen[None] / step, np.full((1, 1), -1 / step)]]
        )
        b = np.vstack([space.b, np.zeros((1, space.b.shape[1]))])
        c = np.zeros((3, states + 1))
        c[0, :states], c[1, :states], c[2, :states], c[2, states] = link, seen, now * seen, -before
        slowest = float(np.abs(1 + step * np.linalg.eigvals(a)).max())
        if not slowest < 1:
            raise GainroomError(f"the joint is not stabilised by kp {kp:g} and kd {kd:g} on {sensor}")
        ticks = math.ceil(math.log(1e-3) / (2 * math.log(slowest)))
        return cls(TriangularForm.of(StateSpace(a, b, c, np.zeros((3, 2)))), joint.held, step, ticks)

    def halves(self, points: int) -> ClosedMaps:
        """Maps as Stabilised has them."""
        step, (kp, kd) = self.sample_time, self.gains
        angles = math.pi * (np.arange(points) + 0.5) / points
        found = self.form.at(np.expm1(1j * angles) / step)
        law = kp - kd * np.expm1(-1j * angles) / step
        (link, link_load), (seen, seen_load) = found[:, 0].T, found[:, 1].T
        answered = found[:, 2, COMMAND]
        sensitivity = 1 - answered

        def affine(fixed: Complexes, free: Complexes) -> AffineMap:
            return AffineMap(fixed, free[:, None])

        return ClosedMaps(
            affine(link_load, -link * seen_load),
            affine(sensitivity, -sensitivity * seen),
            affine(answered, sensitivity * seen),
            (affine(sensitivity * law, sensitivity**2),),
        )


def stabilised(joint: ExactJoint, sensors: tuple[str, ...]) -> "Stabilised | HeldByPD":
    """Joint held on `sensors`: on one by the PD that it names, else by an observer. Raises GainroomError where it cannot be stabilised."""
    first, *others = sensors
    return Stabilised.of(joint, sensors) if joint.held is None or others else HeldByPD.of(joint, first)


def _regulator(a: Floats, b: Floats, c: Floats) -> Floats:
    """Gains F (inputs, states) that bring all poles of a − b F within DECAY: linear quadratic, of the system sped up by 1/DECAY."""
    from scipy.linalg import solve_discrete_are

    a, b = a / DECAY, b / DECAY
    cost = solve_discrete_are(a, b, c.T @ c, np.eye(b.shape[1]))
    return np.linalg.solve(np.eye(b.shape[1]) + b.T @ cost @ b, b.T @ cost @ a)


def _impulses(a: Floats, b: Floats, c: Floats) -> Floats:
    """Responses c a^(k−1) b (ticks, outputs, inputs) to impulses, from tick 0 on until nothing is left of them; `a` is stable."""
    inputs = b.shape[1]
    reached, power = b, a
    while True:
        reached, power = np.hstack([reached, power @ reached]), power @ power
        values = (c @ reached).reshape(len(c), -1, inputs)
        left = np.abs(values[:, -64:]).max(axis=1) <= 1e-17 * np.abs(values).max(axis=1)
        if values.shape[1] > 64 and left.all():
            return np.concatenate([np.zeros((1, len(c), inputs)), values.transpose(1, 0, 2)])


def _on_halves(impulses: Floats, points: int) -> Complexes:
    if len(impulses) > points:
        raise GainroomError(f"a grid of {points} points is too coarse for responses of {len(impulses)} ticks")
    padded = np.zeros((*impulses.shape[1:], points))
    padded[..., : len(impulses)] = np.moveaxis(impulses, 0, -1)
    return np.moveaxis((cosines(padded, 3) + padded[..., :1]) / 2 - 0.5j * sines(later(padded), 3), -1, 0)


def cosines(values: Floats, kind: int) -> Floats:
    """Cosine transform of kind 2 or 3 along the last axis, as scipy normalises it: to and from the middles of parts of a half circle."""
    from scipy.fft import dct

    return np.asarray(dct(values, type=kind))


def sines(values: Floats, kind: int) -> Floats:
    """Sine transform, likewise. Its first coefficient is that of one turn, not the mean."""
    from scipy.fft import dst

    return np.asarray(dst(values, type=kind))


def later(series: Floats) -> Floats:
    """Coefficients (..., k) from the first on, as sine transforms take them; the last is 0."""
    return np.concatenate([series[..., 1:], np.zeros((*series.shape[:-1], 1))], axis=-1)
