"""Search for an oscillation in a joint's record.

It is searched in the deviation from the set-point wherever the set-point rests or moves steadily, else in windows, above the set-point's
own frequencies. Poles and amplitudes are those of simulation/oscillation.py; slow ones come from means over several ticks.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..errors import GainroomError
from ..simulation.oscillation import FEWEST_SAMPLES, MOST_SAMPLES, Vibration, parts_in, vibration, windows
from ..system.linear.arrays import Floats
from .frequency_response import FEEDBACK
from .record import Record
from .recorded_oscillation import LOOKED_AT, POSITIONS, RINGING, TORQUES, UNCHANGED, RecordedOscillation, measured
from .setpoint_feedback import follows_position
from .setpoint_motion import as_commanded, follows, is_harmonic, set_point, steady_pieces
from .speed_order import Turning, turning

RESTING = 0.1  # damping ratio above which an oscillation is the settling of a joint
SMALLEST = 24  # changes of a reading that are tried for a step, and what lies between them
OFF_STEPS, MOST_OFF = 0.01, 12  # share and number of changes that are no multiples
MOST_MULTIPLES = 1e5  # of an encoder's step from row to row: beyond, digits of numbers are no steps
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
MAIN = 0.3  # of the amplitude of all motion in the last third: less, beside a slower swing, is a part of it
MAINLY = 0.3  # of the set-point's motion: its swing
STEADY = 0.05  # damping ratio, either way, of an outer loop's swing: one that seems to grow faster is a sweep
TRIES = 4  # oscillations that are looked at, each of a higher frequency
STRIDES = (1, 4, 16, 64, 256)  # ticks whose mean is taken
SWINGS = 4  # half periods, of which the last three grow
GROWS = 1.1  # from one to the next, at least
DOUBLES = 2.0  # over two of them
LARGE_STEPS = 30.0  # of the encoder
FAR_TIMES = 5.0  # times the largest deviation of before: with many swings, or none
FAR_OFF = 0.2  # [rad] likewise, at least
EARLY, LATE = 0.7, 0.1  # of the rows: those before, and the end
LEAST_GIVEN = 0.2  # of the torque's power, from which on feedback does not make it: of virtual vibrations below 1e-6, of multisines above 1
MOST_LINE = (
    0.4  # likewise: less at the vibration's frequency is one line among others; of a vibration it is 0.9, of stick-slip 0.25 or more
)
LINE_WIDTH = 4  # lines of the spectrum that are one under its window
SPOILT = 0.02  # of the rows, which may be left out: an excitation is in all of them
SLOWER, FASTEST = 2.5, 0.9  # the band looked at: from the frequency over this, up to this share of half the rate
BEYOND_BAND = 0.02  # of the excitation's power beyond either end of its band


@dataclass(frozen=True)
class Departure:
    """Departure from the set-point: size at the end [rad], and frequency, growth rate and amplitude of the last swings if they are few."""

    size: float
    vibration: Vibration | None


@dataclass(frozen=True)
class Search:
    """Result of the search for an oscillation in a record.

    oscillation   None where nothing oscillates
    driven        frequency of a motion that the set-point itself contains [rad/s]; NaN: none
    blind         below this frequency the set-point's motion may hide a vibration [rad/s]; 0: nowhere
    unasked       amplitude of a motion at `driven` that a set-point which is not in the record may well have made [rad]; NaN: none
    away          how the joint left its set-point, to the end of the record; None: it did not
    excited       band of an excitation in target_torque, which moves the joint and may hide a vibration [rad/s]; None: none
    """

    oscillation: RecordedOscillation | None
    driven: float = math.nan
    blind: float = 0.0
    unasked: float = math.nan
    excited: tuple[float, float] | None = None
    away: Departure | None = None


def find_oscillation(record: Record, every_tick: bool = True) -> Search:
    """Strongest vibration in `record`, which has no gaps.

    every_tick   rows come as often as the controller runs; else its law does not show in them, and no excitation beside it

    Raises GainroomError where it holds neither a position nor a torque.
    """
    found = _search(record)
    seen = found.oscillation
    band = None if seen is None or not every_tick else excited_band(record, seen.side, seen.rows, seen.vibration.frequency)
    return found if band is None else replace(found, oscillation=None, excited=band)


def _search(record: Record) -> Search:
    """Search in a record whatever moves the joint."""
    side = next((name for name in (*POSITIONS, "motor_velocity", *reversed(TORQUES)) if record.has(name)), None)
    if side is None:
        raise GainroomError("diagnose: needs a position, a velocity or a torque")
    step = _encoder_step(record.channels[side]) if side in POSITIONS else 0.0
    reference = record.channels.get("reference") if side in POSITIONS else None
    pieces = steady_pieces(record, reference)
    if pieces:
        return _at_steady(record, side, reference, pieces, step)
    assert reference is not None
    return _of_outer_loop(record, side, reference, step) or _in_motion(record, side, reference, step)


def _at_steady(record: Record, side: str, reference: Floats | None, pieces: Sequence[slice], step: float) -> Search:
    """Search where the set-point rests or moves steadily: in the last long piece in which a motion is detected."""
    longest = max(len(record.time[rows]) for rows in pieces)
    long = [rows for rows in pieces if len(record.time[rows]) >= 0.5 * longest]
    deviation = record.channels[side] if reference is None else record.channels[side] - reference
    for steady in long[::-1]:
        found = _in_piece(record, side, reference, steady, deviation, step)
        if found is not None:
            break
    else:
        return Search(None)
    seen = found.oscillation
    if seen is not None and reference is not None and np.ptp(reference[seen.rows]) > 0:
        return replace(found, oscillation=replace(seen, turning=_turning(record, reference, deviation, pieces, seen)))
    return found


def _turning(record: Record, reference: Floats, deviation: Floats, pieces: Sequence[slice], seen: RecordedOscillation) -> Turning:
    return turning(reference, deviation, record.sample_time, pieces, seen.rows, seen.vibration.frequency)


def _in_piece(record: Record, side: str, reference: Floats | None, rows: slice, deviation: Floats, step: float) -> Search | None:
    """Search in one piece; None if it shows neither a vibration nor a departure."""
    found, tick = _found(deviation[rows], record.sample_time), record.sample_time
    ramp = reference is not None and float(np.ptp(reference[rows])) > 0
    away = departure(deviation[rows], tick, step) if reference is not None and side in POSITIONS and rows.stop == len(deviation) else None
    beside = found is None or not found.damping_ratio < RINGING or (away is not None and found.amplitude < MAIN * away.size)
    if away is not None and away.vibration is not None and beside:
        return Search(measured(record, side, rows, away.vibration, deviation, step), away=away)
    decaying, size = None, math.sqrt(2) * float(np.std(deviation[rows][-(len(deviation[rows]) // 3) :]))
    for attempt in range(TRIES):
        if found is None:
            break
        counts = _counts(found, record, rows, step, ramp) and (attempt == 0 or found.amplitude > MAIN * size)
        seen = measured(record, side, rows, found, deviation, step) if counts else None
        if seen is not None and reference is None and side in POSITIONS and as_commanded(seen, deviation[rows], tick):
            return Search(None, driven=seen.vibration.frequency, unasked=seen.vibration.amplitude)
        if seen is not None and _counts(seen.vibration, record, rows, step, ramp):
            if seen.vibrates:
                return Search(seen, away=away)
            decaying = decaying or Search(seen, away=away)
        found = _found(deviation[rows], tick, 1.05 * found.frequency)  # what looks like a vibration may be a joint's settling
    if decaying is not None:
        return decaying
    if away is not None:
        return Search(None, away=away)
    least = max((RAMP_STEPS if ramp else IRREGULAR_STEPS[0]) * step, IRREGULAR_VISIBLE)
    irregular = _irregular(deviation[rows], tick, step, least)
    return None if irregular is None else Search(measured(record, side, rows, irregular, deviation, step, irregular=True))


def _of_outer_loop(record: Record, side: str, reference: Floats, step: float) -> Search | None:
    """Vibration of the set-point that is a law of the position; None if there is none."""
    values, tick = record.channels[side], record.sample_time
    rows = slice(len(values) // 2, None)
    found = _found(values[rows], tick)
    if found is None or abs(found.damping_ratio) > STEADY or found.amplitude < max(MOVING_STEPS * step, VISIBLE_MOVING):
        return None
    period = 2 * math.pi / found.frequency / tick
    swing = abs(complex(parts_in(reference[rows][:, None], tick, found)[0]))
    mainly = swing > MAINLY * math.sqrt(2) * float(np.std(reference[rows]))
    if not mainly or not follows(reference[rows], values[rows], tick, found) or not follows_position(reference, values, period):
        return None
    seen = measured(record, side, rows, found, values, step)
    return Search(replace(seen, answers=True)) if seen.vibrates else None


def _in_motion(record: Record, side: str, reference: Floats, step: float) -> Search:
    """Search where the set-point moves all the time: in successive windows, above its own frequencies."""
    values = record.channels[side]
    deviation = values - reference
    driven, line, fastest = set_point(reference, record.sample_time)
    blind = BEYOND * fastest
    least = max(MOVING_STEPS * step, VISIBLE_MOVING)
    row: list[Vibration] = []
    best: tuple[slice, Vibration] | None = None
    for rows in windows(len(values)):
        found = _found(deviation[rows], record.sample_time, blind)
        counts = found is not None and found.amplitude >= least and not is_harmonic(found.frequency, line)
        if found is None or not counts or follows(reference[rows], deviation[rows], record.sample_time, found):
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
    """True if an oscillation at a steady set-point is large enough, in encoder steps and at its largest."""
    count = len(record.time[rows])
    change = math.exp(found.growth_rate * min(count, MOST_SAMPLES) * record.sample_time)
    decays = found.growth_rate * LOOKED_AT * 2 * math.pi / found.frequency < math.log(1 - UNCHANGED)
    steps = DECAYING_STEPS * change if decays else RAMP_STEPS if ramp else STEPS
    return found.amplitude >= max(steps * step, VISIBLE if any(record.has(name) for name in POSITIONS) else 0.0)


def _encoder_step(values: Floats) -> float:
    """Resolution of a position (m,): the step of which nearly all its changes are multiples; 0 if none is found.

    Fast motion in which no reading repeats is included. Rows interpolated for want of a reading lie on no step.
    """
    changes = np.abs(np.diff(values[-MOST_SAMPLES:]))
    changes = changes[changes > 1e-12]
    if len(changes) < 4:
        return 0.0
    different = np.unique(np.round(changes, 12))[:SMALLEST]
    between = np.diff(different)
    tried = np.unique(np.concatenate([different, between[between > 1e-12]]))[::-1]
    for step in tried.tolist():
        multiples = changes / step
        off = np.count_nonzero(np.abs(multiples - np.round(multiples)) > 0.01) + np.count_nonzero(multiples < 0.5)
        if off <= max(OFF_STEPS * len(changes), MOST_OFF) and off < 0.2 * len(changes) and multiples.max() < MOST_MULTIPLES:
            exact = multiples[np.abs(multiples - np.round(multiples)) <= 0.01]
            whole = np.round(exact)
            return float(step * np.sum(exact * whole) / np.sum(whole**2))
    return 0.0


def _found(values: Floats, tick: float, above: float = 0.0) -> Vibration | None:
    """Largest oscillation that is not the settling of a joint, in means over any number of ticks."""
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
    """Strongest lasting oscillation; if that is a joint's settling, a faster or later one; else the slowest to settle."""
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
    """Means of neighbouring rows, counted from the end."""
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


