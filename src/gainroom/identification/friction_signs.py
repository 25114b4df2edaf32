"""Signs of friction: it opposes the motion, so that no part of its law is below 0, but a fitted one may be.

Friction that is larger near rest (Stribeck 1902; Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30, 1994, 1083–1138) falls with
the speed. Coulomb and viscous friction, which are fitted to it, then come to a larger Coulomb torque and a viscous friction below 0: the
slope of the law over the speeds of the log.
"""

from collections.abc import Mapping

from .estimate import Estimate

FRICTION = ("viscous", "coulomb", "link_coulomb")


def friction_not_below_zero(parameters: Mapping[str, Estimate]) -> tuple[dict[str, Estimate], list[str]]:
    """The parameters without friction below 0 where the interval reaches 0, and a warning of viscous friction that is surely below 0.

    What is bounded is wrong by as much as it was below 0 at least, so that its interval keeps its half-width above 0.
    """
    found = dict(parameters)
    for name in FRICTION:
        if name in found and found[name].low < 0 <= found[name].high:
            was = found[name]
            high = was.high if was.value >= 0 else max(was.high, was.half_width)
            found[name] = Estimate(max(was.value, 0.0), 0.0, high, was.standard_error)
    slope = found.get("viscous")
    if slope is None or slope.high >= 0:
        return found, []
    size = f"{slope.value:.2g}, {slope.low:.2g} to {slope.high:.2g} N·m·s/rad"
    return found, [
        f"viscous friction comes out below 0 ({size}): over the speeds of this log friction falls with speed, as Stribeck friction does; "
        "take it for 0, and the Coulomb friction beside it for friction near rest, or record faster motion"
    ]
