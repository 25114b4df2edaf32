"""An audit over a range of gearboxes, in words and in JSON: which types, what was looked at, and where it is worst."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import listed
from ..robot.gearbox_types import sources
from .needed_stiffness import how_it_was_found
from .number_format import digits
from .robot_units import joint_units

if TYPE_CHECKING:
    from ..studies.audit import Audit
    from ..studies.gearbox_range import RangeOfGearboxes


def over_range(result: "Audit") -> str:
    """What a verdict holds for, behind its first word; "" without ranges."""
    return "" if result.over is None else f" over the range of {listed(_types(result.over))} gearboxes"


def worst_gearboxes(result: "Audit") -> str:
    """The gearboxes that the numbers are of, a sentence; "" without ranges."""
    over = result.over
    if over is None:
        return ""
    stiffness, damping = (_spread(values[_varied(over)]) for values in (over.worst.stiffness, over.worst.damping))
    units = joint_units(result.system.source.body)
    return f" Worst, at K {stiffness} {units['kp']}, B {damping} {units['kd']}:"


def gearbox_assumptions(result: "Audit") -> tuple[str, ...]:
    """Ranges with their sources, what was looked at, and what the ranges leave out."""
    over = result.over
    if over is None:
        return how_it_was_found(result.needed)
    looked = (
        f"looked at {len(over.looks) - over.mixed} places within these ranges with all gearboxes moved together, and at {over.mixed} "
        f"mixes of them, each with a certified limit; between them nothing is proved; all numbers are of the worst by gain limit, "
        "and other margins are judged there alone"
    )
    left_out = (
        "the ranges leave out backlash, stiffness that grows with the load, friction, the links' own elasticity, series springs, and wear"
    )
    return (*sources(dict.fromkeys(_types(over))), looked, left_out, *how_it_was_found(result.needed))


def range_facts(result: "Audit") -> dict[str, Any] | None:
    """In JSON."""
    over = result.over
    if over is None:
        return None
    found, inertia = over.range, result.system.source.actuators.motor_inertia
    rows = [
        {
            "name": name,
            "type": found.types[k],
            "stiffness": [float(inertia[k] * end[k] ** 2) for end in (found.softest, found.stiffest)],
            "damping_ratio": [float(found.least_damped[k]), float(found.most_damped[k])],
            "worst_stiffness": float(over.worst.stiffness[k]),
            "worst_damping": float(over.worst.damping[k]),
        }
        for k, name in enumerate(result.system.source.joint_names)
        if found.types[k]
    ]
    limits = [look.gain_limit for look in over.looks]
    return {
        "joints": rows,
        "looks": len(limits),
        "mixed_looks": over.mixed,
        "gain_limit": None if any(map(math.isnan, limits)) else min(limits),
    }


def _types(over: "RangeOfGearboxes") -> list[str]:
    return [*dict.fromkeys(name for name in over.range.types if name)]


def _varied(over: "RangeOfGearboxes") -> Any:
    return np.array([bool(name) for name in over.range.types])


def _spread(values: Any) -> str:
    first, last = (digits(float(end), "", 3) for end in (values.min(), values.max()))
    return first if first == last else f"{first} to {last}"
