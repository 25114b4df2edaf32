"""The sampled closed loop of one joint under PD, built from scratch and decided twice.

Torque is held for a tick and arrives T = (ticks + fraction) T_s late; the velocity is a backward difference,
u_k = −kp y_k − kd (y_k − y_{k−1})/T_s. `spectral_radius` is that of the whole closed-loop matrix in double
precision; `is_stable` takes the characteristic polynomial in DIGITS digits (matrix exponential by Taylor,
Faddeev-LeVerrier) and applies Schur-Cohn to it, so it still decides where eigenvalues are too coarse.
"""

from dataclasses import replace
from functools import lru_cache
from math import isinf

import mpmath
import numpy as np
from scipy.linalg import expm

from .joint import PDJoint

DIGITS = 70  # Schur-Cohn loses about a digit per reflection coefficient near ±1; joints here stay below 30 lost


def state_space(joint: PDJoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(A, b, c) of plant and current loop: torque command → fed-back position, no delay."""
    if joint.rigid:
        inertia, viscous = joint.motor_inertia + joint.link_inertia, joint.motor_viscous + joint.link_viscous
        a, b, c = np.array([[0, 1], [0, -viscous / inertia]]), np.array([0, 1 / inertia]), np.array([1.0, 0])
    else:
        spring = np.array([joint.stiffness, joint.damping, -joint.stiffness, -joint.damping])  # · (θ, θ̇, q, q̇)
        a = np.zeros((4, 4))
        a[0, 1] = a[2, 3] = 1
        a[1], a[3] = -spring / joint.motor_inertia, spring / joint.link_inertia
        a[1, 1] -= joint.motor_viscous / joint.motor_inertia
        a[3, 3] -= joint.link_viscous / joint.link_inertia
        b = np.array([0, 1 / joint.motor_inertia, 0, 0])
        c = np.array([1.0, 0, 0, 0] if joint.feedback == "motor" else [0, 0, 1.0, 0])
    if isinf(joint.bandwidth):
        return a, b, c
    n, bandwidth = len(a), joint.bandwidth
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n] = a, b
    whole[n, n + 1] = 1
    whole[n + 1, n:] = -(bandwidth**2), -2 * joint.damping_ratio * bandwidth
    return whole, np.append(np.zeros(n + 1), bandwidth**2), np.append(c, [0, 0])


def delay_ticks(joint: PDJoint, sample_time: float) -> tuple[int, float]:
    """Whole ticks, and the remaining delay [s] in [0, T_s); a remainder within rounding of a tick is a tick."""
    ticks = int(np.floor(joint.delay / sample_time + 1e-12))
    return ticks, max(joint.delay - ticks * sample_time, 0.0)


def discretise(joint: PDJoint, sample_time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(Φ, Γ_old, Γ_new, c): x_{k+1} = Φ x_k + Γ_old u_{k−ticks−1} + Γ_new u_{k−ticks}; the older one acts first."""
    a, b, c = state_space(joint)
    n = len(a)
    _, late = delay_ticks(joint, sample_time)
    augmented = np.block([[a, b[:, None]], [np.zeros((1, n + 1))]])
    first, second = expm(augmented * late), expm(augmented * (sample_time - late))
    return second[:n, :n] @ first[:n, :n], second[:n, :n] @ first[:n, n], second[:n, n], c


def closed_loop_matrix(joint: PDJoint, sample_time: float) -> np.ndarray:
    """x_{k+1} = M x_k, states (plant and drive, y_{k−1}, u_{k−1} … u_{k−ticks−1})."""
    phi, older, newer, c = discretise(joint, sample_time)
    n = len(phi)
    ticks, _ = delay_ticks(joint, sample_time)
    size = n + 1 + ticks + 1
    matrix = np.zeros((size, size))
    control = np.zeros(size)
    control[:n], control[n] = -(joint.kp + joint.kd / sample_time) * c, joint.kd / sample_time
    matrix[:n, :n] = phi
    matrix[:n, n + 1 + ticks] += older
    if ticks == 0:
        matrix[:n] += np.outer(newer, control)
    else:
        matrix[:n, n + ticks] += newer
    matrix[n, :n] = c
    matrix[n + 1] = control
    for i in range(n + 2, size):
        matrix[i, i - 1] = 1
    return matrix


def spectral_radius(joint: PDJoint, sample_time: float) -> float:
    """Largest |eigenvalue| of the closed-loop matrix; accurate to about 1e-11."""
    return float(np.abs(np.linalg.eigvals(closed_loop_matrix(joint, sample_time))).max())


def is_stable(joint: PDJoint, sample_time: float) -> bool:
    """All closed-loop eigenvalues inside the unit circle, decided by Schur-Cohn in extended precision."""
    with mpmath.workdps(DIGITS):
        kp, rate = mpmath.mpf(joint.kp), mpmath.mpf(joint.kd) / mpmath.mpf(sample_time)
        return is_stable_with(joint, sample_time, [-rate, kp + rate], [0, 1])


def is_stable_with(joint: PDJoint, sample_time: float, controller_numerator: list, controller_denominator: list) -> bool:
    """The same with any controller D(z) in place of kp + kd (z − 1)/(z T_s): ascending coefficients."""
    with mpmath.workdps(DIGITS):
        ticks, _ = delay_ticks(joint, sample_time)
        denominator, held_old, held_new = _sampled_plant(replace(joint, kp=0.0, kd=0.0), sample_time)
        # z^{ticks+1} det(zI − Φ) D_den(z) + D_num(z) c adj(zI − Φ) (Γ_new z + Γ_old)
        forward = np.convolve(np.append(held_old, 0) + np.append(0, held_new), _to_mpf(np.array(controller_numerator)))
        whole = np.convolve(denominator, _to_mpf(np.array(controller_denominator)))
        whole = np.append(_to_mpf(np.zeros(ticks + 1)), whole)
        whole[: len(forward)] += forward
        return _schur_cohn(whole)


@lru_cache(maxsize=4)
def _sampled_plant(joint: PDJoint, sample_time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """det(zI − Φ), c adj(zI − Φ) Γ_old, c adj(zI − Φ) Γ_new: ascending mpf coefficients (Faddeev-LeVerrier)."""
    a, b, c = state_space(joint)
    n = len(a)
    ticks, _ = delay_ticks(joint, sample_time)
    period = mpmath.mpf(sample_time)
    late = max(mpmath.mpf(joint.delay) - ticks * period, mpmath.mpf(0))
    augmented = _to_mpf(np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]))
    first, second = _exponential(augmented * late), _exponential(augmented * (period - late))
    phi = second[:n, :n] @ first[:n, :n]
    older, newer = second[:n, :n] @ first[:n, n], second[:n, n]
    identity = _to_mpf(np.eye(n))
    adjugate, coefficients, outputs = identity, [mpmath.mpf(1)], []
    for k in range(1, n + 1):
        outputs.append(_to_mpf(c) @ adjugate)
        product = phi @ adjugate
        coefficients.append(-np.trace(product) / k)
        adjugate = product + coefficients[-1] * identity
    rows = np.array(outputs[::-1], dtype=object)
    return np.array(coefficients[::-1], dtype=object), rows @ older, rows @ newer


