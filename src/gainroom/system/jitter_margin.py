"""Jitter margin: the widest range within which the delays of single torque commands may vary, from one to the next, without instability.

A delay that varies can destabilise a loop that is stable with every constant delay of its range; small gain excludes that. Every command
takes effect after a delay of its own, in a range of width δ that contains the loop's constant delay; one that another overtook is dropped.
The torque then differs by e from that of the constant delay, and the loop stays stable if the way from e back to what e is made of has a
gain below 1, in energy (L2) and at every frequency.

**Continuous** (Kao and Lincoln 2004, Automatica 40, theorem 1, for ranges that begin at the constant delay). e(t) is an integral of u̇ over
a stretch that reaches at most a forwards or b backwards, a + b = δ, so that ‖e‖² ≤ max(a, b) (a + b) ‖u̇‖² ≤ δ² ‖u̇‖² by Cauchy and
Schwarz. From e to u the loop is −T, T = L/(1 + L): it is enough that δ ω |T(jω)| < 1 for all ω.

**Sampled** every h, δ = N h. Each step Δu = u_k − u_{k−1} that is due and has not come, or has come and is not due, is a part of e.

* N = n + g > 1, n whole (Kao and Lincoln 2004, theorem 3; Cervin, Lincoln, Eker, Årzén and Buttazzo 2004, RTCSA, eq. 3): n + 1 steps are at
  once in e for a share g of the time, else n, hence ‖e‖² ≤ h f(N) Σ Δu², f(N) = n² + (2n + 1) g: N² joined by straight lines. (f is convex
  and f(0) = 0, so that f(a) + f(b) ≤ f(a + b): a range to both sides costs no more.) Of ‖e‖² the samples behind the plant P keep at most
  Σ_k |P(jω_k)|²/h, ω_k = ω + 2πk/h: it is enough that √f(N) |e^{jωh} − 1| (Σ_k |P(jω_k)|²)^½ |D|/|1 + L| < 1 for all ω in [0, π/h].
* N ≤ 1, where that has √N in place of N: the step late by d is a rectangle of length |d| = x δ. It has the area of x times the rectangle
  that fills the whole range; what is left is the derivative of a function of time with energy at most (4 x (1 − x))² δ³/48. The area acts
  through Σ_k |P(jω_k)| at most, the rest through s P(s). As x² + ⅔ (4 x (1 − x))² ≤ 1 for x in [0, 1], it is enough that, with

      P_e² = (Σ_k |P(jω_k)|)² + h²/32 Σ_k |ω_k P(jω_k)|²,      N |e^{jωh} − 1| P_e |D|/|1 + L| < 1.

P_e serves for both: it is hardly more than the first sum where loops have their peaks, and one peak then answers for every N. Of a sampled
return ratio without its continuous plant P_e/|P_sampled| is taken as 1: its delays vary by whole ticks (theorem 2), and N counts these.

**Several loops**, every command of every joint with a delay of its own: |T| is the largest singular value of U⁻¹ T U at the torques, with
any constant diagonal U > 0: the delays act joint by joint, so that U changes nothing on their side.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .linear.arrays import Booleans, Complexes, Floats, distinct
from .linear.transfer_function import Factored
from .loop import Loop

TOLERANCE = 1e-3  # share by which a certified peak may be exceeded between the frequencies evaluated
MOST_INTERVALS = 100_000  # bound of work: a joint takes some hundreds
MOST_PIECES = 8  # of an interval at a time
FINEST = 1e-13  # relative: shorter intervals are round-off
PER_DECADE = 24  # first intervals
ALIASES = 3  # sampled: aliases to each side that are summed, at least; those beyond are bounded by a power of the frequency
MOST_ALIASES = 60
FIRST = 1e-4  # share of the lowest corner frequency below which a loop is little else than a power of the frequency
DECADES = 12  # below that, in which a bound is looked for
LAST = 1e5  # multiple of the highest one above which it is, too
SHARP = 0.05  # damping ratio below which a resonance above half the sample rate is followed like one below it
SAME = 1e-9  # relative: error of a sampled pole
PAIRED = 3.0  # |(s − p) T_s| up to which a pole and its image behind the sampler are bounded as one factor
SAMPLES_PER_DECADE = 40
AROUND = np.array([-3.0, -1.0, -0.3, 0.3, 1.0, 3.0])  # in widths of a resonance
BALANCED = 10  # sweeps over all joints
LARGEST_RISE, LEAST_DISTANCE = 0.05, 1e-6  # of several loops: largest relative step between samples, least distance of two
MOST_SAMPLES = 20_000
FINER, FLAT = 9, 1e-5  # points of a grid about a peak, and its relative width at last: a maximum is flat, its height good to 1e-10
ROUGHLY = 1e-3  # likewise of several loops: good to 1e-6
RAISED = 10.0  # bound of these times
ROUNDS = 3  # times that the scaling of several loops is balanced anew


@dataclass(frozen=True)
class JitterMargin:
    """Jitter margin of a stable loop.

    width       δ [s], the width of the range of delays up to which stability is proved; inf: any
    frequency   of the peak that bounds it [rad/s]; inf can be, NaN where δ is inf
    certified   True: between the frequencies evaluated the peak is proved not to be exceeded by more than TOLERANCE of it. Of several
                loops it is sampled
    units       (n,) U of several loops
    """

    width: float
    frequency: float
    certified: bool
    units: Floats = field(default_factory=lambda: np.ones(1), repr=False, compare=False)


def jitter_margin(loop: Loop) -> JitterMargin:
    """Jitter margin of a stable loop of n ≥ 1 joints, with its width δ in s; computed once per loop.

    Stability is not checked: for an unstable loop the result has no meaning. Raises GainroomError if kd closes on a path of its own, and
    for a sampled loop whose gains measure both sides.
    """
    loop.require_one_path("the jitter margin")
    if loop.sample_time is not None:  # whose aliases differ from side to side
        loop.require_one_side("the jitter margin of a sampled loop")
    if "jitter" not in loop.measurements:
        peak = sampled_peak(Heights.of(loop), loop.sample_time) if loop.scalar is None else ScalarPeak.of(loop).found()
        place = peak.omega if peak.height > 0 else math.nan
        loop.measurements["jitter"] = JitterMargin(width_below(peak.height, loop.sample_time), place, peak.certified, peak.units)
    return loop.measurements["jitter"]


def width_about(loop: Loop, known: JitterMargin) -> float:
    """Width δ [s] of a loop whose gains are close to those of the loop that `known` was computed for.

    The weighted complementary sensitivity is evaluated at `known.frequency` alone, so δ is accurate to first order in the change of gains.
    Where that frequency is not finite, the whole search is repeated.
    """
    if not math.isfinite(known.frequency):
        return jitter_margin(loop).width
    heights = Heights(loop, known.units) if loop.scalar is None else ScalarPeak.of(loop)
    return width_below(float(heights.at(np.array([known.frequency]))[0]), loop.sample_time)


def width_below(height: float, sample_time: float | None) -> float:
    """Width δ [s] that small gain allows for a weighted complementary sensitivity with the peak `height` [1/s].

    inf for a height of 0, NaN for NaN.
    """
    if not height > 0:
        return math.inf if height == 0 else math.nan
    if sample_time is None:
        return 1 / height
    ticks = 1 / (height * sample_time)  # N, and √f(N) above 1
    whole = math.floor(ticks)
    return sample_time * (ticks if ticks < 1 else whole + (ticks**2 - whole**2) / (2 * whole + 1))


def height_at(width: float, sample_time: float | None) -> float:
    """Peak [1/s] that a loop with the jitter margin `width` [s] > 0 has: the inverse of `width_below`."""
    if sample_time is None or width < sample_time:
        return 1 / width
    whole = math.floor(width / sample_time)
    part = width / sample_time - whole
    return 1 / (sample_time * math.sqrt(whole**2 + (2 * whole + 1) * part))


class Peak(NamedTuple):
    """Peak of the weighted complementary sensitivity: height [1/s], frequency [rad/s]; `certified` and `units` as in JitterMargin."""

    height: float
    omega: float
    certified: bool
    units: Floats


@dataclass(frozen=True)
class Aliases:
    """Plant with current loop P of one joint in continuous time and sampled: its frequency response at all aliases of a frequency."""

    unsampled: Factored
    sampled: Factored
    sample_time: float

    @cached_property
    def shifts(self) -> Floats:
        """Shifts 2πk/T_s [rad/s] of the aliases that are summed: to beyond the highest corner frequency with little damping."""
        turn = 2 * math.pi / self.sample_time
        roots = np.concatenate([self.unsampled.zeros, self.unsampled.poles])
        sharp = np.abs(roots[np.abs(np.real(roots)) < 0.5 * np.abs(roots)])
        count = min(max(ALIASES, math.ceil(2 * sharp.max(initial=0.0) / turn)), MOST_ALIASES)
        return turn * np.arange(-count, count + 1)

    @cached_property
    def beyond(self) -> tuple[float, float]:
        """Bounds of Σ |P| and Σ |ω P|² over all aliases that `shifts` leave out, at any ω in [0, π/T_s]; inf where none is known."""
        turn = 2 * math.pi / self.sample_time
        first = float(self.shifts[-1]) + turn / 2
        zeros, poles = np.abs(self.unsampled.zeros), self.unsampled.poles
        far = np.abs(poles) > first / 2
        power = int(np.count_nonzero(~far)) - len(zeros)  # |P| <= size/ω^power from `first` on
        damped = np.abs(poles.real[far])
        if power < 2 or np.any(damped == 0):
            return math.inf, math.inf
        size = abs(self.unsampled.gain) * np.prod(1 + zeros / first) / (np.prod(1 - np.abs(poles[~far]) / first) * np.prod(damped))
        every = 2 * float(size) * (first**-power + first ** (1 - power) / (turn * (power - 1)))
        return every, 2 * float(size) ** 2 * (first ** (2 - 2 * power) + first ** (3 - 2 * power) / (turn * (2 * power - 3)))

    def points(self, omega: Floats) -> Complexes:
        """s (k, aliases) [1/s] of all aliases of omega (k,)."""
        return 1j * (omega[:, None] + self.shifts)

    def size(self, omega: Floats) -> Floats:
        """Upper bound of P_e (k,) at omega (k,) in [0, π/T_s]: the sums of the module, with bounds for aliases that are left out."""
        points = self.points(omega)
        return self._sum(np.abs(self.unsampled.at(points)), np.abs(points), 1.0)

    def _sum(self, sizes: Floats, omega: Floats, unit: Floats | float) -> Floats:
        """P_e (k,) in `unit` (k,), from `sizes` (k, aliases) of P in that unit at |ω| (k, aliases)."""
        every, squares = self.beyond
        with np.errstate(over="ignore", invalid="ignore"):
            rest = ((omega * sizes) ** 2).sum(axis=1) + squares / unit**2
            return np.sqrt((sizes.sum(axis=1) + every / unit) ** 2 + self.sample_time**2 / 32 * rest)

    def ratio(self, omega: Floats) -> Floats:
        """Ratio P_e/|P_sampled| (k,) at omega (k,) [rad/s], P_e bounded from above."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.size(omega) / np.abs(self.sampled.at(1j * omega))

    def highest(self, middle: Floats, half: Floats) -> Floats:
        """Upper bound of P_e (m,) on intervals `middle` ± `half` (m,) [rad/s]."""
        points = self.points(middle)
        near, far = _reach(points, half, self.unsampled)
        with np.errstate(over="ignore"):
            return self._sum(np.exp(far - near) * abs(self.unsampled.gain), np.abs(points) + half[:, None], 1.0)

    def highest_ratio(self, middle: Floats, half: Floats) -> Floats:
        """Upper bound of P_e/|P_sampled| (m,) on intervals; also where a pole of both lies on the axis."""
        step, points = self.sample_time, self.points(middle)
        v, inverse = np.expm1(1j * middle[:, None] * step) / step, replace(self.sampled, zeros=self.sampled.poles, poles=self.sampled.zeros)
        near, far = _reach(points, half, self.unsampled)
        near_zeros, far_poles = _reach(v, half, inverse)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            least = abs(self.sampled.gain) * np.exp(near_zeros - far_poles)  # of |P_sampled|
            sizes = np.exp(far - near) * abs(self.unsampled.gain) / least
            pairs = self._log_pairs(points[:, self._paired], v, half) - near_zeros
            sizes[:, self._paired] = np.exp(pairs) * abs(self.unsampled.gain / self.sampled.gain)
            return self._sum(sizes, np.abs(points) + half[:, None], least[:, 0])

    @cached_property
    def _paired(self) -> Booleans:
        """True for the shifts at which P may have a pole on or near the axis: 0, and those of resonances above half the sample rate."""
        poles = self.unsampled.poles
        sharp = poles[(np.abs(poles.real) < SHARP * np.abs(poles)) & (np.abs(poles.imag) > math.pi / self.sample_time)]
        beside = [np.abs(self.shifts - one.imag) * self.sample_time < 2 * math.pi for one in sharp.tolist()]
        return np.any([self.shifts == 0, *beside], axis=0)

    def _log_pairs(self, points: Complexes, v: Complexes, half: Floats) -> Floats:
        """Upper bound (m, k), as a logarithm, of the factors of P/P_sampled that zeros of P and poles of P and P_sampled contribute.

        It holds within `half` (m,) [1/s] of `points` (m, k); a pole of P and its image in P_sampled are bounded as a quotient.
        """
        step, images = self.sample_time, self.sampled.poles.tolist()
        log, wide = _reach(points, half, self.unsampled)[1], half[:, None]
        for pole in self.unsampled.poles.tolist():
            image, x = np.expm1(pole * step) / step, (points - pole) * step
            alone = -np.log(np.maximum(np.abs(points - pole) - wide, 0.0))
            apart = [abs(one - image) for one in images]
            if not apart or min(apart) > SAME * abs(image):
                log = log + alone
                continue
            alone = alone + np.log(np.abs(v - images.pop(apart.index(min(apart)))) + wide)
            # (v − image)/(s − pole) = e^{pole T_s} (e^x − 1)/x, the logarithm of which has a slope by x below 1 for |x| <= 3
            together = np.where(x == 0, 1.0, np.abs(np.expm1(x) / np.where(x == 0, 1.0, x))) * math.exp(pole.real * step)
            log = log + np.where(np.abs(x) + wide * step <= PAIRED, np.log(together) + wide * step, alone)
        return log + _reach(v, half, replace(self.sampled, zeros=np.array(images, dtype=complex)))[1]


