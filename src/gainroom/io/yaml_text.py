"""Bounded reading of YAML: any file costs little time and memory, and an error is one line.

Scalars are read by YAML 1.2's core rules, not PyYAML's 1.1: 1e4 is a number, `on` is a word, 010 and 1:30 are no numbers. Anchors,
aliases, merge keys, duplicate keys and tags have no use in a configuration file of ours and are refused. In the files of others
(`of_others`) a value may be used again, within the same bounds, and what has a tag that is no plain value's is kept as Tagged: no object
is made of it.
"""

import itertools
import math
import re
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ..errors import GainroomError, Together, printable
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
"""Plain texts for PyYAML's messages about malformed text."""
LONGEST = 60
"""Maximum length of a value in a message [characters]."""


Problem = tuple[str, str]
"""Path of keys that lead to a wrong value, and the message about it."""


@dataclass(frozen=True)
class Wrong:
    """Placeholder of a wrong value, with its problems, paths relative to it; no problems if they are reported elsewhere."""

    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class Tagged:
    """Value with a tag of its own: its line, and the keys of mappings in it."""

    tag: str
    line: int
    keys: frozenset[str] = frozenset()

    def __repr__(self) -> str:
        return f"{self.tag} in line {self.line}"


def shown(value: object) -> str:
    """Value for a message: printable, on one line, not longer than LONGEST."""
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    text = ascii(value) if isinstance(value, str) and not value.isprintable() else _short(value, [LONGEST])
    text = "".join(c if c.isprintable() else " " for c in text)
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def _short(value: object, left: list[int]) -> str:
    """Representation of at most `left` values (a count that it reduces): a list that contains itself twice would be endless."""
    left[0] -= 1
    if left[0] < 0:
        return "…"
    if type(value) is dict:
        pairs = itertools.takewhile(lambda _: left[0] > 0, value.items())
        return f"{{{', '.join(f'{_short(key, left)}: {_short(each, left)}' for key, each in pairs)}}}"
    if type(value) in (list, tuple):
        text = ", ".join(_short(each, left) for each in itertools.takewhile(lambda _: left[0] > 0, value))  # type: ignore[call-overload]
        return f"[{text}]" if type(value) is list else f"({text}{',' if len(value) == 1 else ''})"  # type: ignore[arg-type]
    return repr(value)


def read_text(path: Path) -> str:
    """Text of a configuration file, within bounds. Raises GainroomError."""
    return bounded_text(path, MAX_BYTES, "a configuration file")


def parse_yaml(text: str, source: str, of_others: bool = False, together: Together | None = None) -> Any:
    """Plain dicts, lists and scalars of a YAML text; None if it is empty.

    source      named in messages
    of_others   whether values may be used again (&, *, <<) and have tags, as in files that programs write
    together    takes what does not keep the rest from being read: a key that is there twice, or is no word, and a number that is too
                large, which is Wrong; without it these are raised, too

    Raises GainroomError on anything malformed or out of bounds.
    """
    loader = None
    try:
        loader = (_OfOthers if of_others else _Loader)(text)  # reading the first characters may already fail
        data = loader.get_single_data()
        if loader.faults:
            error = GainroomError(*(f"{source}: {text}" for text in loader.faults))
            if together is None:
                raise error
            together.add(error)
        return data
    except GainroomError:
        raise
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
        self.faults: list[str] = []

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        self._check(event)
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

    def _check(self, event: Any) -> None:
        """Raises the error of a value that begins with this event."""
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise self._refusal("anchors and aliases (&, *) are not allowed here", event.start_mark)
        if getattr(event, "tag", None) is not None:
            raise self._refusal("tags (!) are not allowed here", event.start_mark)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Hashable, Any] = {}
        for key_node, value_node in node.value:
            key = self._key(key_node, value_node)
            if key in seen:
                self._note(f"key {shown(key)} is given twice", key_node.start_mark)
            elif key is not None:
                seen[key] = self.construct_object(value_node, deep=deep)
        return seen

    def _key(self, node: yaml.Node, value: yaml.Node) -> str | None:
        """Key of a node; None, with a recorded problem, if it is no word."""
        key = self.construct_object(node, deep=True) if isinstance(node, yaml.ScalarNode) else None
        if isinstance(key, str):
            return key
        comma = "; a decimal comma is written as a point" if isinstance(key, int) else ""
        self._note(f"a key must be a word{comma}", node.start_mark)
        return None

    def _note(self, problem: str, mark: yaml.Mark) -> None:
        self.faults.append(f"line {mark.line + 1}, column {mark.column + 1}: {printable(problem)}")

    def construct_number(self, node: yaml.ScalarNode) -> int | float | Wrong:
        text = self.construct_scalar(node)
        plain = text.lower().replace(".inf", "inf").replace(".nan", "nan")
        number = float(plain)
        if math.isinf(number) and "inf" not in plain:
            self._note(f"{shown(text)} is too large a number; infinity is written .inf", node.start_mark)
            return Wrong()
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


