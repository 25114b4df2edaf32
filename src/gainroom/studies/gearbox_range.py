"""A robot whose gearboxes lie in a range: the worst of them that were looked at.

All gearboxes move through their ranges together, stiffest to softest (gearbox_looks.py), once least and once most damped; there are looks
at gearboxes that differ, each anywhere in its own range; and each is looked at at either end with all others at the other. Ends alone
would not do: what lies between may be worse than both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..robot.gearbox_types import GearboxRange
from ..system.linear.arrays import Floats
from ..system.system import System
from .gearbox_looks import STEPS, Gearboxes, Looks, lowest_point
from .progress import Progress, quiet
from .state import State

MIXED = 12
"""Looks at gearboxes that differ, each anywhere in its range."""
MOST = 24
"""Looks from softest to stiffest."""


@dataclass(frozen=True)
class RangeOfGearboxes:
    """What was looked at.

    range   of each joint
    looks   all of them, the least and the most damped first, each from stiffest to softest
    mixed   how many of them are of gearboxes that differ, the last ones
    worst_look   of those that are not safe, if there are some, the one that vibrates first; one whose limit is not known comes before all
    """

    range: GearboxRange
    looks: tuple[Gearboxes, ...]
    mixed: int

    @property
    def worst_look(self) -> Gearboxes:
        return min(self.looks, key=_first)

    @property
    def worst_together(self) -> Gearboxes:
        """The same of those that moved together: to find gains with, as one joint apart from all others would get all that they lose."""
        return min(self.looks[: len(self.looks) - self.mixed], key=_first)

    @property
    def safe(self) -> bool:
        """Whether all have what is required."""
        return all(look.safe for look in self.looks)


def _first(look: Gearboxes) -> tuple[bool, bool, float]:
    return not math.isnan(look.gain_limit), look.safe, look.gain_limit


def look_over(system: System, states: Sequence[State], found: GearboxRange, progress: Progress = quiet) -> RangeOfGearboxes:
    """Looks over a range that leaves out no joint in it with a motor's inertia; `states` of the system."""
    varied = ~np.isnan(found.softest)
    looks = Looks(system, states, varied)
    wide = np.where(varied, np.log(found.stiffest / found.softest), 0.0)
    near, seen = np.sqrt(looks.coupled[1]), []

    def at(share: Floats | float, ratio: Floats) -> Gearboxes:
        progress(min(len(seen), 2 * MOST), 2 * MOST + MIXED, "gearboxes")
        seen.append(looks.at(found.softest * np.exp(wide * share), ratio))
        return seen[-1]

    shares = [1.0]
    while shares[-1] > 0:
        omega = found.softest * np.exp(wide * shares[-1])
        steps = [-math.log1p(-looks.step(float(omega[k]), float(near[k])) / omega[k]) / wide[k] for k in np.flatnonzero(wide > 0).tolist()]
        shares.append(max(0.0, shares[-1] - max(min(steps, default=1.0), 1 / MOST)))
    for ratio in (found.least_damped, found.most_damped):
        row = [(share, at(share, ratio).gain_limit) for share in shares]
        least = min(limit for _, limit in row)
        for end, other in ((0, 1), (-1, -2)):  # where the limit may have its least just inside an end
            if len(row) > 1 and row[end][1] == least:
                place = 0.5 * (row[end][0] + row[other][0])
                row.append((place, at(place, ratio).gain_limit))
        row.sort(reverse=True)
        for k in range(1, len(row) - 1):
            three = row[k - 1 : k + 2]
            for _ in range(STEPS.dips):
                place = _dip(three, STEPS.near * least)
                if place is None:
                    break
                four = sorted([*three, (place, at(place, ratio).gain_limit)], reverse=True)
                lowest = min(range(1, 3), key=lambda k, four=four: four[k][1])
                settled = three[1][1] - four[lowest][1] < STEPS.settled * four[lowest][1]
                three = four[lowest - 1 : lowest + 2]
                if settled:
                    break
    random = np.random.default_rng(0)
    parts = random.random((2, MIXED, len(varied)))
    parts[0, 0] = np.arange(len(varied)) % 2
    parts[0, 1] = 1 - parts[0, 0]
    together, eye = len(seen), np.eye(len(varied))[wide > 0]
    for share, other in zip(*parts, strict=True):
        at(share, found.least_damped * (found.most_damped / found.least_damped) ** other)
    for share in [*eye, *(1 - eye)] if len(eye) > 1 else []:  # one joint at an end, the others at the other, where damping is least
        at(share, found.least_damped)
    progress(1, 1, "")
    return RangeOfGearboxes(found, tuple(seen), len(seen) - together)


def _dip(three: Sequence[tuple[float, float]], enough: float) -> float | None:
    """Where among three places, each with its limit, the limit is least by a parabola; None where it is not in the middle, or `enough`."""
    limits = [limit for _, limit in three]
    if not (limits[1] <= min(limits) and max(limits) < math.inf and limits[1] < enough):
        return None
    place = lowest_point([share for share, _ in three], limits)
    if place is None or not three[2][0] < place < three[0][0] or min(abs(place - share) for share, _ in three) < 1e-6:
        return None
    return place
