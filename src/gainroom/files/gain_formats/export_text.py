"""Text of whole files of gains: plain YAML, ros2_control YAML, arrays, configurations of mjlab and Isaac Lab.

Numbers are written in as many digits as it takes to read the same ones again: gains may lie at the edge of what is required.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import yaml

from ...errors import GainroomError, printable
from .gain_record import Gain, Origin

WORDS = {"true", "false", "null", "yes", "no", "on", "off", "y", "n", "default"}
"""Words that some YAML reader, or ours, does not read as a name."""
CONTROLLER = "effort_joint_trajectory_controller"


@dataclass(frozen=True)
class ExportedGains:
    """Content of a file to be written: gains by joint, their origin, and the joint angles that are not 0, by joint."""

    gains: Mapping[str, Gain]
    origin: Origin = field(default=Origin())
    posture: Mapping[str, float] = field(default_factory=dict)


def number_text(value: float) -> str:
    """Number with a decimal point, so that no reader takes it for an integer (parameters of ROS have types)."""
    if math.isinf(value):
        return ".inf"  # in YAML, of a rigid gearbox
    text = repr(float(value))
    mantissa, sign, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{sign}{exponent}"


def commented(header: Sequence[str]) -> str:
    """Lines of comment."""
    return "".join(f"# {line}\n" for line in header)


def quoted(name: str) -> str:
    """Name as a YAML key, quoted where necessary."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name) and name.lower() not in WORDS else json.dumps(name)


def _entries(values: Mapping[str, float]) -> str:
    """Names and numbers, as YAML and Python write them between braces."""
    return ", ".join(f"{quoted(name)}: {number_text(value)}" for name, value in values.items())


def plain_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Plain YAML: joint → {kp, kd, …}, with location, rate and posture of the gains."""
    said = {key: getattr(goal.origin, key) for key in ("sample_rate_hz", "gains_run", "drive_rate_hz", "drive_delay_ms", "joint_damping")}
    lines = [f"{key}: {value if isinstance(value, str) else number_text(value)}\n" for key, value in said.items() if value is not None]
    lines += [f"posture: {{{_entries(goal.posture)}}}\n"] * bool(goal.posture)
    if goal.origin.system:
        lines.append(
            f"system: {yaml.safe_dump(dict(goal.origin.system), default_flow_style=True, sort_keys=False, width=math.inf).strip()}\n"
        )
    lines.append("gains:\n")
    for name, gain in goal.gains.items():
        given = {key: value for key, value in vars(gain).items() if key in ("kp", "kd") or value}
        lines.append(f"  {quoted(name)}: {{{', '.join(f'{key}: {number_text(value)}' for key, value in given.items())}}}\n")
    return f"{commented(header)}{''.join(lines)}"


def ros2_terms(gain: Gain) -> dict[str, float]:
    """Terms p, i, d of a gain, and its effort limit as their clamp."""
    limit = gain.effort_limit
    return {"p": gain.kp, "i": gain.ki, "d": gain.kd} | ({} if limit is None else {"u_clamp_max": limit, "u_clamp_min": -limit})


def ros2_control_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML of a joint_trajectory_controller with effort commands; its update_rate is an integer."""
    rate = goal.origin.sample_rate_hz
    manager = "controller_manager:\n  ros__parameters:\n" + (f"    update_rate: {round(rate)}\n" if rate else "")
    lines = [f"      {quoted(name)}: {{{_entries(ros2_terms(gain))}}}\n" for name, gain in goal.gains.items()]
    return (
        f"{commented(header)}{manager}    {CONTROLLER}: {{type: joint_trajectory_controller/JointTrajectoryController}}\n"
        f"{CONTROLLER}:\n  ros__parameters:\n    joints: [{', '.join(map(quoted, goal.gains))}]\n    command_interfaces: [effort]\n"
        f"    state_interfaces: [position, velocity]\n    gains:\n{''.join(lines)}"
    )


def arrays_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML of the arrays kps and kds with joint_names."""
    columns = {
        "joint_names": map(quoted, goal.gains),
        "kps": (number_text(gain.kp) for gain in goal.gains.values()),
        "kds": (number_text(gain.kd) for gain in goal.gains.values()),
    }
    return commented(header) + "".join(f"{key}: [{', '.join(values)}]\n" for key, values in columns.items())


def mjlab_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Python text of a tuple of BuiltinPositionActuatorCfg, joints with equal gains together, and the posture."""
    entries = [
        f"    BuiltinPositionActuatorCfg(\n        target_names_expr=({_patterns(names)},),\n{_fields(gain, 'effort_limit')}    ),\n"
        for gain, names in _alike(goal.gains)
    ]
    entity, state = _initial_state("from mjlab.entity import EntityCfg\n", "EntityCfg", goal.posture)
    imports = f"from mjlab.actuator import BuiltinPositionActuatorCfg\n{entity}"
    return f"{commented(header)}{imports}\nACTUATORS = (\n{''.join(entries)})\n{state}"


