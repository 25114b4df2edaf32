"""Run the benchmarks and print their tables; --page writes them to a file as Markdown, --json to build/benchmarks.json.

A benchmark is a file of this folder with a function run(seed) that returns a Table. No result makes this fail; wrong cells are counted.
"""

import argparse
import importlib
import json
import pkgutil
import sys
import time
from pathlib import Path

from gainroom.io.atomic import replacement

from .measure import machine_facts
from .table import Table, bounded, markdown, print_table

HELPERS = {"__main__", "measure", "table", "served", "sysid_peer", "talos", "public_gains"}
PARTS = sorted(one.name for one in pkgutil.iter_modules([str(Path(__file__).parent)]) if one.name not in HELPERS)
OUTPUT = Path("build/benchmarks.json")
INTRODUCTION = """# Performance

Written by `make bench`: every figure beside its peer or its limit, all from one run on one machine. Times are wall-clock times of one core,
peers in turns with gainroom. p99 is the 99th percentile, of fewer than 100 repetitions the longest; ratio is the median of the tool over
that of gainroom.
"""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"which to run, of {', '.join(PARTS)}; all when none is named")
    parser.add_argument("--json", action="store_true", help=f"also write {OUTPUT}")
    parser.add_argument("--page", type=Path, metavar="FILE", help="also write a page of all that has run")
    parser.add_argument("--seed", type=int, default=2017, help="of whatever is drawn")
    parser.add_argument("--logs", type=int, default=3, help="from which identification finds joints; 20 take minutes")
    asked = parser.parse_args()
    unknown = [part for part in asked.parts if part not in PARTS]
    if unknown:
        parser.error(f"part {unknown[0]!r} must be one of {', '.join(PARTS)}")
    facts, started = machine_facts(), time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    for name, fact in facts.items():
        print(f"{name}: {fact}")
    results: dict[str, Table] = {}
    for part in asked.parts or PARTS:
        print(f"measuring {part} …", file=sys.stderr)
        more = {"logs": asked.logs} if part == "identification" else {}
        results[part] = importlib.import_module(f".{part}", __package__).run(seed=asked.seed, **more)
        print_table(results[part])
    limits = bounded(results.values())
    if limits.rows:
        print_table(limits)
    if asked.json:
        OUTPUT.parent.mkdir(exist_ok=True)
        with replacement(OUTPUT) as path:
            path.write_text(
                json.dumps({"machine": facts, **{name: table.rows for name, table in results.items()}}, indent=1) + "\n", "utf-8"
            )
    if asked.page:
        machine = "\n".join(f"- {name}: {fact}" for name, fact in {"begun": started, **facts}.items())
        sections = [markdown(table) for table in ([limits] if limits.rows else []) + list(results.values())]
        with replacement(asked.page) as path:
            path.write_text("\n".join([INTRODUCTION, f"{machine}\n", *sections]), "utf-8")
        print(f"wrote {asked.page}", file=sys.stderr)


if __name__ == "__main__":
    main()
