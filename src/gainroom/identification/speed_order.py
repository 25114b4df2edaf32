"""Whether a vibration comes with the joint's turning: so many periods per turn at every speed, as torque ripple, cogging or teeth make.

Where the set-point moves steadily each piece of it has a speed and, if it vibrates, a frequency. Two speeds show whether the frequency is
that of a turn. At one speed alone the number of periods per turn of the motor is a whole one, or is not.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..simulation.oscillation import Vibration
from ..system.linear.arrays import Floats

APART = 0.1  # relative, of two speeds that tell something
SAME = 0.03  # relative, of frequency over speed
FEWEST_PERIODS = 4.0  # in a piece


@dataclass(frozen=True)
class Turning:
    """How frequency and speed go together.

    order    periods per radian of the joint, of the fastest piece; NaN: it does not turn
    speeds   pieces with speeds of their own
    spread   standard deviation of the logarithm of frequency over speed among pieces; 0 for one
    fixed    likewise of the frequency itself: what does not come with the turning keeps it
    """

    order: float = math.nan
    speeds: int = 0
    spread: float = 0.0
    fixed: float = 0.0

    @property
    def scales(self) -> bool:
        """Whether the frequency goes with the speed."""
        return self.speeds > 1 and self.spread < SAME and self.fixed > 2 * self.spread


def turning(
    reference: Floats, deviation: Floats, tick: float, pieces: Sequence[slice], found_in: Callable[[Floats], Vibration | None]
) -> Turning:
    """Of the `pieces` in which the set-point `reference` (m,) moves steadily; `found_in`: the oscillation in a part of `deviation` (m,)."""
    pairs: list[tuple[float, float]] = []
    for rows in pieces:
        part = reference[rows]
        speed = abs(float(part[-1] - part[0])) / ((len(part) - 1) * tick)
        if speed == 0:
            continue
        found = found_in(deviation[rows])
        if found is not None and found.frequency * len(part) * tick > FEWEST_PERIODS * 2 * math.pi:
            pairs.append((speed, found.frequency))
    if not pairs:
        return Turning()
    speeds, frequencies = np.array(pairs).T
    order = float(frequencies[np.argmax(speeds)] / speeds.max())
    distinct = 1 + int(np.count_nonzero(np.diff(np.log(np.sort(speeds))) > APART))
    return Turning(order, distinct, float(np.std(np.log(frequencies / speeds))), float(np.std(np.log(frequencies))))
