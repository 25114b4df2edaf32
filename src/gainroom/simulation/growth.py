"""Which vibration in a recording grows fastest: the matrix pencil on several channels at once (Hua and Sarkar 1990).

Signals that are sums of p exponentials make a Hankel matrix of rank p, whose row space turns by the exponentials from one sample to the
next. Made for simulations without noise, where even vibrations that are a thousand times weaker than others are seen.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Complexes, Floats
from ..errors import GainroomError, require_finite, require_positive

LAGS = 200
"""Columns of the Hankel matrix at most."""
SHORTEST = 60
"""Samples that at least are needed."""
ROUNDING = 1e-7
"""Singular values below this share of the largest are not told from rounding: squares are what is decomposed."""
SEEN = 1e-3
"""A vibration counts when at the end its amplitude is at least this share of the strongest's."""
PERIODS = 2.0
"""The recording must hold this many of a vibration; slower motion is drift."""


@dataclass(frozen=True)
class Growth:
    """Growth rate [1/s], negative where it dies away, and frequency [rad/s]."""

    rate: float
    frequency: float


def fastest_growth(signals: ArrayLike, sample_time: float) -> Growth | None:
    """Of all vibrations in `signals` (k, c), the one that grows fastest (or dies slowest); None where nothing vibrates.

    Raises GainroomError for signals of wrong shape or too short.
    """
    table = require_finite("growth", "signals", signals)
    require_positive("growth", "sample_time", sample_time, "s")
    if table.ndim != 2 or len(table) < SHORTEST:
        raise GainroomError(f"growth: signals of shape {table.shape} must be (k, channels) with k >= {SHORTEST}")
    scale = np.abs(table).max(initial=0.0)
    if scale == 0:
        return None
    rates = _rates(table / scale)
    amplitudes = _amplitudes(table / scale, rates)  # beside all others, or they would have to account for what is left out
    vibrates = rates.imag * len(table) >= 2 * math.pi * PERIODS
    seen = rates[vibrates & (amplitudes >= SEEN * amplitudes[vibrates].max(initial=0.0))]
    if not len(seen):
        return None
    fastest = seen[np.argmax(seen.real)]
    return Growth(float(fastest.real) / sample_time, float(fastest.imag) / sample_time)


def _rates(table: Floats) -> Complexes:
    """Per sample, of all exponentials that stand out of rounding."""
    _, sizes, right = np.linalg.svd(table, full_matrices=False)
    channels = table @ right[sizes > 1e-6 * sizes[0]].T
    lags = min(LAGS, len(table) // 3)
    hankel = np.lib.stride_tricks.sliding_window_view(channels, lags + 1, axis=0).reshape(-1, lags + 1)
    squares, vectors = np.linalg.eigh(hankel.T @ hankel)
    rank = min(int(np.count_nonzero(squares > (ROUNDING**2) * squares[-1])), lags - 1)
    space = vectors[:, -rank:]
    turn = np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0]
    poles = np.linalg.eigvals(turn).astype(complex)
    return np.log(poles[np.abs(poles) > 1e-3])


def _amplitudes(table: Floats, rates: Complexes) -> Floats:
    """Of each exponential at the end of the recording, over all channels."""
    steps = np.arange(len(table))[:, None]
    shapes = np.exp(rates * np.where(rates.real > 0, steps - len(table), steps))  # at most 1
    weights = np.linalg.lstsq(np.hstack([shapes, np.ones((len(table), 1)), steps]), table.astype(complex), rcond=1e-12)[0]
    return np.linalg.norm(weights[: len(rates)], axis=1) * np.abs(shapes[-1])