def _reach(points: Complexes, half: Floats, system: Factored) -> tuple[Floats, Floats]:
    """Logarithms (m, k) of the least Π|v − pole|, and of the largest Π|v − zero|, within `half` (m,) [1/s] of `points` (m, k)."""
    wide, near, far = half[:, None], np.zeros(points.shape), np.zeros(points.shape)
    with np.errstate(divide="ignore"):
        for pole in system.poles.tolist():
            near = near + np.log(np.maximum(np.abs(points - pole) - wide, 0.0))
        for zero in system.zeros.tolist():
            far = far + np.log(np.abs(points - zero) + wide)
    return near, far


def weight(sampled: Factored, unsampled: Factored | None, omega: Floats) -> Floats:
    """Weight (k,) [1/s] of |T| at omega (k,), one joint: |v|, times P_e/|P_sampled| where the continuous plant is known."""
    time = sampled.sample_time
    known = 1.0 if time is None or unsampled is None else Aliases(unsampled, sampled, time).ratio(omega)
    return speed(omega, time) * known


def speed(omega: Floats, sample_time: float | None) -> Floats:
    """|v| (k,) [1/s] at omega (k,): ω, and sampled |e^{jωT_s} − 1|/T_s."""
    return omega if sample_time is None else 2 * np.sin(0.5 * omega * sample_time) / sample_time


