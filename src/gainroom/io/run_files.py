"""Files that a run has read, and its unfinished actions, so that they can be undone however the run ends.

Only the standard library is needed here: a command can leave at once, also while it still loads.
"""

import contextlib
import os
from collections.abc import Callable, Iterator

_read: dict[tuple[int, int], str] = {}
_unfinished: list[Callable[[], object]] = []


def note_read(status: os.stat_result, name: object) -> None:
    """Remember that a run takes its input from this file, by whatever name."""
    _read[status.st_dev, status.st_ino] = str(name)


def forget_read() -> None:
    """A new run begins."""
    _read.clear()


def read_as(path: str | os.PathLike[str]) -> str | None:
    """The name by which the file at `path` was read, also where that is a link or a hard link to it; None where it was not."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return _read.get((status.st_dev, status.st_ino))


@contextlib.contextmanager
def at_last(action: Callable[[], object]) -> Iterator[None]:
    """Do `action` when the block ends, however it ends: also when the process leaves at once."""
    _unfinished.append(action)
    try:
        yield
    finally:
        action()
        _unfinished.remove(action)


def undo_unfinished() -> None:
    """Do every action that still waits for its block's end, the last begun first: the process is about to leave at once."""
    for action in reversed(_unfinished):
        with contextlib.suppress(Exception):
            action()
