"""Atomic writing: a file is replaced as a whole, or stays as it was."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from ..errors import GainroomError
from .run_files import at_last


@contextlib.contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """Path of a new, empty file with the same ending, which replaces `path` if the block ends without an error.

    It is in the same folder and made on entry: a path that cannot be written fails before the work in the block is done. A block that
    fails leaves the old file as it was. A process that is killed outright leaves the new one under its own name, .gainroom-….

    Raises GainroomError where `path` cannot be written.
    """
    with writing(path):
        target = Path(os.path.realpath(path))  # a link stays a link; what it points to is replaced
        _refuse_unwritable(path, target)
    temporary = target.with_name(f".gainroom-{secrets.token_hex(6)}.tmp{target.suffix}")
    with at_last(lambda: temporary.unlink(missing_ok=True)):
        with writing(path):
            try:
                os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            except FileNotFoundError as error:  # the directory is there, as has been checked: one like /proc
                raise GainroomError(f"{path}: cannot be written: the directory {target.parent} takes no new files") from error
        yield temporary
        with writing(path):
            _swap(temporary, target)


def write_text(path: Path, text: str) -> None:
    """Writes a text to `path` as a whole or not at all. Raises GainroomError if it cannot be written."""
    with replacement(path) as temporary, writing(path):
        temporary.write_text(text, "utf-8", newline="\n")


@contextlib.contextmanager
def text_as_file(text: str, name: str, called: str) -> Iterator[Path]:
    """Path of a file `name` with the text, in a folder that is gone after the block; errors raised in it name the file as `called`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_text(text, "utf-8")
        try:
            yield path
        except GainroomError as error:
            raise GainroomError(*(problem.replace(str(path), called) for problem in error.problems)) from None


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context that turns an OSError in the block into a GainroomError."""
    try:
        yield
    except OSError as error:
        raise GainroomError(f"{path}: cannot be written: {(error.strerror or str(error)).lower()}") from error


def _refuse_unwritable(path: Path, target: Path) -> None:
    """Raises GainroomError if `target`, to which `path` resolves, is no regular file, is read-only, or has no directory."""
    if target.is_dir():
        raise GainroomError(f"{path}: cannot be written: it is a directory")
    if target.exists() and not target.is_file():
        raise GainroomError(f"{path}: cannot be written: it is not a regular file")
    if not target.parent.is_dir():
        raise GainroomError(f"{path}: cannot be written: there is no directory {target.parent}")
    if target.exists() and not os.access(target, os.W_OK):
        raise GainroomError(f"{path}: cannot be written: the file is read-only")


def _swap(temporary: Path, target: Path) -> None:
    handle = os.open(temporary, os.O_RDWR)  # Windows saves nothing through a handle that only reads
    try:
        os.fsync(handle)  # or a power cut could leave the new name with nothing in it
    finally:
        os.close(handle)
    if target.exists():
        temporary.chmod(target.stat().st_mode & 0o777)
    os.replace(temporary, target)
