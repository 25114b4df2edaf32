"""Actuator configurations of mjlab and Isaac Lab: Python files, read as text (python_values).

A configuration is a call, or a class, with names of joints (`target_names_expr`, `joint_names_expr`; regular expressions for whole names),
`stiffness` and `damping`: a number, or by pattern. Lags delay the set-point and not the feedback there, so they are no delay of the loop.
"""

import ast
import contextlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...errors import GainroomError, first_of_many
from ...io.validation import checked, number
from ...io.yaml_text import shown
from ...robot.name_patterns import select_all
from .gain_arrays import ArrayNames, is_gain_array, read_arrays
from .gain_record import NOT_NEGATIVE, Gain, GainFile
from .legged_gym import legged_gym_robots, read_legged_gym
from .python_expressions import Record, Unknown, is_number, parts
from .python_values import SET_UP, PythonValues, one_robot, read_python

TARGETS = ("target_names_expr", "joint_names_expr", "actuated_names_expr")
EFFORT_LIMITS = ("effort_limit", "actuator_effort_limit", "joint_effort_limit", "effort_limit_sim")
GROUPS = ("actuators", "articulation", "base_cfg")
POSTURE = "joint_pos"
GUARDED = (*TARGETS, *EFFORT_LIMITS, *GROUPS, "stiffness", "damping", "armature", POSTURE, "default_joint_angles")
"""What must not be changed where it is not followed."""
WITHOUT_GAINS = {
    "ActuatorNetMLPCfg": "a network",
    "ActuatorNetLSTMCfg": "a network",
    "LearnedMlpActuatorCfg": "a network",
    "BuiltinMotorActuatorCfg": "torque alone",
    "BuiltinMuscleActuatorCfg": "a muscle",
    "XmlMotorActuatorCfg": "torque alone",
    "XmlMuscleActuatorCfg": "a muscle",
}
"""Classes that feed no position back, and what they do."""
IN_THE_MODEL = ("XmlPositionActuatorCfg", "XmlVelocityActuatorCfg", "XmlActuatorCfg", "XmlPdActuatorCfg")
VELOCITY_ONLY = ("BuiltinVelocityActuatorCfg",)
LAGS = (("delay_min_lag", "delay_max_lag"), ("min_delay", "max_delay"))
LAG = number(least=0, most=100_000)
ARMATURE = number(least=0)
EFFORT = number(above=0, infinite=True)


@dataclass(frozen=True)
class Group:
    """Actuators alike: patterns of the joints, and each quantity for all or by pattern; None: not named. `owner` begins messages."""

    owner: str
    joints: tuple[str, ...]
    kp: float | Mapping[str, float]
    kd: float | Mapping[str, float]
    motor_inertia: float | Mapping[str, float] | None
    effort_limit: float | Mapping[str, float] | None


@dataclass(frozen=True)
class GroupedGains(GainFile):
    """Gains by groups of joints, each joint in one of them.

    postures   by name, angles by pattern, of the file's initial states
    """

    groups: tuple[Group, ...] = ()
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def postures_for(self, joint_names: Sequence[str]) -> Mapping[str, Mapping[str, float]]:
        found = {}
        for title, angles in self.postures.items():
            with contextlib.suppress(GainroomError):  # of another robot, or of more joints than the model has
                places = select_all(angles, joint_names, f"{self.source}: {title}")
                pairs = zip(places, angles.values(), strict=True)
                found[title] = {joint_names[k]: angle for matched, angle in pairs for k in matched}
        return found

    @property
    def own_names(self) -> tuple[str, ...]:
        """The joints' names, where no group has a pattern."""
        patterns = [joint for group in self.groups for joint in group.joints]
        names = [re.sub(r"\\(.)", r"\1", pattern) for pattern in patterns]
        return tuple(names) if [re.escape(name) for name in names] == patterns else ()

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        result: list[list[Gain]] = [[] for _ in joint_names]
        owners: dict[int, str] = {}
        for group in self.groups:
            chosen = sorted({k for found in select_all(group.joints, joint_names, group.owner) for k in found})
            names = [joint_names[k] for k in chosen]
            columns = [_by_joint(getattr(group, name), names, group.owner, title) for name, title in _COLUMNS.items()]
            for k, kp, kd, motor_inertia, effort_limit in zip(chosen, *columns, strict=True):
                if k in owners:
                    raise GainroomError(
                        f"{group.owner}: joint {shown(joint_names[k])} has gains in {owners[k].rpartition(': ')[2]}, too; leave one"
                    )
                owners[k] = group.owner
                result[k] = [Gain(kp or 0.0, kd or 0.0, 0.0, motor_inertia or None, effort_limit)]
        return result


_COLUMNS = {"kp": "stiffness", "kd": "damping", "motor_inertia": "armature", "effort_limit": "effort limit"}


