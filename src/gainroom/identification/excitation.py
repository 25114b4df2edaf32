"""Torques that excite a joint over a band: a multisine with a low peak, or a chirp.

Phases start from Schroeder's (IEEE Trans. Inf. Theory 16, 1970, 85–89), under which the sum's momentary frequency sweeps the band as a
chirp's does, and are improved by clipping the sum and giving each line its amplitude back (Van der Ouderaa, Schoukens, Renneboog,
IEEE Trans. Instrum. Meas. 37, 1988, 145–147).
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..system.linear.arrays import Floats, Integers

Kind = Literal["multisine", "chirp"]
LINES = 100  # of a multisine
LONGEST_PERIOD = 20.0  # [s] of a multisine; what lasts longer repeats it
CLIPPED = (0.7, 0.98)  # of the peak, from the first round to the last
ROUNDS = 1000  # from a crest factor of about 4 to one of about 2
RAMP = 0.5  # [s] over which a torque begins and ends, so that nothing is hit
RAMP_SHARE = 0.1  # of the duration, at most


@dataclass(frozen=True)
class Excitation:
    """Torque of peak 1, tick by tick.

    time, torque   (m,) [s], 0 at both ends
    frequencies    (l,) of its lines, or of a chirp its first and last [rad/s]
    """

    time: Floats
    torque: Floats
    frequencies: Floats

    @property
    def crest_factor(self) -> float:
        """Peak over root mean square of the torque."""
        return float(np.abs(self.torque).max() / np.sqrt(np.mean(self.torque**2)))


def excitation(kind: Kind, first: float, last: float, duration: float, sample_time: float, tilt: float = 0.0) -> Excitation:
    """Excitation from `first` to `last` [rad/s] for `duration` [s], equal time or lines per octave; torque grows with ω^tilt."""
    from scipy.fft import next_fast_len

    count = round(duration / sample_time)
    time = np.arange(count + 1) * sample_time
    if kind == "chirp":
        growth = math.log(last / first)
        values = np.sin(first * duration / growth * np.expm1(growth * time / duration))
        values *= np.exp(tilt * growth * (time / duration - 1))
        frequencies = np.array([first, last])
    else:
        # One long period, not many short ones: what encoders round off comes again in every period, and averages do not take it out.
        repeats = math.ceil(duration / LONGEST_PERIOD)
        ticks = int(next_fast_len(math.ceil((count + 1) / repeats), real=True))  # type: ignore[arg-type]
        base = 2 * math.pi / (ticks * sample_time)
        lines = np.unique(np.rint(np.geomspace(first, last, LINES) / base).astype(int))
        values = np.tile(of_low_peak(lines, (lines / lines[-1]) ** tilt, ticks), repeats)[: count + 1]
        frequencies = base * lines
    ends = max(int(min(RAMP, RAMP_SHARE * duration) / sample_time), 1)
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(ends) / ends)
    values[:ends] *= ramp
    values[-ends:] *= ramp[::-1]
    return Excitation(time, values / np.abs(values).max() + 0.0, frequencies)  # + 0: no −0 in a file


def of_low_peak(lines: Integers, amplitudes: Floats, count: int) -> Floats:
    """Sum (count,) of sines with `lines` (l,) whole periods each, rising and below count/2, with phases for a low peak."""
    # Schroeder's idea for lines anywhere: each has its turn, a delay that grows by its share of the power from line to line.
    turns = np.cumsum(amplitudes**2) / np.sum(amplitudes**2)
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    spectrum[lines] = amplitudes * np.exp(-2j * np.pi * np.append(0.0, np.cumsum(np.diff(lines) * turns[:-1])))
    best = np.fft.irfft(spectrum, count)
    lowest = float(np.abs(best).max())
    # Clipping harder first: the peaks that are left are then lower.
    for share in np.linspace(*CLIPPED, ROUNDS):
        values = np.fft.irfft(spectrum, count)
        peak = float(np.abs(values).max())
        if peak < lowest:
            best, lowest = values, peak
        clipped = np.fft.rfft(np.clip(values, -share * peak, share * peak))[lines]
        spectrum[lines] = amplitudes * np.exp(1j * np.angle(clipped))
    return best
