"""Data flows one way: nothing imports what stands to its right in LAYERS."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import gainroom

PACKAGE = Path(gainroom.__path__[0])
LAYERS = (
    ("messages", "arrays", "files"),
    ("errors", "remembered"),
    ("text_file",),
    ("compiled",),
    ("factored", "_scan", "_mu", "_balls"),
    ("_batch",),
    ("_walk",),
    ("_peaks",),
    ("statespace", "sampling"),
    ("lti",),
    ("plant", "drive", "controller"),
    ("uncertainty",),
    ("robot",),
    ("crossings", "acceleration", "sampled_scan"),
    ("assembly",),
    ("loop", "box_loops"),
    ("calm",),
    ("sweep",),
    ("stability", "region_curves", "_disk_modes"),
    ("robustness", "forbidden", "multiloop_disk"),
    ("critical",),
    ("limits", "range_proof", "plausible"),
    ("coupled",),
    ("part_limits", "kept"),
    ("region", "slopes"),
    ("recommend", "coupled_gains"),
    ("study",),
    ("robot_spec",),
    ("simulation",),
    ("simulation_spec",),
    ("played_vibration",),
    ("simulation_study", "verification"),
    ("robot_cases",),
    ("robot_gains",),
    ("robot_states",),
    ("robot_words",),
    ("robot_study", "robot_vibration"),
    ("robot_play",),
    ("robot_play_words",),
    ("robot_verification", "robot_simulation"),
    ("audit",),
    ("io",),
    ("config_sections", "file_kinds"),
    ("gain_files",),
    ("robot_values",),
    ("robot_scenario_sections",),
    ("robot_sections", "scenario_sections"),
    ("config", "robot_config", "report", "reproduce"),
    ("audit_config",),
    ("__init__",),
    ("cli",),
    ("__main__",),
)
RANKS = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}
HEAVY = {"numpy", "scipy", "numba", "pydantic", "plotly", "rich", "yaml"}


def source_files() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def top_name(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Names of the modules of gainroom that a file imports, anywhere in it."""
    package = ("gainroom", *path.relative_to(PACKAGE).parts[:-1])
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, node.module)) if node.module else ".".join(base)
            names.update(f"{module}.{alias.name}" for alias in node.names)
    parts = [name.split(".") for name in names if name.split(".")[0] == "gainroom"]
    return {part[1] for part in parts if len(part) > 1 and part[1] in RANKS}


def test_every_module_has_its_place():
    assert {top_name(path) for path in source_files()} <= set(RANKS)


def test_imports_run_one_way():
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {name}"
        for path in source_files()
        for name in imported(path) - {top_name(path)}
        if RANKS[name] > RANKS[top_name(path)]
    ]
    assert not wrong


def test_imports_have_no_cycle():
    graph: dict[str, set[str]] = {}
    for path in source_files():
        graph.setdefault(top_name(path), set()).update(imported(path) - {top_name(path)})
    order = list(TopologicalSorter(graph).static_order())  # raises CycleError
    assert set(order) >= set(graph)


def test_importing_the_command_line_costs_little():
    """Nothing heavy at import time in the front door and the command line: `gainroom --help` stays instant."""
    for path in [PACKAGE / "__init__.py", PACKAGE / "__main__.py", *(PACKAGE / "cli").glob("*.py")]:
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Import):
                assert not {alias.name.split(".")[0] for alias in node.names} & HEAVY, path
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] not in HEAVY, path
