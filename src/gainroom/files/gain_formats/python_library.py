"""Known functions of Python, math, numpy and a few other libraries, and methods of text, lists and dictionaries.

Each does what Python's own does with values that are known, within bounds; what it is not sure of it does not answer (NotKnown).
"""

import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

from .python_objects import (
    LONGEST_TEXT,
    MOST_ITEMS,
    REST,
    Array,
    Named,
    Record,
    Unknown,
    Unordered,
    is_key,
    is_number,
    is_open,
    is_plain,
    spoil,
)


class NotKnown(Exception):  # noqa: N818 - no error, an answer that is not known
    """Raised if a function's result is not known; `because` is the unknown value that causes it."""

    def __init__(self, because: Unknown | None = None) -> None:
        super().__init__()
        self.because = because


MODULES = {"np": "numpy", "jnp": "numpy", "jax.numpy": "numpy"}
"""Aliases of a library with the same constants and functions."""
CONSTANTS = {"pi": math.pi, "e": math.e, "tau": math.tau, "inf": math.inf}
OF_MATH = ("math", "numpy", "torch")
FUNCTIONS: dict[str, Callable[..., Any]] = {
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
    "power": math.pow,
    "square": lambda x: x * x,
    "floor": math.floor,
    "ceil": math.ceil,
    "log": math.log,
    "abs": abs,
    "fabs": abs,
    "float64": float,
    "maximum": max,
    "minimum": min,
    "hypot": math.hypot,
    "atan2": math.atan2,
    "arctan2": math.atan2,
}
SEQUENCES = ("array", "asarray")


def _two_stage_planetary(rotor_inertia: Any, gear_ratio: Any) -> float:
    """Reflected inertia of a two-stage planetary gearbox, as in mjlab.

    Of the three rotors the first turns through both stages, the second through the last one.
    """
    first, second, third = rotor_inertia
    _, one, two = gear_ratio
    return first * (one * two) ** 2 + second * two**2 + third


def _to_linear(armature_rotary: float, velocity_limit_rotary: float, effort_limit_rotary: float, transmission_ratio: float) -> Named:
    """Linear armature, velocity limit and effort limit of a motor behind a crank or screw of so many metres per radian, as in mjlab."""
    values = (armature_rotary / transmission_ratio**2, velocity_limit_rotary * transmission_ratio, effort_limit_rotary / transmission_ratio)
    return Named(values, ("armature", "velocity_limit", "effort_limit"))


HELPERS: dict[str, Callable[..., Any]] = {
    "reflected_inertia": lambda rotor_inertia, gear_ratio: rotor_inertia * gear_ratio**2,
    "reflected_inertia_from_two_stage_planetary": _two_stage_planetary,
    "rpm_to_rad": lambda rpm: rpm * 2 * math.pi / 60,
    "reflect_rotary_to_linear": _to_linear,
}
"""Functions of mjlab that make constants."""
ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "Add": operator.add,
    "Sub": operator.sub,
    "Mult": operator.mul,
    "Div": operator.truediv,
    "FloorDiv": operator.floordiv,
    "Mod": operator.mod,
    "Pow": math.pow,
}
OF_BITS: dict[str, Callable[[Any, Any], Any]] = {
    "LShift": operator.lshift,
    "RShift": operator.rshift,
    "BitAnd": operator.and_,
    "BitOr": operator.or_,
    "BitXor": operator.xor,
}
MOST_BITS = 900
"""Maximum length of an integer [bits]: as many as a double's range."""
ORDER: dict[str, Callable[[Any, Any], bool]] = {"Lt": operator.lt, "LtE": operator.le, "Gt": operator.gt, "GtE": operator.ge}
TYPES: dict[str, type | tuple[type, ...]] = {
    "dict": dict,
    "list": list,
    "tuple": tuple,
    "str": str,
    "int": int,
    "float": float,
    "bool": bool,
    "Mapping": dict,
    "Sequence": (list, tuple, str),
    "Iterable": (list, tuple, str, dict),
}
FORMAT = re.compile(r"0?\d{0,2}(\.\d{1,2})?[dfegs]?")
"""Format specifications that are evaluated."""


def numbers(*values: Any) -> tuple[float, ...]:
    """Values that must all be numbers. Raises NotKnown."""
    for each in values:
        if not is_number(each) and not isinstance(each, bool):
            raise NotKnown(each if isinstance(each, Unknown) else None)
    return values


def computed(function: Callable[..., Any], *given: Any, **named: Any) -> Any:
    """Result of a function on numbers, or on lists of them: a number, or Named numbers. Raises NotKnown."""
    for value in (*given, *named.values()):
        numbers(*(value if isinstance(value, list | tuple) else [value]))
    try:
        found = function(*given, **named)
    except (ArithmeticError, ValueError, TypeError) as error:
        raise NotKnown from error
    return found if isinstance(found, Named) and numbers(*found) else numbers(found)[0]


