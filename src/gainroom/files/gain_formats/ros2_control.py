"""Gains of ros2_control YAML: p, i, d under a joint's name.

They stand in joint_trajectory_controller's and pid_controller's `gains`, in gazebo's `pid_gains`, in effort_controllers'
JointPositionController (`joint` and `pid`) and JointGroupPositionController (`pid` per joint). Controllers that command position or
velocity are left out: their gains are no N m/rad.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ...errors import GainroomError, Together, first_of_many, refuse_all, typo_of
from ...io.validation import checked, dotted, number
from ...io.yaml_text import shown
from .gain_record import NOT_NEGATIVE, Gain, GainFile, Origin

TERMS = {"p": "kp", "i": "ki", "d": "kd"}
WRAPPERS = ("gains", "pid", "pid_gains", "ros__parameters")
"""Keys between a controller and its joints that name neither of them."""
HOLDERS = ("gains", "pid", "pid_gains")
"""Keys among them that hold nothing but gains."""
BESIDE = (
    *(
        "i_clamp",
        "i_clamp_max",
        "i_clamp_min",
        "i_max",
        "i_min",
        "antiwindup",
        "antiwindup_strategy",
        "tracking_time_constant",
        "error_deadband",
    ),
    *("u_clamp_max", "u_clamp_min", "u_max", "u_min", "saturation", "ff_velocity_scale", "feedforward_gain", "angle_wraparound"),
    *("normalize_error", "save_i_term", "save_iterm", "publish_state", "activate_state_publisher", "type", "joint"),
)
"""Parameters of ros2_control beside p, i and d, on which no margin depends."""
LONGEST_SLIP = 3
MANAGER = "controller_manager"
RATE = number(least=0, most=1e6)


@dataclass(frozen=True)
class Ros2Gains(GainFile):
    """Gains by joint; `paths`: keys that lead to each joint's p, i, d."""

    paths: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def read_ros2_control(data: dict[str, Any], source: str, unknown: str) -> Ros2Gains:
    """Gains p, i, d at any place under a joint's name; `unknown` is the message about a file without any. Raises GainroomError."""
    types = {name: each["type"] for _, node in _mappings(data) for name, each in node.items() if isinstance(each, dict) and "type" in each}
    gains: dict[str, Gain] = {}
    paths: dict[str, tuple[str, ...]] = {}
    notes: list[str] = []
    empty: list[str] = []

    def read(path: tuple[str, ...], node: dict[str, Any]) -> None:
        if path[:-1] in paths.values():
            return  # a section in the place of a number
        place = dotted(*path) or "at the top"
        if all(isinstance(node.get(term, {}), dict) for term in TERMS):  # joints may be called p, i and d, too
            empty.extend([] if _no_torque(data, path, types) else _without_terms(path, node))
            return
        joint = _joint(data, path)
        if joint is None:
            raise GainroomError(f"{source}: {place}: p, i, d stand under no joint's name")
        reason = _no_torque(data, path, types)
        if reason:
            notes.append(f"{place}: left out, as {reason}")
            return
        if joint in paths:
            both = f"in {dotted(*paths[joint])} and in {place}"
            chosen = f"name one, {source}:{path[0]}, or " if path[0] != paths[joint][0] and "." not in path[0] else ""
            raise GainroomError(f"{source}: joint {shown(joint)} has gains twice, {both}; {chosen}leave one in the file")
        paths[joint] = path
        gains[joint] = _pid(node, f"{source}: {place}")
        strange = [key for key in node if key not in (*TERMS, *BESIDE)]
        if strange:
            notes.append(f"{place}: does not count, as it is not known here: {first_of_many([dotted(key) for key in strange])}")

    with Together() as together:
        for path, node in _mappings(data):
            together.step(partial(read, path, node))
        if not paths and not together.failed:
            raise GainroomError(f"{source}: {f'no controller here commands torque: {notes[0]}' if notes else unknown}")
        refuse_all(f"{source}: {text}" for text in empty)
    origin = Origin(sample_rate_hz=_rate(data, {path[0] for path in paths.values() if path}, source))
    return Ros2Gains(source, "ros2_control", gains, notes=tuple(notes), origin=origin, paths=paths)


def _rate(data: dict[str, Any], controllers: Collection[str], source: str) -> float | None:
    """Lowest update_rate of these controllers, with the manager's rate for controllers without one; None if none is given."""
    rates: dict[str, float] = {}
    for path, node in _mappings(data):
        if "update_rate" in node and not isinstance(node["update_rate"], dict):
            name = next((key for key in reversed(path) if key not in WRAPPERS), "")
            rates[name] = checked(f"{source}: {dotted(*path, 'update_rate')}", node["update_rate"], RATE)
    managers = min((rate for name, rate in rates.items() if name.endswith(MANAGER)), default=None)  # /robot/controller_manager too
    own = (rates.get(name) or managers for name in controllers)  # 0: as its manager
    return min((rate for rate in own if rate), default=None)


