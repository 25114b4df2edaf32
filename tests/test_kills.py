"""Commands that are killed at random moments: what was there stays, nothing half-written is left, the status and one line say so.

A share runs every time; all of it with `-m population`. Another population: GAINROOM_SEED=7; another size: GAINROOM_POPULATION=500.
Moments are shares of the time that the undisturbed command took: on a busy machine others are met, and what is asserted holds at any.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

import gainroom as gr
from faults import BIPED, COMMANDS, GAINS, Outcome, environment, faults_of, furnish, gainroom, heard, undisturbed

SEED = int(os.environ.get("GAINROOM_SEED", "20171117"))
WHOLE = int(os.environ.get("GAINROOM_POPULATION", "100"))
SHARE = min(6, WHOLE)
QUICK = ("joint", "simulate csv", "simulate mcap")
SIGNALS = (signal.SIGTERM, signal.SIGKILL, signal.SIGINT)
WITNESS = Path("/proc/self/status")

pytestmark = pytest.mark.skipif(not WITNESS.exists(), reason="asks Linux which signals a process heeds")


@cache
def finished(name: str) -> tuple[int, float]:
    """Status and duration [s] of a command that nothing disturbs."""
    run, lasts = undisturbed(*COMMANDS[name])
    assert run.stderr == ""
    assert run.returncode in (0, 1), name
    return run.returncode, lasts


def wait_until_heeded(process: subprocess.Popen[str]) -> None:
    """Until the process has said that SIGTERM is its own affair, or has ended: what Python does before belongs to Python."""
    while process.poll() is None:
        lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        caught = next((int(line.split()[1], 16) for line in lines if line.startswith("SigCgt:")), 0)
        if caught >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(1e-3)


def killed(index: int, names: tuple[str, ...], folder: Path) -> tuple[str, list[str]]:
    """What became of draw number `index`: "killed", "done" all the same, or "too late" to be killed; and its faults."""
    rng = np.random.default_rng([SEED, index])
    name, number = names[index % len(names)], SIGNALS[index // len(names) % len(SIGNALS)]
    status, lasts = finished(name)
    furnish(folder, old=bool(rng.integers(2)))
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    process = subprocess.Popen(
        [sys.executable, "-m", "gainroom", *COMMANDS[name]],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
        preexec_fn=heard,
    )
    try:
        wait_until_heeded(process)
        time.sleep(float(rng.uniform(0, lasts)))
        late = process.poll() is not None
        process.send_signal(number)
        out, err = process.communicate()
    finally:
        process.kill()
    after = Outcome.of(folder, process.returncode, out, err)
    wrong = faults_of(name, number, before, after, folder, status)
    ended = "too late" if late else "done" if after.status == status else "killed"
    return ended, [f"{index}, {name}, {number.name}: {fault}" for fault in wrong]


def assert_nothing_lost(indices: range, names: tuple[str, ...], folder: Path) -> None:
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    for index in indices:
        place = folder / str(index)
        place.mkdir()
        ended, faults = killed(index, names, place)
        counts[ended] += 1
        wrong += faults
    print(f"population {SEED}: {len(indices)} signals, {dict(counts)}, {len(wrong)} faults")
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_share_of_the_kills(tmp_path: Path):
    assert_nothing_lost(range(SHARE), QUICK, tmp_path)


@pytest.mark.population
@pytest.mark.timeout(0)
def test_whole_population_of_kills(tmp_path: Path):
    assert_nothing_lost(range(WHOLE), tuple(COMMANDS), tmp_path)


AT_AN_EVENT = """
import os, sys
folder, count, number, sys.argv = os.getcwd(), int(sys.argv[1]), int(sys.argv[2]), ["gainroom", *sys.argv[3:]]
WATCHED = {"open", "os.rename", "os.remove", "os.chmod"}
def watch(event, arguments):
    global count
    if event in WATCHED and str(arguments[0]).startswith((folder, "page.html", "run.")) or event == "open" and arguments[1] is None:
        count -= 1
        if count == 0:
            os.kill(os.getpid(), number)
