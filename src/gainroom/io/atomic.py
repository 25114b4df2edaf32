"""Writing a text file so that nobody ever sees half of it."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from ..errors import GainroomError


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[TextIO]:
    """Open a text file (UTF-8) that takes the place of `path` when the block ends well.

    The text goes to a temporary file in the same folder first, which is made on entry: a path that cannot be written
    fails before the work in the block is done, and a block that fails leaves the old file as it was.

    Raises GainroomError where `path` cannot be written.
    """
    target = Path(os.path.realpath(path))  # a link stays a link; what it points to is replaced
    refuse_unwritable(path)
    temporary = target.parent / f".gainroom-{secrets.token_hex(6)}.tmp"
    try:
        stream = open(temporary, "x", encoding="utf-8", newline="\n")  # noqa: SIM115 - closed below, before the replacement
    except FileNotFoundError as error:  # the directory is there, as has been checked: one like /proc
        raise GainroomError(f"{path}: cannot be written: the directory {target.parent} takes no new files") from error
    except OSError as error:
        raise GainroomError(f"{path}: cannot be written: {_reason(error)}") from error
    try:
        with stream:
            yield stream
            _finish(path, stream)
        _swap(path, temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def refuse_unwritable(path: Path) -> None:
    """Refuse what can be told from the names alone. Raises GainroomError."""
    target = Path(os.path.realpath(path))
    try:
        if target.is_dir():
            raise GainroomError(f"{path}: cannot be written: it is a directory")
        if target.exists() and not target.is_file():
            raise GainroomError(f"{path}: cannot be written: it is not a regular file")
        if not target.parent.is_dir():
            raise GainroomError(f"{path}: cannot be written: there is no directory {target.parent}")
        if target.exists() and not os.access(target, os.W_OK):
            raise GainroomError(f"{path}: cannot be written: the file is read-only")
    except OSError as error:
        raise GainroomError(f"{path}: cannot be written: {_reason(error)}") from error


def _finish(path: Path, stream: TextIO) -> None:
    try:
        stream.flush()
        os.fsync(stream.fileno())
    except OSError as error:
        raise GainroomError(f"{path}: cannot be written: {_reason(error)}") from error


def _swap(path: Path, temporary: Path, target: Path) -> None:
    try:
        if target.exists():
            temporary.chmod(target.stat().st_mode & 0o777)
        os.replace(temporary, target)
    except OSError as error:
        raise GainroomError(f"{path}: cannot be written: {_reason(error)}") from error


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
