"""Searches side by side: in processes where they are a command's, else in threads.

Most of their time goes to the core, which works without the interpreter's lock; for the rest of it threads wait for each other.
"""

import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from .forked import Job, Outcomes, Result, StoppedError, in_processes, may_fork

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

Item = TypeVar("Item")
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


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def side_by_side(jobs: Sequence[Job[Result]], progress: Callable[[], None]) -> list[Result]:
    """What the jobs give, in their order, however many of them are done at a time. Raises what the first of them that fails raises.

    In processes (forked.py) nothing that a job changes is seen by others, but for the first one's.
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
    """What `function` gives of each item, side by side: it must change nothing that is needed later."""
    return side_by_side([lambda checkpoint, item=item: function(item) for item in items], lambda: None)


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


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a copy of this process has no such threads
