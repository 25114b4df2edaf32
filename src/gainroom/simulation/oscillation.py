"""Dominant oscillation of a signal: frequency and growth rate.

Matrix pencil (Hua and Sarkar 1990): a signal that is a sum of p damped or growing exponentials makes a Hankel matrix of rank p, whose
row space turns by the poles from one column to the next. Singular values at the level of the noise are dropped (Gavish and Donoho 2014).
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_finite, require_positive
from ..system.linear.arrays import Complexes, Floats

if TYPE_CHECKING:
    from .run_record import Run

LAGS = 100  # columns of the Hankel matrix at most
MOST_SAMPLES = 4000  # samples from the end that are used
FEWEST_SAMPLES = 24
WINDOWS = 8  # that a motion is cut into
NOISE_FACTOR = 2.858  # times the median singular value: what is noise in a square matrix; in a tall one even a little less
FEWEST_PERIODS = 1.5  # that the window must hold of an oscillation
PERIODS_FITTED = 12  # that parts are taken from
SIGNIFICANCE = 4.0  # times what the strongest of all frequencies explains in white noise
ROUNDING = 1e-12  # round-off relative to the signal's largest value


@dataclass(frozen=True)
class Vibration:
    """Oscillation: frequency [rad/s]; growth_rate [1/s], negative if it decays; amplitude at the end of the signal, in its unit."""

    frequency: float
    growth_rate: float
    amplitude: float

    @property
    def damping_ratio(self) -> float:
        """Damping ratio, −cos of the pole's angle: 0 at constant amplitude, negative where it grows."""
        return -self.growth_rate / math.hypot(self.growth_rate, self.frequency) if math.isfinite(self.growth_rate) else -1.0


