"""YAML of ros2_control: the text of a whole file, and p, i, d written into an existing one."""

import re
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

from ...errors import GainroomError, first_of_many
from ...io.yaml_text import parse_yaml
from ..edited_text import Keys, edited
from ..gain_formats.gain_record import Gain
from ..gain_formats.ros2_control import read_ros2_control
from .form import ExportedGains, ExportForm, commented, entries, number_text, quoted

CONTROLLER = "effort_joint_trajectory_controller"
HEADER = re.compile(r"\A(?:# gains by gainroom\b[^\n]*\n)(?:# {2}[^\n]*\n)*")


def ros2_terms(gain: Gain) -> dict[str, float]:
    """Terms p, i, d of a gain, and its effort limit as their clamp."""
    limit = gain.effort_limit
    return {"p": gain.kp, "i": gain.ki, "d": gain.kd} | ({} if limit is None else {"u_clamp_max": limit, "u_clamp_min": -limit})


def ros2_control_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML of a joint_trajectory_controller with effort commands; its update_rate is an integer."""
    rate = goal.origin.sample_rate_hz
    manager = "controller_manager:\n  ros__parameters:\n" + (f"    update_rate: {round(rate)}\n" if rate else "")
    lines = [f"      {quoted(name)}: {{{entries(ros2_terms(gain))}}}\n" for name, gain in goal.gains.items()]
    return (
        f"{commented(header)}{manager}    {CONTROLLER}: {{type: joint_trajectory_controller/JointTrajectoryController}}\n"
        f"{CONTROLLER}:\n  ros__parameters:\n    joints: [{', '.join(map(quoted, goal.gains))}]\n    command_interfaces: [effort]\n"
        f"    state_interfaces: [position, velocity]\n    gains:\n{''.join(lines)}"
    )


def ros2_control_onto(text: str, path: Path, goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML `text` of a file with p, i and d of these gains; the rest of it stays as it is.

    Raises GainroomError where a joint is not in it.
    """
    source, text = str(path), HEADER.sub("", text)
    data = parse_yaml(text, source)
    if not isinstance(data, dict):
        raise GainroomError(f"{source}: must be a ros2_control file with p, i and d under joints' names")
    paths = read_ros2_control(data, source, "holds no gains of ros2_control to replace").paths
    if missing := [joint for joint in goal.gains if joint not in paths]:
        raise GainroomError(f"{source}: has no p, i and d for {first_of_many(missing)}; add them, or export a new file (without --onto)")
    values: dict[Keys, float] = {}
    for joint, gain in goal.gains.items():
        there = reduce(lambda node, key: node[key], paths[joint], data)
        terms = ros2_terms(gain)
        values |= {(*paths[joint], term): value for term, value in terms.items() if value or term in there}
    return commented(header) + edited(text, source, values, number_text)


ROS2_CONTROL = ExportForm(
    "ros2_control", "ros2_control", "a joint_trajectory_controller", ".yaml", ros2_control_text, ros2_control_onto, integral=True
)
