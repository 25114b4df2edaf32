"""The process of its own in which a file is read, from within.

Protocol: lines of JSON. The first answer says what there is; then every request has an answer, a line, and an array of numbers behind
it where the line has its type and shape. A refusal, or a failure of the library, is an answer too, and the last one.
"""

import json
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import GainroomError, one_line
from ....system.linear.arrays import Floats

MOST_MEMORY = 3 << 30
"""Bytes of the process, addresses that are only reserved among them: some pieces, and the library's own."""
MOST_SECONDS = 600
"""Of processor time: 30 GB are read in that."""

Answer = tuple[dict[str, Any], Floats | None]
Handler = Callable[[Any], Answer]
"""From a request to its answer."""
Opened = AbstractContextManager[tuple[dict[str, Any], Handler]]
"""What the file holds, and what answers requests about it."""


def serve(path: Path, opened: Callable[[Path], Opened]) -> None:
    """Answer requests on standard input until it ends."""
    _limit()
    try:
        with opened(path) as (about, handler):
            _say(about)
            for line in sys.stdin:
                answer, part = handler(json.loads(line))
                if part is not None:
                    part = np.ascontiguousarray(part)
                    answer = {**answer, "type": part.dtype.str, "shape": part.shape}
                _say(answer, part)
    except GainroomError as error:
        _say({"refused": str(error)})
    except Exception as error:  # noqa: BLE001 - said to the parent process, which says it to the user
        _say({"failed": one_line(error, 120) or type(error).__name__})


def _limit() -> None:
    try:
        import resource
    except ImportError:  # Windows has no such bounds
        return
    for kind, most in ((resource.RLIMIT_AS, MOST_MEMORY), (resource.RLIMIT_CPU, MOST_SECONDS), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(kind)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (most, most))


def _say(answer: dict[str, Any], part: Floats | None = None) -> None:
    sys.stdout.buffer.write(json.dumps(answer).encode() + b"\n")
    if part is not None:
        sys.stdout.buffer.write(part.data if part.size else b"")
    sys.stdout.buffer.flush()
