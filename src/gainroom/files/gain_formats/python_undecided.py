"""Undecided parts of a Python file: they are not run, and all that they may change is unknown afterwards.

A branch, a loop or a call whose outcome is not known is walked through as text: every name that it stores, every object that it
stores into or calls a method on, and the same in the functions of the file that it calls, are unknown from there on.
"""

import ast
import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from ...errors import GainroomError
from .python_objects import REST, Function, Method, Record, Scope, Unknown, has_record, last_name, parts, spoil, text_of

MOST_STEPS = 250_000
"""Maximum number of evaluated expressions of one file and of the files beside it that it names; an item that is made counts an eighth."""
MOST_OF_ONE = 40_000
"""Maximum number of steps for one statement, which is undecided afterwards."""
MOST_CALLS = 20
"""Maximum depth of functions that call each other."""
COPIES = ("copy", "replace")
HARMLESS = (*COPIES, *("get", "keys", "values", "items", "index", "count", "to_dict", "validate", "exists", "resolve", "tolist"))
"""Names of methods that do not change their object."""
MUTATORS = ("append", "extend", "insert", "remove", "pop", "popitem", "clear", "update", "setdefault", "sort", "reverse")
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda, ast.ClassDef)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
NO_RUN = "cannot be decided without running the file"


class Undecided(Exception):  # noqa: N818 - no error, a turn that is not known
    """Raised if the rest of a function or a statement may be run or not."""

    def __init__(self, unknown: Unknown) -> None:
        super().__init__(str(unknown))
        self.unknown = unknown


class TooLong(Exception):  # noqa: N818
    """Raised if one statement takes too many steps."""


@dataclass
class Budget:
    """Steps taken so far by all files that are read together."""

    steps: int = 0


def own_nodes(body: Iterable[ast.AST], closed: tuple[type[ast.AST], ...] = SCOPES) -> Iterator[ast.AST]:
    """Nodes of a syntax tree in order, without those inside its functions and classes, or other nodes that are `closed`."""
    waiting = list(body)[::-1]
    while waiting:
        node = waiting.pop()
        yield node
        if not isinstance(node, closed):
            waiting += list(ast.iter_child_nodes(node))[::-1]


