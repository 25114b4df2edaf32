"""Postures of a sweep: on a grid, spread evenly between limits, or of a trajectory; each by its index."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from ...errors import GainroomError, first_of_many, nearest
from ...robot.body import RigidBody
from ...system.linear.arrays import Floats

MOST_POSTURES = 1 << 30
"""Most postures: the length of the Sobol sequence used."""
TURN = math.pi
"""Swept range [rad] of a joint without limits, to either side."""


class Postures(Protocol):
    """Set of `count` postures of n joints.

    kind   "grid", "samples" or "trajectory"
    low, high   (n,) the box they lie in [rad; m if prismatic]
    """

    kind: ClassVar[str]

    @property
    def count(self) -> int: ...
    @property
    def low(self) -> Floats: ...
    @property
    def high(self) -> Floats: ...

    def at(self, first: int, stop: int) -> Floats:
        """Joint positions (stop − first, n) [rad; m if prismatic] of postures `first` to `stop`."""
        ...


@dataclass(frozen=True, eq=False)
class Grid:
    """Every combination of `points` values from `low` to `high`, each (n,); joints with one point stand still.

    The order reverses at every end, so that consecutive postures are neighbours on the grid.
    """

    low: Floats
    high: Floats
    points: tuple[int, ...]
    kind: ClassVar[str] = "grid"

    @property
    def count(self) -> int:
        return math.prod(self.points)

    def at(self, first: int, stop: int) -> Floats:
        number = np.arange(first, stop, dtype=np.int64)
        found = np.empty((len(number), len(self.points)))
        for axis in reversed(range(len(self.points))):
            points = self.points[axis]
            number, place = np.divmod(number, points)
            place = np.where(number % 2, points - 1 - place, place)
            values = np.linspace(self.low[axis], self.high[axis], points) if points > 1 else self.low[axis : axis + 1]
            found[:, axis] = values[place]
        return found


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples: `count` postures that fill the box from `low` to `high` (n,) evenly, a Sobol sequence scrambled with `seed`.

    Joints with low = high stand still.
    """

    low: Floats
    high: Floats
    count: int
    seed: int = 0
    kind: ClassVar[str] = "samples"

    def at(self, first: int, stop: int) -> Floats:
        moving = np.flatnonzero(self.high > self.low)
        found = np.tile(self.low, (stop - first, 1))
        found[:, moving] += sobol(len(moving), first, stop, self.seed) * (self.high - self.low)[moving]
        return found


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Postures of a trajectory, in order: `angles` (k, n)."""

    angles: Floats
    kind: ClassVar[str] = "trajectory"

    @property
    def count(self) -> int:
        return len(self.angles)

    @property
    def low(self) -> Floats:
        return self.angles.min(axis=0)

    @property
    def high(self) -> Floats:
        return self.angles.max(axis=0)

    def at(self, first: int, stop: int) -> Floats:
        return self.angles[first:stop].copy()


def sobol(size: int, first: int, stop: int, seed: int) -> Floats:
    """Points (stop − first, size) `first` to `stop` of the scrambled Sobol sequence in [0, 1)."""
    from scipy.stats import qmc  # takes half a second

    if size == 0:
        return np.zeros((stop - first, 0))
    options: dict[str, Any] = {"seed": np.random.default_rng(seed)}  # scipy is about to call it rng
    sequence = qmc.Sobol(size, scramble=True, **options)
    if first:
        sequence.fast_forward(first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a part of the sequence has no balance of its own, and needs none
        return sequence.random(stop - first)


def sampled(body: RigidBody, base: Floats, count: int, ranges: "Mapping[str, tuple[float, float]] | None" = None, seed: int = 0) -> Samples:
    """Samples within all joints' limits, TURN to either side if there are none; `ranges` by joint replace the limits.

    A joint with equal limits stands as in `base` (n,). Raises GainroomError for unknown joints, empty ranges, and prismatic joints without
    limits.
    """
    require_postures(count, "--samples")
    low, high = body.lower.copy(), body.upper.copy()
    for name, (one, other) in (ranges or {}).items():
        at = _joint(body, name, "range")
        low[at], high[at] = ranged(name, one, other)
    free = ~np.isfinite(low) | ~np.isfinite(high)
    sliding = np.flatnonzero(free & body.prismatic)
    if len(sliding):
        raise GainroomError(f"sweep: joint {body.joint_names[sliding[0]]!r} slides without limits: give its range")
    low[free], high[free] = -TURN, TURN
    still = ~(low < high)
    low[still] = high[still] = base[still]
    return Samples(low, high, count, seed)


def gridded(body: RigidBody, base: Floats, axes: Mapping[str, tuple[float, float, int]]) -> Grid:
    """Grid over `axes`, (low, high, points) by joint name [rad; m if prismatic]; all other joints stay at `base` (n,).

    Raises GainroomError without axes, for unknown joints, for ranges that are not finite or without low < high, for fewer than 2 points,
    and for too many postures.
    """
    low, high, points = base.copy(), base.copy(), [1] * body.size
    if not axes:
        raise GainroomError("grid: name at least one joint: JOINT=LOW:HIGH:POINTS")
    for name, (one, other, count) in axes.items():
        at = _joint(body, name, "grid")
        if count < 2:
            raise GainroomError(f"grid: joint {name!r}: {count} points must be 2 or more")
        low[at], high[at] = ranged(name, one, other)
        points[at] = count
    require_postures(math.prod(points), "--grid")
    return Grid(low, high, tuple(points))


def followed(body: RigidBody, base: Floats, columns: Mapping[str, Floats], owner: str) -> Trajectory:
    """Trajectory of `columns`, positions (k,) by joint; other joints at `base`. Raises GainroomError for unknown joints."""
    unknown = [name for name in columns if name not in body.joint_names]
    if unknown:
        raise GainroomError(f"{owner}: joint {unknown[0]!r} is not one of this robot's{nearest(unknown[0], body.joint_names, 'joint')}")
    if not columns:
        raise GainroomError(f"{owner}: no positions of joints; expected {first_of_many(body.joint_names)}")
    angles = np.tile(base, (len(next(iter(columns.values()))), 1))
    for name, values in columns.items():
        angles[:, body.joint_names.index(name)] = values
    require_postures(len(angles), owner)
    return Trajectory(angles)


def ranged(name: str, low: float, high: float) -> tuple[float, float]:
    """Range (low, high) of joint `name`. Raises GainroomError if it is empty or not finite."""
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise GainroomError(f"range of joint {name!r}: low {low:g} must be below high {high:g}")
    return low, high


def require_postures(count: int, owner: str) -> None:
    """Raise GainroomError if `count` is 0 or too large; `owner`: the option or file that gives it."""
    if not 1 <= count <= MOST_POSTURES:
        raise GainroomError(f"{owner}: {count} postures; from 1 to {MOST_POSTURES} are possible")


def _joint(body: RigidBody, name: str, what: str) -> int:
    if name not in body.joint_names:
        raise GainroomError(f"{what}: joint {name!r} is not one of this robot's{nearest(name, body.joint_names, 'joint')}")
    return body.joint_names.index(name)
