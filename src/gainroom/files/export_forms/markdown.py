"""Markdown tables: gains by joint, and the coefficients of the filters at their rate, for a design document or a review."""

import re
from collections.abc import Sequence
from pathlib import Path

from ...errors import GainroomError
from ...io.validation import checked
from ..gain_formats.gain_record import ACTUATOR, NOT_NEGATIVE, Gain, GainFile
from .form import ExportedGains, ExportForm, number_text
from .sampled_law import filter_notes, sampled_law

GAINS = {"kp": "kp [N·m/rad]", "kd": "kd [N·m·s/rad]", "ki": "ki [N·m/(rad·s)]"}
HEADS = GAINS | {
    "motor_inertia": "motor inertia [kg·m²]",
    "effort_limit": "effort limit [N·m]",
    "stiffness": "stiffness [N·m/rad]",
    "damping": "damping [N·m·s/rad]",
    "link_viscous": "link friction [N·m·s/rad]",
    "motor_viscous": "motor friction [N·m·s/rad]",
}
"""Head of each column, by its field of Gain."""
ROW = re.compile(r"(?<!\\)\|")


def markdown_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """Text with a table of gains, one row per joint, and one of filters, where there are some at one rate."""
    keys = [key for key in HEADS if key in GAINS or any(getattr(gain, key) is not None for gain in goal.gains.values())]
    law = sampled_law(goal)
    said = "".join(f"{line}\n" for line in [*header, *([] if law is None else [f"  {law.line}"])])
    rows = [
        [name.replace("|", "\\|"), *("" if (value := getattr(gain, key)) is None else number_text(value) for key in keys)]
        for name, gain in goal.gains.items()
    ]
    text = f"# Gains\n\n```text\n{said}```\n\n{_table(['joint', *(HEADS[key] for key in keys)], rows)}"
    if law is None:
        return text
    filters = _table(["filter", "b0", "b1", "b2", "a1", "a2"], [[one.name, *one.coefficients] for one in law.filters])
    where = " The velocity filter acts on the velocity, the others on the whole torque, one after another." if law.velocity else ""
    return (
        f"{text}\n## Filters\n\nEvery {number_text(law.sample_time)} s: y[k] = b0 x[k] + b1 x[k−1] + b2 x[k−2] − a1 y[k−1] − a2 y[k−2]."
        f"{where or ' They act on the whole torque, one after another.'}\n\n{filters}"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *rows))


def _read(text: str, path: Path) -> GainFile | None:
    """Gains of such a table in a Markdown file."""
    if path.suffix.lower() != ".md":
        return None
    keys, gains = [], {}
    names = {head: key for key, head in HEADS.items()}
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip() for cell in ROW.split(line)[1:-1]] if line.startswith("|") else []
        if not keys:
            keys = [names[cell] for cell in cells[1:] if cell in names] if cells[:1] == ["joint"] else []
        elif not cells:
            break
        elif cells[0] != "---":
            if len(cells) != len(keys) + 1:
                raise GainroomError(f"{path}: line {number}: has {len(cells)} cells and must have {len(keys) + 1}, as the table's head")
            gains[cells[0].replace("\\|", "|")] = _gain(dict(zip(keys, cells[1:], strict=True)), f"{path}: line {number}")
    if not gains:
        raise GainroomError(f"{path}: holds no table of gains with the head | joint | {GAINS['kp']} | {GAINS['kd']} | …")
    return GainFile(str(path), "Markdown", gains)


def _gain(cells: dict[str, str], owner: str) -> Gain:
    """Gain of a row, by field. Raises GainroomError for what is no number."""
    found = {}
    for key, cell in cells.items():
        if cell or key not in ACTUATOR:
            try:
                number = float(cell.removeprefix("."))
            except ValueError:
                raise GainroomError(f"{owner}: {key} {cell!r} must be a number >= 0") from None
            found[key] = number if number == float("inf") and key == "stiffness" else checked(f"{owner}: {key}", number, NOT_NEGATIVE)
    return Gain(**found)


MARKDOWN = ExportForm(
    "markdown", "Markdown", "tables of gains and coefficients", ".md", markdown_text, read=_read, notes=filter_notes, integral=True
)
