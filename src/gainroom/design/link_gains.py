"""The gains of one joint whose link is dynamically stiffest, among those that are allowed on each line kp = const.

For each kp the best allowed kd is searched, for all lines at once; then kp, from the ladder of the region down to a bracket of 0.1 %, from
each of the highest local maxima on the ladder. The compliance of every case is worked out on frequencies of its own; where the gains found
have a peak between them (dynamic_stiffness, by the loop's roots), frequencies about it join, and the search starts over.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..analysis.dynamic_stiffness import FASTEST, stiffness_of
from ..analysis.link_compliance import LinkCompliance
from ..system.controller import Controller
from ..system.gain_bounds import GainBounds
from ..system.linear.arrays import Complexes, Floats, distinct
from ..system.loop import Loop

PER_DECADE = 50  # frequencies per decade: a peak of damping ratio 0.1 is then known to 0.3 % by a parabola
BESIDE = np.linspace(-0.25, 0.25, 81)  # relative frequencies about the resonances, where peaks of light damping are
ACROSS = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, 17))  # places of the first kd tried within what is allowed, denser at its ends
POINTS, ROUNDS = 7, 7  # kd tried about the best, and how often: each narrows the bracket to a third
LINES = 9  # values of kp tried at a time in a bracket
NARROW = 1e-3  # width of a bracket of kp at which a search ends
FEW = 3  # every so many lines of the ladder are tried first
EDGE = 0.005  # share of an allowed interval of kd left free at its ends, below of kd where that is less
CLOSER = 0.2  # width of the frequencies about a peak that was missed, times BESIDE
STARTS = 3  # local maxima on the ladder from which the search goes on
ALIKE = 2e-3  # share of the dynamic stiffness that counts as equal: of equal gains those with the least kd, as encoder noise goes with it
MISSED = 3e-3  # share by which the peak found by the loop's roots may exceed the one on the frequencies
AGAIN = 6  # most searches with more frequencies
WIDEST = 16.0  # largest kd tried where nothing limits it, in units of the critical damping of the whole inertia
BOUND = 0.9  # share of the ladder's top above which the best kp counts as unlimited


@dataclass(frozen=True)
class Stiffest:
    """Gains with the largest dynamic stiffness [N m/rad] in the worst case."""

    kp: float
    kd: float
    stiffness: float


class LinkCase:
    """Compliance of one joint's link in one case, for any gains on the controller's plane.

    loop_of   (kp, kd) → loop
    """

    def __init__(self, loop_of: Callable[[float, float], Loop], template: Controller) -> None:
        self.loop_of, self._template = loop_of, template
        self.links = LinkCompliance.of(loop_of(1.0, 1.0))
        plant = self.links.parts.plant
        drive = self.links.parts.drives[0]
        corners = np.abs(plant.corners().every)
        corners = corners[corners > 1e-6 * corners.max(initial=0.0)]
        lag = drive.delay + 2 / drive.bandwidth + (self.links.parts.sample_time or 0.0)
        scales = [*corners.tolist(), *([1 / lag] if lag else [])] or [1.0]
        low, high = 1e-3 * min(scales), min(FASTEST * max(scales), self.links.fastest)
        wide = np.geomspace(low, high, math.ceil(PER_DECADE * math.log10(high / low)))
        self._set(np.concatenate([wide, (corners[:, None] * (1 + BESIDE)).ravel()]))

    def _set(self, omega: Floats) -> None:
        self._omega = distinct(omega[omega <= self.links.fastest])
        self._s = 1j * self._omega
        parts, step = self.links.parts, self.links.parts.sample_time
        v = self._s if step is None else np.expm1(self._s * step) / step
        self._fed = self.links.delivered(self._s, parts.delays, step) * self._template.plane_at(self._s, v, step)

    @property
    def integral(self) -> bool:
        """True if the controller integrates: at rest the link is then as stiff as its gearbox, not at most kp."""
        return any(powers[1] for terms in self._template.plane() for powers in terms)

    def misses_a_peak(self, found: Stiffest) -> bool:
        """True if the frequencies miss a peak at these gains, by the loop's roots; frequencies about it are then added."""
        exact = stiffness_of(self.loop_of(found.kp, found.kd), stable=True)
        omega, stiffness = float(exact.omega[0]), float(exact.stiffness[0])
        if not omega > 0 or stiffness > (1 - MISSED) * self.stiffness(np.array([found.kp]), np.array([found.kd]))[0]:
            return False
        self._set(np.concatenate([self._omega, omega * (1 + CLOSER * BESIDE)]))
        return True

    def stiffness(self, kp: Floats, kd: Floats) -> Floats:
        """Dynamic stiffness (g,) [N m/rad] at gains (g,): 1/peak by a parabola through the highest sample of ln |C| and its neighbours."""
        fed = kp[:, None] * self._fed[:, 0] + kd[:, None] * self._fed[:, 1]
        heights = np.abs(self.links.of_one(self._s, fed, self._by_motors(kp, kd)))
        top = heights.argmax(axis=1)
        inner = (top > 0) & (top < len(self._omega) - 1)
        rows, at = np.arange(len(kp)), np.clip(top, 1, len(self._omega) - 2)
        a, b, c = (np.log(np.maximum(heights[rows, at + shift], 1e-300)) for shift in (-1, 0, 1))
        x0, x1 = (np.log(self._omega[at + shift] / self._omega[at]) for shift in (-1, 1))
        slope, bend = _parabola(x0, a - b, x1, c - b)
        rise = np.where(inner & (bend < 0), -(slope**2) / (4 * np.minimum(bend, -1e-300)), 0.0)
        found = 1 / (heights[rows, top] * np.exp(np.clip(rise, 0.0, 1.0)))
        return found if self.integral else np.minimum(found, kp)  # at rest, which may be slower than every frequency here

    def _by_motors(self, kp: Floats, kd: Floats) -> Complexes | None:
        """Part (g, k) of the feedback by gains that measure the motor, where gains (g,) measure both sides; None elsewhere."""
        feedback = self.links.parts.feedback
        if not feedback.mixed:
            return None
        return kp[:, None] * self._fed[:, 0] if feedback.position == "motor" else kd[:, None] * self._fed[:, 1]


