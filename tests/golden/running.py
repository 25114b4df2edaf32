"""Runs of the cases: each in a folder of its own that holds every input, in a process forked from one that has imported the package."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from .cases import ANSWER, ROOT, Case, write_inputs

MARK = "@@@ "
"""Begins a line that says what follows; every other line is indented."""
DIGITS = 8
"""Of numbers in JSON: more than the difference that counts, one in a million, and fewer than round-off reaches."""
LEAST = 1e-12
"""Smaller numbers in JSON are round-off of zero: no quantity in SI that is reported is as small."""
MOST_ROWS = 12
"""Of a written table: of one with more rows columns and number of rows are recorded."""
PROGRESS = r"(?m)^gainroom: .* so far(, .*)?\n"
"""A line about a command that takes long: there on a slow machine, and not on a quick one."""
WARM = ROOT / "scripts" / "warm_gainroom.py"


class Runner:
    """Runs cases, as a context: `output` is the text that is recorded of one."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}

    def __enter__(self) -> "Runner":
        self.folder = Path(tempfile.mkdtemp(prefix="golden-"))
        self.inputs = self.folder / "inputs"
        self.inputs.mkdir()
        write_inputs(self.inputs)
        self.environment = environment()
        socket = self.folder / "socket"
        self.server = subprocess.Popen(
            [sys.executable, WARM, "serve", socket], env=self.environment, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        while not socket.exists():
            if self.server.poll() is not None:
                raise RuntimeError("the process that has imported gainroom does not start")
            time.sleep(0.01)
        return self

    def __exit__(self, *error: object) -> None:
        self.server.communicate()  # its standard input ends, and so does it
        shutil.rmtree(self.folder)

    @property
    def seconds(self) -> float:
        return sum(self.times.values())

    def slowest(self, count: int) -> list[tuple[str, float]]:
        return sorted(self.times.items(), key=lambda item: -item[1])[:count]

    def output(self, case: Case) -> str:
        """What all its command lines print and write."""
        before, here = time.monotonic(), self.folder / "case"
        shutil.copytree(self.inputs, here)
        try:
            if case.answer:
                (here / ANSWER).write_bytes(self._called(case.answer, here).stdout)
            parts = [part for line in case.lines for part in self._run(line, here)]
        finally:
            shutil.rmtree(here)
        self.times[case.name] = time.monotonic() - before
        return "".join(f"{MARK}{heading}\n{_indented(self._plain(text))}" for heading, text in parts)

    def _run(self, line: str, here: Path) -> list[tuple[str, str]]:
        """Pairs of a heading and the text under it."""
        known = {path: path.stat().st_mtime_ns for path in here.iterdir()}
        done = self._called(line, here)
        out, error = (stream.decode("utf-8", "replace") for stream in (done.stdout, done.stderr))
        parts = [(f"$ gainroom {line}", ""), (f"exit status {done.returncode}", ""), ("standard output", as_recorded(out))]
        error = re.sub(PROGRESS, "", error)
        if error:
            parts.append(("standard error", error))
        for path in sorted(here.iterdir()):
            if path.stat().st_mtime_ns != known.get(path):
                parts.append((f"file {path.name}", written_text(path)))
        return parts

    def _called(self, line: str, here: Path) -> "subprocess.CompletedProcess[bytes]":
        call = [sys.executable, "-I", "-S", WARM, "call", self.folder / "socket", *shlex.split(line)]
        return subprocess.run(call, cwd=here, env=self.environment, capture_output=True, stdin=subprocess.DEVNULL, timeout=300)

    def _plain(self, text: str) -> str:
        """`text` with placeholders for what differs from one run, day or machine to the next."""
        places = {self.folder / "case": "HERE", self.folder: "TEMPORARY", Path(sysconfig.get_path("purelib")): "PACKAGES"}
        for path, name in (places | {ROOT / "src": "SOURCE", ROOT: "ROOT"}).items():  # those within others first
            for written in {str(path), str(path.resolve())}:
                text = text.replace(written, name)
        text = re.sub(r"\b20\d\d-\d\d-\d\d\b", "DATE", text)
        return re.sub(r'((?:gainroom|MuJoCo|"version":|"gainroom":) *["\']?)\d+\.\d+(\.\d+)?\w*', r"\1VERSION", text)


def environment() -> dict[str, str]:
    """Of the commands: nothing that a terminal, a time zone or a language changes; one thread."""
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "HOME", "TMPDIR", "LD_LIBRARY_PATH")}
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    fixed = {"NO_COLOR": "1", "COLUMNS": "80", "TZ": "UTC", "LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "utf-8"}
    return kept | threads | fixed | {"PYTHONPATH": str(ROOT / "src")}


def _indented(text: str) -> str:
    return "".join(f"  {line}".rstrip() + "\n" for line in text.split("\n")) if (text := text.rstrip("\n")) else ""


def as_recorded(text: str) -> str:
    """A JSON object with sorted keys and rounded numbers; any other text as it is."""
    if not text.startswith("{"):
        return text
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return as_json(rounded(value))


def as_json(value: Any) -> str:
    """Sorted, one number or text a line, lists of numbers on one line."""
    text = json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False)
    return re.sub(r"\[[^\[\]{}\"]*\]", lambda match: " ".join(match[0].split()).replace("[ ", "[").replace(" ]", "]"), text)


def rounded(value: Any) -> Any:
    """The same JSON with numbers of DIGITS digits."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    if isinstance(value, float):
        return 0.0 if abs(value) < LEAST else float(f"{value:.{DIGITS}g}")
    return value


def written_text(path: Path) -> str:
    """What is recorded of a file or folder that a command has written."""
    if path.is_dir():
        return "a folder"
    text = path.read_text("utf-8", "replace")
    if path.suffix == ".html":
        return page_text(text)
    lines = text.splitlines()
    if path.suffix == ".csv" and len(lines) > MOST_ROWS:
        return "\n".join([lines[0], f"({len(lines) - 1} rows)"])
    return text


def page_text(text: str) -> str:
    """What a reader of a page sees in words and tables, line by line; pictures' own texts are left out."""
    reader = _PageText()
    reader.feed(text)
    reader.close()
    lines = (" ".join(line.split()) for line in "".join(reader.found).split("\n"))
    return "\n".join(line for line in lines if line)


class _PageText(HTMLParser):
    """The text of a page; every block on a line of its own, cells of a row divided by bars."""

    PASSED_OVER = ("script", "style", "svg")
    INLINE = ("span", "b", "i", "em", "strong", "code", "sub", "sup", "a", "br", "abbr", "small", "kbd", "var", "label", "button", "dfn")

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.depth = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in self.PASSED_OVER:
            self.depth += 1
        elif tag == "body":
            self.found.append(f"\nbody: {dict(attrs).get('class') or ''}\n")
        elif tag in ("td", "th"):
            self.found.append(" | ")
        elif tag not in self.INLINE:
            self.found.append("\n")

    def handle_endtag(self, tag: str) -> None:
        if tag in self.PASSED_OVER:
            self.depth -= 1
        elif tag not in (*self.INLINE, "td", "th"):
            self.found.append("\n")

    def handle_data(self, data: str) -> None:
        if not self.depth:
            self.found.append(data.replace("\n", " "))
