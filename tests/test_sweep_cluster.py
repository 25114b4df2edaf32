"""A sweep on a Dask cluster of processes: the same bytes, also where a worker dies, and where the scheduler does and comes back."""

import subprocess
import sys
from pathlib import Path

import pytest

import gainroom as gr
from faults import environment, lasting_port
from gainroom.cli import main
from gainroom.studies.sweep import cluster
from robot_files import ROBOT, write_arm
from sweep_runs import CHUNK, Deadly, contents, ran, small_plan

TASKS = 60


class Cluster:
    """A scheduler and workers, each a process of its own."""

    def __init__(self) -> None:
        self.port = lasting_port()
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.begin()

    def begin(self) -> None:
        self._start("scheduler", "dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")
        for name in ("one", "two"):
            self._start(name, "dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def _start(self, name: str, module: str, *arguments: str) -> None:
        paths = [str(Path(__file__).parent), *filter(None, sys.path)]
        self.processes[name] = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", *arguments],
            env={**environment(), "PYTHONPATH": ":".join(paths)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def kill(self, *names: str) -> None:
        for name in names or tuple(self.processes):
            self.processes[name].kill()
            self.processes[name].wait()


@pytest.fixture
def running():
    found = Cluster()
    yield found
    found.kill()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    file = write_arm(folder, ROBOT)
    ran(small_plan(file, TASKS * CHUNK), folder / "one.zarr", workers=1)
    return file, contents(folder / "one.zarr")


@pytest.mark.slow
def test_workers_and_the_scheduler_may_die(undisturbed, running, tmp_path, monkeypatch):
    """A worker after a tenth of the tasks, the scheduler with all of them after a third; both come back."""
    monkeypatch.setattr(cluster, "CONNECTING", 300.0)
    file, expected = undisturbed
    killed = []

    def disturb(done: int, total: int, what: str) -> None:
        if done >= 0.1 * total and not killed:
            running.kill("one")
            killed.append("one")
        if done >= 0.3 * total and len(killed) == 1:
            running.kill()
            running.begin()
            killed.append("all")

    done = ran(small_plan(file, TASKS * CHUNK), tmp_path / "sweep.zarr", scheduler=running.address, progress=disturb)
    assert killed == ["one", "all"]
    assert done.finished == done.total == TASKS * CHUNK
    assert contents(tmp_path / "sweep.zarr") == expected


@pytest.mark.population
def test_a_scheduler_that_stays_away_is_told_and_nothing_finished_is_lost(undisturbed, running, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "ABSENT", 1.0)
    file, expected = undisturbed
    path = tmp_path / "sweep.zarr"

    def disturb(done: int, total: int, what: str) -> None:
        if done >= 0.2 * total:
            monkeypatch.setattr(cluster, "CONNECTING", 1.0)
            running.kill()

    monkeypatch.setattr(cluster, "CONNECTING", 300.0)
    with pytest.raises(gr.GainroomError, match=rf"--scheduler {running.address}: does not answer.*what was finished is kept"):
        ran(small_plan(file, TASKS * CHUNK), path, scheduler=running.address, progress=disturb)
    assert ran(small_plan(file, TASKS * CHUNK), path, workers=1).at_start >= 0.2 * TASKS * CHUNK
    assert contents(path) == expected


@pytest.mark.slow
def test_a_scheduler_without_workers_is_told(undisturbed, running, tmp_path, monkeypatch, capsys):
    running.kill("one", "two")
    monkeypatch.setattr(cluster, "ABSENT", 0.5)
    file, _ = undisturbed
    assert main(["sweep", str(file), "--samples", "10", "--scheduler", running.address]) == 2
    assert capsys.readouterr().err.strip().endswith("it has no workers; what was finished is kept")


@pytest.mark.population
def test_postures_that_kill_every_worker_end_the_run(undisturbed, running, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "ABSENT", 2.0)
    file, _ = undisturbed
    plan = small_plan(file, 4 * CHUNK)
    deadly = Deadly(**{one: getattr(plan, one) for one in plan.__dataclass_fields__}, deadly=1)
    with pytest.raises(gr.GainroomError, match="what was finished is kept"):
        ran(deadly, tmp_path / "sweep.zarr", scheduler=running.address)
