"""How far all gains of a loop can be scaled: the stable interval of the common factor g around 1, with its certificate."""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Complexes
from .errors import GainroomError
from .loop import Loop
from .stability import scan_loop, unstable_roots
from .sweep import FLOOR, Sweep

NUDGE = 1e-6  # the certificate counts roots at limit·(1 ± NUDGE)
HIGHEST = 1 / FLOOR  # of the factors that are looked at on coupled loops
CLOSE = 0.03  # relative distance within which crossings, interpolated between samples, may change places when polished


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

    Coupled loops: roots that the gains do not move (joints left free) are not counted; factors up to 1e3 are looked at.
    """

    stable: bool
    gain: float
    lower_gain: float
    frequency: float
    mode: Complexes
    certificate: Certificate | None


@dataclass(frozen=True)
class Critical:
    """All gains times `gain` put a root at jω; `mode` (n,) complex: the measured positions in that vibration, the largest 1."""

    gain: float
    omega: float
    mode: Complexes


def gain_limit(loop: Loop) -> GainLimit:
    """The largest and smallest factor on all gains that keep the loop stable.

    For an unstable loop: the nearest stable interval below g = 1. Raises GainroomError where L is zero.
    """
    return _scalar_limit(loop) if loop.size == 1 else coupled_limit(Sweep(loop))


def _scalar_limit(loop: Loop) -> GainLimit:
    """From the crossings of the certified scan: between neighbouring ones the number of unstable roots is constant."""
    if loop.scalar is not None and loop.scalar.gain == 0:
        raise GainroomError("gain_limit: all gains are zero")
    crossings = scan_loop(loop, with_peaks=False).phases.tolist()
    points = sorted(
        (Critical(1 / size, omega, np.ones(1, dtype=complex)) for omega, size, _ in crossings if size > 0), key=lambda p: p.gain
    )
    stable = unstable_roots(loop) == 0
    factors = [0.0, *(point.gain for point in points), math.inf]
    upper = next(k for k, factor in enumerate(factors) if factor > 1)
    if not stable:
        upper -= 1
        while upper > 0 and unstable_roots(loop.scaled(_between(factors[upper - 1], factors[upper]))) > 0:
            upper -= 1
    if upper == 0:
        return _no_limit(loop, False, 0.0, math.nan)
    gain, lower = factors[upper], factors[upper - 1]
    if math.isinf(gain):
        return _no_limit(loop, stable, gain, lower)
    certificate = Certificate(unstable_roots(loop.scaled(gain * (1 - NUDGE))), unstable_roots(loop.scaled(gain * (1 + NUDGE))))
    return GainLimit(stable, gain, lower, points[upper - 1].omega, points[upper - 1].mode, certificate)


def _between(low: float, high: float) -> float:
    """A factor inside (low, high)."""
    return math.sqrt(low * high) if low > 0 else high / 2


def _no_limit(loop: Loop, stable: bool, gain: float, lower: float) -> GainLimit:
    return GainLimit(stable, gain, lower, math.nan, np.ones(loop.size, dtype=complex), None)


def coupled_limit(sweep: Sweep) -> GainLimit:
    """gain_limit of several joints, from where their loci cross the negative real axis."""
    if not np.any(sweep.loci):
        raise GainroomError("gain_limit: all gains are zero")
    found = None
    for _ in range(4):
        found, doubtful = _limit_once(sweep)
        if found is not None and (found.certificate.holds if found.certificate else found.gain > 0):
            return found
        if found is not None and found.certificate is None:
            break
        sweep.add(doubtful * (1 + np.linspace(-0.06, 0.06, 121)))  # the crossing was not where its neighbours promised: look closer
    if found is None or (not found.stable and unstable_roots(sweep.loop) == 0):
        raise GainroomError(
            "gain_limit: the loci could not be followed to a certified limit; gains many orders of magnitude apart on joints that work "
            "against each other do this"
        )
    return found


def _limit_once(sweep: Sweep) -> tuple[GainLimit | None, float]:
    """The limit with the present samples, and the frequency on which it rests; None where a crossing is not found on polishing."""
    rough = _crossings(sweep)
    stable = sweep.unstable(1.0) == 0
    factors = [0.0, *(gain for gain, _, _ in rough), math.inf]
    upper = next(k for k, factor in enumerate(factors) if factor > 1)
    if not stable:
        upper -= 1
        while upper > 0 and sweep.unstable(_between(factors[upper - 1], min(factors[upper], HIGHEST))) > 0:
            upper -= 1
    if upper == 0:
        return _no_limit(sweep.loop, False, 0.0, math.nan), math.nan
    lowest = 0.0
    if upper > 1:
        lower = _pinned(sweep, rough[upper - 2], down=True)
        if lower is None:
            return None, rough[upper - 2][1]
        lowest = lower[0].gain
    if upper == len(factors) - 1:
        return _no_limit(sweep.loop, stable, math.inf, lowest), math.nan
    pinned = _pinned(sweep, rough[upper - 1], down=False)
    if pinned is None:
        return None, rough[upper - 1][1]
    point, certificate = pinned
    return GainLimit(stable, point.gain, lowest, point.omega, point.mode, certificate), point.omega


Rough = tuple[float, float, complex]
"""A crossing between two samples: factor, ω and λ, by linear interpolation."""


def _crossings(sweep: Sweep) -> list[Rough]:
    """Crossings of the negative real axis by all loci, by rising factor."""
    steps = sweep.steps()
    crosses = ((steps.start.imag > 0) != (steps.end.imag > 0)) & (np.maximum(np.abs(steps.start), np.abs(steps.end)) > 1 / HIGHEST)
    k, branch = np.nonzero(crosses)
    start, end = steps.start[k, branch], steps.end[k, branch]
    share = start.imag / (start.imag - end.imag)
    value = (start + share * (end - start)).real
    omega = sweep.omega[k] + share * (sweep.omega[k + 1] - sweep.omega[k])
    found = [(-1 / v, w, complex(v)) for v, w in zip(value.tolist(), omega.tolist(), strict=True) if v < 0]
    if sweep.last is not None:
        at_end = sweep.loci[-1]
        real = (np.abs(at_end.imag) < 1e-9 * np.abs(at_end)) & (at_end.real < -1 / HIGHEST)
        found += [(-1 / v, sweep.last, complex(v)) for v in at_end.real[real].tolist()]
    return sorted(found, key=lambda one: one[0])


def _pinned(sweep: Sweep, rough: Rough, down: bool) -> tuple[Critical, Certificate] | None:
    """The lower (`down`) or upper end of a stable interval, polished, with its certificate; None where no crossing is found.

    Near-equal legs cross at nearly the same factor: the rough order decides nothing among those close together.
    """
    gain, omega, value = rough
    near = [_polished(sweep, omega, start) for start in _values_near(sweep, omega, value)]
    found = [point for point in near if point is not None and abs(point.gain / gain - 1) < 2 * CLOSE]
    if not found:
        return None
    point = (max if down else min)(found, key=lambda one: one.gain)
    sweep.add(point.omega * (1 + np.array([sign * 10.0**-k for k in range(2, 9) for sign in (-1, 1)])))
    inward = 1 + NUDGE if down else 1 - NUDGE
    return point, Certificate(sweep.unstable(point.gain * inward), sweep.unstable(point.gain * (2 - inward)))


def _values_near(sweep: Sweep, omega: float, value: complex) -> list[complex]:
    """The eigenvalues of L(jω) that may cross at about the same factor as the one at `value`."""
    values, _ = sweep.eigen(omega)
    return values[np.abs(values - value) < CLOSE * np.abs(value)].tolist()


def _polished(sweep: Sweep, omega: float, wanted: complex) -> Critical | None:
    """The crossing of the negative real axis by the locus that is at `wanted` at `omega`."""
    omega, value, mode = sweep.crossing(omega, wanted, lambda value: value.imag / value.real)
    if value.real >= 0 or abs(value.imag) > 1e-9 * abs(value):
        return None
    return Critical(-1 / value.real, omega, mode)
