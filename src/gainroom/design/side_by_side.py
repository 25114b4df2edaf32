"""Searches side by side, in threads: most of their time goes to the core, which works without the interpreter's lock."""

import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

Item = TypeVar("Item")
Result = TypeVar("Result")
Job = Callable[[Callable[[], None]], Result]
"""Is given what to call now and then: there it ends where another one has failed, or was interrupted."""


HANDOVER = 1e-4
"""[s] after which a thread that computes in Python lets one go on that comes back from the core: those stay there for a millisecond."""


class _Handover:
    """Threads that take turns so quickly, for as long as any searches stand side by side."""

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


class _StoppedError(Exception):
    """Another job has failed."""


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def side_by_side(jobs: Sequence[Job[Result]], progress: Callable[[], None]) -> list[Result]:
    """What the jobs give, in their order, whatever their number of threads. Raises what the first of them that fails raises."""
    threads = min(cores(), len(jobs))
    if threads < 2:
        return [job(progress) for job in jobs]
    from concurrent.futures import ThreadPoolExecutor  # loads logging

    stopped = threading.Event()

    def checkpoint() -> None:
        if stopped.is_set():
            raise _StoppedError
        progress()

    with _handover.quick(), ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(job, checkpoint) for job in jobs]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stopped.set()
            pool.shutdown(cancel_futures=True)
            raise


def at_once(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """What `function` gives of each item, in their order: parts of one job, which must not share what they change."""
    if min(cores(), len(items)) < 2:
        return [function(item) for item in items]
    return list(_helpers().map(function, items))


@cache
def _helpers() -> "ThreadPoolExecutor":
    """Threads of their own, so that no job waits for one that waits for it."""
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(cores())
