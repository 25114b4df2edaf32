"""Tasks of a sweep in processes of this machine, one per core.

Each process has a pipe of its own, so that one that is killed takes nothing with it but its task, which another one does again; and all of
them end when this process ends, however it does.
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
from .plan import SweepPlan, Task

MOST_DEATHS = 3
"""Of processes over one task: then it is the task's fault, or that of a machine without memory."""
PATIENCE = 0.1
"""[s] after which it is asked whether to stop."""
Stop = Callable[[], bool]


def in_this_process(plan: SweepPlan, tasks: Iterator[Task], stop: Stop) -> Iterator[tuple[Task, Limits]]:
    """One after the other, here."""
    for task in tasks:
        if stop():
            return
        yield task, plan.computed(task)


def in_processes(plan: SweepPlan, tasks: Iterator[Task], stop: Stop, workers: int) -> Iterator[tuple[Task, Limits]]:
    """As they are finished; ends early once `stop` says so. Raises what a task raises, and GainroomError where processes keep dying."""
    context = multiprocessing.get_context("spawn")
    crew: list[_Worker] = []
    again: list[tuple[Task, int]] = []

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
    """A process, our end of its pipe, and what it is doing; `deaths`: of processes before it over the same task."""

    process: Any
    pipe: "Connection[Any, Any]"
    task: Task | None = None
    deaths: int = 0

    def send(self, task: Task) -> None:
        """One that has died meanwhile shows when its answer is read."""
        with contextlib.suppress(OSError):
            self.pipe.send(task)


def _work(pipe: "Connection[Any, Any]", plan: SweepPlan) -> None:
    """Until the other end is closed. A Ctrl-C is the other end's matter."""
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
        return f"signal {-code}" + ("; out of memory?" if code == -signal.SIGKILL else "")
    return f"status {code}"
