"""Ranges of gearbox types and of a file's uncertainty that an audit judges at their worst, as text and JSON."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import listed
from ..system.system import System
from .number_format import digits, quantity
from .robot_units import joint_units

if TYPE_CHECKING:
    from ..studies.audit import Audit

OF_GEARBOX = {"stiffness": ("K", "kp"), "damping": ("B", "kd")}
"""Symbol and unit of the quantities that a gearbox type leaves open."""
LEFT_OUT = (
    "the ranges leave out backlash, stiffness that grows with the load, friction, the links' own elasticity, series springs, and wear"
)


def over_range(result: "Audit") -> str:
    """Clause on the scope of a verdict over ranges, to follow its first word; "" without ranges."""
    if result.over is None:
        return ""
    kinds, count = gearbox_types(result.over.system), len(result.over.tried)
    if not kinds:
        return f" at all {count} places in the ranges that were checked" if result.safe else " in the ranges"
    kinds = f"{listed(kinds)} gearboxes"
    return f" with all {count} {kinds} of the range that were checked" if result.safe else f" in the range of {kinds}"


def worst_gearboxes(result: "Audit") -> str:
    """Sentence on the place in the ranges that the numbers belong to; "" without ranges."""
    over = result.over
    if over is None:
        return ""
    worst, varied = over.worst.system, over.system.source.actuators.of_a_type
    units, names = joint_units(result.system.source.body), set(over.system.uncertainty.names)
    found = []
    for name, (symbol, unit) in OF_GEARBOX.items():
        if varied.any():
            joints = " by joint" if name == "stiffness" and np.count_nonzero(varied) > 1 else ""
            found.append(f"{symbol} {_spread(worst.source.quantities[name][varied])} {units[unit]}{joints}")
    others = {"delay": np.array([drive.delay for drive in worst.drives]), **worst.source.quantities}
    for name in ("delay", "stiffness", "damping", "motor_inertia"):
        if name in names:
            values = others[name][np.isfinite(others[name])]
            found.append(quantity(name, *sorted({float(values.min()), float(values.max())})))
    whose = "With the worst of these gearboxes" if gearbox_types(over.system) else "At the worst place"
    return f" {whose} ({', '.join(found)}):"


def gearbox_assumptions(result: "Audit") -> tuple[str, ...]:
    """Assumptions on how ranges were examined, and what they leave out."""
    over = result.over
    if over is None:
        return ()
    tried = (
        f"checked at {len(over.tried) - over.mixed} places of the ranges with all joints at the same share, and at {over.mixed} at which "
        "joints differ, most of them about the worst, each by sampled margins; between them nothing is proved; all numbers are of the "
        "worst: the place where most is missed, or where nothing is the one with least to spare; a joint counts as missing what it "
        "misses at a corner"
    )
    return (tried, *([LEFT_OUT] if gearbox_types(over.system) else []))


def range_facts(result: "Audit") -> dict[str, Any] | None:
    """JSON of the ranges of an audit."""
    over = result.over
    if over is None:
        return None
    worst = over.worst.system.source.quantities
    rows = [
        {**row, **{f"worst_{name}": float(worst[name][row_index]) for name in OF_GEARBOX}} for row_index, row in _typed_rows(over.system)
    ]
    return {"joints": rows, "looks": len(over.tried), "mixed_looks": over.mixed}


def typed_facts(system: System) -> dict[str, Any] | None:
    """JSON of the joints known by gearbox type alone, for a robot at nominal values; None: none."""
    rows = [row for _, row in _typed_rows(system)]
    return {"joints": rows} if rows else None


def gearbox_types(system: System) -> list[str]:
    """Names of the gearbox types of joints without further data, each once."""
    return [*dict.fromkeys(filter(None, system.source.actuators.gearbox))]


def _typed_rows(system: System) -> list[tuple[int, dict[str, Any]]]:
    """Index and JSON ranges of each joint known by its gearbox type alone."""
    if not gearbox_types(system):
        return []
    inertia, uncertain = system.source.quantities["motor_inertia"], system.uncertainty
    assert uncertain.resonance is not None
    assert uncertain.damping_ratio is not None
    return [
        (
            k,
            {
                "name": name,
                "type": kind,
                "stiffness": [float(inertia[k] * end[k] ** 2) for end in uncertain.resonance],
                "damping_ratio": [float(end[k]) for end in uncertain.damping_ratio],
            },
        )
        for k, (name, kind) in enumerate(zip(system.source.joint_names, system.source.actuators.gearbox, strict=True))
        if kind
    ]


def _spread(values: Any) -> str:
    first, last = (digits(float(end), "", 3) for end in (values.min(), values.max()))
    return first if first == last else f"{first} to {last}"
