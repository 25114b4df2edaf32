"""Gains to use as file lines, and their margins as text."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..analysis.margin_record import Margins
from ..files.edited_text import quoted
from ..system.requirements import Requirements
from .margin_columns import margin_value
from .number_format import own_gains, typed

MOST_COLUMNS = 78
"""Most characters of a line, which every terminal shows unbroken."""


def joint_gains(controller: Any) -> list[str]:
    """Lines of `control` in a joint.yaml."""
    return [f"{name}: {typed(value)}" for name, value, _ in own_gains(controller)]


def robot_gains(names: Sequence[str], own: Sequence[Any], space: str) -> list[str]:
    """Lines of `control` in a robot.yaml, with patterns where joints are alike; for task gains lines of `tasks`.

    own   the gains of each of `names`, joints or task directions, as a controller of its own
    """
    if space == "joint":
        keys = own[0].gain_names()
        return [line for key in keys for line in gain_lines(key, names, [float(getattr(one, key)) for one in own])]
    return _of_tasks(names, own)


def gain_file(names: Sequence[str], columns: Mapping[str, Any]) -> list[str]:
    """Lines of a gain file: joint or pattern → {kp, kd, …}, without NaN."""
    groups: dict[str, list[str]] = {}
    for name, *values in zip(names, *columns.values(), strict=True):
        text = ", ".join(f"{key}: {_exactly(value)}" for key, value in zip(columns, values, strict=True) if not math.isnan(value))
        groups.setdefault(f"{{{text}}}", []).append(name)
    return _in_order(groups, names)


def _exactly(value: float) -> str:
    """Gain as text, rounded if that reads back exactly, otherwise with all digits."""
    text = typed(value)
    return text if float(text) == value else repr(float(value))


def gain_lines(key: str, names: Sequence[str], values: Any) -> list[str]:
    """YAML lines key: {name: value, …} of at most MOST_COLUMNS."""
    groups: dict[str, list[str]] = {}
    for name, value in zip(names, np.nan_to_num(values).tolist(), strict=True):
        groups.setdefault(typed(value), []).append(name)
    if len(groups) == 1:
        return [f"{key}: {next(iter(groups))}"]
    return _wrapped(f"{key}: {{", _in_order(groups, names))


def posture_lines(angles: Mapping[str, float]) -> list[str]:
    """Lines posture: {joint: angle, …} of a gain file, with all digits."""
    return _wrapped("posture: {", [f"{quoted(name)}: {angle!r}" for name, angle in angles.items()])


def _in_order(groups: Mapping[str, list[str]], names: Sequence[str]) -> list[str]:
    """Lines pattern: text of each group of joints, in the order of the first of `names` that each matches."""
    items = [(pattern, text) for text, group in groups.items() for pattern in patterns(group, names)]
    first = {pattern: next(k for k, name in enumerate(names) if re.fullmatch(pattern, name)) for pattern, _ in items}
    return [f"{quoted(pattern)}: {text}" for pattern, text in sorted(items, key=lambda item: first[item[0]])]


def patterns(group: Sequence[str], names: Iterable[str]) -> list[str]:
    """Few patterns that together match exactly `group` among `names`, none twice; a name that shares no part stands for itself."""
    left, every, found = list(group), list(names), []
    if len(left) > 1 and set(left) == set(every):
        return [".*"]
    while left:
        chosen = max(_shared_parts(left[0]), key=lambda part: _covered(part, left, every))
        best = _covered(chosen, left, every)[0]
        found.append(chosen if best > 1 else re.escape(left[0]))
        left = [name for name in left if not re.fullmatch(found[-1], name)]
    return found


def _shared_parts(name: str) -> list[str]:
    """Patterns of consecutive words of `name`, with separators."""
    cuts = [0, *(found.start() for found in re.finditer(r"[^A-Za-z0-9]+", name)), len(name)]
    ends = [0, *(found.end() for found in re.finditer(r"[^A-Za-z0-9]+", name)), len(name)]
    places = [(a, b) for a in cuts[:-1] for b in ends[1:] if a < b]
    return [f"{'.*' * (a > 0)}{re.escape(name[a:b])}{'.*' * (b < len(name))}" for a, b in places]


def _covered(pattern: str, wanted: Sequence[str], every: Sequence[str]) -> tuple[int, int]:
    """Score of a pattern: number of `wanted` names it matches (0 if it matches others), then fewer open ends."""
    matched = [name for name in every if re.fullmatch(pattern, name)]
    return (len(matched) if set(matched) <= set(wanted) else 0), -pattern.count(".*")


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


def _of_tasks(names: Sequence[str], own: Sequence[Any]) -> list[str]:
    """Lines of `tasks` with the gain lists of each task."""
    owners: dict[str, list[Any]] = {}
    for name, one in zip(names, own, strict=True):
        owners.setdefault(name.rsplit(" ", 1)[0], []).append(one)
    lines = []
    for owner, each in owners.items():
        lists = [f"{key}: [{', '.join(typed(getattr(one, key)) for one in each)}]" for key in each[0].gain_names()]
        lines.append(f"{owner}: {{{', '.join(lists)}}}")
    return lines


def kept(margins: Margins, asked: Requirements) -> str:
    """Required margins of a stable loop, as text: "gain margin 7.38 dB, phase margin 30°, Ms 2"."""
    values = {one: (one.value(margins), one.met(needed, one.value(margins))) for one, needed in asked.asked_for}
    return ", ".join(f"{one.heading} {margin_value(asked, one.name, value, met, 3)}" for one, (value, met) in values.items())
