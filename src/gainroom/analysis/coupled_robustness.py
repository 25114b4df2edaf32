"""What several coupled loops keep of gain, phase and sensitivity: all together, and each with the others closed.

Found between samples that are refined until neighbours differ little; then what may be the least is polished, so that gains that are said
to keep a margin keep it to the last digits when they are looked at again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ..system.loop import Loop
from ..system.requirements import Requirements
from .coupled_margins import on_axis
from .first_crossing import NUDGE, Family, gains, phases
from .loci import MOST, Sweep, in_blocks

REAL = 0.01  # share of imaginary part that a value next to the end of the boundary may have
CLOSE = 0.05  # relative: crossings and peaks whose interpolated margins are that near the least one are polished
SLACK = 0.01  # [rad, or of ln g] the same, of margins so small that interpolation is off by more than that part of them
ROUNDS = 4  # of parabolas about a peak, of which each finds about half as many digits again


@dataclass(frozen=True)
class Kept:
    """What one coupled loop keeps: all loops together, and each with the others closed.

    gain_margin       the smallest factor > 1, up or down, on all gains or on those of one loop, that makes it vibrate
    phase_margin      [rad] the same for a phase: the lesser of the last two, which requirements go by
    peak_sensitivity  the largest |S_ii| of S = (I + L)⁻¹, the peak sensitivity of loop i with the others closed
    common_phase      [rad] the phase in all loops at once: "phase margin" wherever numbers are shown
    single_phase      [rad] the least phase in one loop, the others closed: "phase, one loop"
    """

    stable: bool
    gain_margin: float
    phase_margin: float
    peak_sensitivity: float
    common_phase: float = math.nan
    single_phase: float = math.nan

    def named(self, name: str) -> str:
        """What the requirement `name` is held against here, in words: "phase margin of one loop" where that is the lesser."""
        words = name.replace("_", " ")
        return f"{words} of one loop" if name == "phase_margin" and self.single_phase < self.common_phase else words

    def meets(self, required: Requirements) -> bool:
        """Whether every requirement holds."""
        return self.stable and all(required.met(name, getattr(self, name)) for name in required.asked)

    def missed(self, required: Requirements) -> str:
        """The name of what is missed most: a field of Requirements, or "stability"; "" where nothing is."""
        if not self.stable:
            return "stability"
        short = self._shortfalls(required)
        return max((name for name in short if not required.met(name, getattr(self, name))), key=lambda name: short[name], default="")

    def shortfall(self, required: Requirements) -> float:
        """By how much the requirement that is missed most is missed: in ln of a gain or a sensitivity, or as part of a phase.

        Negative where all is kept; inf where unstable, or nothing is known.
        """
        worst = max(self._shortfalls(required).values(), default=-math.inf)
        return worst if self.stable else math.inf

    def _shortfalls(self, required: Requirements) -> dict[str, float]:
        asked = {name: getattr(required, name) for name in required.asked}
        kept = {name: getattr(self, name) for name in asked}
        found = {
            name: 1 - kept[name] / asked[name]
            if name == "phase_margin"
            else (1 if name == "peak_sensitivity" else -1) * (math.log(kept[name]) - math.log(asked[name]))
            for name in asked
        }
        return {name: math.inf if math.isnan(value) else value for name, value in found.items()}


UNSTABLE = Kept(False, math.nan, math.nan, math.nan)
UNKNOWN = Kept(True, math.nan, math.nan, math.nan)
"""Of a loop whose loci could not be followed: nothing that is required counts as kept."""


@dataclass(frozen=True)
class Curves:
    """m scalar curves: `values` (k, m) at `omega` (k,), and how to find more."""

    omega: Floats
    values: Complexes
    at: Callable[[Floats], Complexes]

    def on_axis(self, rows: Integers, joints: Integers, bent: Callable[[Complexes], Complexes] = lambda value: value) -> Complexes:
        """Where `bent` of curves `joints` crosses the real axis between samples `rows` and the next."""
        low, high = ((self.omega[at], bent(self.values[at, joints])) for at in (rows, rows + 1))
        return on_axis(lambda omega: bent(self.at(omega)), joints, low, high)[1]


@dataclass(frozen=True)
class Seen:
    """What it takes to see what a loop keeps: its loci, each loop's return ratio with the others closed, and its `sensitivity` (k, n)."""

    sweep: Sweep
    single: Curves
    sensitivity: Complexes

    def ends(self) -> list[tuple[float, Complexes | Floats, Complexes]]:
        """Where the boundary ends and values may be real: ω, the loci that matter there, and every return ratio (n,)."""
        loop, found = self.sweep.loop, []
        if loop.sample_time is not None:  # at half the sample rate
            found.append((float(self.single.omega[-1]), self.sweep.loci[-1], self.single.values[-1]))
        if loop.parts is not None and loop.parts.plant.gravity_stiffness is not None:  # where gravity topples
            rest = 1e-6 * self.single.omega[:1]
            found.append((float(rest[0]), self.sweep.at_rest(), self.single.at(rest)[0]))
        return found


