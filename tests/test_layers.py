"""Data flows one way: nothing imports what stands to its right in LAYERS, and no two modules import each other."""

import ast
import re
from dataclasses import FrozenInstanceError, fields, is_dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import gainroom

PACKAGE = Path(gainroom.__path__[0])
LAYERS = (
    "errors",
    "io",
    "native",
    "system",
    "analysis",
    "robot",
    "design",
    "simulation",
    "trainers",
    "identification",
    "studies",
    "files",
    "report",
    "paper",
    "__init__",
    "app",
    "cli",
    "__main__",
)
"""What stands in the package's folder, lowest first."""
HEAVY = {"numpy", "scipy", "pydantic", "plotly", "rich", "yaml"}


def modules() -> dict[str, Path]:
    """Every module by its dotted name below gainroom, a package by its own."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        *folders, last = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(folders if last == "__init__" and folders else (*folders, last))] = path
    return found


MODULES = modules()


def imported(name: str) -> set[str]:
    """The modules that a module imports, anywhere in it: of a package those that its names come from."""
    path = MODULES[name]
    package = path.relative_to(PACKAGE).parts[:-1]
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = (
                (*package[: len(package) - node.level + 1], *(node.module or "").split("."))
                if node.module
                else package[: len(package) - node.level + 1]
            )
            where = ".".join(base)
            for alias in node.names:
                full = f"{where}.{alias.name}" if where else alias.name
                found.add(full if full in MODULES else where or "__init__")
        elif isinstance(node, ast.Import):
            assert not any(alias.name.split(".")[0] == "gainroom" for alias in node.names), f"{path}: import it relatively"
    return found - {name}


def rank(name: str) -> int:
    return LAYERS.index(name.split(".")[0])


def test_the_package_has_these_layers_and_little_else():
    entries = {path.name.removesuffix(".py") for path in PACKAGE.iterdir() if path.name != "__pycache__"}
    assert entries == {*LAYERS, "py.typed"}
    assert len(entries - {"__init__", "__main__", "py.typed"}) <= 16  # those three are Python's own


@pytest.mark.slow
def test_imports_run_one_way():
    wrong = [f"{name} imports {other}" for name in MODULES for other in imported(name) if other != "__init__" and rank(other) > rank(name)]
    assert not wrong


@pytest.mark.slow
def test_imports_have_no_cycle():
    """Module by module, inside packages too. The front door's own names load when they are asked for."""
    graph = {name: imported(name) - {"__init__"} for name in MODULES if name != "__init__"}
    order = list(TopologicalSorter(graph).static_order())  # raises CycleError
    assert set(order) >= set(graph)


@pytest.mark.parametrize("package", ["analysis", "files", "report", "robot", "robot/formats"])
def test_the_map_of_a_large_package_names_every_file(package):
    """And no other: its docstring is where a reader begins."""
    text = ast.get_docstring(ast.parse((PACKAGE / package / "__init__.py").read_text("utf-8")))
    assert text is not None
    files = {path.stem for path in (PACKAGE / package).iterdir() if path.suffix == ".py"} - {"__init__"}
    folders = {path.name for path in (PACKAGE / package).iterdir() if path.is_dir()}
    named = set(re.findall(r"\w+", text))
    assert files <= named, files - named
    compound = {word for word in named if "_" in word.strip("_")}
    assert compound <= {*files, *folders, "X_text", "X_columns", "X_tables"}, compound - files


def test_importing_the_command_line_costs_little():
    """Nothing heavy at import time in the front door and the command line: `gainroom --help` stays instant."""
    for path in [PACKAGE / "__init__.py", PACKAGE / "__main__.py", *(PACKAGE / "cli").glob("*.py")]:
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Import):
                assert not {alias.name.split(".")[0] for alias in node.names} & HEAVY, path
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] not in HEAVY, path


@pytest.mark.parametrize("name", [name for name in gainroom.__all__ if is_dataclass(getattr(gainroom, name))])
def test_what_the_package_shows_does_not_change_in_a_users_hands(name: str):
    """Results are kept and shared by who asks again: an attribute that is set would be everyone's."""
    shown = getattr(gainroom, name)
    made = object.__new__(shown)
    with pytest.raises(FrozenInstanceError):
        setattr(made, fields(shown)[0].name, None)
