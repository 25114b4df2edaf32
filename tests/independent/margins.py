"""Return ratios straight from the equations of motion, and margins read off a dense grid."""

from collections.abc import Callable
from dataclasses import dataclass
from math import isinf, pi

import numpy as np

from . import sampled
from .joint import PDJoint, polynomials


def response(joint: PDJoint, omega: np.ndarray, sample_time: float | None = None) -> np.ndarray:
    """L(jω) or L(e^{jωT_s}), shape (len(omega),)."""
    s = 1j * np.asarray(omega, dtype=float)
    if sample_time is None:
        denominator, numerator, controller = polynomials(joint)
        whole = np.polyval(numerator[::-1], s) * np.polyval(controller[::-1], s) / np.polyval(denominator[::-1], s)
        return whole * np.exp(-s * joint.delay)
    z = np.exp(s * sample_time)
    difference = (1 - 1 / z) / sample_time
    return (joint.kp + joint.kd * difference) * sampled_plant(joint, z, sample_time)


def sampled_plant(joint: PDJoint, z: np.ndarray, sample_time: float) -> np.ndarray:
    """Torque command → fed-back position at the sampling instants: hold, delay, drive and plant; one solve per z."""
    phi, older, newer, c = sampled.discretise(joint, sample_time)
    ticks, _ = sampled.delay_ticks(joint, sample_time)
    held = newer[None, :] + older[None, :] / z[:, None]
    states = np.linalg.solve(z[:, None, None] * np.eye(len(phi)) - phi, held[:, :, None])[:, :, 0]
    return states @ c * z ** (-float(ticks))


def frequency_grid(joint: PDJoint, sample_time: float | None = None, points: int = 40_000) -> np.ndarray:
    """Logarithmic from far below crossover to far above it (or to Nyquist), and dense at both resonances [rad/s]."""
    inertia = joint.motor_inertia + joint.link_inertia
    delay_rate = 1 / max(joint.delay, 1e-6)
    zero = abs(joint.kp / joint.kd) if joint.kd else delay_rate
    drive = 0.0 if isinf(joint.bandwidth) else joint.bandwidth
    resonances = []
    if not joint.rigid:
        locked = joint.stiffness / joint.link_inertia
        resonances = [np.sqrt(locked), np.sqrt(locked + joint.stiffness / joint.motor_inertia)]
    slowest = min(zero, np.sqrt(abs(joint.kp) / inertia), delay_rate)
    fastest = max(delay_rate, drive, abs(joint.kd) / joint.motor_inertia, *resonances)
    parts = [np.geomspace(1e-3 * slowest, 30 * fastest, points)]
    for centre in resonances:
        offsets = centre * np.geomspace(1e-7, 0.3, 1500)
        parts += [centre - offsets, centre + offsets]
    grid = np.unique(np.concatenate(parts))
    return grid if sample_time is None else np.append(grid[grid < pi / sample_time * (1 - 1e-9)], pi / sample_time)


@dataclass(frozen=True)
class GridMargins:
    """Of a stable loop: factors, radians; inf and 0 where there is no crossing."""

    gain_margin: float
    lower_gain_margin: float
    phase_margin: float
    peak_sensitivity: float


def grid_margins(joint: PDJoint, sample_time: float | None = None) -> GridMargins:
    return margins_on_grid(response(joint, frequency_grid(joint, sample_time), sample_time))


def margins_on_grid(loop: np.ndarray) -> GridMargins:
    """Margins between neighbouring points of L on a dense grid by straight lines: about four digits, fewer where L turns in between."""
    before, after = loop[:-1], loop[1:]
    share = np.divide(before.imag, before.imag - after.imag, where=before.imag != after.imag, out=np.zeros(len(before)))
    real = before.real + share * (after.real - before.real)
    crossing = (np.sign(before.imag) != np.sign(after.imag)) & (real < 0)
    factors = -1 / real[crossing]
    size = np.log(np.abs(loop))
    unity = np.sign(size[:-1]) != np.sign(size[1:])
    share = (size[:-1] / (size[:-1] - size[1:]))[unity]
    turned = np.angle(after[unity] / before[unity])
    phases = np.angle(-before[unity] * np.exp(1j * share * turned))
    return GridMargins(
        gain_margin=min(factors[factors > 1], default=np.inf),
        lower_gain_margin=max(factors[factors < 1], default=0.0),
        phase_margin=min(np.abs(phases), default=np.inf),
        peak_sensitivity=1 / np.abs(1 + loop).min(),
    )


def peak(joint: PDJoint, measure: Callable[[np.ndarray], np.ndarray], sample_time: float | None = None) -> float:
    """Largest value of measure(L) over frequency: the best of the dense grid, then of ever finer ones there."""
    omega = frequency_grid(joint, sample_time)
    for _ in range(5):  # each is about 100 times finer
        height = measure(response(joint, omega, sample_time))
        best = int(np.argmax(height))
        omega = np.linspace(omega[max(best - 1, 0)], omega[min(best + 1, len(omega) - 1)], 201)
    return float(height[best])
