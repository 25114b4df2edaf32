"""Values of the names of a Python file, from its syntax tree: the file is read as text, never imported, compiled or run.

Statements are followed in their order, as Python would run them, as long as every turn is known. What is not known becomes Unknown,
with its line, and is an error only where somebody asks for it; names from other files are read from files beside, where they lie there.
"""

import ast
import sys
import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import GainroomError, first_of_many, nearest
from ...io.yaml_text import read_text, shown
from .python_calls import COPYING, Return
from .python_expressions import FALSE, Expressions
from .python_library import CONSTANTS, MODULES, OF_MATH, NotKnown
from .python_objects import (
    REST,
    Array,
    Function,
    Member,
    Once,
    Partial,
    Record,
    Scope,
    Unknown,
    is_key,
    is_open,
    last_name,
    linear,
    spoil,
    text_of,
    truth,
)
from .python_undecided import Budget, TooLong, Undecided, changed_names, own_nodes

MOST_FILES = 20
"""Maximum number of files beside the main one that are read with it."""
LEAVES = (ast.Return, ast.Break, ast.Continue, ast.Raise, ast.Yield, ast.YieldFrom)
ENUMERATIONS = ("Enum", "Flag")
"""Enumerations whose members are not values; members of IntEnum and StrEnum are."""
HARMLESS_DECORATORS = ("final", "unique", "total_ordering", "runtime_checkable", "dataclass_transform")
MAKES_FIELDS = ("dataclass", "configclass", "define", "frozen")
"""Decorators of classes whose names are fields; the base NamedTuple has the same effect."""


class Break(Exception):  # noqa: N818
    """Raised when a loop ends."""


class Continue(Exception):  # noqa: N818
    """Raised when a loop continues."""


@dataclass
class PythonValues:
    """Names of a Python file with their values and lines.

    call   the value of a function that needs no arguments
    make   an object of a class that needs none
    """

    source: str
    names: dict[str, Any] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    call: Callable[[Function], Any] = lambda function: None
    make: Callable[[Record], Any] = lambda kind: None


def one_robot(robots: Collection[str], source: str, chosen: str, what: str, kind: str) -> str:
    """Name among `robots` that is `chosen`, or the only one.

    Raises GainroomError, with `what` they have and the `kind` of name.
    """
    if chosen and chosen not in robots:
        raise GainroomError(f"{source}: {shown(chosen)} holds no {what}{nearest(chosen, tuple(robots), kind)}")
    first = next(iter(robots))
    if not chosen and len(robots) > 1:
        named = f"name one, {source}:{first} ({first_of_many(tuple(robots))})"
        raise GainroomError(f"{source}: holds the {what} of {len(robots)} robots; {named}")
    return chosen or first


def read_python(text: str, source: str, guarded: tuple[str, ...], folder: Path | None = None) -> PythonValues:
    """Module-level names of a Python text that messages call `source`.

    guarded   fields that must not be changed where it is not known whose they are
    folder    of the file, in which others that it names are read; None: none is

    Raises GainroomError, one line, for text that is no Python, or is too large or too deep.
    """
    reader = _Reader(source, guarded, _Beside(folder, guarded, source))
    try:
        reader.module(parsed(text, source))
    except RecursionError as error:
        raise GainroomError(f"{source}: is nested too deeply") from error
    values = PythonValues(source, reader.scope.names, reader.lines, reader.notes)
    values.call = reader.without_arguments
    values.make = reader.object_of
    return values


