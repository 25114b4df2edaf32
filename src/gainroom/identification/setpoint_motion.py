"""Motion of a record's set-point: pieces at rest or steady speed, its own frequencies, and the motion that it may have commanded."""

import math
from itertools import pairwise

import numpy as np

from ..simulation.oscillation import FEWEST_SAMPLES, Vibration, parts_in
from ..system.linear.arrays import Floats
from .record import Record, resolution
from .recorded_oscillation import RecordedOscillation

STRAIGHT = 1e-9  # of the set-point's range per tick²: a smaller change of its velocity is rounding
FINE = 1e-4  # of the set-point's range: steps this small are the digits of its file
LONG_ENOUGH = 0.15  # of the record, or LONG_ROWS: where the set-point moves steadily
LONG_ROWS = 1500
FOLLOWS = 0.3  # amplitude of the set-point over that of the deviation from it: the motion follows a command
ALONE = 0.8  # of the set-point's power in its largest line: it oscillates
# order, and distance from an odd one, of the harmonics of an oscillating set-point that friction makes
MOST_HARMONICS, NEAR_HARMONIC = 40, 0.25
SLOW, LARGE = 2 * math.pi * 4.0, 0.01  # [rad/s] and [rad]: slower and larger, people and programmes move joints
GROWTH_PERIODS = 10.0  # fewer show no growth: a motion may be large at the end
CLIPPED = 0.05  # share of the rows at a torque limit: something that bounds a vibration
SWEEP_HALVES, SWEEP = 12, 0.02  # half periods that a sweep is seen in, and by how much they change at least from quarter to quarter
ROUNDED = 2e-8  # of its size: what nine digits of a file make of a line
NEAR_LINE = 1e-6  # of its range: off a line


def steady_pieces(record: Record, reference: Floats | None) -> list[slice]:
    """Long runs of rows in which the set-point rests or moves steadily; all rows without a set-point; [] if it always changes.

    Files round to some digits, which bend a line: pieces by either measure of a bend, whichever holds more rows.
    """
    if reference is None:
        return [slice(0, len(record.time))]
    size, digit = float(np.ptp(reference)), resolution(reference)
    digit = digit if digit < FINE * size else 0.0
    found = [
        _straight(reference, max(bend, 2.01 * digit), 3 * digit + NEAR_LINE * size)
        for bend in (STRAIGHT * size, ROUNDED * float(np.abs(reference).max()))
    ]
    return max(found, key=lambda pieces: sum(rows.stop - rows.start for rows in pieces))


def _straight(reference: Floats, bend: float, near: float) -> list[slice]:
    """Runs in which no row bends `reference` (m,) by more than `bend`, and that lie within `near` of a line."""
    count = len(reference)
    turns = np.flatnonzero(np.abs(np.diff(reference, 2)) > bend) + 1
    edges = [0, *(turns + 1).tolist(), count]
    enough = max(FEWEST_SAMPLES, min(LONG_ENOUGH * count, LONG_ROWS))
    runs = [(first, last) for first, last in pairwise(edges) if last - first >= enough]
    lines = [np.linspace(reference[first], reference[last - 1], last - first) for first, last in runs]
    return [slice(*run) for run, line in zip(runs, lines, strict=True) if np.abs(reference[slice(*run)] - line).max() <= near]


def set_point(reference: Floats, tick: float) -> tuple[float, float, float]:
    """Frequencies of a set-point [rad/s]: of the largest line; the same if it is the only line, else 0; and of 99 % of the power."""
    moved = reference - np.linspace(reference[0], reference[-1], len(reference))
    power = np.abs(np.fft.rfft(moved * np.hanning(len(moved)))) ** 2
    omega = 2 * math.pi * np.fft.rfftfreq(len(moved), tick)
    place = 1 + int(np.argmax(power[1:]))
    alone = power[max(1, place - 3) : place + 4].sum() > ALONE * power[1:].sum()
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return float(omega[place]), float(omega[place]) if alone else 0.0, float(omega[int(np.argmax(share >= 0.99))])


def follows(reference: Floats, deviation: Floats, tick: float, found: Vibration) -> bool:
    """True if the set-point itself contains the oscillation."""
    parts = np.abs(parts_in(np.column_stack([reference, deviation]), tick, found))
    return bool(parts[0] > FOLLOWS * parts[1])


def is_harmonic(omega: float, line: float) -> bool:
    """True if friction makes this frequency from an oscillating set-point: an odd multiple of its line."""
    order = omega / line if line else 0.0
    return 0 < order < MOST_HARMONICS and abs((order - 1) / 2 - round((order - 1) / 2)) * 2 < NEAR_HARMONIC


def as_commanded(seen: RecordedOscillation, values: Floats, tick: float) -> bool:
    """True if a set-point that is not in the log may have made this motion: slow, large, or of a steadily changing frequency.

    A vibration of the loop itself grows until something bounds it: a limited torque, friction or a gap, both of which are small. Its
    frequency changes with its amplitude alone.
    """
    if seen.irregular or seen.clipped > CLIPPED:
        return False
    grows = seen.state == "growing" and seen.vibration.frequency * len(values) * tick > GROWTH_PERIODS * 2 * math.pi
    slow = not grows and seen.vibration.frequency < SLOW and seen.vibration.amplitude > LARGE
    return slow or _sweeps(values, tick, seen.vibration.frequency)


def _sweeps(values: Floats, tick: float, frequency: float) -> bool:
    """True if the times between crossings of the mean grow, or shrink, all the time."""
    period = 2 * math.pi / frequency / tick
    smooth = np.convolve(values, np.ones(max(1, round(period / 12))) / max(1, round(period / 12)), mode="valid")
    smooth = smooth - np.linspace(smooth[: round(period)].mean(), smooth[-round(period) :].mean(), len(smooth))
    signs = np.sign(smooth)
    crossings = np.flatnonzero(signs[1:] * signs[:-1] < 0)
    halves = np.diff(crossings[1:])
    if len(halves) < SWEEP_HALVES or np.std(smooth[: len(smooth) // 3]) < 0.3 * np.std(smooth[-len(smooth) // 3 :]):
        return False
    ends = np.linspace(crossings[1], crossings[-1], 5)
    counted = np.histogram(crossings[1:-1], ends)[0]
    parts = np.histogram(crossings[1:-1], ends, weights=halves)[0] / np.maximum(counted, 1)
    if not counted.all():
        return False
    ratios = parts[1:] / parts[:-1]
    return bool(np.all(ratios > 1 + SWEEP) or np.all(ratios < 1 - SWEEP))
