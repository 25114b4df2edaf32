"""Kernels' cache on disk: it saves compiling where it is whole, and never stands in the way where it is not."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core.caching import CacheImpl

KERNEL = """
from gainroom.analysis.compiled import cached_njit

@cached_njit(error_model="numpy")
def halved(x):
    return x / 2

@cached_njit(error_model="numpy")
def first(x):
    return x[0]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "kernel.py"
    path.write_text(KERNEL, "utf-8")
    return path


def loaded(file: Path) -> ModuleType:
    """The module afresh, as another process would have it: with nothing compiled yet."""
    spec = importlib.util.spec_from_file_location("kernel", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cached(file: Path, ending: str) -> list[Path]:
    return sorted((file.parent / "__pycache__").glob(f"*.{ending}"))


def hits(module: ModuleType) -> int:
    return sum(module.halved.stats.cache_hits.values())


def test_a_whole_cache_is_used(file: Path):
    assert loaded(file).halved(3.0) == 1.5
    again = loaded(file)
    assert again.halved(3.0) == 1.5
    assert hits(again) == 1


def test_a_changed_kernel_beside_it_is_compiled_anew(file: Path):
    """Kernels call each other across files."""
    beside = file.with_name("_beside.py")
    beside.write_text("", "utf-8")
    assert loaded(file).halved(3.0) == 1.5
    beside.write_text("# changed\n", "utf-8")
    again = loaded(file)
    assert again.halved(3.0) == 1.5
    assert hits(again) == 0


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", ["empty", "half", "other bytes", "one bit", "a folder"])
def test_a_damaged_cache_is_made_anew(file: Path, ending: str, damage: str):
    loaded(file).halved(3.0)
    (path,) = cached(file, ending)
    whole = path.read_bytes()
    path.unlink()
    if damage == "a folder":
        path.mkdir()
    else:
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 1
        contents = {"empty": b"", "half": whole[: len(whole) // 2], "other bytes": bytes(len(whole)), "one bit": bytes(flipped)}
        path.write_bytes(contents[damage])
    damaged = loaded(file)
    assert damaged.halved(3.0) == 1.5
    if damage != "a folder":
        mended = loaded(file)
        assert mended.halved(3.0) == 1.5
        assert hits(mended) == 1


def test_code_under_the_name_of_another_is_not_run(file: Path):
    """Two processes that fill an empty cache at once both call their first file number 1: one's index may lead to the other's code."""
    double, single = np.array([1.5, 2.5]), np.array([1.5, 2.5], dtype=np.float32)
    kernels = loaded(file)
    assert kernels.first(double) == kernels.first(single) == 1.5
    one, two = cached(file, "nbc")
    contents = one.read_bytes(), two.read_bytes()
    two.write_bytes(contents[0])
    one.write_bytes(contents[1])
    mixed = loaded(file)
    assert mixed.first(single) == 1.5
    assert mixed.first(double) == 1.5


def test_without_any_place_it_compiles_all_the_same(file: Path, monkeypatch: pytest.MonkeyPatch):
    """As in a read-only installation with a home that cannot be written."""
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    assert loaded(file).halved(3.0) == 1.5


def test_a_full_disk_costs_the_cache_alone(file: Path):
    """No file may grow beyond 100 bytes."""
    program = (
        "import resource, sys; sys.path.insert(0, sys.argv[1])\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
        "import kernel; print(kernel.halved(3.0))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [sys.executable, "-B", "-c", program, str(file.parent)]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (run.stdout, run.stderr) == ("1.5\n", "")
