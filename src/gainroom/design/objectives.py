"""What a search for gains makes small, and how it changes with the gains.

dynamic_stiffness   the links' dynamic stiffness as a product: the mean, over contact states and directions, of ln of the highest peak of
                    compliance over postures and uncertainty; mirrored joints have one gain and two terms. No units and no trade of one
                    joint for another: a sum of compliances sacrifices whichever joint weighs least, the largest alone is not unique.
                    A joint's own gains have to damp: its torque, late by τ, damps slow motion by kd − kp τ. Left to the product alone
                    a joint with kd/kp < τ is kept still by its neighbours' kd (a waist by the hips'), and vibrates where these do not
                    act; so its link counts as softer by kp τ/kd.
largest_kp          ln Σ u/k: inertia over stiffness of each direction, the deflection under one common acceleration

Both are functions of ln of the gains, in a search near some gains: value + pull·x + ½ bend x² + Σ share max (height + slope·x), the last
over the peaks of each term.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..system.linear.arrays import Booleans, Floats, Integers
from ..system.system import Objective
from .compliance_slopes import SHARE, SoftPeaks
from .margin_slopes import GainCase, Gains, stiffness
from .parallel import at_once

STIFFER, QUIETER = 0.003, 0.001
"""Share of a fall of ln k_dyn for which a rise of ln kp, or a fall of ln kd, is taken where k_dyn is flat: within 1 % the higher static
stiffness, then the lower noise."""
REMEMBERED = 4  # gains whose cost is stored: a search goes back by a few steps
SOFTER = 2e-3  # rise of ln of a peak in cases not searched over, above which they join


@dataclass(frozen=True)
class Cost:
    """Cost near some gains, as a function of x (2g,): ln of the stiffness of each of g groups, then of its damping.

    value        with these gains
    pull, bend   (2g,) of the smooth part
    share        (T,) weight of each term
    term         (p,) of which term each tangent is one; height (p,) ln of its peak less ln of that term's highest; slope (p, 2g)
    """

    value: float
    pull: Floats
    bend: Floats
    share: Floats
    term: Integers
    height: Floats
    slope: Floats

    def joined(self, other: "Cost", highest: Floats, step: Floats) -> "Cost":
        """Cost with the tangents of `other` at gains changed by `step` (2g,), no higher here than the highest peak.

        highest   (T,) ln of each term's highest peak there less that here
        """
        here = np.minimum(other.height + highest[other.term] - other.slope @ step, 0.0)
        return replace(
            self,
            term=np.concatenate([self.term, other.term]),
            height=np.concatenate([self.height, here]),
            slope=np.vstack([self.slope, other.slope]),
        )

    def and_above_zero(self, height: Floats, slope: Floats, share: Floats) -> "Cost":
        """Cost with terms share max(0, height) added, whose heights (t,) have the slopes (t, 2g)."""
        own, least = np.arange(len(height)), np.maximum(height, 0.0)
        return replace(
            self,
            value=self.value + float(share @ least),
            share=np.concatenate([self.share, share]),
            term=np.concatenate([self.term, len(self.share) + own, len(self.share) + own]),
            height=np.concatenate([self.height, height - least, -least]),
            slope=np.vstack([self.slope, slope, np.zeros_like(slope)]),
        )

    def within(self, radius: float) -> Booleans:
        """Mask (p,) of tangents that may be the highest of their term within `radius` of each x."""
        reach = radius * np.abs(self.slope).sum(axis=1)
        least = np.full(len(self.share), -math.inf)
        np.maximum.at(least, self.term, self.height - reach)
        return self.height + reach >= least[self.term]

    def least(self, step: Floats) -> float:
        """Change of the cost by `step` (2g,), as the model has it."""
        smooth = float(self.pull @ step + 0.5 * self.bend @ step**2)
        if not len(self.share):
            return smooth
        most = np.full(len(self.share), -math.inf)
        np.maximum.at(most, self.term, self.height + self.slope @ step)
        return smooth + float(self.share @ most)


@dataclass(frozen=True)
class StaticSoftness:
    """Goal "largest_kp": ln Σ u/k over the directions, u their inertia times weight, k their stiffness."""

    unit: Floats
    member: Floats
    cascade: Booleans
    LITTLE: ClassVar[float] = 2e-3
    """Fall of the cost over some steps below which a search ends."""
    predicts: ClassVar[bool] = True
    """True: margins are predicted where gains change little, as sampling them takes most of the time."""

    def at(self, gains: Gains) -> tuple[Cost, Floats]:
        """Cost with these gains; no terms."""
        stiff = stiffness(gains, self.cascade)
        moving = acting(gains, self.member) & (stiff > 0)
        compliance = np.divide(self.unit, stiff, out=np.zeros(len(stiff)), where=moving)
        weight = self.member @ compliance / compliance.sum()
        none, nothing = np.zeros(len(weight)), np.zeros(0)
        pull, bend = np.concatenate([-weight, none]), np.concatenate([weight, none])
        return Cost(math.log(compliance.sum()), pull, bend, nothing, nothing.astype(int), nothing, np.zeros((0, len(pull)))), nothing

    @property
    def counted(self) -> Sequence[int]:
        """Indices of the cases that the cost depends on: none."""
        return ()

    def begin(self, which: Sequence[int]) -> None:
        """Nothing: the cost depends on no case."""

    def complete(self, gains: Gains) -> bool:
        """True: no case is left out."""
        return True

    def softer(self, gains: Gains, other: Gains) -> bool:
        """True if `gains` have the larger sum of compliances, over the directions that both hold."""
        stiff, beside = (stiffness(each, self.cascade) for each in (gains, other))
        both = self.member.any(axis=0) & (stiff > 0) & (beside > 0)
        return float((self.unit[both] / stiff[both]).sum()) > float((self.unit[both] / beside[both]).sum())


@dataclass(frozen=True, eq=False)
class LinkSoftness:
    """Goal "dynamic_stiffness": mean ln of the links' highest peaks over contact states and directions.

    cases    those of one contact state share their terms, and the worst of them counts; those that never are the worst are left out
    weight   (m,) of each direction
    """

    cases: Sequence[GainCase]
    weight: Floats
    member: Floats
    cascade: Booleans
    LITTLE: ClassVar[float] = 5e-4
    predicts: ClassVar[bool] = False
    _watched: list[int] = field(default_factory=list)
    _known: dict[bytes, tuple[Cost, Floats]] = field(default_factory=dict)

    def at(self, gains: Gains) -> tuple[Cost, Floats]:
        """Cost with gains that are stable in every case, and (T,) ln of each term's highest peak."""
        key = gains.tobytes()
        if key not in self._known:
            if not self._watched:
                self._watched.extend(self._softest_of(gains) or [0])  # one without peaks, where contacts lock every link
            if len(self._known) >= REMEMBERED:
                del self._known[next(iter(self._known))]
            self._known[key] = self._at(gains)
        return self._known[key]

    def _at(self, gains: Gains) -> tuple[Cost, Floats]:
        found = self._peaks(self._watched, gains)
        counted = np.flatnonzero(np.isfinite(most := self._highest(found)) & np.tile(self.member.any(axis=0), len(self._names)))
        number = np.full(len(most), -1)
        number[counted] = np.arange(len(counted))
        term, height = (np.concatenate([getattr(one, name) for one in found.values()]) for name in ("direction", "height"))
        term = term + np.repeat([self._place(k) for k in found], [len(one.height) for one in found.values()])
        near = (number[term] >= 0) & (height > most[term] + math.log(SHARE))
        slope = np.concatenate([one.slope for one in found.values()])[near] @ self.member.T
        share = np.tile(self.weight, len(self._names))[counted]
        share = share / share.sum()
        held = acting(gains, self.member) & (gains[0] > 0) & (gains[1] > 0)
        part = held / max(int(held.sum()), 1)
        with np.errstate(divide="ignore"):
            logs = np.where(held, np.log([stiffness(gains, self.cascade), gains[1]]), 0.0)
        pull = np.concatenate([-STIFFER * self.member @ part, QUIETER * self.member @ part])
        value = float(share @ most[counted]) + float(part @ (QUIETER * logs[1] - STIFFER * logs[0]))
        links = Cost(value, pull, np.zeros(len(pull)), share, number[term[near]], (height - most[term])[near], slope.reshape(-1, len(pull)))
        late = self._late(logs, held)
        return links.and_above_zero(*late), np.concatenate([most[counted], np.maximum(late[0], 0.0)])

    def _late(self, logs: Floats, held: Booleans) -> tuple[Floats, Floats, Floats]:
        """ln(kp τ/kd) of each group of joints, its slopes by ln of the groups' gains, and its weight: the joints' part of all."""
        if self._lag is None:
            return np.zeros(0), np.zeros((0, 2 * len(self.member))), np.zeros(0)
        each = np.where(held, self._lag + logs[0] - logs[1], -math.inf)
        height = np.where(self.member > 0, each, -math.inf).max(axis=1)
        some = np.isfinite(height)
        one = np.eye(len(height))[some]
        return height[some], np.hstack([one, -one]), (self.member @ held)[some] / held.sum()

    @property
    def counted(self) -> Sequence[int]:
        """Indices of the cases that the cost depends on by now."""
        return self._watched

    def begin(self, which: Sequence[int]) -> None:
        """Set the cases that count first; the others join where they are softer."""
        self._watched[:] = which
        self._known.clear()

    def complete(self, gains: Gains) -> bool:
        """True if no case that was left out is softer with these gains; such cases count from now on."""
        left = [k for k in range(len(self.cases)) if k not in self._watched]
        if not left:
            return True
        known = self._highest(self._peaks(self._watched, gains))
        more = self._softest_of(gains, left, known + SOFTER)
        self._watched.extend(more)
        self._known.clear()
        return not more

    def softer(self, gains: Gains, other: Gains) -> bool:
        """True if `gains` have the larger cost in all cases, or do not hold a direction that `other` holds; both are stable."""
        if np.any((gains[0] <= 0) & (other[0] > 0) & self.member.any(axis=0)):
            return True
        while not (self.complete(gains) and self.complete(other)):
            pass
        return self.at(gains)[0].value > self.at(other)[0].value

    def softest(self, gains: Gains) -> Integers:
        """Index (m,) of the case in which each direction's link is softest; −1 where no load moves it."""
        found = self._peaks(range(len(self.cases)), gains)
        most, where = np.full(len(self.weight), -math.inf), np.full(len(self.weight), -1)
        for k, one in found.items():
            for j, height in zip(one.direction.tolist(), one.height.tolist(), strict=True):
                if height > most[j]:
                    most[j], where[j] = height, k
        return where

    def _softest_of(self, gains: Gains, among: Sequence[int] | None = None, known: Floats | None = None) -> list[int]:
        """Cases that have the highest peak of a contact state's direction, above `known` (T,) if given."""
        found = self._peaks(range(len(self.cases)) if among is None else among, gains)
        most = np.maximum(self._highest(found), -math.inf if known is None else known)
        return [k for k, one in found.items() if np.any(one.height >= most[one.direction + self._place(k)])]

    @cached_property
    def _lag(self) -> Floats | None:
        """ln of the longest lag (m,) of each joint's torque over the cases; None of tasks and of loops without lag."""
        late = [case.lag for case in self.cases if case.lag is not None]
        if not late or not np.any(late):
            return None
        with np.errstate(divide="ignore"):
            return np.log(np.max(late, axis=0))

    def _peaks(self, which: Sequence[int], gains: Gains) -> dict[int, SoftPeaks]:
        return dict(zip(which, at_once(lambda k: self.cases[k].peaks(gains), which), strict=True))

    def _highest(self, found: Mapping[int, SoftPeaks]) -> Floats:
        """ln of the highest peak (T,) of each contact state's directions; −inf where there is none."""
        most = np.full(len(self._names) * len(self.weight), -math.inf)
        for k, one in found.items():
            np.maximum.at(most, one.direction + self._place(k), one.height)
        return most

    @cached_property
    def _names(self) -> list[str]:
        return list(dict.fromkeys(case.contact for case in self.cases))

    def _place(self, k: int) -> int:
        """Number of the first term of a case's contact state."""
        return self._names.index(self.cases[k].contact) * len(self.weight)


def acting(gains: Gains, member: Floats) -> Booleans:
    """Mask (m,) of the directions that belong to a group and have gains."""
    return member.any(axis=0) & np.any(gains > 0, axis=0)


def goal_of(
    objective: Objective, cases: Sequence[GainCase], unit: Floats, weight: Floats, groups: Sequence[Sequence[int]]
) -> LinkSoftness | StaticSoftness:
    """Goal of a search over `groups` of directions; `unit` (m,) of their stiffness, `weight` (m,) of their dynamic stiffness."""
    member = np.zeros((len(groups), len(unit)))
    for row, group in zip(member, groups, strict=True):
        row[list(group)] = 1.0
    if objective == "largest_kp":
        return StaticSoftness(unit, member, cases[0].cascade)
    return LinkSoftness(cases, weight, member, cases[0].cascade)
