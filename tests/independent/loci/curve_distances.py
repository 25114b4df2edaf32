"""How far a number may grow that changes the determinant of the return difference by a scalar curve: gains of one loop, the others closed.

The curve is sampled where it comes near the negative real axis, and followed towards ω = 0 until it settles; unstable roots are counted
on both sides of what is found.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from gainroom.analysis.margin_record import NUDGE
from gainroom.analysis.stability_boundary import in_blocks
from gainroom.system.linear.arrays import Booleans, Complexes, Floats, Integers, distinct

from .first_crossing import SEARCH, Certificate, Family, Rough, listed
from .loci import Sweep, passes
from .resolution import LOCI
from .sampled_curves import Curves, meets_axis, on_axis, passed_unseen, refined, side


@dataclass(frozen=True)
class CurveTolerances:
    """How the curve of one loop is sampled and read."""

    relative_move: float = 0.25  # of a curve between samples, near the negative real axis
    real: float = 1e-6  # part of its size up to which what is imaginary at an end of the boundary is taken for round-off
    # of the lowest corner frequency of the loci: under integrators what crosses further down is round-off
    deep: float = 1e-5
    halved: int = 30  # times that the lowest frequency is halved to see what curves are at rest
    smooth: float = 1e-3  # of a curve: second differences over steps of 1 % that are larger are round-off
    blurred: float = 1e-3  # estimate of the round-off in curves up to which they are used
    enough: float = 1e-9  # of it: what it is known to no better
    lean: float = 0.3  # part of it that may be imaginary where it is looked for
    settled: float = 1e-2  # of a curve's value at rest: what it moves by, at most, further down
    # of a curve's size without resonances: where it is smaller it is not followed, and what it would limit counts as without limit
    faintest: float = 1e-6
    quick: float = 0.1  # [rad] of lag from which on that size is looked at,
    top: float = 0.01  # or from so much of the highest frequency, where that is lower
    cancelled: float = 30 * np.finfo(float).eps  # of the terms of which a curve's value is the sum: W is off by a few last digits
    steepest: int = 6  # power of 1/ω with which a curve rises towards rest: what rises faster rises from a 0 that round-off has made
    within: float = 0.5  # of where it crosses for sure: likewise, as what it does there limits nothing first


CURVES = CurveTolerances()


class Summed(NamedTuple):
    """m curves at k frequencies: `values` (k, m), and the size (k, m) of the `terms` of which each is the sum."""

    values: Complexes
    terms: Floats


def distances(sweep: Sweep, curves: Callable[[Floats], Summed], farthest: Floats | float = math.inf) -> tuple[Floats, Booleans]:
    """(m,) the smallest δ > 0 with 1 + δ c(jω) = 0 for each curve c of a stable loop, inf where none is; and where that is certified.

    c is analytic wherever the loop is stable, so 1 + δ c turns about 0 by as many turns as δ brings unstable roots. What lies beyond
    `farthest` (m,) counts as none.
    """
    family = _Curves(sweep, curves)
    integrates = sweep.loop.parts is not None and any(integral for _, integral in sweep.loop.parts.controller.terms())
    farthest = np.broadcast_to(farthest, family.size)
    nearest = [one if one is None or one.at < most else None for one, most in zip(family.nearest(), farthest.tolist(), strict=True)]
    family.add(np.concatenate([one.omega * (1 + SEARCH.towards) for one in nearest if one is not None] or [np.zeros(0)]))
    found, certified = np.full(family.size, math.inf), family.settled.copy()
    for joint, one in enumerate(nearest):
        if one is None:
            continue
        certificate = Certificate(*(family.count(joint, one.at * (1 + side * NUDGE)) for side in (-1, 1)))
        first = certificate.holds and not family.crosses_before(joint, one.at)
        end = None if first else family.of(joint).end(0.0, one.at * (1 + 10 * NUDGE))
        holds = first or (end is not None and end.certificate.holds)
        found[joint] = end.at if end is not None and holds else one.at
        drowned = integrates and (one if end is None else end).omega < CURVES.deep * sweep.first
        certified[joint] &= holds and family.certifies(joint, found[joint]) and not drowned
    return found, certified


class _Curves:
    """m scalar curves along the stability boundary, sampled until smooth where they come near the negative real axis.

    Towards ω = 0 each is followed until it falls as r/(jω)ᵏ, r real: k = 0, but for a joint that the others leave free to drift. Samples
    further down hold its value there: round-off makes them worse.

    settled   (m,) True where that has been found
    """

    def __init__(self, sweep: Sweep, curves: Callable[[Floats], Summed]) -> None:
        self._sweep = sweep
        self._given: Curves = lambda omega: in_blocks(lambda part: curves(part).values, omega, sweep.loop.size)
        levels, below = self._halved(sweep.first)
        drowned = CURVES.cancelled * in_blocks(lambda part: curves(part).terms, levels, sweep.loop.size)
        omega = distinct(np.concatenate([levels, sweep.omega]))
        values = self._given(omega)
        self.size = values.shape[1]
        least = 1e-3 * np.abs(values).max(axis=0)
        self._rest = [_at_rest(levels, below[:, :, joint], least[joint], drowned[:, joint]) for joint in range(self.size)]
        self.settled = np.array([one.settled for one in self._rest])
        rows = np.array([one.row for one in self._rest])
        self._lowest, self._held = levels[rows], below[rows, 0, np.arange(self.size)]
        values = self._holding(omega, values)
        # Of the curve where the loop is too quick for its lags: further down one that drifts is larger without bound.
        quick = omega >= min(CURVES.quick / max(sweep.lag, 1e-300), CURVES.top * omega[-1])
        self._faint = np.maximum(CURVES.faintest * _level(omega[quick], values[quick]), 1e-300)
        omega, values = refined(omega, values, self._at, lambda _, values: np.any(_rough(self._faint, values), axis=1), 30, LOCI.most)
        self.omega, self.values = refined(omega, values, self._at, partial(_unseen, self._faint), 60, LOCI.most)
        self.settled &= ~_rough(self._faint, self.values).any(axis=0)  # what is not smooth however near samples lie is round-off

    def _halved(self, highest: float) -> tuple[Floats, Complexes]:
        """Frequencies (k,) from `highest` down, and the curves there and 1 and 2 % above (k, 3, m), as far as they can be computed."""
        levels = highest * 0.5 ** np.arange(CURVES.halved)
        while True:
            try:
                blurred = self._sweep.boundary.blurred(levels) > CURVES.blurred
                levels = levels[: max(3, int(np.argmax(np.append(blurred, True))))]
                return levels, self._given((levels[:, None] * [1.0, 1.01, 1.02]).ravel()).reshape(len(levels), 3, -1)
            except np.linalg.LinAlgError:  # weight that hangs on one motion alone drowns the rest there, to the last digit
                if len(levels) <= 3:
                    raise
                levels = levels[:-1]

    def _at(self, omega: Floats) -> Complexes:
        return self._holding(omega, self._given(omega))

    def _holding(self, omega: Floats, values: Complexes) -> Complexes:
        return np.where(omega[:, None] <= self._lowest, self._held, values)

    def certifies(self, joint: int, change: float) -> bool:
        """True where it is known from the value at rest on which side of 0 1 + δ c begins, for δ on both sides of `change`."""
        rest = self._rest[joint]
        return rest.order > 0 or abs(abs(1 + change * rest.value) - NUDGE) > abs(change) * rest.error

    def crosses_before(self, joint: int, change: float) -> bool:
        """Whether samples show the negative real axis crossed by a curve at less than that change."""
        value = meets_axis(self.values[:-1, [joint]], self.values[1:, [joint]])[3]
        return bool(np.any(change * (1 - NUDGE) * value < -1))

    def add(self, omega: Floats) -> None:
        """Take samples at more frequencies."""
        inside = (omega > self.omega[0]) & (omega < self.omega[-1])
        fresh = distinct(omega[inside])
        fresh = fresh[~np.isin(fresh, self.omega, assume_unique=True)]
        place = np.searchsorted(self.omega, fresh)
        self.omega, self.values = np.insert(self.omega, place, fresh), np.insert(self.values, place, self._at(fresh), axis=0)

    def count(self, joint: int, change: float) -> int:
        """By how many unstable roots 1 + `change` c differs from 1."""
        curve = change * self.values[:, joint]
        for _ in range(40):
            close = passes(curve[:-1], curve[1:]) & (np.diff(self.omega) > LOCI.closest * self.omega[1:])
            if not close.any() or len(self.omega) > LOCI.most:
                break
            self.add(0.5 * (self.omega[:-1] + self.omega[1:])[close])
            curve = change * self.values[:, joint]
        one = 1 + curve
        turned = float(np.sum(np.angle(one[1:] * one[:-1].conj())))
        rest = self._rest[joint]
        own = np.sign(change * rest.value + (rest.order == 0)) or 1.0
        turned += float(np.angle(one[0] * 1j**rest.order * own))  # from ω = 0+
        if self._sweep.last is None:
            turned -= float(np.angle(one[-1]))
        return round(rest.order / 2 - turned / math.pi)

    def nearest(self) -> list[Rough | None]:
        """The leftmost crossing of the negative real axis by each curve."""
        least = self._faint
        found: list[Rough | None] = [None] * self.size
        for joint, rest in enumerate(self._rest):
            if rest.settled and rest.order == 0 and rest.value < -least[joint]:
                found[joint] = Rough(-1 / rest.value, float(self._lowest[joint]), complex(rest.value))
        if self._sweep.last is not None:
            for joint, value in enumerate(self.values[-1].tolist()):
                if value.real < -least[joint] and abs(value.imag) < CURVES.real * abs(value):
                    found[joint] = _further_left(found[joint], Rough(-1 / value.real, float(self.omega[-1]), value))
        rows, joints = np.nonzero(_foremost(self.values, _meet_axis(self.values)))
        for joint, one in zip(joints.tolist(), self._polished(rows, joints), strict=True):
            if one.value.real < -least[joint]:
                found[joint] = _further_left(found[joint], one)
        return found

    def _polished(self, rows: Integers, joints: Integers) -> list[Rough]:
        low, high = ((self.omega[at], self.values[at, joints]) for at in (rows, rows + 1))
        omega, value = on_axis(self._at, joints, low, high)
        return listed(np.divide(-1, value.real, out=np.full(len(value), math.inf), where=value.real != 0), omega, value)

    def of(self, joint: int) -> Family:
        """The change that one curve represents."""

        def steps() -> Integers:
            return np.flatnonzero(_meet_axis(self.values[:, [joint]])[:, 0])

        def crossings() -> list[Rough]:
            rows, _, share, value = meets_axis(self.values[:-1, [joint]], self.values[1:, [joint]])
            omega = self.omega[rows] + share * (self.omega[rows + 1] - self.omega[rows])
            seen = value < -self._faint[joint]
            return listed(-1 / value[seen], omega[seen], value[seen].astype(complex))

        def polish(group: list[Rough]) -> list[Rough]:
            rows = np.intersect1d(steps(), np.searchsorted(self.omega, [one.omega for one in group]) - 1)
            return [one for one in self._polished(rows, np.full(len(rows), joint)) if one.value.real < 0]

        def nearest(change: float) -> Rough:
            row = int(np.argmin(np.abs(1 + change * self.values[:, joint])))
            return Rough(change, float(self.omega[row]), complex(self.values[row, joint]))

        def mode(_: Rough) -> Complexes:
            return np.ones(1, dtype=complex)

        return Family(lambda change: self.count(joint, change), crossings, polish, self.add, nearest, mode)


class _Rest(NamedTuple):
    """A curve towards ω = 0: `value`/(jω)^`order`, known to ± `error`; from levels[`row`] on down that is taken."""

    row: int
    order: int
    value: float
    error: float
    settled: bool


def _at_rest(levels: Floats, curve: Complexes, least: float, drowned: Floats) -> _Rest:
    """From samples at `levels` (k,) that halve, and 1 and 2 % above: curve (k, 3).

    Slow closed-loop modes move a curve far below all else, and round-off hides what is still lower: so the lowest stretch is looked for
    on which it moves no more, where it is smooth. `least`: smaller values are as good as 0. `drowned` (k,): smaller ones are round-off,
    smooth as they may be: what round-off leaves of motions that contacts hold drifts as if it were free. Where all are, as of a joint that
    nothing moves, they are what there is.
    """
    size = np.maximum(np.abs(curve), max(least, 1e-300))
    smooth = np.abs(curve[:, 0] - 2 * curve[:, 1] + curve[:, 2]) <= CURVES.smooth * size[:, 0]
    known = np.abs(curve[:, 0]) > drowned
    smooth &= known | ~known.any()
    lowest = np.flatnonzero(smooth[:-2] & smooth[1:-1] & smooth[2:])
    if not len(lowest):
        return _Rest(0, 0, float(curve[0, 0].real), math.inf, False)
    last = int(lowest[-1]) + 1  # the next may just be lost
    order = round(float(np.log2(max(abs(curve[last, 0]), 1e-300) / max(abs(curve[last - 1, 0]), 1e-300))))
    if order < 0 or size[last, 0] <= CURVES.faintest * least:
        return _Rest(last, 0, 0.0, 2 * abs(float(curve[last, 0].real)), True)
    if order > CURVES.steepest:
        return _Rest(last, 0, 0.0, 2 * abs(float(curve[last, 0].real)), bool(abs(curve[last, 0]) <= least))
    flat = curve[: last + 1, 0] * (1j * levels[: last + 1] / levels[last]) ** order
    # c is real on the real axis: what is left of its real part falls with ω², and two levels give the rest of it
    ahead, scale = flat.real[1:] + np.diff(flat.real) / 3, max(abs(flat[last]), least)
    away = (np.abs(ahead - ahead[-1]) > CURVES.settled * scale) | (np.abs(flat.imag[1:]) > CURVES.lean * scale)
    first = int(np.flatnonzero(away)[-1]) + 1 if away.any() else 0
    moved = np.abs(np.diff(ahead))[first:]
    if not len(moved):
        return _Rest(last, order, float(flat[last].real), math.inf, False)
    enough = moved <= CURVES.enough * max(abs(flat[last]), 10 * least)
    row = first + int(np.argmax(enough) if enough.any() else np.argmin(moved)) + 2
    return _Rest(row, order, float(ahead[row - 1]), float(moved[row - 2 - first]), True)


def _further_left(one: Rough | None, other: Rough) -> Rough:
    return other if one is None or other.at < one.at else one


def _meet_axis(values: Complexes) -> Booleans:
    """(k − 1, m) True for steps that cross the real axis, and not surely its positive half."""
    return ((values.imag[1:] > 0) != (values.imag[:-1] > 0)) & ((values.real[1:] < 0) | (values.real[:-1] < 0))


def _foremost(values: Complexes, crosses: Booleans) -> Booleans:
    """Of the steps (k − 1, m) that cross the real axis, those that may hold a curve's leftmost crossing."""
    spread = 1 + CURVES.relative_move  # how far beyond its ends a step may reach
    left = spread * np.minimum(values.real[:-1], values.real[1:])
    surely = np.where(crosses, np.maximum(values.real[:-1], values.real[1:]) / spread, 0.0).min(axis=0, initial=0.0)
    return crosses & (left <= surely)


