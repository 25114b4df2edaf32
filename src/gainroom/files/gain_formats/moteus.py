"""Reader of the gains of moteus controllers, in their unit: N m per revolution of the output, which is 2π rad.

Either the output of `moteus_tool --dump-config` (`servo.pid_position.kp 4.0` on a line), which is of one controller, or YAML with a section
`moteus`: joint or pattern → {kp, ki, kd}.
(moteus' reference: kp N m per rotation, ki N m/s per rotation, kd N m per rotation/s, at the output.)
"""

import math
import re
from dataclasses import replace
from functools import partial
from typing import Any

from pydantic import Field

from ...errors import GainroomError, Together
from ...io.validation import Section, checked, validate
from .gain_record import NOT_NEGATIVE, AnyGain, Gain, GainFile

REVOLUTION = 2 * math.pi
TERM = re.compile(r"^(?:conf set )?servo\.pid_position\.(kp|ki|kd)[ \t]+(\S{1,60})[ \t]*$", re.MULTILINE)


class MoteusFile(Section):
    """Section `moteus`: joint or pattern → gains per revolution."""

    moteus: dict[str, AnyGain] = Field(description="the gains by joint or pattern")


def is_dump(text: str) -> bool:
    """True if a text is a configuration dump of a moteus controller."""
    return TERM.search(text) is not None


def read_dump(text: str, source: str) -> GainFile:
    """Gains of one controller, for every joint of a model. Raises GainroomError."""
    found: dict[str, float] = {}

    def read(match: re.Match[str]) -> None:
        name, written = match.groups()
        owner = f"{source}: line {text.count(chr(10), 0, match.start()) + 1}: servo.pid_position.{name}"
        if name in found:
            raise GainroomError(f"{owner}: is given twice")
        found[name] = math.nan  # as long as it is not known
        try:
            value = float(written)
        except ValueError as error:
            raise GainroomError(f"{owner}: {written!r} must be a number") from error
        found[name] = checked(owner, value, NOT_NEGATIVE)

    with Together() as together:
        for match in TERM.finditer(text):
            together.step(partial(read, match))
        if "kp" not in found:
            raise GainroomError(f"{source}: servo.pid_position.kp is missing: the gain on position [N·m/rev]")
    note = (
        f"{source}: is of one controller, and taken for every joint of the model; name joints in a YAML file, moteus: {{joint: {{kp, kd}}}}"
    )
    gain = _in_radians(Gain(found["kp"], found.get("kd", 0.0), found.get("ki", 0.0)))
    return GainFile(source, "moteus", {".*": gain}, notes=(note,))


def read_moteus(data: dict[str, Any], source: str) -> GainFile:
    """Gains in the section `moteus` of a YAML file. Raises GainroomError."""
    file = validate(MoteusFile, data, source)
    return GainFile(source, "moteus", {name: _in_radians(Gain(**each.model_dump())) for name, each in file.moteus.items()})


def _in_radians(gain: Gain) -> Gain:
    return replace(gain, kp=gain.kp / REVOLUTION, kd=gain.kd / REVOLUTION, ki=gain.ki / REVOLUTION)