def kept_by(loop: Loop) -> Kept:
    """What a coupled loop keeps, from its loci and from each loop's return ratio with the others closed."""
    return kept_where(loop)[0]


def kept_where(loop: Loop) -> tuple[Kept, "Seen | None"]:
    """`kept_by`, and what was seen of a loop that is stable."""
    sweep = Sweep(loop)
    unstable = sweep.unstable(1.0)
    if unstable > 0:
        return UNSTABLE, None
    if sweep.full or unstable < 0:
        return UNKNOWN, None

    def sensitivity(omega: Floats) -> Complexes:
        return in_blocks(lambda part: _own_sensitivity(loop, part), omega, loop.size)

    try:
        omega, values = _resolved(sweep, sensitivity)
        seen = Seen(sweep, Curves(omega, _return_ratio(values), lambda omega: _return_ratio(sensitivity(omega))), values)
        peak = _peak(omega, values, sensitivity)
        factors = [_all_factors(sweep), _own_factors(seen.single)] + [_factor_of_real(ends) for _, *both in seen.ends() for ends in both]
        lags = [_all_phases(sweep), _own_phases(seen.single)]
    except np.linalg.LinAlgError:  # a root on the boundary, to the last digit
        return UNSTABLE, None
    return Kept(True, math.exp(min(factors)), min(lags), peak, *lags), seen


def _own_sensitivity(loop: Loop, omega: Floats) -> Complexes:
    """The diagonal of (I + L)⁻¹ (k, n)."""
    response = loop.response(omega).reshape(len(omega), loop.size, loop.size)
    return np.diagonal(np.linalg.inv(np.eye(loop.size) + response), axis1=1, axis2=2)


def _return_ratio(sensitivity: Complexes) -> Complexes:
    """ℓ_i of loop i with the others closed: 1 + ℓ_i = 1/S_ii."""
    return 1 / np.where(sensitivity == 0, 1e-300, sensitivity) - 1


def _resolved(sweep: Sweep, sensitivity: Callable[[Floats], Complexes]) -> tuple[Floats, Complexes]:
    """ω (k,) and the sensitivities (k, n) along the boundary, refined around their peaks."""
    omega = sweep.omega
    values = sensitivity(omega)
    for _ in range(10):
        move = np.abs(np.diff(values, axis=0)).max(axis=1)
        rough = np.flatnonzero((move > 0.1) & (np.diff(omega) > 1e-7 * omega[1:]))
        if not len(rough) or len(omega) > MOST:
            break
        middle = 0.5 * (omega[rough] + omega[rough + 1])
        values = np.insert(values, rough + 1, sensitivity(middle), axis=0)
        omega = np.insert(omega, rough + 1, middle)
    return omega, values


def _peak(omega: Floats, values: Complexes, sensitivity: Callable[[Floats], Complexes]) -> float:
    """The largest |S_ii|."""
    sizes = np.abs(values)
    rows, joints = peaks(sizes, (1 - CLOSE) * sizes.max())
    _, height = polished_peaks(omega, sizes, rows, joints, lambda omega: np.abs(sensitivity(omega))[np.arange(len(rows)), joints])
    return max(float(sizes.max()), float(height.max(initial=0.0)))


