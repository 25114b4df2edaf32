"""How far all gains of a loop can be scaled: the stable interval of the common factor g around 1, with its certificate."""

import math
from itertools import pairwise

import numpy as np

from ..errors import GainroomError, computable
from ..system.loop import Loop, require_loop
from .first_crossing import SEARCH, Certificate, End, Family, gains
from .loci import Sweep
from .look import Reach, Seen
from .margin_record import GainLimit, interval
from .multirate import Multirate
from .proved_limit import proved_limit
from .sampled_loop import SampledLoop
from .stability import INFINITELY_MANY, has_growing_root, scan_loop, unstable_roots
from .stability_boundary import LOCI, Boundary

NEAREST_FACTORS = 10.0  # of the factors that are searched first on coupled loops; most limits lie below
FAR_BELOW = (1e-4, 1e-3, 1e-2, 0.1)  # of stable gains: how far down a lower end is looked for; round-off may hide what integrators do
MOST_COUNTED = 300  # intervals of the factor whose roots are counted one by one
NEAR_TOP = 0.8  # of the upper end of an interval between crossings
NEAR_AXIS = Reach(LOCI.highest, 0.05)
"""Samples about the negative real axis: all that a factor on all gains needs."""
INSIDE = 1e-3  # of a factor at which roots cross: how far below it a stable one is looked for, and as near as certificates count
JUST_BELOW = 1 - np.geomspace(1e-6, 0.5, 18)  # factors on an unstable loop at which roots are counted beside those between crossings


def gain_limit(loop: Loop) -> GainLimit:
    """The largest and smallest factor on all gains that keep the loop stable.

    Of several joints factors up to 1000 are looked at: `gain` inf says that none up to 1000 is unstable, not that none is. For an unstable
    loop: the nearest stable interval below g = 1. Raises GainroomError for what is no loop, and where L is zero.
    """
    require_loop("gain_limit", loop)
    if loop.kd_path is not None:
        return Multirate(loop).limit()
    if loop.size == 1:
        return _scalar_limit(loop)
    for found in (proved_limit, sampled_limit):
        if (limit := found(loop)) is not None:
            return limit
    return limit_from_loci(loop)


def sampled_limit(loop: Loop) -> GainLimit | None:
    """gain_limit of several joints from the core's samples, with roots counted on both sides; None where something is not confirmed."""
    sampled = SampledLoop.of(loop) if loop.acts else None
    seen = None if sampled is None else sampled.look(NEAR_AXIS, smooth=False)
    if sampled is None or seen is None or not seen.followed or seen.unstable < 0:
        return None
    if seen.unstable == 0:
        return _sampled_interval(loop, sampled, seen, 1.0)
    below = -np.sort(-seen.passing_factors()[:, 0])
    for end in np.exp(below[below < 0]).tolist():  # the highest first
        for aside in (SEARCH.nudge, INSIDE):  # equal limbs pass one close behind the other
            inside = end * (1 - aside)
            stable = sampled.scaled(inside)
            if stable.unstable() == 0:
                looked = stable.look(NEAR_AXIS, smooth=False)
                return _sampled_interval(loop, stable, looked, inside) if looked.followed and looked.unstable == 0 else None
    return None


def _sampled_interval(loop: Loop, sampled: SampledLoop, seen: Seen, factor: float) -> GainLimit | None:
    """The stable interval about a stable `factor` on the gains of `loop`, which `sampled` has; None where an end is not confirmed."""
    seen.tell_apart(LOCI.highest, NEAR_AXIS.phase)
    if not seen.followed:
        return None
    (up, above), (down, below) = seen.common_factors().tolist()
    ends: list[End | None] = []
    for log, omega, farthest in ((up, above, (LOCI.highest / factor,)), (-down, below, FAR_BELOW)):
        at = math.exp(log)
        if not (at < farthest[0] if log > 0 else at > farthest[0]):
            counted = (sampled.scaled(end).unstable() for end in farthest)
            if next((count for count in counted if count >= 0), -1) != 0:
                return None
            ends.append(None)
            continue
        certificate = Certificate(*(sampled.scaled(at * (1 + side * math.copysign(SEARCH.nudge, log))).unstable() for side in (-1, 1)))
        if not certificate.holds or certificate.outside < 0 or not omega > 0:
            return None
        ends.append(End(at * factor, omega, Boundary(loop).mode(omega, -1 / (at * factor)), certificate))
    return interval(loop, *ends, stable=factor == 1)


def limit_from_loci(loop: Loop) -> GainLimit:
    """gain_limit of several joints that the core does not have, or where it leaves something open."""
    with computable("gain_limit"):
        limit = coupled_limit(Sweep(loop, NEAREST_FACTORS, for_limit=True))
        return limit if limit.gain < math.inf else coupled_limit(Sweep(loop, LOCI.highest, for_limit=True))


