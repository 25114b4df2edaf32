"""Gains that somebody already has, from the file they are in: plain YAML or JSON, ros2_control YAML, or an MJCF's position actuators.

Known forms:

    plain           joint name or pattern → {kp, kd, ki, motor_inertia} or [kp, kd], at the top or under `gains`; later patterns win
    ros2_control    p, i, d under a joint's name: joint_trajectory_controller's and pid_controller's `gains`, gazebo's `pid_gains`,
                    effort_controllers' JointPositionController (`joint` and `pid`) and JointGroupPositionController (`pid` per joint)
    MJCF            <position> and <general> with affine bias, as MuJoCo compiles them (read by robot/formats)

Controllers that command position or velocity are left out: their gains are no N m/rad. Everything else is refused in one line.
"""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from ..errors import GainroomError, first_of_many, typo_of
from ..io.validation import NotNegative, Positive, Section, checked, dotted, number, refusal, validate
from ..io.yaml_text import parse_yaml, read_text, shown
from ..linear.arrays import Booleans, Floats
from ..robot.name_patterns import assign
from .file_types import kind_of, wrong_kind

TERMS = {"p": "kp", "i": "ki", "d": "kd"}
WRAPPERS = ("gains", "pid", "pid_gains", "ros__parameters")
"""Keys between a controller and its joints that name neither."""
HOLDERS = ("gains", "pid", "pid_gains")
"""Of them, those that hold gains and nothing else."""
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
"""What ros2_control has beside p, i and d, and what no margin depends on."""
LONGEST_SLIP = 3
XML = (".xml", ".mjcf", ".urdf")
UNKNOWN = (
    "holds no gains in a known form: joint or pattern → {kp, kd}, at the top or under gains; or a ros2_control file with p, i, d under "
    "each joint's name; or an MJCF with position actuators"
)
NOT_NEGATIVE = number(least=0)


@dataclass(frozen=True)
class Gain:
    """One joint's gains [N m/rad], [N m s/rad], [N m/(rad s)], and its reflected motor inertia [kg m²] where the file names one."""

    kp: float
    kd: float = 0.0
    ki: float = 0.0
    motor_inertia: float | None = None


@dataclass(frozen=True)
class GainFile:
    """Gains by joint name or pattern, in the file's order; `form` as in this module's title, `notes` say what was left out."""

    source: str
    form: str
    gains: Mapping[str, Gain]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class JointGains:
    """Gains of n joints, each (n,), units as Gain; 0 where a joint has none, motor_inertia NaN where the file names none."""

    kp: Floats
    kd: Floats
    ki: Floats
    motor_inertia: Floats
    notes: tuple[str, ...] = ()

    @property
    def given(self) -> Booleans:
        """(n,) True where a joint has gains."""
        return (self.kp > 0) | (self.kd > 0)


