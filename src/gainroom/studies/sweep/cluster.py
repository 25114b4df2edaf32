"""Sweep on a Dask cluster: the same tasks, computed by its workers; this process writes."""

import contextlib
import logging
import pickle
import time
from collections.abc import Callable, Iterator
from typing import Any

from ...errors import GainroomError, one_line
from .limits import Limits
from .local_pool import Stop
from .plan import SweepPlan, SweepTask

CONNECTING = 10.0
"""Time [s] in which a scheduler has to answer."""
ABSENT = 60.0
"""Longest wait [s] for a scheduler that has gone away, and for one without workers."""
PATIENCE = 0.1
"""Interval [s] between checks of the stop request."""
FETCHED = 2.0
"""Longest transfer time [s] of a result from its worker."""
AHEAD = 2
"""Number of tasks submitted at a time per thread of the cluster."""
RETRIES = 3
"""Most retries of a task whose worker died."""


class _GoneError(Exception):
    """Scheduler that was there no longer answers."""


def on_cluster(plan: SweepPlan, tasks: Iterator[SweepTask], stop: Stop, address: str) -> Iterator[tuple[SweepTask, Limits]]:
    """Limits of tasks as they are finished; ends early once `stop` is true.

    A scheduler that goes away is waited for, ABSENT s, and its unfinished tasks are submitted again. Raises GainroomError if none answers,
    it has no workers, these have another version, or a task fails.
    """
    given: dict[Any, SweepTask] = {}
    waiting: list[SweepTask] = []
    lost = 0.0

    def following() -> SweepTask | None:
        return waiting.pop() if waiting else next(tasks, None)

    while not stop():
        try:
            client = _client(address)
        except (OSError, TimeoutError, ValueError) as error:
            if lost and time.monotonic() < lost + ABSENT:
                continue
            note = "; it was there: what was finished is kept" if lost else ""
            raise GainroomError(f"--scheduler {address}: does not answer: {one_line(error, 120)}{note}") from error
        try:
            yield from _with(client, plan, following, given, stop)
            return
        except _GoneError:
            lost = time.monotonic()
            waiting.extend(given.values())
            given.clear()
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=1)


def _client(address: str) -> Any:
    """Connected Dask client. Raises OSError, TimeoutError and ValueError."""
    try:
        from distributed import Client
    except ImportError as error:
        raise GainroomError("--scheduler needs dask: pip install 'gainroom[sweep]'") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it reports a lost scheduler by itself, over many lines
    return Client(address, timeout=CONNECTING, set_as_default=False)


def _with(
    client: Any, plan: SweepPlan, following: Callable[[], SweepTask | None], given: dict[Any, SweepTask], stop: Stop
) -> Iterator[tuple[SweepTask, Limits]]:
    """Limits of tasks on a scheduler that answers; `given`: tasks that it holds. Raises _GoneError."""
    from ... import __version__

    address, idle, more = client.scheduler.address, time.monotonic(), True
    with _asking(client):
        # A task like others: where its worker dies, another one does it again. What is scattered would be lost.
        prepared = client.submit(_prepared, pickle.dumps(plan), __version__, pure=False, retries=RETRIES)
    while True:
        with _asking(client):
            threads = sum(client.ncores().values())
            while more and len(given) < AHEAD * threads:
                task = following()
                more = task is not None
                if task is not None:
                    given[client.submit(_computed, prepared, task, pure=False, retries=RETRIES)] = task
        if not given and not more:
            return
        idle = time.monotonic() if threads else idle
        if time.monotonic() > idle + ABSENT:
            raise GainroomError(f"--scheduler {address}: it has no workers; what was finished is kept")
        until = time.monotonic() + PATIENCE
        while not any(future.done() for future in given) and time.monotonic() < until:
            time.sleep(PATIENCE / 20)
        if stop():
            with _asking(client), contextlib.suppress(_GoneError):
                client.cancel(list(given))
            return
        for future in [one for one in given if one.done()]:
            with _asking(client):
                found, error = _answer(future)
            if isinstance(error, GainroomError):
                raise error
            if error is not None:
                raise GainroomError(f"--scheduler {address}: a task failed: {one_line(error)}; what was finished is kept")
            if found is not None:
                yield given.pop(future), found


def _answer(future: Any) -> tuple[Any, BaseException | None]:
    """Result of a task, or the exception that it raised; neither if its worker died with it.

    Raises _GoneError if the scheduler has lost it.
    """
    if future.status == "finished":
        try:
            return future.result(timeout=FETCHED), None
        except TimeoutError:
            return None, None
    if future.status == "error":
        return None, future.exception()
    raise _GoneError


@contextlib.contextmanager
def _asking(client: Any) -> Iterator[None]:
    """Context in which any failure is a _GoneError if the scheduler is no longer there."""
    if not _there(client):
        raise _GoneError
    try:
        yield
    except Exception as error:
        if _there(client):
            raise
        raise _GoneError from error


def _there(client: Any) -> bool:
    comm = getattr(client, "scheduler_comm", None)
    return client.status == "running" and comm is not None and not comm.comm.closed()


def _prepared(pickled: bytes, version: str) -> SweepPlan:
    """Plan unpickled in a worker, after a check of its version."""
    from ... import __version__

    if version != __version__:
        raise GainroomError(f"--scheduler: a worker has gainroom {__version__}, not {version}")
    return pickle.loads(pickled)


def _computed(plan: SweepPlan, task: SweepTask) -> Limits:
    return plan.computed(task)
