"""What an expression of a Python file is, as far as it is understood; nothing is run, and the work is bounded."""

import ast
import copy
import itertools
import math
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ...errors import GainroomError
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


MOST_STEPS = 50_000
"""Nodes that are evaluated of one file."""
MOST_DEPTH = 60
LONGEST_TEXT = 200
MOST_ITEMS = 2000

ARITHMETIC: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: math.pow,
}
MATH = ("math", "np", "numpy", "torch")
CONSTANTS = {"pi": math.pi, "e": math.e, "tau": math.tau, "inf": math.inf}
FUNCTIONS: dict[str, Callable[..., float]] = {
    "sqrt": math.sqrt,
    "radians": math.radians,
    "deg2rad": math.radians,
    "degrees": math.degrees,
    "rad2deg": math.degrees,
    "exp": math.exp,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "pow": math.pow,
    "square": lambda x: x * x,
}
BUILTINS: dict[str, Callable[..., Any]] = {"abs": abs, "min": min, "max": max, "float": float, "round": round, "pow": math.pow}


def _two_stage_planetary(rotor_inertia: Any, gear_ratio: Any) -> float:
    """As mjlab has it: three rotors, of which the first turns through both stages and the second through the last one."""
    first, second, third = rotor_inertia
    _, one, two = gear_ratio
    return first * (one * two) ** 2 + second * two**2 + third


HELPERS: dict[str, Callable[..., float]] = {
    "reflected_inertia": lambda rotor_inertia, gear_ratio: rotor_inertia * gear_ratio**2,
    "reflected_inertia_from_two_stage_planetary": _two_stage_planetary,
    "rpm_to_rad": lambda rpm: rpm * 2 * math.pi / 60,
}
"""Functions of mjlab's that make constants."""
SEQUENCES = ("tuple", "list", "array", "asarray", "tensor")
COPIES = ("copy", "deepcopy", "replace")
HARMLESS = (*COPIES, "get", "keys", "values", "items", "index", "count")
"""Methods that leave alone what they are called on."""


