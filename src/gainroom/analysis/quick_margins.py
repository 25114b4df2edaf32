"""A quick look at the margins that requirements bound, for searches: the least of each, not certified (see coupled_margins.py).

Found between samples that are refined until neighbours differ little; then what may be the least is polished, so that gains that are said
to meet a requirement meet it to the last digits when they are examined again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ..system.loop import Loop
from ..system.requirements import Requirements
from .first_crossing import Family, gains, height, phases, slope
from .loci import Sweep
from .margin_record import GainLimit, Margins, OneLoop
from .sampled_curves import meets_axis, meets_circle, on_axis, peaks, polished_peaks
from .stability_boundary import LOCI, in_blocks


@dataclass(frozen=True)
class Closeness:
    """What a quick look polishes."""

    real: float = 0.01  # share of imaginary part that a value next to the end of the boundary may have
    # relative: crossings and peaks whose interpolated margins are that near the least one are polished
    close: float = 0.05
    # [rad, or of ln g] the same, of margins so small that interpolation is off by more than that part of them
    slack: float = 0.01
    before: float = 1e-3  # of the way to a margin: as near to it roots are counted
    highest: float = 100.0  # factor on all gains up to which loci are followed, or further where a requirement asks for it


QUICK = Closeness()


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


class Peak(NamedTuple):
    """The largest |S_ii|, or what is asked for, and where [rad/s]."""

    height: float
    omega: float


@dataclass(frozen=True)
class Sampled:
    """A loop along the stability boundary: its loci, each return ratio ℓ_i with the other loops closed, and S_ii (k, n) at the same ω."""

    sweep: Sweep
    single: Curves
    sensitivity: Complexes
    sensitivity_at: Callable[[Floats], Complexes]

    @classmethod
    def of(cls, sweep: Sweep) -> "Sampled":
        """From the samples of its loci, refined around peaks of S_ii. Raises LinAlgError where I + L is singular at a sample."""

        def sensitivity(omega: Floats) -> Complexes:
            return in_blocks(lambda part: _own_sensitivity(sweep.loop, part), omega, sweep.loop.size)

        omega, values = _resolved(sweep, sensitivity)
        return cls(sweep, Curves(omega, _return_ratio(values), lambda omega: _return_ratio(sensitivity(omega))), values, sensitivity)

    def peak(self, slope: float = 1.0, offset: float = 0.0) -> Peak:
        """The largest |slope S_ii + offset|."""
        omega, sizes = self.single.omega, np.abs(slope * self.sensitivity + offset)
        rows, joints = peaks(sizes, (1 - QUICK.close) * sizes.max())
        among = np.arange(len(rows)), joints
        place, height = polished_peaks(omega, sizes, rows, joints, lambda omega: np.abs(slope * self.sensitivity_at(omega) + offset)[among])
        row = int(np.argmax(sizes.max(axis=1)))
        return max([Peak(float(sizes[row].max()), float(omega[row])), *map(Peak, height.tolist(), place.tolist())])

    def ends(self) -> list[tuple[float, Complexes | Floats, Complexes]]:
        """Where the boundary ends and values may be real: ω, the loci that matter there, and every return ratio (n,)."""
        loop, found = self.sweep.loop, []
        if loop.sample_time is not None:  # at half the sample rate
            found.append((float(self.single.omega[-1]), self.sweep.loci[-1], self.single.values[-1]))
        if loop.parts is not None and loop.parts.plant.gravity_stiffness is not None:  # where gravity topples
            rest = 1e-6 * self.single.omega[:1]
            found.append((float(rest[0]), self.sweep.at_rest(), self.single.at(rest)[0]))
        return found


def quick_margins(loop: Loop) -> Margins:
    """The gain and phase margins and the peak sensitivity, of a loop built from parts, n >= 1; the rest is NaN.

    Gains: the lesser of the factors up and down stands under both names, and the least over all loops for each. Nothing is known, so
    that no requirement is met, where the loci cannot be followed.
    """
    return quick_look(loop)[0]


def quick_look(loop: Loop, required: Requirements | None = None) -> tuple[Margins, Sampled | None]:
    """`quick_margins`, and the samples behind them of a loop that is stable (required_margins in margins.py: where these do not tell)."""
    asked = required.asked_for if required is not None else ()
    found, sampled = _look(loop, max([QUICK.highest, *(one.reach(needed) for one, needed in asked)]))
    if sampled is None:
        return found, None
    for one, _ in asked:
        if math.isnan(one.value(found)):
            found = replace(found, **one.sampled(sampled))
    return found, sampled


def _look(loop: Loop, highest: float) -> tuple[Margins, Sampled | None]:
    sweep = Sweep(loop, highest)
    count = sweep.unstable(1.0)
    if count > 0 or sweep.full or count < 0:
        return Margins.unknown(GainLimit.unknown(loop.size, stable=count <= 0)), None
    try:
        sampled = Sampled.of(sweep)
        peak = sampled.peak()
        ends = [(_factor_of_real(loci), _factor_of_real(ratios)) for _, loci, ratios in sampled.ends()]
        common = min([_common_factor(sweep), *(one for one, _ in ends)])
        single = min([_own_factors(sampled.single), *(one for _, one in ends)])
        phase, one_phase = _common_phase(sweep), float(own_phases(sampled.single, each=False).min())
    except np.linalg.LinAlgError:  # a root on the boundary, to the last digit
        return Margins.unknown(GainLimit.unknown(loop.size, stable=False)), None
    factor, every = math.exp(common), np.full(loop.size, math.exp(single))
    limit = replace(GainLimit.unknown(loop.size), gain=factor, lower_gain=1 / factor)
    one_loop = OneLoop(every, 1 / every, np.full(loop.size, one_phase), np.zeros(loop.size, dtype=bool))
    return Margins(limit, one_loop, phase_margin=phase, peak_sensitivity=peak.height, peak_sensitivity_frequency=peak.omega), sampled


def _own_sensitivity(loop: Loop, omega: Floats) -> Complexes:
    """The diagonal of (I + L)⁻¹ (k, n)."""
    response = loop.response(omega).reshape(len(omega), loop.size, loop.size)
    return np.diagonal(np.linalg.inv(np.eye(loop.size) + response), axis1=1, axis2=2)


def _return_ratio(sensitivity: Complexes) -> Complexes:
    """ℓ_i of loop i with the other loops closed: 1 + ℓ_i = 1/S_ii."""
    return 1 / np.where(sensitivity == 0, 1e-300, sensitivity) - 1


def _resolved(sweep: Sweep, sensitivity: Callable[[Floats], Complexes]) -> tuple[Floats, Complexes]:
    """ω (k,) and the sensitivities (k, n) along the boundary, refined around their peaks."""
    omega = sweep.omega
    values = sensitivity(omega)
    for _ in range(10):
        move = np.abs(np.diff(values, axis=0)).max(axis=1)
        rough = np.flatnonzero((move > 0.1) & (np.diff(omega) > 1e-7 * omega[1:]))
        if not len(rough) or len(omega) > LOCI.most:
            break
        middle = 0.5 * (omega[rough] + omega[rough + 1])
        values = np.insert(values, rough + 1, sensitivity(middle), axis=0)
        omega = np.insert(omega, rough + 1, middle)
    return omega, values


def _near_least(sizes: Floats) -> Booleans:
    """True for what may be the least when it is polished."""
    return sizes <= sizes.min(initial=math.inf) * (1 + QUICK.close) + QUICK.slack


def _own_factors(single: Curves) -> float:
    """The smallest |ln g| at which g times one loop's gains make it vibrate."""
    rows, joints, _, value = meets_axis(single.values[:-1], single.values[1:])
    chosen = _near_least(np.abs(np.log(-value)))
    value = single.on_axis(rows[chosen], joints[chosen]).real
    return float(np.abs(np.log(-value[value < 0])).min(initial=math.inf))


