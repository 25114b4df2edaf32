"""Tick of a log, and the tick number of each row, from time stamps with jitter and possibly missing rows.

Rows come from a loop that runs once per tick, and their stamps are read a little sooner or later: t_k = T n_k + phase + jitter, with whole
numbers n_k that rise. The mean of e^{2πj t/T} over some rows tells their phase whatever rows are missing; how it turns from there to
the next rows tells how far T is off, and that it is short that T is none (Rayleigh's test). Then n_k − k, the rows that are missing so far,
is what t_k/T − phase − k scatters about: a sequence that never falls, found by isotonic regression. A late stamp before an early one is
evened out by it, where each step by itself would be taken for a gap.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...system.linear.arrays import Complexes, Floats, Integers

GAP = 1.5
"""Number of ticks between two rows from which on at least one row is missing, for stamps without an even clock."""
PAUSE = 20
"""Length of a gap [ticks] after which a clock may restart."""
ROWS = (8, 32, 128)
"""Numbers of rows over which the phase is averaged, in this order: the estimate of the tick improves each time."""
PHASE_ROWS = 64
EVEN = 0.25
"""Minimum length of the mean of e^{2πj t/T} for an even clock: 1 without jitter, 0.64 with 0.15 ticks, 0.29 with 0.25."""
LEAST_ROWS = 32


@dataclass(frozen=True)
class Ticks:
    """Tick number of each row.

    numbers   (m,) rising, 0 first
    off       (m,) how far each stamp lies from its tick [ticks]
    even      False where the stamps are of no even clock; numbers are then steps rounded one by one
    """

    numbers: Integers
    off: Floats
    even: bool


def tick_of(time: Floats) -> float:
    """Tick [s] of rising stamps (m,), m ≥ 2."""
    steps = np.diff(time)
    tick = float(np.mean(steps[steps <= GAP * np.median(steps)]))
    start = tick
    for rows in ROWS:
        if len(time) < 4 * rows:
            break
        turned = _phase(_means(time, tick, rows))
        middle = time[: len(turned) * rows].reshape(-1, rows).mean(axis=1)
        tick = 1 / (1 / tick - float(np.polyfit(middle - middle[0], turned, 1)[0]))
    return tick if abs(tick / start - 1) < 0.5 / ROWS[0] else start


def ticks_of(time: Floats, tick: float) -> Ticks:
    """Ticks of rising stamps (m,); pauses separate them into parts, as a clock may restart after a pause."""
    edges = [0, *(np.flatnonzero(np.diff(time) > PAUSE * tick) + 1).tolist(), len(time)]
    parts = [_without_pause(time[first:last], tick) for first, last in pairwise(edges)]
    numbers, end = [], 0
    for part, first in zip(parts, edges[:-1], strict=True):
        end += int(np.rint((time[first] - time[first - 1]) / tick)) if first else 0
        numbers.append(part.numbers + end)
        end = int(numbers[-1][-1])
    even = [part.even for part in parts if len(part.numbers) >= LEAST_ROWS] or [part.even for part in parts]
    return Ticks(np.concatenate(numbers), np.concatenate([part.off for part in parts]), all(even))


def _without_pause(time: Floats, tick: float) -> Ticks:
    count = np.arange(len(time))
    means = _means(time, tick, min(PHASE_ROWS, len(time)))
    if np.abs(means).mean() < EVEN:
        steps = np.diff(time, prepend=time[:1]) / tick
        numbers = np.cumsum(np.where(steps > GAP, np.maximum(np.rint(steps), 2), 1).astype(np.int64)) - 1
        return Ticks(numbers, (time - time[0]) / tick - numbers, False)
    from scipy.optimize import isotonic_regression

    phase = np.interp(count, PHASE_ROWS * (np.arange(len(means)) + 0.5), _phase(means))
    place = (time - time[0]) / tick - phase
    numbers = np.rint(isotonic_regression(place - count).x).astype(np.int64) + count
    return Ticks(numbers - numbers[0], place - numbers, True)


def _means(time: Floats, tick: float, rows: int) -> Complexes:
    """Means (c,) of e^{2πj t/T} over `rows` rows each; a remainder at the end is left out."""
    turns = np.exp(2j * np.pi * (time - time[0]) / tick)
    return turns[: len(time) // rows * rows].reshape(-1, rows).mean(axis=1)


def _phase(means: Complexes) -> Floats:
    """Phase [ticks] without jumps."""
    return np.unwrap(np.angle(means)) / (2 * np.pi)
