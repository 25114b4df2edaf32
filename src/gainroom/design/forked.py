"""Jobs in copies of this process (fork): they know all that it has computed, and each has an interpreter's lock of its own.

For commands on Linux. A copy has none of the other threads, and a lock that one of these holds stays held there: a job must use nothing
that other threads of its process do. The numbers of the jobs stand in a pipe, of which every process takes the next one.
"""

import ctypes
import itertools
import os
import pickle
import select
import signal
import struct
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, TypeVar

Result = TypeVar("Result")
Job = Callable[[Callable[[], None]], Result]
"""Is given what to call now and then: there it ends where another one has failed, or was interrupted."""
Outcomes = dict[int, tuple[bool, Any]]
"""By the number of the job: whether it has a result; that, or what it raised."""
NUMBER = struct.Struct("H")
MOST_JOBS = 2048
"""That the smallest pipe has room for."""
TICK, FAILED = b".", b"!"
MOST_READ = 1 << 16
ASKED = (signal.SIGINT, signal.SIGTERM)
PR_SET_PDEATHSIG = 1
"""linux/prctl.h."""
_own = False


class StoppedError(Exception):
    """Another job of `those` has failed; jobs within jobs may be stopped by either."""

    def __init__(self, those: object) -> None:
        super().__init__()
        self.those = those


@contextmanager
def own_process() -> Iterator[None]:
    """Meanwhile this process is a command's own, and nothing else in it minds copies of it."""
    global _own
    before, _own = _own, sys.platform == "linux"
    try:
        yield
    finally:
        _own = before


def may_fork(jobs: int) -> bool:
    """Whether so many jobs may be done in copies of this process."""
    return _own and jobs <= MOST_JOBS and threading.current_thread() is threading.main_thread()


def in_processes(jobs: Sequence[Job[Any]], progress: Callable[[], None], count: int) -> Outcomes:
    """What becomes of the jobs in `count` processes: the first one here, so that what it computes stays known.

    A checkpoint, of whichever process, calls `progress` here, but for what a pipe has no room for. Once a job has failed the others are
    stopped, and have no outcome. What a process leaves that was killed from outside, or cannot be begun, or has a result that pickle does
    not take, is done here.
    """
    numbers, (ticks, tick) = _queue(range(1, len(jobs))), os.pipe()
    for end in (ticks, tick):
        os.set_blocking(end, False)
    found: Outcomes = {}

    def heard() -> None:
        """What other processes have told."""
        told = b""
        with suppress(BlockingIOError):
            told = os.read(ticks, MOST_READ)
        for _ in range(told.count(TICK)):
            progress()
        if FAILED in told:
            raise StoppedError(found)

    def checkpoint() -> None:
        heard()
        progress()

    children: list[_Child] = []
    ignored = signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN
    try:
        if ignored:  # then nobody can wait for a process
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        with suppress(OSError):  # no more processes: with those that there are
            for _ in range(count - 1):
                children.append(_forked(jobs, numbers, tick))
        _do(jobs, itertools.chain([0], _taken(numbers)), checkpoint, found)
        while (left := [child for child in children if child.working]) and not _failed(found):
            ready = _readable([ticks, *(child.answer.fileno() for child in left)])
            try:
                heard()
            except StoppedError as stop:  # what failed comes as an answer
                if stop.those is not found:
                    raise
            for child in left:
                if child.answer.fileno() in ready:
                    found.update(child.outcomes())
        if not _failed(found):
            _do(jobs, [number for number in range(len(jobs)) if number not in found], checkpoint, found)
    finally:
        for child in children:
            child.end()
        if ignored:
            signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        for end in (numbers, ticks, tick):
            os.close(end)
    return found


def _failed(found: Outcomes) -> bool:
    return not all(done for done, _ in found.values())


def _readable(ends: Iterable[int]) -> set[int]:
    """Those of the pipes in which something stands, or that have ended; once there is one."""
    every = select.poll()
    for end in ends:
        every.register(end, select.POLLIN)
    return {end for end, _ in every.poll()}


def _queue(numbers: Sequence[int]) -> int:
    """A pipe from which they are read one by one, and then nothing more."""
    out, into = os.pipe()
    os.write(into, b"".join(map(NUMBER.pack, numbers)))
    os.close(into)
    return out


def _taken(numbers: int) -> Iterator[int]:
    while read := os.read(numbers, NUMBER.size):
        yield NUMBER.unpack(read)[0]


def _do(jobs: Sequence[Job[Any]], numbers: Iterable[int], checkpoint: Callable[[], None], found: Outcomes) -> None:
    """Jobs of these numbers into `found`, until one fails; one that is stopped has no outcome."""
    for number in numbers:
        try:
            found[number] = True, jobs[number](checkpoint)
        except StoppedError as stop:
            if stop.those is not found:
                raise
            return
        except Exception as error:  # noqa: BLE001 - raised again where all jobs are known
            found[number] = False, error
            return


@dataclass
class _Child:
    """A process that works, and our end of the pipe through which its outcomes come."""

    number: int
    answer: BinaryIO
    working: bool = True

    def outcomes(self) -> Outcomes:
        """All of them, at its end; none of one that was killed, or whose answer cannot be read."""
        self.working = False
        try:
            return pickle.load(self.answer)
        except Exception:  # noqa: BLE001 - whatever a result or an error does as it is unpacked
            return {}

    def end(self) -> None:
        """It has ended, or its work is not wanted any more."""
        self.answer.close()
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(self.number, signal.SIGKILL)
            os.waitpid(self.number, 0)


def _forked(jobs: Sequence[Job[Any]], numbers: int, tick: int) -> _Child:
    here, there = os.pipe()
    own = os.getpid()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKED)  # the copy would take them as this process does
    try:
        number = os.fork()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(here)
        os.close(there)
        raise
    if number:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(there)
        return _Child(number, open(here, "rb"))
    try:
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # it ends with the process that it is a copy of
        if os.getppid() != own:
            os._exit(0)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # which a terminal sends to both
        if signal.getsignal(signal.SIGTERM) is not signal.SIG_IGN:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

        def checkpoint() -> None:
            with suppress(BlockingIOError):
                os.write(tick, TICK)

        found: Outcomes = {}
        _do(jobs, _taken(numbers), checkpoint, found)
        if _failed(found):
            with suppress(BlockingIOError):
                os.write(tick, FAILED)
        for error in (error for done, error in found.values() if not done):
            error.add_note("".join(traceback.format_exception(error)))  # pickle leaves it out
        with open(there, "wb") as answer:
            answer.write(pickle.dumps(found))  # all of it or nothing
    finally:
        os._exit(0)  # nothing else of this process is the copy's to end
