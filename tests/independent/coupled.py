"""Unstable roots of several coupled elastic joints under full gain matrices, from the textbook's equations.

    J θ̈ = τ_m − τ_J,  τ_J = K (θ − q) + B (θ̇ − q̇),  q̈ = W τ_J,  τ_m = −C e^{−sT} (Kp + s Kd) θ

Continuous: the argument principle on the determinant of those equations, dense in frequency. Sampled: eigenvalues of the closed loop with
hold, whole ticks of delay and backward difference. Roots at s = 0, of motions that the gains leave free, are not counted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True)
class Coupled:
    """W (n, n), motor_inertia, stiffness, damping (n,), kp, kd (n, n), delay [s], bandwidth [rad/s], damping_ratio of the current loops."""

    inverse_inertia: np.ndarray
    motor_inertia: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    delay: float
    bandwidth: float
    damping_ratio: float


def determinant(joints: Coupled, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """sign, log|.| of the characteristic determinant, times the current loops' denominators, at jω."""
    s = 1j * omega[:, None, None]
    n = len(joints.motor_inertia)
    lag = s**2 + 2 * joints.damping_ratio * joints.bandwidth * s + joints.bandwidth**2
    spring = np.eye(n) * (joints.stiffness + s * joints.damping)
    fed_back = joints.bandwidth**2 * np.exp(-s * joints.delay) * (joints.kp + s * joints.kd)
    matrix = np.zeros((len(omega), 2 * n, 2 * n), dtype=complex)
    matrix[:, :n, :n] = lag * (np.diag(joints.motor_inertia) * s**2 + spring) + fed_back
    matrix[:, :n, n:] = -lag * spring
    matrix[:, n:, :n] = -joints.inverse_inertia @ spring
    matrix[:, n:, n:] = s**2 * np.eye(n) + joints.inverse_inertia @ spring
    return np.linalg.slogdet(matrix)


def count_unstable(joints: Coupled, near: float = 0.0) -> int:
    """Roots with Re s > 0. `near` [rad/s]: a frequency around which to look closely."""
    # Below 1e-2 rad/s round-off of the springs hides the motions that nothing holds.
    n, highest = len(joints.motor_inertia), 50 * joints.bandwidth
    resonances = np.sqrt(joints.stiffness.max() * (1 / joints.motor_inertia.min() + np.linalg.eigvalsh(joints.inverse_inertia)[-1]))
    omega = [np.geomspace(1e-2, highest, 6000), np.linspace(1.0, 4 * resonances, 5000)]
    if near:
        omega.append(near * (1 + np.concatenate([[0.0], *(sign * np.geomspace(1e-7, 0.05, 150) for sign in (-1, 1))])))
    omega = np.unique(np.concatenate(omega))
    sign, size = determinant(joints, omega)
    for _ in range(40):
        # Twice as many joints as angles may turn together: halve until a step turns the determinant by little, and its halves agree
        turn = np.angle(sign[1:] * sign[:-1].conj())
        rough = np.flatnonzero((np.abs(turn) > 0.5) & (np.diff(omega) > 1e-10 * omega[1:]))
        if not len(rough):
            break
        middle = 0.5 * (omega[rough] + omega[rough + 1])
        more = determinant(joints, middle)
        omega, sign, size = (np.insert(old, rough + 1, new) for old, new in zip((omega, sign, size), (middle, *more), strict=True))
    at_zero = round((size[1] - size[0]) / np.log(omega[1] / omega[0]))
    degree = 6 * n
    turned = np.angle(sign[1:] * sign[:-1].conj()).sum()
    turned -= np.angle(sign[-1] / 1j**degree)  # from the last sample on it settles on (jω)^degree times a positive number
    return round(((degree - at_zero) * np.pi / 2 - turned) / np.pi)


def sampled_radius(joints: Coupled, sample_time: float, ticks: int) -> float:
    """Largest |z| of the closed loop, those at z = 1 aside."""
    n = len(joints.motor_inertia)
    zero, eye = np.zeros((n, n)), np.eye(n)
    k, b, j = np.diag(joints.stiffness), np.diag(joints.damping), np.diag(1 / joints.motor_inertia)
    w, square, slow = joints.inverse_inertia, joints.bandwidth**2, 2 * joints.damping_ratio * joints.bandwidth
    a = np.block([
        [zero, eye, zero, zero, zero, zero],
        [-j @ k, -j @ b, j @ k, j @ b, j, zero],
        [zero, zero, zero, eye, zero, zero],
        [w @ k, w @ b, -w @ k, -w @ b, zero, zero],
        [zero, zero, zero, zero, zero, eye],
        [zero, zero, zero, zero, -square * eye, -slow * eye],
    ])  # fmt: skip
    force = np.vstack([zero, zero, zero, zero, zero, square * eye])
    both = expm(sample_time * np.block([[a, force], [np.zeros((n, 7 * n))]]))
    step, push = both[: 6 * n, : 6 * n], both[: 6 * n, 6 * n :]
    position = np.hstack([eye, np.zeros((n, 5 * n))])
    # states: x, the last position, and the commands on their way
    size = 7 * n + ticks * n
    closed = np.zeros((size, size))
    command = np.zeros((n, size))
    command[:, : 6 * n] = -(joints.kp + joints.kd / sample_time) @ position
    command[:, 6 * n : 7 * n] = joints.kd / sample_time
    closed[: 6 * n, : 6 * n] = step
    if ticks:
        closed[: 6 * n, -n:] = push
        closed[7 * n : 8 * n] = command
        for tick in range(1, ticks):
            closed[(7 + tick) * n : (8 + tick) * n, (6 + tick) * n : (7 + tick) * n] = eye
    else:
        closed[: 6 * n] += push @ command
    closed[6 * n : 7 * n, : 6 * n] = position
    values = np.linalg.eigvals(closed)
    return float(np.abs(values[np.abs(values - 1) > 1e-4]).max())
