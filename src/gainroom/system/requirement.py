"""A requirement: one object that knows its key in a file, its unit, how it is judged, and what it keeps L(jω) out of."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GainroomError
from .excluded_sets import ROUND_OFF, ExcludedSet
from .linear.arrays import Floats
from .loop_protocols import Curves, MarginRecord, Sampled
from .margin_units import IN_SI


def enough(value: float, needed: float) -> bool:
    """Whether `value` is at least `needed` but for ROUND_OFF; False for NaN."""
    return bool(value >= needed * (1 - ROUND_OFF))


@dataclass(frozen=True)
class Requirement:
    """A bound on one margin. Values are in SI: a factor, rad, s.

    name     in Python, and the field of Margins that is shown
    title    for people: "phase margin"
    key      in files and in JSON, with the unit that people read
    unit     that unit; `scale` is the factor to it from SI
    symbol   a short heading; "": the title
    bounds   the field of Margins that is held against the requirement; "": `name`. Where Margins has no such field: `measured`
    at_frequency   the field with the frequency that belongs to it [rad/s]; "": there is none
    at_most  True: the margin may be as large as what is asked for; False: as small
    low, high   what is asked for lies between these
    most     what a file may ask for, in `unit`
    usual    what is asked for where nothing is said; None: nothing
    meaning  what it is of several coupled loops, in a sentence
    of_several   its title where there are several loops and it is of all of them together, or of each, by definition; "": the title says it
    """

    name: str
    title: str
    key: str
    unit: str = ""
    scale: float = 1.0
    symbol: str = ""
    bounds: str = ""
    at_frequency: str = ""
    at_most: bool = False
    low: float = 0.0
    high: float = math.inf
    most: float = 1e12
    usual: float | None = None
    meaning: str = ""
    of_several: str = ""

    def titled(self, found: MarginRecord, several: bool, short: bool = False) -> str:
        """The title of what `found` has: of which loops it is, where there are several; `short`: the heading where one says enough."""
        if (named := self.named(found)) != self.title:
            return named
        return self.of_several if several and self.of_several else self.heading if short else self.label

    @property
    def heading(self) -> str:
        """The symbol, or the title where there is none."""
        return self.symbol or self.title

    @property
    def label(self) -> str:
        """The title with its symbol: "peak sensitivity Ms"."""
        return f"{self.title} {self.symbol}".rstrip()

    @property
    def sign(self) -> str:
        """≥ or ≤."""
        return "≤" if self.at_most else "≥"

    def in_unit(self, value: float) -> float:
        """`value`, in SI, in the unit that people read."""
        return self.scale * value

    def in_si(self, value: float) -> float:
        """`value`, in the unit that people read, in SI."""
        return value / self.scale

    def text(self, value: float, significant: int = 3) -> str:
        """As text: "6 dB", "30°", "2"."""
        if not math.isfinite(value):
            return "not known" if math.isnan(value) else "∞"
        number = f"{self.in_unit(value):.{significant}g}".replace("-", "−")
        return f"{number}{'' if self.unit in ('', '°') else ' '}{self.unit}"

    def check(self, value: object) -> None:
        """Raise GainroomError where `value` cannot be asked for."""
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and self.low < value < self.high):  # type: ignore[operator]
            below = f" and < {self.high:.4g}" if self.high < math.inf else ""
            raise GainroomError(f"requirements: {self.name} {value!r} must be > {self.low:g}{below}{IN_SI.get(self.unit, '')}")

    def measured(self, loop: Any) -> float:
        """What is held against the requirement, of one stable Loop, SI: for a requirement on what no field of Margins is.

        NaN where it is not known; so is what raises GainroomError. A region of gains asks for loops of one joint without `parts`.
        """
        raise NotImplementedError(f"{self.name} is no field of Margins, and {type(self).__name__} does not measure it")

    def value(self, found: MarginRecord) -> float:
        """What is held against the requirement: the worst over all loops together and one at a time; NaN where it is not known."""
        known = getattr(found, self.bounds or self.name, None)
        if known is not None:
            return known
        values = [self._measured_once(loop) for loop in found.loops] if found.stable else []
        worst = max if self.at_most else min
        return math.nan if not values or any(map(math.isnan, values)) else worst(values)

    def _measured_once(self, loop: Any) -> float:
        """`measured`, kept by the loop."""
        kept: dict[Requirement, float] = loop.measurements
        if self not in kept:
            try:
                kept[self] = float(self.measured(loop))
            except GainroomError:
                kept[self] = math.nan
        return kept[self]

    def of_loops(self, found: Any) -> Floats | None:
        """(n,) the same of one loop at a time, the others as they are; None where it is of all loops together alone, or not known."""
        return None

    def named(self, found: MarginRecord) -> str:
        """What that is: "phase margin of one loop" where it is the lesser."""
        return self.title

    def frequency(self, found: MarginRecord) -> float:
        """The frequency that belongs to it [rad/s]; NaN where there is none."""
        return getattr(found, self.at_frequency) if self.at_frequency else math.nan

    def facts(self, found: MarginRecord) -> dict[str, Any]:
        """`value`, in JSON."""
        return {self.key: self.in_unit(self.value(found))}

    def met(self, needed: float, value: float) -> bool:
        """Whether `value` keeps what is asked for, but for ROUND_OFF; False for NaN."""
        return enough(needed, value) if self.at_most else enough(value, needed)

    def shortfall(self, needed: float, value: float) -> float:
        """By how much `value` misses what is asked for, in ln of it: below 0 where it is met, inf where it is not known."""
        if math.isnan(value):
            return math.inf
        if value <= 0:
            return -math.inf if self.at_most else math.inf
        return (1 if self.at_most else -1) * (math.log(value) - math.log(needed))

    def tightened(self, needed: float, share: float) -> float:
        """A `share` more; what could not be asked for at all (Ms below 1, π of phase): halfway there."""
        if self.at_most:
            return max(needed / (1 + share), 0.5 * (self.low + needed))
        return min(needed * (1 + share), 0.5 * (needed + self.high))

    def stricter(self, needed: float) -> float:
        """A level to draw beside what is asked for."""
        return self.low + (needed - self.low) / 2 if self.at_most else min(1.5 * needed, 0.5 * (needed + self.high))

    def excluded(self, needed: float) -> ExcludedSet | None:
        """The set that L(jω) of one loop must stay out of, exactly.

        None: no such set is given. Then gains are judged by their margins, one by one (PDRegion), and nothing is proved over ranges.
        """
        return None

    def reach(self, needed: float) -> float:
        """The factor on all gains up to which samples of coupled loops have to be fine."""
        return 1.0

    def sampled(self, seen: Sampled) -> dict[str, float]:
        """Fields of Margins that samples of coupled loops tell quickly; without them all margins are worked out at every look."""
        return {}

    def slopes(self, curves: Curves, needed: float) -> Any:
        """By how much coupled loops miss it, wherever they may, and how that changes with every gain."""
        return curves.by_differences(self, needed)
