"""What the names of a Python file hold, from its syntax tree: the file is read as text, never imported, compiled or run.

Understood are numbers, text, lists and dictionaries of them, arithmetic, names of the same file, a few functions of `math` and numpy,
and calls with keywords, which become records: configurations are made of these. Whatever else there is becomes Unknown, with its line,
and is an error only where somebody asks for it.
"""

import ast
import copy
import warnings
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

from ...errors import GainroomError, first_of_many, nearest
from ...io.yaml_text import shown
from .python_expressions import CONSTANTS, HARMLESS, MATH, Expressions, Record, Unknown, has_record, last_name, text_of

SET_UP = ("__post_init__", "__init__")
"""Methods that change what a call makes; the first is also the field that says so."""
NOT_RUN = "may change the configuration, and is not run"


@dataclass
class PythonValues:
    """The names of a Python file and what they hold; `functions` of the file are not run."""

    source: str
    names: dict[str, Any] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    functions: list[ast.AST] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def one_robot(robots: Collection[str], source: str, chosen: str, what: str, kind: str) -> str:
    """The name among `robots` that is `chosen`, or the only one. Raises GainroomError, with `what` they have and the `kind` of name."""
    if chosen and chosen not in robots:
        raise GainroomError(f"{source}: {shown(chosen)} holds no {what}{nearest(chosen, tuple(robots), kind)}")
    first = next(iter(robots))
    if not chosen and len(robots) > 1:
        named = f"name one, {source}:{first} ({first_of_many(tuple(robots))})"
        raise GainroomError(f"{source}: holds the {what} of {len(robots)} robots; {named}")
    return chosen or first


