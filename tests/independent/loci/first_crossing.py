"""How far a factor, a phase or a delay in all loops may go before the first root crosses the stability boundary.

Each answer is a claim, "stable up to here", so roots are counted on both sides of it. Where loci lie close together (equal legs), the
crossing that is found need not be the first: then the count inside decides, and the first is searched in between.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from gainroom.analysis.boundary import exact_delay
from gainroom.analysis.margin_record import NUDGE, Certificate, End
from gainroom.system.linear.arrays import Booleans, Complexes, Floats, distinct

from .loci import Steps, Sweep
from .resolution import Boundary
from .sampled_curves import height, meets_axis, meets_circle, side


@dataclass(frozen=True)
class Search:
    """How the first root that crosses the boundary is looked for."""

    # Relative distances from a crossing at which samples show on which side of it ±nudge lies: no step is longer than twice its distance.
    towards: Floats = field(default_factory=lambda: np.concatenate([sign * np.geomspace(0.2e-6, 0.03, 14) for sign in (-1, 1)]))
    # where a crossing was not where its neighbours promised
    around: Floats = field(default_factory=lambda: np.linspace(-0.06, 0.06, 121))
    # relative distance within which crossings, interpolated between samples, may change places when polished
    close: float = 0.03
    exact_lag: float = 1e-11  # [rad] of a locus at −1
    tries: int = 12  # crossings that are polished and counted before halving has to do
    polished: float = 1e-3  # relative width of a bracket from which on its crossing is polished
    shares: tuple[float, ...] = (1e-5, 1e-3, 0.1)  # of a bracket that are tried before it is halved
    halvings: int = 50  # of a bracket; more only chase round-off
    leap: float = 1e-3  # by which a bracket from 0 is shortened instead: its end may lie many orders of magnitude below
    looks: int = 2  # times that samples are taken about a crossing that was not found
    dips: int = 8  # rounds of samples about what comes near the unit circle
    exchanges: int = 20  # rounds of samples where loci may have changed places
    apart: float = 3.0  # times their own moves, that two loci have to be apart so that it is known which is which
    equal: float = 1e-7  # of their size: what is nearer is one
    beyond: float = 0.25  # of the span of their places at both ends of a step, that they may have left it by between
    compared: int = 500_000  # distances between loci that are held at a time
    lowest: float = 1e-6  # factors on coupled loops below this count as none
    # likewise, beside an undamped resonance: smaller ones may only show the tilt of the boundary there
    lowest_undamped: float = 1e-3


SEARCH = Search()


class Rough(NamedTuple):
    """A crossing: the number `at` which it happens, ω [rad/s] and the eigenvalue λ of L(jω) there; interpolated, or exact."""

    at: float
    omega: float
    value: complex


@dataclass(frozen=True)
class Family:
    """Loops that differ in one number t: a factor on gains, a phase or a delay in all loops.

    count       t → unstable roots, 0 where the loop is stable
    crossings   → where roots cross the boundary, as far as the present samples show
    polish      exact crossings from such; what leads nowhere is left out
    closer      takes samples at more frequencies
    nearest     t → what is nearest to the boundary there
    mode        of an exact crossing
    apart       (low, high) → takes samples where loci that nearly meet may cross between these t
    """

    count: Callable[[float], int]
    crossings: Callable[[], list[Rough]]
    polish: Callable[[list[Rough]], list[Rough]]
    closer: Callable[[Floats], None]
    nearest: Callable[[float], Rough]
    mode: Callable[[Rough], Complexes]
    apart: Callable[[float, float], None] = lambda low, high: None

    def end(self, start: float, stop: float) -> End | None:
        """The end of the stable interval around `start` on the way to `stop`; None where all of that way is stable.

        Where samples are too few, the certificate does not hold.
        """
        way = math.copysign(1.0, stop - start)
        passed, looked = start, 0
        for _ in range(SEARCH.tries):
            self.apart(*sorted((passed, min((one.at for one in self._ahead(way, passed, stop)), key=lambda at: way * at, default=stop))))
            ahead = self._ahead(way, passed, stop)
            if not ahead:
                break
            nearest = min(ahead, key=lambda one: way * one.at)
            group = [one for one in ahead if abs(one.at - nearest.at) <= SEARCH.close * abs(nearest.at)]
            exact = [one for one in self.polish(group) if way * one.at > way * passed]
            if exact:
                first = min(exact, key=lambda one: way * one.at)
                certificate = self._certified(first, way)
                if certificate.holds:
                    return self._ended(first, certificate)
                if certificate.inside != 0:
                    found = self._between(start, first.at * (1 - way * NUDGE))
                    return found if found.certificate.holds else self._ended(first, certificate)
                passed = way * max(way * first.at * (1 + way * NUDGE), way * passed)  # no root crosses there
            elif looked < SEARCH.looks:
                self.closer(nearest.omega * (1 + SEARCH.around))
                looked += 1
            else:
                passed, looked = way * max(way * one.at for one in group), 0
        return self._between(start, stop) if self.count(stop) != 0 else None

    def _ahead(self, way: float, passed: float, stop: float) -> list[Rough]:
        """Crossings behind `passed` on the way to `stop`."""
        return [one for one in self.crossings() if way * passed < way * one.at <= way * stop]

    def _certified(self, found: Rough, way: float) -> Certificate:
        self.closer(found.omega * (1 + SEARCH.towards))
        inside, outside = (self.count(found.at * (1 + way * side * NUDGE)) for side in (-1, 1))
        return Certificate(inside, outside)

    def _ended(self, found: Rough, certificate: Certificate) -> End:
        return End(found.at, found.omega, self.mode(found), certificate)

    def _between(self, stable: float, unstable: float) -> End:
        """The end by halving; polished as soon as its bracket is narrow."""
        way = math.copysign(1.0, unstable - stable)
        least, done = abs(unstable - stable) * 0.5**SEARCH.halvings, set[Rough]()
        for share in SEARCH.shares:  # mostly the first crossing lies close before the one that was found
            inside = unstable - share * (unstable - stable)
            if self.count(inside) == 0:
                stable = inside
                break
            unstable = inside
        for _ in range(SEARCH.halvings):
            if abs(unstable - stable) <= max(NUDGE * abs(unstable), least):
                break
            low, high = sorted((stable, unstable))
            if high - low < SEARCH.polished * abs(unstable):
                near = sorted(self.crossings(), key=lambda one: abs(one.at - unstable))[: SEARCH.tries]
                fresh = [one for one in near if one not in done]  # the others led elsewhere
                done.update(near)
                for one in self.polish([*fresh, self.nearest(unstable)]):
                    if low <= one.at <= high and (certificate := self._certified(one, way)).holds:
                        return self._ended(one, certificate)
            middle = SEARCH.leap * unstable if stable == 0 else math.sqrt(low * high) if 0 < 4 * low < high else 0.5 * (low + high)
            stable, unstable = (middle, unstable) if self.count(middle) == 0 else (stable, middle)
        found = self.nearest(unstable)._replace(at=0.5 * (stable + unstable))
        return self._ended(found, Certificate(self.count(stable), self.count(unstable)))


def gains(sweep: Sweep) -> Family:
    """All gains times t <= sweep.highest."""

    def polish(group: list[Rough]) -> list[Rough]:
        at_rest = [one for one in group if one.omega == 0]  # toppled, or held, by gravity: known as it stands
        omega, value = sweep.boundary.crossings(*_columns([one for one in group if one.omega > 0]), slope)
        on_axis = (value.real < 0) & (np.abs(value.imag) < 1e-9 * np.abs(value))
        return at_rest + listed(-1 / value.real[on_axis], omega[on_axis], value[on_axis])

    def mode(found: Rough) -> Complexes:
        return sweep.mode_at_rest(found.value) if found.omega == 0 else sweep.boundary.mode(found.omega, found.value)

    def apart(low: float, high: float) -> None:  # in ln: what is lost in round-off is far away
        _told_apart(sweep, side, lambda omega, value: -height(value), math.log(low), math.log(high))

    return Family(sweep.unstable, lambda: _axis_crossings(sweep), polish, sweep.add, lambda t: _nearest(sweep, t, t), mode, apart)


def phases(sweep: Sweep, way: int) -> Family:
    """A lag (`way` 1) or lead (−1) of t [rad] in (0, π] in all loops."""

    def at(omega: Floats, value: Complexes) -> Floats:
        return _lag(value) if way > 0 else 2 * math.pi - _lag(value)

    def nearest(t: float) -> Rough:
        return _nearest(sweep, t, np.exp(-1j * way * t))

    return _on_circle(sweep, lambda t: sweep.unstable(1.0, phase=way * t), at, nearest)


def delays(sweep: Sweep) -> Family:
    """The delay margin's: t [s] more in all loops; sampled ones are sampled anew, so that it is exact for any share of a tick."""

    def at(omega: Floats, value: Complexes) -> Floats:
        return _lag(value) / omega

    if sweep.last is None:
        return _on_circle(sweep, lambda t: sweep.unstable(1.0, delay=t), at, lambda t: _nearest(sweep, t, np.exp(-1j * t * sweep.omega)))

    step = sweep.loop.sample_time
    assert step is not None

    def split(t: float) -> tuple[float, float]:
        """Whole ticks, which are a phase, and the rest, for which the plant is sampled anew [s]."""
        ticks = max(math.floor(t / step), 0) * step
        return ticks, max(t - ticks, 0.0)

    def later(t: float) -> Boundary:
        return Boundary(sweep.loop.delayed(split(t)[1]))

    def turn(t: float, omega: float) -> complex:
        return complex(np.exp(-1j * omega * split(t)[0]))

    def lag(t: float, omega: float) -> tuple[float, float]:
        found = _circle_polished(later(t), [Rough(t, omega, -1 / turn(t, omega))])
        if not len(found[0]):
            return math.nan, omega
        omega = float(found[0][0])
        return float(np.angle(-complex(found[1][0]) * turn(t, omega))), omega

    def polish(group: list[Rough]) -> list[Rough]:
        exact = (exact_delay(lag, one.at, one.omega) for one in _placed(at, *_circle_polished(sweep.boundary, group)))
        return [Rough(*one, -1 / turn(*one)) for one in exact if one is not None]

    @lru_cache(2)
    def delayed(rest: float) -> Sweep:
        return Sweep(sweep.loop.delayed(rest))

    def nearest(t: float) -> Rough:
        ticks, rest = split(t)
        return _nearest(delayed(rest), t, np.exp(-1j * ticks * delayed(rest).omega))

    return Family(
        lambda t: delayed(split(t)[1]).unstable(1.0, delay=split(t)[0]),
        lambda: _placed(at, *_circle_crossings(sweep)),
        polish,
        lambda omega: None,
        nearest,
        lambda found: later(found.at).mode(found.omega, found.value),
        lambda low, high: _told_apart(sweep, height, at, low, high),
    )


