"""Published figures of actuators as sentences, tables and JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from ..errors import GainroomError, digits, nearest
from ..files.actuator_facts import UNITS, Actuator, Figure, actuators
from ..io.yaml_text import shown
from .presentation import Part, TextTable, Unwrapped

USED = ("motor_inertia", "stiffness", "damping", "peak_torque")
"""Quantities that files and audits take from an actuator."""
LIST_TITLES = ("name", "motor inertia", "ratio", "stiffness", "peak torque", "kp, kd run in")
LEGEND = (
    "Motor inertia [kg·m²] and stiffness [N·m/rad] on the joint side, peak torque [N·m]. `gainroom actuators NAME` has every figure with "
    "its source, and those that contradict each other."
)


def chosen(name: str | None) -> list[Actuator]:
    """Actuator of a name, all whose names contain it, or all where it is None. Raises GainroomError where there is none."""
    known = actuators()
    if name is None:
        return [*known.values()]
    if name in known:
        return [known[name]]
    words = name.lower().split()
    found = [one for one in known.values() if all(word in f"{one.name} {one.title} {' '.join(one.used_in)}".lower() for word in words)]
    if not found:
        raise GainroomError(f"actuators {shown(name)}: no name has this{nearest(name, [*known], 'actuator')}")
    return found


def facts(found: Sequence[Actuator]) -> dict[str, Any]:
    """JSON of actuators: every figure, and what files and audits take."""
    return {
        "actuators": [
            {
                "name": one.name,
                "title": one.title,
                "maker": one.maker,
                "used_in": list(one.used_in),
                "used": {name: asdict(used) for name in USED if (used := one.used(name)) is not None},
                "figures": {name: [each.described | {"unit": UNITS[name]} for each in given] for name, given in one.figures.items()},
            }
            for one in found
        ]
    }


def parts(found: Sequence[Actuator], asked: str | None) -> list[Part]:
    """Terminal answer: the figures of one actuator, or a list of several."""
    return _one(found[0]) if len(found) == 1 and asked is not None else _list(found)


def _list(found: Sequence[Actuator]) -> list[Part]:
    rows = [
        (
            one.name,
            *(_used(one, name) for name in ("motor_inertia", "ratio", "stiffness", "peak_torque")),
            one.word("gains_run"),
        )
        for one in found
    ]
    return [TextTable("", LIST_TITLES, rows, ("kp, kd run in", "ratio")), LEGEND]


def _used(one: Actuator, name: str) -> str:
    used = one.used(name)
    if used is None:
        return "–"
    return f"{digits(used.low, '', 3)} – {digits(used.high, '', 3)}" if used.is_range else digits(used.value, "", 3)


def _one(one: Actuator) -> list[Part]:
    lines = [line for name in UNITS if name in one.figures for line in _figure_lines(one, name)]
    return [
        f"{one.sentence}.",
        *([f"Used in {', '.join(one.used_in)}."] if one.used_in else []),
        "",
        *map(Unwrapped, lines),
        "",
        f"In a joint.yaml or robot.yaml: `actuator: {one.name}`; of a bare model: `gainroom audit … --actuator JOINT={one.name}`.",
    ]


def _figure_lines(one: Actuator, name: str) -> list[str]:
    """Lines of a quantity: its name, then each figure with grade, source, and what the source says."""
    lines = [name.replace("_", " ")]
    for each in one.figures[name]:
        said = "; ".join(filter(None, [each.said, each.set_aside and f"set aside: {each.set_aside}"]))
        lines.append(f"  {_value(each, UNITS[name]):18} {each.grade:11} {each.source}{f', {each.date}' if each.date else ''}")
        lines += [f"{'':33}{said}"] if said else []
    return lines


def _value(each: Figure, unit: str) -> str:
    if isinstance(each.low, bool):
        return "yes" if each.low else "no"
    if isinstance(each.low, str):
        return each.low
    value = digits(each.low, unit, 4)
    return value if each.low == each.high else f"{digits(each.low, '', 4)} to {digits(each.high, unit, 4)}"
