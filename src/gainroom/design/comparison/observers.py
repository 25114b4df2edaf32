"""Structures that hold a model of the joint: a disturbance observer beside a PD, and state feedback from a Kalman filter.

    dob        (C + Q J D²)/(1 − Q z^−n), C = kp + kd D, as the controller DisturbanceObserver
    observer   u = −F x̂ − d̂: the filter's state is that of the sampled joint with its delay, which predicts over it, and a load torque d̂
               that walks at random and is cancelled; F is the feedback with the least Σ q² + β q̇² + ρ u²

The model is that of the joint's nominal values, wherever in the box the loop is judged.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...system.controller import Compensator, DisturbanceObserver
from ...system.gain_path import GainPath
from ...system.linear.arrays import Complexes, Floats
from ...system.linear.state_space import StateSpace, factored, split_delay
from ...system.system import System
from .exact_joint import COMMAND, LOAD, SENSORS, ExactJoint
from .joint_responses import HOST, opened
from .structures import NYQUIST, Law, Parameter, Structure, closed_with, low_pass_response

MOST_DOUBLINGS, SETTLED = 30, 1e-12
"""Doublings of a Riccati equation, and the relative change at which it is solved."""
PUSHED = 1e-2, 1e-3
"""Variances [N²m²] of the white torques on link and motor that the filter reckons with beside the walking one."""
MOST_KNOWN = 2000
"""Laws that are kept."""
BEYOND = 100.0
"""Factor by which the search may leave the ranges where it starts: far outside, the Riccati equations have no digits left."""
INTEGRATING = 1e-5
"""Distance from 1 within which the law's pole is that of the cancelled load torque."""


@dataclass(frozen=True)
class ObservedDisturbance(Structure):
    """PD with a disturbance observer.

    ticks   of delay that it reckons with
    """

    ticks: int = field(default=1, compare=False)

    @property
    def integrators(self) -> int:
        return 1

    def scaled_to(self, system: System, path: GainPath | None) -> "ObservedDisturbance":
        step, joint = system.control.sample_time, system.source
        assert step is not None
        plain = super().scaled_to(system, path).ranges
        lag = system.delay + step
        most = NYQUIST * math.pi / step
        inertia = joint.motor_inertia or joint.link_inertia
        own = {
            "nominal_inertia": Parameter("nominal_inertia", "kg·m²", 0.2 * inertia, 5 * inertia),
            "bandwidth": Parameter("bandwidth", "rad/s", 0.02 / lag, min(0.5 / lag, most), most=most),
        }
        ticks = int(split_delay(np.array([system.delay]), step)[0][0]) + 1
        return replace(self, ranges={**plain, **own}, ticks=ticks)

    def laws(self, x: Floats, omega: Floats, sample_times: Mapping[str, float]) -> list[Law]:
        value = dict(zip(self.ranges, self.values(np.atleast_2d(x)).T[:, :, None], strict=True))
        step = sample_times[HOST]
        late = np.exp(-1j * omega * step)
        slope = (1 - late) / step
        passed = low_pass_response(value["bandwidth"], late, step) ** 2
        response = (value["kp"] + value["kd"] * slope + passed * value["nominal_inertia"] * slope**2) / (1 - passed * late**self.ticks)
        return [Law(HOST, self.position, response)]

    def system(self, x: Floats, system: System, path: GainPath | None) -> System:
        values: dict[str, Any] = dict(self.by_field(x))
        return closed_with(system, DisturbanceObserver(**values, delay_ticks=self.ticks), self.position)


