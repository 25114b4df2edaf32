"""Precedence between the options of an audit and its file of gains: options win, or the two contradict each other, which is an error."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import GainroomError, first_of_many, option_name
from ..io.as_typed import as_typed
from ..robot.body import RigidBody
from ..robot.gearbox_types import DIRECT
from ..robot.name_patterns import select_all
from ..system.linear.arrays import Floats
from .gain_files import JointGains

JOINT_VALUES = ("stiffness", "damping", "motor_inertia")
"""Quantities that an option may give for all joints, or for some."""


class Typed(Protocol):
    """Fields of AuditOptions that this module reads."""

    @property
    def gearboxes(self) -> tuple[str, ...]: ...
    @property
    def of_joints(self) -> tuple[tuple[str, str, float], ...]: ...


def typed_first(options: Typed, found: JointGains, names: Sequence[str], source: Path) -> JointGains:
    """Gains of the file without its values for gearboxes whose type an option gives by name or pattern.

    Raises GainroomError where a value or a type that is typed of all joints contradicts the file, as one of the two would be lost.
    """
    given = [k for k, has in enumerate(found.given) if has]
    for key in JOINT_VALUES:
        _require_not_lost(key, options, found, names, source)
    types: dict[int, tuple[str, bool]] = {}
    for text in options.gearboxes:
        pattern, _, kind = text.rpartition("=")
        types |= dict.fromkeys(_of(pattern, names, given) if pattern else given, (kind, bool(pattern)))
    typed = _typed_of("stiffness", options, names, given)
    stated = {k: value for k in given if (value := found.actuators[k].get("stiffness")) is not None and k not in typed}
    lost = [k for k, (kind, chosen) in types.items() if k in stated and not chosen and not (kind == DIRECT and math.isinf(stated[k]))]
    if lost:
        kind, there = types[lost[0]][0], first_of_many([names[k] for k in lost])
        raise GainroomError(
            f"--gearbox {kind}: {source} has the stiffness of {there}: leave one out, or type --gearbox '.*={kind}', which wins"
        )
    bare = {k for k, (_, chosen) in types.items() if chosen}
    actuators = [
        {key: value for key, value in each.items() if k not in bare or key not in ("stiffness", "damping")}
        for k, each in enumerate(found.actuators)
    ]
    return replace(found, actuators=tuple(actuators))


def _require_not_lost(key: str, options: Typed, found: JointGains, names: Sequence[str], source: Path) -> None:
    """Raise GainroomError if the file has another value than an option gives for all joints.

    A motor's inertia is that of the joints of which the file has none; where it has that of all, it would be lost, too.
    """
    value, given = getattr(options, key), [k for k, has in enumerate(found.given) if has]
    if value is None:
        return
    typed = _typed_of(key, options, names, given)
    known = {k: found.actuators[k].get(key) for k in given if k not in typed}
    others = [f"{names[k]} {other:g}" for k, other in known.items() if other not in (None, value)]
    if others and (key != "motor_inertia" or None not in known.values()):
        name, there = option_name(key), first_of_many(others)
        raise GainroomError(f"{name} {value:g}: {source} has {there}: leave one out, or type {name} '.*={value:g}', which wins")


def _typed_of(key: str, options: Typed, names: Sequence[str], given: Sequence[int]) -> set[int]:
    """Joints whose value an option gives by name or pattern."""
    return {k for each, pattern, _ in options.of_joints if each == key for k in _of(pattern, names, given)}


def _of(pattern: str, names: Sequence[str], given: Sequence[int]) -> list[int]:
    """Indices of the `given` joints that a pattern matches; a pattern without a match is refused elsewhere."""
    matched = select_all([pattern], [names[k] for k in given], f"{pattern!r}", all_match=False)[0]
    return [given[k] for k in matched]


def with_joint_damping(typed: str | None, found: JointGains, body: RigidBody, source: Path) -> tuple[str | None, JointGains, list[str]]:
    """Meaning of the joints' own damping, counted once: from the option `typed`, or from a file of gains that includes it; and notes.

    Raises GainroomError where the two contradict each other.
    """
    counted_as = found.origin.joint_damping
    if typed is not None and counted_as is not None and typed != counted_as:
        raise GainroomError(f"--joint-damping {typed}: the gains of {source} hold it as {counted_as} already: leave the option out")
    known = [(name, damping, found.actuators[k].get("link_viscous")) for k, name, damping in _damped(body, found)]
    if typed == "controller" and (counted := [name for name, damping, other in known if other == damping]):
        names = first_of_many(counted)
        raise GainroomError(f"--joint-damping controller: {source} has the joints' own damping of {names} as link_viscous already")
    if typed == "friction" and (others := [f"{name} {other:g}, not {own:g}" for name, own, other in known if other not in (None, own)]):
        raise GainroomError(f"--joint-damping friction: {source} has another link_viscous of {first_of_many(others)}")
    if counted_as is not None:
        held = {"controller": "kd", "friction": "link_viscous"}[counted_as]
        return counted_as, found, [f"{held} of {source} has the joints' own damping of the model in it already"]
    if typed != "controller":
        return typed, found, []
    if found.origin.whole_kd:
        return typed, found, [f"kd of {source} is the whole one: the joints' own damping of the model is not added to it"]
    return typed, replace(found, kd=_with(found, padded(body.damping, len(found.kd)))), []


def _with(found: JointGains, damping: Floats) -> Floats:
    """Gain kd plus the joints' own damping, both (n,), added in decimal as by hand."""
    return np.array([as_typed(kd + own) if given else kd for kd, own, given in zip(found.kd, damping, found.given, strict=True)])


def _damped(body: RigidBody, found: JointGains) -> list[tuple[int, str, float]]:
    """Joints with gains and with damping of their own in the model: index, name and damping [N m s/rad]."""
    columns = zip(body.joint_names, body.damping.tolist(), found.given[: body.size].tolist(), strict=True)
    return [(k, name, damping) for k, (name, damping, given) in enumerate(columns) if given and damping]


def padded(column: Floats, size: int) -> Floats:
    """Column of the movable joints, padded with zeros for the locked ones."""
    return np.concatenate([column, np.zeros(size - len(column))])