def _by_joint(value: float | Mapping[str, float] | None, names: Sequence[str], owner: str, title: str) -> list[float | None]:
    """A quantity of each joint of a group; None where a mapping names it not."""
    if not isinstance(value, Mapping):
        return [value] * len(names)
    result: list[float | None] = [None] * len(names)
    for pattern, found in zip(value, select_all(value, names, f"{owner}: {title}"), strict=True):
        for k in found:
            if result[k] is not None:
                raise GainroomError(f"{owner}: {title}: joint {shown(names[k])} is matched by two patterns, {shown(pattern)} the second")
            result[k] = value[pattern]
    return result


def read_actuator_configs(text: str, source: str, chosen: str = "") -> GainFile:
    """The actuators in a Python text that messages call `source`; of several robots in it the one of the name `chosen`.

    Raises GainroomError, one line that names the file and the line.
    """
    values = read_python(text, source, GUARDED)
    robots = _robots(values)
    if not robots and (classes := legged_gym_robots(values)):
        return read_legged_gym(classes, source, chosen, values.notes)
    if not robots and any(is_gain_array(name) and isinstance(value, list | tuple) for name, value in values.names.items()):
        arrays = {name: value for name, value in values.names.items() if isinstance(value, list | tuple)}
        return read_arrays(arrays, ArrayNames.of(arrays, {}), source, values.lines)
    if not robots:
        raise GainroomError(f"{source}: holds no actuator configurations of mjlab or Isaac Lab{_inside_functions(values)}")
    name = one_robot(robots, source, chosen, "actuators", "robot")
    found = robots[name]
    made = list(parts(values.names.get(name) if name else found))
    changed = next((each.fields[SET_UP[0]] for each in made if isinstance(each, Record) and SET_UP[0] in each.fields), None)
    if changed is not None:
        raise GainroomError(f"{source}: line {changed.line}: {changed}; write its numbers into the configuration")
    groups, notes = [], list(values.notes)
    for record in found:
        group = _group(record, source, notes)
        if group is not None:
            groups.append(group)
    if not groups:
        raise GainroomError(f"{source}: {name}: {notes[0].removeprefix(source + ': ') if notes else 'has no actuators'}")
    imported = any(isinstance(value, Unknown) and "mjlab" in value.why for value in values.names.values())
    form = "mjlab" if imported else "Isaac Lab"
    return GroupedGains(source, form, {}, groups=tuple(groups), notes=tuple(notes), postures=_postures(values, made, len(robots) == 1))


def _postures(values: PythonValues, robot: Iterable[Any], alone: bool) -> dict[str, Mapping[str, float]]:
    """The initial states of the parts of a `robot`, by the name that holds each: those whose angles are all numbers.

    alone   whether it is the file's only one: without one of its own it has those of the file
    """
    named = {name: each for name, each in values.names.items() if _is_posture(each)}
    titles = {id(each): name for name, each in named.items()}
    found = {titles.get(id(each), "init_state"): each for each in robot if _is_posture(each)} or (named if alone else {})
    return {name: dict(each.fields[POSTURE]) for name, each in found.items()}


def _is_posture(value: Any) -> bool:
    angles = value.fields.get(POSTURE) if isinstance(value, Record) and not value.is_class else None
    if not isinstance(angles, dict) or not angles:
        return False
    return all(isinstance(name, str) and is_number(angle) for name, angle in angles.items())


def _is_actuator(record: Record) -> bool:
    inner = record.fields.get("base_cfg")
    return any(key in record.fields for key in TARGETS) or (isinstance(inner, Record) and _is_actuator(inner))


def _actuators(value: Any) -> list[Record]:
    """The actuators that stand in a value, in order, each once."""
    return [each for each in parts(value, _is_actuator) if isinstance(each, Record) and _is_actuator(each) and not each.is_class]


def _robots(values: PythonValues) -> dict[str, list[Record]]:
    """By the name that holds them, the actuators of each robot; "" where they stand by themselves.

    Of names that hold the same ones the first counts, and none that holds only some of another's.
    """
    alone: dict[int, Record] = {}
    held: dict[str, list[Record]] = {}
    for name, value in values.names.items():
        found = _actuators(value)
        if isinstance(value, Record) and _is_actuator(value):
            alone |= {id(record): record for record in found}
        elif found:
            held[name] = found
    if not held:
        return {"": list(alone.values())} if alone else {}
    result: dict[str, list[Record]] = {}
    keys = {name: frozenset(map(_identity, found)) for name, found in held.items()}
    for name, found in held.items():
        same = any(keys[name] == keys[other] for other in result)
        if not same and not any(keys[name] < each for each in keys.values()):
            result[name] = found
    return result


def _identity(record: Record) -> tuple[Any, ...]:
    """What two copies of an actuator have in common, as long as nothing that matters was changed in one."""
    return (record.line, *(_plain(record.fields.get(key)) for key in GUARDED))


