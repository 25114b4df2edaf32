"""Searches side by side, in threads: most of their time goes to the core, which works without the interpreter's lock."""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Found = TypeVar("Found")
Job = Callable[[Callable[[], None]], Found]
"""Is given what to call now and then: there it ends where another one has failed, or was interrupted."""


class _StoppedError(Exception):
    """Another job has failed."""


def side_by_side(jobs: Sequence[Job[Found]], progress: Callable[[], None]) -> list[Found]:
    """What the jobs give, in their order, whatever their number of threads. Raises what the first of them that fails raises."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if min(cores, len(jobs)) < 2:
        return [job(progress) for job in jobs]
    stopped = threading.Event()

    def told() -> None:
        if stopped.is_set():
            raise _StoppedError
        progress()

    with ThreadPoolExecutor(cores) as pool:
        futures = [pool.submit(job, told) for job in jobs]
        try:
            return [future.result() for future in futures]
        except BaseException:
            stopped.set()
            pool.shutdown(cancel_futures=True)
            raise
