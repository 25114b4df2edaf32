"""Python text of the actuator configurations of mjlab and Isaac Lab."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...errors import first_of_many
from ..gain_formats.gain_record import Gain
from .form import ExportedGains, ExportForm, commented, number_text


def mjlab_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Python text of a tuple of BuiltinPositionActuatorCfg, joints with equal gains together, and the posture."""
    entries = [
        f"    BuiltinPositionActuatorCfg(\n        target_names_expr=({patterns(names)},),\n{_fields(gain, 'effort_limit')}    ),\n"
        for gain, names in _alike(goal.gains)
    ]
    entity, state = _initial_state("from mjlab.entity import EntityCfg\n", "EntityCfg", goal.posture)
    imports = f"from mjlab.actuator import BuiltinPositionActuatorCfg\n{entity}"
    return f"{commented(header)}{imports}\nACTUATORS = (\n{''.join(entries)})\n{state}"


def isaac_lab_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Python text of a dictionary of ImplicitActuatorCfg, joints with equal gains together, and the posture."""
    entries = []
    for number, (gain, names) in enumerate(_alike(goal.gains)):
        joints = f"        joint_names_expr=[{patterns(names)}],\n"
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


def _alike(gains: Mapping[str, Gain]) -> list[tuple[Gain, list[str]]]:
    groups: dict[Gain, list[str]] = {}
    for name, gain in gains.items():
        groups.setdefault(gain, []).append(name)
    return list(groups.items())


def patterns(names: Sequence[str]) -> str:
    """Patterns that match these names and no others."""
    return ", ".join(json.dumps(re.escape(name)) for name in names)


def _fields(gain: Gain, effort: str) -> str:
    given = {"stiffness": gain.kp, "damping": gain.kd, "armature": gain.motor_inertia, effort: gain.effort_limit}
    return "".join(f"        {key}={number_text(value)},\n" for key, value in given.items() if value is not None)


def _unlimited(goal: ExportedGains, text: str, onto: Path | None) -> list[str]:
    """Note on joints without a limit of the torque."""
    names = [name for name, gain in goal.gains.items() if gain.effort_limit is None]
    note = f"no limit of the torque is known of {first_of_many(names)}: mjlab then limits it nowhere; give effort_limit" if names else ""
    return [note] if note else []


MJLAB = ExportForm("mjlab", "mjlab", "actuator configurations", ".py", mjlab_text, notes=_unlimited)
ISAAC_LAB = ExportForm("isaaclab", "Isaac Lab", "actuator configurations", ".py", isaac_lab_text)