def _parabola(x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> tuple[Floats, Floats]:
    """Slope and bend of y = slope x + bend x² through (x0, y0), (0, 0) and (x1, y1)."""
    bend = (y0 / x0 - y1 / x1) / (x0 - x1)
    return y1 / x1 - bend * x1, bend


Allowed = Callable[[Floats, bool], list[Floats]]
"""kp (m,) → intervals of kd (p, 2) per kp, within the bounds; with ends as good as a grid of frequencies, or (True) polished."""


def stiffest_link(
    cases: Sequence[LinkCase], allowed: Allowed, kps: Floats, inertia: float, bounds: GainBounds | None = None
) -> Stiffest | None:
    """Gains with the largest dynamic stiffness in the worst of `cases`; None where none are allowed, or nothing limits kp.

    kps       ladder of kp (m,), ascending: all orders of magnitude that matter
    inertia   of motor and link [kg m²], from which the largest kd is taken where nothing limits it
    bounds    of one joint's gains; None: none
    """
    bounds = bounds or GainBounds()
    search = _Search(cases, allowed, _between(kps, bounds), inertia, bounds)
    found = search.run()
    for _ in range(AGAIN):
        if found is None or (math.isinf(bounds.kp_max) and found.kp > BOUND * kps[-1]):
            return None
        missed = [case for case in cases if case.misses_a_peak(found)]
        if not missed:
            break
        found = search.run()
    return found


def _between(kps: Floats, bounds: GainBounds) -> Floats:
    """Ladder of kp between its bounds, which are its ends where they are given."""
    low, high = float(bounds.kp_min), float(bounds.kp_max)
    ends = [end for end in (low, high) if 0 < end < math.inf]
    return distinct(np.concatenate([kps[(kps > low) & (kps < high)], ends]))


@dataclass(frozen=True)
class _Search:
    """Search of `stiffest_link`."""

    cases: Sequence[LinkCase]
    allowed: Allowed
    kps: Floats
    inertia: float
    bounds: GainBounds

    def run(self) -> Stiffest | None:
        """Gains with the largest stiffness on the frequencies that the cases have now; None where none are allowed.

        On the ladder what is allowed is as good as a grid of frequencies, and polished where that finds nothing.
        """
        return self.best_from(polish=False) or self.best_from(polish=True)

    def best_from(self, polish: bool) -> Stiffest | None:
        """Gains as `run` returns them, from a ladder on which what is allowed is polished or not."""
        ladder = self.on_ladder(polish)
        values = np.array([line.best for line in ladder])
        padded = np.concatenate([[-math.inf], values, [-math.inf]])
        tops = np.flatnonzero(np.isfinite(values) & (values >= padded[:-2]) & (values >= padded[2:]))
        if not len(tops):
            return None
        tried: list[_Tried] = []
        for top in tops[np.argsort(-values[tops])][:STARTS].tolist():
            low, high = float(self.kps[max(top - 1, 0)]), float(self.kps[min(top + 1, len(self.kps) - 1)])
            if high <= low * (1 + NARROW):  # bounds leave kp no room
                tried += self.on_lines(self.kps[top : top + 1], True)
            while high > low * (1 + NARROW):
                trials = np.geomspace(low, high, LINES)
                lines = self.on_lines(trials, True)
                tried += lines
                best = int(np.argmax([line.best for line in lines]))
                low, high = float(trials[max(best - 1, 0)]), float(trials[min(best + 1, LINES - 1)])
        kp, kd, value = (np.concatenate([getattr(one, name) for one in tried]) for name in ("kp", "kd", "value"))
        if not len(kp):
            return None
        equal = np.flatnonzero(value >= (1 - ALIKE) * value.max())
        k = equal[np.argmin(kd[equal])]
        return Stiffest(float(kp[k]), float(kd[k]), float(value[k]))

    def on_ladder(self, polish: bool) -> "list[_Tried]":
        """Gains tried on each line of the ladder: a few first, then those on which the link could be stiffer than the best of these.

        At rest the link is no stiffer than kp, so that a line has no more than its kp (more with integral action, up to the gearbox).
        """
        found = [_Tried(*(np.zeros(0),) * 3) for _ in self.kps]
        best, integral = -math.inf, self.cases[0].integral
        first = np.arange(len(self.kps)) % FEW == 0
        for lines in (first, ~first):
            some = np.flatnonzero(lines & ((self.kps > best) | integral))
            for k, line in zip(some.tolist(), self.on_lines(self.kps[some], polish), strict=True):
                found[k], best = line, max(best, line.best)
        return found

    def on_lines(self, kps: Floats, polish: bool) -> "list[_Tried]":
        """Gains tried on each line of `kps` (m,), the best kd among them; none where none are allowed."""
        rows = [
            (m, max(low, 0.0), min(high, max(WIDEST * 2 * math.sqrt(kps[m] * self.inertia), 4 * low)))
            for m, intervals in enumerate(self.allowed(kps, polish))
            for low, high in intervals.tolist()
        ]
        rows = [row for row in rows if row[2] > row[1] or row[2] == row[1] == self.bounds.kd_max]
        if not rows:
            return [_Tried(*(np.zeros(0),) * 3) for _ in kps]
        at, low, high = np.array([row[0] for row in rows]), *(np.array([row[k] for row in rows]) for k in (1, 2))
        width = high - low
        first, last = low + EDGE * np.minimum(width, np.maximum(low, 1e-3 * width)), high - EDGE * width
        first, last = np.where((low == self.bounds.kd_min) & (low > 0), low, first), np.where(high == self.bounds.kd_max, high, last)
        every, tried, shares = np.arange(len(rows)), [], ACROSS
        for _ in range(ROUNDS):
            kd = np.clip(low[:, None] + (high - low)[:, None] * shares, first[:, None], last[:, None])
            gains = np.repeat(kps[at], kd.shape[1]), kd.ravel()
            value = np.min([case.stiffness(*gains) for case in self.cases], axis=0).reshape(kd.shape)
            tried.append((kd, value))
            best = value.argmax(axis=1)
            low = np.where(best > 0, kd[every, np.maximum(best - 1, 0)], low)
            high = np.where(best < kd.shape[1] - 1, kd[every, np.minimum(best + 1, kd.shape[1] - 1)], high)
            shares = np.linspace(0.0, 1.0, POINTS)
        kd, value = (np.concatenate([one[k] for one in tried], axis=1) for k in (0, 1))
        mine = [at == m for m in range(len(kps))]
        return [
            _Tried(np.full(int(own.sum()) * kd.shape[1], kp), kd[own].ravel(), value[own].ravel())
            for kp, own in zip(kps, mine, strict=True)
        ]


@dataclass(frozen=True)
class _Tried:
    """Gains tried on a line kp = const, each (g,), and the link's stiffness in the worst case."""

    kp: Floats
    kd: Floats
    value: Floats

    @property
    def best(self) -> float:
        """Largest stiffness; −inf of a line without gains."""
        return float(self.value.max(initial=-math.inf))
