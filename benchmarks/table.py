"""Aligned tables for the terminal, and the same as Markdown for docs/performance.md."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

LIMIT, LEAST = "at most", "at least"
"""A column whose head begins with one of these bounds the column before it."""


@dataclass
class Table:
    """A title, rows of equal keys (the keys are the column heads), and notes under them."""

    title: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def print_table(table: Table) -> None:
    cells = _cells(table)
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    print(f"\n{table.title}")
    for line in cells:
        aligned = (text.ljust(width) if k == 0 else text.rjust(width) for k, (text, width) in enumerate(zip(line, widths, strict=True)))
        print("  " + "  ".join(aligned))
    for note in table.notes:
        print(f"  {note}")


def markdown(table: Table) -> str:
    """A section with a table, and the notes as a paragraph."""
    heads, *lines = _cells(table)
    text = [all(isinstance(row[head], str) for row in table.rows) for head in heads]
    rows = [heads, [":---" if left else "---:" for left in text], *lines]
    body = "\n".join("| " + " | ".join(line) + " |" for line in rows)
    return f"## {table.title}\n\n{body}\n" + (f"\n{chr(10).join(table.notes)}\n" if table.notes else "")


def bounded(tables: Iterable[Table]) -> Table:
    """Figures with a limit, each with the result of the comparison."""
    notes = [
        "NO: missed in this run. In the p99.9 of ticks in one run is what the machine adds to any program: waits as long as each tick's",
        "least, in the table of ticks, show how much.",
    ]
    found = Table("Figures with a limit", notes=notes)
    for table in tables:
        for row in table.rows:
            heads = list(row)
            for before, head in pairwise(heads):
                if head.startswith((LIMIT, LEAST)) and row[head] is not None and row[before] is not None:
                    met = row[before] <= row[head] if head.startswith(LIMIT) else row[before] >= row[head]
                    named = ", ".join([table.title, *(value for value in row.values() if isinstance(value, str))])
                    limit = f"{head.split(' [')[0]} {shown(row[head])}"
                    found.rows.append(
                        {"figure": named, "of": before, "measured": row[before], "limit": limit, "met": "yes" if met else "NO"}
                    )
    return found


def _cells(table: Table) -> list[list[str]]:
    heads = list(table.rows[0])
    return [heads] + [[shown(row[head]) for head in heads] for row in table.rows]


def shown(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