def _to_mpf(array: np.ndarray) -> np.ndarray:
    return np.vectorize(mpmath.mpf, otypes=[object])(array)


def _exponential(matrix: np.ndarray) -> np.ndarray:
    """e^matrix by Taylor with scaling and squaring, to more than the working precision; in fixed point, which is ten times faster."""
    sizes = [abs(x) for x in matrix.flat if x]
    if not sizes:
        return _to_mpf(np.eye(len(matrix)))
    norm = float(max(sum(abs(x) for x in row) for row in matrix))
    halvings = max(0, int(np.ceil(np.log2(norm))) + 8)
    # The smallest entry keeps all its digits, through as many squarings as there are
    bits = mpmath.mp.prec + 3 * halvings + 2 * abs(mpmath.mag(min(sizes))) + 2 * abs(mpmath.mag(max(sizes))) + 64
    fixed = np.vectorize(lambda x: int(mpmath.nint(mpmath.ldexp(x, bits - halvings))), otypes=[object])(matrix)
    one = np.array([[int(i == k) << bits for k in range(len(matrix))] for i in range(len(matrix))], dtype=object)
    total = term = one
    k = 0
    while any(term.flat):
        k += 1
        term = ((term @ fixed) >> bits) // k
        term[term == -1] = 0  # rounding is downwards: −1 would never end
        total = total + term
    for _ in range(halvings):
        total = (total @ total) >> bits
    return np.vectorize(lambda x: mpmath.ldexp(mpmath.mpf(x), -bits), otypes=[object])(total)


def _schur_cohn(ascending: np.ndarray) -> bool:
    """All zeros of a real polynomial inside the unit circle."""
    polynomial = ascending
    while len(polynomial) > 1:
        reflection = polynomial[0] / polynomial[-1]
        if abs(reflection) >= 1:
            return False
        polynomial = (polynomial - reflection * polynomial[::-1])[1:]
    return True