@dataclass(frozen=True)
class ScalarPeak:
    """The peak of H = |v| P_e |D| / |1 + L| of one joint (|v T| where no aliases are known), by branch and bound over ω.

    On an interval each factor v − root of a transfer function keeps within half the interval of what it is in the middle. That bounds H
    from above; intervals on which the bound exceeds the highest value found are divided.
    """

    loop: Factored
    control: Factored | None  # known where aliases are
    aliases: Aliases | None

    @classmethod
    def of(cls, loop: Loop) -> "ScalarPeak":
        """Peak of a loop of one joint that has a return ratio in zeros and poles."""
        assert loop.scalar is not None
        return cls(loop.scalar.reduced, None if loop.control is None else loop.control.scaled(loop.gain), aliases_of(loop))

    def found(self) -> Peak:
        """Peak of H; `certified`: H is proved to exceed it nowhere by more than TOLERANCE. Height 0, frequency NaN if all gains are 0."""
        units = np.ones(1)
        if self.loop.gain == 0:
            return Peak(0.0, math.nan, True, units)
        first, last, best = self._ends()
        low, high = _split(first, last)
        certified, spent = True, 0
        while len(low) and math.isfinite(best[0]):
            spent += len(low)
            value = self.at(0.5 * (low + high))
            top = int(np.argmax(value))
            if value[top] > best[0]:
                best = _polished(self.at, float(low[top]), float(high[top]))
            bound, limit = self._bound(low, high), best[0] * (1 + TOLERANCE)
            left = ~(bound <= limit)
            certified = spent <= MOST_INTERVALS and bool(np.all(high[left] - low[left] > FINEST * high[left]))
            if not certified:
                break
            low, high = _divided(low[left], high[left], value[left], bound[left], limit)
        outside = max(self._below(first), self._above(last))
        return Peak(*best, certified and outside <= best[0] * (1 + TOLERANCE), units)

    @property
    def _time(self) -> float | None:
        return self.loop.sample_time

    def at(self, omega: Floats) -> Floats:
        """H (k,) [1/s] at omega (k,) [rad/s]; 0 where it cannot be evaluated (NaN)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = self.loop.at(1j * omega)
            if self.aliases is None:
                height = speed(omega, self._time) * np.abs(value / (1 + value))
            else:
                assert self.control is not None
                height = speed(omega, self._time) * self.aliases.size(omega) * np.abs(self.control.at(1j * omega) / (1 + value))
        return np.nan_to_num(height, nan=0.0, posinf=0.0)

    def _bound(self, low: Floats, high: Floats) -> Floats:
        """Upper bound (m,) of H on each interval."""
        plain, away = self.without_aliases(low, high)
        if self.aliases is None:
            return plain
        assert self.control is not None
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            near, far = _reach(self._points(middle), half, self.control)
            control = np.exp((far - near)[:, 0]) * abs(self.control.gain)
            fast = speed(high, self._time) * self.aliases.highest(middle, half) * _over(control, away)
            return np.fmin(self.aliases.highest_ratio(middle, half) * plain, fast)

    def without_aliases(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Upper bound (m,) of |v T| on each interval, and lower bound (m,) of |1 + L|."""
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        value = self.loop.at(1j * middle)
        size = np.abs(value)
        log_low, log_high = self._sizes(middle, half)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            turned = np.expm1(self._moves(middle, half))  # relative change of L, at most
            away = np.fmax(np.abs(1 + value) - size * turned, 1 - np.exp(log_high))  # least |1 + L|
            back = np.fmax(np.abs(1 + 1 / value) - turned / size, 1 - np.exp(-log_low))  # least |1 + 1/L|
            fast = speed(high, self._time)
            sensitivity, complementary = _over(1.0, away), np.fmin(_over(1.0, back), _over(np.exp(log_high), away))
            slope, bend = self._slopes(low, middle, half, value, sensitivity, complementary)
            tangent = speed(middle, self._time) * np.abs(value / (1 + value)) * np.exp(np.abs(slope) * half + 0.5 * bend * half**2)
            return np.fmin(fast * complementary, tangent), away

    def _slopes(
        self, low: Floats, middle: Floats, half: Floats, value: Complexes, sensitivity: Floats, complementary: Floats
    ) -> tuple[Floats, Floats]:
        """First derivative (m,) of ln|v T| by ω in the middle of intervals, and an upper bound of |d²/dω²| on each whole interval.

        With λ = d ln L/dω: d ln T/dω = λ S and d²/dω² = λ' S − λ² T S; `sensitivity` and `complementary` bound |S| and |T|.
        """
        v, time, apart = self._points(middle)[:, 0], self._time, np.zeros(len(middle), dtype=complex)
        first, second = np.full(len(middle), self.loop.delay), np.zeros(len(middle))
        for roots, sign in ((self.loop.zeros, 1.0), (self.loop.poles, -1.0)):
            for root in roots.tolist():
                apart = apart + sign / (v - root)
                near = np.maximum(np.abs(v - root) - half, 0.0)
                first, second = first + 1 / near, second + 1 / near**2
        turn = 1.0 if time is None else np.exp(1j * middle * time)
        slope = 1j * (apart * turn - self.loop.delay) / (1 + value)
        if time is None:
            return slope.real + 1 / middle, second * sensitivity + first**2 * sensitivity * complementary + 1 / low**2
        own = 0.5 * time / np.tan(0.5 * middle * time)
        bend = (second + time * first) * sensitivity + first**2 * sensitivity * complementary
        return slope.real + own, bend + (0.5 * time / np.sin(0.5 * low * time)) ** 2

    def _points(self, omega: Floats) -> Complexes:
        """v (k, 1) at omega (k,)."""
        s = 1j * omega[:, None]
        return s if self._time is None else np.expm1(s * self._time) / self._time

    def _sizes(self, middle: Floats, half: Floats) -> tuple[Floats, Floats]:
        """Lower and upper bound of ln|L|, each (m,), on intervals `middle` ± `half` (m,) [rad/s]."""
        v, size = self._points(middle), math.log(abs(self.loop.gain))
        near, far = _reach(v, half, self.loop)
        inverse = replace(self.loop, zeros=self.loop.poles, poles=self.loop.zeros)
        least, most = _reach(v, half, inverse)
        return (size + least - most)[:, 0], (size + far - near)[:, 0]

    def _moves(self, middle: Floats, half: Floats) -> Floats:
        """Upper bound (m,) of |ln L(ω) − ln L(middle)| over ω in each interval `middle` ± `half` (m,) [rad/s]."""
        v = self._points(middle)[:, 0]
        moved = half * self.loop.delay
        for root in [*self.loop.zeros.tolist(), *self.loop.poles.tolist()]:
            moved = moved - np.log1p(-np.minimum(half / np.abs(v - root), 1.0))
        return moved

    def _ends(self) -> tuple[float, float, tuple[float, float]]:
        """Frequencies between which intervals are examined [rad/s], and the height at the upper end with its frequency."""
        loop, time = self.loop, self._time
        sizes = np.abs(np.concatenate([loop.zeros, loop.poles]))
        sizes = np.append(sizes[sizes > 0], 1 / loop.delay if loop.delay > 0 else [])
        sizes = np.append(sizes, abs(loop.gain) ** (1 / loop.relative_degree) if loop.relative_degree > 0 else 1.0)
        last = LAST * float(sizes.max()) if time is None else math.pi / time
        first = min(FIRST * float(sizes.min()), FIRST * last)
        for _ in range(DECADES):  # a loop that comes to rest at −1 has no such bound: its peak is then not certified
            if self._below(first) < math.inf:
                break
            first *= 0.1
        return first, last, self._at_the_end()

    def _at_the_end(self) -> tuple[float, float]:
        """H [1/s] at the highest frequency there is, and that frequency [rad/s]."""
        if self._time is not None:
            last = math.pi / self._time
            return float(self.at(np.array([last]))[0]), last
        return {0: math.inf, 1: abs(self.loop.gain)}.get(self.loop.relative_degree, 0.0), math.inf

    def _below(self, first: float) -> float:
        """Upper bound of H below `first` [rad/s], which is far below all corners."""
        most, moved = self.most_below(first)
        ratio = 1.0 if self.aliases is None else float(self.aliases.ratio(np.array([first]))[0])
        return first * most * ratio * (1 + moved)

    def most_below(self, first: float) -> tuple[float, float]:
        """Upper bound of |T| below `first` [rad/s], and of the relative change of L against a power of the frequency.

        `first` is far below all corners: L is a power of the frequency there, and little else.
        """
        roots = np.concatenate([self.loop.zeros, self.loop.poles])
        roots = np.abs(roots[roots != 0])
        moved = math.expm1(2 * float(np.sum(first / np.maximum(roots - first, first))) + first * self.loop.delay)
        value = complex(self.loop.at(1j * np.array([first]))[0])
        power = int(np.count_nonzero(self.loop.poles == 0)) - int(np.count_nonzero(self.loop.zeros == 0))
        size = abs(value)
        if power > 0:
            most = 1 / (1 - 1 / (size * (1 - moved))) if size * (1 - moved) > 2 else math.inf
        elif power == 0:
            away = abs(1 + value) - size * moved
            most = size * (1 + moved) / away if away > 0 else math.inf
        else:
            most = 2 * size * (1 + moved) if size * (1 + moved) < 0.5 else math.inf
        return most, moved

    def _above(self, last: float) -> float:
        """Upper bound of H above `last` [rad/s], which is far above all corners; 0 in sampled time, which ends there."""
        if self._time is not None:
            return 0.0
        return last * self.most_above(last) if self.loop.relative_degree > 0 else math.inf

    def most_above(self, last: float) -> float:
        """Upper bound of |T| above `last` [rad/s], which is far above all corners, in continuous time."""
        loop = self.loop
        size = abs(loop.gain) * float(np.prod(1 + np.abs(loop.zeros) / last) / np.prod(1 - np.abs(loop.poles) / last))
        size *= last ** (-loop.relative_degree)
        return size / (1 - size) if size < 1 else math.inf


