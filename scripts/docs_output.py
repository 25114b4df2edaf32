"""Brings the outputs quoted in README.md and docs/*.md up to date (docs_picture.py draws the picture).

    python scripts/docs_output.py            rewrite them
    python scripts/docs_output.py --check    exit 1 where one is out of date

Two kinds of blocks are run, in order, in an empty folder of their own per file:

- ```console: every line after `$ ` is a command; what follows it is its output. `gainroom` means this checkout's.
- ```python: run in one namespace per file; a ```text block right after it is what it prints.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```(console|python)\n(.*?)^```\n(?:\n*^```text\n(.*?)^```\n)?", re.MULTILINE | re.DOTALL)


def documents() -> list[Path]:
    """Every file with outputs in it."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def renewed(text: str) -> str:
    """`text` with its outputs as they are now."""
    namespace: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as folder:

        def renew(match: re.Match[str]) -> str:
            kind, content, printed = match.groups()
            if kind == "console":
                return f"```console\n{_session(content, folder)}```\n"
            output = _printed(content, namespace, folder)
            if printed is None:
                return match.group(0)
            return f"```python\n{content}```\n\n```text\n{output}```\n"

        return BLOCK.sub(renew, text)


def _session(content: str, folder: str) -> str:
    """A terminal session played again: the commands, each with its output."""
    result = ""
    for line in content.splitlines():
        if line.startswith("$ "):
            result += f"{line}\n{_output(line[2:], folder)}"
    return result


def _output(command: str, folder: str) -> str:
    """What a shell prints for `command`, standard error included; any exit status."""
    environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "100", "PYTHONPATH": str(ROOT / "src")}
    environment["PYTHONIOENCODING"] = "utf-8"
    script = f'gainroom() {{ "{sys.executable}" -m gainroom "$@"; }}\n{command} 2>&1'
    done = subprocess.run(["sh", "-c", script], cwd=folder, env=environment, capture_output=True, encoding="utf-8")
    return done.stdout


def _printed(code: str, namespace: dict[str, object], folder: str) -> str:
    """What `code` prints when run in `namespace` with `folder` as the current one."""
    stream = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(stream):
        exec(compile(code, "<documentation>", "exec"), namespace)
    return stream.getvalue()


def main() -> int:
    """Rewrite or check; the exit status."""
    stale = []
    for path in documents():
        text = path.read_text("utf-8")
        now = renewed(text)
        if now != text:
            stale.append(path)
            if "--check" not in sys.argv:
                path.write_text(now, "utf-8")
    for path in stale:
        print(f"{'out of date' if '--check' in sys.argv else 'renewed'}: {path.relative_to(ROOT)}")
    return 1 if stale and "--check" in sys.argv else 0


if __name__ == "__main__":
    sys.exit(main())