def polished_peaks(
    omega: Floats, sizes: Floats, rows: Integers, columns: Integers, at: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    """ω and height (k,) of peaks seen in samples: again and again where the parabola through three points about each has its top."""
    place, height = (np.array([part[rows + k] for k in (-1, 0, 1)]) for part in (omega, sizes))
    height = height[:, np.arange(len(rows)), columns]
    for _ in range(ROUNDS if len(rows) else 0):
        top = _top_of_parabola(place, height)
        found = at(top)
        higher, after = found >= height[1], top > place[1]
        for part, new in ((place, top), (height, found)):
            low, middle, high = part.copy()
            part[0] = np.where(higher, np.where(after, middle, low), np.where(after, low, new))
            part[1] = np.where(higher, new, middle)
            part[2] = np.where(higher, np.where(after, high, middle), np.where(after, new, high))
    return place[1], height[1]


def peaks(sizes: Floats, least: float) -> tuple[Integers, Integers]:
    """Samples (k, n) above `least` that are no lower than those beside them: row, which is neither the first nor the last, and column."""
    inner = sizes[1:-1]
    rows, columns = np.nonzero((inner >= sizes[:-2]) & (inner >= sizes[2:]) & (inner > least))
    return rows + 1, columns


def _top_of_parabola(place: Floats, height: Floats) -> Floats:
    """(k,) where the parabolas through three points, (3, k), of which the middle one is highest, have their tops."""
    (low, middle, high), (before, after) = place, np.diff(height, axis=0) / np.maximum(np.diff(place, axis=0), 1e-300)
    bend = before - after
    share = np.divide(before, bend, out=np.full(len(bend), 0.5), where=bend > 0)
    return np.clip(0.5 * (low + middle) + 0.5 * (high - low) * share, low, high)


def _near_least(sizes: Floats) -> Booleans:
    """True for what may be the least when it is polished."""
    return sizes <= sizes.min(initial=math.inf) * (1 + CLOSE) + SLACK


def _own_factors(single: Curves) -> float:
    """The smallest |ln g| at which g times one loop's gains make it vibrate."""
    rows, joints, _, value = meets_axis(single.values[:-1], single.values[1:])
    chosen = _near_least(np.abs(np.log(-value)))
    value = single.on_axis(rows[chosen], joints[chosen]).real
    return float(np.abs(np.log(-value[value < 0])).min(initial=math.inf))


def _own_phases(single: Curves) -> float:
    """The smallest phase [rad] at which one loop vibrates."""
    rows, joints, _, lag = meets_circle(single.values[:-1], single.values[1:])
    chosen = _near_least(np.abs(lag))

    def bent(value: Complexes) -> Complexes:
        """On the real axis, at its lag, where the value is on the unit circle."""
        return np.angle(-value) + 1j * np.log(np.maximum(np.abs(value), 1e-300))

    return float(np.abs(single.on_axis(rows[chosen], joints[chosen], bent).real).min(initial=math.inf))


def _all_factors(sweep: Sweep) -> float:
    """The smallest |ln g| at which g times all gains make them vibrate."""
    steps = sweep.steps()
    rows, _, share, value = meets_axis(steps.start, steps.end)
    chosen = _near_least(np.abs(np.log(-value)))
    omega = (sweep.omega[rows] + share * (sweep.omega[rows + 1] - sweep.omega[rows]))[chosen]
    value = value[chosen]
    found = _polished(sweep, omega, value.astype(complex), lambda value: value.imag / value.real, lambda value: np.log(-value.real))
    for way in (1, -1) if found < math.log(sweep.highest) else ():
        found = abs(math.log(_counted(gains(sweep), 1.0, math.exp(way * found))))
    return found


def _counted(family: Family, start: float, end: float) -> float:
    """`end`, or where the first root crosses before it: of two crossings close together polishing may find one twice."""
    first = family.end(start, end + NUDGE * (start - end))
    return end if first is None or abs(first.at - start) > abs(end - start) else first.at


def _all_phases(sweep: Sweep) -> float:
    """The smallest phase [rad] at which all loops together vibrate."""
    steps = sweep.steps()
    rows, _, share, lag = meets_circle(steps.start, steps.end)
    chosen = _near_least(np.abs(lag))
    omega = (sweep.omega[rows] * (sweep.omega[rows + 1] / sweep.omega[rows]) ** share)[chosen]
    found = _polished(sweep, omega, -np.exp(1j * lag[chosen]), lambda value: np.log(np.abs(value)), lambda value: np.angle(-value))
    for way in (1, -1) if found < math.pi else ():
        found = _counted(phases(sweep, way), 0.0, found)
    return found


def _polished(
    sweep: Sweep, omega: Floats, wanted: Complexes, height: Callable[[Complexes], Floats], margin: Callable[[Complexes], Floats]
) -> float:
    """The smallest |margin| of the loci that are about `wanted` at `omega`, where their `height` is zero."""
    _, value = sweep.boundary.crossings(omega, wanted, height)
    near = np.abs(value / wanted - 1) < 0.5  # else it went astray, and what was interpolated stands
    value = np.where(near, value, wanted)
    return float(np.abs(margin(value)).min(initial=math.inf))


def meets_axis(start: Complexes, end: Complexes) -> tuple[Integers, Integers, Floats, Floats]:
    """Steps (k, m) that cross the negative real axis: row, column, which share of ω in, and where, interpolated."""
    rows, columns = np.nonzero((start.imag > 0) != (end.imag > 0))
    start, end = start[rows, columns], end[rows, columns]
    share = start.imag / (start.imag - end.imag)
    value = (start + share * (end - start)).real
    found = value < 0
    return rows[found], columns[found], share[found], value[found]


def meets_circle(start: Complexes, end: Complexes) -> tuple[Integers, Integers, Floats, Floats]:
    """Steps (k, m) that cross the unit circle: row, column, which share of ln ω in, and arg(−λ) there, interpolated."""
    low, high = (np.log(np.maximum(np.abs(value), 1e-300)) for value in (start, end))
    rows, columns = np.nonzero((low > 0) != (high > 0))
    low, high, start, end = (each[rows, columns] for each in (low, high, start, end))
    share = low / (low - high)
    lag = np.angle(-start) + share * np.angle(end * start.conj())  # size and direction change evenly where curves are powers of ω
    return rows, columns, share, np.angle(np.exp(1j * lag))


def _factor_of_real(values: Complexes | Floats) -> float:
    """The smallest |ln g| with −1/g among the values that are real."""
    real = np.real(values[np.abs(np.imag(values)) < REAL * np.abs(values)])
    return float(np.abs(np.log(-real[real < 0])).min(initial=math.inf))
