"""Mutants of src/gainroom, and which of them the tests kill.

    python scripts/mutants.py [--seed 1] [--count 60] [--only FOLDER] [--limit 120]     make them, test each, print a table
    python scripts/mutants.py --list ...                                                  the table without a test
    python scripts/mutants.py --pick 3,17 [--tests tests/test_loop.py ...] ...           some of them, with chosen tests

A mutant is the package with one place changed: a number, a sign, an operator, a comparison, `and` or `or`, a term or factor left out.
Places are drawn with a seed, in every folder of FOLDERS as many as its lines ask for, and uniformly within it; type hints, `__all__` and
strings are none. Everything else in the file stays letter by letter.

Tests run in a temporary copy of the tree, file by file, nearest first. Nearness is a distance in the graph of names: a test that names the
changed definition is near, one that names a function that names it is one step further, as is one whose file imports one file more on the
way; a step along a name that many definitions share is longer, and slow tests are two steps further. The first failure kills the mutant;
so does a test, or an import, that says nothing for `--hang` seconds, which the table tells apart. Every test that killed then runs on the
unchanged copy: one that fails there as well is left out, and its mutants are tested again.

"Survived" means: no test failed that began within `--limit` seconds. A more distant test might; and a mutant may be equivalent, which
a reader has to judge. The same commit, seed, count and folder give the same mutants; how many tests run in time depends on the machine.
"""

import argparse
import ast
import heapq
import itertools
import math
import os
import random
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from bisect import bisect
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path("src/gainroom")
FOLDERS = (
    "analysis",
    "design",
    "robot",
    "system",
    "simulation",
    "identification",
    "studies",
    "files",
    "io",
    "report",
    "cli",
    "app",
    "paper",
)  # native is C++ and has tests of its own


# --- places and what becomes of them -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mutant:
    """One change of one file: the bytes from `start` to `end` become `after`; `definition` is what holds them, as Class.method."""

    path: Path
    line: int
    start: int
    end: int
    before: str
    after: str
    definition: str

    def text(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.end :]


OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%", ast.Pow: "**", ast.MatMult: "@"}
OTHER_OPERATOR = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "*", "**": "*"}
COMPARISONS = {
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">=")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<=")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
}
TOKEN = re.compile(r"#[^\n]*|not\s+in|is\s+not|[<>=!]=|\*\*|//|[-+*/%@<>]|\b(?:in|is|and|or)\b")
ATOMS = (ast.Name, ast.Attribute, ast.Call, ast.Subscript, ast.Constant, ast.List, ast.Tuple, ast.Dict, ast.Set)
SEQUENCES = (ast.List, ast.Tuple, ast.JoinedStr, ast.ListComp)
TYPES = ("Literal", "Annotated", "ClassVar")