def _on_circle(sweep: Sweep, count: Callable[[float], int], at: "At", nearest: Callable[[float], Rough]) -> Family:
    """A family whose roots cross where loci of L lie on the unit circle."""
    return Family(
        count,
        lambda: _placed(at, *_circle_crossings(sweep)),
        lambda group: _placed(at, *_circle_polished(sweep.boundary, group)),
        sweep.add,
        nearest,
        lambda found: sweep.boundary.mode(found.omega, found.value),
        lambda low, high: _told_apart(sweep, height, at, low, high),
    )


At = Callable[[Floats, Complexes], Floats]
"""ω and λ, on the unit circle, → the number at which λ is turned to −1."""


def _placed(at: At, omega: Floats, value: Complexes) -> list[Rough]:
    return listed(at(omega, value), omega, value)


def listed(at: Floats, omega: Floats, value: Complexes) -> list[Rough]:
    """Columns as crossings."""
    return [Rough(*one) for one in zip(at.tolist(), omega.tolist(), value.tolist(), strict=True)]


def _columns(group: list[Rough]) -> tuple[Floats, Complexes]:
    return np.array([one.omega for one in group]), np.array([one.value for one in group], dtype=complex)


def slope(value: Complexes) -> Floats:
    """Zero where λ is real; steep enough for secants however small λ is; on the imaginary axis as large as beside it, not infinite."""
    real = np.where(value.real == 0, np.finfo(float).eps * np.abs(value.imag), value.real)
    return np.divide(value.imag, real, out=np.zeros(len(value)), where=real != 0)


