"""Handling of Ctrl-C and polite kills: no result is lost, and no unfinished file is left."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from ..io.run_files import undo_unfinished

ASKED = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED = "gainroom: interrupted"


class Stopped(Exception):  # noqa: N818 - asked for, not an error
    """Raised if signal `number` stopped a command; `what` adds the progress made."""

    def __init__(self, number: int, what: str = "") -> None:
        super().__init__(f"{INTERRUPTED}{what}")
        self.status = 128 + number


def leave_when_asked() -> None:
    """Lets either signal end the process with one line and status 128 + its number: an exception could be lost in a library.

    One that the process was started to ignore, as a shell has it for Ctrl-C and what runs in the background, stays ignored.
    """
    for number in ASKED:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _leave)


def leave_quietly() -> None:
    """Restores the default action of signals, once everything is printed and written."""
    for number in ASKED:
        if signal.getsignal(number) is _leave:
            signal.signal(number, signal.SIG_DFL)


def _leave(number: int, frame: FrameType | None) -> None:
    for each in ASKED:
        signal.signal(each, signal.SIG_IGN)  # once is enough
    undo_unfinished()
    with contextlib.suppress(OSError):
        os.write(2, f"{INTERRUPTED}\n".encode())  # what Python's own stream is in the middle of does not matter any more
    os._exit(128 + number)


@contextlib.contextmanager
def stop_signals() -> Iterator[Callable[[], int]]:
    """Function that returns the signal by which the process was asked to stop, 0 before.

    A second one, in case the work never asks, raises KeyboardInterrupt, and a third acts as it did before. What the process was started
    to ignore stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():  # signals are the main thread's
        yield lambda: 0
        return
    came = 0

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if came:
            put_back()
            raise KeyboardInterrupt
        came = number

    def put_back() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    before = {number: signal.getsignal(number) for number in ASKED}
    before = {number: handler for number, handler in before.items() if handler is not signal.SIG_IGN}
    for number in before:
        signal.signal(number, note)
    try:
        yield lambda: came
    finally:
        put_back()