class Places:
    """The places of one file: for each, the mutants that it has."""

    def __init__(self, path: Path, source: bytes):
        self.path, self.source = path, source
        self.lines = [0, *(found.end() for found in re.finditer(rb"\n", source))]
        self.found: list[list[Mutant]] = []
        self.visit(ast.parse(source), ())

    def span(self, node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.lines[node.lineno - 1] + node.col_offset, self.lines[node.end_lineno - 1] + node.end_col_offset

    def written(self, node: ast.expr, alone: bool = False) -> str:
        """The text of an expression; in parentheses where it would mix with what stands around it."""
        start, end = self.span(node)
        text = self.source[start:end].decode()
        return text if alone or isinstance(node, ATOMS) else f"({text})"

    def visit(self, node: ast.AST, inside: tuple[str, ...]) -> None:
        """Every place below a node."""
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            inside = (*inside, node.name)
        elif not inside and isinstance(node, (ast.Assign, ast.AnnAssign)):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            inside = (target.id,) if isinstance(target, ast.Name) else inside
        if isinstance(node, ast.expr):
            self.add(node, ".".join(inside))
        for name, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST) and name not in ("annotation", "returns") and not is_no_place(child):
                    self.visit(child, inside)

    def add(self, node: ast.expr, definition: str) -> None:
        whole = self.span(node)
        changes: list[tuple[tuple[int, int], str]] = []
        match node:
            case ast.Constant(value=bool(value)):
                changes = [(whole, str(not value))]
            case ast.Constant(value=int(value)):
                changes = [(whole, str(value + 1)), (whole, str(value - 1) if value else "(-1)")]
            case ast.Constant(value=float(value)):
                changes = [(whole, repr(2 * value if value else 1.0))]
            case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
                changes = [(whole, self.written(operand))]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS and not any(map(is_text, (left, right))):
                token = OPERATORS[type(op)]
                if token in OTHER_OPERATOR and not isinstance(left, SEQUENCES) and not isinstance(right, SEQUENCES):
                    changes.append((self.token(left, right, token), OTHER_OPERATOR[token]))
                changes += [(whole, self.written(kept)) for kept in ((left, right) if token in "+*@" else (left,))]
            case ast.Compare(left=left, ops=ops, comparators=right):
                for op, (a, b) in zip(ops, itertools.pairwise([left, *right]), strict=True):
                    token, others = COMPARISONS[type(op)]
                    where = self.token(a, b, token)
                    self.keep([(where, other) for other in others], definition)
            case ast.BoolOp(op=op, values=values):
                token, other, neutral = ("and", "or", "True") if isinstance(op, ast.And) else ("or", "and", "False")
                if len(values) == 2:
                    changes.append((self.token(*values, token), other))
                changes += [(self.span(value), neutral) for value in values]
        self.keep(changes, definition)

    def keep(self, changes: list[tuple[tuple[int, int], str]], definition: str) -> None:
        if changes:
            self.found.append(
                [
                    Mutant(self.path, bisect(self.lines, start), start, end, self.source[start:end].decode(), after, definition)
                    for (start, end), after in changes
                ]
            )

    def token(self, left: ast.expr, right: ast.expr, token: str) -> tuple[int, int]:
        """Start and end (bytes) of an operator between its operands, past parentheses and comments."""
        start, end = self.span(left)[1], self.span(right)[0]
        gap = self.source[start:end].decode()
        for found in TOKEN.finditer(gap):
            if not found[0].startswith("#"):
                assert re.sub(r"\s+", " ", found[0]) == token, (self.path, gap, token)
                before = start + len(gap[: found.start()].encode())
                return before, before + len(found[0].encode())
        raise AssertionError((self.path, gap, token))


def is_no_place(node: ast.AST) -> bool:
    """True of what is not computed when a program runs, and of f-strings, whose parts Python 3.11 does not locate."""
    match node:
        case ast.JoinedStr():
            return True
        case ast.Assign(targets=[ast.Name(id="__all__")]) | ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Subscript(value=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name in TYPES
    return False


def is_text(node: ast.expr) -> bool:
    """True of a string, whose signs are no arithmetic."""
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes)))


def draw(root: Path, seed: int, count: int, folders: Iterable[str]) -> list[Mutant]:
    """So many mutants, in each folder as many as its share of the lines (largest remainders, at least one), each of another place."""
    files = {folder: sorted((root / PACKAGE / folder).rglob("*.py")) for folder in folders}
    lines = {folder: sum(path.read_bytes().count(b"\n") for path in paths) for folder, paths in files.items()}
    chosen = []
    for folder, number in shares(lines, count).items():
        rng = random.Random(f"{seed} {folder}")
        places = [place for path in files[folder] for place in Places(path.relative_to(root), path.read_bytes()).found]
        rng.shuffle(places)
        chosen += itertools.islice(filter(None, (chosen_of(place, root, rng) for place in places)), number)
    return sorted(chosen, key=lambda mutant: (mutant.path, mutant.start))


