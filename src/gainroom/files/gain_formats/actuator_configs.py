"""Actuator configurations of mjlab and Isaac Lab: Python files, read as text (python_values).

A configuration is a call, or a class, with names of joints (`target_names_expr`, `joint_names_expr`; regular expressions for whole names),
`stiffness` and `damping`: a number, or by pattern. Lags delay the set-point and not the feedback there, so they are no delay of the loop.
"""

import ast
import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ...errors import GainroomError, Together, all_of, first_of_many, refuse_all
from ...io.validation import checked, dotted, number
from ...io.yaml_text import shown
from ...robot.name_patterns import select_all
from .gain_arrays import INDICES, KD, ORDERS, ArrayNames, is_gain_array, read_arrays
from .gain_record import NOT_NEGATIVE, Gain, GainFile
from .legged_gym import CONTROL, legged_gym_robots, read_legged_gym
from .python_objects import DEEPEST, REST, Alike, Function, Once, Record, Unknown, View, contents, fields_of, is_number, parts
from .python_undecided import COPIES
from .python_values import PythonValues, one_robot, read_python

TARGETS = ("target_names_expr", "joint_names_expr", "actuated_names_expr")
EFFORT_LIMITS = ("effort_limit", "actuator_effort_limit", "joint_effort_limit", "effort_limit_sim")
GROUPS = ("actuators", "articulation", "base_cfg")
POSTURE = "joint_pos"
INERTIAS, GEARBOX = ("armature", "motor_inertia"), ("gearbox_stiffness", "gearbox_damping")
"""Keys of the motor's inertia; and of the gearbox, which gainroom's own actuators (trainers) have."""
LOOP = ("delay", "jitter", "period", "kd_delay", "kd_period", "encoder", "bandwidth", "friction", "viscous")
"""Keys of gainroom's own actuators for their loop and the motor's friction."""
GUARDED = (*TARGETS, *EFFORT_LIMITS, *GROUPS, *INERTIAS, *GEARBOX, "stiffness", "damping", POSTURE, "default_joint_angles")
"""Fields that decide gains: a file that changes one of them in a way that is not followed is refused."""
WITHOUT_GAINS = {
    "ActuatorNetMLPCfg": "a network",
    "ActuatorNetLSTMCfg": "a network",
    "LearnedMlpActuatorCfg": "a network",
    "BuiltinMotorActuatorCfg": "torque alone",
    "BuiltinMuscleActuatorCfg": "a muscle",
    "XmlMotorActuatorCfg": "torque alone",
    "XmlMuscleActuatorCfg": "a muscle",
}
"""Actuator classes without position feedback, with a description of each."""
IN_THE_MODEL = ("XmlPositionActuatorCfg", "XmlVelocityActuatorCfg", "XmlActuatorCfg", "XmlPdActuatorCfg")
VELOCITY_ONLY = ("BuiltinVelocityActuatorCfg",)
LAGS = (("delay_min_lag", "delay_max_lag"), ("min_delay", "max_delay"))
LIBRARIES = ("isaaclab", "omni", "mjlab", "dataclasses", "enum", "typing", "abc")
"""Libraries whose classes hold no gains of a robot."""
LAG = number(least=0, most=100_000)
ARMATURE = number(least=0)
EFFORT = number(above=0, infinite=True)


@dataclass(frozen=True)
class Group:
    """Group of equal actuators: patterns of its joints, and each quantity for all or by pattern; None: not given.

    `owner` begins messages.
    """

    owner: str
    joints: tuple[str, ...]
    kp: float | Mapping[str, float]
    kd: float | Mapping[str, float]
    motor_inertia: float | Mapping[str, float] | None
    effort_limit: float | Mapping[str, float] | None
    gearbox_stiffness: float | Mapping[str, float] | None = None
    gearbox_damping: float | Mapping[str, float] | None = None


