"""gainroom reproduce: the paper, row by row."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..report.number_format import digits
from .options import AsJson, Report, command_line, report_stream
from .output import emit, emit_json, render, table

if TYPE_CHECKING:
    from ..paper import Reproduction, Row


def reproduce(as_json: AsJson = False, report: Report = None) -> int:
    """Compute the figures, Table I and the claims of Jung et al. (Humanoids 2017) on the spot and compare.

    \b
    Example:
      gainroom reproduce --report reproduce.html
    """
    with report_stream(report) as page:
        from ..paper import run_reproduction

        result = run_reproduction()
        if as_json:
            emit_json({"rows": [asdict(row) for row in result.rows], "warnings": list(result.warnings)})
        else:
            emit(_terminal(result))
        if page is not None:
            from ..paper.page import reproduction_page

            page.write(reproduction_page(result, command_line("reproduce", "--report", report)))
    return 0


def _terminal(result: "Reproduction") -> str:
    from ..paper.row import split

    rows = result.rows
    printed, further = ([row.agrees for row in part] for part in split(rows))
    cells = [(row.id, _paper(row), _cell(row.computed), row.unit, "yes" if row.agrees else "no") for row in rows]
    claims = sorted(row.note for row in rows if row.is_claim)
    apart = [f"{row.id}: {row.note}" for row in rows if not (row.is_claim or row.agrees)]
    return render(
        f"{sum(printed)} of {len(printed)} numbers of the paper agree; {sum(further)} of {len(further)} further checks hold (in brackets).",
        "",
        table("Paper and computed", ("", "paper", "computed", "unit", "agrees"), cells),
        *(["What the paper concludes, checked", "", *claims, ""] if claims else []),
        *(["What does not agree, and why", "", *apart] if apart else []),
        *(f"Warning: {warning}" for warning in result.warnings),
    )


def _paper(row: "Row") -> str:
    """The paper's number or range with the tolerance; in brackets what must come out where the paper prints nothing."""
    text = row.printed if row.is_range else f"≥ {_cell(row.paper)}" if row.is_least else _cell(row.paper)
    if row.tolerance and not row.is_range:
        text += f" ± {digits(float(f'{row.tolerance:.2g}'))}"
    return text if row.printed else f"({text})"


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "stable" if value else "vibrates"
    return digits(value) if isinstance(value, int | float) else "–" if value is None else str(value)
