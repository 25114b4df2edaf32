"""Gearboxes that lie in a range in words and in JSON: what was looked at, and where it is worst."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import listed
from ..robot.gearbox_types import sources
from .number_format import digits
from .robot_units import joint_units

if TYPE_CHECKING:
    from ..studies.audit import Audit
    from ..studies.gearbox_range import RangeOfGearboxes


def over_range(result: "Audit") -> str:
    """What a verdict holds for, behind its first word; "" without ranges."""
    if result.over is None:
        return ""
    kinds = f"{listed(_types(result.over))} gearboxes"
    return f" with all {len(result.over.looks)} {kinds} of the range that were checked" if result.safe else f" in the range of {kinds}"


def worst_gearboxes(result: "Audit") -> str:
    """The gearboxes that the numbers are of, a sentence; "" without ranges."""
    over = result.over
    if over is None:
        return ""
    varied = [bool(name) for name in over.range.types]
    stiffness, damping = (_spread(values[varied]) for values in (over.worst_look.stiffness, over.worst_look.damping))
    units = joint_units(result.system.source.body)
    joints = " by joint" if np.count_nonzero(varied) > 1 else ""
    return f" With the worst of these gearboxes (K {stiffness} {units['kp']}{joints}, B {damping} {units['kd']}):"


def gearbox_assumptions(result: "Audit") -> tuple[str, ...]:
    """Ranges with their sources, what was looked at, and what the ranges leave out."""
    over = result.over
    if over is None:
        return ()
    looked = (
        f"checked at {len(over.looks) - over.mixed} points within these ranges with all gearboxes moved together, and at {over.mixed} "
        f"mixes of them, each with a certified limit and sampled margins; between them nothing is proved; all numbers are of the worst: of "
        "those with too little of something, else of all, the one with the least gain limit"
    )
    left_out = (
        "the ranges leave out backlash, stiffness that grows with the load, friction, the links' own elasticity, series springs, and wear"
    )
    return (*sources(dict.fromkeys(_types(over))), looked, left_out)


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
            "worst_stiffness": float(over.worst_look.stiffness[k]),
            "worst_damping": float(over.worst_look.damping[k]),
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


def _spread(values: Any) -> str:
    first, last = (digits(float(end), "", 3) for end in (values.min(), values.max()))
    return first if first == last else f"{first} to {last}"