def _lag(value: Complexes) -> Floats:
    """The lag [rad] in [0, 2π) that turns λ on the unit circle to −1."""
    return (np.angle(value) + math.pi) % (2 * math.pi)


def _nearest(sweep: Sweep, at: float, factor: float | Complexes) -> Rough:
    """The sampled locus that comes nearest to −1 once it is multiplied by `factor`, a number or (k,)."""
    away = np.abs(1 + np.reshape(factor, (-1, 1)) * sweep.loci)
    row, branch = np.unravel_index(np.argmin(away), away.shape)
    return Rough(at, float(sweep.omega[row]), complex(sweep.loci[row, branch]))


def _told_apart(sweep: Sweep, off: Callable[[Complexes], Floats], at: "At", low: float, high: float) -> None:
    """Samples where loci of equal limbs nearly meet, about a line: between two each may take the other's way, and cross it more often.

    off, at   (k, r) how far each of λ (k, r) is from the line, with the sign of its side; the number at which it would cross, at ω (k,)
    low, high    of that number: what crosses elsewhere does not matter
    """
    rows = np.arange(len(sweep.omega) - 1)
    for _ in range(SEARCH.exchanges):
        steps, omega = sweep.steps(rows), sweep.omega[rows]
        ends = [(off(value), at(place[:, None], value)) for place, value in ((omega, steps.start), (sweep.omega[rows + 1], steps.end))]
        rows = rows[_may_exchange(steps, *zip(*ends, strict=True), low, high)]
        rows = rows[sweep.omega[rows + 1] - sweep.omega[rows] > NUDGE * sweep.omega[rows + 1]]
        if not len(rows) or sweep.full:
            break
        middle = 0.5 * (sweep.omega[rows] + sweep.omega[rows + 1])
        sweep.add(middle)
        right = np.searchsorted(sweep.omega, middle)
        rows = distinct(np.concatenate([right - 1, right]))


