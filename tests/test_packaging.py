"""What is shipped is whole: the wheel alone, in an empty environment, runs the demo's commands."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import xml.etree.ElementTree as ET
import zipfile
from importlib.metadata import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import gainroom

ROOT = Path(__file__).parents[1]


def run(*command: str | Path, cwd: Path) -> str:
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    result = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert not result.returncode, result.stderr[-2000:]
    return result.stdout


def ticks_in_a_program_that_finds(package: str, folder: Path) -> None:
    """The example, configured with the option `package`, runs with the headers from there and not with the sources'."""
    run("cmake", "-S", ROOT / "examples", "-B", "loop", package, cwd=folder)
    run("cmake", "--build", "loop", cwd=folder)
    compiled = (folder / "loop" / "CMakeFiles" / "control_loop.dir" / "flags.make").read_text("utf-8")
    assert str(ROOT) not in compiled
    # Settled in every contact state first, as the program does, no tick of this robot is left without a certificate.
    assert run(folder / "loop" / "control_loop", cwd=folder).splitlines()[-1].startswith("100.0 % of 4000 ticks certified")


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
    python = tmp_path / "empty" / "bin" / "python"
    run(python, ROOT / "scripts" / "smoke.py", cwd=tmp_path)
    headers = run(python, "-c", "import gainroom.native; print(gainroom.native.include_dir())", cwd=tmp_path).strip()
    ticks_in_a_program_that_finds(f"-Dgainroom_DIR={headers}/../cmake", tmp_path)


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


def test_the_lock_serves_every_python_that_the_project_is_developed_with():
    """3.11 or later, as scripts/setup.sh asks for; 3.10, on which it runs, has no newer numpy than 2.2."""
    lines = (ROOT / "requirements-dev.lock").read_text("utf-8").splitlines()
    # .get: a library that some test loads may have put its own metadata in the place of Python's.
    needed = {line: metadata(line.partition("==")[0]).get("Requires-Python") for line in lines}
    assert {line: need for line, need in needed.items() if need and "3.11.0" not in SpecifierSet(need)} == {}


@pytest.mark.slow
def test_cmake_installs_the_headers_without_python(tmp_path: Path):
    run("cmake", "-S", ROOT, "-B", "build", f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'prefix'}", cwd=tmp_path)
    assert "Python" not in (tmp_path / "build" / "CMakeCache.txt").read_text("utf-8")
    run("cmake", "--install", "build", cwd=tmp_path)
    headers = ROOT / "src" / "gainroom" / "native" / "include" / "gainroom"
    assert {path.name for path in (tmp_path / "prefix" / "include" / "gainroom").iterdir()} == {path.name for path in headers.iterdir()}
    share = tmp_path / "prefix" / "share"
    assert f'set(PACKAGE_VERSION "{gainroom.__version__}")' in (share / "gainroom" / "cmake" / "gainroomConfigVersion.cmake").read_text(
        "utf-8"
    )
    assert (share / "gainroom" / "package.xml").is_file()
    assert (share / "ament_index" / "resource_index" / "packages" / "gainroom").is_file()
    ticks_in_a_program_that_finds(f"-DCMAKE_PREFIX_PATH={tmp_path / 'prefix'}", tmp_path)


def test_what_else_names_the_version_names_this_one():
    """__init__.py is read by pip and by CMake; these formats have no way to."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["version"]
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text("utf-8"))["context"]["version"]
    package = ET.parse(ROOT / "package.xml").findtext("version")
    assert {citation, recipe, package} == {gainroom.__version__}


def test_the_recipe_needs_what_the_package_needs():
    def needs(lines: list[str]) -> dict[str, SpecifierSet]:
        return {found.name: found.specifier for found in map(Requirement, lines)}

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text("utf-8"))
    requirements = recipe["requirements"]
    assert needs(requirements["run"]) == needs([*settings["project"]["dependencies"], "python"])
    assert needs(requirements["host"]) == needs([*settings["build-system"]["requires"], "python", "pip"])
    robot = {
        "pinocchio" if name == "pin" else name: bound
        for name, bound in needs(settings["project"]["optional-dependencies"]["robot"]).items()
    }
    assert needs(requirements["run_constraints"]) == robot
    oldest = settings["project"]["requires-python"].removeprefix(">=")
    assert recipe["build"]["skip"] == f'match(python, "<{oldest}")'
    assert min(settings["tool"]["cibuildwheel"]["build"]) == f"cp{oldest.replace('.', '')}-*"


def test_workflows_run_what_there_is():
    """Files, and targets of make, that a step names."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for workflow in (ROOT / ".github" / "workflows").iterdir():
        steps = [step for job in yaml.safe_load(workflow.read_text("utf-8"))["jobs"].values() for step in job["steps"]]
        commands = "\n".join(step.get("run", "") for step in steps)
        assert set(re.findall(r"\bmake ([a-z-]+)", commands)) <= targets
        assert [name for name in re.findall(r"\b(?:tests|scripts|src)/\S+", commands) if not (ROOT / name).exists()] == []