@dataclass(frozen=True)
class GroupedGains(GainFile):
    """Gains by groups of joints; each joint belongs to one group."""

    groups: tuple[Group, ...] = ()

    @property
    def own_names(self) -> tuple[str, ...]:
        """Joint names, if no group has a pattern."""
        patterns = [joint for group in self.groups for joint in group.joints]
        names = [re.sub(r"\\(.)", r"\1", pattern) for pattern in patterns]
        return tuple(names) if [re.escape(name) for name in names] == patterns else ()

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        result: list[list[Gain]] = [[] for _ in joint_names]
        owners: dict[int, str] = {}

        def place(group: Group) -> None:
            chosen = sorted({k for found in select_all(group.joints, joint_names, group.owner) for k in found})
            names = [joint_names[k] for k in chosen]
            columns = all_of(partial(_by_joint, getattr(group, name), names, group.owner, title) for name, title in _COLUMNS.items())
            refuse_all(
                f"{group.owner}: joint {shown(joint_names[k])} has gains in {owners[k].rpartition(': ')[2]}, too; leave one"
                for k in chosen
                if k in owners
            )
            for k, kp, kd, motor_inertia, effort_limit, stiffness, damping in zip(chosen, *columns, strict=True):
                owners[k] = group.owner
                result[k] = [Gain(kp or 0.0, kd or 0.0, 0.0, motor_inertia or None, effort_limit, stiffness, damping)]

        all_of(partial(place, group) for group in self.groups)
        return result


_COLUMNS = {"kp": "stiffness", "kd": "damping", "motor_inertia": "armature", "effort_limit": "effort limit"} | {
    name: name.replace("_", " ") for name in GEARBOX
}


def _by_joint(value: float | Mapping[str, float] | None, names: Sequence[str], owner: str, title: str) -> list[float | None]:
    """Quantity of each joint of a group; None where a mapping does not name the joint."""
    if not isinstance(value, Mapping):
        return [value] * len(names)
    result: list[float | None] = [None] * len(names)
    for pattern, found in zip(value, select_all(value, names, f"{owner}: {title}"), strict=True):
        for k in found:
            if result[k] is not None:
                raise GainroomError(f"{owner}: {title}: joint {shown(names[k])} is matched by two patterns, {shown(pattern)} the second")
            result[k] = value[pattern]
    return result


def read_actuator_configs(text: str, source: str, chosen: str = "", folder: Path | None = None) -> GainFile:
    """Actuators in a Python text that messages call `source`; of several robots the one with the name `chosen`.

    folder   in which files lie that the text names; None: none is read

    Raises GainroomError, one line that names the file and the line.
    """
    values = _with_objects(read_python(text, source, GUARDED, folder))
    robots = _robots(values)
    if chosen and chosen not in robots and (value := _named(values, chosen)) is not None:
        if isinstance(value, Unknown):
            raise GainroomError(f"{source}: line {value.line}: {chosen}: {value}")
        robots = {chosen: value} if _actuators(value) else robots
    if not robots:
        return _without_actuators(values, source, chosen)
    name = one_robot(robots, source, chosen, "actuators", "robot")
    robot = robots[name]
    notes = list(values.notes)
    with _each_cause_once():
        read = all_of(partial(_understood_group, record, source, name, notes) for record in _actuators(robot))
    groups = [group for group in read if group is not None]
    if not groups:
        raise _no_gains(notes, source, name)
    form = "mjlab" if any(isinstance(each, Unknown) and each.path.startswith("mjlab") for each in values.names.values()) else "Isaac Lab"
    if not chosen:
        notes += _not_looked_at(values, robots, source)
    postures, unread = _postures(values, robot, source, len(robots) == 1)
    return GroupedGains(
        source, form, {}, groups=tuple(groups), notes=tuple(dict.fromkeys(notes)), postures=postures, unread_postures=unread
    )


def has_groups(data: Mapping[str, Any]) -> bool:
    """True if a mapping of a YAML file holds actuators, as Isaac Lab and mjlab write their training configuration."""
    return any(isinstance(each, dict) and any(key in each for key in (*TARGETS, "base_cfg")) for _, each in _written(data))


