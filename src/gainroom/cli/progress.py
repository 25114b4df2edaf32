"""How far a long command has come: one bar on standard error, and only where that is a terminal."""

import contextlib
import sys
from collections.abc import Callable, Iterator

from ..errors import printable


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int, str], None]]:
    """A function of (steps done, steps in all, what comes next) that draws the bar, with the time that is left."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda done, total, what: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from ..io.run_files import at_last

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar, at_last(bar.stop):
        task = bar.add_task(title, total=None)
        yield lambda done, total, what: bar.update(task, completed=done, total=total, description=printable(f"{title} {what}".strip()))
