"""Commands of a Python without what other systems lack: copies of a process and its limits, signals that end one, opening without waiting.

The answers are those of the whole Python. What is taken away is what Windows lacks (docs.python.org, `os`, `signal`, `resource`, `fcntl`:
"Availability: Unix").
"""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from log_files import WRITERS, Truth

WITHOUT = """
import os, select, signal, subprocess, sys

def kill(process):  # as Windows ends a process, with no signal
    if process.poll() is None:
        os.kill(process.pid, 9)

subprocess.Popen.kill = kill
for name in ("fcntl", "resource", "termios", "pwd", "grp"):
    sys.modules[name] = None
for module, names in {
    os: "O_NONBLOCK O_CLOEXEC fork forkpty sched_getaffinity register_at_fork set_blocking getppid geteuid getuid mkfifo",
    signal: "SIGKILL SIGALRM SIGCHLD SIGXCPU SIGPIPE SIGHUP pthread_sigmask SIG_BLOCK SIG_SETMASK alarm setitimer",
    select: "poll epoll",
}.items():
    for name in names.split():
        delattr(module, name)
"""
"""A sitecustomize: every Python that finds it runs it first, those that a command starts too."""


@pytest.fixture
def less(tmp_path: Path) -> dict[str, str]:
    """Environment of a Python without all that."""
    (tmp_path / "less").mkdir()
    (tmp_path / "less" / "sitecustomize.py").write_text(WITHOUT, "utf-8")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "less"), *filter(None, sys.path)])}


def said(environment: dict[str, str], *words: str | Path) -> tuple[int, str, str]:
    """Exit status, standard output and error of `gainroom` with these words."""
    program = "import sys; from gainroom.cli import main; sys.exit(main())"
    result = subprocess.run([sys.executable, "-c", program, *map(str, words)], env=environment, capture_output=True, text=True)
    return result.returncode, result.stdout, result.stderr


def with_all() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def example(name: str, folder: Path) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(said(with_all(), "example", name)[1], "utf-8")
    return path


@pytest.mark.parametrize("use", ["import fcntl", "import resource", "import os; os.fork", "import os; os.O_NONBLOCK"])
def test_it_is_taken_away(use: str, less: dict[str, str]):
    assert subprocess.run([sys.executable, "-c", use], env=less, capture_output=True).returncode == 1


def test_a_joint(less: dict[str, str], tmp_path: Path):
    path = example("testbed", tmp_path)
    expected = said(with_all(), "joint", path, "--json")
    assert json.loads(expected[1])["stable"] is True
    assert said(less, "joint", path, "--json") == expected


def test_a_report_is_written(less: dict[str, str], tmp_path: Path):
    assert said(less, "joint", example("fig9", tmp_path), "--exit-zero", "--report", tmp_path / "page.html")[0] == 0
    assert (tmp_path / "page.html").read_text("utf-8").endswith("</html>\n")


def test_what_is_no_file_is_refused(less: dict[str, str], tmp_path: Path):
    status, _, error = said(less, "joint", tmp_path)
    assert (status, error) == (2, f"gainroom: error: {tmp_path}: is a directory\n")


@pytest.mark.parametrize("name", ["log.csv", "log.h5"])  # read in this process; in a child
def test_a_log(name: str, less: dict[str, str], tmp_path: Path):
    WRITERS[name](tmp_path / name, Truth())
    program = "import sys; from gainroom.files.logs import read_log; print({**read_log(sys.argv[1]).joints})"
    call = [sys.executable, "-c", program, str(tmp_path / name)]
    whole, found = (subprocess.run(call, env=environment, capture_output=True, text=True) for environment in (with_all(), less))
    assert "motor_position" in whole.stdout, whole.stderr
    assert found.stdout == whole.stdout, found.stderr


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("pinocchio"), reason="robots need Pinocchio")
def test_a_robot(less: dict[str, str], tmp_path: Path):
    """Its states in threads, where copies of the process do them else."""
    path = example("biped", tmp_path)
    kept = [line for line in path.read_text("utf-8").splitlines(True) if not line.startswith(("  crouch:", "  double:", "  right:"))]
    path.write_text("".join(kept), "utf-8")
    expected = said(with_all(), "robot", path, "--json")
    assert len(json.loads(expected[1])["states"]) == 2  # standing on the left foot, and flying
    assert said(less, "robot", path, "--json")[:2] == expected[:2]  # standard error says how far it is