def chosen_of(place: list[Mutant], root: Path, rng: random.Random) -> Mutant | None:
    """One mutant of a place, if Python reads it: `not in` stands in no `for`."""
    mutant = rng.choice(place)
    try:
        ast.parse(mutant.text((root / mutant.path).read_bytes()))
    except SyntaxError:
        return None
    return mutant


def shares(weights: dict[str, int], count: int) -> dict[str, int]:
    """The count divided in proportion to weights, at least one each."""
    total = sum(weights.values())
    exact = {name: count * weight / total for name, weight in weights.items()}
    found = {name: max(1, int(value)) for name, value in exact.items()}
    for name in sorted(exact, key=lambda name: exact[name] - found[name], reverse=True)[: max(0, count - sum(found.values()))]:
        found[name] += 1
    return found


# --- which tests are near -------------------------------------------------------------------------------------------------------------


@dataclass
class Definition:
    """A function, method, class or constant of the package or the tests.

    mentions   the names in it, each with the file that it comes from, None where that is not known, and what a mention costs
    """

    path: Path
    name: str
    inside: str
    mentions: dict[str, tuple[Path | None, float]]
    is_test: bool
    slow: bool

    @property
    def qualified(self) -> str:
        return f"{self.inside}.{self.name}" if self.inside else self.name


SLOW = 2.0
"""So many steps further a slow test is."""
TEXT, ATTRIBUTE = 1.5, 0.5
"""Extra cost of a name in a text, as a command or a key, and of one behind a dot, which may be another object's."""
FAR = 6.0
"""Imports away is a test at most."""


def definitions(path: Path, tree: ast.Module, homes: dict[str, tuple[str, Path | None]]) -> Iterator[Definition]:
    """Those at the top of a file, and in its classes; `homes`: names that it imports, with their own name and their file."""
    marks = [node for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"]
    names = {node.name: node for node in tree.body if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))}

    def made(node: ast.AST, name: str, inside: str = "") -> Definition:
        decorators = [*getattr(node, "decorator_list", ()), *marks]
        marked = " ".join(ast.unparse(decorator) for decorator in decorators)
        is_test = name.startswith("test_") and isinstance(node, ast.FunctionDef) and path.name.startswith("test_")
        is_test = is_test and not inside and "mark.population" not in marked
        found: dict[str, tuple[Path | None, float]] = {}
        for part in ast.walk(node):
            match part:
                case ast.Name(id=called) if called in homes:
                    own, home = homes[called]
                    found[own] = (home, 0.0)
                case ast.Name(id=called):
                    found[called] = (path, 0.0)
                case ast.arg(arg=called) if called in names or is_test:  # a fixture
                    found[called] = (path if called in names else Path("tests/conftest.py"), 0.0)
                case ast.Attribute(attr=called) | ast.keyword(arg=str(called)) | ast.alias(name=called):
                    found.setdefault(called, (None, ATTRIBUTE))
                case ast.Constant(value=str(text)) if text.replace("-", "_").isidentifier():
                    found.setdefault(text.replace("-", "_"), (None, TEXT))
        return Definition(path, name, inside, found, is_test, "mark.slow" in marked)

    for node in tree.body:
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield made(node, node.name)
            case ast.ClassDef():
                yield made(node, node.name)
                for part in node.body:
                    if isinstance(part, (ast.FunctionDef, ast.AsyncFunctionDef)):
                        yield made(part, part.name, node.name)
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                yield made(node, name)


