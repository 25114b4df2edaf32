"""Uncertainty of a system: intervals of its quantities, and the places in them at which it is examined."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import GainroomError
from .drive import Drive
from .elastic_joint import ElasticJoint
from .linear.arrays import Floats

Case = tuple[ElasticJoint, Drive]
Interval = tuple[Any, Any]
Share = float | tuple[float, ...]
"""Position in an interval, from 0 (low) to 1 (high): a number for all joints, or one per joint."""
Place = tuple[Share, ...]
"""Place in the uncertainty: one share per uncertain quantity."""
NOMINAL: Place = ()
"""Place of the nominal values."""


OF_GEARBOXES = ("resonance", "damping_ratio")
"""Names in Uncertainty that are not quantities of a source: with the motor inertia they determine stiffness and damping."""


@dataclass(frozen=True)
class Uncertainty:
    """Intervals (low, high) that contain the true values, SI units; None: known exactly. Both ends numbers, or (n,) arrays, one per joint.

    Joints vary independently, except for the delay, which one bus gives to all.

     delay [s], stiffness [N m/rad], link_inertia and motor_inertia [kg m²], damping [N m s/rad]
     resonance       √(K/J) [rad/s] of a motor with inertia J on its gearbox, the output held; NaN where K has no such range
     damping_ratio   B/(2 √(K J)) of the gearbox; NaN where B has no such range

    Raises GainroomError where an interval is not (low, high) with 0 <= low <= high.
    """

    delay: Interval | None = None
    stiffness: Interval | None = None
    link_inertia: Interval | None = None
    motor_inertia: Interval | None = None
    damping: Interval | None = None
    resonance: Interval | None = None
    damping_ratio: Interval | None = None

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            interval = getattr(self, name)
            if interval is not None and not _is_interval(interval):
                raise GainroomError(f"uncertainty: {name} {interval!r} must be two numbers (low, high) with 0 <= low <= high")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the uncertain quantities."""
        return tuple(name for name in self.__dataclass_fields__ if getattr(self, name) is not None)

    @property
    def delay_range(self) -> tuple[float, float] | None:
        """Ends of the delay [s] where all drives share them; None where they differ or the delay is known."""
        if self.delay is None or any(np.ptp(end) > 0 for end in self.delay):
            return None
        low, high = self.delay
        return float(np.min(low)), float(np.min(high))

    def without(self, name: str) -> "Uncertainty":
        """Uncertainty with the quantity `name` known exactly."""
        return replace(self, **{name: None})

    def values(self, place: Sequence[Share]) -> dict[str, Floats]:
        """Values of the uncertain quantities at `place`, by name; geometric interpolation where low > 0."""
        return {
            name: between(low, high, share) for name, share in zip(self.names, place, strict=True) for low, high in [getattr(self, name)]
        }

    def case(self, joint: ElasticJoint, drive: Drive, place: Sequence[Share]) -> Case:
        """Joint and drive at `place`."""
        values = {name: float(value) for name, value in self.values(place).items()}
        delay = values.pop("delay", drive.delay)
        return replace(joint, **values), replace(drive, delay=delay)

    def place(self, values: Mapping[str, float]) -> Place:
        """Place of given `values`, the inverse of `case`; a quantity that `values` leaves out is at its low end."""
        shares = []
        for name in self.names:
            low, high = getattr(self, name)
            shares.append(share_of(low, high, values.get(name, low)))
        return tuple(shares)

    @property
    def corners(self) -> list[Place]:
        """Corners of the uncertainty: every combination of low and high ends; NOMINAL alone where nothing is uncertain."""
        return list(itertools.product((0.0, 1.0), repeat=len(self.names)))

    def inside(self, count: int) -> list[Place]:
        """Centre and `count` points of a Halton sequence, which fills the interior evenly; all joints at the same shares."""
        bases = (2, 3, 5, 7, 11, 13, 17)[: len(self.names)]
        return [(0.5,) * len(bases), *(tuple(radical_inverse(k, base) for base in bases) for k in range(1, count + 1))]

    def mixed(self, joints: int, count: int) -> list[Place]:
        """Places at which `joints` differ: alternating low and high, the reverse, and `count` random draws (fixed seed).

        Empty for one joint, and where only the delay is uncertain. A case that all joints at one share pass may fail with joints at
        different shares; these places are samples, no proof.
        """
        own = [name != "delay" for name in self.names]
        if joints < 2 or not any(own):
            return []
        draws = np.random.default_rng(0).random((count, len(own), joints))
        odd = np.arange(joints) % 2
        parts = [*np.broadcast_to([odd, 1 - odd], (len(own), 2, joints)).swapaxes(0, 1), *draws]
        return [
            tuple(tuple(part.tolist()) if by_joint else float(part[0]) for part, by_joint in zip(parts_, own, strict=True))
            for parts_ in parts
        ]


def radical_inverse(index: int, base: int) -> float:
    """Van der Corput radical inverse of `index` in `base`; scipy.stats has it too, but takes half a second to load."""
    found, scale = 0.0, 1.0 / base
    while index:
        index, digit = divmod(index, base)
        found += digit * scale
        scale /= base
    return found


def between(low: Floats | float, high: Floats | float, share: Share) -> Floats:
    """Value at `share` of the interval 0 <= low <= high, geometric where low > 0; inf (a rigid joint) and NaN stay."""
    low, high, share_of_each = np.broadcast_arrays(*(np.asarray(one, dtype=float) for one in (low, high, share)))
    value = low.copy()
    scaled, shifted = (low > 0) & np.isfinite(low), low == 0
    value[scaled] *= (high[scaled] / low[scaled]) ** share_of_each[scaled]
    value[shifted] = high[shifted] * share_of_each[shifted]
    return value


def is_end(share: Share) -> bool:
    """True if `share` is an end of the range for all joints at once."""
    return share in (0.0, 1.0)


def share_of(low: float, high: float, value: float) -> float:
    """Share of the interval [low, high] at which `value` lies, clipped to [0, 1]: the inverse of `between`."""
    if low == high:
        return 0.0
    share = math.log(value / low) / math.log(high / low) if low > 0 else value / high
    return min(max(share, 0.0), 1.0)


def _is_interval(value: object) -> bool:
    """True if `value` is (low, high), finite real numbers or arrays of them, with 0 <= low <= high."""
    if not isinstance(value, tuple | list) or len(value) != 2 or any(isinstance(end, bool | str) for end in value):
        return False
    try:
        low, high = (np.asarray(end, dtype=float) for end in value)
    except (TypeError, ValueError):
        return False
    ordered = (low >= 0) & (low <= high) & (high < math.inf)
    rigid = np.isinf(low) & np.isinf(high) & (low.ndim > 0)  # among joints some of which have a spring
    without = np.isnan(low) & np.isnan(high) & (low.ndim > 0)  # among joints some of which have a range
    return low.shape == high.shape and bool(np.all(ordered | rigid | without))
