"""Editing of values in the text of a YAML file: everything else, comments too, stays as it was written."""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import yaml

from ..errors import GainroomError
from ..io.yaml_text import parse_yaml

Keys = tuple[str | int, ...]
"""Keys from the top level to a value; for an entry of a list its index."""


def edited(text: str, source: str, values: Mapping[Keys, Any], as_text: Callable[[Any], str] | None = None) -> str:
    """Text with new `values`, formatted by `written` or `as_text`; missing keys are inserted.

    Raises GainroomError where `text` is no YAML, or where a section on the way is none.
    """
    parse_yaml(text, source)  # within bounds, without references: composing it once more is safe
    for path, value in values.items():
        text = _with(text, source, path, (as_text or written)(value))
    return text


def with_section(text: str, source: str, key: str, section: Mapping[str, Any]) -> str:
    """Text with another section under a key of the top level, in lines of its own where the one before had such. Raises as `edited`."""
    return edited(text, source, {(key,): section}, _as_block if _is_block(text, key) else plain)


def written(value: Any) -> str:
    """Value in YAML's flow style: numbers, lists of them, mappings of names to them, None as null; numbers are read back exactly."""
    if value is None:
        return "null"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{quoted(name)}: {written(each)}" for name, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(written, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value)
    number = float(value)
    if math.isinf(number):
        return ".inf" if number > 0 else "-.inf"
    return repr(number).removesuffix(".0") if abs(number) < 1e15 else repr(number)


def plain(value: Any) -> str:
    """Value in YAML's flow style, with words as they are."""
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{quoted(name)}: {plain(each)}" for name, each in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(plain, value)) + "]"
    return written(value)


def quoted(name: str | int) -> str:
    """Key in YAML, quoted where necessary."""
    name = str(name)
    return name if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) else "'" + name.replace("'", "''") + "'"


def _is_block(text: str, key: str) -> bool:
    """True if a section of the YAML `text` has its keys on lines of their own, two spaces in."""
    return re.search(rf"^{key}:[ \t]*(#.*)?\n  \w", text, re.MULTILINE) is not None


def _as_block(section: Mapping[str, Any]) -> str:
    """Section with a key per line, two spaces in but for the first."""
    return "\n  ".join(f"{key}: {plain(value)}" for key, value in section.items())


def _with(text: str, source: str, path: Keys, value: str) -> str:
    node = yaml.compose(text, yaml.SafeLoader)
    for depth, key in enumerate(path):
        if isinstance(key, int) and isinstance(node, yaml.SequenceNode):
            node = node.value[key]
            continue
        if not isinstance(node, yaml.MappingNode):
            raise GainroomError(f"{source}: {'.'.join(map(str, path[:depth])) or 'the file'}: must be a section, to take {key}")
        found = next((child for name, child in node.value if name.value == key), None)
        if found is None:
            rest = value
            for inner in reversed(path[depth + 1 :]):
                rest = f"{{{quoted(inner)}: {rest}}}"
            return _inserted(text, node, f"{quoted(key)}: {rest}")
        node = found
    assert node is not None
    start, end = node.start_mark.index, _end(node)
    gap = " " if start == end and text[start - 1 : start] == ":" else ""  # `key:` with nothing behind it
    return text[:start] + gap + value + text[end:]


def _end(node: yaml.Node) -> int:
    """Index of the end of a value in the text. A block's end mark lies behind the comments that follow it, so its last value decides."""
    if isinstance(node, yaml.ScalarNode) or getattr(node, "flow_style", False) or not node.value:
        return node.end_mark.index
    last = node.value[-1]
    return _end(last[1] if isinstance(last, tuple) else last)


def _inserted(text: str, section: yaml.MappingNode, entry: str) -> str:
    """A new entry at the end of a section, on a line of its own where the others have one."""
    if section.flow_style or not section.value:
        at = section.start_mark.index + 1
        return text[:at] + entry + (", " if section.value else "") + text[at:]
    first, end = section.value[0][0].start_mark, text.find("\n", _end(section))
    end = len(text) if end < 0 else end
    return f"{text[:end]}\n{' ' * first.column}{entry}{text[end:]}"
