"""Recommended gains of a robot: one set per contact state, and one for all of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..analysis.margin_record import Margins
from ..system.linear.arrays import Floats


@dataclass(frozen=True)
class GainSet:
    """Gains for one contact state, or for all of them (contact "").

    kp, kd    joint space: (n,) [N m/rad], [N m s/rad]; task space: (m,) K'p [1/s²], K'v [1/s]; NaN where nothing can move that joint or
              direction in any state of the set: its gains would do nothing
    ki        (m,) where a task is P/PI [1/s²]; None otherwise
    margins   every margin in the case in which it is smallest
    compliance  (m,) weight × inertia / stiffness, whose sum is made small [s²]; NaN where nothing can move
    binding   posture, contact state and place in the uncertainty that keep the softest joint or direction from more, as text
    cases     number of cases in which the requirements were checked
    margin    (m,) what breaks if that joint or direction is raised by 5 %: the name of a requirement, "stability", or "" where nothing does
    case      (m,) and where, as text
    softest   the joint or direction that `binding` speaks of, by its place
    without_weight  True where the weight of a robot that stands was left out, as no gains were found that meet the requirements with it
    nearest   what came nearest with the weight, as text; "" where it counted
    topples   the states in which the weight makes these gains unstable
    """

    contact: str
    kp: Floats
    kd: Floats
    ki: Floats | None
    margins: Margins
    binding: str
    cases: int
    compliance: Floats
    margin: tuple[str, ...] = ()
    case: tuple[str, ...] = ()
    softest: int = 0
    without_weight: bool = False
    nearest: str = ""
    topples: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """False where nothing moves in any state of the set, so that there are no gains to report."""
        return self.cases > 0

    def times_stiffer(self, other: "GainSet") -> float:
        """Ratio of another set's sum of compliances to this one's, over what both move; NaN where that is nothing."""
        both = np.isfinite(self.compliance) & np.isfinite(other.compliance)
        return float(other.compliance[both].sum() / self.compliance[both].sum()) if both.any() else math.nan


@dataclass(frozen=True)
class RobotGains:
    """Recommended gains of one space ("joint" or "task").

    names        of the joints or of the task directions
    per_contact  one set per contact state, None where none was found that meets the requirements
    everywhere   the one set that is safe in all; None where there is none
    inertia      (n,) J_m + 1/W_ii in the first state: kp / inertia and kd / inertia are the gains in 1/s² and 1/s; None in task space
    nearest      by contact state ("" for all), where no set was found: what came nearest, as text
    unweighed    states in which the weight of a robot that stands is left out, as the contacts leave its base free to move
    """

    space: str
    names: tuple[str, ...]
    per_contact: dict[str, GainSet | None]
    everywhere: GainSet | None
    inertia: Floats | None
    nearest: dict[str, str] = field(default_factory=dict)
    unweighed: tuple[str, ...] = ()

    @property
    def sets(self) -> tuple[GainSet, ...]:
        """Every set that was found, the one that is safe in all states first."""
        return tuple(one for one in (self.everywhere, *self.per_contact.values()) if one is not None)

    def without(self, failing: Mapping[str, str]) -> "RobotGains":
        """Gains without the sets of some contact states ("": the set for all), each with the nearest result as text."""
        kept = {contact: None if contact in failing else one for contact, one in self.per_contact.items()}
        return replace(self, per_contact=kept, everywhere=None if "" in failing else self.everywhere, nearest={**self.nearest, **failing})

    @property
    def cost(self) -> dict[str, float]:
        """Ratio, per contact state, of its own set's stiffness to that of the set for all states; NaN where either is missing."""
        return {
            name: math.nan if own is None or self.everywhere is None else own.times_stiffer(self.everywhere)
            for name, own in self.per_contact.items()
        }
