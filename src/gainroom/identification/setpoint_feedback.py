"""Detection of a swinging set-point that is made of the joint's own position by an outer loop, such as a policy or an admittance.

A swing that is commanded is known beforehand: it goes on as its own past, or its harmonics, say. The set-point of an outer loop is a law of
the last positions, with all their noise and steps, and that law leaves far less of it than its own past does. It is looked for as a bent
line of position and speed at some delay, beside the last set-point (of a law that integrates), at the rows in which the set-point is set.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..system.linear.arrays import Floats, Integers

MADE = 0.2  # variance that the law leaves, over the least that the set-point's own past and its harmonics leave
EXPLAINED = 0.03  # and over the set-point's
KNOWN = 1e-10  # and what is predicted from its own past to the digits is commanded
FEWEST = 30  # set-points: fewer show no law
PER_PERIOD = 20  # set-points looked at, at most twice as many
LATEST = 4  # set-points' time by which positions may be late
MOST_DELAYS = 100  # that are tried
AHEAD = (0.0, 0.15, 0.3, 0.6, 1.0, 2.0, 3.0, 5.0)  # set-points' time by which the law looks ahead
MOST_HARMONICS = 6


def follows_position(reference: Floats, position: Floats, period: float) -> bool:
    """True if `reference` (m,), of `period` [rows], is a law of past values of `position` (m,), all the time or in a half."""
    half = len(reference) // 2
    return any(_made(reference[part], position[part], period) for part in (slice(None), slice(half), slice(half, None)))


def _made(reference: Floats, position: Floats, period: float) -> bool:
    rows, held, own_held = _set_rows(reference, period)
    if len(rows) < FEWEST:
        return False
    values = reference[rows]
    edge = 1e-9 * float(np.ptp(values))
    free = (values < values.max() - edge) & (values > values.min() + edge)  # at its bounds a law does not show
    free[:4] = False
    places = np.flatnonzero(free)
    if len(places) < 0.8 * FEWEST:
        return False
    wanted, last, second, third = (values[places - back] for back in range(4))
    knots = int(np.clip(len(places) // 12, 3, 10))
    at = rows[places]
    past = [*_piecewise_linear(last, knots), second, third, second * np.abs(second - second.mean())]
    between = [reference[at - back * own_held] for back in (1, 2, 3)] if own_held < held else []
    past += between
    own = min(_left(past, wanted), _beside_harmonics(values, rows, 2 * math.pi / period, held))

    def left(late: int, ahead: float) -> float:
        here, before = position[at - late], position[np.maximum(at - late - held, 0)]
        return _left([*_piecewise_linear(here + ahead * (here - before), knots), before, last, *between[:1]], wanted)

    coarse = max(1, LATEST * held // MOST_DELAYS)
    best, late = min((left(late, ahead), late) for late in range(0, LATEST * held + 1, coarse) for ahead in AHEAD)
    near = range(max(0, late - coarse), late + coarse + 1)[:: max(1, coarse // 10)]
    best = min(best, *(left(late, ahead) for late in near for ahead in AHEAD))
    size = float(values.var())
    return best < MADE * own and best < EXPLAINED * size and own > KNOWN * size


def _set_rows(reference: Floats, period: float) -> tuple[Integers, int, int]:
    """Rows at which the set-point is updated, also to the same value; their distance, and that of all."""
    changed = np.flatnonzero(np.diff(reference)) + 1
    between = np.diff(changed)
    if len(between) < FEWEST // 2:
        return np.zeros(0, dtype=int), 0, 0
    lengths, counts = np.unique(between, return_counts=True)
    held = int(lengths[np.argmax(counts)])
    rows = [int(changed[0])]
    for first, length in zip(changed[:-1].tolist(), between.tolist(), strict=True):
        count = max(1, round(length / held))
        rows += [round(first + length * k / count) for k in range(1, count + 1)]
    every = max(1, round(period / PER_PERIOD / held)) if held < period / PER_PERIOD / 2 else 1
    updates = np.array(rows[::every])
    return updates[updates >= 2 * LATEST * held * every], held * every, held


def _piecewise_linear(values: Floats, knots: int) -> list[Floats]:
    """Columns of a piecewise linear function with `knots` bends at quantiles."""
    return [values, *(np.maximum(values - at, 0) for at in np.quantile(values, np.linspace(0, 1, knots + 2)[1:-1]))]


def _left(columns: Sequence[Floats], wanted: Floats) -> float:
    """Variance of `wanted` (k,) unexplained by the columns and a constant, by least squares."""
    table = np.column_stack([np.ones(len(wanted)), *columns])
    table /= np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    off = wanted - table @ np.linalg.lstsq(table, wanted, rcond=1e-11)[0]
    return float(off @ off) / max(len(wanted) - table.shape[1], 1)


def _beside_harmonics(values: Floats, rows: Integers, omega: float, held: int) -> float:
    """Variance unexplained by an oscillation with harmonics of steadily changing size, at the best frequency near `omega` [rad per row]."""
    from scipy.optimize import minimize_scalar

    line = np.linspace(-1, 1, len(rows))

    def left(at: float, most: int) -> float:
        count = int(np.clip(math.pi / (at * held) - 0.3, 1, min(most, max(1, (len(rows) - 20) // 8))))
        waves = [turn(k * at * rows) for k in range(1, count + 1) for turn in (np.cos, np.sin)]
        return _left([line, *waves, *(line * wave for wave in waves)], values)

    near = omega * (1 + np.linspace(-0.06, 0.06, 121))
    best = float(near[int(np.argmin([left(at, 2) for at in near]))])
    found: Any = minimize_scalar(
        lambda at: left(at, MOST_HARMONICS), bounds=(0.998 * best, 1.002 * best), method="bounded", options={"xatol": 1e-8 * best}
    )
    return float(found.fun)
