"""Gains into a ros2_control file that is there: the values of p, i and d change, and the rest of the text stays as it is."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from ...errors import GainroomError, first_of_many
from ...io.yaml_text import parse_yaml
from .export_text import commented, number_text
from .gain_record import Gain
from .ros2_control import TERMS, read_ros2_control

HEADER = re.compile(r"\A(?:# gains by gainroom\b[^\n]*\n)(?:# {2}[^\n]*\n)*")


def ros2_control_onto(text: str, source: str, gains: Mapping[str, Gain], header: Sequence[str]) -> str:
    """The YAML `text` of a file that messages call `source`, with these gains. Raises GainroomError where a joint is not in it."""
    text = HEADER.sub("", text)
    data = parse_yaml(text, source)  # within bounds, without references: composing it once more is safe
    if not isinstance(data, dict):
        raise GainroomError(f"{source}: must be a ros2_control file with p, i and d under joints' names")
    file = read_ros2_control(data, source, "holds no gains of ros2_control to replace")
    missing = [joint for joint in gains if joint not in file.paths]
    if missing:
        raise GainroomError(f"{source}: has no p, i and d for {first_of_many(missing)}; add them, or export a new file (without --onto)")
    root = yaml.compose(text, yaml.SafeLoader)
    edits: list[tuple[int, int, str]] = []
    for joint, gain in gains.items():
        node = root
        for key in file.paths[joint]:
            node = _child(node, key)
        edits += _replaced(node, {term: getattr(gain, name) for term, name in TERMS.items()}, text)
    for start, end, replacement in sorted(edits, reverse=True):
        text = text[:start] + replacement + text[end:]
    return commented(header) + text


def _child(node: Any, key: str) -> Any:
    return next(value for name, value in node.value if name.value == key)


def _replaced(node: Any, values: Mapping[str, float], text: str) -> list[tuple[int, int, str]]:
    """Edits of a section's p, i and d; one that is not there is put behind p, unless it is 0."""
    found = {key.value: value for key, value in node.value}
    edits = [
        (found[term].start_mark.index, found[term].end_mark.index, number_text(value)) for term, value in values.items() if term in found
    ]
    added = [f"{term}: {number_text(value)}" for term, value in values.items() if term not in found and value]
    if added:
        end = found["p"].end_mark.index
        if node.flow_style:
            edits.append((end, end, "".join(f", {each}" for each in added)))
        else:
            key = next(key for key, _ in node.value if key.value == "p")
            edits.append((end, end, "".join(f"\n{' ' * key.start_mark.column}{each}" for each in added)))
    # An insertion stands behind the value at the same place.
    return [(edits[0][0], edits[0][1], edits[0][2])] if len(edits) == 1 else _merged(edits)


def _merged(edits: list[tuple[int, int, str]]) -> list[tuple[int, int, str]]:
    """The same edits, with an insertion joined to the replacement that ends where it stands."""
    ends = {end: (start, new) for start, end, new in edits if start != end}
    result = {start: (start, end, new) for start, end, new in edits if start != end}
    for start, end, new in edits:
        if start == end:
            first, value = ends[start]
            result[first] = (first, end, value + new)
    return list(result.values())