def read_gains(path: Path) -> GainFile:
    """The gains in a YAML, JSON or MJCF file.

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    if path.suffix.lower() in XML:
        return _mjcf(path)
    text = read_text(path)
    # JSON is YAML but for tabs, and has none inside its strings.
    return parse_gains(text.replace("\t", " ") if path.suffix.lower() == ".json" else text, str(path))


def parse_gains(text: str, source: str) -> GainFile:
    """As read_gains, for the text of a file that messages call `source`."""
    data = parse_yaml(text, source)
    if not isinstance(data, dict):
        raise GainroomError(f"{source}: {'is empty' if data is None else UNKNOWN}")
    if "drive" in data and (found := kind_of(data)) != "other":
        raise wrong_kind(source, "file of gains", found)
    section = data.get("gains", data)
    if isinstance(section, dict) and any(_is_plain(value) for value in section.values()):
        plain = validate(PlainFile, data, source)
        return GainFile(source, "plain", {name: Gain(**each.model_dump()) for name, each in plain.gains.items()})
    return _ros2_control(data, source)


def gains_of(file: GainFile, joint_names: Sequence[str]) -> JointGains:
    """The file's gains on a model's joints.

    Raises GainroomError for a joint that the model does not have, for a pattern that matches nothing, and where no joint has gains.
    """
    columns = {name: np.zeros(len(joint_names)) for name in ("kp", "kd", "ki")}
    inertia = np.full(len(joint_names), np.nan)
    for k, matches in enumerate(assign(file.gains, joint_names, f"{file.source}: gains")):
        if matches:
            for name, column in columns.items():
                column[k] = getattr(matches[-1], name)
            named = [match.motor_inertia for match in matches if match.motor_inertia is not None]
            inertia[k] = named[-1] if named else np.nan
    found = JointGains(**columns, motor_inertia=inertia, notes=file.notes)
    if not np.any(found.given):
        raise GainroomError(f"{file.source}: all gains are zero")
    return found


class GainSection(Section):
    """What a plain file says of a joint or pattern."""

    kp: NotNegative = Field(description="[N m/rad]")
    kd: NotNegative = Field(0.0, description="[N m s/rad]")
    ki: NotNegative = Field(0.0, description="[N m/(rad s)]")
    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")


def _pair(value: object) -> object:
    """[kp, kd] as a section."""
    if isinstance(value, list):
        if len(value) != 2:
            raise refusal(f"{shown(value)} must be [kp, kd], or a section with kp and kd")
        return dict(zip(("kp", "kd"), value, strict=True))
    return value


class PlainFile(Section):
    """Joint or pattern → gains."""

    gains: dict[str, Annotated[GainSection, BeforeValidator(_pair)]]

    @model_validator(mode="before")
    @classmethod
    def _at_the_top(cls, data: Any) -> Any:
        return data if not isinstance(data, dict) or "gains" in data else {"gains": data}


def _is_plain(value: object) -> bool:
    """Whether `value` looks like plain gains: a list of numbers, or a section with one of their keys."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(item, int | float) for item in value)
    return isinstance(value, dict) and ("kp" in value or "kd" in value)


def _ros2_control(data: dict[str, Any], source: str) -> GainFile:
    """p, i, d wherever they stand under a joint's name."""
    types = {name: each["type"] for _, node in _mappings(data) for name, each in node.items() if isinstance(each, dict) and "type" in each}
    gains: dict[str, Gain] = {}
    places: dict[str, str] = {}
    notes, empty = [], []
    for path, node in _mappings(data):
        place = dotted(*path) or "at the top"
        if all(isinstance(node.get(term, {}), dict) for term in TERMS):  # joints may be called p, i and d, too
            empty += [] if _no_torque(data, path, types) else _without_terms(path, node)
            continue
        joint = _joint(data, path)
        if joint is None:
            raise GainroomError(f"{source}: {place}: p, i, d stand under no joint's name")
        reason = _no_torque(data, path, types)
        if reason:
            notes.append(f"{place}: left out, as {reason}")
            continue
        if joint in gains:
            raise GainroomError(f"{source}: joint {shown(joint)} has gains twice, in {places[joint]} and in {place}; leave one in the file")
        gains[joint] = _pid(node, f"{source}: {place}")
        places[joint] = place
        unknown = [key for key in node if key not in (*TERMS, *BESIDE)]
        if unknown:
            notes.append(f"{place}: does not count, as it is not known here: {first_of_many([dotted(key) for key in unknown])}")
    if not gains:
        problem = "no controller here commands torque: " + notes[0] if notes else f"{UNKNOWN}{_begins(data)}"
        raise GainroomError(f"{source}: {problem}")
    if empty:
        raise GainroomError(f"{source}: {empty[0]}")
    return GainFile(source, "ros2_control", gains, tuple(notes))


