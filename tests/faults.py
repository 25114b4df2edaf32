"""Processes that are killed, and what is left of them: shared by the tests of faults."""

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import gainroom as gr
from gainroom.cli.example import example_texts
from gainroom.files.logs import read_log

EXAMPLES = example_texts()
OLD = "what was here before"
STATUSES = {signal.SIGINT: 130, signal.SIGTERM: 143}
BIPED = Path(gr.__path__[0]) / "robot" / "models" / "biped.urdf"
SHORT = "scenario: {duration: 0.2, reference: {type: step, by: 0.01}}\n"
GAINS = "default: {kp: 100.0, kd: 5.0, motor_inertia: 0.1}\n"

COMMANDS: dict[str, tuple[str, ...]] = {
    "joint": ("joint", "joint.yaml", "--report", "page.html"),
    "robot": ("robot", "robot.yaml", "--report", "page.html"),
    "audit": ("audit", str(BIPED), "--delay-ms", "2", "--gains", "gains.yaml", "--report", "page.html"),
    "simulate csv": ("simulate", "played.yaml", "--log", "run.csv", "--report", "page.html"),
    "simulate parquet": ("simulate", "played.yaml", "--log", "run.parquet", "--report", "page.html"),
    "simulate mcap": ("simulate", "played.yaml", "--log", "run.mcap", "--report", "page.html"),
    "simulate robot": ("simulate", "robot.yaml", "--log", "run.csv", "--report", "page.html"),
    "verify": ("verify", "played.yaml", "--report", "page.html"),
    "verify robot": ("verify", "robot.yaml", "--report", "page.html"),
    "reproduce": ("reproduce", "--report", "page.html"),
}
"""One per command and kind of output; the files stand in the folder that `furnish` makes."""


def furnish(folder: Path, old: bool) -> None:
    """The inputs of COMMANDS; with `old`, something under every name that they write to."""
    for name, text in {
        "joint.yaml": EXAMPLES["testbed"].replace("kp: 1600.0", "kp: 300.0").replace("kd: 70.0", "kd: 20.0"),  # which are safe: status 0
        "played.yaml": EXAMPLES["testbed-simulated"],
        "robot.yaml": EXAMPLES["biped-simulated"],
        "gains.yaml": GAINS,
    }.items():
        (folder / name).write_text(text, "utf-8")
    for name in ("page.html", "run.csv", "run.parquet", "run.mcap") if old else ():
        (folder / name).write_text(OLD, "utf-8")


def environment(**more: str) -> dict[str, str]:
    """That of this process, with the same modules to import."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path), "COLUMNS": "100", **more}


def heard() -> None:
    """In a new process: no signal is ignored, though the tests may run in the background, where a shell has Ctrl-C ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def lasting_port() -> int:
    """A port that is free and stays so until it is listened on, again, too: the system gives its like to nobody who does not ask for it."""
    try:
        lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    except (OSError, ValueError):
        lowest = 49152  # of those that are given away, as IANA has it
    while True:
        with socket.socket() as trial, contextlib.suppress(OSError):
            trial.bind(("127.0.0.1", port := random.SystemRandom().randrange(10_000, lowest)))
            return port


def gainroom(folder: Path, *arguments: str, **more: object) -> subprocess.CompletedProcess[str]:
    """One command, to its end."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment(), "preexec_fn": heard} | more
    return subprocess.run([sys.executable, "-m", "gainroom", *arguments], cwd=folder, text=True, check=False, **options)  # type: ignore[call-overload]


@cache
def undisturbed(*arguments: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """What a command does that nothing disturbs, and how long it takes [s]: the latter says only when others are killed."""
    with TemporaryDirectory() as folder:
        furnish(Path(folder), old=True)
        begun = time.monotonic()
        return gainroom(Path(folder), *arguments), time.monotonic() - begun


@dataclass
class Outcome:
    """What a process left: status, standard output and error, and by name the files of its folder."""

    status: int
    out: str
    err: str
    files: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, status: int, out: str, err: str) -> "Outcome":
        return cls(status, out, err, {path.name: path.read_bytes() for path in folder.iterdir()})


def faults_of(name: str, number: int, before: dict[str, bytes], after: Outcome, folder: Path, finished: int) -> list[str]:
    """What a command that got signal `number` at some moment must not leave behind.

    before     the folder's files when it began
    finished   the status it has when nothing disturbs it
    """
    found, made = [], COMMANDS[name]
    log = made[made.index("--log") + 1] if "--log" in made else ""
    killed = number == signal.SIGKILL
    done = after.status == finished
    if not done and after.status not in (-number, STATUSES.get(number, -number)):
        found.append(f"status {after.status}")
    if "Traceback" in after.err or after.err.count("\n") > 1:
        found.append(f"standard error: {after.err[-300:]!r}")
    if after.status == STATUSES.get(number) and after.err.count("\n") != 1:
        found.append("no line that says so")
    if done and not after.out.strip():
        found.append("no answer, and a status as if there were one")
    for file, content in before.items():
        if file not in after.files:
            found.append(f"{file} is lost")
        elif file not in ("page.html", log) and after.files[file] != content:
            found.append(f"{file} has changed")
    for file in after.files.keys() - before.keys() - {"page.html", log}:
        if not (killed and file.startswith(".gainroom-")):
            found.append(f"{file} is left")
    page = after.files.get("page.html", b"")
    if page and page != before.get("page.html") and not page.rstrip().endswith(b"</html>"):
        found.append("half a page")
    if done and not page.rstrip().endswith(b"</html>"):
        found.append("no page, and a status as if there were one")
    if log and log in after.files and after.files[log] != before.get(log):
        try:
            kept = read_log(folder / log)
            whole = kept.complete and len(kept.time) > 0
        except gr.GainroomError:
            whole = False
        if not whole:
            found.append(f"{log} is not whole")
    return found