def _mappings(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """All mappings in a file's data with the keys that lead to them."""
    if isinstance(node, dict):
        yield path, node
        for key, value in node.items():
            yield from _mappings(value, (*path, key))


def _along(data: dict[str, Any], path: Sequence[str]) -> list[dict[str, Any]]:
    """Mappings from the top down to the one at `path`."""
    nodes = [data]
    for key in path:
        nodes.append(nodes[-1][key])
    return nodes


def _joint(data: dict[str, Any], path: Sequence[str]) -> str | None:
    """Joint of the gains at `path`: the nearest key that is no wrapper, or the value of `joint` beside the wrapper."""
    nodes = _along(data, path)
    for depth in range(len(path) - 1, -1, -1):
        if path[depth] not in WRAPPERS:
            return _commanded(nodes, path[depth])
        named = nodes[depth].get("joint")
        if isinstance(named, str):
            return named
    return None


def _commanded(nodes: Sequence[Mapping[str, Any]], joint: str) -> str:
    """Joint that gets the torque: of a controller that reads other states than those of the joints it commands, from `command_joints`."""
    for node in nodes:
        read, commanded = node.get("joints"), node.get("command_joints")
        if isinstance(read, list) and isinstance(commanded, list) and len(read) == len(commanded) and joint in read:
            return str(commanded[read.index(joint)])
    return joint


def _no_torque(data: dict[str, Any], path: Sequence[str], types: Mapping[str, Any]) -> str:
    """Reason why a controller's gains are not N m/rad; "" if they are, or may be."""
    for key, node in zip(("", *path), _along(data, path), strict=True):
        commands = node.get("command_interfaces", node.get("command_interface"))
        commands = commands if isinstance(commands, list) else [] if commands is None else [commands]
        if commands and "effort" not in commands:
            return f"it commands {', '.join(map(str, commands))[:60]}, not effort"
        measured = node.get("reference_and_state_interfaces")
        if isinstance(measured, list) and measured and measured[0] != "position":
            return f"it follows {shown(measured[0])}, not position"
        kind = str(node.get("type", types.get(key, "")))
        if re.match(r"(position|velocity)_controllers/", kind) or "Velocity" in kind:
            return f"it is a {shown(kind)}"
    return ""


def _without_terms(path: Sequence[str], node: Mapping[str, Any]) -> list[str]:
    """Messages for the places of gains in which no gains are."""
    found = []
    if path and any(key in HOLDERS for key in path) and not any(isinstance(value, dict) for value in node.values()):
        found.append(f"{dotted(*path)}: must hold p, i and d{_found(node)}")
    for key, value in node.items():
        inside = key in HOLDERS or path[-1:] in (("gains",), ("pid_gains",))
        if inside and (value is None or isinstance(value, str | int | float)):
            found.insert(0, f"{dotted(*path, key)}: {shown(value)} must be a section with p, i and d")
    return found


def _found(node: Mapping[str, Any]) -> str:
    """End of a message: the keys that a section holds instead."""
    return f", and holds {first_of_many([dotted(key) for key in node])}" if node else ""


def _pid(node: Mapping[str, Any], owner: str) -> Gain:
    """Gain of a mapping with p, i, d.

    p is required: a controller takes 0 for a missing one, which nobody means. An unknown short key was meant to be one of the three.
    """
    meant = {key: typo_of(key, (*TERMS, *BESIDE)) for key in node if key not in (*TERMS, *BESIDE)}
    wrong = [
        f"{owner}.{dotted(key)}: unknown key" + (f"; did you mean {term}?" if term else f" beside {', '.join(TERMS)}")
        for key, term in meant.items()
        if term or len(key) <= LONGEST_SLIP
    ]
    if "p" not in node and not wrong:
        wrong.append(f"{owner}.p is missing: the gain on position [N·m/rad]{_found(node)}; write 0 where there is none")
    with Together() as together:
        numbers = [together.step(partial(checked, f"{owner}.{term}", node.get(term, 0.0), NOT_NEGATIVE)) for term in TERMS]
        refuse_all(wrong)
        gains: dict[str, Any] = {name: each() for name, each in zip(TERMS.values(), numbers, strict=True)}
    return Gain(**gains, effort_limit=_clamp(node))


def _clamp(node: Mapping[str, Any]) -> float | None:
    """Larger of the two clamps of the output; None unless both are given."""
    bounds = [node.get(key) for key in ("u_clamp_max", "u_clamp_min")]
    found = [abs(float(each)) for each in bounds if isinstance(each, int | float) and math.isfinite(each)]
    return max(found) or None if len(found) == len(bounds) else None
