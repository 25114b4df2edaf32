"""Lanes of computation off the event loop: one thread per lane, with only the latest job of each owner."""

import threading
import time
from collections.abc import Callable, Hashable

Stale = Callable[[], bool]
"""Test if a job's owner has asked for something newer, or has left: its result is then not needed."""
Job = Callable[[Stale], None]


RESTS = 3.0
"""Rest of a lane as a multiple of a patient job's duration: other threads share the interpreter, and go first meanwhile."""


class Lane:
    """Thread that does one job after the other; owners take turns, and a newer job of an owner replaces its older one."""

    def __init__(self, name: str) -> None:
        self._waiting: dict[Hashable, Job] = {}
        self._patient: set[Hashable] = set()
        self._changed = threading.Condition()
        self._running: Hashable = None
        self._stopped = False
        # A daemon: a search that takes seconds does not keep the process from ending
        threading.Thread(target=self._work, name=f"gainroom {name}", daemon=True).start()

    def put(self, owner: Hashable, job: Job, patient: bool = False) -> None:
        """Replaces the job that `owner` waits for; `patient`: the job may wait for the rest after another such."""
        with self._changed:
            self._waiting[owner] = job
            (self._patient.add if patient else self._patient.discard)(owner)
            self._changed.notify()

    def drop(self, owner: Hashable) -> None:
        """Removes the job of `owner`."""
        with self._changed:
            self._waiting.pop(owner, None)
            self._stopped = self._stopped or self._running == owner

    def _work(self) -> None:
        rest = 0.0
        while True:
            with self._changed:
                self._running = None
                self._changed.wait_for(lambda: bool(self._waiting.keys() - self._patient), rest)
                self._changed.wait_for(lambda: bool(self._waiting))
                owner = next(iter(self._waiting))
                job, patient = self._waiting.pop(owner), owner in self._patient
                self._patient.discard(owner)
                self._running, self._stopped = owner, False
            began = time.perf_counter()
            job(lambda owner=owner: self._stopped or owner in self._waiting)
            rest = RESTS * (time.perf_counter() - began) if patient else 0.0
