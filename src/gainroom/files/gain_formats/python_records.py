"""What the values of a Python file are made of: plain data, records for calls with keywords, and Unknown for all that is not understood."""

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ...io.yaml_text import shown


@dataclass
class Record:
    """A call with keywords, or a class with fields: the class's name, what it inherits from, its fields, and its line."""

    name: str
    line: int
    fields: dict[str, Any]
    kinds: tuple[str, ...] = ()
    is_class: bool = False


@dataclass(frozen=True)
class Unknown:
    """What is not understood, and where; `why` follows the text in messages."""

    line: int
    text: str
    why: str = "is not understood: numbers, arithmetic and names of this file are"
    kind: str = ""
    """import or function, of a name."""

    def __str__(self) -> str:
        return f"{shown(self.text)} {self.why}"


def parts(value: Any, closed: Callable[[Record], bool] = lambda record: False) -> Iterator[Any]:
    """A value and all that stands in it, in its order and each once; not what is in records that are `closed`."""
    seen, waiting = set(), [value]
    while waiting:
        each = waiting.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        yield each
        inner = each
        if isinstance(each, Record):
            inner = {} if closed(each) else each.fields
        waiting += reversed(list(inner.values() if isinstance(inner, dict) else inner if isinstance(inner, list | tuple) else ()))


def has_record(value: Any) -> bool:
    """Whether a configuration stands in a value."""
    return any(isinstance(each, Record) for each in parts(value))


def is_number(value: object) -> bool:
    """Whether a value is a number of usable size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def last_name(node: ast.expr) -> str:
    """The name that a dotted name ends with; empty for anything else."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def text_of(node: ast.AST) -> str:
    """The text of an expression."""
    try:
        return ast.unparse(node)
    except (RecursionError, ValueError):
        return "…"
