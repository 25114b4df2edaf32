"""Elastic joints in time, integrated to the last digits between the instants at which a torque changes (method of steps).

Every joint j keeps its demand u_j[k] from k T_s + T_j on, until the next one arrives. In between, the differential equations of motors,
links and current loops are smooth, and an eighth-order method (DOP853) follows them to 1e-13. Nothing here knows matrix exponentials.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class Joints:
    """n elastic joints; every array (n,) but inverse_inertia W (n, n) and gravity_stiffness (n, n)."""

    motor_inertia: np.ndarray
    inverse_inertia: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    bandwidth: np.ndarray
    damping_ratio: np.ndarray
    delay: np.ndarray
    motor_viscous: np.ndarray | float = 0.0
    link_viscous: np.ndarray | float = 0.0
    gravity_stiffness: np.ndarray | float = 0.0
    forces: Callable | None = field(default=None)
    """(θ, q, θ̇, q̇) → further torques on (motors, links), smooth."""

    def slope(self, state, demand, motor_torque, link_torque):
        """d/dt of (θ, q, θ̇, q̇, τ, τ̇) (6, n) flat."""
        motor, link, motor_rate, link_rate, torque, torque_rate = state.reshape(6, -1)
        spring = self.stiffness * (motor - link) + self.damping * (motor_rate - link_rate)
        on_motor = torque - spring - self.motor_viscous * motor_rate + motor_torque
        on_link = spring - self.link_viscous * link_rate + link_torque - np.dot(self.gravity_stiffness, link)
        if self.forces is not None:
            further = self.forces(motor, link, motor_rate, link_rate)
            on_motor, on_link = on_motor + further[0], on_link + further[1]
        ideal = np.isinf(self.bandwidth)
        w = np.where(ideal, 0.0, self.bandwidth)
        current = w**2 * (demand - torque) - 2 * self.damping_ratio * w * torque_rate
        return np.concatenate(
            [
                motor_rate,
                link_rate,
                on_motor / self.motor_inertia,
                self.inverse_inertia @ on_link,
                torque_rate,
                np.where(ideal, 0.0, current),
            ]
        )


def run(
    joints: Joints,
    control: Callable[[int, np.ndarray, np.ndarray], np.ndarray],
    ticks: int,
    sample_time: float,
    start: np.ndarray,
    motor_torque: np.ndarray | None = None,
    link_torque: np.ndarray | None = None,
    rtol: float = 1e-13,
) -> dict[str, np.ndarray]:
    """`ticks` rows from `start` (4, n): θ, q, θ̇, q̇. control(k, θ, q) → u_k (n,). Disturbing torques (ticks, n) are held over ticks."""
    size = len(joints.motor_inertia)
    nothing = np.zeros((ticks, size))
    motor_torque = nothing if motor_torque is None else motor_torque
    link_torque = nothing if link_torque is None else link_torque
    ideal = np.isinf(joints.bandwidth)
    state = np.concatenate([np.ravel(start), np.zeros(2 * size)])
    sent = np.zeros((ticks, size))
    rows: dict[str, list] = {name: [] for name in ("motor", "link", "target", "demand", "actual")}

    def demand_at(time: float) -> np.ndarray:
        newest = np.floor((time - joints.delay) / sample_time + 1e-9).astype(int)
        return np.array([sent[k, j] if k >= 0 else 0.0 for j, k in enumerate(newest)])

    for k in range(ticks):
        begin, end = k * sample_time, (k + 1) * sample_time
        sent[k] = control(k, state[:size], state[size : 2 * size])
        demand = demand_at(begin)
        rows["motor"].append(state[:size].copy())
        rows["link"].append(state[size : 2 * size].copy())
        rows["target"].append(sent[k])
        rows["demand"].append(demand)
        rows["actual"].append(np.where(ideal, demand, state[4 * size : 5 * size]))
        late = np.mod(joints.delay, sample_time)
        late = late[(late > 1e-9 * sample_time) & (late < sample_time * (1 - 1e-9))]
        instants = np.unique(np.concatenate([[begin], begin + late, [end]]))
        for first, last in pairwise(instants):
            demand = demand_at((first + last) / 2)
            state[4 * size : 5 * size] = np.where(ideal, demand, state[4 * size : 5 * size])
            solved = solve_ivp(
                lambda _, x, k=k, demand=demand: joints.slope(x, demand, motor_torque[k], link_torque[k]),
                (0.0, last - first),
                state,
                method="DOP853",
                rtol=rtol,
                atol=1e-16,
            )
            state = solved.y[:, -1].copy()
    return {name: np.array(values) for name, values in rows.items()}
