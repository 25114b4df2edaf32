"""Computing off the event loop: one thread per lane, and of what each owner asks for only the latest."""

import threading
from collections.abc import Callable, Hashable

Stale = Callable[[], bool]
"""Tells a job that its owner has asked for something newer, or has left: what it would still find nobody waits for."""
Job = Callable[[Stale], None]


class Lane:
    """A thread that does one job after the other; owners take turns, and a newer job of an owner takes the place of its older one."""

    def __init__(self, name: str) -> None:
        self._waiting: dict[Hashable, Job] = {}
        self._changed = threading.Condition()
        self._running: Hashable = None
        self._stopped = False
        # A daemon: a search that takes seconds does not keep the process from ending
        threading.Thread(target=self._work, name=f"gainroom {name}", daemon=True).start()

    def put(self, owner: Hashable, job: Job) -> None:
        """In the place of what `owner` is waiting for."""
        with self._changed:
            self._waiting[owner] = job
            self._changed.notify()

    def drop(self, owner: Hashable) -> None:
        """Nothing of `owner` is wanted any more."""
        with self._changed:
            self._waiting.pop(owner, None)
            self._stopped = self._stopped or self._running == owner

    def _work(self) -> None:
        while True:
            with self._changed:
                self._running = None
                self._changed.wait_for(lambda: bool(self._waiting))
                owner = next(iter(self._waiting))
                job = self._waiting.pop(owner)
                self._running, self._stopped = owner, False
            job(lambda owner=owner: self._stopped or owner in self._waiting)