def read_python(text: str, source: str, guarded: tuple[str, ...]) -> PythonValues:
    """The module-level names of a Python text that messages call `source`.

    guarded   fields that must not be changed where this cannot follow, as in a loop

    Raises GainroomError, one line, for text that is no Python, or is too large or too deep.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of escapes in text that is no raw string, as regular expressions have them
            tree = ast.parse(text)
    except SyntaxError as error:
        raise GainroomError(f"{source}: line {error.lineno or 1}: is no Python: {error.msg}") from error
    except (ValueError, RecursionError, MemoryError) as error:
        raise GainroomError(f"{source}: is no Python that can be read here: {type(error).__name__}") from error
    reader = _Reader(PythonValues(source), guarded)
    try:
        reader.block(tree.body)
    except RecursionError as error:
        raise GainroomError(f"{source}: is nested too deeply") from error
    reader.values.notes = reader.notes
    return reader.values


class _Reader(Expressions):
    """Evaluates statements in their order, as far as they are understood."""

    def __init__(self, values: PythonValues, guarded: tuple[str, ...]) -> None:
        super().__init__(values.source, values.names)
        self.values = values
        self.guarded = guarded

    def block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                found = self.value(value)
                for target in targets:
                    self._assign(target, found)
            case ast.AnnAssign(target=target, value=value) if value is not None:
                self._assign(target, self.value(value))
            case ast.AugAssign(target=target, op=op, value=value):
                before = self.value(ast.copy_location(_loaded(target), target))
                self._assign(target, self.arithmetic(node, op, before, self.value(value)))
            case ast.ClassDef():
                self.names[node.name] = self._class(node)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                self.names[node.name] = Unknown(node.lineno, f"{node.name}()", "is a function of this file, which is not run", "function")
                self.values.functions.append(node)
            case ast.Import() | ast.ImportFrom():
                self._import(node)
            case ast.If(test=test) if _is_false(test):
                self.block(node.orelse)
            case ast.If() | ast.For() | ast.While() | ast.With() | ast.Try() | ast.Match():
                self._unfollowed(node)
            case ast.Expr(value=ast.Call(func=ast.Attribute(value=owner, attr=method), args=args)):
                self._changed_by_call(node, owner, method, args)
            case ast.Expr(value=ast.Call() as call):
                self.value(call)
            case ast.Delete(targets=targets):
                for target in targets:
                    self._assign(target, Unknown(node.lineno, "del"))

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        origin = f"from {node.module or '.'}" if isinstance(node, ast.ImportFrom) else "import"
        for alias in node.names:
            name = (alias.asname or alias.name).partition(".")[0]
            unread = Unknown(node.lineno, alias.name, f"comes with `{origin[:60]}`, and other files are not read", "import")
            constant = isinstance(node, ast.ImportFrom) and node.module in MATH and alias.name in CONSTANTS
            self.names[name] = CONSTANTS[alias.name] if constant else unread

    def _assign(self, target: ast.expr, value: Any) -> None:
        match target:
            case ast.Name(id=name):
                self.names[name] = value
                self.values.lines[name] = target.lineno
            case ast.Tuple(elts=targets) | ast.List(elts=targets):
                fits = isinstance(value, list | tuple) and len(value) == len(targets)
                whole = list(value) if fits else [_as_unknown(value, target)] * len(targets)
                for each, found in zip(targets, whole, strict=True):
                    self._assign(each, found)
            case ast.Attribute(value=owner, attr=name):
                found = self.value(owner)
                if isinstance(found, Record):
                    found.fields[name] = value
                elif name in self.guarded:
                    raise self.refusal(target, f"changes {name} of what is not understood here")
            case ast.Subscript(value=owner, slice=index):
                self._assign_entry(target, self.value(owner), self.value(index), value)

    def _assign_entry(self, node: ast.expr, owner: Any, key: Any, value: Any) -> None:
        in_list = isinstance(owner, list) and type(key) is int and -len(owner) <= key < len(owner)
        if in_list or (isinstance(owner, dict) and isinstance(key, str | int | float)):
            owner[key] = value  # type: ignore[index]
        elif has_record(owner):
            raise self.refusal(node, "changes an entry that is not understood here")

    def _unfollowed(self, node: ast.stmt) -> None:
        """A statement that is not followed: what it may change is unknown afterwards."""
        for each in ast.walk(node):
            self.count(each)
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
                self.names[each.id] = Unknown(each.lineno, each.id, "is set inside a block (if, for, with, …), which is not followed")
            elif isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store) and each.attr in self.guarded:
                raise self.refusal(each, f"changes {each.attr} inside a block (if, for, with, …), which is not followed")
            elif isinstance(each, ast.Subscript) and isinstance(each.ctx, ast.Store):
                if has_record(self.value(each.value)):
                    raise self.refusal(each, "changes an entry inside a block (if, for, with, …), which is not followed")
            elif isinstance(each, ast.Call):
                self.leaves_alone(each)

    def _changed_by_call(self, node: ast.stmt, owner: ast.expr, method: str, args: list[ast.expr]) -> None:
        """list.append(x), dict.update(x): known; others may change what they are called on."""
        found = self.value(owner)
        given = [self.value(arg) for arg in args]
        if isinstance(found, list) and method == "append" and len(given) == 1:
            found.append(given[0])
        elif isinstance(found, list) and method == "extend" and len(given) == 1 and isinstance(given[0], list | tuple):
            found.extend(given[0])
        elif isinstance(found, dict) and method == "update" and len(given) == 1 and isinstance(given[0], dict):
            found.update(given[0])
        elif method not in HARMLESS and has_record(found):
            raise self.refusal(node, f"calls {method} on a configuration, which is not followed")

    def _class(self, node: ast.ClassDef) -> Record:
        """The class's own fields over those of the classes of this file that it inherits from."""
        record = Record(node.name, node.lineno, {}, (node.name,), True)
        for base in node.bases:
            found = self.value(base)
            if isinstance(found, Record):
                record.fields |= self.deep_copy(node, found.fields)
                record.kinds += found.kinds
            else:
                record.kinds += (last_name(base),)
        outer, names = self.names, dict(self.names)
        self.names = names
        for statement in node.body:
            if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
                if statement.name in SET_UP:
                    record.fields[SET_UP[0]] = Unknown(statement.lineno, f"{node.name}.{statement.name}()", NOT_RUN)
                continue
            self._statement(statement)
            record.fields |= {name: names[name] for name in _stored(statement) if name in names}
        self.names = outer
        return record


def _is_false(test: ast.expr) -> bool:
    """if TYPE_CHECKING, if __name__ == "__main__": what a reader of the module never sees."""
    if isinstance(test, ast.Compare):
        return isinstance(test.left, ast.Name) and test.left.id == "__name__"
    return last_name(test) == "TYPE_CHECKING"


def _loaded(target: ast.expr) -> ast.expr:
    """The target of an assignment, to be read."""
    result = copy.copy(target)
    result.ctx = ast.Load()  # type: ignore[attr-defined]
    return result


def _stored(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.ClassDef):
        return [node.name]
    return [each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)]


def _as_unknown(value: Any, node: ast.expr) -> Unknown:
    return value if isinstance(value, Unknown) else Unknown(node.lineno, text_of(node))
