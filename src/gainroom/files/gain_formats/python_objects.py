"""Objects of a Python file that is read as text: configurations, functions of the file, and unknown values.

Numbers, text, lists, tuples and dictionaries stand for themselves, so that what is one object in Python is one here.
"""

import ast
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from ...io.yaml_text import shown

MOST_ITEMS = 2000
"""Maximum number of items of one collection, and of one range."""
LONGEST_TEXT = 400
"""Maximum length of composed text [characters]."""
DEEPEST = 60
"""Maximum depth of nested collections."""


class _Rest:
    """Key for the unknown remaining entries of a dictionary, or fields of a configuration."""

    def __repr__(self) -> str:
        return "…"


REST: Final = _Rest()


@dataclass(eq=False, repr=False)
class Record:
    """Configuration: a call with keywords, or a class with fields.

    name      of the class; line, source: where it stands
    kinds     the class and what it inherits from, by name
    is_class  or else an object of one
    owner     the class in this file that an object is of, and `bases` those that a class inherits from
    order     of the fields that a dataclass takes by place
    is_copied whether an object takes copies of what it is made with, as Isaac Lab's configclass does
    """

    name: str
    line: int
    fields: dict[Any, Any]
    kinds: tuple[str, ...] = ()
    is_class: bool = False
    source: str = ""
    owner: "Record | None" = None
    bases: tuple["Record", ...] = ()
    order: tuple[str, ...] = ()
    is_copied: bool = False
    ancestors: tuple["Record", ...] = ()
    own_order: tuple[str, ...] = ()
    private: frozenset[str] = frozenset()
    """Names of a class that begin with two underscores, which belong to this class alone."""
    is_enumeration: bool = False
    made: "list[Record]" = field(default_factory=list)
    """Instances of a class whose names are not fields; they see later changes of the class."""
    foreign: tuple[str, ...] = ()
    """Dotted names of the base classes that are defined in files that are not read."""
    is_plain: bool = False
    """True for a class without a decorator or base that turns its names into fields."""

    def __repr__(self) -> str:
        return f"{self.name}(…)"

    def method(self, name: str) -> Any:
        """Attribute `name` of the object's class in this file; None if it has no such class."""
        return self.owner.inherited(name) if self.owner is not None else None

    def inherited(self, name: str) -> Any:
        """Attribute `name` of the class, from the first class of its lineage that defines it; None if none does."""
        return next((each.fields[name] for each in self.lineage if name in each.fields), None)

    @property
    def lineage(self) -> "tuple[Record, ...]":
        """Class and its base classes, in the order in which Python looks up a name."""
        return (self, *self.ancestors)


@dataclass(frozen=True)
class Unknown:
    """Value that is not understood, with its place. It is an error only if the value is needed.

    why      follows the text in messages
    kind     "import": what comes from another file, of which `path` is the dotted name; "many": any number of items of a list
    is_free  whether no object of this file can be a part of it, so that what is done to it changes none
    source   the file, where it is not the one that is read
    """

    line: int
    text: str
    why: str = "is not understood"
    kind: str = ""
    path: str = ""
    is_free: bool = True
    source: str = ""

    def __str__(self) -> str:
        return f"{f'{self.source}: line {self.line}: ' if self.source else ''}{shown(self.text)} {self.why}"

    def held(self) -> "Unknown":
        """Copy of this value that may contain objects of this file."""
        return replace(self, is_free=False, kind="")

    def many(self) -> "Unknown":
        """Unknown number of items in the place of this value."""
        return replace(self, kind="many")


@dataclass
class Scope:
    """Names of a module, a class or a function, and the enclosing scope; `module`: scope of the file."""

    names: dict[str, Any]
    parent: "Scope | None" = None
    outside: dict[str, "Scope"] = field(default_factory=dict)
    """Scopes of names declared global or nonlocal."""
    is_class: bool = False
    is_comprehension: bool = False
    unstable: "dict[str, Unknown]" = field(default_factory=dict)
    """Names whose values may change at any time, with the cause."""

    def find(self, name: str) -> Any:
        """Value of a name; None if no scope has it."""
        if name in self.outside:
            return self.outside[name].find(name)
        if name in self.names:
            return _Found(self.names[name])
        around = self.parent
        while around is not None and around.is_class:  # a function does not see the names of the class around it
            around = around.parent
        return around.find(name) if around is not None else None

    def store(self, name: str, value: Any) -> None:
        scope = self.outside.get(name, self)
        if name in scope.unstable:
            spoil(value, scope.unstable[name])
            value = value if isinstance(value, dict | list | Record) else scope.unstable[name]
        scope.names[name] = value

    @property
    def module(self) -> "Scope":
        return self if self.parent is None else self.parent.module


