"""What a form of export is, and what the texts of several have in common.

Numbers are written in as many digits as it takes to read the same ones again: gains may lie at the edge of what is required.
"""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..gain_formats.gain_record import Gain, GainFile, Origin

WORDS = {"true", "false", "null", "yes", "no", "on", "off", "y", "n", "default"}
"""Words that some YAML reader, or ours, does not read as a name."""


@dataclass(frozen=True)
class ExportedGains:
    """Content of a file to be written: gains by joint, their origin, and the joint angles that are not 0, by joint."""

    gains: Mapping[str, Gain]
    origin: Origin = field(default=Origin())
    posture: Mapping[str, float] = field(default_factory=dict)


Written = Callable[[ExportedGains, Sequence[str]], str]
"""Text with gains, and header lines as its comment."""


@dataclass(frozen=True)
class ExportForm:
    """Form in which gains are written. A new one is a file here with an instance, and its place in FORMS.

    name         as --to has it
    title        on the page's button
    description  what holds the gains, in a few words
    ending       of its files
    written      text of a whole file; None: only an existing file takes gains
    onto         text of an existing file with the gains in it, of its text, its path, gains and header; None: it is written as a whole
    pasted       text for the clipboard; None: that of a whole file
    read         gains in a text that `audit` reads, of the text and its path, or None for a text of another form; without it,
                 files/gain_files.py knows the form
    completed    gains read from a text at a path, with what `audit` takes from that file as the robot's model
    notes        on the gains in a text, and the file that took them
    integral     True if it holds an integral gain
    is_model     True if a file of it is a robot's model, whose joints patterns are matched with
    """

    name: str
    title: str
    description: str
    ending: str
    written: Written | None
    onto: Callable[[str, Path, ExportedGains, Sequence[str]], str] | None = None
    pasted: Written | None = None
    read: Callable[[str, Path], GainFile | None] | None = None
    completed: Callable[[GainFile, str, Path], GainFile] | None = None
    notes: Callable[[ExportedGains, str, Path | None], list[str]] | None = None
    integral: bool = False
    is_model: bool = False

    @property
    def text_to_paste(self) -> Written | None:
        """Writer of a text for the clipboard; None: an existing file alone takes the gains."""
        return self.pasted or self.written


def number_text(value: float) -> str:
    """Number with a decimal point, so that no reader takes it for an integer (parameters of ROS have types); ".inf" for infinity."""
    if math.isinf(value):
        return ".inf"  # in YAML, of a rigid gearbox
    text = repr(float(value))
    mantissa, sign, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{sign}{exponent}"


def commented(header: Sequence[str]) -> str:
    """Lines of comment."""
    return "".join(f"# {line}\n" for line in header)


def quoted(name: str) -> str:
    """Name as a YAML key, quoted where necessary."""
    return name if re.fullmatch(r"[A-Za-z_]\w*", name) and name.lower() not in WORDS else json.dumps(name)


def entries(values: Mapping[str, float]) -> str:
    """Names and numbers, as YAML and Python write them between braces."""
    return ", ".join(f"{quoted(name)}: {number_text(value)}" for name, value in values.items())