def _may_exchange(steps: Steps, off: tuple[Floats, Floats], at: tuple[Floats, Floats], low: float, high: float) -> Booleans:
    """(k,) where two loci, `off` the line (k, r) at both ends of a step, are nearer to each other's next places than is clear."""
    moves = np.abs(off[1] - off[0]).max(axis=1, initial=0.0)
    near = np.minimum(np.abs(off[0]), np.abs(off[1])) <= SEARCH.apart * moves[:, None]
    rows = np.flatnonzero(np.count_nonzero(near, axis=1) > 1)
    found = np.zeros(len(near), dtype=bool)
    first, second = np.triu_indices(near.shape[1], 1)
    for some in np.array_split(rows, len(rows) * len(first) // SEARCH.compared + 1):
        spans = []  # of the line, and of the number: as far as the four reach, and a part of it beyond
        for ends in (off, at):
            four = [end[some][:, pair] for end in ends for pair in (first, second)]
            first_one, last_one = np.minimum.reduce(four), np.maximum.reduce(four)
            beyond = SEARCH.beyond * (last_one - first_one)
            spans.append((first_one - beyond, last_one + beyond))
        (least, most), (soon, late) = spans
        places, pairs = np.nonzero((least < 0) & (most > 0) & (soon < high) & (late > low))
        a, b, c, d = (each[some[places], pair[pairs]] for each in (steps.start, steps.end) for pair in (first, second))
        straight, swapped = np.abs(c - a) + np.abs(d - b), np.abs(d - a) + np.abs(c - b)
        apart = np.maximum(np.abs(a - b), np.abs(c - d)) > SEARCH.equal * np.abs(a)
        found[some[places[apart & (swapped < SEARCH.apart * straight)]]] = True
    return found


def _axis_crossings(sweep: Sweep) -> list[Rough]:
    """Crossings of the negative real axis by all loci."""
    steps = sweep.steps()
    rows, _, share, value = meets_axis(steps.start, steps.end)
    omega = sweep.omega[rows] + share * (sweep.omega[rows + 1] - sweep.omega[rows])
    at_rest = sweep.at_rest()
    values, places = [value, at_rest], [omega, np.zeros(len(at_rest))]
    if sweep.last is not None:
        at_end = sweep.loci[-1][np.abs(sweep.loci[-1].imag) < 1e-9 * np.abs(sweep.loci[-1])].real
        values.append(at_end)
        places.append(np.full(len(at_end), sweep.last))
    value, omega = np.concatenate(values), np.concatenate(places)
    reached = (value < -1 / sweep.highest) & (value > -1 / (SEARCH.lowest_undamped if sweep.undamped else SEARCH.lowest))
    return listed(-1 / value[reached], omega[reached], value[reached].astype(complex))


def _circle_crossings(sweep: Sweep) -> tuple[Floats, Complexes]:
    """ω and λ of the crossings of the unit circle by all loci, interpolated."""
    steps = sweep.steps()
    for _ in range(SEARCH.dips):  # a resonance may rise above the circle, or dip below it, between two samples
        low, high = height(steps.start), height(steps.end)
        move = np.maximum(np.abs(high - low), np.abs(np.angle(steps.end * steps.start.conj())))
        near = np.minimum(np.abs(low), np.abs(high))
        rough = np.any((near < 2 * move) & (move > 0.1), axis=1) & (np.diff(sweep.omega) > 1e-6 * sweep.omega[1:])
        if not rough.any() or sweep.full:
            break
        sweep.add(0.5 * (sweep.omega[:-1] + sweep.omega[1:])[rough])
        steps = sweep.steps()
    sweep.show_crossings(height)
    steps = sweep.steps()
    rows, _, share, lag = meets_circle(steps.start, steps.end)
    return sweep.omega[rows] * (sweep.omega[rows + 1] / sweep.omega[rows]) ** share, -np.exp(1j * lag)


def _circle_polished(boundary: Boundary, group: list[Rough]) -> tuple[Floats, Complexes]:
    omega, value = boundary.crossings(*_columns(group), height)
    reached = np.abs(np.abs(value) - 1) < 1e-9
    return omega[reached], value[reached]
