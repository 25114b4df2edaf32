"""C++ programs of the tests, compiled once for as long as what they are made of stays the same."""

import functools
import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from gainroom.native import include_dir

BUILT = Path(__file__).parents[1] / "build" / "native" / "tests"
STRICT = ["-std=c++17", "-Og", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
HEADERS = (Path(include_dir()), Path(__file__).with_name("native"))


def compiler() -> str:
    """The core's own."""
    found = os.environ.get("CXX") or shutil.which("c++") or "build/native/c++"
    if shutil.which(found) is None:
        pytest.skip("no C++ compiler")
    return found


@functools.cache
def compiled(source: Path, *options: str) -> Path:
    """With `options`, of which a compiler need not have sanitizers; every warning is an error."""
    command = [compiler(), *STRICT, f"-I{include_dir()}", str(source)]
    version = subprocess.run([compiler(), "--version"], capture_output=True, check=False).stdout
    made_of = [version, repr((command, options)).encode(), source.read_bytes()]
    made_of += [header.read_bytes() for folder in HEADERS for header in sorted(folder.rglob("*.hpp"))]
    kind, digest = (hashlib.sha256(text).hexdigest()[:16] for text in (repr(options).encode(), b"".join(made_of)))
    path = BUILT / f"{source.stem}-{kind}-{digest}"
    if not path.exists():
        BUILT.mkdir(parents=True, exist_ok=True)
        for old in BUILT.glob(f"{source.stem}-{kind}-*"):
            old.unlink(missing_ok=True)
        made = path.with_suffix(f".{os.getpid()}")
        done = subprocess.run([*command, *options, "-o", str(made)], capture_output=True, text=True, check=False)
        if done.returncode:
            others = [option for option in options if option not in SANITIZED]
            done = subprocess.run([*command, *others, "-o", str(made)], capture_output=True, text=True, check=False)
        assert not done.returncode, done.stderr
        made.replace(path)  # whole, whoever else compiles it
    return path


def output(program: Path, *arguments: str, given: str = "") -> str:
    """What it prints; it ends well and says nothing else."""
    # The look for leaks needs to trace the process, which containers may forbid.
    environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}
    done = subprocess.run([str(program), *arguments], input=given, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout
