"""Reading YAML with bounds: any file costs little time and memory, and an error is one line.

Scalars are read by YAML 1.2's core rules, not PyYAML's 1.1: 1e4 is a number, `on` is a word, 010 and 1:30 are no
numbers.
Anchors, aliases, merge keys, duplicate keys and tags have no use in a configuration file and are refused.
"""

import math
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from ..errors import GainroomError, printable
from .bounded_text import bounded_text

MAX_BYTES = 1 << 20
MAX_DEPTH = 20
MAX_NODES = 20_000
PLAIN = {
    "<stream end>": "the file ends within a bracket that is not closed",
    "unexpected end of stream": "the file ends within a quoted text",
    "expected ',' or": "a comma or a closing bracket is missing before this",
    "expected <block end>": "this does not fit what stands before it: look at its indentation, and for a missing bracket or comma",
    "expected '<document start>'": "this does not fit what stands before it: look at its indentation",
    "mapping values are not allowed": "a second ':' in one value: look for a line break, a space or quotes that are missing",
    "'\\t' that cannot start": "a tab: indent with spaces",
    "could not find expected ':'": "a ':' is missing behind the key before this",
}
"""What PyYAML says of malformed text, in plain words."""
LONGEST = 60
"""Characters of a value in a message."""


def shown(value: object) -> str:
    """`value` for a message: printable, on one line, not longer than LONGEST."""
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    text = ascii(value) if isinstance(value, str) and not value.isprintable() else repr(value)
    text = "".join(c if c.isprintable() else " " for c in text)
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def read_text(path: Path) -> str:
    """The text of a configuration file, within bounds. Raises GainroomError."""
    return bounded_text(path, MAX_BYTES, "a configuration file")


def parse_yaml(text: str, source: str) -> Any:
    """The plain dicts, lists and scalars of a YAML text; None where it holds nothing.

    `source` is named in messages. Raises GainroomError on anything malformed or out of bounds.
    """
    loader = None
    try:
        loader = _Loader(text)  # reading the first characters may already fail
        return loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = " ".join((error.problem or error.context or "malformed YAML").split())
        problem = next((plain for words, plain in PLAIN.items() if words in problem), problem)
        raise GainroomError(f"{source}: {where}{printable(problem)}") from error
    except yaml.reader.ReaderError as error:
        raise GainroomError(f"{source}: character {error.position + 1} is not allowed in YAML") from error
    except (ValueError, OverflowError) as error:
        raise GainroomError(f"{source}: an escape names a character that does not exist") from error
    finally:
        if loader is not None:
            loader.dispose()


class _Loader(yaml.SafeLoader):
    """SafeLoader with bounds, without references, with YAML 1.2's scalars."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own manner; filled below

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise self._refusal("anchors and aliases (&, *) are not allowed here", event.start_mark)
        if getattr(event, "tag", None) is not None:
            raise self._refusal("tags (!) are not allowed here", event.start_mark)
        self._nodes += 1
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise self._refusal(f"nested more than {MAX_DEPTH} deep", event.start_mark)
        if self._nodes > MAX_NODES:
            raise self._refusal(f"more than {MAX_NODES} values", event.start_mark)
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Hashable, Any] = {}
        for key_node, value_node in node.value:
            key = self.construct_object(key_node, deep=True) if isinstance(key_node, yaml.ScalarNode) else None
            if not isinstance(key, str):
                comma = "; a decimal comma is written as a point" if isinstance(key, int) else ""
                raise self._refusal(f"a key must be a word{comma}", key_node.start_mark)
            if key in seen:
                raise self._refusal(f"key {shown(key)} is given twice", key_node.start_mark)
            seen[key] = self.construct_object(value_node, deep=deep)
        return seen

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        text = self.construct_scalar(node)
        plain = text.lower().replace(".inf", "inf").replace(".nan", "nan")
        number = float(plain)
        if math.isinf(number) and "inf" not in plain:
            raise self._refusal(f"{shown(text)} is too large a number; infinity is written .inf", node.start_mark)
        return int(number) if re.fullmatch(r"[-+]?[0-9]{1,15}", text) else number

    @staticmethod
    def _refusal(problem: str, mark: yaml.Mark | None) -> yaml.MarkedYAMLError:
        return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


_SCALARS = (
    ("float", r"[-+]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?", list("-+.0123456789")),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", list("-+.")),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
)
for _name, _pattern, _first in _SCALARS:
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", re.compile(rf"^(?:{_pattern})$"), _first)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_number)
