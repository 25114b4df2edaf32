"""Detection of a joint that runs away from its set-point to the end of a record: in growing swings, or in one direction.

A swing that grows so fast that the log holds a few of them has no frequency that a spectrum shows, and one whose torque is limited becomes
slower as it grows.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..simulation.oscillation import Vibration
from ..system.linear.arrays import Floats

SWINGS = 4  # half periods, of which the last three grow
GROWS = 1.1  # from one to the next, at least
DOUBLES = 2.0  # over two of them
LARGE_STEPS = 30.0  # of the encoder
FAR = 5.0  # times the largest deviation of before: with many swings, or none
FAR_OFF = 0.2  # [rad] likewise, at least
EARLY, LATE = 0.7, 0.1  # of the rows: those before, and the end


@dataclass(frozen=True)
class Departure:
    """Departure from the set-point: size at the end [rad], and frequency, growth rate and amplitude of the last swings if they are few."""

    size: float
    vibration: Vibration | None


def departure(values: Floats, tick: float, step: float) -> Departure | None:
    """Departure from deviations (m,) from a set-point that rests or moves steadily; None if the joint stays with it."""
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
    return Departure(end, None) if end > max(FAR * early, FAR_OFF, LARGE_STEPS * step) else None