def parsed(text: str, source: str) -> ast.Module:
    """Syntax tree of a text. Raises GainroomError, one line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of escapes in text that is no raw string, as regular expressions have them
            return ast.parse(text)
    except SyntaxError as error:
        raise GainroomError(f"{source}: line {error.lineno or 1}: is no Python: {error.msg}") from error
    except (ValueError, RecursionError, MemoryError) as error:
        raise GainroomError(f"{source}: is no Python that can be read here: {type(error).__name__}") from error


class _Beside:
    """Files in the folder of the main one, each read once, and the number of steps that they may take together."""

    def __init__(self, folder: Path | None, guarded: tuple[str, ...], main: str) -> None:
        self.folder = folder.resolve() if folder is not None else None
        self.guarded = guarded
        self.main = main
        self.budget = Budget()
        self._names: dict[Path, dict[str, Any] | str] = {}

    def names(self, module: str, level: int, source: str) -> tuple[dict[str, Any] | str, str]:
        """Names of a module with their values, or the reason why they are not known; and the file's name."""
        path = self._path(module, level, source)
        if path is None:
            return "and other files are not read, unless they lie beside this one", ""
        shown_as = str(Path(self.main).parent / path.relative_to(self.folder or path))
        if path not in self._names:
            self._names[path] = self._read(path, shown_as)
        return self._names[path], shown_as

    def _read(self, path: Path, source: str) -> dict[str, Any] | str:
        if len(self._names) >= MOST_FILES:
            return f"and more than {MOST_FILES} files are not read"
        self._names[path] = "which is being read: these files name each other"
        reader = _Reader(source, self.guarded, self)
        try:
            reader.module(parsed(read_text(path), source))
        except GainroomError as error:
            return f"which cannot be read: {error}"
        return reader.scope.names

    def _path(self, module: str, level: int, source: str) -> Path | None:
        """Path of a module's file inside the folder: named relatively, by itself, or with the names of the enclosing folders."""
        if self.folder is None:
            return None
        words = module.split(".") if module else []
        here = (self.folder / Path(source).relative_to(Path(self.main).parent)).parent
        if level:
            for _ in range(level - 1):
                here = here.parent
            if not here.is_relative_to(self.folder):
                return None
        elif words and words[0] in sys.stdlib_module_names:
            return None
        else:
            count = next((k for k in range(len(words), 0, -1) if self.folder.parts[-k:] == tuple(words[:k])), 0)
            words, here = words[count:], self.folder
        place = here.joinpath(*words)
        for path in (place / "__init__.py", place.with_suffix(".py") if words else place / "__init__.py"):
            if path.is_file() and path.resolve().is_relative_to(self.folder):
                return path
        return None


