"""Gains to use, as they are typed into the file that was read, and what they keep."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..analysis.margin_record import Margins
from ..design.robot_gains import GainSet, RobotGains
from ..system.requirements import Requirements
from .margin_columns import margin_value
from .number_format import own_gains

MOST_COLUMNS = 78
"""Of a line that a terminal shows whole."""


def typed(value: float) -> str:
    """A gain as it is typed: what is read back keeps what was recommended."""
    text = f"{value:.7g}"
    return text if "e" not in text else repr(float(text))


def joint_gains(controller: Any) -> list[str]:
    """Lines of `control` in a joint.yaml."""
    return [f"{name}: {typed(value)}" for name, value, _ in own_gains(controller)]


def robot_gains(found: GainSet, gains: RobotGains) -> list[str]:
    """Lines of `control` in a robot.yaml, by patterns where joints are alike; of task gains lines of `tasks`."""
    columns = {"kp": found.kp, "kd": found.kd} if found.ki is None else {"kp": found.kp, "kv": found.kd, "ki": found.ki}
    if gains.space == "joint":
        return [line for name, values in columns.items() for line in _mapping(name, gains.names, values)]
    return _of_tasks(gains.names, columns)


def _mapping(key: str, names: Sequence[str], values: Any) -> list[str]:
    """key: {name: value, …} in YAML, on lines of MOST_COLUMNS."""
    groups: dict[str, list[str]] = {}
    for name, value in zip(names, np.nan_to_num(values).tolist(), strict=True):
        groups.setdefault(typed(value), []).append(name)
    if len(groups) == 1:
        return [f"{key}: {next(iter(groups))}"]
    items = [f"{_quoted(pattern)}: {value}" for value, group in groups.items() for pattern in patterns(group, names)]
    return _wrapped(f"{key}: {{", items)


def patterns(group: Sequence[str], names: Iterable[str]) -> list[str]:
    """One pattern that matches these names alone, where they end alike from a separator on and no other does; else the names."""
    end = group[0]
    while not all(name.endswith(end) for name in group):
        end = end[1:]
    while end and end[0].isalnum():
        end = end[1:]
    matched = {name for name in names if name.endswith(end)}
    return [f".*{re.escape(end)}"] if len(group) > 1 and end and matched == set(group) else [re.escape(name) for name in group]


def _quoted(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) else "'" + name.replace("'", "''") + "'"


def _wrapped(start: str, items: Sequence[str]) -> list[str]:
    lines, pad = [start + items[0]], "  "
    for item in items[1:]:
        if len(lines[-1]) + len(item) + 4 > MOST_COLUMNS:
            lines[-1] += ","
            lines.append(pad + item)
        else:
            lines[-1] += f", {item}"
    lines[-1] += "}"
    return lines


def _of_tasks(names: Sequence[str], columns: Mapping[str, Any]) -> list[str]:
    """Of each task its lists; a direction that cannot move has 0."""
    owners: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        owners.setdefault(name.rsplit(" ", 1)[0], []).append(k)
    lines = []
    for owner, places in owners.items():
        lists = [f"{key}: [{', '.join(map(typed, np.nan_to_num(values[places]).tolist()))}]" for key, values in columns.items()]
        lines.append(f"{owner}: {', '.join(lists)}")
    return lines


def kept(margins: Margins, asked: Requirements) -> str:
    """The margins that are asked for, in a sentence: "gain margin 7.38 dB, phase margin 30°, Ms 2"."""
    if not margins.stable:
        return "are unstable"
    values = {one: (one.value(margins), one.met(needed, one.value(margins))) for one, needed in asked.asked_for}
    return ", ".join(f"{one.heading} {margin_value(asked, one.name, value, met, 3)}" for one, (value, met) in values.items())
