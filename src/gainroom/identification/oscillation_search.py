"""The search for an oscillation in a joint's record.

It is searched in the deviation from the set-point wherever the set-point rests or moves steadily, else in windows, above the set-point's
own frequencies. Poles and amplitudes are those of simulation/oscillation.py; slow ones come from means over several ticks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..errors import GainroomError
from ..simulation.oscillation import FEWEST_SAMPLES, MOST_SAMPLES, Vibration, parts_in, vibration, windows
from ..system.linear.arrays import Floats
from .record import Record, resolution
from .recorded_oscillation import LOOKED_AT, POSITIONS, RINGING, TORQUES, UNCHANGED, RecordedOscillation, measured
from .setpoint_feedback import follows_position
from .speed_order import turning
from .torque_excitation import excited_band

RESTING = 0.1  # damping ratio above which an oscillation is the settling of a joint
STRAIGHT = 1e-9  # of the set-point's range per tick²: a smaller change of its velocity is rounding
MOST_MULTIPLES = 1e5  # of an encoder's step from row to row: beyond, digits of numbers are no steps
FINE = 1e-4  # of the set-point's range: steps this small are the digits of its file
LONG_ENOUGH = 0.15  # of the record, or LONG_ROWS: where the set-point moves steadily
LONG_ROWS = 1500
STEPS = 0.5  # of the encoder, amplitude: a set-point or a drift that crosses steps makes an error of 1/π at most
IRREGULAR_STEPS = (0.6, 6.0)  # likewise of motion without a single frequency: to and fro between two steps, to a few
IRREGULAR_VISIBLE = 3e-5  # [rad] likewise: with finer encoders nobody notices
RAMP_STEPS = 2.0  # likewise where a steady motion crosses them
DECAYING_STEPS = 5.0  # likewise, LOOKED_AT periods before the end, of one that decays
MOVING_STEPS = 3.0  # likewise while the set-point moves
VISIBLE = 1e-6  # [rad] smaller amplitudes are not visible on hardware
VISIBLE_MOVING = 2e-5  # [rad] likewise while it moves: friction excites them as motion turns
COLOURED = 0.3  # correlation of neighbouring rows: white noise of the measurement has none
SLOW_LINES = 3  # of a spectrum, which hold the trend
UNDIMINISHED = 0.7  # of its size before: irregular motion that falls below decays
SAME_FREQUENCY, TIMES = 0.05, 3  # relative: no further apart in so many successive windows
BEYOND = 3.0  # times the frequency below which 99 % of the set-point's power lie
FOLLOWS = 0.3  # amplitude of the set-point over that of the deviation from it: the motion follows a command
ALONE = 0.8  # of the set-point's power in its largest line: it oscillates
# order, and distance from an odd one, of the harmonics of an oscillating set-point that friction makes
MOST_HARMONICS, NEAR_HARMONIC = 40, 0.25
TRIES = 4  # oscillations that are looked at, each of a higher frequency
SLOW, LARGE = 2 * math.pi * 4.0, 0.01  # [rad/s] and [rad]: slower and larger, people and programmes move joints
CLIPPED, STANDING = 0.05, 0.3  # shares of the rows at a torque limit and at rest: something that bounds a vibration
SWEEP_HALVES, SWEEP = 12, 0.02  # half periods that a sweep is seen in, and by how much they change at least from quarter to quarter
STRIDES = (1, 4, 16, 64, 256)  # ticks whose mean is taken


@dataclass(frozen=True)
class Search:
    """What was found in a record.

    oscillation   None where nothing oscillates
    driven        frequency of a motion that the set-point itself contains [rad/s]; NaN: none
    blind         below this frequency the set-point's motion may hide a vibration [rad/s]; 0: nowhere
    unasked       amplitude of a motion at `driven` that a set-point which is not in the record may well have made [rad]; NaN: none
    excited       band of an excitation in target_torque, which moves the joint and may hide a vibration [rad/s]; None: none
    """

    oscillation: RecordedOscillation | None
    driven: float = math.nan
    blind: float = 0.0
    unasked: float = math.nan
    excited: tuple[float, float] | None = None


def find_oscillation(record: Record) -> Search:
    """The strongest vibration in `record`, which has no gaps. Raises GainroomError where it holds neither a position nor a torque."""
    found = _search(record)
    seen = found.oscillation
    band = None if seen is None else excited_band(record, seen.side, seen.rows, seen.vibration.frequency)
    return found if band is None else replace(found, oscillation=None, excited=band)


def _search(record: Record) -> Search:
    """Whatever moves the joint there."""
    side = next((name for name in (*POSITIONS, "motor_velocity", *reversed(TORQUES)) if record.has(name)), None)
    if side is None:
        raise GainroomError("diagnose: needs a position, a velocity or a torque")
    step = _encoder_step(record.channels[side]) if side in POSITIONS else 0.0
    reference = record.channels.get("reference") if side in POSITIONS else None
    pieces = _steady_pieces(record, reference)
    if pieces:
        return _at_steady(record, side, reference, pieces, step)
    assert reference is not None
    return _of_outer_loop(record, side, reference, step) or _in_motion(record, side, reference, step)


def _at_steady(record: Record, side: str, reference: Floats | None, pieces: Sequence[slice], step: float) -> Search:
    """Where the set-point rests or moves steadily: in the last long piece."""
    longest = max(len(record.time[rows]) for rows in pieces)
    steady = [rows for rows in pieces if len(record.time[rows]) >= 0.5 * longest][-1]
    deviation = record.channels[side] if reference is None else record.channels[side] - reference
    found = _found(deviation[steady], record.sample_time)
    ramp = reference is not None and float(np.ptp(reference[steady])) > 0
    if found is not None and _counts(found, record, steady, step, ramp):
        seen = measured(record, side, steady, found, deviation, step)
        if reference is None and side in POSITIONS and _as_commanded(seen, deviation[steady], record.sample_time):
            return Search(None, driven=seen.vibration.frequency, unasked=seen.vibration.amplitude)
        if _counts(seen.vibration, record, steady, step, ramp):
            if reference is not None and ramp:
                turns = turning(reference, deviation, record.sample_time, pieces, lambda part: _found(part, record.sample_time))
                seen = replace(seen, turning=turns)
            return Search(seen)
    least = max((RAMP_STEPS if ramp else IRREGULAR_STEPS[0]) * step, IRREGULAR_VISIBLE)
    irregular = _irregular(deviation[steady], record.sample_time, step, least)
    return Search(None if irregular is None else measured(record, side, steady, irregular, deviation, step, irregular=True))


def _of_outer_loop(record: Record, side: str, reference: Floats, step: float) -> Search | None:
    """A swing of the set-point that is a law of the position; None where there is none."""
    values, tick = record.channels[side], record.sample_time
    rows = slice(len(values) // 2, None)
    found = _found(values[rows], tick)
    if found is None or found.damping_ratio >= RINGING or found.amplitude < max(MOVING_STEPS * step, VISIBLE_MOVING):
        return None
    period = 2 * math.pi / found.frequency / tick
    if not _follows(reference[rows], values[rows], tick, found) or not follows_position(reference, values, period):
        return None
    seen = measured(record, side, rows, found, values, step)
    return Search(replace(seen, answers=True)) if seen.vibrates else None


def _in_motion(record: Record, side: str, reference: Floats, step: float) -> Search:
    """Where the set-point moves all the time: in successive windows, above its own frequencies."""
    values = record.channels[side]
    deviation = values - reference
    driven, line, fastest = _set_point(reference, record.sample_time)
    blind = BEYOND * fastest
    least = max(MOVING_STEPS * step, VISIBLE_MOVING)
    row: list[Vibration] = []
    best: tuple[slice, Vibration] | None = None
    for rows in windows(len(values)):
        found = _found(deviation[rows], record.sample_time, blind)
        counts = found is not None and found.amplitude >= least and not _is_harmonic(found.frequency, line)
        if found is None or not counts or _follows(reference[rows], deviation[rows], record.sample_time, found):
            row = []
            continue
        row = [*row, found][-TIMES:]
        alike = len(row) == TIMES and all(abs(one.frequency / row[-1].frequency - 1) <= SAME_FREQUENCY for one in row)
        if alike and (best is None or row[-1].amplitude > best[1].amplitude):
            best = rows, row[-1]
    if best is None:
        return Search(None, driven, blind)
    return Search(measured(record, side, best[0], best[1], deviation, step), driven, blind)


def _counts(found: Vibration, record: Record, rows: slice, step: float, ramp: bool) -> bool:
    """Whether an oscillation at a steady set-point is large enough, in encoder steps and where it was largest."""
    count = len(record.time[rows])
    change = math.exp(found.growth_rate * min(LOOKED_AT * 2 * math.pi / found.frequency, count * record.sample_time))
    decays = change < 1 - UNCHANGED
    steps = DECAYING_STEPS * change if decays else RAMP_STEPS if ramp else STEPS
    return found.amplitude >= max(steps * step, VISIBLE if any(record.has(name) for name in POSITIONS) else 0.0)


def _as_commanded(seen: RecordedOscillation, values: Floats, tick: float) -> bool:
    """Whether a set-point that is not in the log may well make this motion: slow, large, or of a frequency that changes all the time.

    What vibrates of itself grows until something bounds it: a limited torque, friction that holds it, or a gap that is small. A loop's
    frequency changes with its amplitude alone.
    """
    if seen.irregular or seen.clipped > CLIPPED or seen.standing > STANDING:
        return False
    slow = seen.state != "growing" and seen.vibration.frequency < SLOW and seen.vibration.amplitude > LARGE
    return slow or _sweeps(values, tick, seen.vibration.frequency)


def _sweeps(values: Floats, tick: float, frequency: float) -> bool:
    """Whether the times from one crossing of the mean to the next become longer or shorter all the time."""
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


def _encoder_step(values: Floats) -> float:
    """Of a position (m,), also where it moves so fast that no reading comes twice: what all its changes are multiples of; 0: nothing."""
    step = resolution(values)
    if step:
        return step if math.isfinite(step) else 0.0
    changes = np.abs(np.diff(values[:MOST_SAMPLES]))
    least = float(changes[changes > 1e-12].min(initial=math.inf))
    steps = np.diff(np.unique(np.round(changes[changes > 0] / least, 6))) if math.isfinite(least) else np.zeros(0)
    steps = steps[steps > 1e-3]
    if not len(steps):
        return 0.0
    step = least * float(min(steps.min(), 1.0))
    multiples = changes / step
    return step if multiples.max() < MOST_MULTIPLES and np.abs(multiples - np.round(multiples)).max() < 0.01 else 0.0


def _steady_pieces(record: Record, reference: Floats | None) -> list[slice]:
    """Long runs of rows in which the set-point rests or moves steadily; all rows where there is none; empty where it always changes."""
    count = len(record.time)
    if reference is None:
        return [slice(0, count)]
    change, digit = np.abs(np.diff(reference, 2)), resolution(reference)
    digit = digit if digit < FINE * np.ptp(reference) else 0.0
    turns = np.flatnonzero(change > max(STRAIGHT * float(np.ptp(reference)), 2.01 * digit)) + 1
    edges = [0, *(turns + 1).tolist(), count]
    enough = max(FEWEST_SAMPLES, min(LONG_ENOUGH * count, LONG_ROWS))
    near = 3 * digit + 1e-6 * float(np.ptp(reference))

    def straight(first: int, last: int) -> bool:
        return bool(np.abs(reference[first:last] - np.linspace(reference[first], reference[last - 1], last - first)).max() <= near)

    return [slice(first, last) for first, last in pairwise(edges) if last - first >= enough and straight(first, last)]


def _found(values: Floats, tick: float, above: float = 0.0) -> Vibration | None:
    """The largest oscillation that is not the settling of a joint, by whichever number of ticks' mean shows it."""
    best = None
    for stride in STRIDES:
        coarse = _means(values, stride)
        if len(coarse) < 2 * FEWEST_SAMPLES:
            break
        found = _unsettled(coarse, stride * tick, above)
        if found is None or (stride > 1 and found.frequency * stride * tick > 1.0):
            continue
        lasts, before = found.damping_ratio < RINGING, best is not None and best.damping_ratio < RINGING
        if best is None or lasts > before or (lasts == before and found.amplitude > 1.2 * best.amplitude):
            best = found
    return best


