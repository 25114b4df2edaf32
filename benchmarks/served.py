"""A running `gainroom app` for whoever drives a browser: the benchmark, the documentation's picture and the tests."""

import contextlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
ANSWERED = "() => gainroom.opening && !gainroom.busy && !gainroom.waiting"
"""True if the page's last request has been answered."""
CERTIFIED = "() => gainroom.certified && !gainroom.busy && gainroom.found && gainroom.found.key === gainroom.key"
"""True if everything has been answered."""


@dataclass
class Served:
    """A server in a process of its own."""

    address: str
    process: subprocess.Popen[str]
    file: Path | None


def serve(file: Path | None, port: int = 0, *options: str, **more: Any) -> Served:
    """`gainroom app FILE`, or without one, once it listens; `options` are further words, `more` is subprocess.Popen's."""
    named = [] if file is None else [str(file)]
    command = [sys.executable, "-m", "gainroom", "app", *named, *options, "--no-browser", "--json", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **more)
    assert process.stdout is not None
    text = ""
    while "}" not in text:
        line = process.stdout.readline()
        assert line, process.stderr.read() if process.stderr else "gainroom app ended"
        text += line
    return Served(json.loads(text)["address"], process, file)


@contextlib.contextmanager
def serving(file: Path | None, *options: str, **more: Any) -> Iterator[Served]:
    """Served application, as `serve`, which ends with the block."""
    served = serve(file, 0, *options, **more)
    try:
        yield served
    finally:
        served.process.kill()
        served.process.wait()
        for stream in (served.process.stdout, served.process.stderr):
            if stream is not None:
                stream.close()


def browser_path() -> str | None:
    """An installed Chromium."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)
