"""Bounded reading: any path costs little time and memory, and an error is one line."""

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import GainroomError
from .run_files import note_read

READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)
"""Flags with which files are opened: to open a FIFO would wait for its writer. Windows has no FIFOs among its files, and not this flag."""


@contextlib.contextmanager
def regular_file(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """Regular file, open for reading, and its size [bytes]. Raises GainroomError, also for errors while it is read."""
    try:
        handle = os.open(path, READING)
    except FileNotFoundError as error:
        raise GainroomError(f"{path}: no such file") from error
    except (OSError, ValueError) as error:
        raise GainroomError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    try:
        status = os.fstat(handle)
        mode = status.st_mode
        if not stat.S_ISREG(mode):
            raise GainroomError(f"{path}: is {'a directory' if stat.S_ISDIR(mode) else 'not a regular file'}")
        note_read(status, path)
        with open(handle, "rb", closefd=False) as stream:
            yield stream, status.st_size
    except OSError as error:
        raise GainroomError(f"{path}: cannot be read: {error.strerror}") from error
    finally:
        os.close(handle)


def bounded_text(path: Path, most: int, what: str) -> str:
    """Text of a regular UTF-8 file of at most `most` bytes. Raises GainroomError; messages call the file `what`."""
    with regular_file(path) as (stream, _):
        content = stream.read(most + 1)
    if len(content) > most:
        raise GainroomError(f"{path}: is larger than {most} bytes; this is not {what}")
    if b"\0" in content:
        raise GainroomError(f"{path}: is binary, not text")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise GainroomError(f"{path}: is not UTF-8 text (byte {error.start})") from error
