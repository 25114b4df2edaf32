"""scripts/mutants.py: what it changes, by hand; that a draw can be drawn again; how mutants of a package of two lines end."""

import ast
import subprocess
from pathlib import Path

import pytest

from scripts.mutants import ROOT, Copy, Mutant, NameGraph, Places, draw, shares, verdict_of

LINES = {
    "x = a - b": {"x = a + b", "x = a"},
    "x = (a + b) * c": {"x = (a + b) / c", "x = (a + b)", "x = c", "x = (a - b) * c", "x = (a) * c", "x = (b) * c"},
    "x = -a ** 2": {"x = (a ** 2)", "x = -a * 2", "x = -a", "x = -a ** 3", "x = -a ** 1"},
    "x = a  <  b is not c": {"x = a  <=  b is not c", "x = a  >  b is not c", "x = a  <  b is c"},
    "x = not (a and b)": {"x = (a and b)", "x = not (a or b)", "x = not (True and b)", "x = not (a and True)"},
    "x: Literal[1] = 0.5 if True else 0": {
        "x: Literal[1] = 1.0 if True else 0",
        "x: Literal[1] = 0.5 if False else 0",
        "x: Literal[1] = 0.5 if True else 1",
        "x: Literal[1] = 0.5 if True else (-1)",
    },
    "µ = 'ä' + a if (  # in\n    b) in c else 'x' 'y'": {"µ = 'ä' + a if (  # in\n    b) not in c else 'x' 'y'"},
    "def f(x: tuple[int, 3]) -> 4:\n    '''a - 1'''\n    return f'{x - 1}'": set(),
    "__all__ = ['a'] * 2": set(),
}
PACKAGE = """\
def larger(a, b):
    return a if a > b else b


def halvings(a):
    count = 0
    while a > 0:
        a //= 2
        count += 1
    return count
"""
TESTS = """\
from gainroom.sizes import halvings, larger


def test_larger():
    assert larger(1, 2) == larger(2, 1) == 2


def test_halvings():
    assert halvings(8) == 4
"""


@pytest.mark.parametrize("line", LINES)
def test_every_mutant_of_a_line(line: str):
    found = Places(Path("x.py"), line.encode()).found
    assert {mutant.text(line.encode()).decode() for place in found for mutant in place} == LINES[line]


def test_a_draw_can_be_drawn_again_and_changes_one_place_each():
    mutants = draw(ROOT, 3, 12, ["io", "app"])
    assert mutants == draw(ROOT, 3, 12, ["io", "app"]) != draw(ROOT, 4, 12, ["io", "app"])
    assert len({(mutant.path, mutant.start, mutant.end) for mutant in mutants}) == 12
    for mutant in mutants:
        source = (ROOT / mutant.path).read_bytes()
        assert source[mutant.start : mutant.end].decode() == mutant.before
        assert source.count(b"\n", 0, mutant.start) == mutant.line - 1
        assert ast.dump(ast.parse(mutant.text(source))) != ast.dump(ast.parse(source))


def test_shares_are_in_proportion_and_none_is_empty():
    assert shares({"a": 500, "b": 310, "c": 189, "d": 1}, 20) == {"a": 10, "b": 6, "c": 3, "d": 1}
    assert shares({"a": 2, "b": 1}, 10) == {"a": 7, "b": 3}


@pytest.fixture
def tree(tmp_path):
    """A package of two functions under git, with a test of each."""
    root = tmp_path / "tree"
    for name, text in (("src/gainroom/__init__.py", ""), ("src/gainroom/sizes.py", PACKAGE), ("tests/test_sizes.py", TESTS)):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    return root


@pytest.mark.slow
def test_mutants_are_killed_hang_or_survive_in_a_copy(tree, tmp_path):
    path = Path("src/gainroom/sizes.py")
    source, graph = PACKAGE.encode(), NameGraph(tree)
    copy = Copy(tree, tmp_path, hang=5.0)
    ends = {}
    for mutant in (mutant for place in Places(path, source).found for mutant in place if mutant.before == ">"):
        assert isinstance(mutant, Mutant)
        tests = graph.nearest_tests(mutant)
        assert tests == [[f"tests/test_sizes.py::test_{mutant.definition}"]]
        found = verdict_of(mutant, copy, source, tests, 60.0)
        ends[mutant.definition, mutant.after] = (found.killer, found.hung, found.exhausted)
    larger, halvings = "tests/test_sizes.py::test_larger", "tests/test_sizes.py::test_halvings"
    assert ends == {
        ("larger", ">="): ("", False, True),  # of two equal numbers either is the larger
        ("larger", "<"): (larger, False, False),
        ("halvings", ">="): (halvings, True, False),  # 0 // 2 is 0 for ever
        ("halvings", "<"): (halvings, False, False),
    }
    assert (tree / path).read_text() == (tmp_path / path).read_text() == PACKAGE
