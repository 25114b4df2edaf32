"""Calls in a Python file: functions and classes of the file, known functions of libraries, and configurations.

A call of a class that the file does not define, with keywords, is a configuration: a Record. Functions of the file are followed, as far
as their turns are known; whatever else is called is not known, and neither is what it was given.
"""

import ast
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

from ...errors import GainroomError
from . import python_library as library
from .python_library import FUNCTIONS, HELPERS, OF_MATH, SEQUENCES, NotKnown
from .python_objects import (
    DEEPEST,
    MOST_ITEMS,
    REST,
    Array,
    Builtin,
    Function,
    Member,
    Method,
    Once,
    Partial,
    Record,
    Unknown,
    Unordered,
    View,
    contents,
    fields_of,
    is_key,
    is_number,
    is_open,
    is_plain,
    parts,
    spoil,
    truth,
)
from .python_undecided import COPIES, HARMLESS, MOST_CALLS, Interpreter, Undecided, function_scope, own_nodes

COPYING = ("isaaclab", "omni.isaac.lab", "omni.isaac.orbit")
"""Libraries whose configurations copy their arguments."""
BUILTINS = (
    *(
        "abs",
        "all",
        "any",
        "bool",
        "dict",
        "enumerate",
        "filter",
        "float",
        "frozenset",
        "getattr",
        "globals",
        "hasattr",
        "int",
        "isinstance",
    ),
    *("len", "list", "map", "max", "min", "pow", "print", "range", "reversed", "round", "set", "setattr", "sorted", "str", "sum", "super"),
    *("tuple", "vars", "zip", "exec", "delattr"),
)


HARMLESS_CALLS = (
    "print",
    "pprint",
    "register",
    "log",
    "info",
    "debug",
    "warn",
    "show",
    "display",
    "dump",
    "save",
    "check",
    "validate",
    "test",
)
"""Beginnings of the names of functions that do not change their arguments."""


class Return(Exception):  # noqa: N818 - how a function ends
    """Raised when a function of the file returns."""

    def __init__(self, value: Any) -> None:
        super().__init__()
        self.value = value


