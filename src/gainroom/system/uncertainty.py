"""What is not known exactly about a joint: intervals, and the places in them that are looked at."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Floats
from .drive import Drive
from .plant import ElasticJoint

Case = tuple[ElasticJoint, Drive]
Place = tuple[float, ...]
"""Where in the uncertainty: one number in [0, 1] per uncertain quantity."""
NOMINAL: Place = ()
"""The place of the stated values."""


@dataclass(frozen=True)
class Uncertainty:
    """Intervals (low, high) that contain the true values, SI units; None: known exactly.

    delay [s], stiffness [N m/rad], link_inertia and motor_inertia [kg m²], damping [N m s/rad]
    """

    delay: tuple[float, float] | None = None
    stiffness: tuple[float, float] | None = None
    link_inertia: tuple[float, float] | None = None
    motor_inertia: tuple[float, float] | None = None
    damping: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            interval = getattr(self, name)
            if interval is not None and not _is_interval(interval):
                raise GainroomError(f"uncertainty: {name} {interval!r} must be two numbers (low, high) with 0 <= low <= high")

    @property
    def names(self) -> tuple[str, ...]:
        """What is uncertain."""
        return tuple(name for name in self.__dataclass_fields__ if getattr(self, name) is not None)

    def case(self, joint: ElasticJoint, drive: Drive, place: Sequence[float]) -> Case:
        """The joint and drive at `place`, one number in [0, 1] per uncertain quantity; geometric between ends that are > 0."""
        values = {}
        for name, share in zip(self.names, place, strict=True):
            low, high = getattr(self, name)
            values[name] = float(between(low, high, share))
        delay = values.pop("delay", drive.delay)
        return replace(joint, **values), replace(drive, delay=delay)

    def place(self, values: Mapping[str, float]) -> Place:
        """The place at which `values` of what is uncertain lie, the inverse of `case`; the low end of a range that `values` leaves out."""
        shares = []
        for name in self.names:
            low, high = getattr(self, name)
            shares.append(share_of(low, high, values.get(name, low)))
        return tuple(shares)

    def ends(self) -> Iterator["Uncertainty"]:
        """Each end of each interval by itself, all else as stated: what is uncertain shrunk to that one value."""
        for name in self.names:
            for end in getattr(self, name):
                yield Uncertainty(**{name: (end, end)})

    @property
    def corners(self) -> list[Place]:
        """Every combination of lowest and highest values; NOMINAL where nothing is uncertain."""
        return list(itertools.product((0.0, 1.0), repeat=len(self.names)))

    def inside(self, count: int) -> list[Place]:
        """The centre, and `count` places that fill the rest evenly."""
        size = len(self.names)
        return [(0.5,) * size, *map(tuple, _halton(size, count).tolist())]


def between(low: Floats | float, high: Floats | float, share: float) -> Floats:
    """A point between 0 <= low <= high, geometric where low > 0; a rigid joint's inf stays."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    value = low.copy()
    scaled, shifted = (low > 0) & np.isfinite(low), low == 0
    value[scaled] *= (high[scaled] / low[scaled]) ** share
    value[shifted] = high[shifted] * share
    return value


def share_of(low: float, high: float, value: float) -> float:
    """Where `value` lies between `low` and `high`: the inverse of `between`."""
    if low == high:
        return 0.0
    share = math.log(value / low) / math.log(high / low) if low > 0 else value / high
    return min(max(share, 0.0), 1.0)


def _is_interval(value: object) -> bool:
    """Whether `value` is (low, high), two finite real numbers with 0 <= low <= high."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        return False
    if not all(isinstance(end, int | float | np.integer | np.floating) and not isinstance(end, bool) for end in value):
        return False
    return 0 <= value[0] <= value[1] < math.inf


def _halton(count: int, points: int) -> Floats:
    """(points, count) Halton sequence in [0, 1]: fills a box evenly (Halton 1960)."""
    result = np.zeros((points, count))
    for axis, base in enumerate((2, 3, 5, 7, 11)[:count]):
        for k in range(points):
            share, rest = 1.0, k + 1
            while rest:
                share /= base
                result[k, axis] += share * (rest % base)
                rest //= base
    return result