def _level(omega: Floats, values: Complexes) -> Floats:
    """(m,) the size of each curve without its sharp resonances: the largest of the least in each fifth of a decade."""
    first = np.flatnonzero(np.diff(np.floor(5 * np.log10(omega)), prepend=-math.inf))
    return np.minimum.reduceat(np.abs(values), first, axis=0).max(axis=0)


def _rough(faint: Floats, values: Complexes) -> Booleans:
    """(k − 1, m) where samples of a curve are too far apart as it comes near the negative real axis.

    Up to a change δ at which a curve c meets −1/δ, 1 + δ c cannot turn about 0 where c is smaller than that.
    """
    start, end = values[:-1], values[1:]
    size, surely = np.maximum(np.abs(start), np.abs(end)), _surely(values)
    moves = _moves(values)
    near = (np.minimum(start.real, end.real) < 0) & (np.minimum(np.abs(start.imag), np.abs(end.imag)) < size)
    followed = size > np.maximum(faint, -CURVES.within * surely)
    return near & moves & followed


def _moves(values: Complexes) -> Booleans:
    """(k − 1, m) True for steps on which a curve moves by much of its size."""
    start, end = values[:-1], values[1:]
    return np.abs(end - start) > CURVES.relative_move * np.maximum(np.abs(start), np.abs(end))


def _surely(values: Complexes) -> Floats:
    """(m,) the leftmost place at which each curve crosses the real axis for sure; 0 where none does."""
    crosses = _meet_axis(values) & ~_moves(values)
    return np.where(crosses, np.maximum(values.real[:-1], values.real[1:]), 0.0).min(axis=0, initial=0.0)


def _unseen(faint: Floats, omega: Floats, values: Complexes) -> Booleans:
    """Where a curve may pass the negative real axis unseen between samples, farther left than it crosses it for sure."""
    start, end = values[:-1], values[1:]
    followed = np.maximum(np.abs(start), np.abs(end)) > np.maximum(faint, -_surely(values))
    return passed_unseen(omega, values, side, followed & (start.real < 0) & (end.real < 0))
