"""Effect of friction on a joint's estimates: viscous friction may be estimated below 0, and the damping is masked.

Friction opposes the motion, so that no part of its law is below 0, but a fitted part may be.

Friction that is larger near rest (Stribeck 1902; Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30, 1994, 1083–1138) falls with
the speed. Coulomb and viscous friction, which are fitted to it, then come to a larger Coulomb torque and a viscous friction below 0: the
slope of the law over the speeds of the log.
"""

import math
from collections.abc import Mapping

from .estimate import Estimate, quantile
from .motion import STRIBECK

FRICTION = ("viscous", "coulomb", "link_coulomb")
NOT_NEGATIVE = (*FRICTION, "delay")
HIDDEN = 0.2  # of the viscous friction that Coulomb friction comes to: what may be missing of the damping beside it
NO_DAMPING = 1e-3  # of its error: a damping that is less is 0


def friction_not_below_zero(parameters: Mapping[str, Estimate]) -> tuple[dict[str, Estimate], list[str]]:
    """Parameters with friction or delay below 0 set to 0 if the interval reaches 0, and a warning about friction surely below 0.

    What is bounded is wrong by as much as it was below 0 at least, so that its interval keeps its half-width above 0.
    """
    found = dict(parameters)
    for name in NOT_NEGATIVE:
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


def damping_beside_friction(parameters: Mapping[str, Estimate], speed: float) -> tuple[Estimate, list[str]]:
    """Damping widened by the friction that may mask it, and a warning if that is all of it; `speed`: the motor's, RMS [rad/s].

    Motion about a mean linearises Coulomb friction to viscous friction √(2/π) F/σ of its side (Booton 1954; Gaussian motion), which damps
    the resonance as the spring's damping does, the motor's in the square of its part in the mode. No law of friction is known to more
    than a share of it. Sized on virtual joints (tests): the error of the damping is below a fifth of it where the damping is more.
    """
    motor, link, damping = (parameters[name].value for name in ("motor_inertia", "link_inertia", "damping"))
    part = link / (motor + link)
    sizes = abs(parameters["coulomb"].value) * part**2, abs(parameters["link_coulomb"].value) * (1 - part) ** 2
    viscous = math.sqrt(2 / math.pi) * sum(sizes) / speed
    was, hidden = parameters["damping"], damping < HIDDEN * viscous
    wide = (2.0 if hidden else HIDDEN) * viscous
    error = math.hypot(was.standard_error, wide / quantile(math.inf))
    note = ["friction hides the damping, which may be 0: record a multisine of torque about the resonance on top of slow motion"] * hidden
    value = was.value if was.value > NO_DAMPING * error else 0.0
    return Estimate(value, max(was.low - wide, 0.0), was.high + wide, error), note


def viscous_beside_friction(parameters: Mapping[str, Estimate], speed: float) -> Estimate:
    """Viscous friction plus the part that friction which is larger near rest, by a share STRIBECK of dry friction, takes off it.

    `speed` as above.

    Such friction falls by that much over the speeds of the log, which the slope that is fitted has in it.
    """
    was = parameters["viscous"]
    wide = STRIBECK * sum(abs(parameters[side].value) for side in ("coulomb", "link_coulomb") if side in parameters) / speed
    low = was.low - wide if was.value < 0 else max(was.low - wide, 0.0)
    return Estimate(was.value, low, was.high + wide, math.hypot(was.standard_error, wide / quantile(math.inf)))
