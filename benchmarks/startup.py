"""How long the command line takes to answer, as a user meets it: whole processes, the very first one with empty caches."""

import os
import subprocess
import sys
import tempfile
import time
from importlib.resources import files
from pathlib import Path

from .table import Table

ROUNDS = 5
EXAMPLE = "testbed"


def run(seed: int) -> Table:
    """One row per command; `seed` is not used."""
    with tempfile.TemporaryDirectory() as folder:
        joint = Path(folder) / "joint.yaml"
        joint.write_text(files("gainroom").joinpath("files", "examples", f"{EXAMPLE}.yaml").read_text(encoding="utf-8"), encoding="utf-8")
        # a cache of bytecode that begins empty, as on a fresh installation
        fresh = dict(os.environ, PYTHONPYCACHEPREFIX=f"{folder}/bytecode")
        fresh.pop("PYTHONDONTWRITEBYTECODE", None)  # or it stays empty
        first = _taken(["joint", str(joint)], fresh)
        warm = min(_taken(["joint", str(joint)], fresh) for _ in range(ROUNDS))
        page = _taken(["joint", str(joint), "--report", f"{folder}/joint.html"], fresh)
        usage = min(_taken(["--help"], fresh) for _ in range(ROUNDS))
    rows = [
        {"command": "gainroom --help", "time [s]": usage, "aim [s]": 0.3},
        {"command": "gainroom joint FILE, the very first time", "time [s]": first, "aim [s]": 0.5},
        {"command": "gainroom joint FILE", "time [s]": warm, "aim [s]": 0.5},
        {"command": "gainroom joint FILE --report", "time [s]": page, "aim [s]": 1.2},
    ]
    note = f"Whole processes; best of {ROUNDS}, except the first time (no bytecode yet) and the report, run once."
    return Table("Command line", rows, [note])


def _taken(arguments: list[str], environment: dict[str, str]) -> float:
    """Wall-clock time of one process [s]; an exit status of 2 (bad call) is an error of the benchmark."""
    script = Path(sys.executable).with_name("gainroom")
    command = [str(script)] if script.exists() else [sys.executable, "-m", "gainroom"]
    start = time.perf_counter()
    done = subprocess.run([*command, *arguments], env=environment, capture_output=True, text=True, check=False)
    taken = time.perf_counter() - start
    if done.returncode not in (0, 1):
        raise RuntimeError(f"gainroom {' '.join(arguments)} ended with status {done.returncode}: {done.stderr.strip()}")
    return taken