class Calls(Interpreter):
    """Interpreter of calls; `discarded` is a call whose value is not used."""

    discarded: ast.AST | None = None

    def block(self, body: list[ast.stmt]) -> None:
        raise NotImplementedError

    def attribute(self, node: ast.AST, owner: Any, name: str, is_called: bool = False) -> Any:
        raise NotImplementedError

    def called(self, node: ast.Call) -> Any:
        of = node.func
        function = self.attribute(of, self.value(of.value), of.attr, True) if isinstance(of, ast.Attribute) else self.value(of)
        given: list[Any] = []
        named: dict[str, Any] = {}
        whole = True
        for each in node.args:
            value = self.value(each.value if isinstance(each, ast.Starred) else each)
            if not isinstance(each, ast.Starred):
                given.append(value)
                continue
            items = self.iterated(node, value)
            given += [value] if items is None else list(items)
            whole = whole and items is not None
        for keyword in node.keywords:
            value = self.value(keyword.value)
            if keyword.arg is not None:
                whole = whole and keyword.arg not in named
                named[keyword.arg] = value
            elif isinstance(value, dict) and not is_open(value) and not value.keys() & named and all(isinstance(key, str) for key in value):
                named |= value
            else:
                named[f"**{len(named)}"] = value
                whole = False
        if not whole:
            return self._not_followed(node, function, given, named)
        return self.call(node, function, given, named)

    def call(self, node: ast.AST, function: Any, given: list[Any], named: dict[str, Any]) -> Any:
        """Value of a call of a function with its arguments."""
        self.count(node, len(given) + len(named))
        try:
            match function:
                case Function():
                    return self._followed(node, function, given, named)
                case Partial():
                    return self.call(node, function.function, [*function.given, *given], function.named | named)
                case Method():
                    return self._method(node, function, given, named)
                case Record(is_class=True):
                    return self._object(node, function, given, named)
                case Builtin():
                    return self._builtin(node, function.name, given, named)
                case Unknown(kind="import"):
                    return self._imported(node, function, given, named)
        except NotKnown as error:
            return self._not_followed(node, function, given, named, error.because)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            if isinstance(error, GainroomError):
                raise
            return self._not_followed(node, function, given, named)  # Python would end here, too
        return self._not_followed(node, function, given, named)

    def _not_followed(
        self, node: ast.AST, function: Any, given: list[Any], named: dict[str, Any], because: Unknown | None = None
    ) -> Unknown:
        """Value of a call that is not followed. Functions of the file, and methods, may change their arguments, which become unknown."""
        values = [*given, *named.values()]
        because = because or next((each for each in values if isinstance(each, Unknown)), None)
        if isinstance(function, Unknown):
            because = function
        why = "" if because is not None else "is a call that is not followed"
        if isinstance(function, Unknown) and function.kind == "import":
            why = f"is a call, and {_shown_path(function)} {function.why}"
        result = self.unknown(node, *([because] if because else []), *values, why=why)
        if isinstance(function, Function):
            names = self.bound(function, given, named) if not any(key.startswith("**") for key in named) else None
            body = [function.node.body] if isinstance(function.node, ast.Lambda) else function.node.body
            arguments = function.node.args
            every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
            unknowns = {each.arg: result.held() for each in every if each is not None}
            with self.inside(function_scope(function, unknowns | (names or {})), function.source):
                self.spoil_by(body, result.held())
            for each in values if names is None else []:
                spoil(each, result)
            return result.held()
        if isinstance(function, Method) and function.name not in HARMLESS:
            spoil(function.this, result)
            return result.held()
        for each in values:
            if isinstance(each, Function):  # it may be called
                self._not_followed(node, each, [result.held()], {})
        name = _shown_path(function)
        taken = node is not self.discarded or name.startswith(HARMLESS_CALLS) or name[:1].isupper()
        for each in values if not taken else [named.get("out")]:
            if isinstance(each, list | dict):
                spoil(each, replace(result, why="is not run, and may change what it gets"))
        if name != "print" and self.holds_record(node, *values):
            what = f"{name or 'a call'}(…) gets a configuration: it is not run, and may change it"
            if not taken:  # or else it would do nothing
                for each in values:
                    spoil(each, replace(result, why="is not run, and may change what it gets"))
            self.notes.append(f"{self.source}: line {getattr(node, 'lineno', 0)}: {what}")
            return result.held()
        return result

    def bound(self, function: Function, given: list[Any], named: dict[str, Any]) -> dict[str, Any] | None:
        """Arguments of a call by parameter name; None if they do not fit."""
        arguments = function.node.args
        places = [each.arg for each in (*arguments.posonlyargs, *arguments.args)]
        given = [function.this, *given] if function.this is not None else given
        names = dict(zip(places, given, strict=False))
        more = given[len(places) :]
        if arguments.vararg is not None:
            names[arguments.vararg.arg] = tuple(more)
        elif more:
            return None
        known = {*(each.arg for each in arguments.args), *(each.arg for each in arguments.kwonlyargs)}
        rest = {key: value for key, value in named.items() if key not in known}
        if names.keys() & (named.keys() - rest.keys()) or (rest and arguments.kwarg is None):
            return None
        names |= {key: value for key, value in named.items() if key in known}
        if arguments.kwarg is not None:
            names[arguments.kwarg.arg] = rest
        for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
            if each.arg not in names:
                if each.arg not in function.defaults:
                    return None
                names[each.arg] = function.defaults[each.arg]
        return names

    def _followed(self, node: ast.AST, function: Function, given: list[Any], named: dict[str, Any]) -> Any:
        names = self.bound(function, given, named)
        if names is None:
            raise NotKnown
        names = {name: self.stored_once(node, value) if isinstance(value, Once) else value for name, value in names.items()}
        if self.calls >= MOST_CALLS:
            raise self.refusal(node, f"functions call each other more than {MOST_CALLS} deep")
        body = function.node.body
        self.calls += 1
        try:
            if function.owner is not None and function.this is not None:
                names |= {"__class__": function.owner, "__self__": function.this}
            with self.inside(function_scope(function, names), function.source):
                if not isinstance(body, list):
                    return self.value(body)
                if isinstance(function.node, ast.AsyncFunctionDef) or any(
                    isinstance(each, ast.Yield | ast.YieldFrom) for each in own_nodes(body)
                ):
                    return self.undecided(node, body, "is a generator, which is not followed")
                try:
                    self.block(body)
                except Return as ended:
                    return ended.value
                except Undecided as turn:
                    self.spoil_by(body, turn.unknown)
                    return turn.unknown.held()
                return None
        finally:
            self.calls -= 1

    def _object(self, node: ast.AST, kind: Record, given: list[Any], named: dict[str, Any]) -> Any:
        """Instance of a class of the file."""
        line = getattr(node, "lineno", 0)
        if kind.is_enumeration:
            raise NotKnown
        names = fields_of(kind)
        strange = [key for key in names if isinstance(key, str) and key.startswith("__") and key not in _PLAIN_METHODS]
        if strange or REST in names:
            return self.undecided(node, [], f"has {strange[0] if strange else 'what is not known'}, which is not followed")
        values = {key: value for key, value in names.items() if not isinstance(value, Function)}
        made = Record(kind.name, line, {}, kind.kinds, source=self.source, owner=kind, is_copied=kind.is_copied)
        made.fields = values if kind.is_plain else self.deep_copy(node, values)
        start = kind.inherited("__init__")
        if isinstance(start, Function):
            self.call(node, replace(start, this=made), given, named)
            return made
        if kind.is_plain:
            for each in kind.lineage:
                each.made.append(made)
        if len(given) > len(kind.order):
            raise NotKnown
        placed = dict(zip(kind.order, given, strict=False))
        if placed.keys() & named.keys():
            raise NotKnown
        made.fields |= self.deep_copy(node, placed | named) if kind.is_copied else placed | named
        after = kind.inherited("__post_init__")
        if isinstance(after, Function):
            self.call(node, replace(after, this=made), [], {})
        return made

    def _imported(self, node: ast.AST, function: Unknown, given: list[Any], named: dict[str, Any]) -> Any:
        """Value of a call of an imported function: known by name, a class, or unknown."""
        path = function.path
        first, _, name = path.rpartition(".")
        first = library.MODULES.get(first, first)
        if first in OF_MATH or (not first and name in FUNCTIONS):
            plain = not named or (set(named) == {"dtype"} and named["dtype"] == Builtin("float"))
            if name in SEQUENCES and first == "numpy" and plain and len(given) == 1 and self._is_row(given[0]):
                return Array(map(float, given[0]) if named else given[0])
            if name in FUNCTIONS and not any(isinstance(each, Array) for each in given):
                return library.computed(FUNCTIONS[name], *given, **named)
        if name in HELPERS and "mjlab" in path:
            return library.computed(HELPERS[name], *given, **named)
        match path:
            case "copy.deepcopy" | "deepcopy" if len(given) == 1:
                return self.deep_copy(node, given[0]) if not isinstance(given[0], Unknown) else given[0]
            case "copy.copy" | "copy" if len(given) == 1:
                return self._shallow(node, given[0], {})
            case "dataclasses.replace" | "replace" if len(given) == 1:
                return self._shallow(node, given[0], named)
            case "dataclasses.field" | "field":
                return self._default(node, named)
            case "functools.partial" | "partial" if given:
                return Partial(given[0], tuple(given[1:]), named)
            case "itertools.chain" | "chain":
                return Once([item for each in given for item in self.items(node, each)])
            case "itertools.chain.from_iterable" | "chain.from_iterable" if len(given) == 1:
                return Once([item for each in self.items(node, given[0]) for item in self.items(node, each)])
            case "itertools.product" | "product" if not named:
                return Once(self._product(node, given))
            case "collections.OrderedDict" | "OrderedDict":
                return self._builtin(node, "dict", given, named)
        if name in COPIES and not given and first:  # a configuration of another file: IMPORTED.copy()
            return Unknown(
                getattr(node, "lineno", 0), first.rpartition(".")[2], f"{function.why}: write its actuators here, or lay that file beside",
                path=path, is_free=not self.holds_record(node, *named.values()), source=self.shown_source,
            )  # fmt: skip
        if name.lstrip("_")[:1].isupper() and not given:
            made = Record(name, getattr(node, "lineno", 0), {}, (name,), source=self.source, is_copied=path.startswith(COPYING))
            made.fields = self.deep_copy(node, named) if made.is_copied else dict(named)
            return made
        raise NotKnown

    def _is_row(self, value: Any) -> bool:
        return isinstance(value, list | tuple) and all(is_number(each) for each in value)

    def _product(self, node: ast.AST, given: list[Any]) -> list[Any]:
        rows: list[tuple[Any, ...]] = [()]
        for each in given:
            items = self.items(node, each)
            if len(rows) * len(items) > MOST_ITEMS:
                raise NotKnown
            rows = [(*row, item) for row in rows for item in items]
            self.count(node, len(rows) * len(given))
        return list(rows)

    def _default(self, node: ast.AST, named: dict[str, Any]) -> Any:
        """Default value in a call of dataclasses.field. Raises NotKnown if it has none."""
        if "default" in named:
            return named["default"]
        if "default_factory" in named:
            return self.call(node, named["default_factory"], [], {})
        raise NotKnown

    def _shallow(self, node: ast.AST, value: Any, changes: dict[str, Any]) -> Any:
        """Shallow copy, unless the configuration itself copies its arguments."""
        if isinstance(value, Record) and not value.is_class:
            result = replace(value, fields=value.fields | changes, line=getattr(node, "lineno", 0) if changes else value.line)
            if value.is_copied and changes:
                result.fields = self.deep_copy(node, result.fields)
            after = value.method("__post_init__")
            return self._after(node, result, after) if changes else result
        if isinstance(value, dict | list | tuple) and not changes:
            self.count(node, len(value))
            return type(value)(value)
        raise NotKnown(value if isinstance(value, Unknown) else None)

    def _after(self, node: ast.AST, made: Record, after: Any) -> Record:
        if isinstance(after, Function):
            self.call(node, replace(after, this=made), [], {})
        return made

    def _method(self, node: ast.AST, method: Method, given: list[Any], named: dict[str, Any]) -> Any:
        this, name = method.this, method.name
        match this:
            case str():
                return (
                    library.format_method(this, given, named)
                    if name == "format"
                    else library.text_method(this, name, self._listed(node, given))
                )
            case dict() if name in ("keys", "values", "items") and not given:
                return View(this, name)
            case dict():
                if name == "update" and given and not isinstance(given[0], dict):
                    given = [self._pairs(node, given[0])]
                return library.dict_method(this, name, given, named)
            case list() if not named:
                if name == "extend":
                    given = [list(self.items(node, given[0]))] if len(given) == 1 else given
                self.count(node, len(this) * (8 if name in ("remove", "index", "count") else 1) // 8)
                return library.list_method(this, name, given)
            case tuple() if name in ("count", "index") and is_plain(this) and is_plain(given):
                return library.list_method(list(this), name, given)
            case Record(name="super", fields={"__self__": Record() as record}) if not given and name in ("__init__", "__post_init__"):
                record.fields |= self.deep_copy(node, named) if record.is_copied else named  # of a library's class, whose fields they are
                return None
            case Record() if name in COPIES and not given:
                result = self.deep_copy(node, this)
                if isinstance(result, Record):
                    result.fields |= self.deep_copy(node, named) if this.is_copied else named
                    result = self._after(node, result, this.method("__post_init__")) if named else result
                return result
        raise NotKnown

    def _listed(self, node: ast.AST, given: list[Any]) -> list[Any]:
        return [each if isinstance(each, str) else list(self.items(node, each)) for each in given]

    def _pairs(self, node: ast.AST, value: Any) -> dict[Any, Any]:
        result: dict[Any, Any] = {}
        for pair in self.items(node, value):
            if not (isinstance(pair, list | tuple) and len(pair) == 2 and is_key(pair[0])):
                raise NotKnown(pair if isinstance(pair, Unknown) else None)
            result[pair[0]] = pair[1]
        return result

    def _builtin(self, node: ast.AST, name: str, given: list[Any], named: dict[str, Any]) -> Any:
        match name, given:
            case "print", _:
                return None
            case "exec", _:
                raise self.refusal(node, "runs text with exec, which is not followed")
            case "globals" | "vars", [] if name == "globals":
                return self.scope.module.names
            case "vars", [Record() as record]:
                return record.fields
            case "super", []:
                return self._super()
            case "isinstance", [value, kind]:
                self.count(node, 8 * len(contents(kind)))
                return library.is_a(value, kind)
            case "getattr" | "hasattr", [Record() as record, str() as key, *rest]:
                has = key in record.fields or record.inherited(key) is not None or record.method(key) is not None
                if not has and (REST in record.fields or record.owner is None or (name == "getattr" and not rest)):
                    raise NotKnown
                return has if name == "hasattr" else self.attribute(node, record, key) if has else rest[0]
            case "getattr", [list() | dict() | str() as owner, str() as key]:
                return self.attribute(node, owner, key)
            case "setattr", [Record() as record, str() as key, value]:
                self.set_field(node, record, key, value)
                return None
            case "delattr", [Record() as record, str() as key] if key in record.fields:
                del record.fields[key]
                return None
            case "setattr" | "delattr", [target, *_]:
                self.spoil_object(node, target, self.unknown(node), f"calls {name} on what is not understood here")
                return None
            case "len", [value]:
                return len(self.items(node, value, taken=False))
            case "range", _:
                found = range(*given) if all(type(each) is int for each in given) else None
                if found is None or found[MOST_ITEMS:]:
                    raise NotKnown(next((each for each in given if isinstance(each, Unknown)), None))
                self.count(node, len(found))
                return tuple(found)
            case "list" | "set" | "frozenset", [] | [_]:
                items = self.items(node, given[0]) if given else []
                return _unique(items) if name != "list" else Unordered(items) if given and isinstance(given[0], Unordered) else items
            case "tuple", [] | [_]:
                return tuple(self.in_order(node, given[0])) if given else ()
            case "dict", [] | [_]:
                start = given[0] if given else {}
                if isinstance(start, dict) and is_open(start):
                    raise NotKnown(start[REST])
                return (dict(start) if isinstance(start, dict) else self._pairs(node, start)) | named
            case "zip", _ if named.keys() <= {"strict"}:
                return Once(list(zip(*(self.in_order(node, each) for each in given), strict=False)))
            case "enumerate", [value, *start] if all(type(each) is int for each in (*start, *named.values())) and set(named) <= {"start"}:
                return Once(list(enumerate(self.in_order(node, value), *start, **named)))
            case "reversed", [value]:
                return Once(self.in_order(node, value)[::-1])
            case "map", [function, *columns]:
                rows = zip(*(self.in_order(node, each) for each in columns), strict=False)
                return Once([self.call(node, function, list(row), {}) for row in rows])
            case "filter", [function, value]:
                return Once(
                    [
                        each
                        for each in self.items(node, value)
                        if self._decided(each if function is None else self.call(node, function, [each], {}))
                    ]
                )
        return self._of_values(node, name, given, named)

    def _of_values(self, node: ast.AST, name: str, given: list[Any], named: dict[str, Any]) -> Any:
        """Value of a builtin function that returns a truth value, a number or text."""
        match name, given:
            case "any" | "all", [value]:
                turns = map(self._decided, self.items(node, value))
                return any(turns) if name == "any" else all(turns)
            case "sorted", [value]:
                return self._sorted(node, self.items(node, value), named)
            case "sum", [value, *start]:
                total = start[0] if start else 0
                for each in self.items(node, value):
                    total = library.arithmetic("Add", total, each)
                return total
            case "min" | "max", _ if not named:
                items = self.items(node, given[0]) if len(given) == 1 else given
                return library.computed({"min": min, "max": max}[name], items)
            case "abs" | "round" | "pow", _ if not named:
                return library.computed(
                    {"abs": abs, "round": round, "pow": lambda one, other: library.arithmetic("Pow", one, other)}[name], *given
                )
            case "int" | "float", [value]:
                number = value if not isinstance(value, str) else _typed(value, int if name == "int" else float)
                return library.computed({"int": int, "float": float}[name], number)
            case "str", [value]:
                return library.formatted(value)
            case "bool", [value]:
                return self._decided(value)
        raise NotKnown(next((each for each in given if isinstance(each, Unknown)), None))

    def stored_once(self, node: ast.AST, value: Once) -> Any:
        """Value of a name that stores a generator, zip, map, …: unknown, because it is iterated later, when its items may have changed."""
        return self.unknown(node, *value.left, why="is gone through later, which is not followed: write list(…)")

    def set_field(self, node: ast.AST, record: Record, name: str, value: Any) -> None:
        """Executes record.name = value as Python does."""
        own = record.method(name) if record.owner is not None else None
        if isinstance(own, Unknown) or (isinstance(own, Function) and own.kind == "property"):
            value = self.unknown(node, value, why="is set through a property, which is not followed")
        record.fields[name] = value
        for each in record.made if record.is_class else ():  # of which some may have a value of their own
            each.fields[name] = self.unknown(node, why="is changed in the class after objects of it were made")

    def _super(self) -> Any:
        """Object of super(): the next class of the lineage, with the present function's first argument."""
        around = self.scope
        while around is not None and "__class__" not in around.names:
            around = around.parent
        if around is None:
            raise NotKnown
        kind, this = around.names["__class__"], around.names["__self__"]
        lineage = (this if this.is_class else this.owner or kind).lineage if isinstance(this, Record) else kind.lineage
        place = next((k for k, each in enumerate(lineage) if each is kind), None)
        if place is None:
            raise NotKnown
        names: dict[Any, Any] = {}
        for each in reversed(lineage[place + 1 :]):
            names |= {key: replace(value, this=this) if isinstance(value, Function) else value for key, value in each.fields.items()}
        return Record("super", kind.line, names | {"__self__": this}, ("super",), source=self.source)

    def _decided(self, value: Any) -> bool:
        found = truth(value)
        if found is None:
            raise NotKnown(value if isinstance(value, Unknown) else None)
        return found

    def _sorted(self, node: ast.AST, items: list[Any], named: dict[str, Any]) -> list[Any]:
        keys = [self.call(node, named["key"], [each], {}) if "key" in named else each for each in items]
        if not all(map(is_plain, keys)) or named.keys() - {"key", "reverse"} or not isinstance(named.get("reverse", False), bool):
            raise NotKnown
        try:
            order = sorted(range(len(items)), key=keys.__getitem__, reverse=named.get("reverse", False))
        except TypeError as error:
            raise NotKnown from error
        return [items[k] for k in order]

    def items(self, node: ast.AST, value: Any, taken: bool = True) -> list[Any]:
        """Items of a value that can be iterated. Raises NotKnown."""
        found = self.iterated(node, value if taken or not isinstance(value, Once) else None)
        if found is None:
            raise NotKnown(value if isinstance(value, Unknown) else None)
        return list(found)

    def in_order(self, node: ast.AST, value: Any) -> list[Any]:
        """Items of a value whose order is defined. Raises NotKnown."""
        if isinstance(value, Unordered) and len(value) > 1:
            raise NotKnown
        return self.items(node, value)

    def iterated(self, node: ast.AST, value: Any) -> Iterator[Any] | None:
        """Iterator over the items of a value as they are when asked for; None if they are not known."""
        if is_open(value) or (isinstance(value, View) and is_open(value.mapping)) or (isinstance(value, Once) and is_open(value.left)):
            return None
        size = len(value) if isinstance(value, list | tuple | dict | str) else len(contents(value)) if isinstance(value, View | Once) else 0
        self.count(node, size)
        if isinstance(value, View | Once):
            return iter(value.items())
        if isinstance(value, Record) and value.is_class and value.is_enumeration:
            return iter([each for each in value.fields.values() if isinstance(each, Member)])
        if isinstance(value, str) and len(value) <= MOST_ITEMS:
            return iter(value)
        return iter(value if not isinstance(value, dict) else list(value)) if isinstance(value, list | tuple | dict) else None

    def deep_copy(self, node: ast.AST, value: Any) -> Any:
        """Deep copy. It costs as many steps as it has parts: configurations that hold each other twice double with every copy."""
        memo: dict[int, Any] = {}
        for _ in parts(value):
            self.count(node)
        return self._copied(value, memo, 0)

    def _copied(self, value: Any, memo: dict[int, Any], depth: int) -> Any:
        if id(value) in memo or not isinstance(value, dict | list | tuple | Record) or (isinstance(value, Record) and value.is_class):
            return memo.get(id(value), value)
        if depth > DEEPEST:
            raise NotKnown
        self.count(ast.Pass(), len(value.fields) if isinstance(value, Record) else len(value))
        again: Callable[[Iterable[Any]], list[Any]] = lambda each: [self._copied(item, memo, depth + 1) for item in each]  # noqa: E731
        if isinstance(value, tuple):
            return memo.setdefault(id(value), tuple(again(value)))
        if isinstance(value, list):
            result: Any = memo.setdefault(id(value), type(value)())
            result.extend(again(value))
        elif isinstance(value, dict):
            result = memo.setdefault(id(value), {})
            result |= zip(value, again(value.values()), strict=True)
        else:
            result = memo.setdefault(id(value), replace(value, fields={}))
            result.fields |= zip(value.fields, again(value.fields.values()), strict=True)
        return result


_PLAIN_METHODS = ("__init__", "__post_init__", "__repr__", "__str__", "__eq__", "__hash__", "__call__", "__len__", "__doc__", "__slots__")


def _unique(items: list[Any]) -> Unordered:
    """Set of the items."""
    if not all(map(is_key, items)):
        raise NotKnown
    return Unordered(dict.fromkeys(items))


def _typed(text: str, kind: Callable[[str], float]) -> float:
    try:
        return kind(text[:60])
    except ValueError as error:
        raise NotKnown from error


def _shown_path(function: Any) -> str:
    """Name of a function, for messages."""
    if isinstance(function, Unknown):
        return function.path.rpartition(".")[2] or function.text
    return getattr(function, "name", "")
