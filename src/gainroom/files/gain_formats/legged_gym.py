"""Gains of legged_gym, and of what descends from it (unitree_rl_gym): classes in classes, read as text (python_values); or in YAML.

`class control` has `stiffness` and `damping` by a part of the joints' names: a joint has the gains of the last key that stands in its name,
and none where no key does. `class init_state` has `default_joint_angles`, the posture about which a policy acts.
"""

import ast
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ...errors import GainroomError, Together, all_of, nearest, refuse_all
from ...io.validation import checked, dotted
from ...io.yaml_text import shown
from .gain_arrays import part_of
from .gain_record import ANGLE, NOT_NEGATIVE, Gain, GainFile
from .python_objects import Alike, Function, Record, Unknown, fields_of
from .python_values import PythonValues, one_robot

POSITION = "P"
ANGLES = "default_joint_angles"
CONTROL = "control"
GAINS = ("stiffness", "damping")
EVERY_JOINT = "default"
"""Key of the default angle of all other joints, in YAML."""


@dataclass(frozen=True)
class LeggedGymGains(GainFile):
    """Gains by parts of joint names, the keys of `gains`, of which the last match counts; `angles` by joint."""

    angles: Mapping[str, float]

    @property
    def own_names(self) -> tuple[str, ...]:
        """Joints of the default posture, which names all of them."""
        return tuple(self.angles)

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        refuse_all(
            f"{self.source}: control: {shown(key)} is in no joint's name{nearest(key, tuple(joint_names), 'joint')}"
            for key in self.gains
            if not any(key in name for name in joint_names)
        )
        return [[gain for key, gain in self.gains.items() if key in name][-1:] for name in joint_names]


def legged_gym_robots(values: PythonValues) -> dict[str, Record]:
    """Classes whose `control` has gains of its own, by name; of classes with equal gains only the first."""
    found: dict[str, Record] = {}
    for name, value in values.names.items():
        if isinstance(value, Record) and value.is_class:
            control = value.inherited(CONTROL)
            named = isinstance(control, Record) and control.is_class and {*GAINS} & fields_of(control).keys()
            if named and (method := _changes_gains(value)) is not None:
                problem = "mentions the gains and may change them where an object is made: write them into the class"
                raise GainroomError(f"{values.source}: line {method.node.lineno}: {name}.{method.name} {problem}")
            if named and not any(_same(value, other) for other in found.values()):
                found[name] = value
    return found


def _changes_gains(kind: Record) -> Function | None:
    """Method that may change the gains of a class when it is instantiated; None if there is none."""
    if not isinstance(kind.inherited("__init__"), Function):
        return None
    methods = [each for each in fields_of(kind).values() if isinstance(each, Function)]
    return next((each for each in methods if any(_names_gains(node) for node in ast.walk(each.node))), None)


def _names_gains(node: ast.AST) -> bool:
    return (isinstance(node, ast.Attribute) and node.attr in GAINS) or (isinstance(node, ast.Constant) and node.value in GAINS)


def _same(one: Record, other: Record) -> bool:
    """True if two classes have the same gains and angles, as a class and its subclass may."""
    alike = Alike()
    pairs = [(_section(one, name).get(key), _section(other, name).get(key)) for name, key in _READ]
    return all(alike.number(first) == alike.number(second) for first, second in pairs)


_READ = (
    *((CONTROL, key) for key in (*GAINS, "control_type")),
    ("asset", "armature"),
    ("init_state", ANGLES),
)


def _section(record: Record, name: str) -> Mapping[str, Any]:
    found = record.inherited(name)
    return fields_of(found) if isinstance(found, Record) else {}


def read_legged_gym(robots: Mapping[str, Record], source: str, chosen: str, notes: Sequence[str]) -> LeggedGymGains:
    """Gains of one of legged_gym_robots. Raises GainroomError, one line that names file, line and key."""
    record = robots[one_robot(robots, source, chosen, "gains", "class")]
    control = _section(record, CONTROL)
    angles = _section(record, "init_state").get(ANGLES)
    where = f"{source}: {record.name}.init_state: {ANGLES}"
    owner = f"{source}: line {record.inherited(CONTROL).line}: {record.name}.{CONTROL}"
    with Together() as together:
        read = together.step(lambda: _gains(control, owner))
        inertia = together.step(lambda: _armature(_section(record, "asset"), f"{source}: {record.name}.asset"))
        stands = together.step(lambda: {} if angles is None or isinstance(angles, Unknown) else _numbers(angles, where, ANGLE))
        (gains, own_notes), found = read(), stands()
        gains = _with_armature(gains, inertia())
    unread = {ANGLES: f"{where}: {angles}"} if isinstance(angles, Unknown) else {}
    postures = {ANGLES: {re.escape(name): angle for name, angle in found.items()}} if found else {}
    return LeggedGymGains(source, "legged_gym", gains, notes=(*notes, *own_notes), angles=found, postures=postures, unread_postures=unread)


