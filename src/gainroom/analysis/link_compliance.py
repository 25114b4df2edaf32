"""Compliance of the links with all loops closed: load torque on a joint → position of its link.

The load is a pair, equal and opposite on the two bodies that a joint connects: a force on one body alone drifts as 1/ω² in flight. In the
coordinates ξ of the plant (system/plant.py: q = R ξ, W = R Rᵀ, never inverted), with the stiffness Y of the joints as their links feel it,

    C = R (s² I + Rᵀ (Y + D_l s + G) R + Hᵀ (K_c + B_c s) H)⁻¹ Rᵀ
    Y = (I + N k⁻¹)⁻¹ (N + E_q),   N = J_m s² + D_m s + E_θ

k = K + B s of the gearboxes, k⁻¹ = 0 of a rigid one; E_θ and E_q are the torques that the loop puts on the motors per position measured at
motors and at links: gains, delay and current loop, each path of gains by itself. Locked motors (E_θ → ∞) leave Y = k. Where the loop puts
E_τ on a motor per torque of its spring, Y = (1 + E_τ + N k⁻¹)⁻¹ (N + E_q).

Sampled loops: E also has the hold of the torque and the difference that velocity is made from, and the load is held over each tick. This is
the fundamental of the sampled response, without its alias terms: the peaks of 450 random joints at 200 Hz to 2 kHz differ from those of the
exactly sampled response by 1e-8 in the median, 1.2e-4 in 99 % and 3.5e-3 at most, that one at half the Nyquist frequency.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import GainroomError
from ..native import _core
from ..system.assembly import Parts
from ..system.controller import Controller
from ..system.drive import Drive
from ..system.feedback import Sensor, Side
from ..system.linear.arrays import Complexes, Floats, diagonals
from ..system.loop import Loop


def held(s: Complexes, step: float | None) -> Complexes:
    """Response (k,) at s (k,) of a zero-order hold of `step` [s]; 1 in continuous time."""
    return np.ones(len(s), dtype=complex) if step is None else -np.expm1(-s * step) / (s * step)


def current(drive: Drive, s: Complexes) -> Complexes:
    """Response (k,) at s (k,) of the current loop, eq. (3) of Jung et al. 2017; 1 of an ideal one."""
    lag = s / drive.bandwidth
    return 1 / (lag * lag + 2 * drive.damping_ratio * lag + 1)


def _beside_0(values: Complexes) -> Complexes:
    """`values` with 1e-16, round-off of 1, in place of 0: at √(K/J_m) itself a link feels an undamped motor as infinitely stiff."""
    return np.where(values == 0, 1e-16, values)


@dataclass(frozen=True)
class LinkCompliance:
    """Links, gearboxes, motors and drives of a loop from build_loop, without its gains: compliance C of the links for any gains."""

    parts: Parts

    @classmethod
    def of(cls, loop: Loop) -> "LinkCompliance":
        """Compliance of the links of `loop`. Raises GainroomError for a loop given as a transfer function, which has no link."""
        if loop.parts is None:
            raise GainroomError("dynamic stiffness: a loop given as a transfer function has no link; build_loop makes one that has")
        return cls(loop.parts)

    @property
    def fastest(self) -> float:
        """Highest frequency of a sampled loop, π/T_s [rad/s]; inf in continuous time."""
        return np.inf if self.parts.sample_time is None else np.pi / self.parts.sample_time

    def delivered(self, s: Complexes, delay: Floats | float, step: float | None) -> Complexes:
        """Transfer function (k, n) at s (k,) from torque command to motor torque: `delay` [s], current loop, and hold of `step` [s]."""
        lags = {(drive.bandwidth, drive.damping_ratio): current(drive, s) for drive in self._kinds}
        currents = np.stack([lags[drive.bandwidth, drive.damping_ratio] for drive in self.parts.drives], axis=1)
        return currents * held(s, step)[:, None] * np.exp(-s[:, None] * delay)

    @cached_property
    def _kinds(self) -> list[Drive]:
        """One drive of each bandwidth and damping ratio."""
        return list({(drive.bandwidth, drive.damping_ratio): drive for drive in self.parts.drives}.values())

    def signals(self, s: Complexes, controller: Controller) -> dict[tuple[int, int], Complexes]:
        """Transfer functions (k, n) at s (k,) from measured position to motor torque with a gain of 1, filters and delays included.

        One for each gain term of `controller`; the key is its pair of powers of velocity and integral (system/controller.py).
        """
        parts, path = self.parts, self.parts.kd_path
        ways = [(controller, parts.sample_time, parts.delays)]
        if path is not None:
            ways = [(controller.without_kd(), *ways[0][1:]), (controller.kd_alone(), path.sample_time, path.delay)]
        found = {}
        for one, step, delay in ways:
            v = s if step is None else np.expm1(s * step) / step
            sent = self.delivered(s, delay, step)
            found |= {powers: sent * one.signal(powers, s, v, step)[:, None] for powers in one.terms()}
        return found

    def measured(self, s: Complexes, controller: Controller, sensor: Sensor, gain: float = 1.0) -> Complexes:
        """Transfer function (k,) at s (k,) from what `sensor` of a single joint measures to its motor's torque; `gain`: a factor on it."""
        law = controller.law(sensor, self.parts.feedback, self.parts.sample_time)
        return gain * law.at(s) * self.delivered(s, self.parts.delays, self.parts.sample_time)[:, 0]

    def feedback(self, s: Complexes, controller: Controller, gain: float = 1.0, side: Side | None = None) -> Complexes:
        """Transfer matrix (k, n, n) [N m/rad] at s (k,) from measured position to motor torque; `gain`: a factor on all gains.

        side   the side of the gearbox whose position is meant, with the gains that measure it; None: all gains
        """
        size = self.parts.plant.size
        terms = controller.matrices(size)
        found = np.zeros((len(s), size, size), dtype=complex)
        for powers, signal in self.signals(s, controller).items():
            if side not in (None, self.parts.feedback.side_of(powers)):
                continue
            found += signal[:, :, None] * terms.get(powers, 0.0)
        return gain * found

    @cached_property
    def _hung(self) -> tuple[Floats, Floats]:
        return self.parts.plant.hung

    def _motors(self, s: Complexes) -> tuple[Complexes, Complexes]:
        """Impedance J_m s² + D_m s of the motors, and k⁻¹ of the gearboxes, each (k, n)."""
        plant, at = self.parts.plant, s[:, None]
        spring = np.where(plant.elastic, plant.stiffness, 1.0) + at * np.where(plant.elastic, plant.damping, 0.0)
        motor = at * at * plant.motor_inertia + at * plant.motor_viscous
        return motor, np.where(plant.elastic, 1 / spring, 0.0)

    def stiffness(self, s: Complexes, fed: Complexes, motors: Complexes | None = None, springs: Complexes | float = 0.0) -> Complexes:
        """Stiffness Y (…, k, n) [N m/rad] of joints whose gains do not couple them, at s (k,); `fed` (…, k, n): diagonal of `feedback`.

        motors    E_θ, the part of `fed` by gains that measure the motors, where gains measure more than one quantity
        springs   E_τ, by gains that measure the torque of the springs
        """
        motor, soft = self._motors(s)
        if self.parts.feedback.link:
            return (motor + fed) / _beside_0(1 + soft * motor)
        if self.parts.feedback.mixed:
            assert motors is not None
            return (motor + fed) / _beside_0(1 + springs + soft * (motor + motors))
        return (motor + fed) / _beside_0(1 + soft * (motor + fed))

    def passed(self, s: Complexes, fed: Complexes) -> Complexes:
        """Change of each joint's stiffness per change of its feedback, dY/dE (k, n) at s (k,); `fed` (k, n) as `stiffness` takes it."""
        motor, soft = self._motors(s)
        return 1 / _beside_0(1 + soft * motor) if self.parts.feedback.link else 1 / _beside_0(1 + soft * (motor + fed)) ** 2

    def open(self, s: Complexes) -> tuple[Complexes, Complexes, Complexes]:
        """Motions of the links without gains, at s (k,): C₀ (k, n, n) by loads and ρ, σ (k, n) with which torques τ of the motors act.

        q = C₀ (τ_L + ρ τ) and θ = ρ q + σ τ.
        """
        motor, soft = self._motors(s)
        share = 1 / _beside_0(1 + soft * motor)
        size = self.parts.plant.size
        return self.on(s, share * motor).reshape(len(s), size, size), share, soft * share

    def coupled_stiffness(self, s: Complexes, fed: Complexes) -> Complexes:
        """Stiffness Y (k, n, n) [N m/rad] at s (k,) with `fed` (k, n, n) from `feedback`, whose gains may couple joints."""
        motor, soft = self._motors(s)
        whole = fed.astype(complex)
        diagonals(whole)[:] += motor
        loose = np.zeros_like(whole) if self.parts.feedback.link else whole * soft[:, None, :]
        diagonals(loose)[:] += _beside_0(1 + motor * soft) if self.parts.feedback.link else 1.0
        return np.linalg.solve(loose, whole)

    def closed(self, s: Complexes, controller: Controller, gain: float = 1.0) -> Complexes:
        """Compliance C (k,) [rad/(N m)] of a single joint at s (k,) with all gains of `controller`, each times `gain`."""
        if not self.parts.feedback.mixed:
            return self.of_one(s, self.feedback(s, controller, gain)[:, 0, 0])
        fed = {sensor: self.measured(s, controller, sensor, gain) for sensor in self.parts.feedback.sensors}
        motors, springs = fed.get("motor", np.zeros(len(s))), fed.get("torque", np.zeros(len(s)))
        return self.of_one(s, motors + fed.get("link", 0.0), motors, springs)

    def of_one(self, s: Complexes, fed: Complexes, motors: Complexes | None = None, springs: Complexes | None = None) -> Complexes:
        """Compliance C (…, k) [rad/(N m)] of a single joint at s (k,), for any number of gains; others (…, k) as `stiffness`."""
        plant, root = self.parts.plant, self._hung[0]
        felt = self.stiffness(
            s, fed[..., None], None if motors is None else motors[..., None], 0.0 if springs is None else springs[..., None]
        )
        if plant.compliance is not None or not root.shape[1]:  # links on springs, or locked
            return np.array([self.on(s, one)[:, 0] for one in felt.reshape(-1, len(s), 1)]).reshape(fed.shape)
        load = felt[..., 0] + s * plant.link_viscous[0]
        if plant.gravity_stiffness is not None:
            load = load + plant.gravity_stiffness[0, 0]
        return root[0, 0] ** 2 / (s * s + root[0, 0] ** 2 * load) * np.abs(held(s, self.parts.sample_time))

    def at(self, s: Complexes, fed: Complexes) -> Complexes:
        """Compliance C (k, n, n) [rad/(N m)] at s = jω (k,), with `fed` (k, n, n) of `feedback`."""
        size = fed.shape[1]
        if np.count_nonzero(fed) == np.count_nonzero(own := np.diagonal(fed, axis1=1, axis2=2)):
            return self.on(s, self.stiffness(s, own)).reshape(len(s), size, size)
        plant, (root, rest) = self.parts.plant, self._hung
        inner = (
            self._inner + root.T @ self.coupled_stiffness(s, fed) @ root + root.T @ ((s[:, None] * plant.link_viscous)[:, :, None] * root)
        )
        if plant.compliance is not None:
            springs = plant.compliance.stiffness + s[:, None] * plant.compliance.damping
            inner = inner + rest.T @ (springs[:, :, None] * rest)
        diagonals(inner)[:] += (s * s)[:, None]
        moved = root @ np.linalg.solve(inner, np.broadcast_to(root.T, (len(s), *root.T.shape)).astype(complex))
        return moved * np.abs(held(s, self.parts.sample_time))[:, None, None]

    def on(self, s: Complexes, stiffness: Complexes, whole: bool = True) -> Complexes:
        """Compliance C [rad/(N m)] at s = jω (k,) of links on joints with the uncoupled `stiffness` Y (k, n) [N m/rad].

        whole   True: all entries, (k, n·n) row by row; False: the diagonal, (k, n)
        """
        plant = self.parts.plant
        loads = stiffness + s[:, None] * plant.link_viscous
        if plant.compliance is not None:
            loads = np.hstack([loads, plant.compliance.stiffness + s[:, None] * plant.compliance.damping])
        found = _core.link_compliance(self._springs, plant.size, self._inner, s.imag, np.ascontiguousarray(loads), whole)
        return found * np.abs(held(s, self.parts.sample_time))[:, None]

    @cached_property
    def _springs(self) -> Floats:
        """Factor R, stacked on H, the rows of springs under contacts, if there are any."""
        return (
            np.ascontiguousarray(np.vstack(self._hung)) if self.parts.plant.compliance is not None else np.ascontiguousarray(self._hung[0])
        )

    @cached_property
    def _inner(self) -> Floats:
        """Stiffness Rᵀ G R (r, r) of gravity."""
        root, gravity = self._hung[0], self.parts.plant.gravity_stiffness
        return np.zeros((root.shape[1],) * 2) if gravity is None else root.T @ ((gravity + gravity.T) / 2) @ root