class NameGraph:
    """Definitions of the package and the tests, joined by the names that they mention."""

    def __init__(self, root: Path):
        trees = {
            path.relative_to(root): ast.parse(path.read_bytes()) for part in (PACKAGE, "tests") for path in (root / part).rglob("*.py")
        }
        self.all: list[Definition] = []
        self.importers: dict[Path, set[Path]] = defaultdict(set)
        for path, tree in trees.items():
            homes = imported(path, tree, trees)
            self.all += definitions(path, tree, homes)
            for _, used in homes.values():
                if used is not None:
                    self.importers[used].add(path)
        self.at = {(found.path, found.qualified): index for index, found in enumerate(self.all)}
        self.in_package = [PACKAGE in found.path.parents for found in self.all]
        self.by_mention: dict[str, list[tuple[int, Path | None, float]]] = defaultdict(list)
        self.named: dict[str, int] = defaultdict(int)
        for index, found in enumerate(self.all):
            self.named[found.name] += 1
            for name, (home, cost) in found.mentions.items():
                self.by_mention[name].append((index, home, cost))

    @cache  # noqa: B019 - one graph, as long as the script runs
    def users(self, path: Path) -> dict[Path, int]:
        """The files that import one, directly or not, with how many imports away they are; itself, 0."""
        found, new = {path: 0}, [path]
        for file in new:
            more = self.importers[file] - found.keys()
            found |= dict.fromkeys(more, found[file] + 1)
            new += sorted(more)
        return found

    @cache  # noqa: B019
    def mentioning(self, path: Path, name: str) -> list[tuple[int, float]]:
        """Definitions that mention a name and can mean the one that `path` defines, with the cost of a step to each."""
        users, shared = self.users(path), math.log2(self.named[name]) / 2
        return [
            (index, 1 + cost + (0.0 if home else shared))
            for index, home, cost in self.by_mention[name]
            if home in (None, path) and (not self.in_package[index] or self.all[index].path in users)
        ]

    def nearest_tests(self, mutant: Mutant) -> list[list[str]]:
        """All tests, as pytest names them, by file, slow ones apart: nearest first, of equally near ones the shorter."""
        parts = mutant.definition.split(".")
        own = [index for (path, _), index in self.at.items() if path == mutant.path]
        starts = [self.at[mutant.path, name] for name in (".".join(parts[:2]), parts[0]) if (mutant.path, name) in self.at][:1] or own
        distance, queue = {}, [(0.0, index) for index in starts]
        while queue:
            so_far, index = heapq.heappop(queue)
            if index in distance:
                continue
            distance[index] = so_far
            here = self.all[index]
            for other, step in self.mentioning(here.path, here.name):
                if other not in distance:
                    heapq.heappush(queue, (so_far + step, other))
            if here.inside:
                heapq.heappush(queue, (so_far + (0.2 if here.name.startswith("__") else 1.0), self.at[here.path, here.inside]))
        users, ranked = self.users(mutant.path), []
        for index, names in distance.items():
            if (test := self.all[index]).is_test:
                far = names + min(users.get(test.path, FAR), FAR) + SLOW * test.slow
                ranked.append((far, len(test.mentions), test.slow, f"{test.path}::{test.name}"))
        units: dict[tuple[str, bool], list[str]] = {}  # in the order of their nearest test
        for *_, slow, name in sorted(ranked):
            units.setdefault((name.partition("::")[0], slow), []).append(name)
        return list(units.values())


def imported(path: Path, tree: ast.Module, files: dict[Path, ast.Module]) -> dict[str, tuple[str, Path | None]]:
    """The names that a file imports from others of the package or the tests, anywhere in it: what they are called there, and which it is.

    Of names that the package itself shows the file is not known.
    """
    found: dict[str, tuple[str, Path | None]] = {}
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom):
            continue
        module = (node.module or "").split(".") if node.module else []
        base = path.parents[node.level - 1] if node.level else Path("src") if module[0] == "gainroom" else Path("tests")
        base = base.joinpath(*module)
        for alias in node.names:
            homes = (base / f"{alias.name}.py", base / alias.name / "__init__.py", base.with_suffix(".py"), base / "__init__.py")
            home = next((file for file in homes if file in files), None)
            found[alias.asname or alias.name] = (alias.name, None if home == PACKAGE / "__init__.py" else home)
    return found


# --- running them ---------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """Outcome of a pytest process: the tests that failed, the one it hung in, and how many passed."""

    failed: tuple[str, ...]
    hung: str
    passed: int


