"""Where the characteristic loci of several coupled loops cross the negative real axis.

det(I + g L(jω)) = 0 for a real g exactly where an eigenvalue of L(jω) equals −1/g. The eigenvalues are followed over a grid that is
refined until each moves little from point to point, crossings are polished, and the caller certifies what it uses by counting roots on
both sides: the grid finds candidates, it proves nothing.
"""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Complexes, Floats
from .loop import Loop

POINTS_PER_DECADE = 40
SMOOTH = 0.35  # largest relative move of an eigenvalue between neighbouring points
FLOOR = 1e-3  # crossings nearer to 0 than this (gains raised by 60 dB) are not looked for
MOST_POINTS = 20_000


@dataclass(frozen=True)
class Critical:
    """All gains times `gain` put a root at jω; `mode` (n,) complex: the measured positions in that vibration, the largest 1."""

    gain: float
    omega: float
    mode: Complexes


def critical_points(loop: Loop) -> list[Critical]:
    """Every crossing of the negative real axis by a locus of `loop`, by rising gain."""
    omega, values = _followed(loop)
    found = []
    for k in range(len(omega) - 1):
        now, after = values[k], values[k + 1]
        crosses = (now.imag > 0) != (after.imag > 0)
        left = (now.real + after.real < 0) & (np.maximum(np.abs(now), np.abs(after)) > FLOOR)
        for branch in np.flatnonzero(crosses & left):
            point = _polished(loop, omega[k], omega[k + 1], now[branch], after[branch])
            if point is not None:
                found.append(point)
    if loop.sample_time is not None:
        found += _at_nyquist(loop)
    return sorted(found, key=lambda point: point.gain)


def _followed(loop: Loop) -> tuple[Floats, Complexes]:
    """ω (k,) and the eigenvalues of L (k, n), ordered so that each column is one locus."""
    omega = _first_grid(loop)
    values = np.linalg.eigvals(loop.response(omega))
    while True:
        values = _matched(values)
        size = np.maximum(np.abs(values[1:]), np.abs(values[:-1]))
        rough = np.any((np.abs(np.diff(values, axis=0)) > SMOOTH * size) & (size > FLOOR), axis=1)
        rough &= np.diff(omega) > 1e-9 * omega[1:]
        if not rough.any() or len(omega) > MOST_POINTS:
            return omega, values
        spots = np.flatnonzero(rough)
        middle = np.sqrt(omega[spots] * omega[spots + 1])
        values = np.insert(values, spots + 1, np.linalg.eigvals(loop.response(middle)), axis=0)
        omega = np.insert(omega, spots + 1, middle)


def _first_grid(loop: Loop) -> Floats:
    """From well below every pole to where all loci have become small, dense around resonances."""
    assert loop.open_loop is not None
    poles = np.linalg.eigvals(loop.open_loop.a)
    if loop.sample_time is not None:
        z = 1 + loop.sample_time * poles
        poles = np.log(z[np.abs(z) > 1e-6]) / loop.sample_time
    longest = float(loop.delays.max(initial=0.0)) if loop.delays is not None else 0.0
    sizes = np.abs(poles)[np.abs(poles) > 1e-3 * np.abs(poles).max(initial=1.0) * 1e-3]
    scale = sizes.min(initial=1 / longest if longest else np.inf)
    scale = float(scale) if np.isfinite(scale) else 1.0
    low = 1e-3 * scale
    while np.abs(np.linalg.eigvals(loop.response(low))).min() < 10 and low > 1e-12 * scale:
        low /= 10
    if loop.sample_time is not None:
        high = math.pi / loop.sample_time * (1 - 1e-9)
    else:
        high = 10 * scale
        while np.linalg.norm(loop.response(high)[0], 2) > FLOOR and high < 1e9 * scale:
            high *= 2
    grid = [np.geomspace(low, high, max(2, round(POINTS_PER_DECADE * math.log10(high / low))))]
    for pole in poles[poles.imag > 1e-6 * np.abs(poles)]:
        width = max(abs(pole.real), 1e-6 * abs(pole))
        grid.append(pole.imag + width * np.sinh(np.linspace(-6, 6, 25)))
    if longest:
        grid.append(np.arange(low, high, 0.4 / longest)[:MOST_POINTS])
    omega = np.unique(np.concatenate(grid))
    return omega[(omega >= low) & (omega <= high)]


def _matched(values: Complexes) -> Complexes:
    """Each row permuted to lie nearest to the row before it."""
    from scipy.optimize import linear_sum_assignment

    result = values.copy()
    for k in range(1, len(values)):
        distance = np.abs(result[k - 1][:, None] - values[k][None, :])
        if np.array_equal(np.argmin(distance, axis=1), np.arange(len(distance))):
            result[k] = values[k]
        else:
            result[k] = values[k][linear_sum_assignment(distance)[1]]
    return result


def _polished(loop: Loop, low: float, high: float, value_low: complex, value_high: complex) -> Critical | None:
    """The crossing in [low, high] of the locus that runs from value_low to value_high, by bisection and secant on Im λ."""
    omega, value, mode = low, value_low, np.ones(loop.size, dtype=complex)
    for _ in range(100):
        share = value_low.imag / (value_low.imag - value_high.imag)
        share = share if 0.05 < share < 0.95 or high - low < 1e-9 * high else 0.5
        omega = low + share * (high - low)
        eigenvalues, vectors = np.linalg.eig(loop.response(omega)[0])
        nearest = int(np.argmin(np.abs(eigenvalues - (value_low + share * (value_high - value_low)))))
        value, mode = complex(eigenvalues[nearest]), vectors[:, nearest]
        if abs(value.imag) <= 1e-14 * abs(value) or high - low <= 4e-16 * high:
            break
        if (value.imag > 0) == (value_low.imag > 0):
            low, value_low = omega, value
        else:
            high, value_high = omega, value
    return Critical(-1 / value.real, omega, _unit(mode)) if value.real < 0 else None


def _at_nyquist(loop: Loop) -> list[Critical]:
    """Real negative eigenvalues of L at z = −1."""
    assert loop.sample_time is not None
    omega = math.pi / loop.sample_time
    eigenvalues, vectors = np.linalg.eig(loop.response(omega)[0])
    found = []
    for value, mode in zip(eigenvalues.tolist(), vectors.T, strict=True):
        if abs(complex(value).imag) <= 1e-9 * abs(value) and complex(value).real < -FLOOR:
            found.append(Critical(-1 / complex(value).real, omega, _unit(mode)))
    return found


def _unit(mode: Complexes) -> Complexes:
    """`mode` with its largest part 1."""
    return mode / mode[np.argmax(np.abs(mode))]
