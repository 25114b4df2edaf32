"""Loops as products of roots, many at once, along the stability boundary: their response, and where a walk along it begins and ends."""

import math
from dataclasses import dataclass

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ..linear.transfer_function import Factored

TINY = 1e-12  # relative width at which bisection stops, a few thousand times the rounding of a double


@dataclass
class Batch:
    """m loops with k roots each, padded with pairs that cancel."""

    roots: Complexes  # (m, k)
    signs: Floats  # (m, k): +1 zero, −1 pole, 0 padding
    gain: Floats  # (m,)
    delay: Floats  # (m,)
    sample_time: float  # 0: continuous
    low: Floats  # (m,) where the walk begins
    high: Floats  # (m,) where it ends

    def evaluate(self, owner: Integers, omega: Floats) -> tuple[Complexes, Complexes]:
        """L(jω) and the terms of d log L/dω (len(omega), k), at `omega` of the loops `owner`."""
        if self.sample_time == 0:
            v = 1j * omega
            dv = np.full(len(omega), 1j)
        else:
            rotation = np.exp(0.5j * omega * self.sample_time)
            # (e^{jθ} − 1)/T_s = e^{jθ/2} 2j sin(θ/2)/T_s, without cancellation
            v = rotation * (2j / self.sample_time) * np.sin(0.5 * omega * self.sample_time)
            dv = 1j * rotation * rotation
        distance = v[:, None] - self.roots[owner]
        signs = self.signs[owner]
        with np.errstate(divide="ignore", invalid="ignore"):  # infinite on a pole
            factors = np.where(signs > 0, distance, 1.0) / np.where(signs < 0, distance, 1.0)
            value = np.prod(factors, axis=1) * (self.gain[owner] * np.exp(-1j * omega * self.delay[owner]))
            return value, signs * (dv[:, None] / np.where(signs != 0, distance, 1.0))


def prepared(loops: list[Factored], floor: float) -> tuple[Batch, Floats, Integers]:
    """The batch with its ends, arg L at small real s > 0, and the number of integrators of each loop."""
    loops = [loop.reduced for loop in loops]
    width = max(len(loop.zeros) + len(loop.poles) for loop in loops)
    roots: Complexes = np.zeros((len(loops), width), dtype=complex)
    signs = np.zeros((len(loops), width))
    for m, loop in enumerate(loops):
        both = np.concatenate([loop.zeros, loop.poles[np.argsort(np.abs(loop.poles))]])
        kinds = np.repeat([1.0, -1.0], [len(loop.zeros), len(loop.poles)])
        # Zero by pole, so that the product stays within range for any number of factors, far beyond all roots, too.
        order = np.argsort(np.concatenate([np.arange(len(loop.zeros)), np.arange(len(loop.poles))]), kind="stable")
        roots[m, : len(both)], signs[m, : len(both)] = both[order], kinds[order]
    sample_time = loops[0].sample_time or 0.0
    gain = np.array([loop.gain for loop in loops])
    delay = np.array([loop.delay for loop in loops])
    batch = Batch(roots, signs, gain, delay, sample_time, np.zeros(len(loops)), np.zeros(len(loops)))

    present = signs != 0
    at_zero = present & (roots == 0)
    integrators = -np.sum(signs * at_zero, axis=1).astype(int)
    flips = np.sum(present & (roots.imag == 0) & (roots.real > 0), axis=1) + (gain <= 0)
    start_phase = np.where(flips % 2 == 1, math.pi, 0.0)
    scale = np.min(np.where(present & ~at_zero, np.abs(roots), np.inf), axis=1, initial=np.inf)
    scale = np.minimum(scale, np.where(delay > 0, 1 / np.where(delay > 0, delay, 1.0), np.inf))
    plain = np.abs(gain) ** (1 / np.maximum(np.abs(integrators), 1))
    scale = np.where(np.isinf(scale), np.where(plain > 0, plain, 1.0), scale)
    _set_low(batch, scale, integrators)
    _set_high(batch, scale, floor)
    return batch, start_phase, integrators


def _set_low(batch: Batch, scale: Floats, integrators: Integers) -> None:
    """Begin at ω = 0, or low enough for the integrators (or differentiators) to rule."""
    everyone = np.arange(len(scale))
    low = 1e-3 * scale
    for _ in range(300):
        value, _ = batch.evaluate(everyone, low)
        ruling = np.where(integrators > 0, np.abs(value) > 10, np.abs(value) < 0.1)
        waiting = ~ruling & (integrators != 0) & (value != 0)
        if not waiting.any():
            break
        low[waiting] /= 4
    batch.low = np.where(integrators == 0, 0.0, low)


