"""Every crossing and every peak of a scalar response along the boundary of stability, certified between the points.

The walk along the boundary is native/include/gainroom/scan.hpp, which describes the method.
"""

from dataclasses import dataclass

from ..native import _core
from ..system.linear.arrays import Floats
from ..system.linear.transfer_function import Factored

FLOOR = _core.FLOOR
"""|L| below which the walk of a continuous loop ends; lowered until |L| cannot come back to the nearest crossing found."""
LOWEST_FLOOR = _core.LOWEST_FLOOR
"""|L| below which crossings are left out: their order is not known."""


@dataclass(frozen=True)
class Scan:
    """Crossings and peaks of one scalar return ratio L along the whole stability boundary.

    gains        (g, 2): ω [rad/s] of every |L| = 1, arg L [rad] there by continuity from small s > 0
    phases       (p, 3): ω [rad/s] of every arg L = π (mod 2π), |L| there, sign of the phase slope (0 at an end of the boundary)
    peaks        (3, 2): ω [rad/s] and minimum of |1+L|, |1+L|/|L|, 2|1+L|/|1−L|; zeros when not requested
    half_turns   change of arg(1+L) along the upper half of the contour, divided by π
    certified    False where rounding or the work limit stopped the proof
    """

    gains: Floats
    phases: Floats
    peaks: Floats
    half_turns: float
    certified: bool


def scan(loop: Factored, with_peaks: bool = True) -> Scan:
    """Crossings of the unit circle and the negative real axis of a return ratio given by zeros and poles; `with_peaks`: its peaks, too."""
    loop = loop.reduced
    return Scan(*_core.scan(loop.zeros, loop.poles, loop.gain, loop.delay, loop.sample_time or 0.0, with_peaks))