def vibration(signal: ArrayLike, sample_time: float, growing: bool = False, above: float = 0.0) -> Vibration | None:
    """Strongest oscillation in the last third of `signal` (k,) or (k, n); the last 4000 samples are used.

    growing   True: the oscillation in the whole signal with the largest growth rate, however small its amplitude; at most 4000 samples,
              evenly spaced, are used
    above     lower bound on the frequency [rad/s]

    None if nothing oscillates for at least one and a half periods above the noise.
    """
    require_positive("vibration", "sample_time", sample_time, "s")
    table = require_finite("vibration", "signal", signal)
    table = table[:, None] if table.ndim == 1 else table
    if table.ndim != 2:
        raise GainroomError(f"vibration: signal of shape {table.shape} must be (k,) or (k, n)")
    if growing and len(table) > MOST_SAMPLES:  # a fast tick and a slow vibration
        stride = -(-len(table) // MOST_SAMPLES)
        table, sample_time = table[::stride], stride * sample_time
    table = table[-MOST_SAMPLES:]
    scale = np.abs(table).max(initial=0.0)
    if len(table) < FEWEST_SAMPLES or scale == 0:
        return None
    table = table / scale
    table = table - table.mean(axis=0)
    rates = _poles(table, 1)
    lowest = above * sample_time
    found = _strongest(table, rates, growing, lowest)
    if found is None:
        return None
    # Once more, with lags that span about a twelfth of a period each: noise then shifts the pole far less.
    stride = min(int(2 * math.pi / found[0].imag / 12), len(table) // (3 * 12))
    if stride > 1:
        finer = _unfolded(_poles(table, stride), stride, found[0])
        if abs(finer - found[0]) < 0.1 * abs(found[0]):
            others = rates[(rates != found[0]) & (rates != found[0].conjugate())]
            found = _strongest(table, np.append(others, [finer, finer.conjugate()]), growing, lowest) or found
    rate, amplitude = found
    if amplitude < ROUNDING:
        return None
    return Vibration(abs(rate.imag) / sample_time, rate.real / sample_time, float(amplitude * scale))


def response_vibration(run: "Run", above: float = 0.0, after: float = 0.0) -> Vibration | None:
    """Oscillation of the tracking error after the reference has come to rest.

    Of the last half of the run if the reference moves to its end.

    above   lower bound on the frequency [rad/s], such as the reference's own
    after   time [s] of the last other change, such as a disturbance; only later rows are used
    """
    moving = np.flatnonzero((np.diff(run.reference, axis=0) != 0).any(axis=1))
    rest = run.time[moving[-1] + 1] if len(moving) else 0.0
    return vibration(run.error[rows_after(run, max(float(rest), after))], run.sample_time, above=above)


def windows(count: int) -> list[slice]:
    """Windows over `count` ticks, each overlapping the next by half, since vibration under friction is intermittent.

    [] for too few ticks.
    """
    size = max(FEWEST_SAMPLES + 2, 2 * count // (WINDOWS + 1))
    return [slice(first, first + size) for first in range(0, count - size + 1, max(1, size // 2))]


def rows_after(run: "Run", event: float) -> slice:
    """Rows of a run from `event` [s] on; the last half of all if too few are left."""
    begin, count = int(np.searchsorted(run.time, event)), len(run.time)
    return slice(begin if count - begin >= max(FEWEST_SAMPLES, count // 10) else count // 2, None)


def parts_in(signal: ArrayLike, sample_time: float, found: Vibration) -> Complexes:
    """Complex amplitude (n,) of each column in the vibration `found` at the end of `signal` (k, n), in its unit; the angle is its phase.

    Least squares over at most the last twelve periods, beside a straight line in every column.
    """
    table = require_finite("vibration", "signal", signal)
    period = 2 * math.pi / found.frequency / sample_time
    table = table[-max(FEWEST_SAMPLES, math.ceil(PERIODS_FITTED * period)) :]
    shape = _shapes(np.array([complex(found.growth_rate, found.frequency) * sample_time]), len(table))[:, 0]
    shape /= shape[-1]
    line = np.linspace(-1, 1, len(table))
    basis = np.column_stack([shape.real, -shape.imag, np.ones(len(table)), line])
    cosine, sine, *_ = np.linalg.lstsq(basis, table, rcond=None)[0]
    return cosine + 1j * sine


def _poles(table: Floats, stride: int) -> Complexes:
    """Rates ln(z) per sample of the exponentials in `table` (k, n), from lags of `stride` samples; imaginary parts within ±π/stride."""
    lags = max(2, min(LAGS, len(table) // (3 * stride)))
    rows = len(table) - lags * stride
    places = np.arange(rows)[:, None] + stride * np.arange(lags + 1)
    hankel = np.concatenate(list(table.T[:, places]))
    _, sizes, right = np.linalg.svd(hankel, full_matrices=False)
    rounding = max(hankel.shape) * np.finfo(float).eps * sizes[0]
    rank = int(np.count_nonzero(sizes > max(NOISE_FACTOR * float(np.median(sizes)), rounding)))
    if rank == 0:
        return np.zeros(0, dtype=complex)
    space = right[: min(rank, lags)].T
    turn = np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0]
    z = np.linalg.eigvals(turn).astype(complex)
    return np.log(z[np.abs(z) > 1e-6]) / stride


def _unfolded(rates: Complexes, stride: int, near: complex) -> complex:
    """Rate closest to `near`, after shifting `rates` by whole turns of 2π/stride."""
    turn = 2 * math.pi / stride
    moved = rates + 1j * turn * np.round((near.imag - rates.imag) / turn)
    return complex(moved[np.argmin(np.abs(moved - near))]) if len(moved) else 0j


def _strongest(table: Floats, rates: Complexes, growing: bool, lowest: float) -> tuple[complex, float] | None:
    """Rate per sample and amplitude at the end of the oscillation with most energy in the last third (`growing`: largest growth).

    None if none above `lowest` [rad per sample] is significant.
    """
    count, upper, others = len(table), rates[rates.imag > 0], rates[rates.imag == 0]
    if not len(upper):
        return None
    shapes, pairs = _shapes(upper, count), len(upper)
    basis = np.hstack([shapes.real, shapes.imag, _shapes(others, count).real, np.ones((count, 1))])
    weights = np.linalg.lstsq(basis, table, rcond=1e-12)[0]
    left_over = table - basis @ weights
    squares = (weights[:pairs] ** 2 + weights[pairs : 2 * pairs] ** 2) / 2
    swing = np.abs(shapes) ** 2
    explained, latest = swing.sum(axis=0) * squares.sum(axis=1), swing[-(count // 3) :].sum(axis=0) * squares.sum(axis=1)
    noise = SIGNIFICANCE * 2 * math.log(count) * np.mean(left_over**2) * table.shape[1]
    good = (upper.imag * count >= FEWEST_PERIODS * 2 * math.pi) & (upper.imag > lowest) & (explained > noise)
    if not good.any():
        return None
    best = int(np.argmax(np.where(good, upper.real if growing else latest, -np.inf)))
    return complex(upper[best]), float(np.sqrt(2 * squares[best].max() * swing[-1, best]))


def _shapes(rates: Complexes, count: int) -> Complexes:
    """Exponentials e^{rate k}, k = 0 to `count` − 1, in columns, each scaled to a largest magnitude of 1."""
    steps = np.arange(count)[:, None]
    return np.exp(rates.real * np.where(rates.real > 0, steps - (count - 1), steps) + 1j * rates.imag * steps)
