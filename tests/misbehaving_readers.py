"""A reader whose library does in the guarded child what a damaged or hostile file can make one do."""

import contextlib
import ctypes
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gainroom.errors import GainroomError
from gainroom.io.guarded_child import Answer, Handler


def _do(what: str, path: Path) -> Answer:
    if what == "abort":
        os.abort()
    elif what == "crash":
        ctypes.string_at(0)
    elif what == "exit":
        os._exit(0)
    elif what == "sleep":
        time.sleep(3600)
    elif what == "half":  # an array is announced, and does not come
        return {"type": "<f8", "shape": [1000]}, None
    elif what == "vast":
        return {"type": "<f8", "shape": [1 << 40]}, None
    elif what == "memory":
        np.ones(10 << 27)  # 10 GiB
    elif what == "recursion":
        return _do(what, path)
    elif what == "raise":
        raise RuntimeError("the library's words\nin two lines")
    elif what == "refuse":
        raise GainroomError(f"{path}: first", f"{path}: second")
    elif what == "print":
        os.write(1, b"libraries print\n")
        print("and Python does", flush=True)
    elif what == "write":
        (path.parent / "written").write_bytes(b"x")
    elif what == "network":
        try:
            socket.create_connection(("127.0.0.1", int(path.read_text())), 5).close()
        except OSError as error:
            return {"network": type(error).__name__}, None
        return {"network": "connected"}, None
    return {"pid": os.getpid(), "modules": sorted(sys.modules)}, np.arange(6.0).reshape(2, 3)


@contextlib.contextmanager
def opened(path: Path, at_once: str = "") -> Iterator[tuple[dict[str, Any], Handler]]:
    """Misbehave at once, or at a request that says how."""
    if at_once:
        _do(at_once, path)
    yield {"pid": os.getpid()}, lambda request: _do(request, path)