def departure(values: Floats, tick: float, step: float) -> Departure | None:
    """Departure from deviations (m,) from a set-point that rests or moves steadily; None if the joint stays with it.

    A swing that grows so fast that the log holds a few of them has no frequency that a spectrum shows, and one whose torque is limited
    becomes slower as it grows.
    """
    size = np.abs(values)
    crossings = np.flatnonzero(values[1:] * values[:-1] < 0) + 1
    edges = [0, *crossings.tolist(), len(values)]
    peaks = np.maximum.reduceat(size, edges[:-1])
    counted = peaks > 0.02 * float(size.max())  # noise near zero makes swings of its own
    places = np.array(edges[:-1])[counted]
    peaks = peaks[counted]
    if len(peaks) > 2 and peaks[-1] < peaks[-2] and size[-1] >= 0.99 * peaks[-1]:  # the log ends in the middle of a swing
        places, peaks = places[:-1], peaks[:-1]
    if len(peaks) >= SWINGS and len(peaks) < len(values) / 8:
        late = peaks[-3:]
        if (
            np.all(late[1:] > GROWS * late[:-1])
            and late[-1] > DOUBLES * late[0]
            and late[-1] >= size.max()
            and late[-1] > LARGE_STEPS * step
        ):
            half = float(np.mean(np.diff(places[-3:]))) * tick
            swings = Vibration(math.pi / half, float(math.log(late[-1] / late[0])) / (2 * half), float(late[-1]))
            return Departure(float(late[-1]), swings)
    early, end = float(size[: round(EARLY * len(size))].max()), float(size[-max(1, round(LATE * len(size))) :].max())
    return Departure(end, None) if end > max(FAR_TIMES * early, FAR_OFF, LARGE_STEPS * step) else None


