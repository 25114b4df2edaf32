"""How far all gains of a loop can be scaled: the stable interval of the common factor g around 1, with its certificate."""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Complexes
from .errors import GainroomError
from .loci import Critical, critical_points
from .loop import Loop
from .stability import scan_loop, unstable_roots

NUDGE = 1e-6  # the certificate counts roots at limit·(1 ± NUDGE)


@dataclass(frozen=True)
class Certificate:
    """Unstable closed-loop roots just inside and just outside a limit; `holds` when none inside and some outside."""

    inside: int
    outside: int
    nudge: float = NUDGE

    @property
    def holds(self) -> bool:
        """True when the limit has been confirmed from both sides."""
        return self.inside == 0 and self.outside > 0


@dataclass(frozen=True)
class GainLimit:
    """The stable interval of the common gain factor g.

    stable       at g = 1
    gain         its upper end: > 1 where the loop is stable; < 1 where it is not, and lowering the gains to it would make it so;
                 0 where no lower gain is stable; inf where no higher gain is unstable
    lower_gain   its lower end, 0 where every lower gain is stable
    frequency    of the vibration at the upper end [rad/s], NaN where there is none
    mode         (n,) complex, the joints' parts in that vibration, the largest 1
    certificate  of the upper end, None where there is none
    """

    stable: bool
    gain: float
    lower_gain: float
    frequency: float
    mode: Complexes
    certificate: Certificate | None


def gain_limit(loop: Loop) -> GainLimit:
    """The largest and smallest factor on all gains that keep the loop stable.

    For an unstable loop: the nearest stable interval below g = 1. Raises GainroomError where L is zero.
    """
    if loop.scalar is not None and loop.scalar.gain == 0:
        raise GainroomError("gain_limit: all gains are zero")
    points = _scalar_points(loop) if loop.size == 1 else critical_points(loop)
    stable = unstable_roots(loop) == 0
    # Between neighbouring critical factors the number of unstable roots is constant: find the stable stretch at or below g = 1.
    factors = [0.0, *(point.gain for point in points), math.inf]
    upper = next(k for k, factor in enumerate(factors) if factor > 1)
    if not stable:
        upper -= 1
        while upper > 0 and unstable_roots(loop.scaled(_between(factors[upper - 1], factors[upper]))) > 0:
            upper -= 1
    none = np.ones(loop.size, dtype=complex)
    if upper == 0:
        return GainLimit(False, 0.0, math.nan, math.nan, none, None)
    gain, lower = factors[upper], factors[upper - 1]
    if math.isinf(gain):
        return GainLimit(stable, gain, lower, math.nan, none, None)
    certificate = Certificate(unstable_roots(loop.scaled(gain * (1 - NUDGE))), unstable_roots(loop.scaled(gain * (1 + NUDGE))))
    return GainLimit(stable, gain, lower, points[upper - 1].omega, points[upper - 1].mode, certificate)


def _between(low: float, high: float) -> float:
    """A factor inside (low, high)."""
    return math.sqrt(low * high) if low > 0 else high / 2


def _scalar_points(loop: Loop) -> list[Critical]:
    """The crossings of a scalar loop, by rising gain: all of them, from the certified scan."""
    crossings = scan_loop(loop, with_peaks=False).phases.tolist()
    found = [Critical(1 / size, omega, np.ones(1, dtype=complex)) for omega, size, _ in crossings if size > 0]
    return sorted(found, key=lambda point: point.gain)
