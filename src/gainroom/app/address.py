"""View encoded behind the # of the page's address."""

from typing import Any
from urllib.parse import parse_qsl

from ..errors import GainroomError
from ..io.validation import validate
from .messages import View

NUMBERS = ("delay_ms", "stiffness", "link_inertia", "sample_rate_hz", "payload")
NAMES = ("structure", "posture", "contact", "joint", "payload_at")


def view_of(text: str) -> View:
    """View of "kp=1000&kd=30&delay_ms=3"; of a robot gains are gain.NAME=KP,KD (or kp:9,kv:30,ki:60) and angles at.NAME=VALUE.

    Raises GainroomError for what is no view.
    """
    gains: dict[str, Any] = {}
    values: dict[str, Any] = {"gains": gains, "angles": {}}
    for name, value in parse_qsl(text.removeprefix("#"), keep_blank_values=True):
        if name in NAMES:
            values[name] = value
        elif name.startswith("gain."):
            parts = [part.rpartition(":") for part in value.split(",")]
            gains[name.removeprefix("gain.")] = {key or ["kp", "kd"][k > 0]: _number(each) for k, (key, _, each) in enumerate(parts)}
        elif name.startswith("at."):
            values["angles"][name.removeprefix("at.")] = _number(value)
        elif name in NUMBERS:
            values[name] = _number(value)
        else:
            gains[name] = _number(value)
    return validate(View, values, "--view")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise GainroomError(f"--view: {text[:40]!r} must be a number") from None