sys.addaudithook(watch)
from gainroom.cli import main
sys.exit(main())
"""


def at_event(folder: Path, name: str, count: int, number: int) -> tuple[bool, list[str]]:
    """Whether the command comes to its file operation number `count`, at which it gets the signal, and the faults."""
    furnish(folder, old=True)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    command = [sys.executable, "-c", AT_AN_EVENT, str(count), str(int(number)), *COMMANDS[name]]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment(), preexec_fn=heard, check=False)
    after = Outcome.of(folder, run.returncode, run.stdout, run.stderr)
    status, _ = finished(name)
    wrong = faults_of(name, number, before, after, folder, status)
    return after.status != status, [f"{name}, operation {count}, {signal.Signals(number).name}: {fault}" for fault in wrong]


@pytest.mark.population
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", ["joint", "simulate csv", "simulate parquet", "simulate mcap"])
@pytest.mark.parametrize("number", SIGNALS)
def test_every_file_operation_can_be_the_last(tmp_path: Path, name: str, number: int):
    """Before each file that the command opens, renames or removes in its folder, one after the other."""
    wrong, count, comes = [], 0, True
    while comes:
        count += 1
        (tmp_path / str(count)).mkdir()
        comes, faults = at_event(tmp_path / str(count), name, count, number)
        wrong += faults
    print(f"{name}, {signal.Signals(number).name}: {count - 1} file operations, {len(wrong)} faults")
    assert count > 5
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_share_of_the_file_operations(tmp_path: Path, number: int):
    rng = np.random.default_rng([SEED, number])
    for count in rng.choice(np.arange(1, 8), 2, replace=False).tolist():
        (tmp_path / str(count)).mkdir()
        _, faults = at_event(tmp_path / str(count), "simulate csv", count, number)
        assert not faults


# Several at once


@pytest.mark.slow
def test_eight_threads_get_what_one_gets():
    """Compiled kernels, robots' files and answers: the same numbers from all, as from one alone."""
    import json

    from gainroom.files.audit_options import AuditOptions, audited
    from gainroom.studies.audit import audit

    loops = [gr.build_loop(gr.ElasticJoint(1.0, 4.0 + k, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3), gr.PD(1e4, 300.0)) for k in range(8)]

    def answers(k: int) -> str:
        limit = gr.gain_limit(loops[k % 8])
        with TemporaryDirectory() as folder:
            file = Path(folder) / "gains.yaml"
            file.write_text(GAINS, "utf-8")
            found = audit(audited(str(BIPED), file, AuditOptions(2.0)).system)
        return json.dumps([limit.gain, limit.frequency, found.tightest.limit.gain, found.delay_limit])

    alone = [answers(k) for k in range(8)]
    together: dict[int, str] = {}
    threads = [threading.Thread(target=lambda k=k: together.update({k: answers(k)})) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [together.get(k) for k in range(8)] == alone


@pytest.mark.population
@pytest.mark.timeout(0)
def test_two_processes_fill_an_empty_cache(tmp_path: Path):
    """Of bytecode. Both compile, both write: both answer as with a full cache, and so does the next one."""
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        furnish(tmp_path / name, old=False)
    call = [sys.executable, "-m", "gainroom", "simulate", "played.yaml", "--json"]
    fresh = environment(PYTHONPYCACHEPREFIX=str(tmp_path / "cache"))

    def both() -> Iterator[subprocess.Popen[str]]:
        for name in ("one", "two"):
            yield subprocess.Popen(call, cwd=tmp_path / name, env=fresh, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    ended = [(process.communicate(), process.returncode) for process in list(both())]
    expected = gainroom(tmp_path / "one", *call[3:])
    assert expected.returncode == 0
    again = gainroom(tmp_path / "one", *call[3:], env=fresh)
    for (out, err), status in [*ended, ((again.stdout, again.stderr), again.returncode)]:
        assert (err, status, out) == ("", 0, expected.stdout)
