"""Searches side by side, in threads and in processes: what they give, what they raise, and all as it was before."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

import faults
from gainroom.design.parallel import HANDOVER, Job, at_once, each, in_parallel, own_process

Checkpoint = Callable[[], None]


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda process: {0, 1}, raising=False)


@pytest.fixture(params=["threads", "processes"])
def where(request: pytest.FixtureRequest) -> Iterator[str]:
    if request.param == "processes" and sys.platform != "linux":
        pytest.skip("copies processes on Linux alone")
    with own_process() if request.param == "processes" else nullcontext():
        yield request.param


@pytest.fixture
def in_processes() -> Iterator[None]:
    if sys.platform != "linux":
        pytest.skip("copies processes on Linux alone")
    with own_process():
        yield


def endless(checkpoint: Checkpoint) -> None:
    """Until it is stopped."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        checkpoint()
        time.sleep(1e-3)
    raise AssertionError("nobody stopped it")


def children() -> list[int]:
    """Processes of this one that were not there before the test."""
    numbers = map(int, Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split())
    return [number for number in numbers if number not in OTHERS]


OTHERS: set[int] = set()


@pytest.fixture(autouse=True)
def of_other_tests() -> None:
    """Such as a server of processes that another test has begun."""
    OTHERS.clear()
    OTHERS.update(children())


def intervals(checkpoint: Checkpoint) -> list[float]:
    """How quickly threads take turns here, and after jobs within this one."""
    return [sys.getswitchinterval(), *in_parallel([lambda checkpoint: sys.getswitchinterval()] * 2, checkpoint), sys.getswitchinterval()]


@pytest.mark.usefixtures("where")
def test_threads_take_turns_quickly_only_meanwhile():
    before = sys.getswitchinterval()
    for found in in_parallel([intervals, intervals], lambda: None):
        assert found == pytest.approx([HANDOVER] * 4)
    assert sys.getswitchinterval() == before


@pytest.mark.parametrize("place", [0, 1])
def test_one_that_fails_ends_the_others(place: int, where: str):
    def fails(checkpoint: Checkpoint) -> None:
        checkpoint()
        raise ZeroDivisionError("here")

    jobs: list[Job[None]] = [endless, endless]
    jobs[place] = fails
    before = sys.getswitchinterval()
    if place == 1 and where == "threads":
        jobs[0] = lambda checkpoint: time.sleep(0.1)  # results are asked for in their order
    with pytest.raises(ZeroDivisionError, match="here"):
        in_parallel(jobs, lambda: None)
    assert sys.getswitchinterval() == before


@pytest.mark.usefixtures("where")
def test_results_come_in_the_order_of_the_jobs():
    assert in_parallel([lambda checkpoint, k=k: k for k in range(5)], lambda: None) == list(range(5))
    assert each(lambda k: k * k, range(7)) == [k * k for k in range(7)]
    assert each(str, []) == []


def test_checkpoints_of_all_jobs_are_counted(where: str):
    def job(checkpoint: Checkpoint) -> int:
        for _ in range(20):
            checkpoint()
        return os.getpid()

    told: list[int] = []
    pids = in_parallel([job] * 6, lambda: told.append(os.getpid()))
    assert told == [os.getpid()] * 120
    assert pids[0] == os.getpid()
    assert len(set(pids)) <= (1 if where == "threads" else 2)


@pytest.mark.usefixtures("in_processes")
def test_jobs_have_processes_of_their_own_and_leave_none():
    """The second begins while the first waits for it, so that it cannot be in the same process."""
    out, into = os.pipe()

    def first(checkpoint: Checkpoint) -> int:
        assert os.read(out, 1) == b"x"
        return os.getpid()

    def second(checkpoint: Checkpoint) -> int:
        os.write(into, b"x")
        inner = in_parallel([lambda checkpoint: os.getpid()] * 2, checkpoint)
        assert inner[0] == os.getpid()
        return os.getpid()

    one, other = in_parallel([first, second], lambda: None)
    assert one == os.getpid() != other
    assert children() == []
    os.close(out)
    os.close(into)


@pytest.mark.usefixtures("in_processes")
def test_parts_of_a_job_have_threads_in_a_copy_of_a_process_that_had_some():
    assert at_once(abs, [-1, 2]) == [1, 2]
    assert in_parallel([lambda checkpoint: at_once(abs, [-1, 2])] * 4, lambda: None) == [[1, 2]] * 4


