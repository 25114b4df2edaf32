"""Options for reading a log: columns, units and the part of the log that is wanted, from flags or from a small YAML file."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError
from pydantic_core import InitErrorDetails

from ...errors import GainroomError, Together, all_of, named, nearest, require_positive
from ...identification.record import SIGNALS
from ...io.validation import Name, Section, number, partly, refusal
from ...io.yaml_text import parse_yaml, read_text, shown
from .channels import CHANNELS
from .units import factor

MOST_EPISODES = 10**9
"""Bound on an episode's number."""


@dataclass(frozen=True)
class LogOptions:
    """Options for reading a log.

    columns       the file's column by channel, or by channel.joint; `{joint}` in it stands for every joint's name
    units         by channel: a unit, or a number to multiply by; a minus before it turns the sign round
    rotor_side    channels that the file holds before the gearbox; `gear_ratio` brings them to the joint side
    sample_rate   [Hz] rows come at this rate, whatever their time stamps; None: by their time stamps
    start, end    [s] after the first row; None: from the first, to the last
    joints        names or regular expressions; empty: all
    episode       of a data set; None: the first

    Raises GainroomError for a channel, a unit or a number that cannot be.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    rotor_side: tuple[str, ...] = ()
    gear_ratio: float = 1.0
    sample_rate: float | None = None
    start: float | None = None
    end: float | None = None
    joints: tuple[str, ...] = ()
    episode: int | None = None

    def __post_init__(self) -> None:
        checks: list[Callable[[], object]] = [
            *(partial(_channel, key.partition(".")[0], "columns") for key in self.columns),
            *(partial(_unit, key, unit) for key, unit in self.units.items()),
            *(partial(_side, key) for key in self.rotor_side),
            partial(require_positive, "log", "gear_ratio", self.gear_ratio),
            self._require_ratio,
            lambda: self.sample_rate is None or require_positive("log", "sample_rate_hz", self.sample_rate, "Hz"),
            self._require_span,
            self._require_episode,
            *(partial(_pattern, text) for text in self.joints),
        ]
        all_of(checks)

    def _require_ratio(self) -> None:
        if self.rotor_side and self.gear_ratio == 1:
            raise GainroomError("rotor_side: needs gear_ratio, the motor's turns per turn of the joint")

    def _require_span(self) -> None:
        begin = 0.0 if self.start is None else require_positive("log", "start", self.start, "s", zero=True)
        if self.end is not None and require_positive("log", "end", self.end, "s") <= begin:
            raise GainroomError(f"log: end {self.end:g} s must be > start {begin:g} s")

    def _require_episode(self) -> None:
        if self.episode is not None and not 0 <= self.episode < MOST_EPISODES:
            raise GainroomError(f"log: episode {self.episode} must be a number from 0 to {MOST_EPISODES - 1}")

    def scale(self, channel: str, unit: str, owner: str) -> float:
        """Factor from the file's numbers in `unit` to SI on the joint side. Raises GainroomError if the unit is not known."""
        value = factor(self.units.get(channel, unit), CHANNELS[channel].dimension, owner)
        if channel not in self.rotor_side:
            return value
        return value * self.gear_ratio if CHANNELS[channel].dimension == "torque" else value / self.gear_ratio

    def wants(self, joint: str) -> bool:
        """True if a joint is among those asked for."""
        return not self.joints or any(joint == pattern or re.fullmatch(pattern, joint) for pattern in self.joints)


def _channel(key: str, owner: str) -> str:
    if key not in CHANNELS:
        raise GainroomError(f"{owner}: unknown channel {key!r}{nearest(key, [*CHANNELS], 'channel')}")
    return key


def _unit(key: str, unit: str) -> None:
    factor(unit, CHANNELS[_channel(key, "units")].dimension, f"units: {key}")


def _side(key: str) -> None:
    if CHANNELS[_channel(key, "rotor_side")].dimension in ("time", "current"):
        raise GainroomError(f"rotor_side: {key} has no side of the gearbox")


def _pattern(text: str) -> None:
    try:
        re.compile(text)
    except (re.error, OverflowError) as error:
        raise GainroomError(f"joints: {text!r} is neither a name nor a regular expression: {error}") from error


def assignments(texts: Sequence[str], owner: str) -> dict[str, str]:
    """Mapping from the text `target_torque=cmd,motor_position=enc`, which may come in parts. Raises GainroomError."""
    found: dict[str, str] = {}
    for text in texts:
        for part in text.split(","):
            key, sign, value = (piece.strip() for piece in part.partition("="))
            if not (key and sign and value):
                raise GainroomError(f"{owner}: {part!r} must be CHANNEL=VALUE, several with commas between: target_torque=cmd,time=t")
            if key in found:
                raise GainroomError(f"{owner}: {key} is given twice")
            found[key] = value
    return found


def _texts(value: object) -> dict[str, str]:
    if not isinstance(value, dict):
        raise refusal(f"{shown(value)} must be a section with channels as keys")
    wrong = [
        InitErrorDetails(type=refusal(f"{shown(text)} must be a name"), loc=(key,), input=text)
        for key, text in value.items()
        if isinstance(text, bool) or not isinstance(text, str | int | float)
    ]
    if wrong:
        raise ValidationError.from_exception_data("names", wrong)
    return {key: str(text) for key, text in value.items()}


Assignments = Annotated[dict[str, str], BeforeValidator(_texts)]


def _number_of_episode(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < MOST_EPISODES:
        raise refusal(f"{shown(value)} must be a whole number >= 0")
    return value


class LogSection(Section):
    """File of log options: LogOptions in YAML."""

    columns: Assignments = Field(default_factory=dict)
    units: Assignments = Field(default_factory=dict)
    rotor_side: list[Annotated[str, Field(strict=True)]] = Field(default_factory=list, max_length=len(SIGNALS))
    gear_ratio: Annotated[float, number(above=0)] = 1.0
    sample_rate_hz: Annotated[float | None, number(above=0, most=1e6, unit="Hz")] = None
    start: Annotated[float | None, number(least=0, unit="s")] = None
    end: Annotated[float | None, number(above=0, unit="s")] = None
    joints: list[Name] = Field(default_factory=list, max_length=200)
    episode: Annotated[int | None, BeforeValidator(_number_of_episode)] = None


def load_options(path: Path) -> dict[str, Any]:
    """Fields of LogOptions in a YAML file. Raises GainroomError."""
    with named(str(path)), Together() as together:
        data = parse_yaml(read_text(path), str(path), together=together)
        section = partly(LogSection, data if data is not None else {}, str(path), together)
        given = {
            name: getattr(section, name) for name in LogSection.model_fields if name in section.model_fields_set and section.is_right(name)
        }
        if "sample_rate_hz" in given:
            given["sample_rate"] = given.pop("sample_rate_hz")
        given |= {name: tuple(given[name]) for name in ("rotor_side", "joints") if name in given}
        judged = given if section.is_right("gear_ratio") else {name: value for name, value in given.items() if name != "rotor_side"}
        LogOptions(**judged)
    return given
