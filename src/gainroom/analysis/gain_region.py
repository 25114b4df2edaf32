"""The region of PD gains that are stable and keep the required margins: exact membership, boundary, largest gains.

On each line kp = const the crossings of the stability curve (gain_plane.py) and the intervals that margins exclude (excluded_region.py) are
known to machine precision. Between crossings the number of unstable roots is constant; it is counted once (Nyquist) and then carried
across each crossing by the direction in which its root moves, once per cell, not once per point.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_finite
from ..system.assembly import Parts
from ..system.controller import PD, Controller, Terms
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.feedback import GivenFeedback
from ..system.linear.arrays import Booleans, Floats, Integers
from ..system.linear.state_space import StateSpace
from ..system.linear.transfer_function import Factored
from ..system.loop import Loop, build_loop
from ..system.measured_response import Sensed, measured_signals
from ..system.plant import Plant
from ..system.requirement import Requirement
from ..system.requirements import Requirements
from .crossings import scan
from .excluded_region import Lines
from .gain_plane import BoundaryCurve, GainPlane
from .margin_record import Margins
from .margins import margins_from_scan

SAMPLED = 24  # gains tried in each interval of kd for a requirement without an excluded set
INSIDE = 1e-6  # share of an interval by which the first and last of these are off its ends, which other requirements or stability set
BETWEEN, NARROWED = 5, 4  # gains tried between two of these where it is missed least, and how often: each narrows them to a third
HALVED, FEW_HALVED = 20, 10  # halvings between neighbouring samples: polished, to 1e-6 of their distance, and for a first search
RUNGS, RUNGS_PER_DECADE = 121, 5  # values of kp: at least, and per decade of a boundary that slow poles spread over many
FEW_TURNS = 10.0  # [rad] largest phase ωT of the delay at gains chosen for a root count


def pd_region(
    joint: ElasticJoint | Plant,
    drive: Drive,
    gain_margin: float | None = None,
    phase_margin: float | None = None,
    peak_sensitivity: float | None = None,
    feedback: GivenFeedback = "motor",
    sample_time: float | None = None,
    controller: Any = None,
    **others: Any,
) -> "PDRegion":
    """The gains (kp, kd) of one joint that are stable and keep every margin asked for (factor; rad; factor).

    controller   a PD, PID or PPI whose filters and integral ratio are kept while kp and kd vary; None: plain PD
    others       further requirements by name, SI (system/requirements.py)
    """
    template = PD(1.0, 1.0) if controller is None else controller
    if not getattr(template, "has_plane", False):
        raise GainroomError(f"pd_region: controller {type(template).__name__} must be a PD, PID or PPI")
    loop = build_loop(joint, drive, template, feedback, sample_time)
    actuated = loop.sensed or loop.actuated
    if actuated is None:
        raise GainroomError(f"pd_region is for one joint, not for {loop.size}")
    return PDRegion(actuated, template, Requirements(gain_margin, phase_margin, peak_sensitivity, **others), loop.unsampled, loop.parts)


@dataclass(frozen=True)
class PDRegion:
    """Region of one joint's PD gains, see pd_region. `template` gives the controller at (kp, kd).

    actuated    loop without its controller: response to the measured position, or those to both where gains measure both sides
    unsampled   `actuated` in continuous time; None where it is not known
    parts       components of the loop, by which its link is known; None where they are not
    """

    actuated: Factored | Sensed
    template: Controller
    required: Requirements
    unsampled: Factored | None = None
    parts: Parts | None = None

    def scalar(self, kp: float, kd: float) -> Factored:
        """Return ratio L at one pair of gains."""
        return self._returned(self.template.plane_terms(kp, kd))

    def _returned(self, terms: Terms) -> Factored:
        """Return ratio of `terms` of gains with the filters of `template`."""
        if isinstance(self.actuated, Sensed):
            return self.actuated.under(self.template, terms)
        return self.actuated * self.template.combine(terms, self.actuated.sample_time)

    def columns(self, kps: ArrayLike) -> list[Floats]:
        """For each kp (m,): the allowed kd as open intervals (p, 2), sorted; ends may be ±inf."""
        kps = np.atleast_1d(np.asarray(kps, dtype=float))
        free = self.stable_columns(kps)
        return self.excluding(self.required, kps, free)

    def excluding(self, required: Requirements, kps: Floats, free: list[Floats], polish: bool = True) -> list[Floats]:
        """`free`, intervals of kd for each kp, without what `required` excludes."""
        free, kps = list(free), np.asarray(kps)
        for one, needed in sorted(required.asked_for, key=lambda pair: not pair[0].in_closed_form(pair[1])):
            filled = [m for m, intervals in enumerate(free) if len(intervals)]
            if filled and not one.in_closed_form(needed):
                kept = self._where(partial(self._shortfalls, one, needed), kps[filled], [free[m] for m in filled], polish)
                for m, intervals in zip(filled, kept, strict=True):
                    free[m] = intervals
            elif filled:
                window = np.array([[free[m][0, 0], free[m][-1, 1]] for m in filled])
                lines = Lines(self._plane, self._curve.omega, kps[filled], window, polish)
                shape = one.excluded(needed)
                walls = lines.excluded(shape) if shape is not None else lines.above(one.weight(needed, self.actuated, self.unsampled))
                for m, wall in zip(filled, walls, strict=True):
                    free[m] = without(free[m], wall)
        return free

    def _shortfalls(self, one: Requirement, needed: float, kps: Floats, kds: Floats) -> Floats:
        """Shortfalls (m,) of stable gains kps and kds (m,) against the requirement `one`; 0 or less: they meet it."""
        values = None
        if one.is_measured:
            if one.name not in self._measures:
                (loop,), step = self.loops(1.0, 1.0), self.actuated.sample_time
                parts = (self.template.combine(terms, step) for terms in self.template.plane())
                self._measures[one.name] = one.in_plane(loop, *parts)
            if (together := self._measures[one.name]) is not None:
                values = together(kps, kds).tolist()
        if values is None:
            values = [one.value(found) for found in self.margins(kps, kds)]
        short = [one.shortfall(needed, value) for value in values]
        return np.array([min(by, 0.0) if one.met(needed, value) else by for value, by in zip(values, short, strict=True)])

    def _where(self, missed: Callable[[Floats, Floats], Floats], kps: Floats, free: list[Floats], polish: bool) -> list[Floats]:
        """The parts of `free`, stable intervals (p, 2) of kd for each of `kps` (m,), in which `missed`(kp, kd) is 0 or less.

        It is worked out at SAMPLED gains in each interval, and where it is least in between. Where neighbours differ, the end between them
        is halved to.
        """
        intervals, line = np.concatenate(free), np.repeat(np.arange(len(free)), [len(some) for some in free])
        kps = kps[line]
        kds = np.array([self._samples(*interval) for interval in intervals.tolist()])
        short = missed(np.repeat(kps, SAMPLED), kds.ravel()).reshape(kds.shape)
        self._to_the_least(missed, kps, kds, short)
        inside = short <= 0
        row, k = np.nonzero(inside[:, 1:] != inside[:, :-1])
        good, bad = np.where(inside[row, k], kds[row, k], kds[row, k + 1]), np.where(inside[row, k], kds[row, k + 1], kds[row, k])
        for _ in range((HALVED if polish else FEW_HALVED) if len(row) else 0):
            middle = 0.5 * (good + bad)
            still = missed(kps[row], middle) <= 0
            good, bad = np.where(still, middle, good), np.where(still, bad, middle)
        first, last = np.flatnonzero(inside[:, 0]), np.flatnonzero(inside[:, -1])
        ends, of = np.concatenate([good, intervals[first, 0], intervals[last, 1]]), np.concatenate([row, first, last])
        order = np.lexsort((ends, of))
        ends, of = ends[order].reshape(-1, 2), line[of[order]][::2]
        return [ends[of == m] for m in range(len(free))]

    @staticmethod
    def _to_the_least(missed: Callable[[Floats, Floats], Floats], kps: Floats, kds: Floats, short: Floats) -> None:
        """Move samples kds (p, SAMPLED) that are missed and less so than their neighbours to where `short` is least between these."""
        row, k = np.nonzero((short[:, 1:-1] > 0) & (short[:, 1:-1] < short[:, :-2]) & (short[:, 1:-1] <= short[:, 2:]))
        k = k + 1
        low, high, every = kds[row, k - 1], kds[row, k + 1], np.arange(len(row))
        for _ in range(NARROWED if len(row) else 0):
            trials = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, BETWEEN + 2)
            values = np.full(trials.shape, np.inf)
            values[:, 1:-1] = missed(np.repeat(kps[row], BETWEEN), trials[:, 1:-1].ravel()).reshape(-1, BETWEEN)
            best = values.argmin(axis=1)
            low, high = trials[every, np.maximum(best - 1, 0)], trials[every, np.minimum(best + 1, BETWEEN + 1)]
            found = values[every, best]
            lower = found < short[row, k]
            kds[row[lower], k[lower]], short[row[lower], k[lower]] = trials[every, best][lower], found[lower]

    def _samples(self, low: float, high: float) -> Floats:
        """SAMPLED kd within an interval, closer together near its ends; without an end as far as the stability boundary goes."""
        _, reached = self._curve.along("kd")
        farthest = 2 * float(np.max(np.abs(reached[np.isfinite(reached)]), initial=1.0))
        low, high = max(low, min(-farthest, high - farthest)), min(high, max(farthest, low + farthest))
        return low + (high - low) * np.clip(0.5 * (1 - np.cos(np.linspace(0, math.pi, SAMPLED))), INSIDE, 1 - INSIDE)

    def margins(self, kp: ArrayLike, kd: ArrayLike) -> list[Margins]:
        """The margins at each pair of gains; kp and kd broadcast."""
        return [margins_from_scan(loop, scan(loop.scalar)) for loop in self.loops(kp, kd) if loop.scalar is not None]

    def loops(self, kp: ArrayLike, kd: ArrayLike) -> list[Loop]:
        """The loop at each pair of gains; kp and kd broadcast."""
        kps, kds = (part.ravel().tolist() for part in np.broadcast_arrays(kp, kd))
        step, loops = self.actuated.sample_time, []
        for gains in zip(kps, kds, strict=True):
            parts = None if self.parts is None else replace(self.parts, controller=self.template.from_plane(*gains))
            known: dict[str, Any] = {"parts": parts, "resolution": None if parts is None else parts.resolution}
            if isinstance(self.actuated, Sensed):
                loop = Loop(1, step, unstable_poles=self.scalar(*gains).unstable_poles, sensed=self.actuated, **known)
            else:
                control = self.template.in_plane(*gains, step)
                unstable = (self.actuated * control).unstable_poles
                loop = Loop(1, step, self.actuated, control, unstable_poles=unstable, unsampled=self.unsampled, **known)
            loops.append(loop if parts is None else loop.with_signals(self._signals))
        return loops

    @cached_property
    def _measures(self) -> dict[str, Callable[[Floats, Floats], Floats] | None]:
        """Functions (kps, kds) → values of requirements that are computed from the loop itself, by name; None: computed loop by loop."""
        return {}

    @cached_property
    def _signals(self) -> StateSpace:
        """State space from torque command to the signals that the controller gets; computed once for all gains."""
        assert self.parts is not None
        return measured_signals(self.parts)

    def stable_columns(self, kps: Floats, polish: bool = True) -> list[Floats]:
        """Intervals of kd (p, 2) with which the loop is stable, one array per kp of `kps` (m,), sorted; no margin is required."""
        index, kd, change = self._crossings("kp", kps, polish)
        order = np.lexsort((kd, index))
        index, kd, change = index[order], kd[order], change[order]
        # Line m's crossings are first[m] to first[m + 1]; its intervals, one more than crossings, begin at first[m] + m.
        first = np.searchsorted(index, np.arange(len(kps) + 1))
        total = np.append(0, np.cumsum(change))
        below = self._row.counts(kps) - np.bincount(index, change * (kd < self._row.kd), len(kps))  # unstable roots where kd → −∞
        start, inner = first + np.arange(len(kps) + 1), np.arange(len(kd)) + index + 1
        low, high, unstable = np.full(start[-1], -np.inf), np.full(start[-1], np.inf), np.repeat(below, np.diff(start))
        low[inner], high[inner - 1] = kd, kd
        unstable[inner] += total[1:] - total[first[index]]
        reached = (kps >= self._reach[0]) & (kps <= self._reach[1])
        free = (unstable == 0) & (high > low) & np.repeat(reached, np.diff(start))
        intervals, ends = np.stack([low, high], axis=1)[free], np.append(0, np.cumsum(free))[start]
        return [intervals[ends[m] : ends[m + 1]] for m in range(len(kps))]

    def contains(self, kp: ArrayLike, kd: ArrayLike) -> Booleans:
        """True where the gains are allowed; kp and kd broadcast."""
        given, kd = require_finite("region", "kp", kp), require_finite("region", "kd", kd)
        values, line = np.unique(given, return_inverse=True)
        line, kd = np.broadcast_arrays(line.reshape(np.shape(given)), kd)
        lines = line.ravel()
        order = slice(None) if np.all(lines[1:] >= lines[:-1]) else np.argsort(lines, kind="stable")  # line by line
        ranked, bounds = kd.ravel()[order], np.searchsorted(lines[order], np.arange(len(values) + 1))
        found, inside = np.zeros(len(ranked), dtype=bool), np.zeros(len(ranked), dtype=bool)
        for m, intervals in enumerate(self.columns(values)):
            mine, ends = slice(bounds[m], bounds[m + 1]), intervals.ravel()
            below, not_above = (ends.searchsorted(ranked[mine], side) for side in ("left", "right"))
            found[mine] = (below & 1 == 1) & (below == not_above)  # inside an interval, on no end
        inside[order] = found
        return inside.reshape(kd.shape)

    def max_kd(self, kp: ArrayLike) -> Any:
        """The largest allowed kd for each kp; NaN where none is allowed. A float for a single kp."""
        tops = np.array([intervals[-1, 1] if len(intervals) else np.nan for intervals in self.columns(kp)])
        return float(tops[0]) if np.ndim(kp) == 0 else tops.reshape(np.shape(kp))

    def max_kp(self) -> float:
        """The largest allowed kp over all kd; NaN where no gains are allowed."""
        return self._top

    @cached_property
    def boundary(self) -> tuple[Floats, ...]:
        """Closed polylines (m, 2), columns kp and kd, around every connected part; an unbounded part is cut off at a large kd."""
        low, high = self._bottom, self._top
        if math.isnan(low):
            return ()
        low, high = max(low, self.ladder[0] if low < 0 else 0.0), min(high, self.ladder[-1])
        spread = 0.5 * (1 - np.cos(np.linspace(0, math.pi, 161)))
        kps = low + (high - low) * np.clip(spread, 1e-9, 1 - 1e-9)
        return traced(kps, self.columns(kps))

    @cached_property
    def _plane(self) -> GainPlane:
        return GainPlane.of(*map(self._returned, self.template.plane()))

    @cached_property
    def _curve(self) -> BoundaryCurve:
        return BoundaryCurve.of(self._plane, -1.0)

    def _crossings(self, axis: str, values: Floats, polish: bool = True) -> tuple[Integers, Floats, Integers]:
        """Crossings of the stability boundary with lines: (index into values, other gain, change of the unstable count as it grows)."""
        index, omega, other = self._curve.crossings(axis, values, polish)
        size = np.full(len(omega), 2)
        if self._plane.last is not None:
            a, b = (float(part.response(self._plane.last).real) for part in (self._plane.a, self._plane.b))
            here, there = (a, b) if axis == "kp" else (b, a)
            if there != 0:
                index = np.append(index, np.arange(len(values)))
                omega = np.append(omega, np.full(len(values), self._plane.last))
                other = np.append(other, (-1 - values * here) / there)
                size = np.append(size, np.ones(len(values), dtype=int))
        kp, kd = (values[index], other) if axis == "kp" else (other, values[index])
        a, da, b, db, _, turn = self._plane.lines(-1.0, omega)
        # ds/d(gain) = −A/(dL/ds) and dL/ds = −j dL/dω; the real part says which way the root moves. Both over what A and B share.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            moving = (b if axis == "kp" else a) / (kp * da + kd * db - turn)
        return index, other, size * np.sign(moving.imag).astype(int)

    @cached_property
    def _row(self) -> "_Row":
        """Numbers of unstable roots along a line kd = const: counted once on either side of the static line, changed at each crossing."""
        # Few turns of the delay: far out along the curve lie gains with thousands of unstable roots, which rounding and the grid blur.
        near = np.isfinite(self._curve.kd) & (self._curve.omega * self.actuated.delay < FEW_TURNS)
        finite = np.sort(np.abs(self._curve.kd[near]))  # np.median would load masked arrays, a tenth of a short command's time
        kd = 1.0371 * float(finite[len(finite) // 2]) if len(finite) else 1.0  # no symmetric case has a crossing just there
        kd = kd or 1.0  # a curve that lies on kd = 0 altogether: rigid, and nothing rolls off
        _, events, change = self._crossings("kd", np.array([kd]))
        order = np.argsort(events)
        static = 0.0
        if not np.any(self._plane.a.poles == 0):  # a root at s = 0 where kp A(0) = −1
            static = -1 / float(self._plane.a.response(0.0).real)
        events, total = events[order], np.append(0, np.cumsum(change[order]))
        # Halfway to the first crossing on either side: next to kp = 0 the controller's own zeros lie on the boundary but for round-off.
        unlimited = math.sqrt(self.ladder[self.ladder > 0][0] * self.ladder[-1])
        left, right = static - events[events < static][-1:], events[events > static][:1] - static
        counted = static - 0.5 * float(min(left, default=unlimited)), static + 0.5 * float(min(right, default=unlimited))
        return _Row(kd, events, total, static, counted, (self._count(counted[0], kd), self._count(counted[1], kd)))

    def _count(self, kp: float, kd: float) -> int:
        """Number of unstable roots at (kp, kd), by the Nyquist count of the certified scan."""
        system = self.scalar(kp, kd)
        return round(system.unstable_poles - scan(system, with_peaks=False).half_turns)

    @cached_property
    def _top(self) -> float:
        """Largest allowed kp; inf where no kp on the ladder is too large, NaN where none is allowed."""
        last = self._outermost(self.ladder)
        return math.inf if last == self.ladder[-1] else last

    @cached_property
    def _bottom(self) -> float:
        """Smallest allowed kp; 0 or −inf where every lower one on the ladder is allowed."""
        first = self._outermost(self.ladder[::-1])
        return first if first != self.ladder[0] else 0.0 if first > 0 else -math.inf

    @cached_property
    def ladder(self) -> Floats:
        """kp over all orders of magnitude at which the stability boundary lives, negative ones first."""
        upward = self._rungs(1.0)
        if np.any(self._plane.a.poles == 0):  # with an integrator no kp < 0 is stable
            return upward
        return np.concatenate([-self._rungs(-1.0)[::-1], upward])

    def _rungs(self, sign: float) -> Floats:
        """Sizes |kp|, rising, of one `sign`, from far below the stability boundary to just beyond its end."""
        omega, kp = self._curve.along("kp")
        sizes = np.where(omega >= self._plane.resolved, sign * kp, 0.0)
        if not np.any(sizes > 0):
            sizes = np.abs(sizes)
        sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
        lowest, highest = float(sizes.min(initial=1.0)), float(sizes.max(initial=0.0)) or 1.0
        lowest *= 1e-3
        rungs = np.geomspace(lowest, 0.99 * highest, max(RUNGS, round(RUNGS_PER_DECADE * math.log10(highest / lowest))))
        unlimited = self._plane.last is None and highest == sizes[-1]
        return rungs if unlimited else np.append(rungs, 1.01 * highest)

    @cached_property
    def _reach(self) -> tuple[float, float]:
        """Lowest and highest kp of which the unstable roots are known: beyond, nothing is allowed.

        The stability boundary must reach there, and with a delay, which brings roots at every height, no root along the row may have
        crossed above the highest ω looked at: |kp A + kd B| < 1 from there on.
        """
        _, kp = self._curve.along("kp")
        kp = kp[np.isfinite(kp)]
        most = math.inf
        if self.actuated.delay > 0 and self._plane.last is None:
            a, b = (float(abs(part.response(self._plane.omega[-1]))) for part in (self._plane.a, self._plane.b))
            most = max(1 - abs(self._row.kd) * b, 0.0) / a
        return max(float(kp.min(initial=0.0)), -most), min(float(kp.max(initial=0.0)), most)

    def _outermost(self, ladder: Floats) -> float:
        """The last allowed kp along `ladder`, to machine precision: between a filled column and the empty ones beyond."""
        filled = np.flatnonzero([len(intervals) > 0 for intervals in self.columns(ladder)])
        if not len(filled):
            return math.nan
        if filled[-1] == len(ladder) - 1:
            return float(ladder[-1])
        inside, outside = ladder[filled[-1]], ladder[filled[-1] + 1]
        while abs(outside - inside) > 1e-12 * abs(inside):
            trial = np.linspace(inside, outside, 14)[1:-1]
            empty = np.flatnonzero([not len(intervals) for intervals in self.columns(trial)])
            place = int(empty[0]) if len(empty) else len(trial)
            inside, outside = (trial[place - 1] if place else inside), (trial[place] if place < len(trial) else outside)
        return float(inside)


@dataclass(frozen=True)
class _Row:
    """Numbers of unstable roots along kd = const: crossings `events` in kp, `total` of changes up to each, counts beside `static`."""

    kd: float
    events: Floats
    total: Integers
    static: float
    counted: tuple[float, float]
    base: tuple[int, int]

    def counts(self, kps: Floats) -> Integers:
        """Numbers of unstable roots at each kp."""
        level = self.total[np.searchsorted(self.events, kps)]
        start = self.total[np.searchsorted(self.events, self.counted)]
        right = self.base[1] + level - start[1]
        return np.where(kps > self.static, right, np.where(kps < self.static, self.base[0] + level - start[0], 1))


def without(free: Floats, excluded: Floats) -> Floats:
    """`free` minus `excluded`, both disjoint sorted intervals (p, 2)."""
    pieces = []
    for low, high in free:
        for start, end in excluded[(excluded[:, 1] > low) & (excluded[:, 0] < high)]:
            if start > low:
                pieces.append((low, start))
            low = max(low, end)
        if high > low:
            pieces.append((low, high))
    return np.array(pieces).reshape(-1, 2)


def traced(kps: Floats, columns: list[Floats]) -> tuple[Floats, ...]:
    """Closed outlines from intervals on successive lines, linked one to one where they overlap, and slanted strips by their order."""
    finished: list[list[tuple[float, float, float]]] = []
    active: list[list[tuple[float, float, float]]] = []
    ceiling = 2 * max((float(np.abs(c[np.isfinite(c)]).max(initial=0.0)) for c in columns), default=1.0) or 1.0
    for kp, intervals in zip(kps, columns, strict=True):
        intervals = np.clip(intervals, -ceiling, ceiling)
        links = _links([chain[-1][1:] for chain in active], intervals)
        finished += [chain for j, chain in enumerate(active) if j not in links.values()]
        following = []
        for k, (low, high) in enumerate(intervals):
            chain = active[links[k]] if k in links else []
            chain.append((kp, low, high))
            following.append(chain)
        active = following
    outlines = []
    for chain in finished + active:
        table = np.array(chain)
        forth, back = table[:, [0, 1]], table[::-1][:, [0, 2]]
        outlines.append(np.vstack([forth, back, forth[:1]]))
    return tuple(outlines)


def _links(before: list[tuple[float, float]], after: Floats) -> dict[int, int]:
    """Index of the interval of the column before that each interval of a column continues: {index after: index before}."""
    over = np.array([[low < end and high > start for start, end in before] for low, high in after]).reshape(len(after), len(before))
    links = {k: int(np.argmax(over[k])) for k in range(len(after)) if over[k].sum() == 1 and over[:, np.argmax(over[k])].sum() == 1}
    loose_after, loose_before = np.flatnonzero(~over.any(axis=1)), np.flatnonzero(~over.any(axis=0))
    if len(loose_after) == len(loose_before):
        links.update(zip(loose_after.tolist(), loose_before.tolist(), strict=True))
    return links
