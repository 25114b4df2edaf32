"""Protocol of what the page works on, one joint or a robot, and the parts that both share."""

import hashlib
import math
import shlex
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from ..errors import GainroomError
from ..io.yaml_text import read_text
from ..report.gain_advice import ToUse
from ..simulation.step_response import StepResponse
from ..studies.progress import Progress, quiet
from ..system.linear.arrays import Complexes, Floats
from .messages import View

REMEMBERED = 24
"""Number of cached studies, recommendations and planes, of each kind."""
Value = TypeVar("Value")
Part = tuple[str, dict[str, Any]]
"""Part of an answer: its name and its content; strict() makes JSON of it."""


class Cancelled(Exception):  # noqa: N818 - asked for, not an error
    """Raised if nobody waits for the answer any more."""


@dataclass
class Opened:
    """File of the page: its text as it was read; `path` None: a shipped example or a model, which is not saved.

    command  that opened it, where it is no file of its own
    saved    the text that stands in the file since it was saved; None: the one that was read
    """

    text: str
    source: str
    folder: Path
    path: Path | None = None
    command: str = ""
    saved: str | None = None

    @property
    def stored(self) -> str:
        """Content of the file on disk, as far as it is known here."""
        return self.text if self.saved is None else self.saved

    def call(self, kind: str) -> str:
        """Command that gives the same numbers in a terminal; `kind`: joint or robot."""
        return self.command or f"gainroom {kind} {shlex.quote(self.source)}"

    def save(self, text: str, digest: str) -> None:
        """Writes `text` to the file.

        Raises GainroomError where it cannot be written, has changed since it was read, or the difference that was seen is another one.
        """
        from ..io.atomic import write_text

        if self.path is None:
            raise GainroomError(f"{self.source}: no gains are saved to an example or a model: copy them, or start with --write-robot")
        if digest_of(text) != digest:
            raise GainroomError(f"{self.source}: not saved, as the gains have changed since the difference was shown")
        if read_text(self.path) != self.stored:
            raise GainroomError(
                f"{self.source}: not saved, as the file has changed since this page read or saved it; load the page again, or, where "
                "it was changed elsewhere, start gainroom app again"
            )
        write_text(self.path, text)
        self.saved = text

    def difference(self, text: str) -> str:
        """Difference between the file and `text`, as `diff -u`."""
        import difflib

        lines = difflib.unified_diff(self.stored.splitlines(), text.splitlines(), self.source, self.source, lineterm="")
        return "".join(f"{line}\n" for line in lines)


class Remembered(OrderedDict[str, Value]):
    """Cache of the latest REMEMBERED values, by the key that they depend on."""

    def __setitem__(self, key: str, value: Value) -> None:
        super().__setitem__(key, value)
        self.move_to_end(key)
        while len(self) > REMEMBERED:
            self.popitem(last=False)

    def of(self, key: str, made: Callable[[], Value]) -> Value:
        """Value of a key, computed if it is not cached."""
        if key not in self:
            self[key] = made()
        return self[key]


def digest_of(text: str) -> str:
    """SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


class Bench(Protocol):
    """Opened file, and its numbers at other gains. Only `opened.saved` changes, on saving."""

    opened: Opened

    def __init__(self, opened: Opened) -> None: ...

    def opening(self) -> dict[str, Any]:
        """Parts that stay the same while the page is open."""
        ...

    def quick(self, view: View, window: tuple[float, float] | None, known: str) -> Iterator[Part]:
        """Parts computed at every gesture, the quickest first; `known`: key of the map that the page already has."""
        ...

    def curves(self, view: View, window: tuple[float, float] | None, known: str, final: bool, progress: Progress = quiet) -> Iterator[Part]:
        """Parts computed shortly after a gesture; `final`: the gesture has ended, so there is time for more."""
        ...

    def full(self, view: View, window: tuple[float, float] | None, progress: Progress) -> Iterator[Part]:
        """Parts that the command line would print for the same gains, certified in the same way."""
        ...

    def recommended(self, view: View, progress: Progress) -> Iterator[Part]:
        """Recommended gains, if they take too long to be found with everything else."""
        ...

    def plant(self, view: View) -> str:
        """Key of the plant: views with equal keys have the same recommended gains."""
        ...

    def shaken(self, view: View, progress: Progress) -> Iterator[Part]:
        """Parts of a simulated run."""
        ...

    def text(self, view: View) -> str:
        """Text of the file, edited to have the view's values."""
        ...

    def copied(self, view: View, form: str) -> str:
        """Gains in one of messages.Form."""
        ...

    def mesh(self, place: int) -> bytes | None:
        """Packed mesh of the robot; None if there is none."""
        ...

    def page(self, view: View) -> str:
        """Report of the view, as the command line writes it."""
        ...


def advised(use: ToUse, warnings: Iterable[str]) -> dict[str, Any]:
    """Gains to use as the page shows them: sentences in reading order, each with the lines that it is about."""
    later = [] if use.folded is None else [use.folded]
    notes = [(use.heading, use.lines), *((text, ()) for text in use.remarks), *later, *((text, ()) for text in warnings)]
    return {
        "lines": use.folded[1] if use.folded else use.lines,
        "notes": [{"text": text.replace("`", ""), "lines": lines} for text, lines in notes if text],
    }


def drawn_response(omega: Floats, value: Complexes, phase: Floats, marks: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return ratio (k,) at `omega` [rad/s], with its phase [°], for Bode and Nyquist plots; `marks`: decisive frequencies, by name."""
    return {
        "hz": rounded(omega / (2 * math.pi), 6),
        "size": rounded(20 * np.log10(np.abs(value))),
        "phase": rounded(phase),
        "re": rounded(value.real),
        "im": rounded(value.imag),
        "marks": [{"name": name, "hz": at / (2 * math.pi)} for name, at in (marks or {}).items() if math.isfinite(at)],
    }


def drawn_step(found: StepResponse, pick: slice, scale: float) -> dict[str, Any]:
    """Link and motor after a step of the reference and under a load, the latter times `scale`; `pick`: the points drawn."""
    return {
        "ms": rounded(1e3 * found.time[pick]),
        "reference": rounded(found.reference.link[pick]),
        "reference_motor": rounded(found.reference.motor[pick]),
        "disturbance": rounded(scale * found.load.link[pick]),
        "disturbance_motor": rounded(scale * found.load.motor[pick]),
    }


def drawn_line(points: Floats) -> list[list[float | None]]:
    """Points (k, 2) of a line in a gain map."""
    return [rounded(column, 6) for column in points.T]


def rounded(values: Any, significant: int = 5) -> list[float | None]:
    """Numbers with fewer digits for a picture, a third of the bytes; None for values that are not finite."""
    exact = np.asarray(values, dtype=float).ravel()
    sound = np.isfinite(exact)
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.clip(significant - 1 - np.floor(np.log10(np.abs(exact))), -290, 290)
        scale = 10.0 ** np.abs(np.where(np.isfinite(place), place, 0))
        # A whole number by a power of ten, so that what is written has no more digits
        short = np.where(place > 0, np.rint(exact * scale) / scale, np.rint(exact / scale) * scale)
    found = np.where(exact == 0, 0.0, short).tolist()
    return found if sound.all() else [value if good else None for value, good in zip(found, sound.tolist(), strict=True)]
