"""Execution of a sweep, from its finished part to its end."""

from dataclasses import dataclass

from ...design.parallel import cores
from ..progress import Progress, quiet
from .cluster import on_cluster
from .local_pool import Stop, in_processes, in_this_process
from .store import Store


@dataclass(frozen=True)
class Done:
    """Progress of a run: limits finished, in all, and finished `at_start`.

    damaged   messages about damaged tasks, which were computed again
    """

    finished: int
    total: int
    at_start: int
    damaged: tuple[str, ...] = ()


def run(store: Store, workers: int | None = None, scheduler: str = "", progress: Progress = quiet, stop: Stop = lambda: False) -> Done:
    """Compute and write all tasks that `store` lacks or has damaged; it ends early if `stop` is true.

    workers     processes of this machine; None: one per core; 1: this one alone
    scheduler   address of a Dask scheduler, whose workers compute instead

    Raises GainroomError if results cannot be written, workers keep dying, or the scheduler does not answer: finished tasks are kept.
    """
    plan = store.plan
    todo, damaged = [], []
    for number in range(plan.tasks):
        task = plan.task(number)
        message = store.damage(task) if store.has(task) else ""
        damaged += [message] * bool(message)
        todo += [number] * bool(message or not store.has(task))
    found = done = plan.states - sum(plan.task(number).size for number in todo)
    progress(done, plan.states, "")
    tasks = map(plan.task, todo)
    count = min(workers or cores(), len(todo))
    if scheduler:
        results = on_cluster(plan, tasks, stop, scheduler)
    else:
        results = in_processes(plan, tasks, stop, count) if count > 1 else in_this_process(plan, tasks, stop)
    for task, limits in results:
        store.write(task, limits)
        done += task.size
        progress(done, plan.states, "")
    return Done(done, plan.states, found, tuple(damaged))