def arithmetic(op: str, left: Any, right: Any) -> Any:
    """Result of a binary operator, as in Python. Raises NotKnown."""
    if isinstance(left, Array) or isinstance(right, Array):
        return _by_element(op, left, right)
    if isinstance(left, Unordered) or isinstance(right, Unordered):
        raise NotKnown
    if op == "Add" and type(left) is type(right) and isinstance(left, str | list | tuple):
        if len(left) + len(right) > (LONGEST_TEXT if isinstance(left, str) else MOST_ITEMS):
            raise NotKnown
        return left + right
    if op == "BitOr" and isinstance(left, dict) and isinstance(right, dict):
        if is_open(right):
            raise NotKnown(right[REST])
        return left | right
    if op == "Mod" and isinstance(left, str):
        return _percent(left, right)
    if op == "Mult" and isinstance(left, int) and isinstance(right, str | list | tuple):
        left, right = right, left
    if op == "Mult" and isinstance(left, str | list | tuple) and type(right) is int:
        if len(left) * right > (LONGEST_TEXT if isinstance(left, str) else MOST_ITEMS):
            raise NotKnown
        return left * right
    if op not in (ARITHMETIC if isinstance(left, float) or isinstance(right, float) else ARITHMETIC | OF_BITS):
        raise NotKnown(next((each for each in (left, right) if isinstance(each, Unknown)), None))
    if not (isinstance(left, int | float) and isinstance(right, int | float)):
        raise NotKnown(next((each for each in (left, right) if isinstance(each, Unknown)), None))
    try:
        if isinstance(left, int) and isinstance(right, int):
            return _whole(op, left, right)
        return ARITHMETIC[op](float(left), float(right))
    except (ArithmeticError, ValueError) as error:
        raise NotKnown from error


def _whole(op: str, left: int, right: int) -> float:
    """Result of an operator on two integers, exact and of a bounded size. Raises NotKnown."""
    size = max(left.bit_length(), 1) * (right if op == "Pow" else 1) + (
        right if op == "LShift" else right.bit_length() if op != "Pow" else 0
    )
    if size > MOST_BITS:
        raise NotKnown
    return left**right if op == "Pow" else (ARITHMETIC | OF_BITS)[op](left, right)


def _by_element(op: str, left: Any, right: Any) -> Array:
    count = len(left) if isinstance(left, Array) else len(right)
    columns = [list(each) if isinstance(each, list | tuple) else [each] * count for each in (left, right)]
    if any(len(column) != count for column in columns):
        raise NotKnown
    for column in columns:
        numbers(*column)
    return Array(arithmetic(op, one, other) for one, other in zip(*columns, strict=True))


def _percent(text: str, given: Any) -> str:
    """Text with %s and %d filled in."""
    values = given if isinstance(given, tuple) else (given,)
    pieces = re.split(r"%([sd])", text)
    if len(pieces) // 2 != len(values) or any("%" in piece for piece in pieces[::2]):
        raise NotKnown(next((each for each in values if isinstance(each, Unknown)), None))
    filled = [_written(each, pieces[2 * k + 1] == "d") for k, each in enumerate(values)]
    return bounded("".join(one + other for one, other in zip(pieces[::2], [*filled, ""], strict=True)))


def _written(value: Any, whole: bool = False) -> str:
    if not isinstance(value, int if whole else str | int | float):
        raise NotKnown(value if isinstance(value, Unknown) else None)
    return str(value)


def formatted(value: Any, form: str = "", conversion: int = -1) -> str:
    """Value of an f-string's field. Raises NotKnown."""
    if not isinstance(value, str | int | float) or not FORMAT.fullmatch(form):
        raise NotKnown(value if isinstance(value, Unknown) else None)
    try:
        return bounded(format(repr(value) if conversion == ord("r") else value, form))
    except ValueError as error:
        raise NotKnown from error


def bounded(text: str) -> str:
    """Text, if it is not too long. Raises NotKnown."""
    if len(text) > LONGEST_TEXT:
        raise NotKnown
    return text


def compared(op: str, left: Any, right: Any) -> bool:
    """Result of a comparison. Raises NotKnown."""
    if op in ("Is", "IsNot"):
        if isinstance(left, Unknown) or isinstance(right, Unknown):
            raise NotKnown(left if isinstance(left, Unknown) else right)
        if not any(each is None or isinstance(each, bool | Record) for each in (left, right)):
            raise NotKnown  # of numbers and text it depends on the interpreter
        return (left is right) == (op == "Is")
    if op in ("In", "NotIn"):
        if isinstance(right, str) and isinstance(left, str):
            return (left in right) == (op == "In")
        if not isinstance(right, dict | list | tuple) or is_open(right):
            raise NotKnown(right if isinstance(right, Unknown) else None)
        for key in right:
            if compared("Eq", left, key):
                return op == "In"
        return op == "NotIn"
    if not (is_plain(left) and is_plain(right)):
        raise NotKnown(next((each for each in (left, right) if isinstance(each, Unknown)), None))
    if any(isinstance(each, Unordered) and len(each) > 1 for each in (left, right)):
        raise NotKnown
    if op in ("Eq", "NotEq"):
        return (left == right) == (op == "Eq")
    try:
        return bool(ORDER[op](left, right))
    except TypeError as error:
        raise NotKnown from error


