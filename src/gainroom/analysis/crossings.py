"""Every crossing and every peak of a scalar response along the boundary of stability, certified between the points.

The walk is native/include/gainroom/scan.hpp, where the method is described.
"""

from dataclasses import dataclass

from ..native import _core
from ..system.linear.arrays import Floats
from ..system.linear.transfer_function import Factored

FLOOR = _core.FLOOR
"""In continuous time the walk ends where |L| stays below; lower until it cannot come back to the nearest crossing found."""
LOWEST_FLOOR = _core.LOWEST_FLOOR
"""Crossings below are left out: which of them comes first is not known."""


@dataclass(frozen=True)
class Scan:
    """What one loop's response does along the whole stability boundary.

    gains        (g, 2): ω of every |L| = 1, arg L there by continuity from small s > 0
    phases       (p, 3): ω of every arg L = π (mod 2π), |L| there, sign of the phase slope (0 at an end of the boundary)
    peaks        (3, 2): ω and minimum of |1+L|, |1+L|/|L|, 2|1+L|/|1−L|; zeros when not requested
    half_turns   change of arg(1+L) along the upper half of the contour, divided by π
    certified    False where rounding or the work limit stopped the proof
    """

    gains: Floats
    phases: Floats
    peaks: Floats
    half_turns: float
    certified: bool


def scan(loop: Factored, with_peaks: bool = True) -> Scan:
    """Scan one loop."""
    loop = loop.reduced
    return Scan(*_core.scan(loop.zeros, loop.poles, loop.gain, loop.delay, loop.sample_time or 0.0, with_peaks))
