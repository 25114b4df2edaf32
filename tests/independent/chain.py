"""A chain of inertias on springs, driven at its first, followed by the classical Runge-Kutta method with small steps.

A joint is a chain of two; three show what a two-mass model cannot be. The command is held for a tick and arrives whole ticks late; the
drive makes it through a second-order current loop; Coulomb friction is smoothed by tanh. Nothing here knows matrix exponentials.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Chain:
    """Inertias (n,), springs and dampers (n − 1,), Coulomb torque on the first and on the last, current loop, steps of the encoder.

    hardening   of every spring: torque per deflection³ beside its stiffness [N m/rad³]; limit: of the torque [N m]
    """

    inertia: Sequence[float]
    stiffness: Sequence[float]
    damping: Sequence[float]
    coulomb: float = 0.0
    last_coulomb: float = 0.0
    bandwidth: float = 4000.0
    damping_ratio: float = 0.9
    resolution: float = 0.0
    softness: float = 0.002
    hardening: float = 0.0
    limit: float = math.inf

    def slope(self, x: list[float], demand: float) -> list[float]:
        """d/dt of positions (n,), velocities (n,), torque and its rate; in plain numbers, as so few are slow as arrays."""
        count, w = len(self.inertia), self.bandwidth
        velocity, torque, rate = x[count : 2 * count], x[-2], x[-1]
        force = [0.0] * count
        for k in range(count - 1):
            stretch, rates = x[k] - x[k + 1], velocity[k] - velocity[k + 1]
            spring = self.stiffness[k] * stretch + self.hardening * stretch * stretch * stretch + self.damping[k] * rates
            force[k] -= spring
            force[k + 1] += spring
        force[0] += torque - self.coulomb * math.tanh(velocity[0] / self.softness)
        force[-1] -= self.last_coulomb * math.tanh(velocity[-1] / self.softness)
        demand = min(max(demand, -self.limit), self.limit)
        acceleration = [each / inertia for each, inertia in zip(force, self.inertia, strict=True)]
        return [*velocity, *acceleration, rate, w * w * (demand - torque) - 2 * self.damping_ratio * w * rate]


def record(
    chain: Chain, command: Callable[[int, float], float], ticks: int, tick: float, late: int, substeps: int = 8
) -> dict[str, np.ndarray]:
    """Columns of a log (ticks,): `command` makes the target torque from the tick's number and the motor's reading."""
    count = len(chain.inertia)
    x, step = [0.0] * (2 * count + 2), tick / substeps
    sent = np.zeros(ticks)
    columns = {name: np.zeros(ticks) for name in ("target_torque", "actual_torque", "motor_position", "link_position")}
    for k in range(ticks):
        reading = [x[0], x[count - 1]]
        if chain.resolution:
            reading = [chain.resolution * float(np.floor(value / chain.resolution + 0.5)) for value in reading]
        sent[k] = command(k, reading[0])
        for name, value in zip(columns, (sent[k], x[-2], *reading), strict=True):
            columns[name][k] = value
        demand = float(sent[k - late]) if k >= late else 0.0
        for _ in range(substeps):
            first = chain.slope(x, demand)
            second = chain.slope([a + step / 2 * b for a, b in zip(x, first, strict=True)], demand)
            third = chain.slope([a + step / 2 * b for a, b in zip(x, second, strict=True)], demand)
            fourth = chain.slope([a + step * b for a, b in zip(x, third, strict=True)], demand)
            x = [a + step / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in zip(x, first, second, third, fourth, strict=True)]
    return columns


def multisine(frequencies: np.ndarray, ticks: int, tick: float, seed: int) -> np.ndarray:
    """(ticks,) of unit standard deviation, with random phases; frequencies (k,) [Hz]."""
    time, phases = np.arange(ticks) * tick, np.random.default_rng(seed).uniform(0, 2 * np.pi, len(frequencies))
    values = np.sin(2 * np.pi * np.outer(frequencies, time) + phases[:, None]).sum(axis=0)
    return values / values.std()
