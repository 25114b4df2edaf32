"""gainroom reproduce: the paper, row by row."""

from dataclasses import asdict
from typing import TYPE_CHECKING

from .options import AsJson, Report, Verbose, command_line, report_stream
from .output import emit, emit_json, render, table

if TYPE_CHECKING:
    from ..paper import Reproduction


def reproduce(as_json: AsJson = False, verbose: Verbose = False, report: Report = None) -> int:
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
            emit(_terminal(result, verbose))
        if page is not None:
            from ..paper.page import reproduction_page

            page.write(reproduction_page(result, command_line("reproduce", "--report", report)))
    return 0


def _terminal(result: "Reproduction", verbose: bool) -> str:
    """The count and the rows that disagree; `verbose`: all rows, why some disagree, and what becomes of the paper's claims."""
    from ..paper.text import COLUMNS, cells, claims, summary

    head, warnings = summary(result.rows), [f"Warning: {warning}" for warning in result.warnings]
    apart = [row for row in result.rows if not row.agrees]
    if not verbose:
        parts = [table("Rows that disagree", COLUMNS[:-1], [cells(row)[:-1] for row in apart])] if apart else []
        return render(head, "", *parts, *warnings, "--verbose: all rows, why some disagree, and what becomes of the paper's claims.")
    return render(
        head,
        "",
        table("Paper and computed (in brackets: not printed in the paper)", COLUMNS, [cells(row) for row in result.rows]),
        "What the paper concludes, checked",
        "",
        *(f"{name}: {text}" for name, text in claims(result.rows)),
        "",
        "What disagrees, and why",
        "",
        *(f"{row.id}: {row.note}" for row in apart if not row.is_claim),
        *warnings,
    )
