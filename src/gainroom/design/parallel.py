"""Independent jobs in parallel: in copies of this process (fork) where they are a command's, on Linux, else in threads.

Most of their time goes to the core, which releases the interpreter's lock; for the rest of it threads wait for each other. A copy of the
process knows all that it has computed, and has an interpreter's lock of its own. It has none of the other threads, and a lock that one of
these holds stays held there: a job must use nothing that other threads of its process use. The numbers of the jobs stand in a pipe, from
which every process takes the next one.
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
from functools import cache
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

Item = TypeVar("Item")
Result = TypeVar("Result")
Job = Callable[[Callable[[], None]], Result]
"""Function of a checkpoint, which it calls now and then: that raises where another job has failed, or was interrupted."""
Outcomes = dict[int, tuple[bool, Any]]
"""Outcomes by the number of the job: (True, result), or (False, the exception that it raised)."""
NUMBER = struct.Struct("H")
MOST_JOBS = 2048
"""Most jobs whose numbers the smallest pipe has room for."""
TICK, FAILED = b".", b"!"
MOST_READ = 1 << 16
ASKED = (signal.SIGINT, signal.SIGTERM)
PR_SET_PDEATHSIG = 1
"""Option of prctl, from linux/prctl.h: the signal that a process gets when its parent ends."""
HANDOVER = 1e-4
"""[s] after which a thread that computes in Python lets one go on that comes back from the core: those stay there for a millisecond."""
_own = False


class StoppedError(Exception):
    """Another job of `those` has failed; jobs within jobs may be stopped by either."""

    def __init__(self, those: object) -> None:
        super().__init__()
        self.those = those


@contextmanager
def own_process() -> Iterator[None]:
    """Context in which this process is a command's own: nothing else in it minds copies of it."""
    global _own
    before, _own = _own, sys.platform == "linux" and hasattr(os, "fork")
    try:
        yield
    finally:
        _own = before


def may_fork(jobs: int) -> bool:
    """True if `jobs` jobs may be done in copies of this process."""
    return _own and jobs <= MOST_JOBS and threading.current_thread() is threading.main_thread()


def in_processes(jobs: Sequence[Job[Any]], progress: Callable[[], None], count: int) -> Outcomes:
    """Outcomes of the jobs in `count` processes: the first job here, so that what it computes stays known.

    A checkpoint, of whichever process, calls `progress` here, but for what a pipe has no room for. Once a job has failed the others are
    stopped, and have no outcome. Jobs of a process that was killed from outside, or cannot be begun, or has a result that pickle does not
    take, are done here.
    """
    numbers, (ticks, tick) = _queue(range(1, len(jobs))), os.pipe()
    for end in (ticks, tick):
        os.set_blocking(end, False)
    found: Outcomes = {}

    def hear() -> None:
        """Report the checkpoints of other processes; raises StoppedError once a job of theirs has failed."""
        received = b""
        with suppress(BlockingIOError):
            received = os.read(ticks, MOST_READ)
        for _ in range(received.count(TICK)):
            progress()
        if FAILED in received:
            raise StoppedError(found)

    def checkpoint() -> None:
        hear()
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
                hear()
            except StoppedError as stop:  # the failure comes as an answer
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
    """Those of the pipe ends `ends` that can be read or are closed; waits until there is one."""
    every = select.poll()
    for end in ends:
        every.register(end, select.POLLIN)
    return {end for end, _ in every.poll()}


def _queue(numbers: Sequence[int]) -> int:
    """File descriptor of a pipe that holds `numbers` and then ends: several processes may read them, one at a time."""
    out, into = os.pipe()
    os.write(into, b"".join(map(NUMBER.pack, numbers)))
    os.close(into)
    return out


def _taken(numbers: int) -> Iterator[int]:
    while read := os.read(numbers, NUMBER.size):
        yield NUMBER.unpack(read)[0]


def _do(jobs: Sequence[Job[Any]], numbers: Iterable[int], checkpoint: Callable[[], None], found: Outcomes) -> None:
    """Does the jobs with these numbers and puts their outcomes into `found`, until one fails; a stopped job has no outcome."""
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
    """Process that works on jobs, and our end of the pipe through which its outcomes come."""

    number: int
    answer: BinaryIO
    working: bool = True

    def outcomes(self) -> Outcomes:
        """Outcomes of all jobs that the process did, read when it ends; none if it was killed or its answer cannot be read."""
        self.working = False
        try:
            return pickle.load(self.answer)
        except Exception:  # noqa: BLE001 - whatever a result or an error does as it is unpacked
            return {}

    def end(self) -> None:
        """Kills the process, if it has not ended, and waits for its end."""
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
            if sys.version_info >= (3, 11):  # before, an error has no notes, and is shown without where in the copy it was raised
                error.add_note("".join(traceback.format_exception(error)))  # pickle leaves it out
        with open(there, "wb") as answer:
            answer.write(pickle.dumps(found))  # all of it or nothing
    finally:
        os._exit(0)  # nothing else of this process is the copy's to end


class _Handover:
    """Short switch interval of Python's threads for as long as jobs run in parallel; the former interval afterwards."""

    def __init__(self) -> None:
        self._lock, self._users, self._usual = threading.Lock(), 0, 0.0

    @contextmanager
    def quick(self) -> Iterator[None]:
        with self._lock:
            if not self._users:
                self._usual = sys.getswitchinterval()
                sys.setswitchinterval(min(HANDOVER, self._usual))
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    sys.setswitchinterval(self._usual)


_handover = _Handover()


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_parallel(jobs: Sequence[Job[Result]], progress: Callable[[], None]) -> list[Result]:
    """Results of independent jobs, in their order, however many are done at a time. Raises what the first of them that fails raises.

    In copies of this process nothing that a job changes is seen by others, but for the first one's.
    """
    count = min(cores(), len(jobs))
    if count < 2:
        return [job(progress) for job in jobs]
    with _handover.quick():
        found = in_processes(jobs, progress, count) if may_fork(len(jobs)) else _in_threads(jobs, progress, count)
    for done, error in (found[number] for number in sorted(found)):
        if not done:
            raise error
    return [found[number][1] for number in range(len(jobs))]


def _in_threads(jobs: Sequence[Job[Result]], progress: Callable[[], None], count: int) -> Outcomes:
    from concurrent.futures import ThreadPoolExecutor  # loads logging

    stopped = threading.Event()

    def checkpoint() -> None:
        if stopped.is_set():
            raise StoppedError(stopped)
        progress()

    with ThreadPoolExecutor(count) as pool:
        futures = [pool.submit(job, checkpoint) for job in jobs]
        try:
            return {number: (True, future.result()) for number, future in enumerate(futures)}
        except BaseException:
            stopped.set()
            pool.shutdown(cancel_futures=True)
            raise


def each(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of `function` for each item, in parallel: it must change nothing that is needed later."""
    return in_parallel([lambda checkpoint, item=item: function(item) for item in items], lambda: None)


def at_once(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of `function` for each item, in their order, in threads: parts of one job, which must not share what they change."""
    if min(cores(), len(items)) < 2:
        return [function(item) for item in items]
    return list(_helpers().map(function, items))


@cache
def _helpers() -> "ThreadPoolExecutor":
    """Pool of threads apart from those of jobs, so that no job waits for one that waits for it."""
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(cores())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a copy of this process has no such threads
