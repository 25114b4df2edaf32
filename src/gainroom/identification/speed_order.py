"""Detection of vibrations at a fixed number of periods per turn, at every speed, as torque ripple, cogging or teeth make.

Where the set-point moves steadily each piece of it has a speed. From the piece in which a vibration was found its frequency is carried over
to the others in proportion to their speeds, and as it is: the power at either says which it keeps to. At one speed alone the periods per
turn of the motor are a whole number, or are not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats

APART = 0.1  # relative, of two speeds that tell something
NEAR = 0.03  # relative, of a frequency
SETTLED = 0.35  # of a piece, from which on it is looked at
FEWEST_LINES = 4  # of the spectrum: slower, the settling is there
LEAST_SHARE, TIMES_FIXED = (
    0.3,
    5.0,
)  # of the power that a vibration has in every piece, or so many times what keeps the frequency, if a tenth


@dataclass(frozen=True)
class Turning:
    """Relation of frequency and speed.

    order    periods per radian of the joint; NaN: it does not turn
    speeds   pieces at speeds of their own in which that can be seen, beside the one of the vibration
    scaled   least share of a piece's power at a frequency in proportion to the speed; NaN for none
    fixed    largest share at the frequency itself; likewise
    """

    order: float = math.nan
    speeds: int = 0
    scaled: float = math.nan
    fixed: float = math.nan

    @property
    def scales(self) -> bool:
        """True if the frequency is proportional to the speed."""
        clear = LEAST_SHARE if self.scaled < TIMES_FIXED * self.fixed else LEAST_SHARE / 6
        return self.speeds > 0 and self.scaled > max(clear, self.fixed)


def turning(reference: Floats, deviation: Floats, tick: float, pieces: Sequence[slice], rows: slice, frequency: float) -> Turning:
    """Relation of a vibration [rad/s] in `rows` to speed; the set-point `reference` (m,) moves steadily in each of the `pieces`."""
    own = _speed(reference[rows], tick)
    shares = []
    for piece in pieces:
        speed = _speed(reference[piece], tick)
        ratio = speed / own
        if speed == 0 or abs(math.log(ratio)) < APART or ratio * frequency > 0.9 * math.pi / tick:
            continue
        part = deviation[piece]
        above = min(ratio, 1.0) * frequency / 2  # what is slower is settling
        scaled, fixed = (_share(part[round(SETTLED * len(part)) :], tick, omega, above) for omega in (ratio * frequency, frequency))
        if not math.isnan(scaled):
            shares.append((scaled, fixed))
    if not shares:
        return Turning(frequency / own)
    return Turning(frequency / own, len(shares), min(one for one, _ in shares), max(one for _, one in shares))


def _speed(reference: Floats, tick: float) -> float:
    return abs(float(reference[-1] - reference[0])) / ((len(reference) - 1) * tick)


def _share(values: Floats, tick: float, omega: float, above: float) -> float:
    """Share of the power of `values` (k,) above the frequency `above` that lies near `omega`; NaN if too few lines lie below `omega`."""
    line = np.linspace(-1, 1, len(values))
    rest = values - np.polyval(np.polyfit(line, values, 1), line)
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) ** 2
    lines = 2 * math.pi * np.fft.rfftfreq(len(rest), tick)
    if omega < FEWEST_LINES * lines[1]:
        return math.nan
    near = np.abs(lines - omega) < max(NEAR * omega, 2.5 * lines[1])
    return float(power[near].sum() / max(float(power[lines > above].sum()), 1e-300))
