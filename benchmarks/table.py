"""Aligned tables for the terminal."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Table:
    """A title, rows of equal keys (the keys are the column heads), and notes under them."""

    title: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def print_table(table: Table) -> None:
    heads = list(table.rows[0])
    cells = [heads] + [[_shown(row[head]) for head in heads] for row in table.rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(heads))]
    print(f"\n{table.title}")
    for line in cells:
        print(
            "  "
            + "  ".join(
                text.ljust(width) if k == 0 else text.rjust(width) for k, (text, width) in enumerate(zip(line, widths, strict=True))
            )
        )
    for note in table.notes:
        print(f"  {note}")


def _shown(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
