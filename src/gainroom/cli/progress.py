"""Progress of a long command on standard error: a bar on a terminal, and a plain line every 10 s wherever no bar stands."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

from ..errors import printable
from .streams import say

EVERY = 10.0
"""Time between two lines, and before the first [s]: a short command prints none."""
TOLD = 0.03
"""Least share done of a count whose speed tells the time left: the first steps of a search are the slowest."""
FIRST, LAST = "reading the input", "preparing the answer and its page"
"""Work of a command before and after everything that it counts."""


class Progress:
    """Latest progress of a command, and the line about it.

    now   the clock [s]
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now, self._begun = now, now()
        self._told = ("", 0, 0, FIRST)
        self._counts: dict[tuple[str, int], tuple[float, int, int]] = {}
        """Counts by title and end: when each began [s], at how much, and its latest value."""
        self.in_a_bar = False

    def tell(self, title: str, done: int, total: int, what: str) -> None:
        """Records that `done` of `total` are done, 0 of 0 if nothing is counted; several counts may be updated in turns."""
        began, first, latest = self._counts.get((title, total), (self._now(), done, done))
        if done < latest:  # the same count from its beginning
            began, first = self._now(), done
        self._counts[title, total] = began, first, done
        self._told = title, done, total, what

    def line(self) -> str:
        """Line with the work in progress, the share done, the time so far, and the time left as far as the share tells it."""
        title, done, total, what = self._told
        parts = []
        if total > 0:
            began, first, _ = self._counts[title, total]
            parts.append("longer than expected" if done >= total else f"{100 * done / total:.0f} % done")
            if first + TOLD * total <= done < total:
                parts.append(f"about {duration_text((self._now() - began) * (total - done) / (done - first))} left")
        parts.insert(min(1, len(parts)), f"{duration_text(self._now() - self._begun)} so far")
        return printable(f"gainroom: {' '.join(filter(None, (title, what))).removesuffix(':')}: {', '.join(parts)}")

    def follow(self, wait: Callable[[float], bool], write: Callable[[str], None] = say) -> None:
        """Writes a line every EVERY seconds until `wait(seconds)` returns True."""
        while not wait(EVERY):
            if not self.in_a_bar:
                write(self.line())


def duration_text(seconds: float) -> str:
    """Duration in its largest unit and the next smaller one: "40 s", "2 min 10 s", "3 h 5 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes = round(whole / 60)
    return f"{whole // 60} min {whole % 60} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


_running: list[tuple[Progress, threading.Event]] = []
"""Running commands with the event that ends their lines; the last one if a command runs in another."""


@contextlib.contextmanager
def followed() -> Iterator[None]:
    """Context of a command with a line of progress now and then, until it is over, or `at_rest`."""
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
    """Ends the lines of a command that waits for others from now on, as a server does."""
    for _, over in _running:
        over.set()


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int, str], None]]:
    """Function of (steps done, total steps, next step): it draws a bar on a terminal; elsewhere the next line shows it."""
    progress = _running[-1][0] if _running else Progress()
    progress.tell(title, 0, 0, "")
    try:
        if sys.stderr is None or not sys.stderr.isatty():
            yield lambda done, total, what: progress.tell(title, done, total, what)
            return
        progress.in_a_bar = True
        with _bar(title) as update:
            yield update
    finally:
        progress.in_a_bar = False
        progress.tell(title, 0, 0, LAST)


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
