"""Detection of an excitation in a record's torque, such as a multisine beside the controller's: the motion it makes is no vibration.

A vibration goes round the loop, so that the controller's law makes its torque of the position; and it is a line of the spectrum that stands
out, with its harmonics. An excitation over a band is neither. The law is that of least squares between torque and motion, both differenced
twice (frequency_response.given_torque), here with the set-point and the integral of the error.
"""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..system.linear.arrays import Floats
from .frequency_response import FEEDBACK
from .record import Record

GIVEN = 0.2  # of the torque's power, from which on feedback does not make it: of virtual vibrations below 1e-6, of multisines above 1
LINE = 0.4  # likewise: less at the vibration's frequency is one line among others; of a vibration it is 0.9, of stick-slip 0.25 or more
NEAR = 4  # lines of the spectrum that are one under its window
SPOILT = 0.02  # of the rows, which may be left out: an excitation is in all of them
SLOWER, FASTEST = 2.5, 0.9  # the band looked at: from the frequency over this, up to this share of half the rate
ENDS = 0.02  # of the excitation's power beyond either end of its band


def excited_band(record: Record, side: str, rows: slice, frequency: float) -> tuple[float, float] | None:
    """Band [rad/s] of an excitation in target_torque that contains `frequency` [rad/s]; None if the torque there is the loop's.

    side, rows   of the position in which an oscillation of that frequency was found
    """
    if not record.has("target_torque") or side not in ("motor_position", "link_position"):
        return None
    reference = record.channels["reference"][rows] if record.has("reference") else None
    torque, position = record.channels["target_torque"][rows], record.channels[side][rows]
    if len(torque) < 4 * NEAR * FEEDBACK:
        return None
    whole, given = _power(torque[FEEDBACK - 1 :]), _power(_given(torque, position, reference))
    omega = 2 * math.pi * np.fft.rfftfreq(len(torque) - FEEDBACK + 1, record.sample_time)
    band = (omega > frequency / SLOWER) & (omega < FASTEST * math.pi / record.sample_time)
    total = float(whole[band].sum())
    line = float(whole[np.abs(omega - frequency) < NEAR * omega[1]].sum())
    if not total > 0 or line > LINE * total or float(given[band].sum()) < GIVEN * total:
        return None
    share = np.cumsum(whole[NEAR:]) / float(whole[NEAR:].sum())
    low, high = (float(omega[NEAR:][int(np.argmax(share >= end))]) for end in (ENDS, 1 - ENDS))
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
