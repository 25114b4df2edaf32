"""Recommended gains of a robot: one set per contact state, and one for all of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..analysis.margin_record import Margins
from ..system.linear.arrays import Booleans, Floats


@dataclass(frozen=True)
class StateStiffness:
    """Dynamic stiffness of the links in one posture and contact state, at the worst of the uncertainty.

    title, contact   of the state
    stiffness        (m,) of each joint [N m/rad], or along each direction of a task [N/m, N m/rad]; NaN where no load moves it or no gain
                     holds it
    omega            (m,) its frequency [rad/s]
    gear_limited     (m,) True where no gain changes it, but the gearbox alone
    damping          least damping ratio of each kind of vibration, "sway", "loop" and "gearbox", and its frequency [rad/s]
    """

    title: str
    contact: str
    stiffness: Floats
    omega: Floats
    gear_limited: Booleans
    damping: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class GainSet:
    """Gains for one contact state, or for all of them (contact "").

    kp, kd    joint space: (n,) [N m/rad], [N m s/rad]; task space: (m,) K'p [1/s²], K'v [1/s]; NaN where nothing can move that joint or
              direction in any state of the set: its gains would do nothing
    ki        (m,) where a task is P/PI [1/s²]; None otherwise
    margins   every margin in the case in which it is smallest
    links     dynamic stiffness of the links in each state of the set
    binding   posture, contact state and place in the uncertainty that keep the softest joint or direction from more, as text; "" where a
              bound does, in all of them
    cases     number of cases in which the requirements were checked
    margin    (m,) what limits that joint or direction: the requirement that breaks if it is raised by 5 %, "stability", "link" where its
              link would then be softer, the bound that its gains are on ("kp_max"), or "" where nothing does
    case      (m,) and where, as text
    of_sway   (m,) True where sway alone breaks that requirement
    softest   index of the joint or direction that `binding` is about
    without_weight  True where the weight of a robot that stands was left out, as no gains were found that meet the requirements with it
    nearest   shortfall of the best gains found with the weight, as text; "" where the weight counted
    topples   the states in which the weight makes these gains unstable
    """

    contact: str
    kp: Floats
    kd: Floats
    ki: Floats | None
    margins: Margins
    binding: str
    cases: int
    links: tuple[StateStiffness, ...] = ()
    margin: tuple[str, ...] = ()
    case: tuple[str, ...] = ()
    of_sway: tuple[bool, ...] = ()
    softest: int = 0
    without_weight: bool = False
    nearest: str = ""
    topples: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """False where nothing moves in any state of the set, so that there are no gains to report."""
        return self.cases > 0

    @property
    def stiffness(self) -> Floats:
        """Dynamic stiffness (m,) of each joint or direction in the state where it is least; NaN where it has none."""
        return _least(self.links, len(self.kp))

    @property
    def softest_in(self) -> tuple[int, ...]:
        """Index (m,) in `links` of the state in which each joint or direction is softest; −1 where it has no stiffness."""
        every = np.array([one.stiffness for one in self.links]).reshape(len(self.links), len(self.kp))
        return tuple(int(np.nanargmin(column)) if np.isfinite(column).any() else -1 for column in every.T)

    def times_stiffer(self, other: "GainSet") -> float:
        """Ratio of dynamic stiffness to that with another set in the same states; NaN where no link has one in both.

        It is a geometric mean over contact states and joints, of the least over postures.
        """
        ratios = []
        for contact in dict.fromkeys(one.contact for one in self.links):
            own, beside = (_least([one for one in each.links if one.contact == contact], len(self.kp)) for each in (self, other))
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios.append(np.log(own / beside))
        both = np.concatenate(ratios) if ratios else np.zeros(0)
        both = both[np.isfinite(both)]
        return math.exp(float(both.mean())) if len(both) else math.nan


def _least(links: Sequence[StateStiffness], size: int) -> Floats:
    """Least dynamic stiffness (m,) over states; NaN where there is none."""
    every = np.array([one.stiffness for one in links]).reshape(len(links), size)
    found = np.where(np.isnan(every), math.inf, every).min(axis=0, initial=math.inf)
    return np.where(np.isinf(found), math.nan, found)


@dataclass(frozen=True)
class RobotGains:
    """Recommended gains of one space ("joint" or "task").

    names        of the joints or of the task directions
    per_contact  one set per contact state, None where none was found that meets the requirements
    everywhere   the one set that is safe in all; None where there is none
    inertia      (n,) J_m + 1/W_ii in the first state: kp / inertia and kd / inertia are the gains in 1/s² and 1/s; None in task space
    nearest      by contact state ("" for all), where no set was found: shortfall of the best gains found, as text
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
        """Ratio, per contact state, of dynamic stiffness with its own set to that with the common set; NaN where either is missing."""
        return {
            name: math.nan if own is None or self.everywhere is None else own.times_stiffer(self.everywhere)
            for name, own in self.per_contact.items()
        }