def excited_band(record: Record, side: str, rows: slice, frequency: float) -> tuple[float, float] | None:
    """Band [rad/s] of an excitation in target_torque that contains `frequency` [rad/s]; None if the torque there is the loop's.

    A vibration goes round the loop, so that the controller's law makes its torque of the position; and it is a line of the spectrum that
    stands out, with its harmonics. An excitation over a band is neither. The law is that of least squares between torque and motion, both
    differenced twice (frequency_response.given_torque), here with the set-point and the integral of the error.

    side, rows   of the position in which an oscillation of that frequency was found
    """
    if not record.has("target_torque") or side not in ("motor_position", "link_position"):
        return None
    reference = record.channels["reference"][rows] if record.has("reference") else None
    torque, position = record.channels["target_torque"][rows], record.channels[side][rows]
    if len(torque) < 4 * LINE_WIDTH * FEEDBACK:
        return None
    whole, given = _power(torque[FEEDBACK - 1 :]), _power(_given(torque, position, reference))
    omega = 2 * math.pi * np.fft.rfftfreq(len(torque) - FEEDBACK + 1, record.sample_time)
    band = (omega > frequency / SLOWER) & (omega < FASTEST * math.pi / record.sample_time)
    total = float(whole[band].sum())
    line = float(whole[np.abs(omega - frequency) < LINE_WIDTH * omega[1]].sum())
    if not total > 0 or line > MOST_LINE * total or float(given[band].sum()) < LEAST_GIVEN * total:
        return None
    share = np.cumsum(whole[LINE_WIDTH:]) / float(whole[LINE_WIDTH:].sum())
    low, high = (float(omega[LINE_WIDTH:][int(np.argmax(share >= end))]) for end in (BEYOND_BAND, 1 - BEYOND_BAND))
    return low, high