@dataclass(frozen=True)
class _Found:
    value: Any


@dataclass(eq=False, repr=False)
class Function:
    """Function of the file, or a lambda, with its defaults; `this`: the object that it is bound to; `owner`: the class that defines it."""

    name: str
    node: ast.FunctionDef | ast.Lambda
    scope: Scope
    defaults: dict[str, Any]
    source: str = ""
    kind: str = ""
    """Decorator: staticmethod, classmethod or property."""
    this: Any = None
    owner: Record | None = None


@dataclass(frozen=True)
class Builtin:
    """Builtin function by its name, or a library's function by its dotted name."""

    name: str


@dataclass(eq=False, repr=False)
class Method:
    """Method of text, a list, a dictionary or a configuration."""

    this: Any
    name: str

    def __repr__(self) -> str:
        return f"method {self.name}"


@dataclass(eq=False, repr=False)
class Partial:
    """Result of functools.partial."""

    function: Any
    given: tuple[Any, ...]
    named: dict[str, Any]


@dataclass(eq=False)
class View:
    """View of a dictionary's keys, values or items as they are when asked for."""

    mapping: dict[Any, Any]
    what: str

    def items(self) -> list[Any]:
        return list({"keys": self.mapping.keys, "values": self.mapping.values, "items": self.mapping.items}[self.what]())


@dataclass(eq=False)
class Once:
    """Generator, or zip, map, …: its items can be taken once."""

    left: list[Any]

    def items(self) -> list[Any]:
        taken, self.left = self.left, []
        return taken


class Array(list):  # type: ignore[type-arg]
    """One-dimensional numpy array, with arithmetic by element; `family`: arrays that share its memory."""

    def __init__(self, items: Iterable[Any] = (), family: "list[Array] | None" = None) -> None:
        super().__init__(items)
        self.family = [] if family is None else family
        self.family.append(self)


class Unordered(list):  # type: ignore[type-arg]
    """Set, whose order of iteration is not known."""


@dataclass(frozen=True, eq=False)
class Member:
    """Member of an enumeration, equal to itself alone unless it `is_mixed` with text or numbers."""

    name: str
    value: Any
    is_mixed: bool = False


class Named(tuple):  # type: ignore[type-arg]
    """Instance of a library's NamedTuple: values with their names."""

    names: tuple[str, ...]

    def __new__(cls, values: tuple[Any, ...], names: tuple[str, ...]) -> "Named":
        made = super().__new__(cls, values)
        made.names = names
        return made


def fields_of(record: Record) -> dict[Any, Any]:
    """Fields of an object; of a class its own fields over those of its bases in their order."""
    result: dict[Any, Any] = {}
    for each in reversed(record.lineage):
        result |= each.fields
    return result


def linear(bases: Sequence[Record]) -> tuple[Record, ...] | None:
    """Lineage of a class with these bases (C3 linearization, as in Python); None if there is none."""
    waiting = [list(base.lineage) for base in bases] + [list(bases)]
    result: list[Record] = []
    while waiting := [each for each in waiting if each]:
        tails = {id(record) for each in waiting for record in each[1:]}
        first = next((each[0] for each in waiting if id(each[0]) not in tails), None)
        if first is None or len(result) > DEEPEST:
            return None
        result.append(first)
        waiting = [each[1:] if each[0] is first else each for each in waiting]
    return tuple(result)


def contents(value: Any) -> list[Any]:
    """Values directly inside a value, one level down."""
    if isinstance(value, Record):
        return list(value.fields.values())
    if isinstance(value, View):
        return list(value.mapping.values())
    if isinstance(value, Once):
        return list(value.left)
    if isinstance(value, Function):
        return [value.this, *value.defaults.values()]
    if isinstance(value, Method):
        return [value.this]
    if isinstance(value, Partial):
        return [value.function, *value.given, *value.named.values()]
    if isinstance(value, dict):
        return list(value.values())
    return list(value) if isinstance(value, list | tuple) else []


