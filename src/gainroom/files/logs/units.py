"""Units of a log's columns: how each is written, and its factor to SI."""

import math
import re
from functools import lru_cache

from ...errors import GainroomError, one_line

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
TICKS = {"angle": re.compile(r"ticks/([0-9.eE+]{1,20})"), "speed": re.compile(r"ticks/([0-9.eE+]{1,20})/s")}
"""Patterns of encoder steps: the number of steps per revolution."""
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
    plain = re.sub(r"[\s·*⋅]|(?<=\w)\.(?=\w)", "", text.strip())
    plain = SPELLINGS.get(plain.lower(), plain).replace("/sec", "/s")
    units = UNITS[dimension]
    if plain in units:
        return plain
    pattern = TICKS.get(dimension)
    if pattern is not None and (found := pattern.fullmatch(plain)) and _positive(found[1]):
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
    unit = known_unit(plain, dimension)
    if unit is not None:
        return sign * (UNITS[dimension].get(unit) or 2 * math.pi / float(TICKS[dimension].fullmatch(unit)[1]))  # type: ignore[index]
    steps = [f"ticks/4096{'/s' if dimension == 'speed' else ''} (4096 a revolution)"] if dimension in TICKS else []
    allowed = ", ".join([*UNITS[dimension], *steps])
    raise GainroomError(f"{owner}: unit {one_line(repr(text), 60)} must be one of {allowed}; or a number that the column is multiplied by")


def _positive(text: str) -> float | None:
    """Number above 0 and within the range of factors; None for any other text."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 1e-12 <= value <= 1e12 else None