def isaac_lab_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Python text of a dictionary of ImplicitActuatorCfg, joints with equal gains together, and the posture."""
    entries = []
    for number, (gain, names) in enumerate(_alike(goal.gains)):
        joints = f"        joint_names_expr=[{_patterns(names)}],\n"
        entries.append(f'    "group_{number}": ImplicitActuatorCfg(\n{joints}{_fields(gain, "effort_limit_sim")}    ),\n')
    asset, state = _initial_state("from isaaclab.assets import ArticulationCfg\n", "ArticulationCfg", goal.posture)
    imports = f"from isaaclab.actuators import ImplicitActuatorCfg\n{asset}"
    return f"{commented(header)}{imports}\nACTUATORS = {{\n{''.join(entries)}}}\n{state}"


def _initial_state(imported: str, owner: str, posture: Mapping[str, float]) -> tuple[str, str]:
    """Import line and statement of an initial state with a posture; both "" if there is none."""
    if not posture:
        return "", ""
    angles = "".join(f"    {json.dumps(re.escape(name))}: {number_text(angle)},\n" for name, angle in posture.items())
    return imported, f"\nINITIAL_STATE = {owner}.InitialStateCfg(joint_pos={{\n{angles}}})\n"


def legged_gym_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Python text of a class with a class `control`, and `init_state` with the posture of all joints.

    The shortest names first, as of the keys in a joint's name the last one counts there.
    """
    gains, posture = goal.gains, goal.posture
    base, names = "LeggedRobotCfg", sorted(gains, key=len)
    columns = {"stiffness": {name: gains[name].kp for name in names}, "damping": {name: gains[name].kd for name in names}}
    fields = []
    for key, found in columns.items():
        entries = "".join(f"            {json.dumps(name)}: {number_text(value)},\n" for name, value in found.items())
        fields.append(f"        {key} = {{\n{entries}        }}\n")
    start = f"{commented(header)}from legged_gym.envs.base.legged_robot_config import {base}\n\n\nclass GainsCfg({base}):\n"
    state = ""
    if posture:
        angles = {**dict.fromkeys(gains, 0.0), **posture}
        entries = "".join(f"            {json.dumps(name)}: {number_text(angle)},\n" for name, angle in angles.items())
        state = f"\n    class init_state({base}.init_state):\n        default_joint_angles = {{\n{entries}        }}\n"
    return f"{start}    class control({base}.control):\n{''.join(fields)}{state}"


def force_limits(effort: float) -> dict[str, str]:
    """Attributes of an MJCF's actuator that limit its force in both directions."""
    return {"forcerange": f"{number_text(-effort)} {number_text(effort)}", "forcelimited": "true"}


def _alike(gains: Mapping[str, Gain]) -> list[tuple[Gain, list[str]]]:
    groups: dict[Gain, list[str]] = {}
    for name, gain in gains.items():
        groups.setdefault(gain, []).append(name)
    return list(groups.items())


def _patterns(names: Sequence[str]) -> str:
    """Patterns that match these names and no others."""
    return ", ".join(json.dumps(re.escape(name)) for name in names)


def _fields(gain: Gain, effort: str) -> str:
    given = {"stiffness": gain.kp, "damping": gain.kd, "armature": gain.motor_inertia, effort: gain.effort_limit}
    return "".join(f"        {key}={number_text(value)},\n" for key, value in given.items() if value is not None)


def copied_gains(gains: Mapping[str, Gain], form: str, margins: str, rate: float | None) -> str:
    """Text of gains to be pasted: `yaml` (read by `gainroom audit --gains`), `ros2_control` or `mjcf` (an `<actuator>` section).

    margins   what they keep, as a comment
    rate      of the controller [Hz]; None: continuous

    Raises GainroomError where the form cannot hold the gains.
    """
    header = [printable(f"gains from gainroom app: {margins}")[:300]]
    goal = ExportedGains(gains, Origin(sample_rate_hz=rate))
    if form == "yaml":
        return plain_text(goal, header)
    if form == "ros2_control":
        return ros2_control_text(goal, header)
    if any(gain.ki for gain in gains.values()):
        raise GainroomError("mjcf: a position actuator holds no integral gain; ros2_control and yaml do")
    from xml.sax.saxutils import quoteattr  # loads urllib, http and ssl

    lines = []
    for name, gain in gains.items():
        attributes = {"joint": name, "kp": number_text(gain.kp), "kv": number_text(gain.kd)}
        if gain.effort_limit is not None:
            attributes |= force_limits(gain.effort_limit)
        lines.append(f"  <position {' '.join(f'{key}={quoteattr(value)}' for key, value in attributes.items())}/>\n")
    return f"<!-- {' '.join(header).replace('--', '- -')} -->\n<actuator>\n{''.join(lines)}</actuator>\n"
