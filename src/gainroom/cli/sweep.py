"""gainroom sweep: the gain limit in every posture."""

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .interrupts import Stopped, stop_signals
from .options import AsJson, ExitZero, Report, Strict, exit_status, report_stream, typed_command, with_options
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..studies.sweep.plan import SweepPlan
    from ..studies.sweep.store import Store
    from ..system.system import System

MOST_MARGINS = 10_000
"""Maximum number of postures of each contact state with margins: a quarter of an hour for a biped."""


@dataclass(frozen=True)
class PosturesCall:
    """The postures, contact states and draws of uncertain values that a sweep covers, as options of the command line."""

    samples: Annotated[
        int | None, typer.Option(help="So many postures, spread evenly within the joints' limits; 10 000 without any other choice.")
    ] = None
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range", metavar="JOINT=LOW:HIGH", help="In place of a joint's limits [rad; m if prismatic]; name or pattern; repeats."
        ),
    ] = None
    grid: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=LOW:HIGH:POINTS", help="A grid over these joints, the others as in --posture; name or pattern; repeats."
        ),
    ] = None
    trajectory: Annotated[
        Path | None, typer.Option(metavar="LOG", help="The postures of a log: columns motor_position_NAME or link_position_NAME.")
    ] = None
    posture: Annotated[str, typer.Option(metavar="NAME", help="Where joints stand that are not swept; the first without it.")] = ""
    contact: Annotated[list[str] | None, typer.Option(metavar="NAME", help="A contact state; repeats; all without it.")] = None
    draws: Annotated[int, typer.Option(help="Also so many draws of the file's `uncertainty`.")] = 0
    seed: Annotated[int, typer.Option(help="Of samples and draws.")] = 0

    def plan(self, system: "System") -> "SweepPlan":
        """Plan of the sweep. Raises GainroomError."""
        from ..files.sweep_options import SweepOptions, sweep_plan

        asked = self.grid or (), self.ranges or (), self.trajectory, self.contact or ()
        return sweep_plan(system, SweepOptions(self.samples, *asked, self.draws, self.seed, self.posture))


@with_options
def sweep(
    *,
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A robot.yaml; `gainroom example biped` prints one.", show_default=False)],
    swept: PosturesCall,
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

    if margins is not None and not 0 <= margins <= MOST_MARGINS:
        raise GainroomError(f"--margins {margins} must be from 0 to {MOST_MARGINS}")
    if workers is not None and (workers < 1 or scheduler is not None):
        raise GainroomError(f"--workers {workers} must be 1 or more, and not beside --scheduler")
    plan = swept.plan(load_robot_system(file))
    with report_stream(report) as page, _store(output, plan) as store:
        from ..report.sweep_text import SweepPresentation
        from ..studies.sweep.search import searched
        from ..studies.sweep.summary import summarized
        from ..studies.swept_margins import MANY, swept_verdict, worst_states

        mended = _run(store, workers, scheduler or "", output)
        found = summarized(plan, store.finished(), remembered=max(MANY, margins or 0))
        with progress_bar("sweep:") as progress:
            progress(0, 0, "search near the worst posture")
            near, at_worst = searched(found), worst_states(found, margins, progress)
        found = replace(found, searched=near)
        shown = SweepPresentation(found, at_worst, store, mended, files={"Results": output, "Report": report})
        present(shown, as_json, False)
        if page is not None:
            from ..report.sweep import sweep_page

            page.write(sweep_page(shown, typed_command(context, "workers", "scheduler")))
    return exit_status(swept_verdict(found, at_worst), exit_zero)


@contextlib.contextmanager
def _store(output: Path | None, plan: "SweepPlan") -> "Iterator[Store]":
    """Store of the results; without an output path a temporary one, which lasts as long as the block."""
    from ..studies.sweep.store import Store

    if output is not None:
        yield Store.of(output, plan)
        return
    from ..io.run_files import at_last

    folder = tempfile.TemporaryDirectory(prefix="gainroom-")
    with at_last(folder.cleanup):
        yield Store.of(Path(folder.name) / "sweep.zarr", plan)


def _run(store: "Store", workers: int | None, scheduler: str, output: Path | None) -> list[str]:
    """Texts about damaged chunks that were computed again. Raises Stopped on a signal, with the progress made."""
    from ..studies.sweep.checksums import damaged
    from ..studies.sweep.run import run

    with stop_signals() as asked, progress_bar("sweep:") as progress:
        done = run(store, workers, scheduler, progress, lambda: asked() > 0)
        if done.finished < done.total:
            kept = f"; {done.finished} of {done.total} limits are in {output}: the same command goes on" if output is not None else ""
            raise Stopped(asked(), kept)
    return [f"{text}; it was computed again" for text in (*(f"{damaged(store.path, place)}" for place in store.mended), *done.damaged)]
