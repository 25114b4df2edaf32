"""Gains as text in the forms that are whole files: plain YAML, ros2_control YAML, arrays, configurations of mjlab and Isaac Lab.

Numbers are written with ten digits: recommended gains lie at the edge of what is required.
"""

import json
import re
from collections.abc import Mapping, Sequence

from ...errors import GainroomError, printable
from .gain_record import Gain

WORDS = {"true", "false", "null", "yes", "no", "on", "off", "y", "n", "default"}
"""What some YAML reader, or ours, does not take for a name."""
CONTROLLER = "effort_joint_trajectory_controller"


def number_text(value: float) -> str:
    """A number with a decimal point, so that no reader takes it for an integer (parameters of ROS have types)."""
    text = f"{value:.10g}"
    mantissa, sign, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{sign}{exponent}"


def commented(header: Sequence[str]) -> str:
    """Lines of comment."""
    return "".join(f"# {line}\n" for line in header)


def quoted(name: str) -> str:
    """A name as a key of YAML."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name) and name.lower() not in WORDS else json.dumps(name)


def plain_text(gains: Mapping[str, Gain], header: Sequence[str], rate: float | None) -> str:
    """Joint → {kp, kd, …}."""
    lines = []
    for name, gain in gains.items():
        given = {key: value for key, value in vars(gain).items() if key in ("kp", "kd") or value}
        lines.append(f"  {quoted(name)}: {{{', '.join(f'{key}: {number_text(value)}' for key, value in given.items())}}}\n")
    return f"{commented(header)}gains:\n{''.join(lines)}"


def ros2_control_text(gains: Mapping[str, Gain], header: Sequence[str], rate: float | None) -> str:
    """A joint_trajectory_controller that commands effort."""
    manager = "controller_manager:\n  ros__parameters:\n" + (f"    update_rate: {round(rate)}\n" if rate else "")
    lines = [
        f"      {quoted(name)}: {{p: {number_text(gain.kp)}, i: {number_text(gain.ki)}, d: {number_text(gain.kd)}}}\n"
        for name, gain in gains.items()
    ]
    return (
        f"{commented(header)}{manager}    {CONTROLLER}: {{type: joint_trajectory_controller/JointTrajectoryController}}\n"
        f"{CONTROLLER}:\n  ros__parameters:\n    joints: [{', '.join(map(quoted, gains))}]\n    command_interfaces: [effort]\n"
        f"    state_interfaces: [position, velocity]\n    gains:\n{''.join(lines)}"
    )


def arrays_text(gains: Mapping[str, Gain], header: Sequence[str], rate: float | None) -> str:
    """kps and kds with joint_names."""
    columns = {
        "joint_names": map(quoted, gains),
        "kps": (number_text(gain.kp) for gain in gains.values()),
        "kds": (number_text(gain.kd) for gain in gains.values()),
    }
    return commented(header) + "".join(f"{key}: [{', '.join(values)}]\n" for key, values in columns.items())


def mjlab_text(gains: Mapping[str, Gain], header: Sequence[str], rate: float | None) -> str:
    """A tuple of BuiltinPositionActuatorCfg, joints with the same gains in one."""
    entries = [
        f"    BuiltinPositionActuatorCfg(\n        target_names_expr=({_patterns(names)},),\n{_fields(gain, 'effort_limit')}    ),\n"
        for gain, names in _alike(gains)
    ]
    return f"{commented(header)}from mjlab.actuator import BuiltinPositionActuatorCfg\n\nACTUATORS = (\n{''.join(entries)})\n"


def isaac_lab_text(gains: Mapping[str, Gain], header: Sequence[str], rate: float | None) -> str:
    """A dictionary of ImplicitActuatorCfg, joints with the same gains in one."""
    entries = []
    for number, (gain, names) in enumerate(_alike(gains)):
        joints = f"        joint_names_expr=[{_patterns(names)}],\n"
        entries.append(f'    "group_{number}": ImplicitActuatorCfg(\n{joints}{_fields(gain, "effort_limit_sim")}    ),\n')
    return f"{commented(header)}from isaaclab.actuators import ImplicitActuatorCfg\n\nACTUATORS = {{\n{''.join(entries)}}}\n"


def legged_gym_text(gains: Mapping[str, Gain], header: Sequence[str], rate: float | None) -> str:
    """A class with a class `control`; the shortest names first, as of the keys in a joint's name the last one counts there."""
    base, names = "LeggedRobotCfg", sorted(gains, key=len)
    columns = {"stiffness": {name: gains[name].kp for name in names}, "damping": {name: gains[name].kd for name in names}}
    fields = []
    for key, found in columns.items():
        entries = "".join(f"            {json.dumps(name)}: {number_text(value)},\n" for name, value in found.items())
        fields.append(f"        {key} = {{\n{entries}        }}\n")
    start = f"{commented(header)}from legged_gym.envs.base.legged_robot_config import {base}\n\n\nclass GainsCfg({base}):\n"
    return f"{start}    class control({base}.control):\n{''.join(fields)}"


def _alike(gains: Mapping[str, Gain]) -> list[tuple[Gain, list[str]]]:
    groups: dict[Gain, list[str]] = {}
    for name, gain in gains.items():
        groups.setdefault(gain, []).append(name)
    return list(groups.items())


def _patterns(names: Sequence[str]) -> str:
    """Names as patterns that match them alone."""
    return ", ".join(json.dumps(re.escape(name)) for name in names)


def _fields(gain: Gain, effort: str) -> str:
    given = {"stiffness": gain.kp, "damping": gain.kd, "armature": gain.motor_inertia, effort: gain.effort_limit}
    return "".join(f"        {key}={number_text(value)},\n" for key, value in given.items() if value is not None)


def copied_gains(gains: Mapping[str, Gain], form: str, margins: str, rate: float | None) -> str:
    """Of named joints, to be pasted: `yaml` (which `gainroom audit --gains` reads), `ros2_control` or `mjcf` (an `<actuator>` section).

    margins   what they keep, as a comment
    rate      of the controller [Hz]; None: continuous

    Raises GainroomError where the form cannot hold the gains.
    """
    header = [printable(f"gains from gainroom app: {margins}")[:300]]
    if form == "yaml":
        return plain_text(gains, header, rate)
    if form == "ros2_control":
        return ros2_control_text(gains, header, rate)
    if any(gain.ki for gain in gains.values()):
        raise GainroomError("mjcf: a position actuator holds no integral gain; ros2_control and yaml do")
    from xml.sax.saxutils import quoteattr  # loads urllib, http and ssl

    lines = [
        f"  <position joint={quoteattr(name)} kp={quoteattr(number_text(gain.kp))} kv={quoteattr(number_text(gain.kd))}/>\n"
        for name, gain in gains.items()
    ]
    return f"<!-- {' '.join(header).replace('--', '- -')} -->\n<actuator>\n{''.join(lines)}</actuator>\n"
