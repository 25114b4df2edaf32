"""Bounds within which recommended gains are searched, as a robot's user knows them: of kp and kd of one joint, or of each."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..errors import GainroomError
from .linear.arrays import Booleans, Floats

BOUNDS = ("kp_min", "kp_max", "kd_min", "kd_max")
"""Names of the bounds, in files too."""
ON = 1e-3
"""Relative distance below which gains are on a bound."""


@dataclass(frozen=True)
class GainBounds:
    """Bounds of recommended gains, kp_min ≤ kp ≤ kp_max [N m/rad] and kd_min ≤ kd ≤ kd_max [N m s/rad].

    Each is a number, or (n,) for n joints; 0 and infinity bound nothing. Raises GainroomError unless 0 ≤ min ≤ max, min < ∞ and max > 0.
    """

    kp_min: float | Floats = 0.0
    kp_max: float | Floats = math.inf
    kd_min: float | Floats = 0.0
    kd_max: float | Floats = math.inf

    def __post_init__(self) -> None:
        for name in BOUNDS:
            try:
                given = np.asarray(getattr(self, name), dtype=float)
            except (TypeError, ValueError) as error:
                raise GainroomError(f"GainBounds: {name} {getattr(self, name)!r} must be a number, or one per joint") from error
            right = np.isfinite(given) & (given >= 0) if name.endswith("_min") else given > 0
            if not np.all(right):
                must = "be finite and >= 0" if name.endswith("_min") else "be > 0"
                raise GainroomError(f"GainBounds: {name} {given[~right].flat[0]:g} must {must}")
            object.__setattr__(self, name, given if given.ndim else float(given))
        for gain in ("kp", "kd"):
            low, high = np.broadcast_arrays(*(np.atleast_1d(getattr(self, f"{gain}_{end}")) for end in ("min", "max")))
            wrong = low > high
            if np.any(wrong):
                raise GainroomError(f"GainBounds: {gain}_min {low[wrong][0]:g} must be <= {gain}_max {high[wrong][0]:g}")

    @property
    def names(self) -> tuple[str, ...]:
        """Bounds that bound the gains of some joint."""
        return tuple(one.name for one in fields(self) if np.any(getattr(self, one.name) != one.default))

    def without(self, names: Iterable[str]) -> "GainBounds":
        """Bounds without some of them."""
        return replace(self, **{one.name: one.default for one in fields(self) if one.name in names})

    def box(self, size: int) -> tuple[Floats, Floats]:
        """Least and largest kp and kd, each (2, size)."""
        low, high = ([np.broadcast_to(getattr(self, f"{gain}_{end}"), size) for gain in ("kp", "kd")] for end in ("min", "max"))
        return np.array(low, dtype=float), np.array(high, dtype=float)

    def within(self, gains: Floats) -> Floats:
        """Gains (3, m), kp, kd and ki, with kp and kd brought within the bounds; those that are 0 or NaN stay."""
        found, (low, high) = gains.copy(), self.box(gains.shape[1])
        found[:2] = np.where(gains[:2] > 0, np.clip(gains[:2], low, high), gains[:2])
        return found

    def shared(self, groups: Sequence[Sequence[int]], size: int) -> "GainBounds":
        """Bounds (size,) of joints with equal gains in `groups`: those of each hold for all. Raises GainroomError where none are left."""
        low, high = self.box(size)
        for group in groups:
            low[:, group], high[:, group] = low[:, group].max(axis=1, keepdims=True), high[:, group].min(axis=1, keepdims=True)
        return GainBounds(low[0], high[0], low[1], high[1])

    def freed(self, name: str, group: Sequence[int]) -> "GainBounds":
        """Bounds per joint without the one `name` on the joints of a group."""
        bound = np.array(getattr(self, name))
        bound[group] = 0.0 if name.endswith("_min") else math.inf
        return replace(self, **{name: bound})

    def on(self, name: str, gains: Floats) -> Booleans:
        """Mask (m,) of gains (3, m) that are on the bound `name`."""
        gain = gains[0 if name.startswith("kp") else 1]
        bound = np.broadcast_to(getattr(self, name), gain.shape)
        with np.errstate(invalid="ignore"):
            return (bound > 0) & np.isfinite(bound) & (np.abs(gain - bound) <= ON * bound)