def _written(data: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Actuator entries of a mapping of a YAML file, each with its path."""
    held = data.get("articulation", data)
    held = held.get("actuators", data if held is data else {}) if isinstance(held, dict) else held
    pairs = held.items() if isinstance(held, dict) else enumerate(held) if isinstance(held, list) else ()
    return [(dotted("actuators", str(key)) if held is not data else dotted(str(key)), each) for key, each in pairs]


def read_actuator_data(data: Mapping[str, Any], source: str) -> GainFile:
    """Actuators of a mapping found by has_groups, in which a class is named by `class_type`. Raises GainroomError."""
    notes: list[str] = []

    def read(name: str, each: Any) -> Group | None:
        if not isinstance(each, dict):
            raise GainroomError(f"{source}: {name}: {shown(each)} is no actuator configuration")
        return _understood_group(_written_record(name, each, source), source, "", notes)

    groups = [group for group in all_of(partial(read, name, each) for name, each in _written(data)) if group is not None]
    if not groups:
        raise _no_gains(notes, source, "")
    state = data.get("init_state")
    robot = Record("robot", 0, {"init_state": _written_record("init_state", state, source)} if isinstance(state, dict) else {})
    postures, unread = _postures(PythonValues(source, {}, {}, []), robot, source, False)
    return GroupedGains(source, "Isaac Lab", {}, groups=tuple(groups), notes=tuple(notes), postures=postures, unread_postures=unread)


def _written_record(name: str, data: Mapping[str, Any], source: str) -> Record:
    """Configuration record from YAML data."""
    kind = str(data.get("class_type", "")).rpartition(":")[2].rpartition(".")[2]
    inner = data.get("base_cfg")
    fields = {**data, "base_cfg": _written_record(f"{name}.base_cfg", inner, source)} if isinstance(inner, dict) else dict(data)
    return Record(name, 0, fields, (f"{kind.removesuffix('Cfg')}Cfg",), source=source)


def _no_gains(notes: Sequence[str], source: str, name: str) -> GainroomError:
    """Error for a robot without an actuator whose gains are known: the reason, and the remedy."""
    owner = f"{source}: {name}" if name else source
    if not notes:
        return GainroomError(f"{owner}: has no actuators")
    others = "name another, or write the gains that the drives have into a YAML file: JOINT: {kp: 100, kd: 5}"
    return GainroomError(
        f"{notes[-1].replace('left out', f'{name} has no gains that are known' if name else 'no gains are known')}; {others}"
    )


def _without_actuators(values: PythonValues, source: str, chosen: str) -> GainFile:
    """Gains of a file that has them in another format. Raises GainroomError if it has none."""
    if classes := legged_gym_robots(values):
        return read_legged_gym(classes, source, chosen, values.notes)
    arrays = {name: each for name, each in {"": values.names, **_records(values)}.items() if any(map(is_gain_array, each))}
    arrays = {name: each for name, each in arrays.items() if _is_array(each)} or arrays
    if arrays and (chosen or any(map(_is_array, arrays.values()))):
        name = one_robot(arrays, source, chosen, "gains", "robot")
        for key, value in arrays[name].items():
            if isinstance(value, Unknown) and (key is REST or key.lower() in (*ORDERS, *INDICES, *KD) or is_gain_array(key)):
                raise GainroomError(f"{source}: line {value.line}: {key}: {value}")
        lists = {key: value for key, value in arrays[name].items() if isinstance(key, str) and isinstance(value, list | tuple)}
        return read_arrays(lists, ArrayNames.of(lists, {}), source, values.lines if not name else None)
    unknown = _named(values, chosen) if chosen else None
    built = {name: each for name, each in values.names.items() if _is_built_on(each)} if unknown is None else {chosen: unknown}
    for name, each in built.items():
        if isinstance(each, Unknown):
            raise GainroomError(f"{source}: line {each.line}: {name}: {each}")
    built_on = f"{_inside_functions(values)}{_foreign_class(values)}"
    raise GainroomError(f"{source}: holds no actuator configurations of mjlab or Isaac Lab{built_on}")


def _records(values: PythonValues) -> dict[str, dict[str, Any]]:
    """Fields of each configuration and of each class of the file, by its name."""
    return {name: fields_of(each) for name, each in values.names.items() if isinstance(each, Record)}


def _is_array(fields: Mapping[str, Any]) -> bool:
    return any(isinstance(key, str) and is_gain_array(key) and isinstance(value, list | tuple | Unknown) for key, value in fields.items())


def _is_built_on(value: Any) -> bool:
    """True if a value is a copy of a configuration in another file."""
    return isinstance(value, Unknown) and value.path.rpartition(".")[2] in COPIES and not value.kind


def _not_looked_at(values: PythonValues, robots: Mapping[str, Any], source: str) -> list[str]:
    """Notes about actuators outside every robot, and about configurations that build on those of another file."""
    alike = Alike()
    used = {_identity(each, alike) for robot in robots.values() for each in _actuators(robot)}
    notes = [
        f"{source}: line {each.line}: {name} is in no robot's actuators, so it does not count"
        for name, each in values.names.items()
        if isinstance(each, Record) and _is_actuator(each) and not each.is_class and _identity(each, alike) not in used
    ]
    built = [(name, each) for name, each in values.names.items() if _is_built_on(each)]
    return notes + [f"{source}: line {each.line}: {name} is not looked at: {each}" for name, each in built]


def _postures(values: PythonValues, robot: Any, source: str, alone: bool) -> tuple[dict[str, Mapping[str, float]], dict[str, str]]:
    """Initial states of the parts of a `robot`, by name; and those that are not understood, with the reason.

    alone   whether it is the file's only one: without one of its own it has those of the file
    """
    named = {name: each for name, each in values.names.items() if _has_posture(each)}
    titles = {id(each): name for name, each in named.items()}
    own = {titles.get(id(each), "init_state"): each for each in parts(robot) if _has_posture(each)}
    known: dict[str, Mapping[str, float]] = {}
    unread: dict[str, str] = {}
    for name, each in (own or (named if alone else {})).items():
        angles = each.fields[POSTURE]
        inner = [angles] if not isinstance(angles, dict) else [each for pair in angles.items() for each in pair]
        unknown = next((value for value in inner if isinstance(value, Unknown)), None)
        if isinstance(angles, dict) and all(isinstance(key, str) and is_number(value) for key, value in angles.items()):
            known[name] = dict(angles)
        else:
            line = each.line if unknown is None or unknown.source else unknown.line
            unread[name] = f"{source}: line {line}: {name}: {POSTURE}: {unknown or 'must be angles by joint or pattern'}"
    return known, unread


def _has_posture(value: Any) -> bool:
    return isinstance(value, Record) and not value.is_class and bool(value.fields.get(POSTURE))


def _is_actuator(value: Any) -> bool:
    return isinstance(value, Record) and any(key in fields_of(value) for key in (*TARGETS, "base_cfg"))


def _actuators(value: Any, depth: int = 0, seen: set[int] | None = None) -> list[Any]:
    """Actuators in a value, in order, and any other values in the places of actuators."""
    seen = set() if seen is None else seen
    if id(value) in seen or depth > DEEPEST:
        return []
    seen.add(id(value))
    if isinstance(value, Record) and _is_actuator(value):
        return [] if value.is_class else [value]
    fields = fields_of(value) if isinstance(value, Record) else {}
    if isinstance(value, list | tuple | dict | View | Once) and any(_is_actuator(each) and not each.is_class for each in contents(value)):
        return contents(value)
    result: list[Any] = []
    for key, each in fields.items() if isinstance(value, Record) else enumerate(contents(value)):
        if key == "actuators" and each is not None:
            result += contents(each) if isinstance(each, list | tuple | dict | View | Once) else [each]
        elif key == "articulation" and isinstance(each, Unknown):
            result.append(each)
        elif not isinstance(each, Function):
            result += _actuators(each, depth + 1, seen)
    return result


def _understood(value: Any, source: str, name: str) -> Record:
    """Actuator record. Raises GainroomError for any other value."""
    if isinstance(value, Record) and _is_actuator(value) and not value.is_class:
        return value
    owner = f"{name}: actuators" if name else "actuators"
    if isinstance(value, Unknown):
        raise GainroomError(f"{source}: line {value.line}: {owner}: {value}")
    if isinstance(value, list | tuple | dict) and (inner := next((each for each in parts(value) if isinstance(each, Record)), None)):
        what = f"a {type(value).__name__} stands where an actuator must; write what is in it, or unpack it with * or **"
        raise GainroomError(f"{inner.source or source}: line {inner.line}: {owner}: {what}")
    if isinstance(value, Record):
        what = "names no joints: what its class has by default is not known; write joint_names_expr"
        raise GainroomError(f"{value.source}: line {value.line}: {owner}: {value.name} {what}")
    raise GainroomError(f"{source}: {owner}: {shown(value)} is no actuator configuration")


@contextlib.contextmanager
def _each_cause_once() -> Iterator[None]:
    """Reduces the problems of the block to one for each cause: one line that is not understood may spoil several quantities."""
    try:
        yield
    except GainroomError as error:
        causes = {text: re.search(r": ([^:]* \(line \d+\))\Z", text) for text in reversed(error.problems)}
        first = {(found[1] if found else text): text for text, found in causes.items()}
        raise GainroomError(*reversed(first.values())) from error


def _understood_group(value: Any, source: str, name: str, notes: list[str]) -> Group | None:
    """Actuator group in a value; as _group otherwise. Raises GainroomError if the value is not understood."""
    return _group(_understood(value, source, name), source, notes)


def _robots(values: PythonValues) -> dict[str, Any]:
    """Robots of the file: the objects that hold actuators, by name; "" for actuators outside any robot.

    An object inside another robot is not a robot of its own; of robots with the same actuators in the same posture only the first counts.
    """
    alone = [each for each in values.names.values() if isinstance(each, Record) and _is_actuator(each) and not each.is_class]
    held = {name: each for name, each in _candidates(values.names).items() if _actuators(each)}
    if not held and (empty := {name: each for name, each in values.names.items() if _records_with(each, "actuators")}):
        return empty
    if not held:
        return {"": tuple({id(each): each for each in alone}.values())} if alone else _made_by_functions(values)
    inside = {id(each) for robot in held.values() if isinstance(robot, Record) for each in parts(robot) if each is not robot}
    alike = Alike()
    keys = {name: frozenset(_identity(actuator, alike) for actuator in _actuators(each)) for name, each in held.items()}
    result: dict[str, Any] = {}
    known: set[Any] = set()
    for name, each in held.items():
        bare = not isinstance(each, Record)
        if id(each) in inside or (bare and any(keys[name] <= keys[other] for other, robot in held.items() if isinstance(robot, Record))):
            continue
        if bare and any(keys[name] < keys[other] for other in held):
            continue
        key = (keys[name], alike.number(next((part.fields[POSTURE] for part in parts(each) if _has_posture(part)), None)))
        if key not in known:
            known.add(key)
            result[name] = each
    return result


def _records_with(value: Any, key: str) -> bool:
    """True if a value holds a configuration with a field of this name."""
    return any(isinstance(each, Record) and key in each.fields for each in parts(value))


def _candidates(names: Mapping[str, Any]) -> dict[str, Any]:
    """Possible robots by name: configurations and collections of actuators, also those in a dictionary of them."""
    result: dict[str, Any] = {}
    for name, value in names.items():
        if not isinstance(value, dict | list | tuple) or any(map(_is_actuator, contents(value))):
            if not _is_actuator(value) and not isinstance(value, Function):
                result[name] = value
        else:
            pairs = value.items() if isinstance(value, dict) else enumerate(value)
            result |= {f"{name}.{key}": each for key, each in pairs if not _is_actuator(each)}
    return result


def _made_by_functions(values: PythonValues) -> dict[str, Any]:
    """Return values that hold actuators, by name of the function; only functions that need no arguments are called."""
    functions = {name: each for name, each in values.names.items() if isinstance(each, Function) and not _needed(each)}
    made = {name: values.call(each) for name, each in functions.items()}
    return {name: (each,) if _is_actuator(each) else each for name, each in made.items() if _actuators(each)}


def _needed(function: Function) -> bool:
    arguments = function.node.args
    return any(each.arg not in function.defaults for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs))


def _named(values: PythonValues, chosen: str) -> Any:
    """Value of a name of the file, or of a dotted name within it; for a function without required arguments its return value."""
    first, *rest = chosen.split(".")
    value = values.names.get(first)
    for name in rest:
        held = fields_of(value) if isinstance(value, Record) else value if isinstance(value, dict) else {}
        value = held.get(name)
    value = values.call(value) if isinstance(value, Function) and not _needed(value) else value
    return (value,) if isinstance(value, Record) and _is_actuator(value) else value


def _identity(value: Any, alike: Alike) -> tuple[Any, ...]:
    """Key that is equal for two copies of an actuator unless one of the guarded fields was changed in one of them."""
    if not isinstance(value, Record):
        return (str(value),) if isinstance(value, Unknown) else (id(value),)
    return (value.source, value.line, *(alike.number(value.fields.get(key)) for key in GUARDED))


def _with_objects(values: PythonValues) -> PythonValues:
    """Values of the file with an instance in the place of each class whose constructor changes its fields."""
    names = dict(values.names)
    for name, each in values.names.items():
        changes = isinstance(each, Record) and each.is_class and any(each.inherited(made) for made in ("__init__", "__post_init__"))
        if changes and not _is_actuator(each) and each.inherited(CONTROL) is None:
            made = values.make(each)
            holds = isinstance(made, Unknown) and _actuators(each)
            names[name] = made if not holds else Record(each.name, each.line, {"actuators": made}, source=each.source)
    return replace(values, names=names)


def _foreign_class(values: PythonValues) -> str:
    """End of a message: the class of the file that inherits from one that is not read."""
    for name, each in values.names.items():
        if isinstance(each, Record) and each.is_class and each.foreign and each.foreign[0].partition(".")[0] not in LIBRARIES:
            base = each.foreign[0].rpartition(".")[2]
            return f"; line {each.line}: {name} inherits from {base}, whose file is not read: give that file, or lay it beside this one"
    return ""


def _inside_functions(values: PythonValues) -> str:
    """End of a message about actuators inside functions that need arguments, which are not read: their line."""
    for function in values.names.values():
        for node in ast.walk(function.node) if isinstance(function, Function) else []:
            if isinstance(node, ast.keyword) and node.arg in TARGETS:
                return f" outside functions that need arguments: line {node.value.lineno}; write the call into the file"
    return ""


def _group(record: Record, source: str, notes: list[str]) -> Group | None:
    """Actuator group of a record; None, with a note, if it has no gains."""
    owner = f"{record.source or source}: {f'line {record.line}: ' if record.line else ''}{record.name}"
    if REST in record.fields:
        raise GainroomError(f"{owner}: {record.fields[REST]} and may have changed it")
    inner = record.fields.get("base_cfg")
    if inner is not None:
        _note_lags(record, owner, notes)
        if not (isinstance(inner, Record) and _is_actuator(inner)):
            raise GainroomError(
                f"{owner}: base_cfg: {inner if isinstance(inner, Unknown) else shown(inner) + ' is no actuator configuration'}"
            )
        return _group(inner, source, notes)
    with Together() as together:
        step = together.step
        step(lambda: _note_lags(record, owner, notes))
        _note_loop(record, owner, notes)
        joints = step(lambda: _patterns(next((record.fields[key], key) for key in TARGETS if key in record.fields), owner))
        reason = next((WITHOUT_GAINS[kind] for kind in record.kinds if kind in WITHOUT_GAINS), None)
        if reason:
            notes.append(f"{owner}: left out, as it is {reason}: {first_of_many(joints())}")
            return None
        if any(kind in IN_THE_MODEL for kind in record.kinds):
            raise GainroomError(f"{owner}: its gains stand in the MJCF: audit that without --gains")
        fields = record.fields
        only = any(kind in VELOCITY_ONLY for kind in record.kinds)
        kp = step(lambda: 0.0 if only else _gain(fields, "stiffness", owner))
        kd = step(lambda: _gain(fields, "damping", owner))
        inertia = step(
            lambda: _quantity(fields, next((key for key in INERTIAS if fields.get(key) is not None), "armature"), owner, ARMATURE)
        )
        gearbox = [step(partial(_quantity, fields, key, owner, check)) for key, check in zip(GEARBOX, (EFFORT, ARMATURE), strict=True)]
        effort = next((key for key in EFFORT_LIMITS if fields.get(key) is not None), "effort_limit")
        limit = step(lambda: _quantity(fields, effort, owner, EFFORT))
        return Group(owner, joints(), kp(), kd(), inertia(), limit(), *(each() for each in gearbox))


def _gain(fields: Mapping[str, Any], key: str, owner: str) -> float | Mapping[str, float]:
    """Quantity of a field, which must be present; otherwise as _quantity."""
    found = _quantity(fields, key, owner, NOT_NEGATIVE)
    if found is None:
        written = "is None: the value stands in the robot's file" if key in fields else "is missing, and a default is not known"
        raise GainroomError(f"{owner}: {key} {written}; write the number")
    return found


def _patterns(found: tuple[Any, str], owner: str) -> tuple[str, ...]:
    value, key = found
    value = [value] if isinstance(value, str) else value
    if isinstance(value, Unknown):
        raise GainroomError(f"{owner}: {key}: {value}")
    if not isinstance(value, list | tuple) or not value:
        raise GainroomError(f"{owner}: {key} {shown(value)} must be a list of joint names or patterns")
    refuse_all(
        f"{owner}: {key}: {each if isinstance(each, Unknown) else shown(each) + ' must be a name or pattern'}"
        for each in value
        if not isinstance(each, str)
    )
    return tuple(value)


def _quantity(fields: Mapping[str, Any], key: str, owner: str, check: Any) -> float | Mapping[str, float] | None:
    """Number, or numbers by pattern, of a field; None if it is missing or None."""
    value = fields.get(key)
    if isinstance(value, dict):

        def read(pattern: Any, each: Any) -> float:
            if pattern is REST:
                raise GainroomError(f"{owner}: {key}: {each}")
            if not isinstance(pattern, str):
                raise GainroomError(f"{owner}: {key}: {shown(pattern)} must be a joint name or pattern")
            return _number(f"{owner}: {key}.{shown(pattern)}", each, check)

        return dict(zip(value, all_of(partial(read, pattern, each) for pattern, each in value.items()), strict=True))
    return None if value is None else _number(f"{owner}: {key}", value, check)


def _number(owner: str, value: Any, check: Any) -> float:
    if isinstance(value, Unknown):
        raise GainroomError(f"{owner}: {value}" + (f" (line {value.line})" if f"line {value.line}:" not in owner else ""))
    if isinstance(value, Record):
        raise GainroomError(f"{owner}: {shown(value.name + '(…)')} is a configuration, and must be a number")
    return checked(owner, value, check)


def _note_loop(record: Record, owner: str, notes: list[str]) -> None:
    """Adds a note about a loop that gainroom's own actuators describe, and flags have to."""
    found = [key for key in LOOP if record.fields.get(key) is not None]
    if found:
        notes.append(
            f"{owner}: {', '.join(found)}: not read here: --delay-ms, --rate-hz and --gains-run say the loop, a robot.yaml all of it"
        )


def _note_lags(record: Record, owner: str, notes: list[str]) -> None:
    """Adds a note about the set-point's delay."""
    for keys in LAGS:
        given = [key for key in keys if key in record.fields]
        if not given:
            continue
        low, high = (_number(f"{owner}: {key}", record.fields.get(key, 0), LAG) for key in keys)
        if low > high:
            raise GainroomError(f"{owner}: {keys[0]} {low:g} must be at most {keys[1]} {high:g}")
        if high:
            notes.append(
                f"{owner}: its lag of {low:g} to {high:g} physics steps delays the set-point, not the feedback, so it does not count: "
                "--delay-ms is the loop's"
            )
