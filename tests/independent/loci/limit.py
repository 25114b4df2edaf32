"""The stable interval of a common factor on all gains of coupled loops, from where their loci cross the negative real axis."""

import math
from itertools import pairwise

import numpy as np

from gainroom.analysis.gain_limit import FAR_BELOW
from gainroom.analysis.margin_record import NUDGE, GainLimit, interval
from gainroom.analysis.stability import has_growing_root
from gainroom.errors import GainroomError, computable
from gainroom.system.loop import Loop

from .first_crossing import SEARCH, End, Family, gains
from .loci import Sweep
from .resolution import LOCI

NEAREST_FACTORS = 10.0  # of the factors that are searched first on coupled loops; most limits lie below
NEAR_TOP = 0.8  # of the upper end of an interval between crossings
JUST_BELOW = 1 - np.geomspace(1e-6, 0.5, 18)  # factors on an unstable loop at which roots are counted beside those between crossings


def limit_from_loci(loop: Loop) -> GainLimit:
    """gain_limit of several joints that the core does not have, or where it leaves something open."""
    with computable("gain_limit"):
        limit = coupled_limit(Sweep(loop, NEAREST_FACTORS, for_limit=True))
        return limit if limit.gain < math.inf else coupled_limit(Sweep(loop, LOCI.highest, for_limit=True))


def coupled_limit(sweep: Sweep) -> GainLimit:
    """gain_limit of several joints, from where their loci cross the negative real axis; factors up to `sweep.highest` are searched."""
    if not sweep.largest:
        raise GainroomError("gain_limit: all gains are zero")
    family, stable = gains(sweep), sweep.unstable(1.0) == 0
    near = any(abs(one.at - 1) < SEARCH.close for one in family.crossings())
    inside = 1.0 if stable and not (near and not _is_inside(sweep, 1.0)) else _inside_below(sweep)
    if inside is None or sweep.full:
        if sweep.full or not has_growing_root(sweep.loop):
            raise GainroomError("the loci could not be followed to a certified limit")
        return GainLimit(False, 0.0, math.nan, math.nan, np.ones(sweep.loop.size, dtype=complex), None)
    upper = family.end(inside, sweep.highest if stable else 1.0)
    lower = _lower_end(sweep, family, inside)
    if sweep.full or not all(end.certificate.holds for end in (upper, lower) if end is not None):
        raise GainroomError("the loci could not be followed to a certified limit")
    return interval(sweep.loop, upper, lower, stable and (upper is None or upper.at > 1))


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
    return all(sweep.unstable(factor * (1 + side * NUDGE)) == 0 for side in (0, -2, 2))
