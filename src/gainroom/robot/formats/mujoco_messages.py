"""Warnings of MuJoCo, collected instead of printed and written to MUJOCO_LOG.TXT in the current folder.

Its handler is one for the whole process: it is taken over while any thread collects, and given back when the last one has done.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

_lock = threading.Lock()
_thread = threading.local()
_collecting = 0
_before: Callable[[str], object] | None = None


@contextlib.contextmanager
def mujoco_warnings(mujoco: Any) -> Iterator[list[str]]:
    """Context with a list that collects this thread's warnings of the module `mujoco`; those of other threads go where they went before."""
    global _collecting, _before
    with _lock:
        if not _collecting:
            _before = mujoco.get_mju_user_warning()
            mujoco.set_mju_user_warning(_collect)
        _collecting += 1
    outer, _thread.said = getattr(_thread, "said", None), []
    try:
        yield _thread.said
    finally:
        _thread.said = outer
        with _lock:
            _collecting -= 1
            if not _collecting:
                mujoco.set_mju_user_warning(_before)


def _collect(text: str) -> None:
    said = getattr(_thread, "said", None)
    if said is not None:
        said.append(text)
    elif _before is not None:
        _before(text)
