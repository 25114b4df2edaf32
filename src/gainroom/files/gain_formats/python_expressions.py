"""Evaluation of the expressions of a Python file as far as their values are known without running anything; the work is bounded."""

import ast
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from . import python_library as library
from .python_calls import BUILTINS, Calls
from .python_library import CONSTANTS, OF_MATH, NotKnown
from .python_objects import (
    MOST_ITEMS,
    REST,
    Array,
    Builtin,
    Function,
    Member,
    Method,
    Named,
    Once,
    Record,
    Scope,
    Unknown,
    Unordered,
    is_key,
    is_open,
    spoil,
    text_of,
    truth,
)

MOST_DEPTH = 60
"""Maximum depth of nested expressions, those of called functions included."""
FALSE = ("typing.TYPE_CHECKING", "TYPE_CHECKING")


class Expressions(Calls):
    """Evaluator of expressions in the present scope."""

    _depth = 0

    def value(self, node: ast.expr) -> Any:
        self.count(node)
        self._depth += 1
        try:
            if self._depth > MOST_DEPTH:
                return self.undecided(node, [node], "is nested too deeply")
            return self._evaluated(node)
        except NotKnown as error:
            return self.unknown(node, *([error.because] if error.because else []), *self._known_in(node))
        finally:
            self._depth -= 1

    def _known_in(self, node: ast.AST) -> list[Any]:
        """Values of the names in a node, which an unknown value may contain."""
        names = [self.found(each.id, each) for each in ast.walk(node) if isinstance(each, ast.Name)]
        self.count(node, 8 * len(names))
        return [each for each in names if not isinstance(each, Unknown) or not each.is_free]

    def found(self, name: str, node: ast.AST) -> Any:
        here = self.scope.find(name)
        if here is not None:
            return here.value
        if name in BUILTINS:
            return Builtin(name)
        if name == "__name__":
            return "read"  # by gainroom, and not as __main__
        return Unknown(getattr(node, "lineno", 0), name, "is no name of this file", "import", name, source=self.shown_source)

    def _evaluated(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=value):
                return value if isinstance(value, str | int | float | bool | None) else self.unknown(node)
            case ast.Name(id=name):
                return self.found(name, node)
            case ast.Tuple(elts=elements) | ast.List(elts=elements) | ast.Set(elts=elements):
                items: list[Any] = list(itertools.islice(self._items(elements), MOST_ITEMS + 1))
                if len(items) > MOST_ITEMS:
                    return self.undecided(node, [node], f"has more than {MOST_ITEMS} items")
                self.count(node, len(items))
                found = tuple(items) if isinstance(node, ast.Tuple) else items
                return found if not isinstance(node, ast.Set) else self._builtin(node, "set", [found], {})
            case ast.Dict(keys=keys, values=values):
                return self._dict(keys, values)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return not self._decided(self.value(operand))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
                found = self.value(operand)
                if isinstance(found, Array):
                    return library.arithmetic("Mult", found, -1 if isinstance(op, ast.USub) else 1)
                library.numbers(found)
                return -found if isinstance(op, ast.USub) else +found
            case ast.BinOp(left=left, op=op, right=right):
                return self.arithmetic(node, op, self.value(left), self.value(right))
            case ast.BoolOp(op=op, values=values):
                return self._either(node, isinstance(op, ast.Or), values)
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compared(left, ops, others)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                turn = truth(self.value(test))
                if turn is None:
                    return self.undecided(node, [body, orelse])
                return self.value(body if turn else orelse)
            case ast.NamedExpr(target=target, value=value):
                found, scope = self.value(value), self.scope
                while scope.is_comprehension and scope.parent is not None:
                    scope = scope.parent
                scope.store(target.id, found)
                return found
            case ast.Attribute(value=owner, attr=name):
                return self.attribute(node, self.value(owner), name)
            case ast.Subscript(value=owner, slice=index):
                return self._entry(self.value(owner), self._index(index))
            case ast.JoinedStr(values=pieces):
                return library.bounded("".join(self._piece(each) for each in pieces))
            case ast.Lambda(args=arguments):
                return Function("lambda", node, self.scope, self.defaults(arguments), self.source)
            case (
                ast.ListComp(elt=made, generators=loops)
                | ast.SetComp(elt=made, generators=loops)
                | ast.GeneratorExp(elt=made, generators=loops)
            ):
                items = self._comprehended(node, lambda: self.value(made), loops)
                if isinstance(items, Unknown) or isinstance(node, ast.ListComp):
                    return items
                return Once(items) if isinstance(node, ast.GeneratorExp) else self._builtin(node, "set", [items], {})
            case ast.DictComp(key=key, value=value, generators=loops):
                items = self._comprehended(node, lambda: (self.value(key), self.value(value)), loops)
                return items if isinstance(items, Unknown) else self._pairs(node, items)
            case ast.Call():
                return self.called(node)
        return self.undecided(node, [node])

    def _items(self, elements: list[ast.expr]) -> Iterator[Any]:
        for each in elements:
            if isinstance(each, ast.Starred):
                found = self.value(each.value)
                inner = self.iterated(each, found)
                yield from inner if inner is not None else [self.unknown(each.value, found).many()]
            else:
                yield self.value(each)

    def _dict(self, keys: list[ast.expr | None], values: list[ast.expr]) -> dict[Any, Any]:
        result: dict[Any, Any] = {}
        for key, value in zip(keys, values, strict=True):
            name = self.value(key) if key is not None else None
            found = self.value(value)
            if key is None and isinstance(found, dict):
                result = library.arithmetic("BitOr", result, found) if not is_open(found) else result | found
            elif key is None or not is_key(name):  # it may be any key
                unknown = self.unknown(value if key is None else key, found if key is None else name).held()
                result = dict.fromkeys((*result, REST), unknown)
            else:
                result[name] = found
        self.count(values[0] if values else ast.Pass(), len(result))
        return result

    def arithmetic(self, node: ast.AST, op: ast.operator, left: Any, right: Any) -> Any:
        if isinstance(left, list | tuple | str):
            self.count(node, len(left))
        try:
            found = library.arithmetic(type(op).__name__, left, right)
            self.count(node, len(found) if isinstance(found, list | tuple | dict) else 0)
            return found
        except NotKnown as error:
            return self.unknown(node, *([error.because] if error.because else []), left, right)

    def _either(self, node: ast.expr, is_or: bool, values: list[ast.expr]) -> Any:
        for number, each in enumerate(values):
            found = self.value(each)
            if number == len(values) - 1:
                return found
            turn = truth(found)
            if turn is None:
                return self.undecided(node, values[number + 1 :])
            if turn == is_or:
                return found
        return None

    def _compared(self, left: ast.expr, ops: list[ast.cmpop], others: list[ast.expr]) -> bool:
        first = self.value(left)
        for op, other in zip(ops, others, strict=True):
            second = self.value(other)
            self.count(other, sum(len(each) for each in (first, second) if isinstance(each, list | tuple | dict)))
            if not library.compared(type(op).__name__, first, second):
                return False
            first = second
        return True

    def attribute(self, node: ast.AST, owner: Any, name: str, is_called: bool = False) -> Any:
        match owner:
            case Unknown(kind="import", path=path):
                first = library.MODULES.get(path, path)
                if first in OF_MATH and name in CONSTANTS:
                    return CONSTANTS[name]
                return replace(owner, text=f"{owner.text}.{name}"[:80], path=f"{path}.{name}")
            case Unknown():
                return owner
            case Record(fields=fields):
                return self._of_record(node, owner, fields, name, is_called)
            case Named() if name in owner.names:
                return owner[owner.names.index(name)]
            case Member() if name in ("name", "value"):
                return owner.name if name == "name" else owner.value
            case Array() if is_called and name != "tolist":
                spoil(owner, self.unknown(node, why="is a method that is not followed"))
            case str() | dict() | list() | tuple() if not isinstance(owner, Array) or name == "tolist":
                return Method(owner, name)
        return self.unknown(node, owner)

    def _of_record(self, node: ast.AST, owner: Record, fields: dict[Any, Any], name: str, is_called: bool) -> Any:
        if name == "__dict__":
            return fields
        found = fields.get(name)
        if name not in fields:
            found = owner.inherited(name) if owner.is_class else owner.method(name)
        if isinstance(found, Function) and owner.name != "super":
            if found.kind == "property" and not owner.is_class:
                return self.call(node, replace(found, this=owner), [], {})
            bound = found.kind == "classmethod" or (not owner.is_class and name not in fields and found.kind != "staticmethod")
            return replace(found, this=owner if found.kind != "classmethod" else owner.owner or owner) if bound else found
        if found is not None or name in fields:
            return found
        if owner.is_class and name[:1].isupper():
            path = f"{'isaaclab.' if owner.is_copied else ''}{owner.name}.{name}"
            return Unknown(getattr(node, "lineno", 0), text_of(node), "comes with another file", "import", path, source=self.shown_source)
        if is_called:
            return Method(owner, name)
        why = "may have been changed" if REST in fields else "is not written in this file: a default is not known"
        return self.unknown(node, owner, why=why)

    def _index(self, node: ast.expr) -> Any:
        if not isinstance(node, ast.Slice):
            return self.value(node)
        ends = [None if each is None else self.value(each) for each in (node.lower, node.upper, node.step)]
        for each in ends:
            if each is not None and type(each) is not int:
                raise NotKnown(each if isinstance(each, Unknown) else None)
        return slice(*ends)

    def _entry(self, owner: Any, key: Any) -> Any:
        if not isinstance(owner, dict | list | tuple | str) or is_open(owner):
            if isinstance(owner, dict) and is_key(key) and key in owner:
                return owner[key]
            raise NotKnown(owner if isinstance(owner, Unknown) else owner[REST] if isinstance(owner, dict) else None)
        if not isinstance(key, slice) and not is_key(key):
            raise NotKnown(key if isinstance(key, Unknown) else None)
        try:
            if isinstance(owner, Unordered):
                raise NotKnown
            found = owner[key]  # type: ignore[index]
            return Array(found, owner.family) if isinstance(owner, Array) and isinstance(key, slice) else found
        except (LookupError, TypeError, ValueError) as error:
            raise NotKnown from error

    def _piece(self, part: ast.expr) -> str:
        if isinstance(part, ast.FormattedValue):
            form = self.value(part.format_spec) if part.format_spec is not None else ""
            return library.formatted(self.value(part.value), form if isinstance(form, str) else "?", part.conversion)
        found = self.value(part)
        return found if isinstance(found, str) else ""

    def defaults(self, arguments: ast.arguments) -> dict[str, Any]:
        """Default values of a function's parameters at its definition."""
        places = [*arguments.posonlyargs, *arguments.args]
        pairs = list(zip(places[len(places) - len(arguments.defaults) :], arguments.defaults, strict=True))
        pairs += [(each, value) for each, value in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True) if value is not None]
        return {each.arg: self.value(value) for each, value in pairs}

    def _comprehended(self, node: ast.expr, make: Callable[[], Any], loops: list[ast.comprehension]) -> Any:
        """List of a comprehension's items."""
        result: list[Any] = []
        try:
            first = self.value(loops[0].iter)  # is evaluated outside
            outer = self.iterated(node, first)
            result = Unordered() if isinstance(first, Unordered) and len(first) > 1 else result
            with self.inside(Scope({}, self.scope, is_comprehension=True)):
                self._looped(node, make, loops, outer, result)
        except NotKnown as error:
            unknown = self.undecided(node, [node])
            return unknown if error.because is None else error.because.held()
        return result

    def _looped(self, node: ast.expr, make: Callable[[], Any], loops: list[ast.comprehension], items: Any, result: list[Any]) -> None:
        loop = loops[0]
        if items is None or loop.is_async:
            raise NotKnown
        for item in items:
            self.count(node)
            self.assign(loop.target, item)
            if all(self._decided(self.value(test)) for test in loop.ifs):
                if len(loops) > 1:
                    self._looped(node, make, loops[1:], self.iterated(node, self.value(loops[1].iter)), result)
                else:
                    result.append(make())
            if len(result) > MOST_ITEMS:
                raise NotKnown

    def assign(self, target: ast.expr, value: Any) -> None:
        raise NotImplementedError
