"""The cost of a joint's uncertainty in what its gains make largest, and which of its quantities is worth measuring better."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from ..system.uncertainty import Uncertainty
from .joint_gains import Recommendation

Recommend = Callable[[Uncertainty], Recommendation | None]


@dataclass(frozen=True)
class KnownExactly:
    """Recommended gains if one quantity were known exactly and had its nominal value, all others as uncertain as they are.

    name     in Uncertainty
    kp, kd   on the plane of Recommendation [N m/rad], [N m s/rad]; NaN where there are none even then
    value    Recommendation.value, dynamic stiffness or kp [N m/rad]
    proved   as Recommendation.proved
    """

    name: str
    kp: float
    kd: float
    value: float
    proved: bool


@dataclass(frozen=True)
class HalfAsUncertain(KnownExactly):
    """Recommended gains if one quantity were known to half of its range, to either side of its nominal value: `low` to `high`, SI."""

    low: float
    high: float


@dataclass(frozen=True)
class UncertaintyCost:
    """Cost of a joint's uncertainty in dynamic stiffness or kp, and the gains that knowing more would allow.

    exact   recommended gains if all were known exactly and nominal
    cost    share, 0 to 1, of the value of `exact` that the uncertainty costs; 1 if no gains meet the requirements in every case
    known   for each uncertain quantity the gains if it alone were known exactly, the one with the largest value first
    half    gains if the first of those quantities were half as uncertain
    """

    exact: Recommendation
    cost: float
    known: tuple[KnownExactly, ...]
    half: HalfAsUncertain


def cost_of(found: Recommendation | None, exact: Recommendation) -> float:
    """Cost of the uncertainty, see UncertaintyCost; `found` holds over the whole uncertainty."""
    return 1.0 if found is None else max(1 - found.value / exact.value, 0.0)


def uncertainty_cost(
    recommend: Recommend, uncertainty: Uncertainty, nominal: Mapping[str, float], found: Recommendation | None, exact: Recommendation
) -> UncertaintyCost:
    """Cost of the uncertainty, each number by `recommend` itself: certified, once per uncertain quantity, and once more.

    nominal        by name of the uncertain quantity, SI
    found, exact   the result of `recommend` for all of `uncertainty`, and for none
    """
    single = len(uncertainty.names) == 1
    known = [_known(name, exact if single else recommend(uncertainty.without(name)), found) for name in uncertainty.names]
    ranked = sorted(known, key=lambda one: one.value if one.value > 0 else 0.0, reverse=True)
    name = ranked[0].name
    low, high = (0.5 * (float(end) + nominal[name]) for end in getattr(uncertainty, name))
    half = _known(name, recommend(replace(uncertainty, **{name: (low, high)})), found)
    return UncertaintyCost(exact, cost_of(found, exact), tuple(ranked), HalfAsUncertain(**vars(half), low=low, high=high))


def _known(name: str, one: Recommendation | None, found: Recommendation | None) -> KnownExactly:
    """Gains `one` for a better known quantity `name`, or those of `found` if these are larger: they hold in fewer cases, too."""
    best = max((gains for gains in (one, found) if gains is not None), key=lambda gains: gains.value, default=None)
    if best is None:
        return KnownExactly(name, math.nan, math.nan, math.nan, False)
    return KnownExactly(name, best.kp, best.kd, best.value, best.proved)