class Interpreter:
    """Interpreter of a file: `scope` of the present names, `source` as messages call the file; `notes` for the user.

    guarded   fields that must not be changed where it is not known whose they are
    main      the file that was asked for: messages of others name theirs
    """

    def __init__(self, source: str, guarded: tuple[str, ...], main: str, budget: Budget) -> None:
        self.source = source
        self.main = main
        self.guarded = guarded
        self.scope = Scope({})
        self.notes: list[str] = []
        self.budget = budget
        self._statement_from = budget.steps
        self.calls = 0
        self._spoiling: list[ast.AST] = []

    def value(self, node: ast.expr) -> Any:
        raise NotImplementedError

    def found(self, name: str, node: ast.AST) -> Any:
        raise NotImplementedError

    def bound(self, function: Function, given: list[Any], named: dict[str, Any]) -> dict[str, Any] | None:
        raise NotImplementedError

    def count(self, node: ast.AST, items: int = 0) -> None:
        self.budget.steps += 1 + items // 8
        if self.budget.steps > MOST_STEPS:
            raise self.refusal(node, f"more than {MOST_STEPS} expressions")
        if self.budget.steps - self._statement_from > MOST_OF_ONE:
            raise TooLong

    def next_statement(self) -> None:
        """Begins the next statement of the file, with a step count of its own."""
        self._statement_from = self.budget.steps

    def refusal(self, node: ast.AST, problem: str) -> GainroomError:
        return GainroomError(f"{self.source}: line {getattr(node, 'lineno', 0)}: {problem}")

    @property
    def shown_source(self) -> str:
        """Name of the file in messages, if it is not the main file."""
        return "" if self.source == self.main else self.source

    @contextlib.contextmanager
    def inside(self, scope: Scope, source: str = "") -> Iterator[None]:
        outer = self.scope, self.source
        self.scope, self.source = scope, source or self.source
        try:
            yield
        finally:
            self.scope, self.source = outer

    def holds_record(self, node: ast.AST, *values: Any) -> bool:
        """True if one of the values may contain a configuration."""
        for value in values:
            for number, _ in enumerate(parts(value)):
                if number % 8 == 7:
                    self.count(node)
        return any(map(has_record, values))

    def unknown(self, node: ast.AST, *inner: Any, why: str = "") -> Unknown:
        """Unknown value of a node; if a value inside it is unknown, that one names the cause."""
        first = next((each for each in inner if isinstance(each, Unknown)), None)
        if first is None or why:
            first = Unknown(getattr(node, "lineno", 0), text_of(node), why or "is not understood", source=self.shown_source)
        return first.held() if self.holds_record(node, *inner) else first

    def undecided(self, node: ast.AST, body: Iterable[ast.AST], why: str = NO_RUN) -> Unknown:
        """Unknown value of a node whose `body` may run or not: all that the body may change becomes unknown."""
        unknown = Unknown(getattr(node, "lineno", 0), text_of(node), why, is_free=False, source=self.shown_source)
        self.spoil_by(body, unknown)
        return unknown

    def spoil_by(self, body: Iterable[ast.AST], unknown: Unknown) -> None:
        for node in own_nodes(body, (*SCOPES, *COMPREHENSIONS)):
            self.count(node)
            if isinstance(node, COMPREHENSIONS):
                own = [each for loop in node.generators for each in ast.walk(loop.target) if isinstance(each, ast.Name)]
                with self.inside(Scope(dict.fromkeys((each.id for each in own), unknown), self.scope, is_comprehension=True)):
                    self.spoil_by(ast.iter_child_nodes(node), unknown)
            match node:
                case ast.NamedExpr(target=target):
                    outer = self.scope
                    while outer.is_comprehension and outer.parent is not None:
                        outer = outer.parent
                    outer.store(target.id, unknown)
                case ast.AugAssign(target=ast.Name() as target):
                    spoil(self.peek(target), unknown)
                case ast.Name(id=name, ctx=ast.Store() | ast.Del()):
                    self.scope.store(name, unknown)
                case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                    self.scope.store(name, unknown)
                case ast.alias(name=name, asname=other):
                    self.scope.store((other or name).partition(".")[0], unknown)
                case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                    self.scope.store(name, unknown)
                case ast.Attribute(value=owner, attr=name, ctx=ast.Store() | ast.Del()):
                    found = self.peek(owner)
                    if isinstance(found, Record):
                        found.fields[name] = unknown
                    elif isinstance(found, Unknown) and not found.is_free and name in self.guarded:
                        raise self.refusal(node, f"changes {name} of what is not understood here")
                case ast.Subscript(value=owner, ctx=ast.Store() | ast.Del()):
                    self.spoil_object(node, self.peek(owner), unknown, "changes an entry of what is not understood here")
                case ast.Call():
                    self._spoil_by_call(node, unknown)

    def spoil_object(self, node: ast.AST, value: Any, unknown: Unknown, problem: str) -> None:
        """Makes all contents of a value unknown. Raises GainroomError if the value itself is not known."""
        if isinstance(value, Unknown) and not value.is_free:
            raise self.refusal(node, problem)
        spoil(value, unknown)

    def _spoil_by_call(self, node: ast.Call, unknown: Unknown) -> None:
        function = self.peek(node.func)
        given = [self.peek(each.value if isinstance(each, ast.Starred) else each) for each in node.args]
        named = {each.arg or "": self.peek(each.value) for each in node.keywords}
        whole = not any(isinstance(each, ast.Starred) for each in node.args) and "" not in named
        for each in (*given, *named.values(), function):
            if isinstance(each, Function):
                self._spoil_by_function(each, *((given, named) if each is function and whole else ([], {})), unknown)
            elif isinstance(each, Record) and each.is_class:
                for name in ("__init__", "__post_init__"):
                    made = each.inherited(name)
                    if isinstance(made, Function):
                        self._spoil_by_function(made, [Record(each.name, each.line, {}), *given], named, unknown)
        if isinstance(node.func, ast.Attribute) and not isinstance(function, Function):
            name, owner = node.func.attr, self.peek(node.func.value)
            if name in HARMLESS or isinstance(owner, str) or (isinstance(owner, Record) and owner.is_class and name[:1].isupper()):
                return
            if isinstance(owner, Unknown) and name not in MUTATORS:
                return
            self.spoil_object(node, owner, unknown, f"calls {name} on what is not understood here")
        elif last_name(node.func) in ("setattr", "delattr", "exec") or isinstance(function, Method):
            target = function.this if isinstance(function, Method) else given[0] if given else unknown
            self.spoil_object(node, target, unknown, f"calls {last_name(node.func)} on what is not understood here")

    def _spoil_by_function(self, function: Function, given: list[Any], named: dict[str, Any], unknown: Unknown) -> None:
        if function.node in self._spoiling or len(self._spoiling) >= MOST_CALLS:
            return
        arguments = function.node.args
        every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        every += [each for each in (arguments.vararg, arguments.kwarg) if each is not None]
        names = {each.arg: unknown for each in every} | (self.bound(function, given, named) or {})
        body = [function.node.body] if isinstance(function.node, ast.Lambda) else function.node.body
        self._spoiling.append(function.node)
        try:
            with self.inside(function_scope(function, names), function.source):
                self.spoil_by(body, unknown)
        finally:
            self._spoiling.pop()

    def peek(self, node: ast.expr) -> Any:
        """Value of a node without calling anything; unknown if it needs a call."""
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                return self.found(name, node)
            case ast.Attribute(value=owner, attr=name):
                found = self.peek(owner)
                if isinstance(found, Record):
                    if name == "__dict__":
                        return found.fields
                    if name in found.fields:
                        return found.fields[name]
                    method = found.inherited(name) if found.is_class else found.method(name)
                    if isinstance(method, Function):
                        return replace(method, this=found)
                elif isinstance(found, Unknown) and found.kind == "import":
                    return found
            case ast.Subscript(value=owner, slice=ast.Constant(value=key)):
                found = self.peek(owner)
                with contextlib.suppress(LookupError, TypeError):
                    if isinstance(found, dict | list | tuple) and REST not in found:
                        return found[key]  # type: ignore[index]
        names = [self.found(each.id, each) for each in ast.walk(node) if isinstance(each, ast.Name)]
        unknown = Unknown(node.lineno, text_of(node), source=self.shown_source)
        calls_own = any(isinstance(each, Function) for each in names)
        return unknown.held() if calls_own or self.holds_record(node, *names) else unknown


