"""Gains that a requirement excludes, on lines kp = const, as intervals of kd.

A requirement keeps L(jω) out of a set around −1 (system/excluded_sets.py). On a line kp = const, and at one ω, the kd for which L lies in
the set are points or an interval in closed form (a linear or quadratic equation); over all ω they sweep intervals. Their ends lie where ω
enters or leaves the set, or where kd(ω) has an extremum; both are polished, so the intervals are exact, not gridded.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..system.excluded_sets import Branch, ExcludedSet, on_circle
from ..system.linear.arrays import Booleans, Complexes, Floats, Integers
from .gain_plane import BoundaryCurve, GainPlane

Piece = tuple[Integers, Floats, Floats]
"""Column, one end and the other end of intervals of kd."""
Events = tuple[Integers, Floats, Floats]
"""Column, ω and kd."""
ROUNDS, FEW_ROUNDS = 50, 8  # halvings of an end of an interval: polished, and for a first search
GOLDEN_ROUNDS = 24  # of golden section, each to 0.618 of the interval: together to 1e-5 of it


@dataclass(frozen=True)
class Lines:
    """Lines kp = const of a plane of gains, and what figures in the plane of L exclude on them.

    omega   (k,) grid that resolves the plane
    kps     (m,)
    window  (m, 2) the kd of interest; what lies outside is not worked out to the last digit
    polish  False: ends as good as the grid, for a first search
    """

    plane: GainPlane
    omega: Floats
    kps: Floats
    window: Floats
    polish: bool = True

    def excluded(self, shape: ExcludedSet) -> list[Floats]:
        """Intervals of kd (p, 2), disjoint and sorted, that `shape` excludes, one array per line; (−inf, inf) if all kd are excluded."""
        column, low, high = (np.concatenate(parts) for parts in zip(*shape.on(self), strict=True))
        return union_of(column.astype(int), np.minimum(low, high), np.maximum(low, high), len(self.kps))

    @cached_property
    def responses(self) -> tuple[Complexes, Complexes]:
        """Responses A and B (k,) at `omega`, with L = kp A + kd B."""
        return self._at(self.omega)

    def _at(self, omega: Floats) -> tuple[Complexes, Complexes]:
        return self.plane.a.response(omega), self.plane.b.response(omega)

    def swept(self, branches: Sequence[Branch], ends: Sequence[complex]) -> list[Piece]:
        """Intervals of kd for which L lies at some ω on a curve in the plane of L with the end points `ends`.

        branches   solutions kd(ω) with L on the curve
        """
        found = [BoundaryCurve.of(self.plane, end).crossings("kp", self.kps, self.polish) for end in ends]
        if any(branch.paired for branch in branches):
            found = [self._touching(), *found]
        column, omega, kd = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return [piece for branch in branches for piece in self._swept_by(branch, (column, omega, kd))]

    def _swept_by(self, branch: Branch, events: Events) -> list[Piece]:
        """Intervals of kd swept while L is in the set: between samples of ω, cut at every event between them."""
        omega = self.omega
        kd, inside = branch(self.kps[:, None], *(part[None, :] for part in self.responses))
        cut = np.zeros((len(self.kps), len(omega) - 1), dtype=bool)
        place = np.clip(np.searchsorted(omega, events[1]) - 1, 0, len(omega) - 2)
        cut[events[0], place] = True
        whole = inside[:, 1:] & inside[:, :-1] & ~cut
        column, k = np.nonzero(whole)
        pieces = [(column, kd[column, k], kd[column, k + 1])]
        pieces.append(self._around_events(branch, events, place, cut))
        if self.polish:  # extrema of kd(ω) inside the set are ends of its intervals
            near = (kd >= self.window[:, :1]) & (kd <= self.window[:, 1:])
            column, k = np.nonzero(whole[:, 1:] & whole[:, :-1] & near[:, 1:-1] & (np.diff(kd)[:, 1:] * np.diff(kd)[:, :-1] < 0))
            sign = np.where(kd[column, k + 1] > kd[column, k], 1.0, -1.0)
            _, height = self._maximum(lambda *at: sign * branch(*at)[0], self.kps[column], omega[k], omega[k + 1], omega[k + 2])
            pieces.append((column, kd[column, k + 1], sign * height))
        return pieces

    def _around_events(self, branch: Branch, events: Events, place: Integers, cut: Booleans) -> Piece:
        """Intervals of kd from the parts of cells of ω that events divide, however narrow in ω, in which L is in the set.

        With a small kp the crossing frequency hardly depends on kd: a whole segment is swept between two samples.
        """
        column, k = np.nonzero(cut)
        columns = np.concatenate([events[0], column, column])
        places = np.concatenate([place, k, k])
        points = np.concatenate([events[1], self.omega[k], self.omega[k + 1]])
        kd, _ = branch(self.kps[columns], *self._at(points))
        # An event knows its kd to the last digit; on the other branch of a circle it is just one more point.
        own = events[2]
        mine = np.abs(own - kd[: len(own)]) <= 1e-3 * np.abs(own) if branch.paired else np.ones(len(own), dtype=bool)
        kd[: len(own)] = np.where(mine, own, kd[: len(own)])
        order = np.lexsort((points, places, columns))
        columns, places, points, kd = columns[order], places[order], points[order], kd[order]
        _, inside = branch(self.kps[columns[1:]], *self._at(0.5 * (points[1:] + points[:-1])))
        held = inside & (columns[1:] == columns[:-1]) & (places[1:] == places[:-1])
        return columns[1:][held], kd[:-1][held], kd[1:][held]

    def _touching(self) -> Events:
        """Events (line, ω, kd) at which the L of all kd, at one kp and ω, form a line tangent to the unit circle: |kp Im(Ā B)| = |B|.

        On one side of such an ω no kd gives |L| = 1.
        """

        def reach(a: Complexes, b: Complexes) -> Floats:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.abs(b) / np.abs((a.conj() * b).imag)

        kps, omega = self.kps, self.omega
        exists = reach(*self.responses) >= np.abs(kps)[:, None]
        column, k = np.nonzero(exists[:, 1:] != exists[:, :-1])
        starts = exists[column, k + 1]
        low, high = omega[k].copy(), omega[k + 1].copy()
        for _ in range((ROUNDS if self.polish else FEW_ROUNDS) if len(k) else 0):
            middle = 0.5 * (low + high)
            now = reach(*self._at(middle)) >= np.abs(kps[column])
            go_low = now == starts
            high, low = np.where(go_low, middle, high), np.where(go_low, low, middle)
        edge_a, edge_b = self._at(low)
        return column, low, -kps[column] * (edge_a * edge_b.conj()).real / np.abs(edge_b) ** 2

    def shadow(self, center: float, radius: float) -> list[Piece]:
        """Intervals of kd for which |L − center| < radius at some ω."""
        kps, omega = self.kps, self.omega
        a, b = (part[None, :] for part in self.responses)
        (lower, real), (upper, _) = (on_circle(kps[:, None], a, b, -center, radius, sign) for sign in (-1.0, 1.0))
        column, k = np.nonzero(real)
        pieces = [(column, lower[column, k], upper[column, k])]
        # From one sample to the next the interval moves and sweeps what lies between, unless it leaves through infinity (a zero of B).
        column, k = np.nonzero(real[:, 1:] & real[:, :-1] & ((lower[:, 1:] > upper[:, :-1]) | (upper[:, 1:] < lower[:, :-1])))
        start, end = np.minimum(lower[column, k], lower[column, k + 1]), np.maximum(upper[column, k], upper[column, k + 1])
        halfway = self._at(0.5 * (omega[k] + omega[k + 1]))
        (below, exists), (above, _) = (on_circle(kps[column], *halfway, -center, radius, sign) for sign in (-1.0, 1.0))
        gap = np.minimum(upper[column, k], upper[column, k + 1]), np.maximum(lower[column, k], lower[column, k + 1])
        swept = exists & (above > gap[0]) & (below < gap[1])
        pieces.append((column[swept], start[swept], end[swept]))
        pieces += self._towards_gaps(center, radius, column, k, lower, upper)
        if not self.polish:
            return pieces
        column, point = self._narrow_shadows(center, radius)
        (low_end, reached), (high_end, _) = (on_circle(kps[column], *self._at(point), -center, radius, sign) for sign in (-1.0, 1.0))
        # Where B vanishes, as at half the rate of whole ticks of delay, round-off may leave a point that no kd puts into the disk.
        column, point, low_end, high_end = column[reached], point[reached], low_end[reached], high_end[reached]
        cell = np.searchsorted(omega, point) - 1
        pieces.append((column, low_end, high_end))
        for sign, kd in ((-1.0, lower), (1.0, upper)):

            def farthest(kp: Floats, a: Complexes, b: Complexes, sign: float = sign) -> Floats:
                kd, real = on_circle(kp, a, b, -center, radius, sign)
                return np.where(real, sign * kd, -np.inf)  # beside the disk's shadow nothing is reached

            reach = np.where(real, sign * kd, -np.inf)
            top, k = np.nonzero((reach[:, 1:-1] >= reach[:, :-2]) & (reach[:, 1:-1] > reach[:, 2:]))
            owner = np.append(top, column)
            low, middle, high = np.append(omega[k], omega[cell]), np.append(omega[k + 1], point), np.append(omega[k + 2], omega[cell + 1])
            _, height = self._maximum(farthest, kps[owner], low, middle, high)
            start, known = np.append(kd[top, k + 1], low_end if sign < 0 else high_end), np.isfinite(height)
            pieces.append((owner[known], start[known], sign * height[known]))
        return pieces

    def _towards_gaps(self, center: float, radius: float, column: Integers, k: Integers, lower: Floats, upper: Floats) -> list[Piece]:
        """Intervals of kd that the disk excludes on either side of a gap between samples `k` and k + 1: in the gap no kd puts L into it."""
        kps, omega = self.kps[column], self.omega

        def off(kp: Floats, a: Complexes, b: Complexes) -> Floats:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.abs(((-center + kp * a) * b.conj()).imag) / np.abs(b)

        farthest, height = self._maximum(off, kps, omega[k], 0.5 * (omega[k] + omega[k + 1]), omega[k + 1])
        gap = height > radius
        column, k, kps, farthest = column[gap], k[gap], kps[gap], farthest[gap]
        pieces = []
        for sample in (k, k + 1):
            inner, outer = omega[sample].copy(), farthest.copy()
            for _ in range((ROUNDS if self.polish else FEW_ROUNDS) if len(k) else 0):
                middle = 0.5 * (inner + outer)
                reached = off(kps, *self._at(middle)) < radius
                inner, outer = np.where(reached, middle, inner), np.where(reached, outer, middle)
            edge, _ = on_circle(kps, *self._at(inner), -center, radius, 1.0)
            pieces.append((column, np.minimum(lower[column, sample], edge), np.maximum(upper[column, sample], edge)))
        return pieces

    def _narrow_shadows(self, center: float, radius: float) -> tuple[Integers, Floats]:
        """Column and ω of frequencies, between samples, at which the line of all L at one kp comes closest to `center`, within `radius`."""

        def nearness(kp: Floats, a: Complexes, b: Complexes) -> Floats:
            with np.errstate(divide="ignore", invalid="ignore"):
                return -np.abs(((-center + kp * a) * b.conj()).imag) / np.abs(b)

        kps, omega = self.kps, self.omega
        column, point, _ = BoundaryCurve.of(self.plane, center).crossings("kp", kps, True)
        near = nearness(kps[:, None], *(part[None, :] for part in self.responses))
        owner, k = np.nonzero((near[:, 1:-1] >= near[:, :-2]) & (near[:, 1:-1] > near[:, 2:]) & (near[:, 1:-1] < -radius))
        touching, height = self._maximum(nearness, kps[owner], omega[k], omega[k + 1], omega[k + 2])
        owner, touching = owner[height > -radius], touching[height > -radius]
        column, point = np.append(column, owner), np.append(point, touching)
        inside = (point > omega[0]) & (point < omega[-1])
        return column[inside], point[inside]

    def above(self, weight: Callable[[Floats], Floats]) -> list[Floats]:
        """The kd on each line with which x |L/(1 + L)| exceeds 1 at some ω, x = `weight`(ω): as `excluded`.

        These are |1 + L|² < |x L|², a quadratic inequality in kd at every ω: an interval where x < 1, and all but
        an interval, or everything, where x > 1.
        """
        kps = self.kps[:, None]

        def at(omega: Floats) -> tuple[Complexes, Complexes, Floats]:
            return *self._at(omega), weight(omega)

        a, b, x = (part[None, :] for part in at(self.omega))
        lower, upper, inner = _exceeded(kps, a, b, x)
        pieces = []
        for kind, low, high in ((INNER, lower, upper), (OUTER, -np.inf, lower), (OUTER, upper, np.inf), (EVERY, -np.inf, np.inf)):
            column, k = np.nonzero(inner == kind)
            pieces.append((column, np.broadcast_to(low, inner.shape)[column, k], np.broadcast_to(high, inner.shape)[column, k]))
        # From one sample to the next an interval moves and sweeps what lies between.
        column, k = np.nonzero((inner[:, 1:] == INNER) & (inner[:, :-1] == INNER))
        gap = np.minimum(upper[column, k], upper[column, k + 1]), np.maximum(lower[column, k], lower[column, k + 1])
        pieces.append((column[gap[0] < gap[1]], gap[0][gap[0] < gap[1]], gap[1][gap[0] < gap[1]]))
        for kind, side, sign, other in EXTREMES if self.polish else ():

            def farthest(kp: Floats, *found: Any, kind: int = kind, side: int = side, sign: float = sign) -> Floats:
                *ends, which = _exceeded(kp, *found)
                return np.where(which == kind, sign * ends[side], -np.inf)

            end = (lower, upper)[side]
            reach = np.where(inner == kind, sign * end, -np.inf)
            column, k = np.nonzero((reach[:, 1:-1] >= reach[:, :-2]) & (reach[:, 1:-1] > reach[:, 2:]))
            _, height = self._maximum(farthest, self.kps[column], self.omega[k], self.omega[k + 1], self.omega[k + 2], at)
            pieces.append((column, end[column, k + 1] if other is None else np.full(len(column), other), sign * height))
        column, low, high = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
        return union_of(column.astype(int), np.minimum(low, high), np.maximum(low, high), len(self.kps))

    def _maximum(
        self,
        function: Callable[..., Floats],
        kp: Floats,
        low: Floats,
        middle: Floats,
        high: Floats,
        at: Callable[[Floats], tuple[Any, ...]] | None = None,
    ) -> tuple[Floats, Floats]:
        """(ω, value) of the largest function(kp, A, B) in (low, high), by golden section from a first guess; `at`: of other responses.

        The maximum is flat: ω to 1e-5 of the interval gives the value to 1e-10 of its change there.
        """
        at = self._at if at is None else at
        best = function(kp, *at(middle))
        for _ in range(GOLDEN_ROUNDS if len(middle) else 0):
            right = high - middle > middle - low
            trial = middle + 0.381966011250105 * np.where(right, high - middle, low - middle)
            value = function(kp, *at(trial))
            better = value > best
            end = np.where(better, middle, trial)  # a better trial takes the middle's place; otherwise it is the end on its own side
            low, high = np.where(better == right, end, low), np.where(better == right, high, end)
            middle, best = np.where(better, trial, middle), np.where(better, value, best)
        return middle, best

    def at_ends(self, low: float, high: float) -> list[Piece]:
        """kd for which L, real where the frequencies end, lies between `low` and `high`: at ω = 0 (where finite) and at Nyquist."""
        plane, ends = self.plane, []
        if not np.any(plane.a.poles == 0):
            ends.append(0.0)
        if plane.last is not None:
            ends.append(plane.last)
        pieces = []
        for a, b in ((float(plane.a.response(w).real), float(plane.b.response(w).real)) for w in ends):
            column = np.arange(len(self.kps))
            if b == 0:
                column = column[(self.kps * a >= low) & (self.kps * a <= high)]
                pieces.append((column, np.full(len(column), -np.inf), np.full(len(column), np.inf)))
            else:
                pieces.append((column, (low - self.kps * a) / b, (high - self.kps * a) / b))
        return pieces


NONE, INNER, OUTER, EVERY = range(4)
"""Which kd exceed a ceiling at one ω: none, those between two values, those beside them, all."""
EXTREMES = ((INNER, 0, -1.0, None), (INNER, 1, 1.0, None), (OUTER, 0, 1.0, -np.inf), (OUTER, 1, -1.0, np.inf))
"""Ends of such intervals, lower and upper, which way they reach farthest, and the other end; None: where the sample has it."""


def _exceeded(kp: Floats, a: Complexes, b: Complexes, x: Floats) -> tuple[Floats, Floats, Integers]:
    """The two kd with |1 + L| = x |L|, L = kp A + kd B, in rising order, and which kd make it less (NONE to EVERY)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # In y = kd, over |B|²: (1 − x²)(y² + 2 p y + |kp A|²/|B|²) + 2 q y + r
        size = np.abs(b) ** 2
        p, q = kp * (a * b.conj()).real / size, b.real / size
        square = 1 - x**2
        half = square * p + q
        rest = (square * np.abs(kp * a) ** 2 + 2 * kp * a.real + 1) / size
        discriminant = half**2 - square * rest
        root = np.sqrt(np.maximum(discriminant, 0.0))
        far = -(half + np.where(half >= 0, root, -root))  # without cancellation; the other one from their product
        first, second = far / square, rest / far
        lower, upper = np.minimum(first, second), np.maximum(first, second)
        found = np.where(square > 0, np.where(discriminant > 0, INNER, NONE), np.where(discriminant > 0, OUTER, EVERY))
    return lower, upper, np.where(np.isfinite(discriminant) & np.isfinite(x), found, NONE)


def union_of(column: Integers, low: Floats, high: Floats, count: int) -> list[Floats]:
    """Union of intervals [low, high] per column, `count` of them: disjoint sorted intervals (p, 2) each."""
    order = np.lexsort((low, column))
    column, low, high = column[order], low[order], high[order]
    bounds = np.searchsorted(column, np.arange(count + 1))
    result = []
    for m in range(count):
        mine_low, mine_high = low[bounds[m] : bounds[m + 1]], high[bounds[m] : bounds[m + 1]]
        if not len(mine_low):
            result.append(np.empty((0, 2)))
            continue
        reach = np.maximum.accumulate(mine_high)
        fresh = np.append(True, mine_low[1:] > reach[:-1] + 1e-12 * np.abs(reach[:-1]))
        starts = np.flatnonzero(fresh)
        result.append(np.stack([mine_low[starts], reach[np.append(starts[1:] - 1, len(reach) - 1)]], axis=1))
    return result
