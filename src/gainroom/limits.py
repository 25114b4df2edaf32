"""How far all gains of a loop can be scaled: the stable interval of the common factor g around 1, with its certificate."""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Booleans, Complexes, Floats
from .errors import GainroomError
from .loop import Loop
from .stability import INFINITELY_MANY, has_growing_root, scan_loop, unstable_roots
from .sweep import HIGHEST, Sweep

NUDGE = 1e-6  # the certificate counts roots at limit·(1 ± NUDGE)
NEAREST = 10.0  # of the factors that are looked at first on coupled loops; most limits lie below
LOWEST = 1e-6  # factors on coupled loops below this count as none
LOWEST_UNDAMPED = 1e-3  # likewise, beside an undamped resonance: smaller ones may only tell how far the boundary leans there
# Relative distances from a crossing at which samples tell on which side of it ±NUDGE lies: no step is longer than twice its distance.
TOWARDS = np.concatenate([sign * np.geomspace(0.2 * NUDGE, 0.03, 14) for sign in (-1, 1)])
MOST_COUNTED = 300  # intervals of the factor whose roots are counted one by one
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
                 0 where no lower gain is stable; inf where no higher gain is unstable (one joint, continuous time: none below 1e9)
    lower_gain   its lower end, 0 where every lower gain is stable, NaN where no factor below 1 is
    frequency    of the vibration at the upper end [rad/s], 0 where the robot topples, NaN where there is none
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
    if loop.size == 1:
        return _scalar_limit(loop)
    limit = coupled_limit(Sweep(loop, NEAREST, for_limit=True))
    return limit if limit.gain < math.inf else coupled_limit(Sweep(loop, HIGHEST, for_limit=True))


def _scalar_limit(loop: Loop) -> GainLimit:
    """From the crossings of the certified scan: between neighbouring ones the number of unstable roots is constant."""
    if loop.scalar is not None and loop.scalar.gain == 0:
        raise GainroomError("gain_limit: all gains are zero")
    phases = scan_loop(loop, with_peaks=False).phases
    phases = phases[phases[:, 1] > 0]
    phases = phases[np.argsort(-phases[:, 1], kind="stable")]
    points = [Critical(1 / size, omega, np.ones(1, dtype=complex)) for omega, size, _ in phases.tolist()]
    stable = unstable_roots(loop) == 0
    factors = [0.0, *(point.gain for point in points), math.inf]
    upper = next(k for k, factor in enumerate(factors) if factor > 1)
    if not stable:
        upper = _stable_below(loop, factors, phases[:, 2].tolist(), upper - 1)
    if upper == 0:
        return _no_limit(loop, False, 0.0, math.nan)
    gain, lower = factors[upper], factors[upper - 1]
    if math.isinf(gain):
        return _no_limit(loop, stable, gain, lower)
    certificate = Certificate(unstable_roots(loop.scaled(gain * (1 - NUDGE))), unstable_roots(loop.scaled(gain * (1 + NUDGE))))
    return GainLimit(stable, gain, lower, points[upper - 1].omega, points[upper - 1].mode, certificate)


def _stable_below(loop: Loop, factors: list[float], slopes: list[float], upper: int) -> int:
    """The highest interval (factors[k − 1], factors[k]), k <= upper, without unstable roots; 0 where there is none.

    A long delay or huge gains make thousands of them, so roots are counted once and then carried from one to the next: a pair enters, as
    the factor rises, where arg L falls through π, and leaves where it rises. What this finds is counted, and so is the lowest interval;
    should they not agree, every interval is. Raises GainroomError where those are too many.
    """

    def counted(k: int) -> int:
        return unstable_roots(loop.scaled(_between(factors[k - 1], factors[k])))

    carried: float = math.nan  # NaN: to be counted
    for k in range(upper, 0, -1):
        fresh = math.isnan(carried)
        carried = counted(k) if fresh else carried
        if carried == 0 and (fresh or counted(k) == 0):
            return k
        if k > 1:  # slope 0: at an end of the boundary, where a single root passes
            slope = slopes[k - 2]
            carried = carried + 2 * slope if slope != 0 and carried < INFINITELY_MANY else math.nan
        elif carried != counted(1):
            if upper > MOST_COUNTED:
                raise GainroomError(
                    f"gain_limit: {upper} factors at which roots cross the boundary, and rounding hides which way: shorten the delay, "
                    f"or lower the gains"
                )
            return next((k for k in range(upper, 0, -1) if counted(k) == 0), 0)
    return 0


def _between(low: float, high: float) -> float:
    """A factor inside (low, high)."""
    return math.sqrt(low * high) if low > 0 else high / 2


def _no_limit(loop: Loop, stable: bool, gain: float, lower: float) -> GainLimit:
    return GainLimit(stable, gain, lower, math.nan, np.ones(loop.size, dtype=complex), None)