class Copy:
    """A copy of the tree, in which tests run; the tree itself is never touched."""

    def __init__(self, root: Path, folder: Path, hang: float):
        self.folder, self.hang, self.stamp = folder, hang, time.time() - 1e6
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=root, capture_output=True, check=True, text=True
        )
        core = [str(path.relative_to(root)) for path in (root / PACKAGE / "native").glob("_core.*")]
        for name in {*filter(None, listed.stdout.split("\0")), *core}:
            if (root / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, folder / name)
        self.environment = os.environ | {"PYTHONPATH": str(folder / "src"), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        asked = [sys.executable, "-c", "import gainroom; print(gainroom.__file__)"]
        said = subprocess.run(asked, env=self.environment, cwd=folder, capture_output=True, text=True, check=True).stdout
        assert Path(said.strip()).is_relative_to(folder.resolve()), f"the copy's tests import {said}"

    def write(self, path: Path, text: bytes) -> None:
        """A file with a time of its own: Python knows compiled files by whole seconds and the length, which + and − share."""
        self.stamp += 10
        (self.folder / path).write_bytes(text)
        os.utime(self.folder / path, (self.stamp, self.stamp))

    def run(self, tests: list[str], deadline: float, first: bool) -> Run:
        """Tests in the order given, until one fails where `first`, until the deadline between two of them, or until one hangs."""
        command = [sys.executable, "-m", "pytest", "-v", "--tb=no", "-rfE", "--no-header", "-p", "no:cacheprovider", *["-x"] * first]
        process = subprocess.Popen(
            [*command, *tests],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        assert process.stdout is not None
        output, hung, late = b"", "", False
        try:
            while True:
                if not select.select([process.stdout], [], [], self.hang)[0]:
                    hung = output.decode(errors="replace").rsplit("\n", 1)[-1].split(" ")[0] or "the import"
                    break
                data = os.read(process.stdout.fileno(), 1 << 16)
                output += data
                late = time.monotonic() > deadline
                if not data or late:
                    break
        finally:
            if process.poll() is None and (hung or late or sys.exc_info()[0]):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            process.stdout.close()
        said = output.decode(errors="replace")
        outcomes = [
            re.match(r"(tests/\S+?::.*?) (FAILED|ERROR)\b|(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", line) for line in said.split("\n")
        ]
        failed = tuple(dict.fromkeys(found[1] or found[3] for found in outcomes if found))
        if not (failed or hung or late) and process.returncode not in (0, 5):
            failed = (said.rsplit("\n", 1)[-1].split(" ")[0] or f"pytest, exit status {process.returncode}",)
        return Run(failed, hung, len(re.findall(r" PASSED\b", said)))


@dataclass
class Verdict:
    """Outcome of a mutant: killed by a test or survived, after `ran` tests in `seconds` [s]."""

    mutant: Mutant
    killer: str = ""
    hung: bool = False
    ran: int = 0
    exhausted: bool = False
    seconds: float = 0.0

    def text(self) -> str:
        if not self.killer:
            return f"SURVIVED {self.ran} tests" + (", all there are" if self.exhausted else "")
        return ("killed, timeout in " if self.hung else "killed by ") + self.killer


def verdict_of(mutant: Mutant, copy: Copy, source: bytes, tests: list[list[str]], limit: float) -> Verdict:
    """The mutant's end, by tests of more and more files in a process: to read one takes as long as some of its tests."""
    verdict, begun = Verdict(mutant), time.monotonic()
    copy.write(mutant.path, mutant.text(source))
    try:
        at, size = 0, 2
        while at < len(tests) and time.monotonic() - begun < limit:
            run = copy.run(list(itertools.chain(*tests[at : at + size])), begun + limit, first=True)
            verdict.ran += run.passed
            if run.failed or run.hung:
                verdict.killer, verdict.hung = (run.hung or run.failed[0]), bool(run.hung)
                break
            at, size = at + size, 2 * size
        verdict.exhausted = at >= len(tests) and time.monotonic() - begun < limit
    finally:
        copy.write(mutant.path, source)
    verdict.seconds = time.monotonic() - begun
    return verdict


def failing_unchanged(copy: Copy, killers: Iterable[str]) -> set[str]:
    """Tests among `killers` that fail or hang without a mutant, too."""
    left, bad = sorted(killers), set()
    while left:
        run = copy.run(left, math.inf, first=False)
        bad |= {*run.failed, *filter(None, [run.hung])}
        left = left[left.index(run.hung) + 1 :] if run.hung in left else []
    return bad


def main() -> int:
    """Exit status 0: which survivors matter a reader says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--only", choices=FOLDERS, action="append", metavar="FOLDER", help="repeat it for several")
    parser.add_argument("--limit", type=float, default=120.0, metavar="SECONDS", help="of testing for one mutant (120)")
    parser.add_argument("--hang", type=float, default=90.0, metavar="SECONDS", help="without a word, after which a test hangs (90)")
    parser.add_argument("--list", action="store_true", help="show the mutants and their nearest tests, run nothing")
    parser.add_argument("--pick", type=lambda text: [int(part) for part in text.split(",")], metavar="K,...", help="their numbers")
    parser.add_argument("--tests", nargs="+", metavar="TEST", help="run these instead of the nearest")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # the copy goes, and what runs in it
    mutants = draw(ROOT, asked.seed, asked.count, asked.only or FOLDERS)
    numbers = asked.pick or range(1, len(mutants) + 1)
    if asked.tests:
        tests = {number: [asked.tests] for number in numbers}
    else:
        graph = NameGraph(ROOT)
        tests = {number: graph.nearest_tests(mutants[number - 1]) for number in numbers}
    if asked.list:
        for number in numbers:
            print(row(number, mutants[number - 1], " ".join(names[0].removeprefix("tests/") for names in tests[number][:4])))
        return 0
    verdicts: dict[int, Verdict] = {}
    with tempfile.TemporaryDirectory(prefix="gainroom-mutants-") as folder:
        copy = Copy(ROOT, Path(folder), asked.hang)
        bad: set[str] = set()
        due = list(numbers)
        while due:
            for number in due:
                mutant = mutants[number - 1]
                source = (copy.folder / mutant.path).read_bytes()
                fair = [[test for test in names if not any(name.startswith(test) for name in bad)] for names in tests[number]]
                verdicts[number] = verdict_of(mutant, copy, source, fair, asked.limit)
                print(row(number, mutant, f"{verdicts[number].text()} ({verdicts[number].seconds:.0f} s)"), flush=True)
            bad |= failing_unchanged(copy, {verdict.killer for verdict in verdicts.values() if verdict.killer} - bad)
            due = [number for number, verdict in verdicts.items() if verdict.killer in bad]
    print("\n" + summary(verdicts, bad))
    return 0


def row(number: int, mutant: Mutant, end: str) -> str:
    """A line of the table."""
    before, after = (re.sub(r"\s+", " ", text) for text in (mutant.before, mutant.after))
    return f"{number:3}  {mutant.path.relative_to(PACKAGE)}:{mutant.line}  {before} → {after}  {end}"


def summary(verdicts: dict[int, Verdict], bad: set[str]) -> str:
    """Number of mutants killed, and a row for each that survived."""
    killed = [verdict for verdict in verdicts.values() if verdict.killer]
    hung = sum(verdict.hung for verdict in killed)
    lines = [f"{len(killed)} of {len(verdicts)} mutants killed, {hung} of them by a timeout; {len(verdicts) - len(killed)} survived"]
    lines += [row(number, verdict.mutant, verdict.text()) for number, verdict in sorted(verdicts.items()) if not verdict.killer]
    lines += [f"left out, as it fails without a mutant: {name}" for name in sorted(bad)]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