def _scalar_limit(loop: Loop) -> GainLimit:
    """From the crossings of the certified scan: between neighbouring ones the number of unstable roots is constant."""
    if loop.scalar is not None and loop.scalar.gain == 0:
        raise GainroomError("gain_limit: all gains are zero")
    scan = scan_loop(loop, with_peaks=False)
    phases = scan.phases[scan.phases[:, 1] > 0]
    phases = phases[np.argsort(-phases[:, 1], kind="stable")]
    stable = unstable_roots(loop, scan) == 0
    factors = [0.0, *(1 / size for size in phases[:, 1].tolist()), math.inf]
    upper = next(k for k, factor in enumerate(factors) if factor > 1)
    if not stable:
        upper = _stable_below(loop, factors, phases[:, 2].tolist(), upper - 1)
    if upper == 0:
        return _no_limit(loop, False, 0.0, math.nan)
    gain, lower = factors[upper], factors[upper - 1]
    if math.isinf(gain):
        return _no_limit(loop, stable, gain, lower)

    def counted(end: float, way: int) -> Certificate:
        return Certificate(*(unstable_roots(loop.scaled(end * (1 + way * side * SEARCH.nudge))) for side in (-1, 1)))

    below = counted(lower, -1) if lower > 0 else None
    at = float(phases[upper - 2, 0]) if lower > 0 else math.nan
    return GainLimit(stable, gain, lower, float(phases[upper - 1, 0]), np.ones(1, dtype=complex), counted(gain, 1), below, at)


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
    """gain_limit of several joints, from where their loci cross the negative real axis; factors up to `sweep.highest` are searched."""
    if not sweep.largest:
        raise GainroomError("gain_limit: all gains are zero")
    family, stable = gains(sweep), sweep.unstable(1.0) == 0
    near = any(abs(one.at - 1) < SEARCH.close for one in family.crossings())
    inside = 1.0 if stable and not (near and not _is_inside(sweep, 1.0)) else _inside_below(sweep)
    if inside is None or sweep.full:
        if sweep.full or not has_growing_root(sweep.loop):
            raise GainroomError(f"gain_limit: the loci could not be followed to a certified limit: {_why_not(sweep)}")
        return _no_limit(sweep.loop, False, 0.0, math.nan)
    upper = family.end(inside, sweep.highest if stable else 1.0)
    lower = _lower_end(sweep, family, inside)
    if sweep.full or not all(end.certificate.holds for end in (upper, lower) if end is not None):
        raise GainroomError(f"gain_limit: the loci could not be followed to a certified limit: {_why_not(sweep)}")
    return interval(sweep.loop, upper, lower, stable and (upper is None or upper.at > 1))


def _why_not(sweep: Sweep) -> str:
    """The likeliest reason, and what to do."""
    longest = 0.0 if sweep.loop.delays is None else float(sweep.loop.delays.max(initial=0.0))
    if sweep.undamped:
        return "a resonance has no damping at all; give its gearbox some"
    at_rest = np.abs(sweep.at_rest())
    if np.any(np.finfo(float).eps * np.abs(sweep.loci[0]).max() > SEARCH.nudge * at_rest):
        return "gravity moves links so much less in one direction than in others that round-off hides where the gains hold them"
    if sweep.full:
        return f"they need over {len(sweep.omega) - 1} samples, as with very light damping or a very long delay (here {1e3 * longest:g} ms)"
    return "the loop is as good as marginal at any gain (kd 0?), or gains lie many orders of magnitude apart"


def _lower_end(sweep: Sweep, family: Family, inside: float) -> End | None:
    """The lower end of a stable interval, looked for as far down as round-off lets roots be counted; None where none is found."""
    lower = None
    for share in FAR_BELOW:
        lower = family.end(inside, max(share * inside, SEARCH.lowest_undamped if sweep.undamped else SEARCH.lowest))
        if lower is None or lower.certificate.holds:
            break
    return lower


def _inside_below(sweep: Sweep) -> float | None:
    """The highest factor below 1 that is found to be stable; None where there is none, and where the loci cannot be followed."""
    if sweep.full:  # with thousands of crossings
        return None
    edges = sorted({SEARCH.lowest, 1.0, *(one.at for one in gains(sweep).crossings() if one.at < 1)})
    # Of each interval its middle, and a place near its top: wide ones may hold a lower end, further down than crossings are looked for.
    inner = [max(math.sqrt(low * high), share * high) for low, high in pairwise(edges) for share in (0.0, NEAR_TOP)]
    return next((factor for factor in sorted({*JUST_BELOW.tolist(), *inner}, reverse=True) if _is_inside(sweep, factor)), None)


def _is_inside(sweep: Sweep, factor: float) -> bool:
    """Whether it is stable there, and a little to either side: on an end itself, as of gains at twice their limit, counts say anything."""
    return all(sweep.unstable(factor * (1 + side * SEARCH.nudge)) == 0 for side in (0, -2, 2))
