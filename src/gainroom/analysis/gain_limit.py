"""The gain limit of a loop: the stable interval of the common factor g on all gains, around 1, with its certificate."""

import math

import numpy as np

from ..errors import GainroomError, computable
from ..system.loop import Loop, require_loop
from .core_loop import CoreLoop
from .loop_samples import AT_REST, LoopSamples, Reach
from .margin_record import NUDGE, Certificate, End, GainLimit, interval
from .multirate import Multirate
from .proved_limit import proved_limit
from .stability import INFINITELY_MANY, has_growing_root, scan_loop, unstable_roots
from .stability_boundary import HIGHEST, Boundary, first_grid

FAR_BELOW = (1e-4, 1e-3, 1e-2, 0.1)  # lowest factors searched, the first that round-off allows: it may hide the effect of integrators
MOST_COUNTED = 300  # intervals of the factor whose roots are counted one by one
NEAR_AXIS = Reach(HIGHEST, 0.05)
"""Reach of samples for a common factor: loci near the negative real axis."""
INSIDE = 1e-3  # relative distance below a crossing at which stability is tried, after NUDGE


def gain_limit(loop: Loop) -> GainLimit:
    """The largest and smallest factor on all gains that keep the loop stable.

    Of several joints factors up to 1000 are looked at: `gain` = inf says that no factor up to 1000 is unstable. For an unstable loop: the
    nearest stable interval below g = 1. Raises GainroomError for an argument that is no loop, and where L is zero.
    """
    require_loop("gain_limit", loop)
    if loop.kd_path is not None:
        return Multirate(loop).limit()
    if loop.size == 1:
        return _scalar_limit(loop)
    if not loop.acts:
        raise GainroomError("gain_limit: all gains are zero")
    for found in (proved_limit, sampled_limit):
        if (limit := found(loop)) is not None:
            return limit
    with computable("gain_limit"):
        if has_growing_root(loop):
            return _no_limit(loop, False, 0.0, math.nan)
    raise GainroomError(f"gain_limit: {lost(loop)}")


def sampled_limit(loop: Loop) -> GainLimit | None:
    """Gain limit of several joints from the core's samples, with roots counted on both sides; None where an end is not confirmed."""
    core = CoreLoop.of(loop)
    samples = None if core is None else core.samples(NEAR_AXIS, smooth=False)
    if core is None or samples is None or not samples.followed or samples.unstable < 0:
        return None
    if samples.unstable == 0:
        return _sampled_interval(loop, core, samples, 1.0)
    below = -np.sort(-samples.passing_factors()[:, 0])
    for end in np.exp(below[below < NUDGE]).tolist():  # the highest first; these gains may lie on one themselves
        for aside in (NUDGE, INSIDE):  # equal limbs pass one close behind the other
            inside = end * (1 - aside)
            stable = core.scaled(inside)
            if stable.unstable() == 0:
                looked = stable.samples(NEAR_AXIS, smooth=False)
                return _sampled_interval(loop, stable, looked, inside) if looked.followed and looked.unstable == 0 else None
    return None


def _sampled_interval(loop: Loop, core: CoreLoop, samples: LoopSamples, factor: float) -> GainLimit | None:
    """The stable interval about a stable `factor` on the gains of `loop`, which `sampled` has; None where an end is not confirmed."""
    samples.tell_apart(HIGHEST, NEAR_AXIS.phase)
    if not samples.followed:
        return None
    boundary = Boundary(loop)
    ends: list[End | None] = []
    for way, farthest, (log, omega) in zip((1, -1), ((HIGHEST / factor,), FAR_BELOW), samples.common_factors().tolist(), strict=True):
        at = math.exp(way * log)
        within = at < farthest[0] if way > 0 else at > farthest[0]
        certificate = Certificate(*(core.scaled(at * (1 + side * way * NUDGE)).unstable() for side in (-1, 1))) if within else None
        if certificate is None or not certificate.holds or certificate.outside < 0:
            # Round-off may hide what low gains do: then stability is known down to a higher one.
            nearer = [end for end in farthest if not within or end > at] if way < 0 or not within else []
            if not any(core.scaled(end).unstable() == 0 for end in nearer):
                return None
            ends.append(None)
            continue
        place = omega if omega > 0 else AT_REST * float(first_grid(loop, boundary.last)[0])
        ends.append(End(at * factor, omega, boundary.mode(place, -1 / (at * factor)), certificate))
    return interval(loop, *ends, stable=factor == 1)


def _scalar_limit(loop: Loop) -> GainLimit:
    """Gain limit of one joint from the crossings of its certified scan: between neighbouring crossings the root count is constant."""
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
        return Certificate(*(unstable_roots(loop.scaled(end * (1 + way * side * NUDGE))) for side in (-1, 1)))

    below = counted(lower, -1) if lower > 0 else None
    at = float(phases[upper - 2, 0]) if lower > 0 else math.nan
    return GainLimit(stable, gain, lower, float(phases[upper - 1, 0]), np.ones(1, dtype=complex), counted(gain, 1), below, at)


def _stable_below(loop: Loop, factors: list[float], slopes: list[float], upper: int) -> int:
    """Highest interval (factors[k − 1], factors[k]), k <= upper, without unstable roots; 0 where there is none.

    A long delay or huge gains make thousands of intervals. Roots are counted once, and the count is carried from one interval to the next:
    a pair becomes unstable, as the factor rises, where arg L falls through π, and stable where it rises. The interval found and the lowest
    one are counted again; if the counts disagree, every interval is counted. Raises GainroomError where those are too many.
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
    """Factor inside (low, high): their geometric mean, or half of `high` if `low` is 0."""
    return math.sqrt(low * high) if low > 0 else high / 2


def _no_limit(loop: Loop, stable: bool, gain: float, lower: float) -> GainLimit:
    return GainLimit(stable, gain, lower, math.nan, np.ones(loop.size, dtype=complex), None)


def lost(loop: Loop) -> str:
    """Message for a loop of several joints that cannot be followed along the stability boundary: the likeliest reason, and what to do."""
    longest = 0.0 if loop.delays is None else float(loop.delays.max(initial=0.0))
    plant = None if loop.parts is None else loop.parts.plant
    if Boundary(loop).undamped and plant is not None and not plant.damping.all():
        reason = "a resonance has no damping at all; give its gearbox some"
    elif plant is not None and plant.gravity_stiffness is not None:
        reason = "gravity moves links so much less in one direction than in others that round-off hides where the gains hold them"
    else:
        reason = (
            "the loop is as good as marginal at any gain (kd 0?), "
            f"has hardly any damping or a very long delay (here {1e3 * longest:g} ms), "
            "or gains that lie many orders of magnitude apart"
        )
    return f"the loci could not be followed to a certified limit: {reason}"
