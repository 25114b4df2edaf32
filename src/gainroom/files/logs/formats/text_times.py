"""Times of day and dates in text (ISO 8601, `12:34:56.789`, `01/02/2024 12:34:56 PM`) as seconds."""

import math
import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from ....system.linear.arrays import Floats

TIME = re.compile(
    r"(?:(?P<date>[0-9]{1,4}[-/.][0-9]{1,2}[-/.][0-9]{1,4}|[0-9]{8})(?:[T_]|,? +))?"
    r"(?:(?P<hours>[0-9]{1,2}):)?(?P<minutes>[0-9]{1,2}):(?P<seconds>[0-9]{1,2})(?:[.,:](?P<part>[0-9]{1,12}))?"
    r"(?: *(?P<half>[AaPp])\.?[Mm]\.?)?(?: *(?P<zone>Z|UTC|[-+][0-9]{2}:?[0-9]{2}))?"
)
DAY, HOUR = 86_400, 3_600
EPOCH = date(1970, 1, 1).toordinal()
PROBED = 100
"""Texts that show whether a column is one of times."""
MOST_LETTERS = 60
NONE = -(1 << 62)


def times_in(texts: Sequence[object]) -> Floats | None:
    """Times (k,) [s] of texts, since 1970, or since midnight if they have no date; None if fewer than half of the first are times."""
    some = [text for text in texts[:PROBED] if isinstance(text, str) and text]
    if not some or 2 * sum(map(is_time, some)) < len(some):
        return None
    clock = TextClock()
    return clock.seconds([text if isinstance(text, str) else "" for text in texts]) + (clock.base or 0)


def is_time(text: str) -> bool:
    """True if a text is a time of day, with or without a date."""
    text = text.strip().strip('"')
    return len(text) <= MOST_LETTERS and TIME.fullmatch(text) is not None


class TextClock:
    """Converter of a column of texts, in order, to seconds. Times without a date go on after midnight, those without hours after the hour.

    base   [s] what was taken off: whole seconds of the first one
    """

    def __init__(self) -> None:
        self.base: int | None = None
        self._last, self._turns = 0, 0

    def seconds(self, texts: Sequence[str]) -> Floats:
        """Times (k,) [s] less `base`; NaN for texts that are no time."""
        found = np.array([self._nanoseconds(text) for text in texts], dtype=np.int64)
        good = found != NONE
        if self.base is None:
            self.base = int(found[good][0] // 10**9) if good.any() else None
        base = self.base or 0
        return np.where(good, (np.where(good, found, base * 10**9) - base * 10**9) / 1e9, math.nan)

    def _nanoseconds(self, text: str) -> int:
        """Time of a text [ns], since 1970, or since midnight if it has no year."""
        text = text.strip().strip('"')
        match = TIME.fullmatch(text) if len(text) <= MOST_LETTERS else None
        if match is None:
            return NONE
        hours, minutes, seconds = (int(match[name] or 0) for name in ("hours", "minutes", "seconds"))
        if hours > 24 or minutes > 59 or seconds > 60:  # a leap second
            return NONE
        if match["half"]:
            hours = hours % 12 + 12 * (match["half"] in "Pp")
        part = int((match["part"] or "").ljust(9, "0")[:9])
        value = (3600 * hours + 60 * minutes + seconds - _offset(match["zone"])) * 10**9 + part
        day = _day(match["date"])
        return value + day * DAY * 10**9 if day is not None else self._onward(value, DAY if match["hours"] else HOUR)

    def _onward(self, value: int, period: int) -> int:
        turned = value + self._turns * period * 10**9
        if turned < self._last - period * 10**9 // 2:  # back by more than half a day: another one has begun
            self._turns += 1
            turned += period * 10**9
        self._last = max(self._last, turned)
        return turned


def _day(text: str | None) -> int | None:
    """Days since 1970 of a date that begins with its year; None for others, in which day and month may be exchanged."""
    parts = [] if text is None else re.split(r"[-/.]", text) if len(text) != 8 or not text.isdigit() else [text[:4], text[4:6], text[6:]]
    if not parts or len(parts[0]) != 4:
        return None
    try:
        return date(int(parts[0]), int(parts[1]), int(parts[2])).toordinal() - EPOCH
    except ValueError:
        return None


def _offset(zone: str | None) -> int:
    """Offset [s] of a time zone, positive east of Greenwich."""
    if not zone or zone[0] not in "+-":
        return 0
    digits = zone[1:].replace(":", "")
    return (-1 if zone[0] == "-" else 1) * (3600 * int(digits[:2]) + 60 * int(digits[2:]))