class _Reader(Expressions):
    """Interpreter of the statements of one file."""

    def __init__(self, source: str, guarded: tuple[str, ...], beside: _Beside) -> None:
        super().__init__(source, guarded, beside.main, beside.budget)
        self.beside = beside
        self.lines: dict[str, int] = {}

    def module(self, tree: ast.Module) -> None:
        for statement in tree.body:
            self.next_statement()
            try:
                self._statement(statement)
            except Undecided as turn:
                self.spoil_by([statement], turn.unknown)
            except TooLong:
                self.next_statement()
                try:
                    self.undecided(statement, [statement], "takes too many steps")
                except TooLong as error:
                    raise self.refusal(statement, "takes too many steps, and so does telling what it changes") from error

    def without_arguments(self, function: Function) -> Any:
        """Value of a function of the file that needs no arguments."""
        self.next_statement()
        try:
            return self.call(function.node, function, [], {})
        except (TooLong, RecursionError):
            return Unknown(function.node.lineno, f"{function.name}()", "takes too many steps")

    def object_of(self, kind: Record) -> Any:
        """Instance of a class of the file, made without arguments."""
        self.next_statement()
        node = ast.Pass(lineno=kind.line)
        try:
            return self.call(node, kind, [], {})
        except (TooLong, RecursionError, GainroomError) as error:
            why = str(error) if isinstance(error, GainroomError) else "takes too many steps"
            return Unknown(kind.line, f"{kind.name}()", f"cannot be made: {why}")

    def block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        self.count(node)
        self._depth += 1
        try:
            self._one(node)
        except NotKnown:
            self._not_decided(node)
        finally:
            self._depth -= 1

    def _one(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                found = self.value(value)
                for target in targets:
                    self.assign(target, found)
            case ast.AnnAssign(target=target, annotation=annotation, value=value):
                if any(isinstance(each, ast.Call) for each in ast.walk(annotation)):
                    self.undecided(annotation, [annotation])
                if value is not None:
                    self.assign(target, self.value(value))
            case ast.AugAssign(target=target, op=op, value=value):
                self._changed_in_place(node, target, op, value)
            case ast.ClassDef():
                self._store(node, self._class(node))
            case ast.FunctionDef():
                self._store(node, self._function(node))
            case ast.AsyncFunctionDef():
                self._store(node, Unknown(node.lineno, node.name, "is a coroutine, which is not followed", source=self.shown_source))
            case ast.Import() | ast.ImportFrom():
                self._import(node)
            case ast.If(test=test, body=body, orelse=orelse):
                self._if(node, test, body, orelse)
            case ast.For() | ast.While():
                self._loop(node)
            case ast.With(items=items) if any(_swallows(item.context_expr) for item in items):
                self._not_decided(node)
            case ast.With(items=items, body=body):
                for item in items:
                    found = self.value(item.context_expr)
                    if item.optional_vars is not None:
                        self.assign(item.optional_vars, self.unknown(item.context_expr, found))
                self.block(body)
            case ast.Return(value=value):
                raise Return(None if value is None else self.value(value))
            case ast.Break():
                raise Break
            case ast.Continue():
                raise Continue
            case ast.Raise():
                raise Undecided(Unknown(node.lineno, text_of(node), "ends it with an error", is_free=False, source=self.shown_source))
            case ast.Expr(value=value):
                self.discarded = value
                self.value(value)
            case ast.Delete(targets=targets):
                for target in targets:
                    self._deleted(target)
            case ast.Try(body=body, handlers=handlers) if _imports(body, ()) and all(
                _imports(each.body, (ast.Assign,)) for each in handlers
            ):
                self._imported_either_way(node)
            case ast.Assert(test=test):
                self.value(test)
            case ast.Pass() | ast.Global() | ast.Nonlocal():
                pass
            case _:
                self._not_decided(node)

    def _imported_either_way(self, node: ast.Try) -> None:
        """Executes try: import …, except: import …: a name that both store stands for the library's object; other names are unknown."""
        self.block(node.body)
        first = {each: self._last_name_of(each) for each in _stored(node.body)}
        for handler in node.handlers:
            for statement in handler.body:
                for name in _stored([statement]):
                    other = _imported_name(statement, name)
                    if other is None or first.get(name, other) != other:
                        self.scope.store(name, self.undecided(node, [statement]))
                    elif name not in first:
                        self._statement(statement)
        self.block([*node.orelse, *node.finalbody])

    def _last_name_of(self, name: str) -> str | None:
        found = self.scope.find(name)
        return found.value.path.rpartition(".")[2] if found is not None and isinstance(found.value, Unknown) else None

    def _not_decided(self, node: ast.stmt) -> None:
        """Skips a statement that is not followed: all that it may change is unknown afterwards, and later statements may be skipped."""
        unknown = Unknown(node.lineno, text_of(node), "cannot be decided without running the file", is_free=False, source=self.shown_source)
        unknown = Unknown(node.lineno, unknown.text.partition(":")[0], unknown.why, is_free=False, source=self.shown_source)
        self.spoil_by([node], unknown)
        if any(isinstance(each, LEAVES) for each in own_nodes([node])):
            raise Undecided(unknown)

    def _if(self, node: ast.stmt, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt]) -> None:
        found = self.value(test)
        turn = False if isinstance(found, Unknown) and found.path in FALSE else truth(found)
        if turn is None and isinstance(body[-1], ast.Raise):
            turn = False  # the file is one that can be imported
        if turn is None:
            self._not_decided(node)
        else:
            self.block(body if turn else orelse)

    def _loop(self, node: ast.For | ast.While) -> None:
        if isinstance(node, ast.For):
            items = self.iterated(node, self.value(node.iter))
            if items is None:
                raise NotKnown
        else:
            items = iter(lambda: self._decided(self.value(node.test)), False)
        try:
            for item in items:
                self.count(node)
                if isinstance(node, ast.For):
                    self.assign(node.target, item)
                try:
                    self.block(node.body)
                except Continue:
                    continue
            self.block(node.orelse)
        except Break:
            pass

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        for alias in node.names:
            if isinstance(node, ast.Import):
                path = alias.name if alias.asname else alias.name.partition(".")[0]
                names, _ = self.beside.names(alias.name, 0, self.source)
                value: Any = self._unread(node, path, f"comes with `import {alias.name[:60]}`", names)
                if isinstance(names, dict) and (alias.asname or "." not in alias.name):
                    value = Record(alias.name, node.lineno, names, ("module",), source=self.source)
                self.scope.store(alias.asname or path, value)
                continue
            module = node.module or ""
            dotted = "." * node.level + module
            names, file = self.beside.names(module, node.level, self.source)
            if alias.name == "*":
                self._import_all(node, dotted, names)
                continue
            if isinstance(names, dict) and alias.name not in names:
                inner, _ = self.beside.names(f"{module}.{alias.name}" if module else alias.name, node.level, self.source)
                if isinstance(inner, dict):
                    names = {alias.name: Record(alias.name, node.lineno, inner, ("module",), source=self.source)}
                else:
                    names = f"and {file} has no such name"
            elif isinstance(names, str) and not file and node.level and not module:
                inner, _ = self.beside.names(alias.name, node.level, self.source)
                names = (
                    {alias.name: Record(alias.name, node.lineno, inner, ("module",), source=self.source)}
                    if isinstance(inner, dict)
                    else names
                )
            if isinstance(names, dict):
                value = names[alias.name]
            elif MODULES.get(module, module) in OF_MATH and alias.name in CONSTANTS:
                value = CONSTANTS[alias.name]
            else:
                value = self._unread(node, f"{dotted}.{alias.name}", f"comes with `from {dotted[:60]}`", names)
            self.scope.store(alias.asname or alias.name, value)

    def _unread(self, node: ast.stmt, path: str, origin: str, names: dict[str, Any] | str) -> Unknown:
        why = f"{origin}, {names if isinstance(names, str) else 'and other files are not read'}"
        return Unknown(node.lineno, path.rpartition(".")[2], why, "import", path, source=self.shown_source)

    def _import_all(self, node: ast.stmt, dotted: str, names: dict[str, Any] | str) -> None:
        """Executes from x import *: all names of a file beside, or unknown names, which may include those of this file."""
        if isinstance(names, dict):
            chosen = names.get("__all__")
            public = chosen if isinstance(chosen, list | tuple) else [name for name in names if not name.startswith("_")]
            for name in public:
                if name in names:
                    self.scope.store(name, names[name])
            return
        for name, value in list(self.scope.names.items()):
            if not (isinstance(value, Unknown) and value.kind == "import"):
                self.scope.store(name, self._unread(node, name, f"may come with `from {dotted[:60]} import *`", names))

    def _store(self, node: ast.stmt, value: Any) -> None:
        self.scope.store(node.name, value)  # type: ignore[attr-defined]
        self._note_line(node.name, node)  # type: ignore[attr-defined]

    def _note_line(self, name: str, node: ast.AST) -> None:
        if self.scope.parent is None:
            self.lines[name] = getattr(node, "lineno", 0)

    def assign(self, target: ast.expr, value: Any) -> None:
        if isinstance(value, Once):
            value = self.stored_once(target, value)
        match target:
            case ast.Name(id=name):
                self.scope.store(name, value)
                self._note_line(name, target)
            case ast.Tuple(elts=targets) | ast.List(elts=targets):
                for each, found in zip(targets, self._unpacked(target, targets, value), strict=True):
                    self.assign(each.value if isinstance(each, ast.Starred) else each, found)
            case ast.Attribute(value=owner, attr=name):
                found = self.value(owner)
                if isinstance(found, Record):
                    self.set_field(target, found, name, value)
                elif isinstance(found, Unknown) and not found.is_free and name in self.guarded:
                    raise self.refusal(target, f"changes {name} of what is not understood here")
            case ast.Subscript(value=owner, slice=index):
                self._assign_entry(target, self.value(owner), self._index(index), value)

    def _unpacked(self, node: ast.expr, targets: list[ast.expr], value: Any) -> list[Any]:
        items = self.iterated(node, value)
        found = None if items is None else list(items)
        star = next((k for k, each in enumerate(targets) if isinstance(each, ast.Starred)), None)
        if found is not None and star is not None and len(found) >= len(targets) - 1:
            end = len(found) - (len(targets) - 1 - star)
            found = [*found[:star], found[star:end], *found[end:]]
        if found is None or len(found) != len(targets):
            return [self.unknown(node, value)] * len(targets)
        return found

    def _assign_entry(self, node: ast.expr, owner: Any, key: Any, value: Any) -> None:
        match owner:
            case dict() if is_key(key):
                owner[key] = value
            case Array():
                spoil(owner, self.unknown(node, key, value, why="changes an array, which others may see, too"))
            case list() if type(key) is int and -len(owner) <= key < len(owner) and not is_open(owner):
                owner[key] = value
            case list() if isinstance(key, slice) and isinstance(value, list | tuple) and not is_open(owner):
                try:
                    owner[key] = list(value)
                except ValueError as error:
                    raise NotKnown from error
            case _:
                self.spoil_object(node, owner, self.unknown(node, key, value), "changes an entry of what is not understood here")

    def _changed_in_place(self, node: ast.stmt, target: ast.expr, op: ast.operator, value: ast.expr) -> None:
        before = self._loaded(target)
        more = self.value(value)
        if isinstance(before, Array):
            spoil(before, self.unknown(node, more, why="changes an array, which others may see, too"))
            more = before
        elif isinstance(before, list) and isinstance(op, ast.Add):
            items = self.iterated(node, more)
            before.extend(list(items) if items is not None else [self.unknown(value, more).many()])
            more = before
        elif isinstance(before, dict) and isinstance(op, ast.BitOr):
            if isinstance(more, dict) and REST not in more:
                before |= more
            else:
                spoil(before, self.unknown(value, more))
            more = before
        else:
            more = self.arithmetic(node, op, before, more)
        self.assign(target, more)

    def _loaded(self, target: ast.expr) -> Any:
        match target:
            case ast.Name(id=name):
                return self.found(name, target)
            case ast.Attribute(value=owner, attr=name):
                return self.attribute(target, self.value(owner), name)
            case ast.Subscript(value=owner, slice=index):
                try:
                    return self._entry(self.value(owner), self._index(index))
                except NotKnown as error:
                    return self.unknown(target, *([error.because] if error.because else []))
        return self.unknown(target)

    def _deleted(self, target: ast.expr) -> None:
        match target:
            case ast.Name(id=name):
                self.scope.names.pop(name, None)
            case ast.Attribute(value=owner, attr=name):
                found = self.value(owner)
                if isinstance(found, Record):
                    found.fields.pop(name, None)
                elif isinstance(found, Unknown) and not found.is_free and name in self.guarded:
                    raise self.refusal(target, f"changes {name} of what is not understood here")
            case ast.Subscript(value=owner, slice=index):
                found, key = self.value(owner), self._index(index)
                known = isinstance(found, dict) and is_key(key) and REST not in found and key in found
                if known or (
                    isinstance(found, list) and isinstance(key, int | slice) and not any(isinstance(each, Unknown) for each in found)
                ):
                    try:
                        del found[key]  # type: ignore[arg-type]
                        return
                    except LookupError:
                        pass
                self.spoil_object(target, found, self.unknown(target), "deletes an entry of what is not understood here")

    def _function(self, node: ast.FunctionDef) -> Any:
        made = Function(node.name, node, self.scope, self.defaults(node.args), self.source)
        others: list[ast.expr] = []
        for each in node.decorator_list:
            name = last_name(each.func if isinstance(each, ast.Call) else each)
            if name in ("staticmethod", "classmethod", "property", "cached_property"):
                made.kind = "property" if name == "cached_property" else name
            elif name not in ("cache", "lru_cache", "wraps", "override", "overload"):
                others.append(each)
        result: Any = made
        for each in reversed(others):
            function = self.value(each)
            if not isinstance(function, Function | Partial):
                return Unknown(node.lineno, f"@{text_of(each)[:60]}", "is not followed", is_free=False, source=self.shown_source)
            result = self.call(each, function, [result], {})
        return result

    def _class(self, node: ast.ClassDef) -> Any:
        """Class with its own fields, and with the classes of this file that it inherits from."""
        bases = [self.value(base) for base in node.bases]
        known = tuple(base for base in bases if isinstance(base, Record) and base.is_class)
        decorators = [last_name(each.func if isinstance(each, ast.Call) else each) for each in node.decorator_list]
        is_tuple = "NamedTuple" in map(last_name, node.bases)
        fields_by_name = any(name in MAKES_FIELDS for name in decorators) or is_tuple
        foreign = [base.path for base in bases if isinstance(base, Unknown)]
        record = Record(node.name, node.lineno, {}, (node.name,), True, source=self.source, bases=known, foreign=tuple(foreign))
        ancestors = linear(known)
        for base, written in zip(bases, node.bases, strict=True):
            record.kinds += base.kinds if isinstance(base, Record) else (last_name(written),)
        record.ancestors = ancestors or ()
        record.is_copied = (
            "configclass" in decorators or any(each.startswith(COPYING) for each in foreign) or any(base.is_copied for base in known)
        )
        record.is_plain = not fields_by_name and all(base.is_plain for base in known) and not foreign
        record.own_order = tuple(_dataclass_names(node)) if fields_by_name else ()
        order = [name for each in reversed(record.lineage) for name in each.own_order]
        record.order = tuple(dict.fromkeys(order)) if not foreign or is_tuple else ()
        stated = {name for each in own_nodes(node.body) if isinstance(each, ast.Global) for name in each.names}
        with self.inside(Scope(record.fields, self.scope, dict.fromkeys(stated, self.scope.module), is_class=True)):
            self.block(node.body)
        for name, value in record.fields.items():
            if isinstance(value, Function) and value.owner is None:
                value.owner = record
            if isinstance(value, Function) and name.startswith("__") and name not in ("__init__", "__post_init__"):
                self._may_run_at_any_time(value)
        if problem := self._not_followed_in(node, record, ancestors, bases):
            return Unknown(node.lineno, f"class {node.name}", problem, is_free=False, source=self.shown_source)
        if any(kind in ENUMERATIONS for kind in record.kinds):
            record.is_enumeration = True
            is_mixed = len(node.bases) > 1 or "Flag" in record.kinds  # with text or a number, which it may be equal to
            record.fields = {key: _member(key, value, is_mixed) for key, value in record.fields.items()}
        return self._decorated(node, record)

    def _may_run_at_any_time(self, function: Function) -> None:
        """Makes unknown, from here on, all that a special method may change: ==, len() and many other operations may run it at any time."""
        shown_source = Unknown(
            function.node.lineno, f"def {function.name}", "may be run at any time, and change it", is_free=False, source=self.shown_source
        )
        for name in changed_names(function):
            scope = self.scope.module
            if name in scope.names:
                spoil(scope.names[name], shown_source)
            if name in scope.names and not isinstance(scope.names[name], Function | Record | Unknown):
                scope.unstable[name] = shown_source
                scope.store(name, scope.names[name])
            elif name not in scope.names:
                scope.unstable[name] = shown_source

    def _not_followed_in(self, node: ast.ClassDef, record: Record, ancestors: tuple[Record, ...] | None, bases: list[Any]) -> str:
        """Reason why a class is not followed; "" if it is."""
        if ancestors is None:
            return "inherits in an order that is not followed"
        metaclass = next((each.value for each in node.keywords if each.arg == "metaclass"), None)
        if metaclass is not None and last_name(metaclass) not in ("ABCMeta", "EnumMeta", "EnumType"):
            return f"has the metaclass {text_of(metaclass)}, which is not followed"
        written = {getattr(each, "attr", getattr(each, "id", "")) for each in ast.walk(node)}
        record.private = frozenset(name for name in written if name.startswith("__") and not name.endswith("__"))
        if any(record.private & each.private for each in ancestors):
            return "has a private name that a class which it inherits from has, too"
        if any("__init_subclass__" in each.fields for each in ancestors):
            return "inherits __init_subclass__, which is not followed"
        if any("InitVar" in text_of(each.annotation) for each in node.body if isinstance(each, ast.AnnAssign)):
            return "has an InitVar, which is not followed"
        first = next((place for place, base in enumerate(bases) if isinstance(base, Unknown)), len(bases))
        if first < len(bases) and any(isinstance(base, Record) for base in bases[first + 1 :]):
            return f"inherits from {text_of(node.bases[first])} before others, and may have any name from it"
        return ""

    def _decorated(self, node: ast.ClassDef, record: Record) -> Any:
        """Class after its decorators."""
        result: Any = record
        for each in reversed(node.decorator_list):
            name = last_name(each.func if isinstance(each, ast.Call) else each)
            if name in MAKES_FIELDS or name in HARMLESS_DECORATORS or name.startswith("register"):
                continue
            function = self.value(each)
            if not isinstance(function, Function | Partial):
                return Unknown(node.lineno, f"@{text_of(each)[:60]}", "is not followed", is_free=False, source=self.shown_source)
            result = self.call(each, function, [result], {})
        return result


