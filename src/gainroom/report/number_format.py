"""Numbers as a person reads them: three to four significant digits, thin spaces between thousands, always a unit."""

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from ..errors import QUANTITIES, apart, digits as digits

if TYPE_CHECKING:
    from ..system.gain_path import GainPath

LARGE = 0.5
"""[rad, m] from which on distances are not in thousandths."""
MISSED = "✗"
"""The sign before a value in a table that misses what its column requires."""
UNITS = re.compile(r"(?<=[≥≤✗×]) (?=[\d−])|(?<=[\d∞]) (?=(?:×|%|°|dB|k?Hz|m?rad|m?s|m?m|kg|N·m[^\s,;)]*)(?![\w·/]))")
"""The spaces at which no line is broken: between number and unit, after a sign before a number. page.js has the same."""


def motion_unit(value: float, unit: str = "rad") -> tuple[float, str]:
    """Factor and unit in which a distance [rad, m] is shown: thousandths, or where it is LARGE as it is."""
    return (1.0, unit) if abs(value) > LARGE else (1e3, f"m{unit}")


def motion(value: float, unit: str = "rad", significant: int = 3) -> str:
    """A distance [rad, m] with the unit that suits it."""
    factor, shown = motion_unit(value, unit)
    return digits(factor * value, shown, significant)


def milli(value: float, floor: float = 1e-9) -> str:
    """An error [rad, m] in thousandths, without unit, with what is below `floor` as 0."""
    return digits(0.0 if abs(value) < floor else 1e3 * value, significant=3)


def settling(time: float) -> str:
    """A settling time [s]; inf: not in the run, NaN: nothing to settle."""
    return "not in this run" if math.isinf(time) else digits(time, "s", 3)


def gain_factor(gain: float, significant: int = 4) -> str:
    """A factor on the gains at which something begins, with digits enough to tell it from 1, the gains themselves."""
    return digits(gain, significant=apart(gain, 1.0, significant))


def hertz(omega: float) -> str:
    """`omega` [rad/s] in Hz; unlike frequency_text with a power of ten below 1 mHz and from 10 MHz on."""
    return digits(omega / (2 * math.pi), "Hz", 3)


def rate(hz: float) -> str:
    """Of a loop, in kHz from 1 kHz on."""
    return digits(1e-3 * hz, "kHz", 4) if hz >= 1e3 else digits(hz, "Hz", 4)


def frequency(omega: float | None, significant: int = 4) -> str:
    """`omega` [rad/s] in Hz and rad/s; a dash where there is none."""
    if omega is None or not math.isfinite(omega):
        return "–"
    return f"{hertz(omega)} ({digits(omega, 'rad/s', significant)})"


def quantity(name: str, *values: float) -> str:
    """A parameter of joint or drive (SI) by its field's name, with the unit a person expects: "delay 3 ms", or "delay 2 to 3 ms"."""
    scale, unit = QUANTITIES[name]
    *first, last = values
    return " ".join([name.replace("_", " "), *(f"{digits(scale * value)} to" for value in first), digits(scale * last, unit)])


def model_kind(sample_time: float | None) -> str:
    """Which of the two models of time a loop is studied in; `sample_time` [s], None: continuous."""
    return "continuous" if sample_time is None else "sampled"


def model_text(sample_time: float | None, kd_path: "GainPath | None" = None) -> str:
    """The same with its rate, for titles; where kd has a path of its own, with both."""
    rate = "" if sample_time is None else f", {digits(1 / sample_time, 'Hz')}"
    own = "" if kd_path is None else f", kd {digits(1 / kd_path.sample_time, 'Hz')}"
    return f"{model_kind(sample_time)} model{rate}{own}"


def model_facts(sample_time: float | None) -> dict[str, Any]:
    """What --json says of the model of time."""
    return {"model": model_kind(sample_time), "sample_rate_hz": None if sample_time is None else 1 / sample_time}


def path_facts(kd_path: "GainPath | None") -> dict[str, float] | None:
    """What --json says of kd's own path; null where it closes with the other gains."""
    return None if kd_path is None else {"delay_ms": 1e3 * kd_path.delay, "sample_rate_hz": 1 / kd_path.sample_time}


def own_gains(controller: Any, of_task: bool = False) -> list[tuple[str, float, str]]:
    """(name, value, unit) of a controller's own gains, in the order of its signature; `of_task`: of one direction of a task."""
    return [(key.name, float(getattr(controller, key.name)), key.of_task if of_task else key.unit) for key in controller.gain_keys()]


def typed_gains(controller: Any) -> str:
    """Its own gains with units, in digits that can be typed into a file."""
    return ", ".join(f"{name} {typed(value, 6)} {unit}".rstrip() for name, value, unit in own_gains(controller))


def typed(value: float, significant: int = 7) -> str:
    """A gain as it is typed: without exponent where it is large, and what is read back keeps what was recommended."""
    text = f"{value:.{significant}g}"
    return text if "e" not in text else repr(float(text)).removesuffix(".0")


def span(values: Iterable[float], unit: str = "") -> str:
    """One value where all are the same, else from the least to the largest."""
    found = [float(value) for value in values]
    if not found:
        return "none"
    low, high = min(found), max(found)
    return digits(low, unit) if low == high else f"{digits(low)} to {digits(high, unit)}"


def rounded_up(value: float, significant: int = 3) -> float:
    """To so many digits, never down: what is read off it is enough."""
    if not (math.isfinite(value) and value > 0):
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - significant + 1)
    return float(f"{unit * math.ceil(value / unit * (1 - 1e-12)):.{significant}g}")
