"""Progress of a long command on standard error: a bar on a terminal, and a plain line every 10 s wherever no bar stands."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

from ..errors import printable
from .streams import say

EVERY = 10.0
"""[s] between two lines, and before the first: a short command has none."""
FIRST, LAST = "reading the input", "preparing the answer and its page"
"""Work of a command before it counts anything, and when it has counted all."""


class Progress:
    """The last that a command told of itself, and the line that says it.

    now   the clock [s]
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now, self._begun = now, now()
        self._told = ("", 0, 0, FIRST)
        self._counts: dict[tuple[str, int], tuple[float, int, int]] = {}
        """Counts that were told, by title and end: when each began [s], at how much, and the latest."""
        self.in_a_bar = False

    def tell(self, title: str, done: int, total: int, what: str) -> None:
        """`done` of `total` are done, 0 of 0 where nothing is counted; several counts may be told in turns."""
        began, first, latest = self._counts.get((title, total), (self._now(), done, done))
        if done < latest:  # the same count from its beginning
            began, first = self._now(), done
        self._counts[title, total] = began, first, done
        self._told = title, done, total, what

    def line(self) -> str:
        """A line: what is being done, the share that is done, the time so far, and the time left as far as the share tells it."""
        title, done, total, what = self._told
        parts = []
        if total > 0:
            began, first, _ = self._counts[title, total]
            parts.append(f"{100 * done / total:.0f} % done" + (", still at work" if done >= total else ""))
            if first < done < total:
                parts.append(f"about {duration_text((self._now() - began) * (total - done) / (done - first))} left")
        parts.insert(min(1, len(parts)), f"{duration_text(self._now() - self._begun)} so far")
        return printable(f"gainroom: {' '.join(filter(None, (title, what))).removesuffix(':')}: {', '.join(parts)}")

    def follow(self, wait: Callable[[float], bool], write: Callable[[str], None] = say) -> None:
        """A line every EVERY seconds, until `wait`, which waits so many seconds, gives True."""
        while not wait(EVERY):
            if not self.in_a_bar:
                write(self.line())


def duration_text(seconds: float) -> str:
    """A length of time in the unit that tells it, and the next smaller one: "40 s", "2 min 10 s", "3 h 5 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes = round(whole / 60)
    return f"{whole // 60} min {whole % 60} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


_running: list[tuple[Progress, threading.Event]] = []
"""The command that runs, and what ends its lines; the last one where one runs in another."""


@contextlib.contextmanager
def followed() -> Iterator[None]:
    """A command, with a line about it now and then; none any more once it is over, or `at_rest`."""
    progress, over = Progress(), threading.Event()
    thread = threading.Thread(target=progress.follow, args=(over.wait,), daemon=True)
    thread.start()
    _running.append((progress, over))
    try:
        yield
    finally:
        over.set()
        thread.join()
        _running.remove((progress, over))


def at_rest() -> None:
    """The command waits for others from now on, as a server does: no more lines."""
    for _, over in _running:
        over.set()


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int, str], None]]:
    """A function of (steps done, steps in all, what comes next): on a terminal it draws the bar, elsewhere the next line has it."""
    told = _running[-1][0] if _running else Progress()
    told.tell(title, 0, 0, "")
    try:
        if sys.stderr is None or not sys.stderr.isatty():
            yield lambda done, total, what: told.tell(title, done, total, what)
            return
        told.in_a_bar = True
        with _bar(title) as update:
            yield update
    finally:
        told.in_a_bar = False
        told.tell(title, 0, 0, LAST)


@contextlib.contextmanager
def _bar(title: str) -> Iterator[Callable[[int, int, str], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ..io.run_files import at_last

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar, at_last(bar.stop):
        task = bar.add_task(title, total=None)
        yield lambda done, total, what: bar.update(
            task, completed=done, total=total or None, description=printable(f"{title} {what}".strip())
        )