def _mjcf(path: Path) -> GainFile:
    """Position and velocity feedback of an MJCF's actuators; the joints' own damping is passive and only noted."""
    from ..robot.formats.model_files import position_gains

    found = position_gains(path)
    if not found:
        raise GainroomError(
            f"{path}: holds no gains: no actuator feeds position back (<position> of an MJCF, or <general> with affine bias, does); give "
            "--gains FILE"
        )
    gains = {}
    for joint, (kp, kd) in found.items():
        owner = f"{path}: actuator of joint {shown(joint)}"
        gains[joint] = Gain(checked(f"{owner}: kp", kp, NOT_NEGATIVE), checked(f"{owner}: kd", kd, NOT_NEGATIVE))
    notes = []
    undamped = [joint for joint, gain in gains.items() if gain.kd == 0]
    if undamped:
        notes.append(
            f"actuators without velocity feedback: {first_of_many(undamped)}; damping of the joint itself, where the model has any, is not "
            "the controller's and is not counted: give kv"
        )
    return GainFile(str(path), "MJCF", gains, tuple(notes))


def _begins(data: dict[str, Any]) -> str:
    """What a file without known gains holds first: the end of a message."""
    path, value = (), data
    while isinstance(value, dict) and value:
        key, value = next(iter(value.items()))
        path = (*path, key)
    if not path:
        return ""
    close = difflib.get_close_matches(path[-1].lower(), GainSection.model_fields, 1, cutoff=0.5)
    hint = f", did you mean {close[0]}?" if close and path[-1] not in close else ""
    return f"; found {dotted(*path)}: {shown(value)}{hint}"


def _mappings(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Every mapping in a file's data with the keys that lead to it."""
    if isinstance(node, dict):
        yield path, node
        for key, value in node.items():
            yield from _mappings(value, (*path, key))


def _along(data: dict[str, Any], path: Sequence[str]) -> list[dict[str, Any]]:
    """The mappings from the top down to the one at `path`."""
    nodes = [data]
    for key in path:
        nodes.append(nodes[-1][key])
    return nodes


def _joint(data: dict[str, Any], path: Sequence[str]) -> str | None:
    """Whose gains stand at `path`: the nearest key that is no wrapper's, or the value of `joint` beside the wrapper."""
    nodes = _along(data, path)
    for depth in range(len(path) - 1, -1, -1):
        if path[depth] not in WRAPPERS:
            return path[depth]
        named = nodes[depth].get("joint")
        if isinstance(named, str):
            return named
    return None


def _no_torque(data: dict[str, Any], path: Sequence[str], types: Mapping[str, Any]) -> str:
    """Why a controller's gains are not N m/rad; empty where they are, or nothing says otherwise."""
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
    """What stands in the place of gains and has none of them."""
    found = []
    if path and any(key in HOLDERS for key in path) and not any(isinstance(value, dict) for value in node.values()):
        found.append(f"{dotted(*path)}: must hold p, i and d{_found(node)}")
    for key, value in node.items():
        inside = key in HOLDERS or path[-1:] in (("gains",), ("pid_gains",))
        if inside and (value is None or isinstance(value, str | int | float)):
            found.insert(0, f"{dotted(*path, key)}: {shown(value)} must be a section with p, i and d")
    return found


def _found(node: Mapping[str, Any]) -> str:
    """What a section holds in their place: the end of a message."""
    return f", and holds {first_of_many([dotted(key) for key in node])}" if node else ""


def _pid(node: Mapping[str, Any], owner: str) -> Gain:
    """p must be there: a controller takes 0 for it, which nobody means. A short key that is not known was meant to be one of the three."""
    for key in node:
        meant = typo_of(key, (*TERMS, *BESIDE))
        if key not in (*TERMS, *BESIDE) and (meant or len(key) <= LONGEST_SLIP):
            raise GainroomError(
                f"{owner}.{dotted(key)}: unknown key" + (f"; did you mean {meant}?" if meant else f" beside {', '.join(TERMS)}")
            )
    if "p" not in node:
        raise GainroomError(f"{owner}.p: is missing: [N m/rad]{_found(node)}; write 0 where there is none")
    return Gain(**{name: checked(f"{owner}.{term}", node.get(term, 0.0), NOT_NEGATIVE) for term, name in TERMS.items()})
