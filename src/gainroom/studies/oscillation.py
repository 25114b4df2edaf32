"""Detection of sustained vibration in a simulated run.

The search starts after the last change of reference or disturbance. A run that is stepped exactly is continued if that comes late, and if a
stable linear loop shows an oscillation, which may still decay; MuJoCo's runs are also searched during the motion.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.margin_record import GainLimit
from ..analysis.stability import rightmost_roots
from ..simulation.oscillation import FEWEST_SAMPLES, MOST_SAMPLES, Vibration, parts_in, rows_after, vibration, windows
from ..simulation.run_record import Run
from ..simulation.simulation_spec import LATE_SHARE, SimulationSpec
from ..system.linear.arrays import Complexes, Floats
from .state import STRONG, strongest_first

LASTING = 1e-3  # damping ratio below which a vibration on hardware is sustained: what ends its growth there is friction or the torque limit
RESTING = 0.1  # damping ratio above which an oscillation is the settling of a joint
HARMONICS = 5.0  # times a moving reference's own frequency: most of friction's harmonics lie below
UNCHANGED = 0.1  # relative: a vibration that changes less over the rows examined is sustained
PATIENCE = 7.0  # time constants: a decaying motion is then down to a thousandth
UNDIMINISHED = 0.7  # relative to the size before: irregular motion that falls below decays
FRICTION_STARTS = 1e-4  # [m, rad] smaller oscillations during motion are not counted: friction excites them as the motion starts and turns
PREDICTED = 1e-6  # [m, rad] likewise of the vibration that an unstable linear loop predicts
NEAR_LIMIT = 0.15  # relative: how far the frequency may be from that at the limit. It rises with the gains, and other postures have others
SAME_FREQUENCY, TIMES = 0.05, 3  # relative: no further apart in so many successive windows: a vibration, also where no limit predicts one
SPLINE = 5 * 4 * math.pi  # [rad] over a spline's duration: it has almost no energy beyond a fifth of that, friction's harmonics included


@dataclass(frozen=True)
class Thresholds:
    """Amplitudes below which a vibration is not counted [m, rad].

    gone    decayed
    least   below visibility on hardware
    steps   in multiples of the encoders' step, or the noise's standard deviation, which cause as much in a stable loop
    """

    gone: float
    least: float
    steps: float


EXACT = Thresholds(gone=1e-9, least=1e-6, steps=3.0)
MUJOCO = Thresholds(gone=1e-5, least=1e-5, steps=10.0)
"""Thresholds for MuJoCo: the compliance of contacts and constraints, and gear transients, are smaller."""


@dataclass(frozen=True)
class Oscillation:
    """Vibration in a run.

    vibration   frequency, growth and amplitude [m, rad]: of the error after the last event; during motion, of the motor that moves most
    rows        of the run in which it was found
    lasts       True: it grows, or does not decay, and is large enough to count
    sustained   True: it neither grows nor decays over the rows examined
    moving      True: found while the reference moved, or before the run ended early
    irregular   True: driven by noise or encoder steps, without a single frequency: `vibration` has its power, at its mean frequency
    names, parts   (j,) a joint's sides, or a robot's motors, and their complex amplitudes, the largest 1
    swing       the largest amplitude, at the end of those rows [m, rad]
    least       smallest amplitude that counts [m, rad]
    """

    vibration: Vibration
    rows: slice
    names: tuple[str, ...]
    parts: Complexes
    swing: float
    lasts: bool = False
    sustained: bool = False
    moving: bool = False
    irregular: bool = False
    least: float = 0.0

    @property
    def strongest(self) -> tuple[str, ...]:
        """Names of the participating signals, the largest amplitude first."""
        parts = np.abs(self.parts)
        return tuple(self.names[k] for k in strongest_first(self.parts).tolist() if parts[k] >= STRONG * parts.max())


@dataclass(frozen=True)
class _Record:
    """Rows without a change of reference or disturbance: error (k, m), and oscillating positions (k, j), by name.

    Only frequencies above `above` [rad/s] count.
    """

    error: Floats
    swinging: Floats
    names: tuple[str, ...]
    rows: slice
    above: float = 0.0


def oscillation_in(spec: SimulationSpec, gain: float, run: Run, limit: GainLimit | None) -> tuple[Oscillation | None, float]:
    """Vibration in a run with all gains times `gain`: a sustained or growing one, otherwise a decaying one; None if there is none.

    limit   of the linear loop, as a factor on the gains of the run; None: they act on no motion

    The second value is the joint's motion due to noise and encoder steps where no vibration is sustained, RMS [rad]. A linear loop vibrates
    only if it is unstable, whatever a short record shows. A robot's run that ended early is searched only if its linear loop is unstable:
    the oscillation of a toppling robot is no vibration.
    """
    stable, completed = limit is None or limit.stable, run.ending == "completed"
    if not spec.is_exact:
        rest = None
        if completed or (run.diverged and not stable):
            rest, _ = _oscillation_of(spec, _at_rest(spec, run), stable)
        return (rest if rest is not None and rest.lasts else _in_motion(spec, run, limit) or rest), 0.0
    found, noise_motion = _oscillation_of(spec, _after_last_event(spec, gain, run), stable, irregular=completed)
    if found is not None and found.lasts and stable and completed:
        again, noise_motion = _oscillation_of(spec, _after_settling(spec, gain), stable=True)
        if again is None or not again.lasts:
            return again, noise_motion
    return found, noise_motion


def _oscillation_of(spec: SimulationSpec, record: _Record, stable: bool, irregular: bool = True) -> tuple[Oscillation | None, float]:
    """Vibration in `record`, and the RMS of irregular motion where none is sustained; `stable`: stability of the linear loop."""
    sizes, unsteady = EXACT if spec.is_exact else MUJOCO, max(spec.noise, spec.encoder_step)
    least = max(sizes.least, sizes.steps * unsteady)
    if spec.is_exact:
        least = 0.0 if spec.is_linear else least if stable else sizes.least
    possible = not (spec.is_exact and spec.is_linear and stable)
    found = vibration(record.error, spec.sample_time, above=record.above) if len(record.error) >= FEWEST_SAMPLES else None
    seen = None
    if found is not None and found.damping_ratio <= RESTING and not (found.growth_rate < 0 and found.amplitude < sizes.gone):
        seen = _oscillation(spec, record, found, least, possible)
    if (seen is not None and seen.lasts) or not (spec.is_exact and irregular and unsteady > 0 and record.above == 0):
        return seen, 0.0
    driven, held = _irregular(spec, record)
    if driven is None:
        return seen, 0.0
    size = driven.swing / math.sqrt(2)
    if possible and held and driven.swing > least:
        return replace(driven, least=least), size
    return seen, size


def _oscillation(spec: SimulationSpec, record: _Record, found: Vibration, least: float, possible: bool) -> Oscillation:
    """Oscillation with its parts and size over the last periods: over a whole record a pole and a limit cycle drift apart in phase."""
    parts = parts_in(record.swinging, spec.sample_time, found)
    largest = complex(parts[np.argmax(np.abs(parts))])
    swing, size = float(np.abs(parts).max()), found.amplitude
    if spec.is_exact:
        size = min(size, swing)
    lasts = possible and _lasts(found, spec.is_linear) and size > least
    sustained = lasts and not spec.is_linear and abs(found.damping_ratio) < LASTING
    if spec.is_exact:
        sustained = sustained and abs(found.growth_rate) * min(len(record.error), MOST_SAMPLES) * spec.sample_time < UNCHANGED
    if lasts and spec.is_exact:
        found = replace(found, amplitude=swing)
    return Oscillation(found, record.rows, record.names, parts / largest, swing, lasts, sustained, least=least)


def _lasts(found: Vibration, linear: bool) -> bool:
    """True if the vibration does not decay; `linear`: no effect bounds its amplitude."""
    return found.growth_rate > 0 if linear else found.damping_ratio < LASTING


def _irregular(spec: SimulationSpec, record: _Record) -> tuple[Oscillation | None, bool]:
    """Motion without a single frequency in the last third, and True if it has not decayed since the third before; None without motion.

    It is reported as an oscillation with the power of the largest signal, at its mean frequency (root mean square, weighted by power).
    """
    from scipy.signal import detrend

    third = len(record.swinging) // 3
    if third < FEWEST_SAMPLES:
        return None, False
    before, last = (detrend(part, axis=0) for part in (record.swinging[-2 * third : -third], record.swinging[-third:]))
    sizes = last.std(axis=0)
    most = int(np.argmax(sizes))
    size = float(last[:, most].std())
    if size == 0:
        return None, False
    power = np.abs(np.fft.rfft(last[:, most] * np.hanning(third))) ** 2
    omega = 2 * math.pi * np.fft.rfftfreq(third, spec.sample_time)
    mean = math.sqrt(float(np.average(omega**2, weights=power)))
    held = bool(size >= UNDIMINISHED * before.std(axis=0).max())
    found = Vibration(mean, 0.0, math.sqrt(2) * size)
    parts = (sizes / sizes.max()).astype(complex)
    return Oscillation(found, record.rows, record.names, parts, found.amplitude, lasts=True, sustained=True, irregular=True), held


def _at_rest(spec: SimulationSpec, run: Run) -> _Record:
    """Record after the reference came to rest."""
    rows = spec.at_rest(run)
    return _Record(run.error[rows], run.motor_position[rows], run.joint_names, rows)


def _after_last_event(spec: SimulationSpec, gain: float, run: Run) -> _Record:
    """Searched rows of a joint's run, after the last event.

    The response to a late change is no vibration: the run is continued for as long again, its reference held. With friction, which might
    then stop the vibration, an oscillating reference continues, and only much higher frequencies count.
    """
    late, duration = spec.last_event, spec.duration
    if run.diverged:
        return _sides(run, spec.at_rest(run))
    swings = spec.fastest > 0 and spec.moves_until >= duration and not spec.is_linear
    if swings and spec.disturbed_from <= LATE_SHARE * duration:
        return _sides(run, rows_after(run, max(spec.disturbed_from, duration / 2)), HARMONICS * spec.fastest)
    if late <= LATE_SHARE * duration:
        return _sides(run, spec.at_rest(run))
    rest = min(spec.ticks, MOST_SAMPLES)
    return _run_on(spec, gain, rest, rest, swings)


def _after_settling(spec: SimulationSpec, gain: float) -> _Record:
    """Run continued until the stable linear loop has settled, then for the settling time of a link behind an immobile motor.

    A short record may show a settling joint; a vibration that friction, steps or a limit sustain is still present then.
    """
    longest = MOST_SAMPLES * spec.sample_time
    rate = -float(rightmost_roots(spec.loop(gain), count=1).roots[0].real)
    held = spec.link_decay or rate
    wait, look = (min(PATIENCE / max(slow, PATIENCE / longest), longest) for slow in (rate, min(rate, held)))
    rest = round(look / spec.sample_time)
    return _run_on(spec, gain, round(wait / spec.sample_time) + rest, rest, spec.fastest > 0 and spec.moves_until >= spec.duration)


def _run_on(spec: SimulationSpec, gain: float, further: int, rest: int, swings: bool) -> _Record:
    """Last `rest` of `further` ticks after the run; `swings`: its reference continues, otherwise it is held."""
    record = _sides(spec.continued(gain, further, swings), slice(-rest, None), HARMONICS * spec.fastest if swings else 0.0)
    return replace(record, rows=slice(0, None))


def _sides(run: Run, rows: slice, above: float = 0.0) -> _Record:
    """True position error of motor and link side."""
    error = (run.reference - np.hstack([run.motor_position, run.link_position]))[rows]
    return _Record(error, error, ("the motor side", "the link side"), rows, above)


def _in_motion(spec: SimulationSpec, run: Run, limit: GainLimit | None) -> Oscillation | None:
    """Strongest vibration found in successive windows, or one with the frequency of an unstable loop in a single window.

    It is searched above the reference's own frequencies, in the motors' accelerations, where a vibration dominates the motion.
    """
    tick, ended, moved = run.sample_time, run.ending != "completed", spec.moves_until
    unstable = limit is not None and not limit.stable
    end = len(run.time) if ended else min(len(run.time), round(moved / tick))
    if ended and not unstable:
        return None
    lowest = SPLINE / moved if moved > 0 else 0.0
    if unstable and limit is not None and limit.frequency > 0:
        lowest = max(lowest, (1 - NEAR_LIMIT) * limit.frequency) if ended else min(lowest, (1 - NEAR_LIMIT) * limit.frequency)
    found = [(rows, _in_window(run, rows, lowest)) for rows in windows(end)]
    lasting: list[tuple[slice, Vibration]] = []
    least = max(FRICTION_STARTS, MUJOCO.steps * spec.encoder_step)
    for index, (rows, one) in enumerate(found):
        if one is None:
            continue
        row = [earlier for _, earlier in found[max(0, index - TIMES + 1) : index + 1] if earlier is not None]
        again = len(row) == TIMES and all(_alike(earlier, one.frequency, SAME_FREQUENCY) and earlier.amplitude > least for earlier in row)
        predicted = unstable and limit is not None and one.amplitude > PREDICTED and _alike(one, limit.frequency, NEAR_LIMIT)
        if again or predicted:
            lasting.append((rows, one))
    if not lasting:
        return None
    rows, strongest = max(lasting, key=lambda pair: pair[1].amplitude)
    turn = complex(strongest.growth_rate, strongest.frequency)
    parts = parts_in(_accelerations(run, rows), tick, strongest) / turn**2  # of the positions, in which the motion dominates
    largest = complex(parts[np.argmax(np.abs(parts))])
    return Oscillation(strongest, rows, run.joint_names, parts / largest, abs(largest), lasts=True, moving=True)


def _alike(one: Vibration, frequency: float, within: float) -> bool:
    return abs(one.frequency - frequency) <= within * frequency


def _in_window(run: Run, rows: slice, lowest: float) -> Vibration | None:
    """Growing or sustained vibration in a window, with the amplitude of the motors' motion [m, rad]; None: neither."""
    found = vibration(_accelerations(run, rows), run.sample_time, above=lowest)
    if found is None or not _lasts(found, linear=False):
        return None
    return Vibration(found.frequency, found.growth_rate, found.amplitude / found.frequency**2)


def _accelerations(run: Run, rows: slice) -> Floats:
    """Motor accelerations (k - 2, n) [m/s², rad/s²]."""
    return np.diff(run.motor_position[rows], n=2, axis=0) / run.sample_time**2


def torque_ripple_of(run: Run, moved: float) -> Floats:
    """Torque ripple (n,): RMS of the actual torque [N m] above the frequencies of a spline that ends at `moved` [s], over the whole run."""
    count = len(run.time)
    taper = np.hanning(count)[:, None]
    waves = np.fft.rfft(taper * (run.actual_torque - run.actual_torque.mean(axis=0)), axis=0)
    waves[: math.ceil(SPLINE / (moved or run.time[-1] + run.sample_time) / (2 * math.pi) * count * run.sample_time)] = 0
    return np.sqrt(np.mean(np.fft.irfft(waves, count, axis=0) ** 2, axis=0) / max(float(np.mean(taper**2)), 1e-300))
