"""Requirement: one object with its key in files, unit, comparison, and excluded set of L(jω)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import GainroomError
from .excluded_sets import ROUND_OFF, ExcludedSet
from .linear.arrays import Floats
from .loop_protocols import LoopCurves, MarginRecord, SampledLoops
from .margin_units import IN_SI

Shown = Literal["always", "known", "asked"]


def enough(value: float, needed: float) -> bool:
    """True if `value` >= `needed` within ROUND_OFF; False for NaN."""
    return bool(value >= needed * (1 - ROUND_OFF))


@dataclass(frozen=True)
class Requirement:
    """Bound on one margin. Values are in SI: a factor, rad, s.

    name     name in Python, and displayed field of Margins
    title    displayed title: "phase margin"
    key      key in files and JSON, with the displayed unit
    unit     displayed unit; `scale` is the factor to it from SI
    symbol   short heading; "": the title
    bounds   field of Margins that is compared with the requirement; "": `name`. Without such a field: `measured`
    at_frequency   field with the frequency [rad/s] of the margin; "": none
    at_most  True: upper bound on the margin; False: lower bound
    low, high   open interval of admissible bounds
    most     largest bound that a file may ask for, in `unit`
    usual    default bound; None: not required by default
    meaning  explanation for several coupled loops, one sentence
    shown    "always": reported of every loop; "known": where it is asked for or known; "asked": where it is asked for
    of_one   True: reported of a single joint, and of several only where it is asked for
    of_several   title for several loops, where the margin is by definition of all loops together, or of each; "": the title says it
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
    of_one: bool = False
    shown: Shown = "always"

    def titled(self, found: MarginRecord, several: bool, short: bool = False) -> str:
        """Title of the margin in `found`, with the loops it belongs to where there are several; `short`: as table heading."""
        if (named := self.named(found)) != self.title:
            return named
        return self.of_several if several and self.of_several else self.heading if short else self.label

    @property
    def heading(self) -> str:
        """Table heading: the symbol, or the title where there is none."""
        return self.symbol or self.title

    @property
    def label(self) -> str:
        """The title with its symbol: "peak sensitivity Ms"."""
        return f"{self.title} {self.symbol}".rstrip()

    @property
    def sign(self) -> str:
        """Comparison sign, ≥ or ≤."""
        return "≤" if self.at_most else "≥"

    def in_unit(self, value: float) -> float:
        """`value` [SI] in the displayed unit."""
        return self.scale * value

    def in_si(self, value: float) -> float:
        """`value` [displayed unit] in SI."""
        return value / self.scale

    def text(self, value: float, significant: int = 3) -> str:
        """Value with its unit as text: "6 dB", "30°", "2"."""
        if not math.isfinite(value):
            return "not known" if math.isnan(value) else "∞"
        number = f"{self.in_unit(value):.{significant}g}".replace("-", "−")
        return f"{number}{'' if self.unit in ('', '°') else ' '}{self.unit}"

    def check(self, value: object) -> None:
        """Raise GainroomError if `value` is not an admissible bound."""
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and self.low < value < self.high):  # type: ignore[operator]
            below = f" and < {self.high:.4g}" if self.high < math.inf else ""
            raise GainroomError(f"requirements: {self.name} {value!r} must be > {self.low:g}{below}{IN_SI.get(self.unit, '')}")

    def measured(self, loop: Any) -> float:
        """Quantity compared with the requirement, of one stable Loop, SI; for requirements on a quantity that is no field of Margins.

        NaN where it is not known; a GainroomError counts as NaN. A region of gains calls it with loops of one joint without `parts`.
        """
        raise NotImplementedError(f"{self.name} is no field of Margins, and {type(self).__name__} does not measure it")

    @property
    def is_measured(self) -> bool:
        """True if the quantity is no field of Margins."""
        return type(self).measured is not Requirement.measured

    def in_plane(self, loop: Any, first: Any, second: Any) -> Callable[[Floats, Floats], Floats] | None:
        """Function (kps (m,), kds (m,)) → `measured` (m,) of one joint at many stable gains, with D = kp D_a + kd D_b; None: one by one.

        loop             of the joint, whatever its gains; first, second: D_a and D_b as transfer functions
        """
        return None

    def measured_about(self, loop: Any, near: Any) -> float:
        """`measured` of the Loop `near`, which differs from `loop` by small changes of its gains, exact to first order in these."""
        return self.measured(near)

    def value(self, found: MarginRecord) -> float:
        """Quantity compared with the requirement: the worst over all loops together and one at a time; NaN where it is not known."""
        known = getattr(found, self.bounds or self.name, None)
        if known is not None:
            return known
        values = [self.measured_once(loop) for loop in found.loops] if found.stable else []
        worst = max if self.at_most else min
        return math.nan if not values or any(map(math.isnan, values)) else worst(values)

    def measured_once(self, loop: Any) -> float:
        """`measured`, cached on the loop; NaN where it raises GainroomError."""
        measured: dict[Requirement, float] = loop.measurements
        if self not in measured:
            try:
                measured[self] = float(self.measured(loop))
            except GainroomError:
                measured[self] = math.nan
        return measured[self]

    def of_loops(self, found: Any) -> Floats | None:
        """Values (n,) one loop at a time, other loops closed; None where the margin is of all loops together alone, or not known."""
        return None

    @property
    def bounds_each_loop(self) -> bool:
        """True if every single loop has to meet the bound by itself: one that is known to miss it says nothing about the others."""
        return False

    def named(self, found: MarginRecord) -> str:
        """Title that tells which loops the margin belongs to: "phase margin of one loop" where that is the lesser."""
        return self.title

    def frequency(self, found: MarginRecord) -> float:
        """Frequency of the margin [rad/s]; NaN where there is none."""
        return getattr(found, self.at_frequency) if self.at_frequency else math.nan

    def facts(self, found: MarginRecord) -> dict[str, Any]:
        """JSON entries of `value`."""
        return {self.key: self.in_unit(self.value(found))}

    def met(self, needed: float, value: float) -> bool:
        """True if `value` meets the bound `needed` within ROUND_OFF; False for NaN."""
        return enough(needed, value) if self.at_most else enough(value, needed)

    def shortfall(self, needed: float, value: float) -> float:
        """Shortfall of `value` against `needed` as a log ratio: negative where the bound is met, inf where the value is not known."""
        if math.isnan(value):
            return math.inf
        if value <= 0:
            return -math.inf if self.at_most else math.inf
        return (1 if self.at_most else -1) * (math.log(value) - math.log(needed))

    def tightened(self, needed: float, share: float) -> float:
        """Bound stricter by `share`, but at most halfway to the end of the admissible interval (Ms 1, phase π)."""
        if self.at_most:
            return max(needed / (1 + share), 0.5 * (self.low + needed))
        return min(needed * (1 + share), 0.5 * (needed + self.high))

    def excluded(self, needed: float) -> ExcludedSet | None:
        """Set that L(jω) of one loop must avoid to meet `needed`, exactly.

        None: no such set exists. Gains are then judged by their margins, one by one (PDRegion), and nothing is proved over ranges.
        """
        return None

    def weight(self, needed: float, actuated: Any, unsampled: Any) -> Callable[[Floats], Floats]:
        """Function ω (k,) [rad/s] → x (k,), with x |T| ≤ 1 of one joint, T = L/(1 + L), exactly where `needed` is met.

        actuated   Factored or Sensed of the joint; unsampled: the same in continuous time, None where it is not known

        Where it is defined, the gains of one joint that meet it are known in closed form, as those of an excluded set are.
        """
        raise NotImplementedError(f"{self.name} is no ceiling of the complementary sensitivity")

    def in_closed_form(self, needed: float) -> bool:
        """True if gains of one joint that meet `needed` are known in closed form, by an excluded set or a weight."""
        return self.excluded(needed) is not None or type(self).weight is not Requirement.weight

    def reach(self, needed: float) -> float:
        """Factor on all gains up to which coupled loops have to be sampled finely."""
        return 1.0

    def sampled(self, samples: SampledLoops) -> dict[str, float]:
        """Fields of Margins that follow quickly from sampled coupled loops; where it is empty all margins are computed at every sample."""
        return {}

    def slopes(self, curves: LoopCurves, needed: float) -> Any:
        """Shortfall of coupled loops at every place where it may occur, and its derivative by every gain."""
        return curves.at_measured(self, needed) if self.is_measured else curves.by_differences(self, needed)