def has_parts(data: Mapping[str, Any], key: str) -> bool:
    """True if a mapping has stiffness and damping by part of joints' names, or one of each for all joints under the key `control`."""
    pair = [data.get(name) for name in GAINS]
    parts = [each for each in pair if isinstance(each, dict)]
    if len(parts) == len(pair):  # ranges of a randomisation are none
        return key == CONTROL or all(any(isinstance(value, int | float) for value in each.values()) for each in parts)
    return key == CONTROL and all(each is not None and not isinstance(each, list) for each in pair)


def read_parts(control: Mapping[str, Any], around: Mapping[str, Any], source: str) -> LeggedGymGains:
    """Gains of a mapping found by has_parts, and the angles that stand `around` it. Raises GainroomError."""
    asset = around.get("asset")
    with Together() as together:
        read = together.step(lambda: _gains(control, source))
        place = f"{source.rpartition(': ')[0] or source}: asset"
        inertia = together.step(lambda: _armature(asset if isinstance(asset, dict) else {}, place))
        gains, notes = read()
        gains = _with_armature(gains, inertia())
    state = around.get("init_state")
    angles = (state if isinstance(state, dict) else around).get(ANGLES, around.get("defaultJointAngles"))
    try:
        postures, unread = ({ANGLES: _by_part(angles, f"{source}: {ANGLES}")} if angles else {}), {}
    except GainroomError as error:
        postures, unread = {}, {ANGLES: str(error)}
    return LeggedGymGains(source, "legged_gym", gains, notes=notes, angles={}, postures=postures, unread_postures=unread)


def _gains(control: Mapping[str, Any], owner: str) -> tuple[dict[str, Gain], tuple[str, ...]]:
    """Gains of a `control` by part of joint names, "" for all; and notes."""
    kind = control.get("control_type", POSITION)
    if kind != POSITION:
        raise GainroomError(
            f"{owner}: control_type {kind if isinstance(kind, Unknown) else shown(kind)} must be 'P', a position controller"
        )
    for key in control:
        part = part_of(key) if isinstance(key, str) else None
        if part is not None and part[0] and part[1] in ("kp", "kd") and not isinstance(control[key], Function):
            raise GainroomError(f"{owner}: {key}: gains of further joints are read from stiffness and damping alone: write them there")
    pair = [control.get(key) for key in GAINS]
    if all(isinstance(each, int | float) for each in pair):
        return {
            "": Gain(*all_of(partial(checked, f"{owner}: {key}", each, NOT_NEGATIVE) for key, each in zip(GAINS, pair, strict=True)))
        }, ()
    stiffness, damping = all_of(partial(_numbers, each, f"{owner}: {key}", NOT_NEGATIVE) for key, each in zip(GAINS, pair, strict=True))
    refuse_all(f"{owner}: damping: names no {shown(key)}, which stiffness has" for key in stiffness if key not in damping)
    network = f"{owner}: a network stands for the motors in training; these gains are what it was trained with at most"
    return {key: Gain(stiffness[key], damping[key]) for key in stiffness}, (network,) * (control.get("use_actuator_network") is True)


def _armature(asset: Mapping[str, Any], owner: str) -> float:
    """Inertia of the motors [kg m²], 0 if not given."""
    value = asset.get("armature")
    if isinstance(value, Unknown):
        raise GainroomError(f"{owner}: armature: {value}")
    return checked(f"{owner}: armature", value, NOT_NEGATIVE) if value is not None else 0.0


def _with_armature(gains: Mapping[str, Gain], inertia: float) -> dict[str, Gain]:
    """Gains with the motors' inertia, which the simulator adds to every joint."""
    return {key: replace(each, motor_inertia=inertia or None) for key, each in gains.items()}


def _by_part(value: Any, owner: str) -> dict[str, float]:
    """Angles by pattern.

    Some readers take the keys as parts of joint names, others as joints: only angles for which both agree are used.
    """
    angles = _numbers(value, owner, ANGLE)
    parts = [key for key in angles if key != EVERY_JOINT]
    for k, key in enumerate(parts):
        if longer := [before for before in parts[:k] if key in before]:
            raise GainroomError(f"{owner}: {shown(key)} is a part of {shown(longer[0])}, which stands before it: write it first")
    rest = {".*": angles[EVERY_JOINT]} if EVERY_JOINT in angles else {}
    return rest | {f".*{re.escape(key)}.*": angles[key] for key in parts}


def _numbers(value: Any, owner: str, check: Any) -> dict[str, float]:
    """Numbers by text."""
    if isinstance(value, Unknown):
        raise GainroomError(f"{owner}: {value}")
    if not isinstance(value, dict) or not value:
        problem = "is missing: the class that it comes from is in another file" if value is None else f"{shown(value)} is no mapping"
        raise GainroomError(f"{owner}: {problem}; write a number by part of the joints' names")

    def number(key: Any, each: Any) -> float:
        if not isinstance(key, str) or not key:
            raise GainroomError(f"{owner}: {shown(key)} must be a part of joints' names")
        if isinstance(each, Unknown | Record):
            raise GainroomError(f"{owner}.{dotted(key)}: {each if isinstance(each, Unknown) else 'is a call, and no function is run'}")
        return checked(f"{owner}.{dotted(key)}", each, check)

    return dict(zip(value, all_of(partial(number, key, each) for key, each in value.items()), strict=True))
