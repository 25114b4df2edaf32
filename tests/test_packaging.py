"""What is shipped is whole: the wheel alone, in an empty environment, runs the demo's commands."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import metadata
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[1]


def run(*command: str | Path, cwd: Path, status: int = 0) -> str:
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    result = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert result.returncode == status, result.stderr[-2000:]
    return result.stdout


@pytest.mark.slow
@pytest.mark.parametrize("options", [["--no-isolation"], pytest.param([], marks=pytest.mark.population, id="in an empty environment")])
def test_the_wheel_alone_runs_the_demo(tmp_path: Path, options: list[str]):
    """Built with this environment's tools and the core that build/ holds compiled; or with nothing but what pyproject.toml asks for."""
    run(sys.executable, "-m", "build", "--wheel", *options, "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {"gainroom/py.typed", "gainroom/files/examples/testbed.yaml"} <= set(names)
    assert not [name for name in names if not re.match(r"gainroom(-[\d.]+\.dist-info)?/", name)]
    run(sys.executable, "-m", "venv", "--without-pip", "empty", cwd=tmp_path)
    run(sys.executable, "-m", "pip", "--python", "empty", "install", "-q", "--no-compile", wheel, cwd=tmp_path)
    gainroom = tmp_path / "empty" / "bin" / "gainroom"
    (tmp_path / "testbed.yaml").write_text(run(gainroom, "example", "testbed", cwd=tmp_path), "utf-8")
    words = (gainroom, "joint", "testbed.yaml", "--json", "--report", "testbed.html")
    facts = json.loads(run(*words, cwd=tmp_path, status=1))  # the paper's own gains: stable, but 80 instead of 70 vibrates
    assert facts["stable"] is True
    assert (tmp_path / "testbed.html").stat().st_size > 10_000


@pytest.mark.slow
def test_the_source_distribution_holds_sources_alone(tmp_path: Path):
    """Built where a virtual environment, a core and other builds may lie about."""
    run(sys.executable, "-c", "import sys, scikit_build_core.build as b; b.build_sdist(sys.argv[1])", tmp_path, cwd=ROOT)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
    tops = {name.partition("/")[0] for name in names}
    assert {"src", "tests", "docs", "scripts", "pyproject.toml", "CMakeLists.txt", "LICENSE"} <= tops
    assert not tops & {".venv", "build", "dist", ".git", ".ci"}
    assert "src/gainroom/native/include/gainroom/scan.hpp" in names
    assert not [name for name in names if name.endswith((".so", ".pyd", ".pyc"))]


def test_the_lock_pins_every_dependency_and_names_no_host():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    lines = (ROOT / "requirements-dev.lock").read_text("utf-8").splitlines()
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+]+", line) for line in lines)
    pinned = {re.sub(r"[-_.]+", "-", line.partition("==")[0]).lower() for line in lines}
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["docs"], *extras["dev"]]
    names = [re.match(r"[A-Za-z0-9._-]+", text)[0] for text in wanted]  # type: ignore[index]
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in names} - {"gainroom"} <= pinned


def test_the_lock_serves_every_python_that_the_project_does():
    lines = (ROOT / "requirements-dev.lock").read_text("utf-8").splitlines()
    # .get: a library that some test loads may have put its own metadata in the place of Python's.
    needed = {line: metadata(line.partition("==")[0]).get("Requires-Python") for line in lines}
    assert {line: need for line, need in needed.items() if need and "3.11.0" not in SpecifierSet(need)} == {}
