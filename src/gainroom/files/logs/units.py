"""Units of a log's columns: how each is written, and its factor to SI."""

import math
import re
from collections.abc import Callable, Mapping
from functools import lru_cache

from ...errors import GainroomError, digits, one_line

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "rev": 2 * math.pi, "m": 1.0, "mm": 1e-3},
    "speed": {"rad/s": 1.0, "deg/s": math.pi / 180, "rev/s": 2 * math.pi, "rpm": math.pi / 30, "m/s": 1.0, "mm/s": 1e-3},
    "torque": {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2, "kNm": 1e3, "N": 1.0, "kN": 1e3},
    "current": {"A": 1.0, "mA": 1e-3},
}
"""Factors to SI by dimension and unit; lengths and forces are those of prismatic joints."""
SI = {"time": "s", "angle": "rad", "speed": "rad/s", "torque": "Nm", "current": "A"}
"""Units of numbers without a stated unit."""
_NUMBER = "([0-9.eE+]{1,20})"
SCALES: Mapping[str, tuple[tuple[re.Pattern[str], Callable[[float], float]], ...]] = {
    "angle": (
        (re.compile(f"(?:ticks|counts)/{_NUMBER}"), lambda steps: 2 * math.pi / steps),
        (re.compile(f"norm/{_NUMBER}"), lambda span: math.radians(span) / 200),
    ),
    "speed": ((re.compile(f"(?:ticks|counts)/{_NUMBER}/s"), lambda steps: 2 * math.pi / steps),),
    "current": ((re.compile(f"{_NUMBER}mA"), lambda step: 1e-3 * step),),
}
"""Units with a number in them, and the factor that it makes.

Encoder steps, by their number per revolution; LeRobot's −100 … 100, by the degrees between the two; current registers, by the step.
"""
OF_CURRENT = re.compile(rf"{_NUMBER}?(mA|A)\*([\w.+-]{{1,40}})")
"""Unit of a torque that is logged as a current: the current's unit, times N·m/A or the name of an actuator that has a torque constant."""
ONE_CONSTANT = 1.1
"""Largest ratio of an actuator's published torque constants for which the first of them is taken: fits to one servo differ by that."""
UNKNOWN = "?"
"""Unit of a column whose format does not say it, and whose numbers are not SI."""
FORMS: dict[str, tuple[str, ...]] = {
    "angle": ("counts/4096 or ticks/4096 (4096 a revolution)", "norm/DEGREES (LeRobot's −100 … 100 over the joint's calibrated range)"),
    "speed": ("counts/4096/s (4096 a revolution)",),
    "torque": ("mA*1.2 (a current, and N·m/A or the name of an actuator)",),
    "current": ("6.5mA (steps of 6.5 mA, as Feetech's STS has; 2.69mA of XM430 and XM540, 1mA of XL330)",),
}
"""Forms of units with numbers in them, as messages name them.

4096 steps a turn: MODEL_RESOLUTION in lerobot's motors/feetech/tables.py (STS, SMS) and motors/dynamixel/tables.py (X series).
1024 steps over 300 degrees of SCS and XL-320 are 1228.8 a turn: ROBOTIS e-manual, XL-320, Resolution and Goal Position(30).
6.5 mA: Feetech's memory table of the STS series, present current at address 69. 2.69 mA and 1 mA: ROBOTIS e-manual, Goal Current(102) of
XM430-W350 and Present Current(126) of XL330-M288.
"""
MOST_LETTERS = 40
"""Maximum length of a unit's name."""
SPELLINGS = {
    spelling: unit
    for unit, spellings in {
        "s": "sec secs seconds second",
        "ms": "msec",
        "us": "µs μs usec",
        "ns": "nsec nanoseconds",
        "deg": "° degree degrees",
        "rad": "radian radians",
        "rev": "turn turns revs",
        "rev/s": "rps",
        "rad/s": "rads radps rads^-1 rads-1",
        "deg/s": "degps °/s dps degs^-1 degs-1",
        "A": "amp amps ampere",
    }.items()
    for spelling in spellings.split()
}
"""Alternative spellings of units."""


def known_unit(text: str, dimension: str) -> str | None:
    """Unit of `dimension` in any spelling of `text`; None if it is none."""
    return _known(text, dimension) if len(text) <= MOST_LETTERS else None


@lru_cache(1 << 12)
def _known(text: str, dimension: str) -> str | None:
    if _scaled(text.strip(), dimension) is not None:
        return text.strip()
    plain = re.sub(r"[\s·*⋅]|(?<=\w)\.(?=\w)", "", text.strip())
    plain = SPELLINGS.get(plain.lower(), plain).replace("/sec", "/s")
    units = UNITS[dimension]
    if plain in units:
        return plain
    close = [unit for unit in units if unit.lower() == plain.lower()]  # a header may write NM, and no two units differ by case alone
    return close[0] if len(close) == 1 else None


def factor(text: str, dimension: str, owner: str) -> float:
    """Factor to SI from the unit `text`, or from a bare number that is the factor itself.

    A minus before either turns the sign round. Raises GainroomError that begins with `owner`.
    """
    sign, plain = (-1.0, text.strip()[1:]) if text.strip().startswith("-") else (1.0, text.strip())
    value = _positive(plain)
    if value is not None:
        return sign * value
    if dimension == "torque" and (current := OF_CURRENT.fullmatch(plain)):
        step = _positive(current[1] or "1")
        if step is not None:
            return sign * step * UNITS["current"][current[2]] * _torque_constant(current[3], owner)
    scaled = _scaled(plain, dimension)
    if scaled is not None:
        return sign * scaled
    unit = known_unit(plain, dimension)
    if unit is not None:
        return sign * UNITS[dimension][unit]
    allowed = unit_choices(dimension)
    raise GainroomError(f"{owner}: unit {one_line(repr(text), 60)} must be one of {allowed}; or a number that the column is multiplied by")


def _scaled(text: str, dimension: str) -> float | None:
    """Factor of a unit with a number in it; None for any other text."""
    for pattern, factor_of in SCALES.get(dimension, ()):
        if (found := pattern.fullmatch(text)) and (value := _positive(found[1])) is not None:
            return factor_of(value)
    return None


def _torque_constant(text: str, owner: str) -> float:
    """Torque constant [N m/A], a number or that published of an actuator. Raises GainroomError that begins with `owner`."""
    from ..actuator_facts import actuators, unknown_actuator  # reads a large file

    if (value := _positive(text)) is not None:
        return value
    if text not in actuators():
        raise GainroomError(f"{owner}: {unknown_actuator(text)}")
    found = actuators()[text].used("torque_constant")
    if found is None:
        raise GainroomError(f"{owner}: the torque constant of {text} is not published: give it in N·m/A in its place")
    if found.high > ONE_CONSTANT * found.low:
        between = f"{digits(found.low, '', 3)} to {digits(found.high, 'N·m/A', 3)}"
        raise GainroomError(f"{owner}: the torque constant of {text} is published as {between}: give a number in its place")
    return found.value


def _positive(text: str) -> float | None:
    """Number above 0 and within the range of factors; None for any other text."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 1e-12 <= value <= 1e12 else None


def unit_choices(dimension: str) -> str:
    """Units of a dimension, as messages name them."""
    return ", ".join([*UNITS[dimension], *FORMS.get(dimension, ())])
