"""Structures by the name under which files, commands and results have them."""

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ...errors import GainroomError, one_line, typo_of
from .joint_responses import DRIVE, HOST
from .observers import ObservedDisturbance, StateObserver
from .structures import Structure

NAMES = ("pd", "pid", "ppi", "dob", "split", "torque_feedback", "observer")
"""Names of structures; a ppi is a pid, whose feedback is the same."""
MOST_BIQUADS = 3
USUAL = ("pd", "pid", "pd+biquad", "dob", "observer", "split", "torque_feedback")
"""Structures that are compared where none are named, as far as the sensors are known."""
OF_ROBOTS = ("pd", "pid", "pd+biquad", "split")
"""Those that are compared on a joint of a robot."""
OPTION = re.compile(r"(?:(\d+)\s*)?biquads?")


def structure_of(entry: Any, position: str = "motor") -> Structure:
    """Structure of an entry: a key such as pd, pd+biquad or pd+2biquads, or a mapping {pd: {biquads: 1}}.

    position   sensor of the position

    Raises GainroomError, with a name that is near, for other entries.
    """
    name, options = _parted(entry)
    if name not in NAMES:
        near = f"; the nearest is {close}" if (close := typo_of(name, NAMES)) else ""
        raise GainroomError(f"structure {one_line(repr(name), 40)} must be one of {', '.join(NAMES)}{near}")
    biquads = options.pop("biquads", 0)
    if options:
        raise GainroomError(f"structure {name}: {one_line(repr(next(iter(options))), 40)} must be biquads")
    if isinstance(biquads, bool) or not isinstance(biquads, int) or not 0 <= biquads <= MOST_BIQUADS:
        raise GainroomError(f"structure {name}: biquads {one_line(repr(biquads), 20)} must be a whole number from 0 to {MOST_BIQUADS}")
    if biquads and name not in ("pd", "pid", "ppi"):
        raise GainroomError(f"structure {name}: biquads are for pd and pid")
    if name == "dob":
        return ObservedDisturbance(name, position)
    if name == "observer":
        return StateObserver(name, position)
    kind = "pid" if name == "ppi" else name
    key = kind if not biquads else f"{kind}+biquad" if biquads == 1 else f"{kind}+{biquads}biquads"
    found = Structure(key, position, biquads=biquads)
    if name in ("pid", "ppi"):
        return replace(found, integral=True)
    if name == "split":
        return replace(found, velocity=DRIVE)
    return replace(found, torque=HOST) if name == "torque_feedback" else found


def _parted(entry: Any) -> tuple[str, dict[str, Any]]:
    """Name and options of an entry."""
    if isinstance(entry, Mapping):
        if len(entry) != 1:
            raise GainroomError(f"structure {one_line(repr(dict(entry)), 60)} must have one name, such as {{pd: {{biquads: 1}}}}")
        ((name, given),) = entry.items()
        if given is not None and not isinstance(given, Mapping):
            raise GainroomError(f"structure {name}: {one_line(repr(given), 40)} must be a mapping, such as {{biquads: 1}}")
        return str(name), dict(given or {})
    if not isinstance(entry, str):
        raise GainroomError(f"structure {one_line(repr(entry), 40)} must be a name, such as pd, or {{pd: {{biquads: 1}}}}")
    name, *parts = (part.strip() for part in entry.split("+"))
    options: dict[str, Any] = {}
    for part in parts:
        match = OPTION.fullmatch(part)
        if match is None:
            raise GainroomError(f"structure {one_line(repr(entry), 40)}: {part!r} must be biquad or 2biquads")
        options |= {"biquads": int(match[1] or 1)}
    return name, options


def starts_from(structure: Structure, smaller: Structure, found: Mapping[str, float]) -> list[dict[str, float]]:
    """Parameters of `structure`, by field, at which it does what `smaller` does with the parameters `found`; [] where it cannot.

    What `smaller` lacks is neutral: a biquad whose zeros are its poles, at several frequencies; no feedback of torque; little integral; an
    observer of little inertia, and slow.
    """
    if structure.position != smaller.position or structure.velocity != smaller.velocity or smaller.biquads > structure.biquads:
        return []
    if isinstance(smaller, (ObservedDisturbance, StateObserver)) or isinstance(structure, StateObserver):
        return []
    if (smaller.integral and not structure.integral) or (smaller.torque and not structure.torque):
        return []
    return _completed(structure, dict(found))


def _completed(structure: Structure, found: dict[str, float]) -> list[dict[str, float]]:
    ranges = structure.ranges
    base = {name: found[name] if name in found else _neutral(name, one.low, one.high, found) for name, one in ranges.items()}
    free = [k for k in range(structure.biquads) if f"zero_frequency_{k}" not in found]
    if not free:
        return [base]
    every = []
    for share in (0.15, 0.4, 0.65, 0.9):
        own = dict(base)
        for k in free:
            one = ranges[f"zero_frequency_{k}"]
            at = one.low ** (1 - share) * one.high**share
            own |= {f"zero_frequency_{k}": at, f"pole_frequency_{k}": 1.03 * at if 1.03 * at < one.most else at}
            own |= {f"zero_damping_{k}": 0.7, f"pole_damping_{k}": 0.74}
        every.append(own)
    return every


def _neutral(name: str, low: float, high: float, found: Mapping[str, float]) -> float:
    if name in ("ktau", "kstau"):
        return 0.0
    if name == "nominal_inertia":
        return low
    if name == "ki":
        return 0.05 * found["kp"]
    if name == "bandwidth" and "nominal_inertia" in found:
        return low
    return high if name == "bandwidth" else (low * high) ** 0.5