def own_phases(single: Curves, each: bool = True) -> Floats:
    """(n,) the smallest phase [rad] at which each loop vibrates; `each` False: inf but for those that may be the least of all."""
    rows, joints, _, lag = meets_circle(single.values[:-1], single.values[1:])
    least = np.full(single.values.shape[1], math.inf)
    np.minimum.at(least, joints, np.abs(lag))
    chosen = np.abs(lag) <= (least[joints] if each else least.min()) * (1 + QUICK.close) + QUICK.slack

    def bent(value: Complexes) -> Complexes:
        """On the real axis, at its lag, where the value is on the unit circle."""
        return np.angle(-value) + 1j * np.log(np.maximum(np.abs(value), 1e-300))

    least[:] = math.inf
    np.minimum.at(least, joints[chosen], np.abs(single.on_axis(rows[chosen], joints[chosen], bent).real))
    return least


def _common_factor(sweep: Sweep) -> float:
    """The smallest |ln g| at which g times all gains make them vibrate."""
    steps = sweep.steps()
    rows, _, share, value = meets_axis(steps.start, steps.end)
    chosen = _near_least(np.abs(np.log(-value)))
    omega = (sweep.omega[rows] + share * (sweep.omega[rows + 1] - sweep.omega[rows]))[chosen]
    value = value[chosen]
    found = _polished(sweep, omega, value.astype(complex), slope, lambda value: np.log(-value.real))
    for way in (1, -1) if found < math.log(sweep.highest) else ():
        found = abs(math.log(_counted(gains(sweep), 1.0, math.exp(way * found))))
    return found


def _counted(family: Family, start: float, end: float) -> float:
    """`end`, or where the first root crosses before it: of two crossings close together polishing may find one twice."""
    before = end + QUICK.before * (start - end)
    if family.count(before) == 0:
        return end
    first = family.end(start, before)
    return end if first is None or abs(first.at - start) > abs(end - start) else first.at


def _common_phase(sweep: Sweep) -> float:
    """The smallest phase [rad] at which all loops together vibrate."""
    steps = sweep.steps()
    rows, _, share, lag = meets_circle(steps.start, steps.end)
    chosen = _near_least(np.abs(lag))
    omega = (sweep.omega[rows] * (sweep.omega[rows + 1] / sweep.omega[rows]) ** share)[chosen]
    found = _polished(sweep, omega, -np.exp(1j * lag[chosen]), height, lambda value: np.angle(-value))
    for way in (1, -1) if found < math.pi else ():
        found = _counted(phases(sweep, way), 0.0, found)
    return found


def _polished(
    sweep: Sweep, omega: Floats, wanted: Complexes, zero: Callable[[Complexes], Floats], margin: Callable[[Complexes], Floats]
) -> float:
    """The smallest |margin| of the loci that are about `wanted` at `omega`, where `zero` of them is 0."""
    _, value = sweep.boundary.crossings(omega, wanted, zero)
    near = np.abs(value / wanted - 1) < 0.5  # else it went astray, and what was interpolated stands
    value = np.where(near, value, wanted)
    return float(np.abs(margin(value)).min(initial=math.inf))


def _factor_of_real(values: Complexes | Floats) -> float:
    """The smallest |ln g| with −1/g among the values that are real."""
    real = np.real(values[np.abs(np.imag(values)) < QUICK.real * np.abs(values)])
    return float(np.abs(np.log(-real[real < 0])).min(initial=math.inf))