@dataclass(frozen=True)
class StateObserver(Structure):
    """State feedback from a Kalman filter with a load torque.

    model   sampled joint at its nominal values; None: not yet known
    """

    model: ExactJoint | None = field(default=None, compare=False)

    @property
    def integrators(self) -> int:
        return 1

    def scaled_to(self, system: System, path: GainPath | None) -> "StateObserver":
        """Structure with the joint's model. Ranges: ρ about the square of a gearbox's compliance, β of the lag's, noise about a count's."""
        joint = system.source
        step = system.control.sample_time
        assert step is not None
        soft = 1 / joint.stiffness if math.isfinite(joint.stiffness) else (system.delay + step) ** 2 / joint.link_inertia
        slow, spread, wide = 40 * (system.delay + step), math.exp(6), math.exp(8)
        ends = {
            "rho": ("rad²/(N·m)²", 0.1 * soft**2 / spread, 0.1 * soft**2 * spread),
            "beta": ("s²", slow**2 / math.exp(3), slow**2 * math.exp(3)),
            "walk": ("N²·m²", math.exp(-5), math.exp(3)),
            "reading": ("rad²", 1e-2 * soft**2 / spread, 1e-2 * soft**2 * wide),
        }
        ranges = {name: Parameter(name, unit, low, high, low / BEYOND, high * BEYOND) for name, (unit, low, high) in ends.items()}
        return replace(self, ranges=ranges, model=ExactJoint.of(opened(system).parts))

    @cached_property
    def _sampled(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Model in z, its states of one size: transition, columns of command and load torque, rows of SENSORS, and the sizes."""
        assert self.model is not None
        space, tick = self.model.state_space, self.model.sample_time
        a, b, c = np.eye(len(space.a)) + tick * space.a, tick * space.b, space.c
        size = np.sqrt(np.sum([(np.linalg.matrix_power(a, k) @ b) ** 2 for k in (0, 3, 10, 40)], axis=(0, 2)))
        size[size == 0] = 1.0
        return a * size / size[:, None], b[:, [COMMAND]] / size[:, None], b[:, [LOAD]] / size[:, None], c * size, size

    def _designed(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Law x̂⁺ = A x̂ + L y, −u = F x̂ of coordinates x (batch, n): A (batch, s, s), L (batch, s, 1), F (batch, 1, s)."""
        a, command, load, rows, _ = self._sampled
        rho, beta, walk, reading = self.values(np.atleast_2d(x)).T
        states = len(a)
        link, position = rows[[SENSORS.index("link")]], rows[[SENSORS.index(self.position)]]
        assert self.model is not None
        rate = (link @ a - link) / self.model.sample_time  # of the link, by its next difference
        cost = link.T @ link + beta[:, None, None] * (rate.T @ rate)
        pushed = command @ command.T / rho[:, None, None]
        held = riccati(a, pushed, cost)
        gain = command.T @ held
        feedback = (gain @ a) / (rho[:, None, None] + gain @ command)
        wide = np.block([[a, load], [np.zeros((1, states)), np.eye(1)]])
        seen = np.hstack([position, np.zeros((1, 1))])
        noise = np.zeros((len(rho), states + 1, states + 1))
        noise[:, :states, :states] = PUSHED[0] * load @ load.T + PUSHED[1] * command @ command.T
        noise[:, -1, -1] = walk
        spread = riccati(wide.T, seen.T @ seen / reading[:, None, None], noise)
        read = spread @ seen.T
        correction = wide @ read / (seen @ read + reading[:, None, None])
        output = np.concatenate([feedback, np.ones((len(rho), 1, 1))], axis=2)
        law = wide - np.vstack([command, np.zeros((1, 1))]) @ output - correction @ seen
        lost = ~np.isfinite(law).all(axis=(1, 2))
        law[lost], correction[lost], output[lost] = 2 * np.eye(states + 1), 0.0, 0.0  # which is unstable
        return law, correction, output

    def _expanded(self, x: Floats) -> tuple[Complexes, Complexes]:
        """Poles (batch, s) of the laws of coordinates x (batch, n) and their residues: the same ones serve every corner."""
        x = np.atleast_2d(x)
        rows = [one.tobytes() for one in x]
        found = [self._known.get(row) for row in rows]  # looked up once: other threads may empty it
        if missing := [k for k, one in enumerate(found) if one is None]:
            law, into, out = self._designed(x[missing])
            poles, vectors = np.linalg.eig(law)
            parts = (out @ vectors)[:, 0] * np.linalg.solve(vectors, into.astype(complex))[:, :, 0]
            for k, *pair in zip(missing, _with_integrator(poles), parts, strict=True):
                found[k] = pair[0], pair[1]
            if len(self._known) > MOST_KNOWN:
                self._known.clear()
            self._known.update({rows[k]: found[k] for k in missing})
        poles, parts = zip(*found, strict=True)
        return np.array(poles), np.array(parts)

    @cached_property
    def _known(self) -> dict[bytes, Any]:
        """Poles and residues by coordinates."""
        return {}

    def laws(self, x: Floats, omega: Floats, sample_times: Mapping[str, float]) -> list[Law]:
        poles, parts = self._expanded(x)
        z = np.exp(1j * omega * sample_times[HOST])
        response: Complexes = np.zeros((len(poles), len(omega)), dtype=complex)
        for k in range(poles.shape[1]):
            response += parts[:, k, None] / (z - poles[:, k, None])
        return [Law(HOST, self.position, response)]

    def unstable_poles(self, x: Floats) -> Floats:
        """Number (batch,) of poles of the law outside the unit circle."""
        return np.count_nonzero(np.abs(self._expanded(x)[0]) > 1, axis=1)

    def system(self, x: Floats, system: System, path: GainPath | None) -> System:
        assert self.model is not None
        law, into, out = (one[0] for one in self._designed(x))
        tick = self.model.sample_time
        poles = (self._expanded(x)[0][0] - 1) / tick
        space = StateSpace((law - np.eye(len(law))) / tick, into / tick, out, np.zeros((1, 1)))
        laws: dict[str, Any] = {self.position: factored(space, poles, tick)}
        return closed_with(system, Compensator(**laws), self.position)


def _with_integrator(poles: Complexes) -> Complexes:
    """Poles (batch, s) with that of the cancelled load torque, which is 1 but for round-off, at 1."""
    poles = poles.astype(complex)
    row, nearest = np.arange(len(poles)), np.argmin(np.abs(poles - 1), axis=1)
    near = np.abs(poles[row, nearest] - 1) < INTEGRATING
    poles[row[near], nearest[near]] = 1.0
    return poles


def riccati(a: Floats, pushed: Floats, cost: Floats) -> Floats:
    """Solutions X (batch, s, s) of X = Aᵀ X (1 + G X)⁻¹ A + Q by doubling (Chu, Fan, Lin and Wang 2004); A (s, s), G, Q (batch, s, s).

    NaN where the doubling does not settle.
    """
    batch, size = max(len(pushed), len(cost)), len(a)
    step = more = np.broadcast_to(a, (batch, size, size)).copy()
    g, h = (np.broadcast_to(one, (batch, size, size)).copy() for one in (pushed, cost))
    unit = np.eye(size)
    for _ in range(MOST_DOUBLINGS):
        turned = np.linalg.solve(unit + g @ h, np.concatenate([step, g], axis=2))
        through, behind = turned[..., :size], turned[..., size:]
        more = step.swapaxes(1, 2) @ h @ through
        g = g + step @ behind @ step.swapaxes(1, 2)
        h = h + more
        step = step @ through
        if np.all(np.abs(more).max(axis=(1, 2)) <= SETTLED * np.abs(h).max(axis=(1, 2))):
            return (h + h.swapaxes(1, 2)) / 2
    settled = np.abs(more).max(axis=(1, 2)) <= np.sqrt(SETTLED) * np.abs(h).max(axis=(1, 2))
    return np.where(settled[:, None, None], (h + h.swapaxes(1, 2)) / 2, np.nan)
