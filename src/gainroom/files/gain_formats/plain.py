"""Plain YAML or JSON: joint name or pattern → {kp, kd, ki, motor_inertia, …} or [kp, kd], at the top or under `gains`.

Later patterns win.
"""

from typing import Any

from pydantic import Field, model_validator

from ...io.validation import Section, validate
from .gain_record import AnyGain, Gain, GainFile


class PlainFile(Section):
    """Joint or pattern → gains."""

    gains: dict[str, AnyGain] = Field(description="the gains by joint or pattern")

    @model_validator(mode="before")
    @classmethod
    def _at_the_top(cls, data: Any) -> Any:
        return data if not isinstance(data, dict) or "gains" in data else {"gains": data}


def is_plain(data: dict[str, Any]) -> bool:
    """Whether a file's data look like plain gains."""
    section = data.get("gains", data)
    return isinstance(section, dict) and any(_is_gain(value) for value in section.values())


def is_plain_gain(data: dict[str, Any]) -> bool:
    """Whether a mapping is plain gains wherever it stands: a pair of numbers alone says too little, but under `gains`."""
    section = data.get("gains", data)
    values = list(section.values()) if isinstance(section, dict) else []
    if section is not data and values and all(isinstance(each, list) and _is_gain(each) for each in values):
        return True
    sections = [each for each in values if isinstance(each, dict) and "p" not in each]
    return any(not isinstance(each.get(key, {}), dict | list) for each in sections for key in ("kp", "kd"))


def _is_gain(value: object) -> bool:
    """Whether `value` looks like plain gains: a list of numbers, or a section with one of their keys."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(item, int | float) for item in value)
    return isinstance(value, dict) and ("kp" in value or "kd" in value)


def read_plain(data: dict[str, Any], source: str) -> GainFile:
    """Raises GainroomError."""
    file = validate(PlainFile, data, source)
    return GainFile(source, "plain", {name: Gain(**each.model_dump()) for name, each in file.gains.items()})