def _unsettled(values: Floats, tick: float, above: float) -> Vibration | None:
    """The strongest oscillation that lasts; where that is a joint's settling, a faster or a later one; else the slowest to settle."""
    settling = None
    for part in (values, values[-(len(values) // 2) :]):
        lowest = above
        for _ in range(TRIES):
            found = vibration(part, tick, above=lowest)
            if found is None:
                break
            if found.damping_ratio < RINGING:
                return found
            if settling is None and found.damping_ratio <= RESTING:
                settling = found
            lowest = 1.05 * found.frequency
    return settling


def _means(values: Floats, stride: int) -> Floats:
    """Of neighbouring rows, from the end."""
    if stride == 1:
        return values
    rows = len(values) // stride
    return values[len(values) - rows * stride :].reshape(rows, stride).mean(axis=1)


def _irregular(values: Floats, tick: float, step: float, least: float) -> Vibration | None:
    """Motion of about an encoder's step without a single frequency, which has not decayed; None without it.

    Faster than a few periods in each eighth of the last third, so that no slow move counts. Neighbouring rows are alike: white noise of the
    measurement is none.
    """
    from scipy.signal import welch

    third = len(values) // 3
    if step == 0 or third < 4 * FEWEST_SAMPLES:
        return None
    width = max(2 * FEWEST_SAMPLES, third // 8)
    spectra = [welch(part, 1 / tick, nperseg=width, detrend="linear") for part in (values[-2 * third : -third], values[-third:])]
    frequency, (earlier, power) = spectra[0][0], (one[1] for one in spectra)
    earlier[:SLOW_LINES], power[:SLOW_LINES] = 0.0, 0.0
    total = float(power.sum())
    size = math.sqrt(2 * total * frequency[1])
    if not least <= size <= IRREGULAR_STEPS[1] * step or total < UNDIMINISHED**2 * float(earlier.sum()):
        return None
    if float(power @ np.cos(2 * np.pi * frequency * tick)) < COLOURED * total:
        return None
    return Vibration(2 * math.pi * float(frequency[int(np.argmax(power))]), 0.0, size)


def _set_point(reference: Floats, tick: float) -> tuple[float, float, float]:
    """Of its motion: frequency of the largest line, again where that is all there is, else 0, and where 99 % of the power end [rad/s]."""
    moved = reference - np.linspace(reference[0], reference[-1], len(reference))
    power = np.abs(np.fft.rfft(moved * np.hanning(len(moved)))) ** 2
    omega = 2 * math.pi * np.fft.rfftfreq(len(moved), tick)
    place = 1 + int(np.argmax(power[1:]))
    alone = power[max(1, place - 3) : place + 4].sum() > ALONE * power[1:].sum()
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return float(omega[place]), float(omega[place]) if alone else 0.0, float(omega[int(np.argmax(share >= 0.99))])


def _follows(reference: Floats, deviation: Floats, tick: float, found: Vibration) -> bool:
    """Whether the set-point itself contains the oscillation."""
    parts = np.abs(parts_in(np.column_stack([reference, deviation]), tick, found))
    return bool(parts[0] > FOLLOWS * parts[1])


def _is_harmonic(omega: float, line: float) -> bool:
    """Whether friction makes this frequency of an oscillating set-point: an odd multiple of it."""
    order = omega / line if line else 0.0
    return 0 < order < MOST_HARMONICS and abs((order - 1) / 2 - round((order - 1) / 2)) * 2 < NEAR_HARMONIC
