"""One joint, its drive and its PD gains, as plain numbers, and their random draws."""

from dataclasses import dataclass, replace
from math import inf, isinf, pi
from typing import Any

import numpy as np


@dataclass(frozen=True)
class PDJoint:
    """Two-mass joint under PD; SI units, joint side. stiffness=inf: rigid; bandwidth=inf: ideal current loop."""

    motor_inertia: float
    link_inertia: float
    stiffness: float
    damping: float
    kp: float
    kd: float
    delay: float = 0.0
    bandwidth: float = inf
    damping_ratio: float = 0.9
    motor_viscous: float = 0.0
    link_viscous: float = 0.0
    feedback: str = "motor"

    @property
    def rigid(self) -> bool:
        return isinf(self.stiffness)

    def scaled(self, factor: float) -> "PDJoint":
        """The same joint with both gains times `factor`."""
        return replace(self, kp=self.kp * factor, kd=self.kd * factor)


def polynomials(joint: PDJoint, number: Any = float) -> tuple[list, list, list]:
    """(plant denominator × current loop denominator, plant numerator × current loop numerator, D).

    Coefficients in ascending powers of s, computed with the type `number` (float, Fraction, mpf), so that
    the return ratio is L(s) = e^{-sT} numerator · D / denominator. From J_m θ̈ + b_m θ̇ = τ − k(θ−q),
    J_L q̈ + b_L q̇ = k(θ−q), k = K + sB: determinant s·[…], numerators J_L s² + b_L s + k (motor), k (link).
    """
    jm, jl = number(joint.motor_inertia), number(joint.link_inertia)
    bm, bl = number(joint.motor_viscous), number(joint.link_viscous)
    zero, one = number(0), number(1)
    if joint.rigid:
        plant, numerator = [zero, bm + bl, jm + jl], [one]
    else:
        stiffness, damping = number(joint.stiffness), number(joint.damping)
        spring = [stiffness, damping]
        both_free = multiply([bm, jm], [bl, jl])  # (J_m s + b_m)(J_L s + b_L), still to be multiplied by s²
        together = multiply(spring, [bm + bl, jm + jl])  # k · (sum of both), still to be multiplied by s
        plant = add([zero, zero, *both_free], [zero, *together])
        numerator = add(spring, [zero, bl, jl]) if joint.feedback == "motor" else spring
    if not isinf(joint.bandwidth):
        bandwidth = number(joint.bandwidth)
        plant = multiply(plant, [bandwidth**2, 2 * number(joint.damping_ratio) * bandwidth, one])
        numerator = [bandwidth**2 * c for c in numerator]
    return plant, numerator, [number(joint.kp), number(joint.kd)]


def multiply(p: list, q: list) -> list:
    """Product of two polynomials (ascending coefficients)."""
    out = [p[0] * 0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for k, b in enumerate(q):
            out[i + k] = out[i + k] + a * b
    return out


def add(p: list, q: list) -> list:
    """Sum of two polynomials (ascending coefficients)."""
    longer, shorter = (p, q) if len(p) >= len(q) else (q, p)
    return [c + (shorter[i] if i < len(shorter) else 0) for i, c in enumerate(longer)]


def random_joint(rng: np.random.Generator) -> PDJoint:
    """Resonance 5 to 150 Hz, delay 0.5 to 20 ms, damping ratio 0.1 to 5 %, inertia ratio 0.05 to 20.

    The gains point anywhere in units of (J ω², J ω) with ω = 1/(4T), so that directions spread over what a delay of T
    allows; four draws in five have both gains positive.
    """
    resonance = 2 * pi * np.exp(rng.uniform(np.log(5), np.log(150)))
    delay = np.exp(rng.uniform(np.log(0.5e-3), np.log(20e-3)))
    mode_damping = np.exp(rng.uniform(np.log(0.1e-2), np.log(5e-2)))
    motor_inertia = np.exp(rng.uniform(np.log(0.05), np.log(2.0)))
    link_inertia = motor_inertia * np.exp(rng.uniform(np.log(0.05), np.log(20.0)))
    reduced = motor_inertia * link_inertia / (motor_inertia + link_inertia)
    angle = rng.uniform(0, pi / 2) if rng.random() < 0.8 else rng.uniform(-pi, pi)
    crossover = 1 / (4 * delay)
    return PDJoint(
        motor_inertia=float(motor_inertia),
        link_inertia=float(link_inertia),
        stiffness=float(reduced * resonance**2),
        damping=float(2 * mode_damping * resonance * reduced),
        kp=float(np.cos(angle) * (motor_inertia + link_inertia) * crossover**2),
        kd=float(np.sin(angle) * (motor_inertia + link_inertia) * crossover),
        delay=float(delay),
        bandwidth=inf if rng.random() < 0.15 else float(np.exp(rng.uniform(np.log(500), np.log(6000)))),
        damping_ratio=float(rng.uniform(0.5, 1.1)),
        feedback="link" if rng.random() < 0.2 else "motor",
    )
