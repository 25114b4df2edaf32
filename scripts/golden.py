"""Records what every command says about the cases of tests/golden, and shows how that differs after a change.

    python scripts/golden.py record [FOLDER] [--only PATTERN]     write the outputs, one text file per case
    python scripts/golden.py compare [FOLDER] [--only PATTERN]    run again; what differs, and a summary; exit status 1 if anything does

FOLDER is tests/golden/recorded where it is not given. PATTERN is a regular expression, searched in a case's name and command line. Paths,
dates and versions are replaced by placeholders. Numbers in JSON have eight digits and are the same where they differ by less than one part
in a million: of those `record` keeps the old digits. Everything else is compared letter by letter.
"""

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from golden.cases import CASES, Case  # noqa: E402 - found by the line above
from golden.difference import Summary, difference, settled  # noqa: E402
from golden.running import Runner  # noqa: E402

RECORDED = ROOT / "tests" / "golden" / "recorded"


def record(folder: Path, cases: dict[str, Case]) -> int:
    """Write every case, and take away recordings of cases that are no more."""
    folder.mkdir(parents=True, exist_ok=True)
    with Runner() as runner:
        for name, case in cases.items():
            path = folder / f"{name}.txt"
            text = runner.output(case)
            path.write_text(settled(path.read_text("utf-8"), text) if path.exists() else text, "utf-8")
    for path in folder.glob("*.txt") if folder.resolve() == RECORDED else ():
        if path.stem not in CASES:
            path.unlink()
    print(f"{len(cases)} cases, {runner.seconds:.0f} s, {sum(path.stat().st_size for path in folder.glob('*.txt')) / 1e6:.2f} MB in all")
    print("slowest:", ", ".join(f"{name} {seconds:.1f} s" for name, seconds in runner.slowest(8)))
    return 0


def compare(folder: Path, cases: dict[str, Case]) -> int:
    """Print what differs; the exit status."""
    summary = Summary()
    with Runner() as runner:
        for name, case in cases.items():
            path = folder / f"{name}.txt"
            old, new = path.read_text("utf-8") if path.exists() else "", runner.output(case)
            if lines := difference(name, old, new):
                print("\n".join(lines), end="\n\n", flush=True)
                summary.count(name, old, new)
    print(summary.text(len(cases)))
    return 1 if summary.cases else 0


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verb", choices=("record", "compare"))
    parser.add_argument("folder", nargs="?", type=Path, default=RECORDED)
    parser.add_argument("--only", default="", metavar="PATTERN")
    asked = parser.parse_args()
    pattern = re.compile(asked.only)
    cases = {name: case for name, case in CASES.items() if pattern.search(name) or pattern.search(case.line)}
    return (record if asked.verb == "record" else compare)(asked.folder, cases)


if __name__ == "__main__":
    sys.exit(main())
