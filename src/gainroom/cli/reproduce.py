"""gainroom reproduce: the paper, row by row."""

from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from .options import AsJson, Report, Verbose, report_stream, typed_command
from .output import render, show, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..paper import Reproduction


def reproduce(context: typer.Context, as_json: AsJson = False, verbose: Verbose = False, report: Report = None) -> int:
    """Compute the figures, Table I and the claims of Jung et al. (Humanoids 2017) and compare.

    \b
    Example:
      gainroom reproduce --report reproduce.html
    """
    with report_stream(report) as page:
        from ..paper import run_reproduction

        with progress_bar("reproduce:") as progress:
            result = run_reproduction(progress)
        facts = {"rows": [asdict(row) for row in result.rows], "warnings": list(result.warnings)}
        show(as_json, lambda: facts, lambda: _terminal(result, verbose))
        if page is not None:
            from ..paper.page import reproduction_page

            page.write(reproduction_page(result, typed_command(context)))
    return 0


def _terminal(result: "Reproduction", verbose: bool) -> str:
    """Text of the count and the rows that disagree; `verbose`: all rows, why some disagree, and the paper's claims checked."""
    from ..paper.row import COLUMNS, cells, claims, interval, summary, value_text

    head, warnings = summary(result.rows), [f"Warning: {warning}" for warning in result.warnings]
    disagreeing = [row for row in result.rows if not row.agrees]
    if not verbose:
        named = ("disagrees", *COLUMNS[1:-1])
        parts = [table("", named, [cells(row)[:-1] for row in disagreeing])] if disagreeing else []
        return render(head, *parts, *warnings, "--verbose: all rows, why some disagree, and the paper's claims checked.")
    return render(
        head,
        "",
        table("Paper and computed (in brackets: not printed in the paper)", COLUMNS, [cells(row) for row in result.rows], wide=True),
        "Identified from virtual logs",
        "",
        *(f"{row.id}: {value_text(row.computed)}, {interval(row)}" for row in result.rows if interval(row)),
        "",
        "What the paper concludes, checked",
        "",
        *(f"{name}: {text}" for name, text in claims(result.rows)),
        "",
        "What disagrees, and why",
        "",
        *(f"{row.id}: {row.note}" for row in disagreeing if not row.is_claim),
        *warnings,
        wide=True,
    )
