"""Python text of a class of legged_gym."""

import json
from collections.abc import Sequence

from .form import ExportedGains, ExportForm, commented, number_text


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


LEGGED_GYM = ExportForm("legged_gym", "legged_gym", "a class with control", ".py", legged_gym_text)
