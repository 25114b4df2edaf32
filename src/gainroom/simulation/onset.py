"""Onset of vibration by repeated simulation: an independent check of a computed limit.

No frequency response is used. A run starts with an impulse; the growth rate of its fastest-growing oscillation shows on which side of
the limit the gains are.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError, require_positive
from ..system.loop import Loop
from .oscillation import Vibration, vibration
from .run import simulate
from .scenario import Scenario

FURTHEST_FACTOR = 1e3  # factors on the gains beyond this, or below its inverse, are not tried
MOST_RUNS = 100  # runs


@dataclass(frozen=True)
class Onset:
    """Gain at which the growth rate changes sign, between `stable` and `growing`; frequency there [rad/s]; number of runs."""

    gain: float
    frequency: float
    stable: float
    growing: float
    runs: int


def find_onset(vibration_at: Callable[[float], Vibration | None], stable: float, growing: float, tolerance: float = 1e-6) -> Onset:
    """Gain between `stable` and `growing` at which the vibration `vibration_at(gain)` neither grows nor decays.

    vibration_at   vibration in a run with that gain; None: it has decayed
    tolerance      of the gain, relative

    Raises GainroomError if the vibration does not decay at `stable` or does not grow at `growing`.
    """
    low, high = vibration_at(stable), vibration_at(growing)
    rates = [_rate(low), _rate(high)]
    if rates[0] >= 0 or rates[1] <= 0:
        raise GainroomError(
            f"onset: the vibration must decay at {stable:g} and grow at {growing:g}, not at {rates[0]:g}/s and {rates[1]:g}/s"
        )
    weights, latest, runs, last = list(rates), high, 2, 0
    while abs(growing - stable) > tolerance * abs(growing) and runs < MOST_RUNS:
        middle = (stable + growing) / 2
        if np.isfinite(weights).all():  # Illinois: growth is all but straight in the gain near the limit
            chord = (stable * weights[1] - growing * weights[0]) / (weights[1] - weights[0])
            # a hair to the side of the older end, so that both ends close in on the limit
            hair = tolerance / 3 * (growing - stable) / abs(growing - stable) * abs(growing)
            middle = min(max(chord + (hair if last < 0 else -hair), min(stable, growing)), max(stable, growing))
        here = vibration_at(middle)
        runs, rate = runs + 1, _rate(here)
        latest = here or latest
        side = 1 if rate > 0 else -1
        if side == last:
            weights[0 if side > 0 else 1] /= 2
        if side > 0:
            growing, weights[1] = middle, rate
        else:
            stable, weights[0] = middle, rate
        last = side
    assert latest is not None
    return Onset((stable + growing) / 2, latest.frequency, stable, growing, runs)


def _rate(found: Vibration | None) -> float:
    return -math.inf if found is None else found.growth_rate


def linear_vibration(loop: Loop, duration: float = 2.0) -> Vibration | None:
    """Fastest-growing oscillation of the sampled linear loop, `duration` [s] after an impulse of every joint's torque; None: decayed."""
    require_positive("onset", "duration", duration, "s")
    impulse = np.vstack([np.random.default_rng(0).standard_normal(loop.size), np.zeros(loop.size)])  # no symmetry: excites every mode
    run = simulate(loop, Scenario(0.0, duration, feedforward=impulse))
    later = run.error[len(run.time) // 2 :]
    found = vibration(later, run.sample_time, growing=True)
    if run.diverged and _rate(found) <= 0:
        return Vibration(0.0, math.inf, run.diverged_at or 0.0)  # it diverged without oscillation
    return found


def linear_onset(loop: Loop, duration: float = 2.0, tolerance: float = 1e-6) -> Onset:
    """Common factor on all gains of a sampled loop at which its linear simulation starts to vibrate.

    duration   of a run [s]: some tens of the vibration's periods

    Raises GainroomError if there is none between 1/1000 and 1000.
    """
    return search_onset(lambda factor: linear_vibration(loop.scaled(factor), duration), tolerance)


def search_onset(vibration_at: Callable[[float], Vibration | None], tolerance: float, near: float = 1.0, step: float = 2.0) -> Onset:
    """Onset by find_onset between ends searched from `near` on in factors of `step`: upwards where vibration decays, otherwise downwards.

    Raises GainroomError if there is none between near/1000 and 1000 near.
    """
    require_positive("onset", "near", near)
    factor = near
    direction = 1 / step if _rate(vibration_at(factor)) > 0 else step
    while near / FURTHEST_FACTOR < factor * direction < FURTHEST_FACTOR * near:
        factor *= direction
        if (_rate(vibration_at(factor)) > 0) == (direction > 1):
            ends = (factor / direction, factor) if direction > 1 else (factor, factor / direction)
            return find_onset(vibration_at, *ends, tolerance)
    raise GainroomError(f"onset: the loop {'decays' if direction > 1 else 'grows'} at every factor up to {factor:g}")