def parts(value: Any, closed: Callable[[Record], bool] = lambda record: False) -> Iterator[Any]:
    """Value and all values inside it, depth first and each once, without the contents of records that are `closed`."""
    seen, waiting, stored_once = set(), [value], []
    while waiting:
        each = waiting.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        stored_once.append(each)  # an id is taken again once its object is gone
        yield each
        if not (isinstance(each, Record) and closed(each)):
            waiting += reversed(contents(each))


def has_record(value: Any) -> bool:
    """True if a value may contain a configuration."""
    return any(isinstance(each, Record) or (isinstance(each, Unknown) and not each.is_free) for each in parts(value))


def spoil(value: Any, unknown: Unknown) -> None:
    """Makes all contents of a value unknown, as something that is not followed may have changed it."""
    spoilt = unknown.held()
    for each in list(parts(value)):
        held = each.fields if isinstance(each, Record) else each.mapping if isinstance(each, View) else each
        if isinstance(held, dict):
            held |= dict.fromkeys((*held, REST), spoilt)
        elif isinstance(held, list):
            for one in held.family if isinstance(held, Array) else [held]:
                one[:] = [spoilt.many()]
        elif isinstance(held, Once):
            held.left[:] = [spoilt.many()]


class Alike:
    """Numbering of values in which equal values have equal numbers; each part of a value is visited once."""

    def __init__(self) -> None:
        self._numbers: dict[Any, int] = {}
        self._seen: dict[int, tuple[Any, int]] = {}
        """Object and number by id; the entry keeps the object alive, so that its id stays unique."""

    def number(self, value: Any, depth: int = 0) -> int:
        if id(value) in self._seen:
            return self._seen[id(value)][1]
        own = len(self._numbers)
        key: Any = (object(),)  # one that is alike to nothing else
        if isinstance(value, dict | list | tuple | Record) and depth < DEEPEST:
            self._seen[id(value)] = (value, self._numbers.setdefault(key, own))
            pairs = value.items() if isinstance(value, dict) else value.fields.items() if isinstance(value, Record) else enumerate(value)
            inner = tuple((repr(name)[:200], self.number(each, depth + 1)) for name, each in pairs)
            key = (type(value).__name__, getattr(value, "line", 0), getattr(value, "source", ""), inner)
        elif value is None or isinstance(value, str | int | float | bool | Unknown):
            key = (type(value).__name__, value)
        self._seen[id(value)] = (value, self._numbers.setdefault(key, len(self._numbers)))
        return self._seen[id(value)][1]


def is_number(value: object) -> bool:
    """True if a value is a number below 1e300 in size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def is_plain(value: Any) -> bool:
    """True if a value consists of known numbers, text, None and collections of them, few enough to compare."""
    waiting, seen = [value], 0
    while waiting:
        each = waiting.pop()
        seen += 1
        if isinstance(each, Array) or seen > MOST_ITEMS:
            return False
        if isinstance(each, dict):
            waiting += each.values()
            if REST in each:
                return False
        elif isinstance(each, list | tuple):
            waiting += each
        elif isinstance(each, Member):
            if each.is_mixed:
                return False
        elif not (each is None or isinstance(each, str | int | float | bool)):
            return False
    return True


def is_open(value: Any) -> bool:
    """True if a collection may hold more items than are known."""
    if isinstance(value, dict):
        return REST in value
    return isinstance(value, list | tuple) and any(isinstance(each, Unknown) and each.kind == "many" for each in value)


def is_key(value: Any) -> bool:
    """True if a value can be a known key of a dictionary."""
    return is_plain(value) and isinstance(value, Hashable)


def truth(value: Any) -> bool | None:
    """Truth value of a value; None if it is not known."""
    if value is None or isinstance(value, str | int | float | bool):
        return bool(value)
    if isinstance(value, dict):
        return None if REST in value else bool(value)
    if isinstance(value, list | tuple) and not isinstance(value, Array):
        return None if is_open(value) and all(isinstance(each, Unknown) for each in value) else bool(value)
    return True if isinstance(value, Function | Builtin) or (isinstance(value, Record) and value.owner is None) else None


def last_name(node: ast.expr) -> str:
    """Last part of a dotted name; "" for any other expression."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def text_of(node: ast.AST) -> str:
    """Text of an expression on one line, shortened."""
    try:
        text = ast.unparse(node)
    except (RecursionError, ValueError):
        return "…"
    return re.sub(r"\s+", " ", text[:LONGEST_TEXT])