def changed_names(function: Function, seen: set[ast.AST] | None = None) -> set[str]:
    """Names around a function whose objects a call of it may change."""
    seen = set() if seen is None else seen
    if function.node in seen or len(seen) > MOST_CALLS:
        return set()
    seen.add(function.node)
    body: list[ast.AST] = [function.node.body] if isinstance(function.node, ast.Lambda) else list(function.node.body)
    arguments = function.node.args
    own = {each.arg for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg) if each}
    found: set[str] = set()
    for node in own_nodes(body, ()):
        match node:
            case ast.Global(names=names):
                found |= set(names)
            case ast.Name(id=name, ctx=ast.Store()):
                own.add(name)
            case ast.Attribute(value=owner, ctx=ast.Store() | ast.Del()) | ast.Subscript(value=owner, ctx=ast.Store() | ast.Del()):
                found |= _names_in(owner)
            case ast.Call(func=called, args=given, keywords=named):
                for each in (*given, *(keyword.value for keyword in named)):
                    found |= _names_in(each)
                if isinstance(called, ast.Attribute) and called.attr not in HARMLESS:
                    found |= _names_in(called.value)
                inner = function.scope.find(called.id) if isinstance(called, ast.Name) else None
                if inner is not None and isinstance(inner.value, Function):
                    found |= changed_names(inner.value, seen)
    stated = {name for node in own_nodes(body) if isinstance(node, ast.Global) for name in node.names}
    return found - (own - stated)


def _names_in(node: ast.AST) -> set[str]:
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}


def function_scope(function: Function, names: dict[str, Any]) -> Scope:
    """Scope of a function's body, in which its global and nonlocal names refer to the enclosing scopes."""
    scope = Scope(names, function.scope)
    if isinstance(function.node, ast.Lambda):
        return scope
    for node in own_nodes(function.node.body):
        if isinstance(node, ast.Global):
            scope.outside |= dict.fromkeys(node.names, function.scope.module)
        elif isinstance(node, ast.Nonlocal):
            for name in node.names:
                around: Scope | None = function.scope
                while around is not None and (around.is_class or name not in around.names):
                    around = around.parent
                if around is not None:
                    scope.outside[name] = around
    return scope
