"""Number formatting: three to four significant digits, thin spaces between thousands, always a unit."""

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from ..errors import QUANTITIES, apart, digits as digits

if TYPE_CHECKING:
    from ..system.gain_path import GainPath

LARGE = 0.5
"""Distance [rad, m] above which thousandths are not used."""
MISSED = "✗"
"""Mark before a value in a table that misses its column's requirement."""
UNITS = re.compile(r"(?<=[≥≤✗×]) (?=[\d−])|(?<=[\d∞]) (?=(?:×|%|°|dB|k?Hz|m?rad|m?s|m?m|kg|N·m[^\s,;)]*)(?![\w·/]))")
"""Spaces at which no line is broken: between number and unit, after a sign before a number. page.js has the same pattern."""


def motion_unit(value: float, unit: str = "rad") -> tuple[float, str]:
    """Factor and unit for a distance [rad, m]: thousandths, or the unit itself above LARGE."""
    return (1.0, unit) if abs(value) > LARGE else (1e3, f"m{unit}")


def motion(value: float, unit: str = "rad", significant: int = 3) -> str:
    """Distance [rad, m] with its unit as text."""
    factor, shown = motion_unit(value, unit)
    return digits(factor * value, shown, significant)


def milli(value: float, floor: float = 1e-9) -> str:
    """Error [rad, m] in thousandths, without unit; 0 below `floor`."""
    return digits(0.0 if abs(value) < floor else 1e3 * value, significant=3)


def settling(time: float) -> str:
    """Settling time [s] as text; inf: not in the run, NaN: nothing to settle."""
    return "not in this run" if math.isinf(time) else digits(time, "s", 3)


def gain_factor(gain: float, significant: int = 4) -> str:
    """Factor on the gains as text, with enough digits to distinguish it from 1."""
    return digits(gain, significant=apart(gain, 1.0, significant))


def hertz(omega: float) -> str:
    """Frequency `omega` [rad/s] in Hz; unlike frequency_text with a power of ten below 1 mHz and from 10 MHz on."""
    return digits(omega / (2 * math.pi), "Hz", 3)


def one_degree(stiffness: float, omega: float, static: float) -> str:
    """Load torque that turns a link by 1°, as text: at rest, and what is enough at the frequency [rad/s] of its dynamic stiffness.

    "" where that is not known, 0 or infinite: nothing holds the link, or nothing moves it.
    """
    if not 0 < stiffness < math.inf:
        return ""
    at_rest = digits(math.radians(static), "N·m", 3)
    return at_rest if omega == 0 else f"{at_rest}, swinging at {hertz(omega)} {digits(math.radians(stiffness), 'N·m', 3)}"


def rate(hz: float) -> str:
    """Sample rate as text, in kHz from 1 kHz on."""
    return digits(1e-3 * hz, "kHz", 4) if hz >= 1e3 else digits(hz, "Hz", 4)


def frequency(omega: float | None, significant: int = 4) -> str:
    """Frequency `omega` [rad/s] in Hz and rad/s; a dash if there is none."""
    if omega is None or not math.isfinite(omega):
        return "–"
    return f"{hertz(omega)} ({digits(omega, 'rad/s', significant)})"


def quantity(name: str, *values: float) -> str:
    """Parameter of joint or drive (SI) by its field's name, in its displayed unit: "delay 3 ms", or "delay 2 to 3 ms"."""
    scale, unit = QUANTITIES[name]
    *first, last = values
    return " ".join([name.replace("_", " "), *(f"{digits(scale * value)} to" for value in first), digits(scale * last, unit)])


def model_kind(sample_time: float | None) -> str:
    """Name of the time model, continuous or sampled; `sample_time` [s], None: continuous."""
    return "continuous" if sample_time is None else "sampled"


def model_text(sample_time: float | None, kd_path: "GainPath | None" = None) -> str:
    """Name of the time model with its rate, for titles; with both rates if kd has a separate path."""
    rate = "" if sample_time is None else f", {digits(1 / sample_time, 'Hz')}"
    own = "" if kd_path is None else f", kd {digits(1 / kd_path.sample_time, 'Hz')}"
    return f"{model_kind(sample_time)} model{rate}{own}"


def model_facts(sample_time: float | None) -> dict[str, Any]:
    """JSON of the time model."""
    return {"model": model_kind(sample_time), "sample_rate_hz": None if sample_time is None else 1 / sample_time}


def path_facts(kd_path: "GainPath | None") -> dict[str, float] | None:
    """JSON of kd's separate path; null if it closes with the other gains."""
    return None if kd_path is None else {"delay_ms": 1e3 * kd_path.delay, "sample_rate_hz": 1 / kd_path.sample_time}


def own_gains(controller: Any, of_task: bool = False) -> list[tuple[str, float, str]]:
    """Gains of a controller as (name, value, unit), in the order of its signature; `of_task`: of one direction of a task."""
    return [(key.name, float(getattr(controller, key.name)), key.of_task if of_task else key.unit) for key in controller.gain_keys()]


def typed_gains(controller: Any) -> str:
    """Gains of a controller with units, in digits that can be typed into a file."""
    return ", ".join(f"{name} {typed(value, 6)} {unit}".rstrip() for name, value, unit in own_gains(controller))


def typed(value: float, significant: int = 7) -> str:
    """Gain as typed into a file: rounded, without exponent if it is large."""
    text = f"{value:.{significant}g}"
    return text if "e" not in text else repr(float(text)).removesuffix(".0")


def span(values: Iterable[float], unit: str = "") -> str:
    """Value if all are equal, otherwise the range from the least to the largest."""
    found = [float(value) for value in values]
    if not found:
        return "none"
    low, high = min(found), max(found)
    return digits(low, unit) if low == high else f"{digits(low)} to {digits(high, unit)}"


def rounded_up(value: float, significant: int = 3) -> float:
    """Value rounded up to `significant` digits, so that it stays sufficient."""
    if not (math.isfinite(value) and value > 0):
        return value
    unit = 10.0 ** (math.floor(math.log10(value)) - significant + 1)
    return float(f"{unit * math.ceil(value / unit * (1 - 1e-12)):.{significant}g}")
