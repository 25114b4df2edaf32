"""Boundary curves in the plane of two gains (D-decomposition).

With L = kp A + kd B, where A and B do not depend on the gains, L(jω) = target is two real equations linear in (kp, kd): one point per ω.
target = −1 bounds the stable gains; −1/g and −g bound a gain margin, −e^{±jφ} a phase margin. (Neimark 1949; Ackermann 2002, ch. 4.)
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..system.linear.arrays import Booleans, Complexes, Floats, Integers, distinct
from ..system.linear.transfer_function import Factored, growth

POINTS_PER_DECADE = 120
MOST_TURNS = 20_000  # samples that follow the delay's phase
DEEPEST = 1e-9  # the curve is followed down to this share of the lowest frequency sampled finely
GAIN_ROUNDING = 4e-15  # relative round-off of a gain that solves L = target: nearer to the target, ω cannot be told apart
UNRESOLVED = 2e-9  # relative distance of zeros between which no sample lies
PINCH = 1e-9  # relative distance from a pinch within which the curve is taken as the straight line it is there
LineCrossings = tuple[Integers, Floats, Floats]  # index of the value crossed, ω [rad/s], the other gain there
SMALL_TURN = 0.12  # [rad] largest turn of a curve, drawn to scale, between neighbouring samples


@dataclass(frozen=True)
class GainPlane:
    """Plane of two gains, L = kp A + kd B: the responses A and B on a grid of ω that resolves them.

    omega   (k,) rising [rad/s]
    last    the Nyquist frequency, or None in continuous time
    resolved  ω from which the grid is fine; below, a few points follow the curve into the origin
    pinches   (p,) ω at which A and B have the same phase, as at the bandwidth of a second-order velocity filter: the curve runs through
              infinity there along the line kp + kd B/A = target/A, the straighter the less damping turns A
    curves  those drawn so far, by target
    """

    a: Factored
    b: Factored
    omega: Floats
    last: float | None
    resolved: float
    pinches: Floats
    curves: dict[complex, "BoundaryCurve"] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def zeros(self) -> list[tuple[float, tuple[complex, complex], tuple[complex, complex]]]:
        """(ω₀, A's, B's) at the zeros on the boundary that A and B share, each one simple: A/(ω − ω₀) there, and its derivative by ω.

        Two between the same samples, as of two notches of depth 0, are none: the curve comes back from infinity where it went.
        """
        found = []
        for root in self.a.zeros[(growth(self.a.zeros, self.a.sample_time) == 0) & (self.a.zeros.imag > 0)]:
            if _is_simple(root, self.a) and _is_simple(root, self.b):
                omega = _frequency(root, self.a.sample_time)
                found.append((omega, *(_divided(part, root, omega) for part in (self.a, self.b))))
        return found

    @classmethod
    def of(cls, a: Factored, b: Factored) -> "GainPlane":
        """A grid from well below every root to where both gains must exceed anything of interest."""
        roots = np.abs(np.concatenate([a.zeros, a.poles, b.zeros, b.poles]))
        roots = roots[roots > 0]
        if a.sample_time is None:
            slowest = min(roots.min(initial=np.inf), 1 / a.delay if a.delay else np.inf)
            fastest = max(roots.max(initial=0.0), 1 / a.delay if a.delay else 0.0)
            slowest, fastest = (slowest, fastest) if fastest else (1.0, 1.0)
            last, high = None, _horizon(a, slowest, fastest)
        else:
            last = math.pi / a.sample_time
            slowest, high = min(roots.min(initial=np.inf), last), last * (1 - 1e-9)
        low = resolved = 1e-3 * slowest
        grid = [np.geomspace(low, high, max(2, round(POINTS_PER_DECADE * math.log10(high / low))))]
        low = DEEPEST * low  # below the corners integrators dominate: the curve is straight into the origin, and a few points serve
        grid.append(np.geomspace(low, grid[0][0], 110))
        _, own_a, own_b = _apart(a, b)
        sharp = np.concatenate([a.zeros, a.poles, own_b.zeros])  # zeros of B alone: of the other encoder's position
        for root in sharp:  # resonances are sampled on their own scale
            center = _frequency(root, a.sample_time)
            if center > 0 and root.imag > 0:
                width = max(abs(_damping(root, a.sample_time)), 1e-9 * center)
                grid.append(center + width * np.sinh(np.linspace(-12, 12, 97)))
        if a.delay:
            count = min(math.ceil((high - low) * a.delay / 0.2), MOST_TURNS)
            grid.append(np.linspace(low, low + 0.2 / a.delay * count, count, endpoint=False))
        omega = distinct(np.concatenate(grid))
        for root in sharp:  # an undamped resonance is stepped over
            omega = omega[np.abs(omega - _frequency(root, a.sample_time)) > 1e-9 * omega]
        omega = omega[(omega >= low) & (omega <= high)]
        pinches = _pinches(own_a, own_b, omega)
        steps = np.append(-np.geomspace(1e-2, PINCH, 60), np.geomspace(PINCH, 1e-2, 60))
        around = (pinches[:, None] * (1 + steps)).ravel()
        clear = np.all(np.abs(omega[:, None] - pinches) > PINCH * pinches, axis=1)
        omega = distinct(np.append(omega[clear], around[(around > low) & (around < high)]))
        return cls(a, b, omega, last, resolved, pinches)

    @cached_property
    def _parts(self) -> tuple[Factored, Factored, Factored]:
        return _apart(self.a, self.b)

    def lines(self, target: complex, omega: Floats) -> tuple[Complexes, ...]:
        """a, da/dω, b, db/dω, r, dr/dω, each (k,): L(jω) = target on the line kp a + kd b = r, at omega (k,).

        What A and B share, plant and delay, stands in r alone. As ω → 0, A and B come to lie along one line, apart by an angle of the order
        of ω over the controller's corners. Where a pole is slow beside these corners, as a trace of friction makes one, the boundary is
        drawn at ω so far below them that this angle is less than the round-off of A and B. In the controller's own roots it keeps its
        digits, and so does what r is off the axis on which it comes to lie (Factored.response_and_slope). So no pole has to be
        told to be an integrator or not: one at 0 turns r by a right angle at every ω, a slow one by what its own size says.
        """
        shared, *own = self._parts
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value, slope = shared.response_and_slope(omega)
            (a, da), (b, db) = (one.response_and_slope(omega) for one in own)
            right = target / value
            return a, da, b, db, right, -right * slope / value

    def solve(self, target: complex, omega: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """(kp, kd, dkp/dω, dkd/dω) with L(jω) = target."""
        a, da, b, db, right, turn = self.lines(target, omega)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            kp, kd = _solve2(a, b, right)
            dkp, dkd = _solve2(a, b, turn - kp * da - kd * db)
        on_pole = (right == 0) | ~np.isfinite(a)  # no gains are needed to reach the target there
        return np.where(on_pole, 0.0, kp), np.where(on_pole, 0.0, kd), dkp, dkd


def _apart(a: Factored, b: Factored) -> tuple[Factored, Factored, Factored]:
    """Factors of A and B: their common part (plant and delay), and what each has besides, a few roots of the controller."""
    zeros, a_zeros, b_zeros = _common(a.zeros, b.zeros)
    poles, a_poles, b_poles = _common(a.poles, b.poles)
    shared = Factored(zeros, poles, 1.0, a.delay, a.sample_time)
    step = a.sample_time
    return shared, Factored(a_zeros, a_poles, a.gain, 0.0, step), Factored(b_zeros, b_poles, b.gain, 0.0, step)


def _common(first: Complexes, second: Complexes) -> tuple[Complexes, Complexes, Complexes]:
    """Roots common to `first` and `second`, then the remaining ones of each."""
    left, both, right = [], [], second.tolist()
    for root in first.tolist():
        if root in right:
            right.remove(root)
            both.append(root)
        else:
            left.append(root)
    return np.array(both, dtype=complex), np.array(left, dtype=complex), np.array(right, dtype=complex)


def _is_simple(root: complex, part: Factored) -> bool:
    near = part.zeros[np.abs(part.zeros - root) <= UNRESOLVED * abs(root)]
    return near.tolist() == [root] and not np.any(part.poles == root)


def _divided(part: Factored, root: complex, omega: float) -> tuple[complex, complex]:
    """A/(ω − ω₀) at its zero ω₀ = `omega`, `root` in v, and the derivative of that by ω."""
    value, slope = replace(part, zeros=part.zeros[part.zeros != root]).response_and_slope(np.array([omega]))
    step = part.sample_time or 0.0
    first = 1j * np.exp(1j * omega * step)  # dv/dω; the second derivative is j T_s times that
    return complex(value[0] * first), complex(first * (slope[0] + value[0] * 0.5j * step))


def _together(parts: Iterable[LineCrossings]) -> LineCrossings:
    index, omega, other = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return index, omega, other


def _pinches(a: Factored, b: Factored, omega: Floats) -> Floats:
    """Frequencies (p,) [rad/s] at which B/A is real, see GainPlane.pinches, by bisection between samples at `omega`.

    B/A is of the controller alone, and smooth, or has zeros where the samples are dense.
    """

    def turned(omega: Floats) -> Booleans:
        with np.errstate(divide="ignore", invalid="ignore"):
            return (b.response(omega) / a.response(omega)).imag > 0

    side = turned(omega)
    k = np.flatnonzero(side[1:] != side[:-1])
    low, high = omega[k], omega[k + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        same = turned(middle) == side[k]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return low


def _frequency(root: complex, sample_time: float | None) -> float:
    """Frequency [rad/s] of the point of the stability boundary nearest to a root in v."""
    return root.imag if sample_time is None else float(np.angle(1 + sample_time * root)) / sample_time


def _damping(root: complex, sample_time: float | None) -> float:
    """Signed distance [1/s] of a root in v from the stability boundary; > 0: on the unstable side."""
    size = 1.0 if sample_time is None else abs(1 + sample_time * root)
    return root.real if sample_time is None else math.log(max(size, 1e-300)) / sample_time


def _horizon(a: Factored, slowest: float, fastest: float) -> float:
    """Highest frequency [rad/s] of the curve's grid: past all roots and several turns of the delay, beyond every gain of interest."""
    if not a.delay:
        return 1e5 * fastest  # a joint without roll-off crosses at √(kp/J): far out for large gains
    return max(4 * fastest, 8 * math.pi / a.delay, 10 * slowest)


