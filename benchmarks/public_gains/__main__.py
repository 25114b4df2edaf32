"""Audit public gains of public robots, and write the page and its picture."""

import argparse
import sys
from pathlib import Path

from gainroom.errors import GainroomError
from gainroom.io.atomic import replacement

from .measured import numbers
from .page import PICTURE, Found, page, picture, verdict
from .rows import Row, rows


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public_gains", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="row", help="which rows of rows.yaml; all when none is named")
    parser.add_argument("--checkouts", type=Path, metavar="DIR", help="folder with clones of the models' repositories")
    parser.add_argument("--page", type=Path, metavar="FILE", help=f"also write the page, and {PICTURE} beside it")
    asked = parser.parse_args()
    known = {row.name: row for row in rows()}
    unknown = [name for name in asked.names if name not in known]
    if unknown:
        parser.error(f"row {unknown[0]!r} must be one of {', '.join(known)}")
    found: list[tuple[Row, Found]] = []
    left_out = []
    for name in asked.names or known:
        row = known[name]
        model = row.model_in(asked.checkouts)
        if model is None:
            left_out.append(f"{row.robot}, {row.set}: {_missing(row)}")
            print(f"{name}: left out: {_missing(row)}", file=sys.stderr)
            continue
        try:
            readings = {reading: numbers(row, model, reading) for reading in row.readings}
        except GainroomError as error:
            parser.exit(2, f"{name}: {error}\n")
        found.append((row, readings))
        for reading, one in readings.items():
            first = one.joints[0] if one.joints else "–"
            print(
                f"{name}: {row.title(reading)}: {verdict(row, reading, one)}, × {one.factor:.4g}, from {one.delay:.4g} ms, {first}",
                flush=True,
            )
    if asked.page and found:
        (asked.page.parent / PICTURE).parent.mkdir(exist_ok=True)
        picture(found, asked.page.parent / PICTURE)
        with replacement(asked.page) as path:
            path.write_text(page(found, left_out), "utf-8")


def _missing(row: Row) -> str:
    where = "the package is not installed" if row.repository is None else f"no {row.in_checkout} in the folder of --checkouts"
    return f"its model is not here ({where})"


if __name__ == "__main__":
    main()
