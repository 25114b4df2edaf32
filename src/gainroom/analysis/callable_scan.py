"""Crossings and peaks of a loop that is only known as a callable or a sampled state space: sampled adaptively, polished, never certified.

The response is sampled on a logarithmic grid that is refined until log|L| and arg L move little from point to point. A feature
narrower than the grid's first spacing can be missed, so a Scan from here says `certified = False`.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..native import _core
from ..system.linear.arrays import Complexes, Floats
from .crossings import Scan

FIRST, LAST, DENSITY = 1e-5, 1e7, 60  # [rad/s], [rad/s], points per decade of the first grid
LARGEST_STEP = 0.3  # largest step of log|L| and arg L between neighbours
QUIET = 1e-6  # |L| below which a response is not refined
END = 1e-9  # relative distance from half the sample rate at which a sampled scan ends
BELOW, DRIFT = 0.1, 1e-3  # share of the slowest pole at which it begins, and rate [rad/s] of poles that are round-off of those at rest
SHARP = 0.3  # damping ratio below which a pole has frequencies about it
ALMOST = 1.05  # times the least sample: minima up to it are polished

LEAST_STEP: Any = 4 * np.finfo(float).eps  # the least that brentq accepts

Response = Callable[[Floats], Complexes]


def scan_callable(response: Response) -> Scan:
    """Scan a scalar continuous response omega (k,) → L(jω) (k,)."""
    omega, value = _sample(response, np.geomspace(FIRST, LAST, round(DENSITY * math.log10(LAST / FIRST))))
    # Slope −1 per integrator at the low end fixes both the start phase and the number of integrators
    integrators = round(-float(np.log(np.abs(value[1] / value[0])) / np.log(omega[1] / omega[0])))
    limit = -integrators * math.pi / 2
    positive = abs(np.angle(value[0] * np.exp(-1j * limit))) < math.pi / 2
    start_phase = 0.0 if positive else math.pi
    limit += start_phase
    start = limit + float(np.angle(value[0] * np.exp(-1j * limit)))
    table, phases, last_phase = _crossings(response, omega, value, start)
    if integrators == 0 and start_phase:  # L(0) < 0 is itself a crossing
        phases.insert(0, (0.0, abs(value[0]), 0.0))
    outside = bool(integrators > 0 or abs(value[0]) > 1)
    half_turns = _core.half_encirclements(start_phase, outside, False, last_phase, table)
    return Scan(table, np.array(phases, dtype=float).reshape(-1, 3), _peaks(response, omega, value), half_turns, False)


def scan_sampled(response: Response, poles: Complexes, sample_time: float) -> Scan:
    """Scan a scalar sampled response omega (k,) → L(e^{jωT_s}) (k,) whose poles in s [1/s] are known; half turns are not counted (NaN)."""
    size, last = np.abs(poles), math.pi / sample_time * (1 - END)
    lowest = BELOW * size[size > DRIFT].min(initial=last)
    near = size[(np.abs(poles.real) < SHARP * size) & (size > lowest) & (size < last)]
    beside = np.geomspace(1e-5, 0.1, 25)
    about = np.multiply.outer(near, 1 + np.concatenate([-beside, beside])).ravel()
    grid = np.geomspace(lowest, last, max(2, round(DENSITY * math.log10(last / lowest))))
    omega, value = _sample(response, np.unique(np.concatenate([grid, about[about < last]])))
    table, phases, _ = _crossings(response, omega, value, float(np.angle(value[0])))
    if value[-1].real < 0:  # at half the rate L is real
        phases.append((last, abs(value[-1]), 0.0))
    return Scan(table, np.array(phases, dtype=float).reshape(-1, 3), _peaks(response, omega, value), math.nan, False)


def _crossings(response: Response, omega: Floats, value: Complexes, start: float) -> tuple[Floats, list[tuple[float, float, float]], float]:
    """Crossings of |L| = 1 with their phases (k, 2), of the negative real axis, and the last phase, where that begins at `start`."""
    phase = start + np.append(0.0, np.cumsum(np.angle(value[1:] / value[:-1])))
    gains = []
    for k in np.flatnonzero((np.abs(value[1:]) > 1) != (np.abs(value[:-1]) > 1)):
        root = _root(lambda w: math.log(abs(response(np.array([w]))[0])), float(omega[k]), float(omega[k + 1]))
        gains.append((root, phase[k] + float(np.angle(response(np.array([root]))[0] / value[k]))))
    phases = []
    turns = np.floor((phase - math.pi) / (2 * math.pi))
    for k in np.flatnonzero((turns[1:] != turns[:-1]) & (np.abs(value[1:]) > QUIET)):
        root = _root(lambda w: float(np.angle(-response(np.array([w]))[0])), float(omega[k]), float(omega[k + 1]))
        phases.append((root, abs(response(np.array([root]))[0]), float(np.sign(phase[k + 1] - phase[k]))))
    return np.array(gains, dtype=float).reshape(-1, 2), phases, float(phase[-1])


def _peaks(response: Response, omega: Floats, value: Complexes) -> Floats:
    """Frequency and height (3, 2) of each kind of `objective` where it is least."""
    return np.array([_minimum(response, kind, omega, value) for kind in range(3)])


def _sample(response: Response, omega: Floats) -> tuple[Floats, Complexes]:
    """Frequencies, refined from `omega`, and the response there."""
    value = _checked(response, omega)
    for _ in range(40):
        step = np.abs(np.log(value[1:] / value[:-1]))
        rough = np.flatnonzero((step > LARGEST_STEP) & (np.maximum(np.abs(value[1:]), np.abs(value[:-1])) > QUIET))
        rough = rough[np.diff(omega)[rough] > 1e-12 * omega[rough]]
        if not len(rough) or len(omega) > 200_000:
            break
        middle = np.sqrt(omega[rough] * omega[rough + 1])
        value = np.insert(value, rough + 1, _checked(response, middle))
        omega = np.insert(omega, rough + 1, middle)
    return omega, value


def _checked(response: Response, omega: Floats) -> Complexes:
    value = response(omega)
    if not np.all(np.isfinite(value)) or np.any(value == 0):
        raise GainroomError("loop: the callable must return finite, nonzero values on the imaginary axis")
    return value


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    from scipy.optimize import brentq

    root: Any = brentq(function, low, high, xtol=1e-15 * high, rtol=LEAST_STEP)
    return float(root)


def objective(kind: int, value: Complexes) -> Floats:
    """Quantity minimised by each peak, at L = `value` (k,): 0: |1+L| (Ms), 1: |1+L|/|L| (Mt), 2: 2|1+L|/|1−L| (disk margin)."""
    below = (1.0, np.abs(value), np.abs(1 - value) / 2)[kind]
    return np.divide(np.abs(1 + value), below, out=np.full(len(value), np.inf), where=np.asarray(below) > 0)


def _minimum(response: Response, kind: int, omega: Floats, value: Complexes) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar

    heights = objective(kind, value)
    best = int(np.argmin(heights))
    at, least = float(omega[best]), float(heights[best])
    lower = (heights <= np.append(np.inf, heights[:-1])) & (heights <= np.append(heights[1:], np.inf))
    for k in np.flatnonzero(lower & (heights <= ALMOST * least)):
        low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
        found: Any = minimize_scalar(
            lambda w: objective(kind, response(np.array([w])))[0], bounds=(low, high), method="bounded", options={"xatol": 1e-10}
        )
        if found.fun < least:
            at, least = float(found.x), float(found.fun)
    return at, least