def _set_high(batch: Batch, scale: Floats, floor: float) -> None:
    """End at the Nyquist frequency, or where |L| stays below `floor`."""
    if batch.sample_time > 0:
        batch.high = np.full(len(scale), math.pi / batch.sample_time)
        return
    omega = scale[:, None] * 2.0 ** np.arange(1, 121)
    owner = np.repeat(np.arange(len(scale)), omega.shape[1])
    value, _ = batch.evaluate(owner, omega.ravel())
    floors = np.where(np.sum(batch.signs, axis=1) == 0, neutral_floor(batch.gain, floor), floor)
    below = _tail_bound(batch, omega, np.abs(value).reshape(omega.shape)) < floors[:, None]
    first = np.where(below.any(axis=1), np.argmax(below, axis=1), omega.shape[1] - 1)
    batch.high = omega[np.arange(len(scale)), first]


def neutral_floor(gain: Floats, floor: float) -> Floats:
    """Where the walk ends for loops with as many zeros as poles, whose |L| tends to |gain|: halfway from 1, closer with a lower `floor`."""
    return np.abs(gain) + (1 - np.abs(gain)) * min(500 * floor, 0.5)


def _tail_bound(batch: Batch, omega: Floats, magnitude: Floats) -> Floats:
    """Largest |L(jω')| for any ω' >= omega (m, j), continuous time, given |L(jω)| = magnitude (m, j).

    Zeros and as many of the slowest poles are bounded together, as |jω' − root|/ω'; each further pole by its least distance.
    """
    x, y = batch.roots.real[:, None, :], batch.roots.imag[:, None, :]
    signs, size2 = batch.signs[:, None, :], np.abs(batch.roots[:, None, :]) ** 2
    zeros = np.sum(batch.signs > 0, axis=1)[:, None, None]
    paired = np.cumsum(signs < 0, axis=2) <= zeros
    far = omega[:, :, None]
    # |jω' − root|²/ω'² is a convex quadratic in 1/ω', equal to 1 at ω' = ∞ and to `here` at ω
    here = (x**2 + (far - y) ** 2) / far**2
    vertex = (y > 0) & (far * y <= size2)
    least = np.where(vertex, x**2 / np.where(size2 > 0, size2, 1.0), np.minimum(1.0, here))
    nearest = np.where(y > far, x**2, x**2 + (far - y) ** 2) / far**2
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = np.where(signs > 0, np.maximum(1.0, here) / here, np.where(paired, here / least, here / nearest))
        bound = magnitude * np.sqrt(np.prod(np.where(signs != 0, growth, 1.0), axis=2))
    return np.where(np.sum(batch.signs, axis=1)[:, None] <= 0, np.nan_to_num(bound, nan=np.inf), np.inf)


def centers(batch: Batch) -> Floats:
    """(m, k) the frequency of the boundary point nearest to each root."""
    if batch.sample_time == 0:
        return batch.roots.imag
    return np.angle(1 + batch.sample_time * batch.roots) / batch.sample_time


def rates(batch: Batch) -> tuple[Floats, Booleans]:
    """(m, k) how fast each root grows [1/s], and whether it lies on the boundary."""
    rate = batch.roots.real + np.abs(batch.roots) ** 2 * batch.sample_time / 2
    return rate, np.abs(rate) <= 1e-13 * np.abs(batch.roots)


def breakpoints(batch: Batch) -> Floats:
    """(m, p) every ω > 0 where a slope term may have an extremum or a pole; NaN elsewhere. Axis roots give a pair around them."""
    rate, on_axis = rates(batch)
    center = centers(batch)
    spread = np.abs(batch.roots.real)
    shifts = np.zeros(1)
    if batch.sample_time > 0:
        radius = np.sqrt(np.maximum(1 + 2 * batch.sample_time * rate, 0.0))  # |z|
        spread = 2 * np.arctan(2 * batch.sample_time * np.abs(rate) / (1 + radius) ** 2) / batch.sample_time
        shifts = np.array([-1.0, 0.0, 1.0]) * 2 * math.pi / batch.sample_time
    spread = np.where(on_axis, 2 * TINY * np.abs(center), spread)
    points = np.stack([center - spread, center + spread, np.where(on_axis, np.nan, center)], axis=-1)[..., None] + shifts
    points = np.where(batch.signs[:, :, None, None] != 0, points, np.nan).reshape(len(batch.gain), -1)
    return np.where(points > 0, points, np.nan)