def coupled_limit(sweep: Sweep) -> GainLimit:
    """gain_limit of several joints, from where their loci cross the negative real axis; factors up to `sweep.highest` are looked at."""
    if not sweep.largest:
        raise GainroomError("gain_limit: all gains are zero")
    for _ in range(4):
        found, doubtful = _limit_once(sweep)
        if sweep.full:
            break
        if found is not None and (found.certificate.holds if found.certificate else found.gain > 0):
            return found
        if found is not None and found.certificate is None:
            if has_growing_root(sweep.loop):
                return found
            break
        sweep.add(doubtful * (1 + np.linspace(-0.06, 0.06, 121)))  # the crossing was not where its neighbours promised: look closer
    raise GainroomError(f"gain_limit: the loci could not be followed to a certified limit: {_why_not(sweep)}")


def _why_not(sweep: Sweep) -> str:
    """The likeliest reason, and what to do."""
    longest = 0.0 if sweep.loop.delays is None else float(sweep.loop.delays.max(initial=0.0))
    if sweep.undamped:
        return "a resonance has no damping at all; give its gearbox some"
    if sweep.full:
        return f"they need over {len(sweep.omega) - 1} samples, as with very light damping or a very long delay (here {1e3 * longest:g} ms)"
    return "the loop is as good as marginal at any gain (kd 0?), or gains lie many orders of magnitude apart"


def _limit_once(sweep: Sweep) -> tuple[GainLimit | None, float]:
    """The limit with the present samples, and the frequency on which it rests; None where a crossing is not found on polishing."""
    rough = _crossings(sweep)
    stable = sweep.unstable(1.0) == 0
    factors = [0.0, *(gain for gain, _, _ in rough), math.inf]
    upper = next(k for k, factor in enumerate(factors) if factor > 1)
    if not stable:
        upper -= 1
        while upper > 0 and sweep.unstable(_between(factors[upper - 1], min(factors[upper], sweep.highest))) > 0:
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
    k, branch = np.nonzero(((steps.start.imag > 0) != (steps.end.imag > 0)) & ~sweep.calm[:, None])
    start, end = steps.start[k, branch], steps.end[k, branch]
    share = start.imag / (start.imag - end.imag)
    value = (start + share * (end - start)).real
    omega = sweep.omega[k] + share * (sweep.omega[k + 1] - sweep.omega[k])
    found = _reached(sweep, value)
    crossings = zip(-1 / value[found], omega[found], value[found], strict=True)
    rough = [(float(gain), float(at), complex(there)) for gain, at, there in crossings]
    if sweep.last is not None:
        at_end = sweep.loci[-1]
        real = (np.abs(at_end.imag) < 1e-9 * np.abs(at_end)) & _reached(sweep, at_end.real)
        rough += [(-1 / there, sweep.last, complex(there)) for there in at_end.real[real].tolist()]
    at_rest = sweep.at_rest()
    rough += [(-1 / there, 0.0, complex(there)) for there in at_rest[_reached(sweep, at_rest)].tolist()]
    return sorted(rough, key=lambda one: one[0])


def _reached(sweep: Sweep, value: Floats) -> Booleans:
    """True where −1/`value` is a factor that is looked at."""
    return (value < -1 / sweep.highest) & (value > -1 / (LOWEST_UNDAMPED if sweep.undamped else LOWEST))


def _pinned(sweep: Sweep, rough: Rough, down: bool) -> tuple[Critical, Certificate] | None:
    """The lower (`down`) or upper end of a stable interval, polished, with its certificate; None where no crossing is found.

    Near-equal legs cross at nearly the same factor: the rough order decides nothing among those close together.
    """
    gain, omega, there = rough
    if omega == 0:  # toppled, or held, by gravity: known as it stands
        point = Critical(gain, 0.0, sweep.mode_at_rest(there))
        return point, _certified(sweep, gain, down)
    values = sweep.eigen(np.array([omega]))[0][0]
    near = values[np.abs(values - there) < CLOSE * np.abs(there)]

    def foremost(value: Complexes) -> int | None:
        factors = np.where((value.real < 0) & (np.abs(value.imag) < CLOSE * np.abs(value)), -1 / value.real, math.nan)
        return None if np.all(np.isnan(factors)) else int((np.nanargmax if down else np.nanargmin)(factors))

    at, value, modes = sweep.crossings(np.full(len(near), omega), near, _slope, foremost)
    if not len(at) or value[0].real >= 0 or abs(value[0].imag) > 1e-9 * abs(value[0]) or abs(-1 / value[0].real / gain - 1) > 2 * CLOSE:
        return None
    point = Critical(-1 / float(value[0].real), float(at[0]), modes[0])
    sweep.add(point.omega * (1 + TOWARDS))
    return point, _certified(sweep, point.gain, down)


def _certified(sweep: Sweep, gain: float, down: bool) -> Certificate:
    inward = 1 + NUDGE if down else 1 - NUDGE
    return Certificate(sweep.unstable(gain * inward), sweep.unstable(gain * (2 - inward)))


def _slope(value: Complexes) -> Floats:
    return value.imag / value.real
