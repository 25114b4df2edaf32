"""Files that a run has read, and its unfinished actions, which can be undone however the run ends.

Only the standard library is needed here: a command can leave at once, also while it still loads.
"""

import contextlib
import os
from collections.abc import Callable, Iterator

_read: dict[tuple[int, int], str] = {}
_unfinished: list[Callable[[], object]] = []


def note_read(status: os.stat_result, name: object) -> None:
    """Records that a run takes its input from this file, under any of its names."""
    note_file(status.st_dev, status.st_ino, str(name))


def note_file(device: int, number: int, name: str) -> None:
    """Records a file by the numbers of its device and inode, which a child that reads for this process has sent."""
    _read[device, number] = name


def files_read() -> dict[tuple[int, int], str]:
    """Names of the files that were read, by device and inode."""
    return {**_read}


def forget_read() -> None:
    """Begins a new run, which has read no file."""
    _read.clear()


def read_as(path: str | os.PathLike[str]) -> str | None:
    """Name under which the file at `path` was read, also through a link or hard link; None if it was not."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return _read.get((status.st_dev, status.st_ino))


@contextlib.contextmanager
def at_last(action: Callable[[], object]) -> Iterator[None]:
    """Context that runs `action` when the block ends, however it ends: also when the process leaves at once."""
    _unfinished.append(action)
    try:
        yield
    finally:
        action()
        _unfinished.remove(action)


def undo_unfinished() -> None:
    """Runs every action whose block has not ended, the last begun first, because the process is about to leave at once."""
    for action in reversed(_unfinished):
        with contextlib.suppress(Exception):
            action()
