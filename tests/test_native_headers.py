"""The core's headers in a C++ program of their own: the same digits as through Python, and nothing that the sanitizers find."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gainroom.analysis.crossings import scan
from gainroom.linear.transfer_function import Factored
from gainroom.native import include_dir
from test_crossings import KINDS

SOURCES = Path(__file__).with_name("native")
STRICT = ["-std=c++17", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def compiled(name: str, folder: Path) -> Path:
    """With sanitizers, where the compiler has them."""
    compiler = os.environ.get("CXX") or shutil.which("c++") or "build/native/c++"
    if shutil.which(compiler) is None:
        pytest.skip("no C++ compiler")
    path = folder / name
    command = [compiler, *STRICT, f"-I{include_dir()}", str(SOURCES / f"{name}.cpp"), "-o", str(path)]
    done = subprocess.run([*command, *SANITIZED], capture_output=True, text=True, check=False)
    if done.returncode:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    return path


def output(program: Path, lines: str = "") -> str:
    # The look for leaks needs to trace the process, which containers may forbid.
    environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}
    done = subprocess.run([str(program)], input=lines, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled("scans", tmp_path_factory.mktemp("native"))


def test_limits_of_random_and_hostile_coupled_loops_end(tmp_path: Path):
    """Loops of 0 to 60 joints; NaN, infinite, zero, huge and tiny values in every kind of place."""
    ordinary, _ = output(compiled("limits", tmp_path)).split()
    assert int(ordinary) > 10


def scanned(program: Path, loops: list[Factored]) -> list[list[float]]:
    """Of each loop: certified, the numbers of crossings, half turns, crossings and peaks."""
    lines = []
    for loop in loops:
        numbers = [loop.gain, loop.delay, loop.sample_time or 0.0]
        for root in (*loop.zeros, *loop.poles):
            numbers += [root.real, root.imag]
        lines.append(" ".join([str(len(loop.zeros)), str(len(loop.poles)), *(float(value).hex() for value in numbers)]))
    found = output(program, "\n".join(lines))
    return [[float.fromhex(word) for word in line.split()] for line in found.splitlines()]


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_digits(program: Path, kind: str):
    loops = [KINDS[kind](np.random.default_rng([7, k])).reduced for k in range(25)]
    for loop, found in zip(loops, scanned(program, loops), strict=True):
        own = scan(loop)
        expected = [float(own.certified), len(own.gains), len(own.phases), own.half_turns, *own.gains.ravel(), *own.phases.ravel()]
        assert found == pytest.approx([*expected, *own.peaks.ravel()], rel=0, abs=0, nan_ok=True)


def test_hostile_loops_end(program: Path):
    """Numbers that are none, infinite, vast and minute, nothing at all, and hundreds of roots; none of it is called certified and wrong."""
    none, one = np.zeros(0, complex), np.array([-1.0 + 0j])
    odd = [0.0, 1e300, -1e300, np.inf, np.nan, 5e-324]
    rng = np.random.default_rng(8)
    loops = [Factored(none, none, gain, delay) for gain in odd for delay in (0.0, 1.0)]
    loops += [Factored(none, np.array([complex(x, y)]), 1.0, 0.1) for x in odd for y in odd]
    loops += [Factored(none, one, gain, abs(delay), 1e-3) for gain in odd for delay in odd]
    loops += [Factored(none, one, 1.0, 0.0, abs(step)) for step in odd]
    loops += [Factored(one, none, 1.0), Factored(np.repeat(one, 5), one, 1.0, 0.1)]
    many = -(10.0 ** rng.uniform(-3, 3, 500)).astype(complex)
    loops += [Factored(many[:-2], many, 1.0), Factored(none, np.repeat(1j * np.array([1.0, -1.0]), 50), 1.0, 0.1)]
    found = scanned(program, loops)
    assert len(found) == len(loops)
    for loop, numbers in zip(loops, found, strict=True):
        given = np.array([loop.gain, loop.delay, *loop.poles.real, *loop.poles.imag])
        if not np.all(np.isfinite(given)):
            assert numbers[0] == 0.0, loop