def _solve2(a: Complexes, b: Complexes, right: Complexes) -> tuple[Floats, Floats]:
    """Real (x, y) that solve x a + y b = right, complex."""
    determinant = a.real * b.imag - a.imag * b.real
    return (right.real * b.imag - right.imag * b.real) / determinant, (a.real * right.imag - a.imag * right.real) / determinant


@dataclass(frozen=True)
class BoundaryCurve:
    """Boundary curve (kp, kd)(ω) of one target, in samples (k,) with its slopes by ω; it may run through infinity between samples."""

    plane: GainPlane
    target: complex
    omega: Floats
    kp: Floats
    kd: Floats
    slope_kp: Floats
    slope_kd: Floats

    @classmethod
    def of(cls, plane: GainPlane, target: complex) -> "BoundaryCurve":
        """The curve of one target, built once per plane."""
        if target not in plane.curves:
            plane.curves[target] = cls._built(plane, target)
        return plane.curves[target]

    @classmethod
    def _built(cls, plane: GainPlane, target: complex) -> "BoundaryCurve":
        """The curve on the plane's grid, refined until it turns little between samples."""

        def solved(omega: Floats) -> Floats:
            return np.column_stack(plane.solve(target, omega))

        def rough(omega: Floats, found: Floats) -> Booleans:
            # kp and ω kd are the two parts of D(jω): in these axes a curve that turns little is resolved. Below `resolved` it is straight.
            turned = np.diff(np.arctan2(omega * found[:, 3], found[:, 2]))
            return (np.abs(np.angle(np.exp(1j * turned))) > SMALL_TURN) & (omega[1:] > plane.resolved)

        omega, found = refined(plane.omega, solved(plane.omega), solved, rough, 12, 40_000)
        return cls(plane, target, omega, *found.T)

    def crossings(self, axis: str, values: Floats, polish: bool = True) -> LineCrossings:
        """Crossings of the curve with the lines kp = value (axis 'kp') or kd = value ('kd').

        Returns (index into values, ω, the other gain), each crossing polished to machine precision, or interpolated with polish=False.
        """
        omega, along, slope = self._monotone_kp if axis == "kp" else self._monotone_kd
        # An interval that runs through infinity is no crossing.
        low, high = np.minimum(along[:-1], along[1:]), np.maximum(along[:-1], along[1:])
        through = np.isfinite(low) & np.isfinite(high) & ~_runs_through_infinity(along, slope) & ~self._pinched(omega)
        order = np.argsort(values, kind="stable")
        ranked = values[order]
        first, last = np.searchsorted(ranked, low, "left"), np.searchsorted(ranked, high, "left")
        count = np.where(through, last - first, 0)
        interval = np.repeat(np.arange(len(count)), count)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        index = order[first[interval] + within]
        share = (values[index] - along[interval]) / (along[interval + 1] - along[interval])
        omega_found = omega[interval] + share * (omega[interval + 1] - omega[interval])
        if polish:
            ends = omega[interval], omega[interval + 1]
            bent = _bent(share, *ends, along[interval + 1] - along[interval], slope[interval], slope[interval + 1])
            omega_found = np.where((bent > ends[0]) & (bent < ends[1]), bent, omega_found)
            omega_found = self._polish(axis, values[index], *ends, omega_found, along[interval])
        other = self._other(axis, values[index], omega_found)
        parts = (index, omega_found, other), self._straight(axis, values), self._beside_zeros(axis, values)
        return _together(parts)

    def _other(self, axis: str, values: Floats, omega: Floats) -> Floats:
        """Gain other than `axis` at which the curve is met at `omega` if the gain `axis` is `values`."""
        a, b = self.plane.a.response(omega), self.plane.b.response(omega)
        given, free = (a, b) if axis == "kp" else (b, a)
        with np.errstate(divide="ignore", invalid="ignore"):
            other = ((self.target - values * given) * free.conj()).real / np.abs(free) ** 2
        return np.where(np.isfinite(a), other, 0.0)  # on a pole no gains are needed to reach the target

    def _pinched(self, omega: Floats) -> Booleans:
        """Mask (k − 1,) of the intervals between neighbours in `omega` that contain a pinch: there the curve is taken as straight."""
        middle, pinches = 0.5 * (omega[1:] + omega[:-1]), self.plane.pinches
        return np.any(np.abs(middle[:, None] - pinches) < PINCH * pinches, axis=1)

    def _straight(self, axis: str, values: Floats) -> LineCrossings:
        """Crossings of `values` with the straight pieces at the pinches: from the last sample on either side out to infinity.

        There kd = Im(target/A)/Im(B/A) and kp = Re(target/A) − kd Re(B/A), of which only Im(B/A) moves, through 0.
        """
        found: list[LineCrossings] = [(np.empty(0, dtype=int), np.empty(0), np.empty(0))]
        for pinch in self.plane.pinches.tolist():
            for side in (-1.0, 1.0):
                edge = np.array([pinch * (1 + side * PINCH)])
                kp, kd, _, _ = self.plane.solve(self.target, edge)
                a, b = (part.response(np.array([pinch]))[0] for part in (self.plane.a, self.plane.b))
                beyond = self.plane.b.response(edge)[0] / self.plane.a.response(edge)[0]
                outward = (1.0 if (self.target / a).imag >= 0 else -1.0) * np.sign(beyond.imag)
                if axis == "kp":
                    outward *= -np.sign((b / a).real)
                start = (kp if axis == "kp" else kd)[0]
                index = np.flatnonzero(outward * (values - start) > 0)
                omega = np.full(len(index), pinch)
                found.append((index, omega, self._other(axis, values[index], omega)))
        return _together(found)

    def _beside_zeros(self, axis: str, values: Floats) -> LineCrossings:
        """Crossings of `values` nearer to a zero on the boundary than any sample, given the ω of the sample next to them.

        A notch of depth 0 or an undamped antiresonance at ω₀: A = a (ω − ω₀) and B = b (ω − ω₀), so the curve runs out to infinity on
        either side of it, where kp a + kd b = target/(ω − ω₀); a and b are taken to first order in ω − ω₀.
        """
        found: list[LineCrossings] = [(np.empty(0, dtype=int), np.empty(0), np.empty(0))]
        for center, *parts in self.plane.zeros:
            k = int(np.searchsorted(self.omega, center))
            if not 0 < k < len(self.omega):
                continue
            (given, bend), (free, free_bend) = (np.array(part) / self.target for part in (parts if axis == "kp" else parts[::-1]))
            rate, other = np.full(len(values), np.inf), values
            for _ in range(4):  # the corners of A and B move the other gain by a constant; in ω they vanish
                with np.errstate(divide="ignore", invalid="ignore"):  # no crossing where the curve is parallel to the lines
                    here, there = given + bend / rate, free + free_bend / rate
                    other = -values * here.imag / there.imag
                    rate = (values * here + other * there).real  # 1/(ω − ω₀)
            for inside, edge in ((rate < 0, self.omega[k - 1]), (rate > 0, self.omega[k])):
                index = np.flatnonzero(inside & np.isfinite(rate) & (np.abs(rate * (edge - center)) > 1))
                found.append((index, np.full(len(index), edge), other[index]))
        return _together(found)

    def along(self, axis: str) -> tuple[Floats, Floats]:
        """Frequencies [rad/s] and the gain `axis`, "kp" or "kd", at the samples and at every extremum of that gain between them."""
        return (self._monotone_kp if axis == "kp" else self._monotone_kd)[:2]

    @cached_property
    def _monotone_kp(self) -> tuple[Floats, Floats, Floats]:
        return self._with_extrema("kp", self.kp, self.slope_kp)

    @cached_property
    def _monotone_kd(self) -> tuple[Floats, Floats, Floats]:
        return self._with_extrema("kd", self.kd, self.slope_kd)

    def _with_extrema(self, axis: str, along: Floats, slope: Floats) -> tuple[Floats, Floats, Floats]:
        """The samples with every extremum of kp(ω) or kd(ω) added, so that the curve is monotone between them."""
        turning = np.flatnonzero((np.sign(slope[1:]) != np.sign(slope[:-1])) & np.isfinite(slope[1:]) & np.isfinite(slope[:-1]))
        low, high = self.omega[turning].copy(), self.omega[turning + 1].copy()
        rising = slope[turning] > 0
        for _ in range(60):
            middle = 0.5 * (low + high)
            _, _, slope_kp, slope_kd = self.plane.solve(self.target, middle)
            same = ((slope_kp if axis == "kp" else slope_kd) > 0) == rising
            low, high = np.where(same, middle, low), np.where(same, high, middle)
            if np.all(high - low <= 1e-10 * high):  # the extremum is flat: its gain is then good to the last digit
                break
        kp, kd, slope_kp, slope_kd = self.plane.solve(self.target, low)
        extra, extra_slope = (kp, slope_kp) if axis == "kp" else (kd, slope_kd)
        return (
            np.insert(self.omega, turning + 1, low),
            np.insert(along, turning + 1, extra),
            np.insert(slope, turning + 1, extra_slope * 0),
        )

    def _polish(self, axis: str, values: Floats, low: Floats, high: Floats, omega: Floats, along_low: Floats) -> Floats:
        """ω in [low, high] where the curve meets `values`, by Newton from `omega`, with bisection as the fallback."""
        low, high, rising = low.copy(), high.copy(), along_low <= values
        active = np.arange(len(values))
        for _ in range(80):
            here, wanted = omega[active], values[active]
            kp, kd, slope_kp, slope_kd = self.plane.solve(self.target, here)
            along, slope = (kp, slope_kp) if axis == "kp" else (kd, slope_kd)
            below = (along <= wanted) == rising[active]
            low[active], high[active] = np.where(below, here, low[active]), np.where(below, high[active], here)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = here - (along - wanted) / slope
            done = (np.abs(step - here) <= 1e-15 * here) | (np.abs(along - wanted) <= GAIN_ROUNDING * np.abs(wanted))
            inside = (step > low[active]) & (step < high[active])
            omega[active] = np.where(done, here, np.where(inside, step, 0.5 * (low[active] + high[active])))
            active = active[~done & (high[active] - low[active] > 4e-16 * here)]
            if not len(active):
                break
        return omega


