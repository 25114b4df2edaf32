"""gainroom sweep: the gain limit in every posture."""

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .interrupts import Stopped, stop_signals
from .options import AsJson, ExitZero, Report, Strict, exit_status, report_stream, typed_command
from .output import closing, column_table, render, show, warned_first
from .progress import progress_bar

if TYPE_CHECKING:
    from ..studies.sweep.plan import SweepPlan
    from ..studies.sweep.store import Store
    from ..studies.sweep.summary import SweepSummary, SweptPosture
    from ..studies.swept_margins import WorstStates


MOST_MARGINS = 10_000
"""Postures of each contact state: a quarter of an hour for a biped."""


def sweep(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A robot.yaml; `gainroom example biped` prints one.", show_default=False)],
    samples: Annotated[
        int | None, typer.Option(help="So many postures, spread evenly within the joints' limits; 10 000 without any other choice.")
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range", metavar="JOINT=LOW:HIGH", help="In place of a joint's limits [rad; m if prismatic]; name or pattern; repeats."
        ),
    ] = None,
    grid: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=LOW:HIGH:POINTS", help="A grid over these joints, the others as in --posture; name or pattern; repeats."
        ),
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="LOG", help="The postures of a log: columns motor_position_NAME or link_position_NAME.")
    ] = None,
    posture: Annotated[str, typer.Option(metavar="NAME", help="Where joints stand that are not swept; the first without it.")] = "",
    contact: Annotated[list[str] | None, typer.Option(metavar="NAME", help="A contact state; repeats; all without it.")] = None,
    draws: Annotated[int, typer.Option(help="Also so many draws of the file's `uncertainty`.")] = 0,
    seed: Annotated[int, typer.Option(help="Of samples and draws.")] = 0,
    margins: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Judge the file's other requirements, too, in the N postures with the lowest gain limits and in N random ones of each "
            "contact state; 50 without it, 5 where a limit takes long; 0: in the lowest alone.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR.zarr", help="Keep the results there, as they come; a run that was stopped goes on with the same command."
        ),
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; one per core without it.")] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Compute on the workers of this Dask scheduler.")] = None,
    as_json: AsJson = False,
    strict: Strict = False,
    exit_zero: ExitZero = False,
    report: Report = None,
) -> int:
    """The gain limit in many postures, contact states and draws of what is uncertain; which posture is the worst, and how sure that is.

    \b
    Example:
      gainroom sweep robot.yaml --samples 100000 --output sweep.zarr --report sweep.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..errors import GainroomError
    from ..files.robot_yaml import load_robot_system
    from ..files.sweep_options import SweepOptions, sweep_plan

    if margins is not None and not 0 <= margins <= MOST_MARGINS:
        raise GainroomError(f"--margins {margins} must be from 0 to {MOST_MARGINS}")
    if workers is not None and (workers < 1 or scheduler is not None):
        raise GainroomError(f"--workers {workers} must be 1 or more, and not beside --scheduler")
    system = load_robot_system(file)
    plan = sweep_plan(system, SweepOptions(samples, grid or (), ranges or (), trajectory, contact or (), draws, seed, posture))
    with report_stream(report) as page, _store(output, plan) as store:
        from ..studies.sweep.search import searched
        from ..studies.sweep.summary import summarized
        from ..studies.swept_margins import MANY, swept_verdict, worst_states

        mended = _run(store, workers, scheduler or "", output)
        found = summarized(plan, store.finished(), remembered=max(MANY, margins or 0))
        with progress_bar("sweep:") as progress:
            progress(0, 0, "search near the worst posture")
            near, at_worst = searched(found), worst_states(found, margins, progress)
        found = replace(found, searched=near)
        show(
            as_json, lambda: _facts(found, near, at_worst, output, mended), lambda: _terminal(found, near, at_worst, output, report, mended)
        )
        if page is not None:
            from ..report.sweep import sweep_page

            page.write(sweep_page(found, near, at_worst, store, typed_command(context, "workers", "scheduler")))
    return exit_status(swept_verdict(found, at_worst), exit_zero)


@contextlib.contextmanager
def _store(output: Path | None, plan: "SweepPlan") -> "Iterator[Store]":
    """Where results go; without a name for the length of the call."""
    from ..studies.sweep.store import Store

    if output is not None:
        yield Store.of(output, plan)
        return
    from ..io.run_files import at_last

    folder = tempfile.TemporaryDirectory(prefix="gainroom-")
    with at_last(folder.cleanup):
        yield Store.of(Path(folder.name) / "sweep.zarr", plan)


def _run(store: "Store", workers: int | None, scheduler: str, output: Path | None) -> list[str]:
    """What was damaged and made again. Raises Stopped where a signal asks for it, which says how far it came."""
    from ..studies.sweep.checksums import damaged
    from ..studies.sweep.run import run

    with stop_signals() as asked, progress_bar("sweep:") as progress:
        done = run(store, workers, scheduler, progress, lambda: asked() > 0)
        if done.finished < done.total:
            kept = f"; {done.finished} of {done.total} limits are in {output}: the same command goes on" if output is not None else ""
            raise Stopped(asked(), kept)
    return [f"{text}; it was computed again" for text in (*(f"{damaged(store.path, place)}" for place in store.mended), *done.damaged)]


def _facts(
    found: "SweepSummary", near: "SweptPosture | None", at_worst: "WorstStates", output: Path | None, mended: list[str]
) -> dict[str, Any]:
    """What --json prints."""
    from .. import __version__
    from ..io.as_typed import as_typed
    from ..report.columns import facts
    from ..report.number_format import model_facts
    from ..report.robot_columns import state_columns
    from ..report.sweep_text import columns, posture_facts, sample_facts, sentence, warnings
    from ..studies.swept_margins import swept_verdict
    from ..system.margin_units import to_db

    plan = found.plan
    return {
        "robot": plan.robot.name,
        "gainroom": __version__,
        **swept_verdict(found, at_worst).facts,
        "stable": found.stable,
        "gain_margin_met": found.margin_held if found.margin > 1 else None,
        "unmet": [*(["gain_margin"] if found.margin > 1 and not found.margin_held else []), *at_worst.unmet],
        "sentence": sentence(found),
        **model_facts(plan.system.control.sample_time),
        "margin_db": as_typed(to_db(found.margin)) if found.margin > 1 else None,
        "postures": plan.postures.kind,
        "count": plan.postures.count,
        "draws": len(plan.places) - 1,
        "limits": found.count,
        "unknown": found.unknown,
        "uncertified": found.uncertified,
        "worst": posture_facts(found, found.worst_posture),
        "searched": posture_facts(found, near),
        "worst_states": [facts(state_columns(), state) for state in at_worst.states],
        "judged": sample_facts(found, at_worst),
        "scale": found.scale,
        "rarer_than": found.rarer_than,
        "contacts": [facts(columns(found), one) for one in found.contacts],
        "output": None if output is None else str(output),
        "warnings": [*warnings(found), *mended],
    }


def _terminal(
    found: "SweepSummary",
    near: "SweptPosture | None",
    at_worst: "WorstStates",
    output: Path | None,
    report: Path | None,
    mended: list[str],
) -> str:
    from ..report.sweep_text import advice, columns, looked_at, sureness, verdict, warnings

    table = column_table("", columns(found), found.contacts, ("highest", "10 %"))
    doubts, warned = warned_first(warnings(found))
    said = [*doubts, *verdict(found, at_worst), *filter(None, [advice(found, at_worst)])]
    sure = [*sureness(found, near), *filter(None, [looked_at(found, at_worst)])]
    files = {"Results": output, "Report": report}
    return render(*said, table, *sure, *closing(files, [*warned, *mended]))
