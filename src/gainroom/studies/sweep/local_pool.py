"""Sweep in processes of this machine, one per core.

Each process has its own pipe, so that a killed one loses nothing but its task, which another one repeats; all end when this process ends,
however it does.
"""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from ...errors import GainroomError
from .limits import Limits
from .plan import SweepPlan, SweepTask

MOST_DEATHS = 3
"""Most processes that may die over one task: then the task, or a machine without memory, is at fault."""
PATIENCE = 0.1
"""Interval [s] between checks of the stop request."""
KILLED = 9
"""Number of the signal that nothing outlives, in POSIX; Python knows its name only where it is."""
Stop = Callable[[], bool]


def in_this_process(plan: SweepPlan, tasks: Iterator[SweepTask], stop: Stop) -> Iterator[tuple[SweepTask, Limits]]:
    """Limits of tasks, computed one after the other in this process."""
    for task in tasks:
        if stop():
            return
        yield task, plan.computed(task)


def in_processes(plan: SweepPlan, tasks: Iterator[SweepTask], stop: Stop, workers: int) -> Iterator[tuple[SweepTask, Limits]]:
    """Limits of tasks as they are finished; ends early once `stop` is true.

    Raises what a task raises; GainroomError if processes keep dying.
    """
    context = multiprocessing.get_context("spawn")
    crew: list[_Worker] = []
    again: list[tuple[SweepTask, int]] = []

    def give(worker: "_Worker") -> None:
        task, deaths = again.pop() if again else (next(tasks, None), 0)
        worker.task, worker.deaths = task, deaths
        if task is not None:
            worker.send(task)

    def hired() -> "_Worker":
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there, plan), daemon=True)
        process.start()
        there.close()
        return _Worker(process, here)

    try:
        for _ in range(workers):
            crew.append(hired())
            give(crew[-1])
        while any(worker.task is not None for worker in crew):
            if stop():
                return
            busy = {worker.pipe: worker for worker in crew if worker.task is not None}
            for pipe in wait(list(busy), PATIENCE):
                worker = busy[pipe]  # type: ignore[index]
                task = worker.task
                assert task is not None
                try:
                    found = worker.pipe.recv()
                except (EOFError, OSError):
                    deaths = worker.deaths + 1
                    worker.process.join()
                    if deaths == MOST_DEATHS:
                        raise GainroomError(
                            f"sweep: a worker process ended {deaths} times on postures {task.first} to {task.stop - 1} "
                            f"({_ending(worker.process.exitcode)}); what was finished is kept"
                        ) from None
                    again.append((task, deaths))
                    crew[crew.index(worker)] = worker = hired()
                    give(worker)
                    continue
                give(worker)
                if isinstance(found, BaseException):
                    raise found
                yield task, found
    finally:
        for worker in crew:
            worker.pipe.close()
            worker.process.terminate()
        for worker in crew:
            worker.process.join()


@dataclass
class _Worker:
    """Worker process, this end of its pipe, and its task; `deaths`: number of processes that died over that task before."""

    process: Any
    pipe: "Connection[Any, Any]"
    task: SweepTask | None = None
    deaths: int = 0

    def send(self, task: SweepTask) -> None:
        """Send a task; a process that has died is noticed when its answer is read."""
        with contextlib.suppress(OSError):
            self.pipe.send(task)


def _work(pipe: "Connection[Any, Any]", plan: SweepPlan) -> None:
    """Compute tasks until the other end closes the pipe; Ctrl-C is handled by the other end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            found: Any = plan.computed(task)
        except Exception as error:  # noqa: BLE001 - raised again in the parent
            found = error
        try:
            pipe.send(found)
        except OSError:
            return


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f"signal {-code}" + ("; out of memory?" if code == -KILLED else "")
    return f"status {code}"
