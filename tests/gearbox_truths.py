"""Gain limits and margins of one joint by other formulas: the loop's closed form, and the eigenvalues of a tick."""

import math

import numpy as np
from scipy.linalg import expm

import gainroom as gr

MARGIN = 2.0


def continuous_limit(joint: gr.ElasticJoint, kp: float, kd: float, delay: float) -> float:
    """The smallest g with g L(jω) = −1, L in closed form: gains near 0 are stable, so that no root has crossed below it."""
    omega = np.geomspace(1e-2, 1e5, 60_001)
    s = 1j * omega
    J, load = joint.motor_inertia, joint.link_inertia
    spring = 1 / (joint.stiffness + joint.damping * s)
    plant = (load * s**2 * spring + 1) / (s**2 * (J * load * s**2 * spring + J + load))
    loop = (kp + kd * s) * np.exp(-s * delay) * plant
    crosses = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0) & (loop.real[:-1] < 0))
    share = loop.imag[crosses] / (loop.imag[crosses] - loop.imag[crosses + 1])
    return float(np.min(-1 / (loop.real[crosses] + share * np.diff(loop.real)[crosses])))


def sampled_stable(joint: gr.ElasticJoint, kp: float, kd: float, ticks: int, step: float) -> bool:
    """The eigenvalues of one tick: torque held, `ticks` of delay in a row of registers, velocity by backward difference."""
    J, load, K, B = joint.motor_inertia, joint.link_inertia, joint.stiffness, joint.damping
    a = np.array([[0, 1, 0, 0], [-K / J, -B / J, K / J, B / J], [0, 0, 0, 1], [K / load, B / load, -K / load, -B / load]])
    b = np.array([[0], [1 / J], [0], [0]])
    if math.isinf(K):
        a, b = np.array([[0.0, 1], [0, 0]]), np.array([[0], [1 / (J + load)]])
    whole = expm(step * np.block([[a, b], [np.zeros((1, len(a) + 1))]]))
    size = len(a)
    tick = np.zeros((size + 1 + ticks, size + 1 + ticks))  # plant, position one tick ago, torques on their way
    tick[:size, :size] = whole[:size, :size]
    tick[size, 0] = 1.0
    law = np.zeros(size + 1 + ticks)
    law[0], law[size] = -(kp + kd / step), kd / step
    if ticks:
        tick[:size, -1] = whole[:size, size]
        tick[size + 1] = law
        tick[np.arange(size + 2, size + 1 + ticks), np.arange(size + 1, size + ticks)] = 1.0
    else:
        tick[:size] += np.outer(whole[:size, size], law)
    return bool(np.abs(np.linalg.eigvals(tick)).max() < 1)


def has_margin(joint: gr.ElasticJoint, kp: float, kd: float, delay: float, step: float | None, margin: float = MARGIN) -> bool:
    """No factor from 1 to `margin` makes it vibrate."""
    if step is None:
        return continuous_limit(joint, kp, kd, delay) >= margin
    return all(sampled_stable(joint, g * kp, g * kd, round(delay / step), step) for g in np.geomspace(1, margin, 9))