def is_a(value: Any, kind: Any) -> bool:
    """Result of isinstance(value, kind); a kind is given by its name, or as a class of the file. Raises NotKnown."""
    if isinstance(kind, tuple | list):
        return any(is_a(value, each) for each in kind)
    name = getattr(kind, "name", "") or (kind.path.rpartition(".")[2] if isinstance(kind, Unknown) else "")
    if isinstance(value, Record):
        if name in value.kinds:
            return True
        if name in TYPES or (isinstance(kind, Record) and value.owner is not None):
            return False
        raise NotKnown
    if not is_plain(value) and not isinstance(value, dict | list | tuple):
        raise NotKnown(value if isinstance(value, Unknown) else None)
    if name in TYPES:
        return isinstance(value, TYPES[name])
    if isinstance(kind, Record):
        return False
    raise NotKnown(kind if isinstance(kind, Unknown) else None)


def text_method(text: str, name: str, given: list[Any]) -> Any:
    """Result of a method of text. Raises NotKnown."""
    if name == "join" and len(given) == 1 and isinstance(given[0], list | tuple):
        words = [_text(each) for each in given[0]]
        return bounded(text.join(words) if sum(map(len, words)) + len(text) * len(words) <= LONGEST_TEXT else " " * (LONGEST_TEXT + 1))
    words = [_text(each) for each in given]
    if name in ("upper", "lower", "title", "capitalize", "strip", "lstrip", "rstrip", "removeprefix", "removesuffix") and len(words) <= 1:
        return getattr(text[:LONGEST_TEXT] if len(text) <= LONGEST_TEXT else bounded(text), name)(*words)
    if name in ("startswith", "endswith") and len(words) == 1:
        return getattr(text, name)(*words)
    if name in ("split", "rsplit") and len(words) <= 1 and len(text) <= LONGEST_TEXT and words != [""]:
        return getattr(text, name)(*words)
    if name == "replace" and len(words) == 2 and (len(text) + 1) * (len(words[1]) + 1) < LONGEST_TEXT**2:
        return bounded(text.replace(words[0], words[1]))
    raise NotKnown


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise NotKnown(value if isinstance(value, Unknown) else None)
    return value


def format_method(text: str, given: list[Any], named: Mapping[str, Any]) -> str:
    """Result of str.format with plain fields: {}, {0}, {name}. Raises NotKnown."""
    pieces = re.split(r"\{(\w*)\}", text)
    if any("{" in piece or "}" in piece for piece in pieces[::2]):
        raise NotKnown
    filled = []
    for number, place in enumerate(pieces[1::2]):
        index = number if not place else int(place) if place.isdigit() and len(place) < 4 else -1
        if index >= len(given) or (index < 0 and place not in named):
            raise NotKnown
        filled.append(_written(given[index] if index >= 0 else named[place]))
    return bounded("".join(one + other for one, other in zip(pieces[::2], [*filled, ""], strict=True)))


def list_method(items: list[Any], name: str, given: list[Any]) -> Any:
    """Result of a method of a list, some of whose items may be unknown. Raises NotKnown, and then the list is unchanged."""
    match name, given:
        case "append", [value]:
            items.append(value)
        case "extend", [list() | tuple() as more] if len(items) + len(more) <= MOST_ITEMS:
            items.extend(list(more))
        case "insert", [int() as place, value] if not is_open(items):
            items.insert(place, value)
        case "pop", [] | [int()] if not is_open(items):
            try:
                return items.pop(*given)
            except IndexError as error:
                raise NotKnown from error
        case "remove", [value] if not is_open(items):
            place = next((k for k, each in enumerate(items) if each is value or compared("Eq", each, value)), None)
            if place is None:
                raise NotKnown
            del items[place]
        case "clear", []:
            items.clear()
        case "reverse", [] if not is_open(items):
            items.reverse()
        case "copy", []:
            return type(items)(items)
        case "tolist", []:
            return list(items)
        case (("count" | "index"), [value]) if is_plain(items) and is_plain(value) and (name == "count" or value in items):
            return getattr(items, name)(value)
        case _:
            raise NotKnown
    return None


def dict_method(mapping: dict[Any, Any], name: str, given: list[Any], named: dict[str, Any]) -> Any:
    """Result of a method of a dictionary, some of whose values may be unknown. Raises NotKnown, and then it is unchanged."""
    match name, given:
        case "update", [] | [dict()]:
            more = (given[0] if given else {}) | named
            if is_open(more):
                spoil(mapping, more[REST])
            if len(mapping) + len(more) > MOST_ITEMS:
                raise NotKnown
            mapping.update(more)
        case "clear", []:
            mapping.clear()
        case "copy", []:
            return dict(mapping)
        case (("get" | "pop" | "setdefault"), [key, *rest]) if is_key(key) and len(rest) <= 1:
            if key not in mapping and (is_open(mapping) or (name == "pop" and not rest)):
                raise NotKnown(mapping.get(REST))
            return getattr(mapping, name)(key, *rest)
        case "popitem", [] if mapping and not is_open(mapping):
            return mapping.popitem()
        case _:
            raise NotKnown
    return None
