"""What is not known exactly about a system: intervals, and the places in them that are looked at."""

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
"""How far up a range, from 0 to 1: a number for all joints, or one for each."""
Place = tuple[Share, ...]
"""Where in the uncertainty: one share per uncertain quantity."""
NOMINAL: Place = ()
"""The place of the nominal values."""


OF_GEARBOXES = ("resonance", "damping_ratio")
"""Names of Uncertainty that are no quantities of a source: they make stiffness and damping, with the motor's inertia."""


@dataclass(frozen=True)
class Uncertainty:
    """Intervals (low, high) that contain the true values, SI units; None: known exactly. Both ends numbers, or (n,) arrays, one per joint.

    Joints vary each by itself, but for the delay, which all have from one bus.

    delay [s], stiffness [N m/rad], link_inertia and motor_inertia [kg m²], damping [N m s/rad]
    resonance       √(K/J) [rad/s]: of a motor of inertia J on its gearbox, the output held; NaN where K has no such range
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
        """What is uncertain."""
        return tuple(name for name in self.__dataclass_fields__ if getattr(self, name) is not None)

    @property
    def delay_range(self) -> tuple[float, float] | None:
        """The ends of the delay [s] where they are the same for all drives; None where they are not, or it is known."""
        if self.delay is None or any(np.ptp(end) > 0 for end in self.delay):
            return None
        low, high = self.delay
        return float(np.min(low)), float(np.min(high))

    def without(self, name: str) -> "Uncertainty":
        """The same with one quantity known exactly."""
        return replace(self, **{name: None})

    def values(self, place: Sequence[Share]) -> dict[str, Floats]:
        """What is uncertain at `place`, one share per quantity; geometric where low > 0."""
        return {
            name: between(low, high, share) for name, share in zip(self.names, place, strict=True) for low, high in [getattr(self, name)]
        }

    def case(self, joint: ElasticJoint, drive: Drive, place: Sequence[Share]) -> Case:
        """The joint and drive at `place`."""
        values = {name: float(value) for name, value in self.values(place).items()}
        delay = values.pop("delay", drive.delay)
        return replace(joint, **values), replace(drive, delay=delay)

    def place(self, values: Mapping[str, float]) -> Place:
        """The place at which `values` of what is uncertain lie, the inverse of `case`; the low end of a range that `values` leaves out."""
        shares = []
        for name in self.names:
            low, high = getattr(self, name)
            shares.append(share_of(low, high, values.get(name, low)))
        return tuple(shares)

    @property
    def corners(self) -> list[Place]:
        """Every combination of lowest and highest values; NOMINAL where nothing is uncertain."""
        return list(itertools.product((0.0, 1.0), repeat=len(self.names)))

    def inside(self, count: int) -> list[Place]:
        """The centre, and `count` places of a Halton sequence, which fill the rest evenly; all joints together."""
        bases = (2, 3, 5, 7, 11, 13, 17)[: len(self.names)]
        return [(0.5,) * len(bases), *(tuple(radical_inverse(k, base) for base in bases) for k in range(1, count + 1))]

    def mixed(self, joints: int, count: int) -> list[Place]:
        """Places at which `joints` differ: every other one low, the rest high, the reverse, and `count` draws, the same ones at every call.

        None where nothing is uncertain that joints have by themselves. What is in between for all joints together may be safe at both ends
        of every range, and so may each mix of two: these are samples.
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
    """The digits of `index` in `base` behind the point, mirrored; scipy.stats has it too, and takes half a second to load."""
    found, scale = 0.0, 1.0 / base
    while index:
        index, digit = divmod(index, base)
        found += digit * scale
        scale /= base
    return found


def between(low: Floats | float, high: Floats | float, share: Share) -> Floats:
    """A point between 0 <= low <= high, geometric where low > 0; a rigid joint's inf stays, and NaN."""
    low, high, share_of_each = np.broadcast_arrays(*(np.asarray(one, dtype=float) for one in (low, high, share)))
    value = low.copy()
    scaled, shifted = (low > 0) & np.isfinite(low), low == 0
    value[scaled] *= (high[scaled] / low[scaled]) ** share_of_each[scaled]
    value[shifted] = high[shifted] * share_of_each[shifted]
    return value


def is_end(share: Share) -> bool:
    """Whether it is an end of its range for all joints at once."""
    return share in (0.0, 1.0)


def share_of(low: float, high: float, value: float) -> float:
    """Where `value` lies between `low` and `high`: the inverse of `between`."""
    if low == high:
        return 0.0
    share = math.log(value / low) / math.log(high / low) if low > 0 else value / high
    return min(max(share, 0.0), 1.0)


def _is_interval(value: object) -> bool:
    """Whether `value` is (low, high), both finite real numbers, or arrays of them, with 0 <= low <= high."""
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
