"""Run the benchmarks, print one table, and write build/benchmarks.json with --json. No result makes this fail; wrong cells are counted."""

import argparse
import json
import sys
from pathlib import Path

from . import biped, coupled, disk, identification, maps, margins, startup, stepping
from .measure import machine_facts
from .table import print_table

PARTS = {
    "margins": margins.run,
    "coupled": coupled.run,
    "disk": disk.run,
    "maps": maps.run,
    "startup": startup.run,
    "stepping": stepping.run,
    "biped": biped.run,
    "identification": identification.run,
}
OUTPUT = Path("build/benchmarks.json")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"which to run, of {', '.join(PARTS)}; all when none is named")
    parser.add_argument("--json", action="store_true", help=f"also write {OUTPUT}")
    parser.add_argument("--seed", type=int, default=2017, help="of the map cells that are drawn for checking")
    parser.add_argument("--logs", type=int, default=3, help="from which identification finds joints; 20 take minutes")
    asked = parser.parse_args()
    unknown = [part for part in asked.parts if part not in PARTS]
    if unknown:
        parser.error(f"part {unknown[0]!r} must be one of {', '.join(PARTS)}")
    facts = machine_facts()
    print(facts)
    results = {}
    for part in asked.parts or PARTS:
        print(f"measuring {part} …", file=sys.stderr)
        more = {"logs": asked.logs} if part == "identification" else {}
        results[part] = PARTS[part](seed=asked.seed, **more)
        print_table(results[part])
    if asked.json:
        OUTPUT.parent.mkdir(exist_ok=True)
        OUTPUT.write_text(json.dumps({"machine": facts, **{name: table.rows for name, table in results.items()}}, indent=1) + "\n")
        print(f"wrote {OUTPUT}", file=sys.stderr)


if __name__ == "__main__":
    main()
