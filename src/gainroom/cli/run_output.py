"""What `gainroom simulate` shows and writes of a run, of a joint and of a robot."""

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..report.number_format import frequency, gain_factor
from .interrupts import Stopped, stop_signals
from .options import refuse_inputs
from .output import file_line
from .progress import progress_bar

if TYPE_CHECKING:
    from ..analysis.gain_limit import GainLimit
    from ..simulation import Response, Vibration
    from ..simulation.robot_result import RobotRun
    from ..studies.verification import Progress


def factor_words(gain: float) -> tuple[str, ...]:
    """`--gain` as it was typed, if it was."""
    return ("--gain", repr(gain).removesuffix(".0")) if gain != 1 else ()


@contextlib.contextmanager
def playing(
    log: Path | None, joints: Sequence[str], duration: float, signals: Sequence[str] | None = None
) -> Iterator["tuple[Callable[[Response | RobotRun], None], Progress, Callable[[], bool]]"]:
    """What takes a run's rows, what is told of its progress, and what says whether to stop; one that is stopped says so, and exits."""
    from ..studies.joint_simulation import Interrupted

    with stop_signals() as stopped:
        kept = "" if log is None else f"; {log} holds what was done"
        try:
            with log_rows(log, joints, signals) as rows, progress_bar("simulate:") as progress:
                yield rows, progress, lambda: stopped() != 0
        except Interrupted as end:
            raise Stopped(stopped(), f" at {end.time:g} s of {duration:g} s{kept}") from end
        except KeyboardInterrupt as end:  # asked twice
            raise Stopped(stopped() or signal.SIGINT) from end
    if stopped():  # after the run, while it was being judged
        raise Stopped(stopped(), kept)


@contextlib.contextmanager
def log_rows(
    log: Path | None, joints: Sequence[str], signals: Sequence[str] | None = None
) -> Iterator[Callable[["Response | RobotRun"], None]]:
    """What takes the parts of a run and writes their `signals`, None: all. Raises GainroomError where `log` cannot be written."""
    if log is None:
        yield lambda part: None
        return
    from ..files.logs import open_log
    from ..simulation.response import LOGGED

    refuse_inputs(log, "log")
    with open_log(log, joints, LOGGED if signals is None else signals) as writer:
        yield lambda part: writer.write(part.columns())


def vibration_facts(found: "Vibration | None", **more: Any) -> dict[str, Any] | None:
    """A vibration in JSON."""
    if found is None:
        return None
    return {"frequency_rad_s": found.frequency, "growth_rate": found.growth_rate, "amplitude": found.amplitude, **more}


def limit_facts(limit: "GainLimit | None") -> dict[str, Any] | None:
    """What the linear loop predicts, in JSON; None: the gains move nothing."""
    if limit is None:
        return None
    return {"stable": limit.stable, "gain_limit": limit.gain, "limit_frequency_rad_s": limit.frequency}


def closing(log: Path | None, report: Path | None, warnings: Sequence[str]) -> list[Any]:
    """The last lines on the terminal: what was written, and what to look at."""
    written = [file_line(name, path) for name, path in (("Log", log), ("Report", report)) if path is not None]
    return [*written, *(f"Warning: {warning}" for warning in warnings)]


def limit_words(limit: "GainLimit | None") -> tuple[str, str]:
    """Where the linear loop begins to vibrate: frequency, and factor on the gains played; None: they move nothing."""
    if limit is None:
        return "none", "the gains move nothing"
    return frequency(limit.frequency), "at all gains" if limit.gain <= 0 else f"from {gain_factor(limit.gain)} × these gains on"