def _given(torque: Floats, position: Floats, reference: Floats | None) -> Floats:
    """Part of the torque (m,) that no linear law of the last positions and set-points explains, without the first rows."""
    error, columns = position, [_latest(position)]
    if reference is not None and np.ptp(reference) > 0:
        error = position - reference
        columns.append(_latest(reference))
    law = np.hstack([*columns, np.cumsum(error)[FEEDBACK - 1 :, None]])
    changes = np.diff(law, 2, axis=0)
    scale = np.maximum(np.linalg.norm(changes, axis=0), 1e-300)
    asked = np.diff(torque[FEEDBACK - 1 :], 2)
    weights = np.linalg.lstsq(changes / scale, asked, rcond=1e-10)[0]
    off = np.abs(asked - changes / scale @ weights)
    few = off > np.quantile(off, 1 - SPOILT)  # rows that were spoilt, and made of their neighbours, are of no law
    weights = np.linalg.lstsq((changes / scale)[~few], asked[~few], rcond=1e-10)[0]
    given = torque[FEEDBACK - 1 :] - law @ (weights / scale)
    spoilt = np.convolve(np.pad(few, 1), np.ones(3), mode="same") > 0.5
    rows = np.arange(len(given))
    return np.interp(rows, rows[~spoilt], given[~spoilt])


def _latest(values: Floats) -> Floats:
    """Signal and its latest changes, (m − FEEDBACK + 1, FEEDBACK + 1)."""
    return np.column_stack([values[FEEDBACK - 1 :], sliding_window_view(np.diff(values, prepend=values[0]), FEEDBACK)])


def _power(values: Floats) -> Floats:
    """Power spectrum of a signal beside a straight line, under a Hann window."""
    time = np.linspace(-1, 1, len(values))
    return np.abs(np.fft.rfft((values - np.polyval(np.polyfit(time, values, 1), time)) * np.hanning(len(values)))) ** 2