def _bent(share: Floats, low: Floats, high: Floats, rise: Floats, slope_low: Floats, slope_high: Floats) -> Floats:
    """ω at a `share` of the rise from `low` to `high`, by the cubic with a curve's slopes at both; NaN or infinite where one is 0."""
    left = 1 - share
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        turned = left * (rise / slope_low) - share * (rise / slope_high)
        return low + (high - low) * share**2 * (1 + 2 * left) + share * left * turned


def _runs_through_infinity(along: Floats, slope: Floats) -> Booleans:
    """True where neighbouring samples lie on two sides of a pole of the curve: it jumps against its own slope, by more than its size."""
    jump = np.diff(along)
    against = (jump * slope[:-1] < 0) & (jump * slope[1:] < 0)
    return against & (np.abs(jump) > np.minimum(np.abs(along[1:]), np.abs(along[:-1])))


def refined(
    omega: Floats,
    values: Complexes,
    at: Callable[[Floats], Complexes],
    rough: Callable[[Floats, Complexes], Booleans],
    rounds: int,
    most: int,
    closest: float = 1e-9,
) -> tuple[Floats, Complexes]:
    """Samples at `omega` (k,), with `values` (k, m) there, and in the middle of rough steps, which are halved until none is rough.

    at        ω (k,) → (k, m): m scalar responses
    rough     of samples (ω, values): (k − 1,) True where a step to the next one is too long
    most      samples, but for those of one more round
    closest   of ω: shorter steps are not halved
    """
    for _ in range(rounds):
        spots = np.flatnonzero(rough(omega, values) & (np.diff(omega) > closest * omega[1:]))
        if not len(spots) or len(omega) > most:
            break
        middle = 0.5 * (omega[spots] + omega[spots + 1])
        values, omega = np.insert(values, spots + 1, at(middle), axis=0), np.insert(omega, spots + 1, middle)
    return omega, values