def _swallows(node: ast.expr) -> bool:
    """True if a context manager suppresses errors, so that its block may have ended at any statement."""
    return last_name(node.func if isinstance(node, ast.Call) else node) in ("suppress", "raises", "ExitStack")


def _imports(body: list[ast.stmt], more: tuple[type[ast.stmt], ...]) -> bool:
    return all(isinstance(each, (ast.Import, ast.ImportFrom, ast.Pass, *more)) for each in body)


def _stored(body: list[ast.stmt]) -> list[str]:
    """Names that imports and assignments store."""
    aliases = [each for statement in body for each in ast.walk(statement) if isinstance(each, ast.alias)]
    names = [inner.id for each in body for inner in ast.walk(each) if isinstance(inner, ast.Name) and isinstance(inner.ctx, ast.Store)]
    return [*((each.asname or each.name).partition(".")[0] for each in aliases), *names]


def _imported_name(statement: ast.stmt, name: str) -> str | None:
    """Original name of an imported name; None if the statement imports no such name."""
    if not isinstance(statement, ast.Import | ast.ImportFrom):
        return None
    return next((each.name.rpartition(".")[2] for each in statement.names if (each.asname or each.name).partition(".")[0] == name), None)


def _dataclass_names(node: ast.ClassDef) -> list[str]:
    """Positional parameters of a dataclass."""
    written = [each for each in node.body if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name) and _has_place(each)]
    return [each.target.id for each in written if "ClassVar" not in text_of(each.annotation)]  # type: ignore[union-attr]


def _has_place(node: ast.AnnAssign) -> bool:
    """False if field(init=False) or field(kw_only=True) takes the name out of the positional parameters."""
    keywords = node.value.keywords if isinstance(node.value, ast.Call) else []
    return not any(each.arg in ("init", "kw_only") for each in keywords)


def _member(name: str, value: Any, is_mixed: bool) -> Any:
    return value if isinstance(value, Function) or name.startswith("_") else Member(name, value, is_mixed)