class Expressions:
    """Evaluates expressions with the `names` that are known so far; messages call the file `source`."""

    def __init__(self, source: str, names: dict[str, Any]) -> None:
        self.source = source
        self.names = names
        self.notes: list[str] = []
        self._steps = 0
        self._depth = 0

    def value(self, node: ast.expr) -> Any:
        self.count(node)
        self._depth += 1
        try:
            return Unknown(node.lineno, "…", "is nested too deeply") if self._depth > MOST_DEPTH else self._evaluated(node)
        finally:
            self._depth -= 1

    def _evaluated(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=value):
                return value if isinstance(value, str | int | float | bool | None) else self.unknown(node)
            case ast.Name(id=name):
                return self.names[name] if name in self.names else Unknown(node.lineno, name, "is no name of this file")
            case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts):
                items = list(itertools.islice(self._items(parts), MOST_ITEMS + 1))
                if len(items) > MOST_ITEMS:
                    return self.unknown(node)
                return tuple(items) if isinstance(node, ast.Tuple) else items
            case ast.Dict(keys=keys, values=values):
                return self._dict(node, keys, values)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
                found = self.value(operand)
                return (-found if isinstance(op, ast.USub) else found) if is_number(found) else self.unknown(node, found)
            case ast.BinOp(left=left, op=op, right=right):
                return self.arithmetic(node, op, self.value(left), self.value(right))
            case ast.Attribute():
                return self._attribute(node)
            case ast.Subscript(value=owner, slice=index):
                return self._entry(node, self.value(owner), self.value(index))
            case ast.JoinedStr(values=parts):
                return self._text(node, parts)
            case ast.Call():
                return self._call(node)
        return self.unknown(node)

    def _items(self, parts: list[ast.expr]) -> Iterator[Any]:
        for part in parts:
            if isinstance(part, ast.Starred):
                found = self.value(part.value)
                yield from found if isinstance(found, list | tuple) else [self.unknown(part, found)]
            else:
                yield self.value(part)

    def _dict(self, node: ast.Dict, keys: list[ast.expr | None], values: list[ast.expr]) -> Any:
        result: dict[Any, Any] = {}
        for key, value in zip(keys, values, strict=True):
            found = self.value(value)
            if key is None:
                if not isinstance(found, dict):
                    return self.unknown(node, found)
                result |= found
                continue
            name = self.value(key)
            if not isinstance(name, str | int | float):
                return self.unknown(node, name)
            result[name] = found
        return result

    def arithmetic(self, node: ast.AST, op: ast.operator, left: Any, right: Any) -> Any:
        if isinstance(op, ast.Add) and type(left) is type(right) and isinstance(left, str | list | tuple):
            whole = left + right
            return whole if len(whole) <= (LONGEST_TEXT if isinstance(whole, str) else MOST_ITEMS) else self.unknown(node)
        if isinstance(op, ast.BitOr) and isinstance(left, dict) and isinstance(right, dict):
            return left | right
        if not (isinstance(left, int | float) and isinstance(right, int | float) and type(op) in ARITHMETIC):
            return self.unknown(node, left if isinstance(left, Unknown) else right)
        try:
            found = ARITHMETIC[type(op)](float(left), float(right))
        except (ArithmeticError, ValueError):
            return self.unknown(node)
        whole = isinstance(left, int) and isinstance(right, int) and not isinstance(op, ast.Div) and abs(found) < 2**53
        return int(found) if whole and found == int(found) else found

    def _attribute(self, node: ast.Attribute) -> Any:
        if isinstance(node.value, ast.Name) and node.value.id in MATH and node.attr in CONSTANTS:
            return CONSTANTS[node.attr]
        owner = self.value(node.value)
        if isinstance(owner, Record) and node.attr in owner.fields:
            return owner.fields[node.attr]
        return self.unknown(node, owner)

    def _entry(self, node: ast.expr, owner: Any, key: Any) -> Any:
        try:
            return owner[key] if isinstance(owner, dict | list | tuple) else self.unknown(node, owner)
        except (LookupError, TypeError):
            return self.unknown(node, key)

    def _text(self, node: ast.expr, parts: list[ast.expr]) -> Any:
        text = ""
        for part in parts:
            plain = isinstance(part, ast.FormattedValue) and part.format_spec is None and part.conversion == -1
            found = self.value(part.value) if plain else self.value(part) if isinstance(part, ast.Constant) else None  # type: ignore[union-attr]
            if not isinstance(found, str | int) or len(text) > LONGEST_TEXT:
                return self.unknown(node, found)
            text += str(found)
        return text

    def _call(self, node: ast.Call) -> Any:
        name = last_name(node.func)
        given = [self.value(arg) for arg in node.args]
        named: dict[str, Any] = {}
        for keyword in node.keywords:
            value = self.value(keyword.value)
            if keyword.arg is not None:
                named[keyword.arg] = value
            elif isinstance(value, dict):
                named |= {str(key): each for key, each in value.items()}
            else:
                return self.unknown(node, value)
        if isinstance(node.func, ast.Attribute) and name in COPIES and not given:  # cfg.copy(), cfg.replace(…)
            return self._copied(node, self.value(node.func.value), named)
        if name in COPIES and given:  # copy.deepcopy(cfg), dataclasses.replace(cfg, …)
            return self._copied(node, given[0], named)
        if name in SEQUENCES and len(given) == 1 and isinstance(given[0], list | tuple):
            return tuple(given[0]) if name == "tuple" else list(given[0])
        if name == "dict" and not given:
            return named
        function = self._function(node.func, name)
        if function is not None:
            return self._computed(node, function, given, named)
        known = self.value(node.func) if isinstance(node.func, ast.Name | ast.Attribute) else None
        if isinstance(known, Unknown) and known.kind == "function":
            self._note_passed(node, name, (*given, *named.values()))
            return Unknown(node.lineno, text_of(node), known.why)
        self.leaves_alone(node)
        if given or not name:
            self._note_passed(node, name, (*given, *named.values()))
            return self.unknown(node)
        inherited = known if isinstance(known, Record) else Record(name, node.lineno, {}, (name,))
        return Record(name, node.lineno, self.deep_copy(node, inherited.fields) | named, inherited.kinds)

    def _note_passed(self, node: ast.Call, name: str, values: tuple[Any, ...]) -> None:
        """A note where a configuration goes into a function that is not run: it may be another afterwards."""
        if name != "print" and any(map(has_record, values)):
            what = f"{name or 'a call'}(…) gets a configuration"
            self.notes.append(f"{self.source}: line {node.lineno}: {what}: it is not run, and may change it")

    def _function(self, node: ast.expr, name: str) -> Callable[..., float] | None:
        """One of those that are known by name, unless the file gives the name another meaning."""
        if isinstance(node, ast.Attribute):
            of_math = isinstance(node.value, ast.Name) and node.value.id in MATH
            return FUNCTIONS.get(name) if of_math else HELPERS.get(name)
        meant = self.names.get(name)
        if meant is None:
            return (BUILTINS | HELPERS | FUNCTIONS).get(name)
        return (HELPERS | FUNCTIONS).get(name) if isinstance(meant, Unknown) and meant.kind == "import" else None

    def _computed(self, node: ast.Call, function: Callable[..., float], given: list[Any], named: dict[str, Any]) -> Any:
        for value in (*given, *named.values()):
            flat = value if isinstance(value, list | tuple) else [value]
            if not all(map(is_number, flat)):
                return self.unknown(node, next((each for each in flat if isinstance(each, Unknown)), None))
        try:
            found = function(*given, **named)
        except (ArithmeticError, ValueError, TypeError):
            return self.unknown(node)
        return found if is_number(found) else self.unknown(node)

    def _copied(self, node: ast.Call, value: Any, changes: dict[str, Any]) -> Any:
        if isinstance(value, Record):
            result = self.deep_copy(node, value)
            result.fields |= changes
            return result
        return self.deep_copy(node, value) if isinstance(value, dict | list | tuple) and not changes else self.unknown(node, value)

    def deep_copy(self, node: ast.AST, value: Any) -> Any:
        """A copy, which costs as many steps as it has parts: configurations that hold each other twice double with every copy."""
        for _ in parts(value):
            self.count(node)
        return copy.deepcopy(value)

    def unknown(self, node: ast.AST, inner: Any = None) -> Unknown:
        """Unknown; of what is inside it, if that was unknown."""
        return inner if isinstance(inner, Unknown) else Unknown(getattr(node, "lineno", 0), text_of(node))

    def count(self, node: ast.AST) -> None:
        self._steps += 1
        if self._steps > MOST_STEPS:
            raise self.refusal(node, f"more than {MOST_STEPS} expressions")

    def refusal(self, node: ast.AST, problem: str) -> GainroomError:
        return GainroomError(f"{self.source}: line {getattr(node, 'lineno', 0)}: {problem}")

    def leaves_alone(self, node: ast.Call) -> None:
        """Raise GainroomError where a method that may change a configuration is called on one."""
        if isinstance(node.func, ast.Attribute) and node.func.attr not in HARMLESS and has_record(self.value(node.func.value)):
            raise self.refusal(node, f"calls {node.func.attr} on a configuration, which is not followed")