def _plain(value: Any) -> Any:
    """A value to compare with another: numbers and text, and flat lists and mappings of them; of anything else its identity."""
    if isinstance(value, dict):
        return tuple((key, _plain(each) if not isinstance(each, dict | list | tuple) else id(each)) for key, each in value.items())
    if isinstance(value, list | tuple):
        return tuple(_plain(each) if not isinstance(each, dict | list | tuple) else id(each) for each in value)
    if isinstance(value, Record):
        return _identity(value) if not any(isinstance(each, Record) for each in value.fields.values()) else id(value)
    return value if isinstance(value, str | int | float | bool | None | Unknown) else id(value)


def _inside_functions(values: PythonValues) -> str:
    """Where actuators stand that are not read: the end of a message."""
    for function in values.functions:
        for node in ast.walk(function):
            if isinstance(node, ast.keyword) and node.arg in TARGETS:
                return f" outside functions, which are not run: line {node.value.lineno}; move them to the module"
    return ""


def _group(record: Record, source: str, notes: list[str]) -> Group | None:
    """A record's gains; None, and a note, where it has none."""
    inner = record.fields.get("base_cfg")
    if isinstance(inner, Record):
        _note_lags(record, source, notes)
        return _group(inner, source, notes)
    owner = f"{source}: line {record.line}: {record.name}"
    _note_lags(record, source, notes)
    joints = _patterns(next((record.fields[key], key) for key in TARGETS if key in record.fields), owner)
    listed = first_of_many(joints)
    reason = next((WITHOUT_GAINS[kind] for kind in record.kinds if kind in WITHOUT_GAINS), None)
    if reason:
        notes.append(f"{owner}: left out, as it is {reason}: {listed}")
        return None
    if any(kind in IN_THE_MODEL for kind in record.kinds):
        raise GainroomError(f"{owner}: its gains stand in the MJCF: audit that without --gains")
    fields = record.fields
    only = any(kind in VELOCITY_ONLY for kind in record.kinds)
    kp = 0.0 if only else _quantity(fields, "stiffness", owner, NOT_NEGATIVE)
    kd = _quantity(fields, "damping", owner, NOT_NEGATIVE)
    missing = "stiffness" if kp is None else "damping" if kd is None else ""
    if kp is None or kd is None:
        written = "is None: the value stands in the robot's file" if missing in fields else "is missing, and a default is not known"
        raise GainroomError(f"{owner}: {missing} {written}; write the number")
    effort = next((key for key in EFFORT_LIMITS if fields.get(key) is not None and not isinstance(fields[key], Unknown)), "effort_limit")
    limit = None if isinstance(fields.get(effort), Unknown) else _quantity(fields, effort, owner, EFFORT)
    return Group(owner, joints, kp, kd, _quantity(fields, "armature", owner, ARMATURE), limit)


def _patterns(found: tuple[Any, str], owner: str) -> tuple[str, ...]:
    value, key = found
    value = [value] if isinstance(value, str) else value
    if isinstance(value, Unknown):
        raise GainroomError(f"{owner}: {key}: {value}")
    if not isinstance(value, list | tuple) or not value:
        raise GainroomError(f"{owner}: {key} {shown(value)} must be a list of joint names or patterns")
    for each in value:
        if not isinstance(each, str):
            raise GainroomError(f"{owner}: {key}: {each if isinstance(each, Unknown) else shown(each) + ' must be a name or pattern'}")
    return tuple(value)


def _quantity(fields: Mapping[str, Any], key: str, owner: str, check: Any) -> float | Mapping[str, float] | None:
    """A number, or numbers by pattern; None where it is missing or None."""
    value = fields.get(key)
    if isinstance(value, dict):
        for pattern in value:
            if not isinstance(pattern, str):
                raise GainroomError(f"{owner}: {key}: {shown(pattern)} must be a joint name or pattern")
        return {pattern: _number(f"{owner}: {key}.{shown(pattern)}", each, check) for pattern, each in value.items()}
    return None if value is None else _number(f"{owner}: {key}", value, check)


def _number(owner: str, value: Any, check: Any) -> float:
    if isinstance(value, Unknown):
        raise GainroomError(f"{owner}: {value}" + (f" (line {value.line})" if f"line {value.line}:" not in owner else ""))
    if isinstance(value, Record):
        raise GainroomError(f"{owner}: {shown(value.name + '(…)')} is a call, and no function is run")
    return checked(owner, value, check)


def _note_lags(record: Record, source: str, notes: list[str]) -> None:
    """A note of the set-point's delay."""
    for keys in LAGS:
        given = [key for key in keys if key in record.fields]
        if not given:
            continue
        owner = f"{source}: line {record.line}: {record.name}"
        low, high = (_number(f"{owner}: {key}", record.fields.get(key, 0), LAG) for key in keys)
        if low > high:
            raise GainroomError(f"{owner}: {keys[0]} {low:g} must be at most {keys[1]} {high:g}")
        if high:
            notes.append(
                f"{owner}: its lag of {low:g} to {high:g} physics steps delays the set-point, not the feedback, so it does not count: "
                "--delay-ms is the loop's"
            )
