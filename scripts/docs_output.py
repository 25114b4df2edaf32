"""Brings outputs and pictures of README.md and docs/*.md up to date (docs_animation.py draws the one that moves).

    python scripts/docs_output.py [FILES]            rewrite them
    python scripts/docs_output.py --check [FILES]    exit 1 where an output is out of date

Blocks are run in order, in an empty folder of their own per file:

- ```console: every line after `$ ` is a command; what follows it is its output. `gainroom` means this checkout's, $EXAMPLES its examples.
- ```python: run in one namespace per file; a ```text block right after it is what it prints. A picture that it saves under the name of one
  in docs/images replaces that.
- the block after <!-- within: PERCENT --> shows what a search found, which the last digits of a processor lead to an end of its own: it
  stays as it is while the same words stand there, and each number is that near.
- a block after <!-- file: NAME --> is not run, but written to NAME; <!-- run: COMMAND --> is a command that readers do not see.
"""

import atexit
import contextlib
import functools
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WARM = ROOT / "scripts" / "warm_gainroom.py"
IMAGES = ROOT / "docs" / "images"
BLOCK = re.compile(
    r"^<!-- file: (?P<file>\S+) -->\n+```\w*\n(?P<text>.*?)^```\n"
    r"|^<!-- run: (?P<command>.*?) -->\n"
    r"|^<!-- within: (?P<percent>\d+) -->\n"
    r"|^```(?P<kind>console|python)\n(?P<content>.*?)^```\n(?:\n*^```text\n(?P<printed>.*?)^```\n)?",
    re.MULTILINE | re.DOTALL,
)
PROGRESS = re.compile(r"^gainroom: .* so far(, .*)?\n", re.MULTILINE)


def documents() -> list[Path]:
    """Every file with outputs in it."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def renewed(text: str, images: Path | None = None, fresh: bool = False) -> str:
    """`text` with its outputs as they are now; pictures that it shows and makes are put into `images`.

    fresh   every command starts from nothing, as a reader's does; else from a process that has imported the package
    """
    namespace: dict[str, object] = {}
    percent = 0
    with tempfile.TemporaryDirectory() as folder:

        def renew(match: re.Match[str]) -> str:
            nonlocal percent
            within, percent = percent, int(match["percent"] or 0)
            if match["file"]:
                (Path(folder) / match["file"]).write_text(match["text"], "utf-8")
            elif match["command"]:
                _output(match["command"], folder, fresh)
            elif match["kind"] == "console":
                now = _session(match["content"], folder, fresh)
                return f"```console\n{match['content'] if _alike(match['content'], now, within) else now}```\n"
            elif match["kind"]:
                output = _printed(match["content"], namespace, folder)
                if match["printed"] is not None:
                    return f"```python\n{match['content']}```\n\n```text\n{output}```\n"
            return match.group(0)

        result = BLOCK.sub(renew, text)
        for name in re.findall(r"images/([\w.-]+)", text) if images else ():
            if (Path(folder) / name).exists():
                shutil.copy(Path(folder) / name, images)
    return result


def _alike(old: str, new: str, percent: int) -> bool:
    """True if two texts have the same words, in any layout, and numbers that differ by no more than `percent` of them."""
    numbers, words = zip(*(_parted(text) for text in (old, new)), strict=True)
    near = (abs(one - other) <= percent / 100 * abs(one) for one, other in zip(*numbers, strict=False))
    return words[0] == words[1] and all(near)


def _parted(text: str) -> tuple[list[float], list[str]]:
    """Numbers of a text, and its words with a # in place of each."""
    number = re.compile(r"\d+(?:\u202f\d{3})*(?:\.\d+)?")
    found = [float(each.replace("\u202f", "")) for each in number.findall(text)]
    return found, re.sub("─+", "─", number.sub("#", text)).split()


def _session(content: str, folder: str, fresh: bool) -> str:
    """A terminal session played again: the commands, which go on after a backslash at "> ", each with its output."""
    result, lines = "", iter(content.splitlines())
    for line in lines:
        if line.startswith("$ "):
            typed, command = [line], line[2:]
            while command.endswith("\\"):
                typed.append(next(lines))
                command = command[:-1] + typed[-1].removeprefix("> ")
            result += "\n".join(typed) + f"\n{_output(command, folder, fresh)}"
    return result


def _output(command: str, folder: str, fresh: bool) -> str:
    """The text that a shell prints for `command`, standard error included, but for progress, which is of the machine."""
    environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "80", "PYTHONPATH": str(ROOT / "src")}
    environment |= {"LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "utf-8", "EXAMPLES": str(ROOT / "examples")}
    called = "-m gainroom" if fresh else f'-I -S "{WARM}" call "{_warm()}"'
    script = f'gainroom() {{ "{sys.executable}" {called} "$@"; }}\n{{ {command}\n}} 2>&1'
    done = subprocess.run(["sh", "-c", script], cwd=folder, env=environment, capture_output=True, encoding="utf-8")
    return PROGRESS.sub("", done.stdout)


@functools.cache
def _warm() -> Path:
    """The socket of a process that has imported the package; it ends with this one."""
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder)
    path = Path(folder) / "socket"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PYTHONIOENCODING": "utf-8"}
    process = subprocess.Popen([sys.executable, WARM, "serve", path], env=environment, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    while not path.exists():
        assert process.poll() is None, "the process for the documentation's commands does not start"
        time.sleep(0.01)
    return path


def _printed(code: str, namespace: dict[str, object], folder: str) -> str:
    """Output of `code` run in `namespace` with `folder` as the current one."""
    stream = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(stream):
        exec(compile(code, "<documentation>", "exec"), namespace)
    return stream.getvalue()


def main() -> int:
    """Rewrite or check; the exit status."""
    check = "--check" in sys.argv
    stale = []
    for path in [Path(each).resolve() for each in sys.argv[1:] if each != "--check"] or documents():
        text = path.read_text("utf-8")
        now = renewed(text, None if check else IMAGES)
        if now != text:
            stale.append(path)
            if not check:
                path.write_text(now, "utf-8")
    for path in stale:
        print(f"{'out of date' if check else 'renewed'}: {path.relative_to(ROOT)}")
    return 1 if stale and check else 0


if __name__ == "__main__":
    sys.exit(main())
