"""What vibrates in a played robot: after its move, or while it still moves, or before it falls."""

import math
from dataclasses import dataclass

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..linear.arrays import Complexes, Floats
from ..simulation.oscillation import SHORTEST, Vibration, parts_in, vibration
from ..simulation.robot_result import RobotRun
from .joint_simulation import doubling, keeps_up, lasts, that_rings

ENCODER_STEPS = 10.0
"""A vibration below so many encoder steps is the encoders' own doing."""
NOTICED = 1e-5
"""[m, rad] a smaller vibration is none."""
KNOCKS = 1e-4
"""[m, rad] likewise while it moves, where friction knocks as the motion starts and turns, and what it knocks rings for a while."""
FAINT = 1e-6
"""[m, rad] likewise where it is the very one that the linear loop, unstable, predicts."""
WINDOWS = 8
"""That a motion is cut into, each overlapping the next by half, to be listened to one by one: friction lets a vibration come and go."""
NEAR = 0.15
"""Relative: how far the frequency may be from that at the limit. It rises with the gains, and other postures have others."""
SAME, TIMES = 0.05, 3
"""A vibration that no limit predicts must be heard in so many windows in a row, at frequencies no further apart, relatively."""
SPLINE = 5 * 4 * math.pi
"""[rad] over the duration of a spline: it has next to nothing beyond a fifth of that frequency, and what friction makes of it little."""


@dataclass(frozen=True)
class Heard:
    """A vibration of a run.

    found    amplitude [m, rad]: of the channel after the move, of the motor while it moves
    rows     of the run in which it was heard
    moving   heard while the reference moved, or before the run ended by itself
    parts    (n,) complex: the motors' parts in it, the largest 1
    swing    of the motor that swings most, at the end of those rows [rad]
    """

    found: Vibration
    rows: slice
    moving: bool
    parts: Complexes
    swing: float


def listen(run: RobotRun, moved: float, limit: GainLimit | None, linear: bool) -> Heard | None:
    """The vibration that lasts, else that which dies away after the move; None where nothing rings.

    moved    [s] until when the reference moves
    limit    of the linear loop
    linear   nothing there could hold a vibration at its size

    Of a run that ended early only a linear loop that is unstable is listened to: what swings as a robot topples is no vibration.
    """
    rest = _at_rest(run, moved, limit)
    if rest is not None and shows(rest, run.setup.encoder_step, linear):
        return rest
    return _moving(run, moved, limit) or rest


def shows(heard: Heard, encoder_step: float, linear: bool) -> bool:
    """Whether anyone would see it, by more than encoders' steps make, and it does not die away."""
    if heard.moving:  # which looks for no other
        return True
    return heard.found.amplitude > max(NOTICED, ENCODER_STEPS * encoder_step) and lasts(heard.found, linear)


def in_words(heard: Heard, linear: bool) -> str:
    """How it goes on."""
    if heard.moving:
        return "while it moves"
    return "keeping up" if not linear and keeps_up(heard.found) else doubling(heard.found)


def _at_rest(run: RobotRun, moved: float, limit: GainLimit | None) -> Heard | None:
    """After the reference came to rest; of a run that ran away in its second half."""
    if run.ending == "fell" or (run.ending == "diverged" and (limit is None or limit.stable)):
        return None
    first = round(moved / run.setup.sample_time) if run.ending == "completed" else len(run.time) // 2
    rows = slice(first, len(run.time))
    seen = run.rows(rows)
    found = that_rings(vibration(seen.error, run.setup.sample_time), NOTICED) if len(seen.time) >= SHORTEST else None
    return None if found is None else _heard(run, found, rows, moving=False)


def _moving(run: RobotRun, moved: float, limit: GainLimit | None) -> Heard | None:
    """The strongest that keeps up from window to window, or that in one is the one that an unstable loop predicts.

    Above the reference's own frequencies, in the motors' accelerations: there a vibration stands out of the motion under it.
    """
    tick, ended = run.setup.sample_time, run.ending != "completed"
    unstable = limit is not None and not limit.stable
    end = len(run.time) if ended else min(len(run.time), round(moved / tick))
    if ended and not unstable:
        return None
    lowest = SPLINE / moved if moved > 0 else 0.0
    if unstable and limit is not None and limit.frequency > 0:
        lowest = max(lowest, (1 - NEAR) * limit.frequency) if ended else min(lowest, (1 - NEAR) * limit.frequency)
    found = [(rows, _in_window(run, rows, lowest)) for rows in _windows(end)]
    kept: list[tuple[slice, Vibration]] = []
    least = max(KNOCKS, ENCODER_STEPS * run.setup.encoder_step)
    for index, (rows, one) in enumerate(found):
        if one is None:
            continue
        row = [earlier for _, earlier in found[max(0, index - TIMES + 1) : index + 1] if earlier is not None]
        again = len(row) == TIMES and all(_alike(earlier, one.frequency, SAME) and earlier.amplitude > least for earlier in row)
        predicted = unstable and limit is not None and one.amplitude > FAINT and _alike(one, limit.frequency, NEAR)
        if again or predicted:
            kept.append((rows, one))
    if not kept:
        return None
    rows, strongest = max(kept, key=lambda pair: pair[1].amplitude)
    return _heard(run, strongest, rows, moving=True)


def _alike(one: Vibration, frequency: float, within: float) -> bool:
    return abs(one.frequency - frequency) <= within * frequency


def _windows(end: int) -> list[slice]:
    """Of `end` ticks; none where they are too few to listen to."""
    size = max(SHORTEST + 2, 2 * end // (WINDOWS + 1))
    return [slice(first, first + size) for first in range(0, end - size + 1, max(1, size // 2))]


def _in_window(run: RobotRun, rows: slice, lowest: float) -> Vibration | None:
    """What grows or keeps up there, with the amplitude of the motors' swing [m, rad]."""
    tick = run.setup.sample_time
    found = vibration(_accelerations(run, rows), tick, above=lowest)
    if found is None or not lasts(found, linear=False):
        return None
    return Vibration(found.frequency, found.growth_rate, found.amplitude / found.frequency**2)


def _accelerations(run: RobotRun, rows: slice) -> Floats:
    """(k - 2, n) of the motors [m/s², rad/s²]."""
    return np.diff(run.motor_position[rows], n=2, axis=0) / run.setup.sample_time**2


def _heard(run: RobotRun, found: Vibration, rows: slice, moving: bool) -> Heard:
    if moving:  # the motion would drown it in the positions
        parts = parts_in(_accelerations(run, rows), run.setup.sample_time, found) / complex(found.growth_rate, found.frequency) ** 2
    else:
        parts = parts_in(run.motor_position[rows], run.setup.sample_time, found)
    largest = complex(parts[np.argmax(np.abs(parts))])
    return Heard(found, rows, moving, parts / largest, abs(largest))


def chatter(run: RobotRun, moved: float) -> Floats:
    """(n,) RMS of the actual torque beyond the reference's own frequencies [N m], over the whole run."""
    count = len(run.time)
    taper = np.hanning(count)[:, None]
    waves = np.fft.rfft(taper * (run.actual_torque - run.actual_torque.mean(axis=0)), axis=0)
    waves[: math.ceil(SPLINE / (moved or run.time[-1] + run.setup.sample_time) / (2 * math.pi) * count * run.setup.sample_time)] = 0
    return np.sqrt(np.mean(np.fft.irfft(waves, count, axis=0) ** 2, axis=0) / max(float(np.mean(taper**2)), 1e-300))