def _over(above: Floats | float, below: Floats) -> Floats:
    """Quotient above/below (m,); inf where `below` is 0, negative or NaN."""
    return np.where(below > 0, above / np.where(below > 0, below, 1.0), np.inf)


def _divided(low: Floats, high: Floats, value: Floats, bound: Floats, limit: float) -> tuple[Floats, Floats]:
    """Ends (low, high) of the intervals divided into equal pieces, more the farther `bound` is above `limit`.

    The number is that which suffices if the excess of the bound over `value` in the middle shrinks in proportion to the length.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.log(bound / value) / np.log(limit / value)
    pieces = np.clip(np.nan_to_num(np.ceil(needed), nan=2, posinf=MOST_PIECES), 2, MOST_PIECES).astype(int)
    at = np.repeat(np.arange(len(low)), pieces)
    place = np.arange(len(at)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    step = ((high - low) / pieces)[at]
    return low[at] + place * step, low[at] + (place + 1) * step


def _split(first: float, last: float) -> tuple[Floats, Floats]:
    """Ends (low, high), each (m,) [rad/s], of the intervals with which the search begins, from `first` to `last`."""
    edges = np.geomspace(first, last, 2 + math.ceil(PER_DECADE * math.log10(last / first)))
    return edges[:-1], edges[1:]


def aliases_of(loop: Loop) -> Aliases | None:
    """Aliases of the plant of a sampled loop of one joint; None in continuous time, and where the continuous plant is not known."""
    if loop.sample_time is None or loop.unsampled is None:
        return None
    assert loop.actuated is not None
    return Aliases(loop.unsampled, loop.actuated, loop.sample_time)


@dataclass(frozen=True)
class Heights:
    """Largest singular value of the weighted complementary sensitivity T of several loops, or of one loop given as a callable.

    units   (n,) U of the module: T is U⁻¹ T U at the torques
    """

    loop: Loop
    units: Floats

    @classmethod
    def of(cls, loop: Loop) -> "Heights":
        """Heights with torques in units of the joints' own (Plant.units)."""
        return cls(loop, np.ones(1) if loop.parts is None else loop.parts.plant.units)

    @cached_property
    def _unsampled(self) -> Loop | None:
        """Plant and drives in continuous time; None where nothing is sampled."""
        parts = self.loop.parts
        if parts is None or self.loop.sample_time is None:
            return None
        return Loop(self.loop.size, None, delays=parts.delays, parts=replace(parts, sample_time=None))

    def at(self, omega: Floats) -> Floats:
        """Largest singular value (k,) [1/s] of the weighted T at omega (k,) [rad/s], aliases of a sampled loop included."""
        return self.scaled(omega, self.without_aliases(omega) if self._unsampled is None else self.matrices(omega))

    def without_aliases(self, omega: Floats) -> Complexes:
        """Complementary sensitivity T at the torques, (k, n, n) without weight, at omega (k,) [rad/s]; aliases are not included."""
        loop, s = self.loop, 1j * omega
        if loop.size == 1:
            value = loop.response(omega)
            return (value / (1 + value))[:, None, None]
        returned = loop.control_at(s) @ loop.actuated_at(s)
        return np.linalg.solve(np.eye(loop.size) + returned, returned)

    def matrices(self, omega: Floats) -> Complexes:
        """Matrices (I + D P)⁻¹ D [P_k w_k, for every alias k] (k, n, n·aliases) at omega (k,) [rad/s] of a sampled loop.

        The weights w_k make their largest singular value an upper bound of the gain with P_e in place of P:
        |Σ_k P_k|² ≤ Σ_k |P_k|²/β_k for any β_k > 0 with Σ β_k = 1, whatever the phases.
        """
        loop, s, plant = self.loop, 1j * omega, self._unsampled
        actuated, control = loop.actuated_at(s), loop.control_at(s)
        back = np.linalg.solve(np.eye(loop.size) + control @ actuated, control)
        assert plant is not None
        assert loop.sample_time is not None
        points = omega[:, None] + 2 * math.pi / loop.sample_time * np.arange(-ALIASES, ALIASES + 1)
        parts = plant.actuated_at(1j * np.abs(points.ravel())).reshape(len(omega), -1, loop.size, loop.size)
        parts = np.where(points[:, :, None, None] < 0, parts.conj(), parts)
        sizes = np.linalg.norm(parts, axis=(2, 3))
        with np.errstate(divide="ignore"):
            weights = np.sqrt(sizes.sum(axis=1, keepdims=True) / sizes + (loop.sample_time * points) ** 2 / 32)
        parts = parts * np.where(sizes > 0, weights, 0.0)[:, :, None, None]
        return back @ parts.swapaxes(1, 2).reshape(len(omega), loop.size, -1)

    def scaled(self, omega: Floats, matrices: Complexes) -> Floats:
        """Largest singular value (k,) [1/s] of `matrices` (k, n, n or n·aliases) in the units of this object, times |v|."""
        scaled = matrices * np.tile(self.units, matrices.shape[2] // len(self.units)) / self.units[:, None]
        values = np.linalg.eigvalsh(scaled @ scaled.conj().swapaxes(1, 2))[:, -1]
        return speed(omega, self.loop.sample_time) * np.sqrt(np.maximum(values, 0.0))

    def balanced(self, omega: float) -> "Heights":
        """Copy with other `units`: those that make row and column norms of T at `omega` [rad/s] equal (balancing, Osborne 1960)."""
        loop, s = self.loop, 1j * np.array([omega])
        actuated, control = loop.actuated_at(s), loop.control_at(s)
        size = np.abs(np.linalg.solve(np.eye(loop.size) + control @ actuated, control @ actuated))[0] ** 2
        units = self.units.copy()
        np.fill_diagonal(size, 0.0)
        for _ in range(BALANCED):
            for k in range(loop.size):
                scaled = size * (units / units[:, None]) ** 2
                row, column = float(scaled[k].sum()), float(scaled[:, k].sum())
                if row > 0 and column > 0:
                    units[k] *= (row / column) ** 0.25
        return replace(self, units=units)


def sampled_peak(heights: Heights, step: float | None) -> Peak:
    """Peak for several loops, or one given as a callable, by refined samples up to half of the rate 1/`step`: never certified.

    For several loops the units are balanced at the peak, and the peak is searched again, as long as it falls.
    """
    loop, omega = heights.loop, _first_samples(heights.loop, step)
    matrices = heights.without_aliases(omega)
    if not heights.scaled(omega, matrices).any():
        return Peak(0.0, math.nan, False, heights.units)
    height, place = _peak(heights, omega, heights.scaled(omega, matrices))
    for _ in range(ROUNDS if loop.size > 1 else 0):
        other = heights.balanced(place)
        lower, there = _peak(other, omega, other.scaled(omega, matrices))
        little = lower > 0.99 * height
        if lower < height:
            heights, height, place = other, lower, there
        if little:
            break
    return Peak(height, place, False, heights.units)


def _peak(heights: Heights, omega: Floats, value: Floats) -> tuple[float, float]:
    """Height [1/s] and frequency [rad/s] of the highest peak, from samples `value` (k,) at omega (k,) that leave aliases out.

    Samples are added where neighbours differ much. Every local maximum that could be the highest once aliases are included is polished
    with them.
    """
    while len(omega) < MOST_SAMPLES:
        high = np.maximum(value[1:], value[:-1]) > 0.5 * value.max()
        with np.errstate(divide="ignore", invalid="ignore"):
            rough = np.abs(np.diff(np.log(value))) > LARGEST_RISE
        rough &= high & (np.diff(omega) > LEAST_DISTANCE * omega[1:])
        if not rough.any():
            break
        more = 0.5 * (omega[1:] + omega[:-1])[rough]
        omega, value = np.append(omega, more), np.append(value, heights.scaled(more, heights.without_aliases(more)))
        order = np.argsort(omega)
        omega, value = omega[order], value[order]
    beside = np.concatenate([[-math.inf], value, [-math.inf]])
    raised = value * (1 + RAISED * (omega * (heights.loop.sample_time or 0.0) / (2 * math.pi)) ** 2)
    tops = np.flatnonzero((value >= beside[:-2]) & (value >= beside[2:]) & (raised >= 0.99 * value.max()))
    last = len(omega) - 1
    return max(_polished(heights.at, float(omega[max(top - 1, 0)]), float(omega[min(top + 1, last)]), ROUGHLY) for top in tops.tolist())


def _polished(height: Callable[[Floats], Floats], low: float, high: float, flat: float = FLAT) -> tuple[float, float]:
    """Largest `height` on [low, high] [rad/s] and its frequency, by ever narrower grids, to a relative width `flat` in frequency."""
    best = (-math.inf, low)
    while True:
        omega = np.linspace(low, high, FINER)
        value = height(omega)
        top = int(np.argmax(value))
        best = max(best, (float(value[top]), float(omega[top])))
        if high - low <= flat * high:
            return best
        low, high = float(omega[max(top - 1, 0)]), float(omega[min(top + 1, FINER - 1)])


def _first_samples(loop: Loop, step: float | None) -> Floats:
    """Frequencies (k,) [rad/s] at which the search begins: all orders of magnitude up to π/`step`, and denser around every resonance."""
    if loop.function is not None:
        return np.geomspace(1e-3, 1e6, 9 * SAMPLES_PER_DECADE)
    roots = np.concatenate([loop.corner_frequencies.poles, loop.corner_frequencies.zeros])
    sizes = np.abs(roots[roots != 0])
    delay = 0.0 if loop.parts is None else float(loop.parts.delays.max(initial=0.0))
    sizes = np.append(sizes, 1 / delay if delay else [])
    last = math.inf if step is None else math.pi / step
    low, high = (float(sizes.min()), float(sizes.max())) if len(sizes) else (1.0, 1.0)
    high = min(100 * high, last)
    low = min(0.01 * low, 0.01 * high)
    grid = [np.geomspace(low, high, 2 + round(SAMPLES_PER_DECADE * math.log10(high / low)))]
    swinging = roots[np.imag(roots) > 0]
    center = np.imag(swinging)
    center = center if math.isinf(last) else np.abs((center + last) % (2 * last) - last)
    width = np.maximum(np.abs(np.real(swinging)), 1e-4 * center)
    grid.append((center[:, None] + width[:, None] * AROUND).ravel())
    omega = distinct(np.concatenate(grid))
    return omega[(omega >= low) & (omega <= high)]
