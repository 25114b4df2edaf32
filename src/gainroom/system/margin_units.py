"""Units of margins: display units and SI."""

import math

IN_SI = {"dB": ", a factor: 10**(6 / 20) is 6 dB", "°": " rad: numpy.radians(30) is 30°", "ms": " s: 0.002 is 2 ms"}
"""Note on the SI value of a bound, for messages, by its unit in files."""


def to_db(factor: float) -> float:
    """A gain factor in decibels; −inf for 0."""
    return 20 * math.log10(factor) if factor > 0 else -math.inf if factor == 0 else math.nan


def from_db(level: float) -> float:
    """Gain factor of `level` [dB]."""
    return 10 ** (level / 20)