@pytest.mark.usefixtures("in_processes")
def test_what_a_killed_process_leaves_is_done_here():
    own = os.getpid()

    def killed(checkpoint: Checkpoint) -> int:
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid()

    def waits(checkpoint: Checkpoint) -> int:
        time.sleep(0.3)
        return os.getpid()

    assert in_parallel([waits, killed, killed], lambda: None) == [own] * 3


@pytest.mark.usefixtures("in_processes")
def test_results_that_pickle_does_not_take_are_made_here():
    found = in_parallel([lambda checkpoint: time.sleep(0.1), lambda checkpoint: lambda: 7], lambda: None)[1]
    assert found is not None
    assert found() == 7


@pytest.mark.usefixtures("in_processes")
def test_an_interrupt_ends_all_processes():
    def interrupted(checkpoint: Checkpoint) -> None:
        time.sleep(0.1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        in_parallel([interrupted, endless], lambda: None)
    assert children() == []


@pytest.mark.usefixtures("in_processes")
def test_where_no_more_processes_may_be_begun_all_is_done_here(monkeypatch: pytest.MonkeyPatch):
    def refused() -> int:
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", refused)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert in_parallel([lambda checkpoint: os.getpid()] * 3, lambda: None) == [os.getpid()] * 3
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before


@pytest.mark.usefixtures("in_processes")
def test_processes_are_waited_for_where_their_end_is_ignored():
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        assert in_parallel([lambda checkpoint, k=k: k for k in range(4)], lambda: None) == [0, 1, 2, 3]
        assert signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGCHLD, before)


@pytest.mark.usefixtures("in_processes")
def test_a_job_that_fails_stops_jobs_within_another():
    def within(checkpoint: Checkpoint) -> list[None]:
        return in_parallel([endless, lambda checkpoint: None], checkpoint)

    def fails(checkpoint: Checkpoint) -> list[None]:
        time.sleep(0.2)
        raise ZeroDivisionError("outside")

    jobs: list[Job[list[None]]] = [within, fails]
    with pytest.raises(ZeroDivisionError, match="outside"):
        in_parallel(jobs, lambda: None)
    assert children() == []


class UnreadableError(Exception):
    """Pickle takes it, and cannot make it again."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(one + two)


@pytest.mark.usefixtures("in_processes")
def test_an_error_that_pickle_cannot_make_again_is_raised_here():
    def fails(checkpoint: Checkpoint) -> None:
        raise UnreadableError(1, 2)

    jobs: list[Job[None]] = [lambda checkpoint: time.sleep(0.1), fails]
    with pytest.raises(UnreadableError, match="3"):
        in_parallel(jobs, lambda: None)


@pytest.mark.usefixtures("in_processes")
def test_thousands_of_jobs_have_threads():
    assert each(abs, range(-5000, 0)) == list(range(5000, 0, -1))


ENDLESS = """
import os, time
from gainroom.design.parallel import own_process
from gainroom.design.parallel import in_parallel
os.sched_getaffinity = lambda process: {0, 1}
def job(checkpoint):
    os.write(1, f"{os.getpid()}\\n".encode())
    time.sleep(60)
with own_process():
    in_parallel([job, job], lambda: None)
"""


@pytest.mark.usefixtures("in_processes")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_processes_end_with_the_one_that_they_are_copies_of(number: signal.Signals):
    program = subprocess.Popen(
        [sys.executable, "-c", ENDLESS], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, preexec_fn=faults.heard
    )
    assert program.stdout is not None
    both = {int(program.stdout.readline()), int(program.stdout.readline())}
    assert program.pid in both
    assert len(both) == 2
    program.send_signal(number)
    assert program.stdout.read() == ""  # once nobody holds its other end
    assert program.wait() != 0


@pytest.mark.usefixtures("in_processes")
def test_other_threads_make_no_processes():
    found: list[list[int]] = []
    thread = threading.Thread(target=lambda: found.append(in_parallel([lambda checkpoint: os.getpid()] * 4, lambda: None)))
    thread.start()
    thread.join()
    assert found == [[os.getpid()] * 4]
