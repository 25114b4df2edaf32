"""Gearboxes that lie in a range, or of which nobody says how stiff, in words and in JSON: what was looked at, and where it is worst."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import listed
from ..robot.gearbox_types import sources
from .columns import Column, facts, tabulated, yes
from .number_format import digits, hertz
from .page import Html, table
from .robot_units import joint_units

if TYPE_CHECKING:
    from ..studies.audit import Audit
    from ..studies.gearbox_range import RangeOfGearboxes
    from ..studies.needed_stiffness import NeededStiffness


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
        return how_it_was_found(result.needed)
    looked = (
        f"checked at {len(over.looks) - over.mixed} points within these ranges with all gearboxes moved together, and at {over.mixed} "
        f"mixes of them, each with a certified limit and sampled margins; between them nothing is proved; all numbers are of the worst: of "
        "those with too little of something, else of all, the one with the least gain limit"
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


def how_it_was_found(needed: "NeededStiffness | None") -> tuple[str, ...]:
    """What was looked at, and what was not: for the assumptions."""
    if needed is None:
        return ()
    text = (
        f"gearboxes of unknown stiffness have one resonance Ω, outputs held (K = J Ω², B = 2 ζ J Ω, J the motor's inertia), and a damping "
        f"ratio ζ of {needed.damping_ratio:.3g} (--damping-ratio), so stiffer ones more damping; checked at {len(needed.looks)} Ω"
    )
    if needed.mixed:
        text += f" and {needed.mixed} mixes of stiffer, more damped ones"
    return (f"{text}, each with a certified limit; between them nothing is proved",)


def look_columns(result: "Audit", needed: "NeededStiffness") -> list[Column]:
    """One stiffness of the unknown gearboxes, of the softest and the stiffest joint."""
    return [
        Column("resonance", "resonance_rad_s", lambda look: look.resonance, shown=lambda look: hertz(look.resonance)),
        Column("", "stiffness_low", lambda look: float(look.stiffness[needed.unknown].min())),
        Column("", "stiffness_high", lambda look: float(look.stiffness[needed.unknown].max())),
        Column(f"K [{joint_units(result.system.source.body)['kp']}]", "", lambda look: _spread(look.stiffness[needed.unknown])),
        Column("limit", "gain_limit", lambda look: look.gain_limit),
        Column("safe", "safe", lambda look: look.safe, shown=lambda look: yes(look.safe)),
    ]


SHOWN_STEP = 1.25
"""Of Ω: a table leaves out looks that are nearer to the one before, but for those at the edge of what is safe."""


def shown_looks(needed: "NeededStiffness") -> list[Any]:
    """Those that a table shows."""
    looks, shown = needed.looks, []
    for k, look in enumerate(looks):
        edge = any(0 <= n < len(looks) and looks[n].safe != look.safe for n in (k - 1, k + 1))
        if edge or not shown or look.resonance < shown[-1].resonance / SHOWN_STEP or k == len(looks) - 1:
            shown.append(look)
    return shown


def needed_facts(result: "Audit") -> dict[str, Any] | None:
    """In JSON."""
    needed = result.needed
    if needed is None:
        return None
    names, least = result.system.source.joint_names, needed.least
    joints = [] if least is None else [
        {"name": name, "stiffness": float(least.stiffness[k]), "damping": float(least.damping[k])}
        for k, name in enumerate(names)
        if needed.unknown[k]
    ]  # fmt: skip
    return {
        "damping_ratio": needed.damping_ratio,
        "resonance_rad_s": None if least is None else least.resonance,
        "joints": joints,
        "looks": [facts(look_columns(result, needed), look) for look in needed.looks],
        "mixed_looks": needed.mixed,
    }


CAPTION = (
    "resonance: of every motor on its gearbox, output held; limit: the factor on all gains until vibration; "
    "the last column: whether all that is required holds."
)


def needed_table(result: "Audit", needed: "NeededStiffness") -> Html:
    """The gain limit by stiffness, on a page."""
    return table(*tabulated(look_columns(result, needed), shown_looks(needed)), CAPTION)