class _OfOthers(_Loader):
    """Loader with anchors, aliases and merge keys, each use of a value counted as if it were written there, and with tags."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._sizes: dict[str, tuple[int, int]] = {}
        """Number of values and depth of nesting of a finished value, by anchor."""
        self._deepest = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._sizes:
                raise self._refusal(f"*{event.anchor} is used before its value has ended", event.start_mark)
            count, depth = self._sizes[event.anchor]
            self._nodes += count
            self._deepest = max(self._deepest, self._depth + depth)
            if self._depth + depth > MAX_DEPTH:
                raise self._refusal(f"nested more than {MAX_DEPTH} deep", event.start_mark)
            return super().compose_node(parent, index)
        anchor = getattr(event, "anchor", None)
        tag, before, around = getattr(event, "tag", None), self._nodes, self._deepest
        self._deepest = self._depth + 1
        node = super().compose_node(parent, index)
        if anchor is not None:
            self._sizes[anchor] = (self._nodes - before, self._deepest - self._depth)
        self._deepest = max(self._deepest, around)
        if tag is not None and node is not None:
            node.tag = self._plain_tag(node, tag)
        return node

    def _check(self, event: Any) -> None:
        pass

    def _plain_tag(self, node: yaml.Node, tag: str) -> str:
        """Tag of a plain value with the same meaning, else the tag as it is written."""
        if isinstance(node, yaml.ScalarNode):
            plain = self.resolve(yaml.ScalarNode, node.value, (True, False))
            kind = tag.removeprefix(CORE)
            fits = tag == plain or kind in TEXT_TAGS or (kind in ("int", "float") and plain == f"{CORE}float")
            return (f"{CORE}str" if kind in TEXT_TAGS else plain) if fits else f"!{tag}"
        kinds = ("seq", "python/tuple", "python/list") if isinstance(node, yaml.SequenceNode) else ("map", "python/dict")
        return f"{CORE}{kinds[0]}" if tag.removeprefix(CORE) in kinds and tag.startswith(CORE) else f"!{tag}"

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        merged: dict[Hashable, Any] = {}
        own = []
        for key_node, value_node in node.value:
            if isinstance(key_node, yaml.ScalarNode) and key_node.value == "<<" and key_node.style is None:
                nodes = value_node.value if isinstance(value_node, yaml.SequenceNode) else [value_node]
                for each in nodes:
                    if not isinstance(each, yaml.MappingNode):
                        raise self._refusal("<< must be a mapping, or a list of them", each.start_mark)
                    merged = self.construct_object(each, deep=True) | merged
            else:
                own.append((key_node, value_node))
        plain = yaml.MappingNode(node.tag, own, node.start_mark, node.end_mark)
        return merged | super().construct_mapping(plain, deep)

    def _key(self, node: yaml.Node, value: yaml.Node) -> str | None:
        """Key of a node, including numbers, true and null as written, except where it may be the rest of a number with a decimal comma."""
        is_plain = isinstance(node, yaml.ScalarNode) and node.tag.startswith(CORE) and value.tag != f"{CORE}null"
        return node.value if is_plain else super()._key(node, value)

    def construct_tagged(self, node: yaml.Node) -> Tagged:
        keys: set[str] = set()
        waiting, seen = [node], set()
        while waiting:
            each = waiting.pop()
            if id(each) in seen:
                continue
            seen.add(id(each))
            if isinstance(each, yaml.MappingNode):
                keys |= {key.value for key, _ in each.value if isinstance(key, yaml.ScalarNode)}
                waiting += [part for pair in each.value for part in pair]
            elif isinstance(each, yaml.SequenceNode):
                waiting += each.value
        return Tagged(node.tag[1:].replace(CORE, "!!"), node.start_mark.line + 1, frozenset(keys))


CORE = "tag:yaml.org,2002:"
TEXT_TAGS = ("str", "python/str", "python/unicode")
_OfOthers.add_constructor(None, _OfOthers.construct_tagged)  # type: ignore[arg-type]
