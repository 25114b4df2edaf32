"""The return ratio of one joint in boxes of frequency and uncertain parameters: a sector that contains L everywhere in each box.

The plant is written with ν, the frequency over the resonance √(K (1/J_m + 1/J_l)), so that a resonance stands still while the parameters
move, with y = 1 + jωB/K and the friction of motor and link, D_m and D_l:

    P_M = (y − ν² c (1 − j D_l/(J_l ω))) / −ω (J_m + J_l) R,   c = (J_m + J_l)/J_m;   link side: y in place of the numerator
    R   = ω (y − ν²) − j y (D_m + D_l)/(J_m + J_l) + jν² (D_m/J_m + D_l/J_l) + (ν²/ω) (D_m/J_m) (D_l/J_l)

Sampled behind a hold, L(e^{jωT_s}) = D (1 − e^{−jωT_s})/T_s · Σ_k G(jω_k)/(jω_k) with ω_k = ω + 2πk/T_s and G = P C e^{−sT}: a few
terms beside k = 0 are added up, all further ones bounded. log|L| and arg L in a box: their values at its middle, and the largest slopes
anywhere in it (mean value theorem).
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..system.assembly import Feedback, current_loop
from ..system.drive import Drive
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.transfer_function import Factored
from ..system.plant import ElasticJoint
from ..system.uncertainty import Uncertainty
from ._balls import Ball, Disc, constant, gathered, inverse, is_number, plus, times, turned

FEWEST_ALIASES, MOST_ALIASES = 3, 24
TURN = 2 * math.pi
SECTOR_ROUNDING = 1e-11  # of log|L| and arg L: far above that of some fifty operations in doubles


@dataclass(frozen=True)
class Sectors:
    """What L can be in each of n boxes: log|L| and arg L between two values, the latter up to full turns.

    center   (n,) L in the middle of each box
    score    (n, p) how much each parameter's width moves L: the widest is split first
    """

    log_low: Floats
    log_high: Floats
    phase_low: Floats
    phase_high: Floats
    center: Complexes
    score: Floats

    def apart(self) -> Floats:
        """By how much, at least, arg L differs from that of −1; 0 where it may be the same."""
        nearest = math.pi * (2 * np.floor((self.phase_low + self.phase_high) / (4 * math.pi)) + 1)
        return np.maximum(0.0, np.maximum(self.phase_low - nearest, nearest - self.phase_high))


class BoxLoop:
    """One joint's loop over ranges. `names`: the parameters beside the frequency, which is number 0, in the order of the boxes."""

    def __init__(
        self, joint: ElasticJoint, drive: Drive, uncertainty: Uncertainty, controller: Any, feedback: Feedback, sample_time: float | None
    ) -> None:
        self.feedback, self.sample_time = feedback, sample_time
        self.nominal = {name: getattr(joint, name) for name in ("motor_inertia", "link_inertia", "stiffness", "damping")}
        self.nominal["delay"] = drive.delay
        self.viscous = float(joint.motor_viscous), float(joint.link_viscous)
        self.ranges = {name: getattr(uncertainty, name) for name in uncertainty.names}
        self.nominal |= {name: low for name, (low, high) in self.ranges.items() if low == high}
        self.names = tuple(name for name, (low, high) in self.ranges.items() if low < high)
        self.low = np.array([self.ranges[name][0] for name in self.names])
        self.high = np.array([self.ranges[name][1] for name in self.names])
        self.rigid, self.locked = math.isinf(joint.stiffness), math.isinf(joint.link_inertia)
        self.currents = replace(current_loop(drive), delay=0.0)
        self.control = controller.transfer(sample_time)
        self.aliases = 0 if sample_time is None else self._aliases()

    def _ends(self, name: str) -> tuple[float, float]:
        return self.ranges.get(name, (self.nominal[name], self.nominal[name]))

    @property
    def nyquist(self) -> float | None:
        """Half the sample rate [rad/s]; None in continuous time."""
        return None if self.sample_time is None else math.pi / self.sample_time

    def resonances_in(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Lowest and highest resonance [rad/s] within each box, as `at` takes them; for an elastic joint."""
        ends = []
        for soft, heavy in ((low, high), (high, low)):
            inverse_inertia = 1 / self._end("motor_inertia", heavy) + 1 / self._end("link_inertia", heavy)
            ends.append(np.sqrt(self._end("stiffness", soft) * inverse_inertia))
        return ends[0], ends[1]

    def _end(self, name: str, corners: Floats) -> Any:
        return corners[:, 1 + self.names.index(name)] if name in self.names else self.nominal[name]

    @property
    def resonances(self) -> tuple[float, float]:
        """Lowest and highest resonance [rad/s] within the ranges; (inf, inf) for a rigid joint."""
        ends = [self._ends(name) for name in ("stiffness", "motor_inertia", "link_inertia")]
        (soft, stiff), (light, heavy), (least, most) = ends
        if self.rigid:
            return math.inf, math.inf
        return math.sqrt(soft * (1 / heavy + 1 / most)), math.sqrt(stiff * (1 / light + 1 / least))

    def roll_off(self, omega: float) -> float:
        """A bound of |P C| at `omega` [rad/s] that also holds at every ω beyond, times (omega/ω)²; inf where there is none yet."""
        (soft, _), (light, _), (least, most), (_, lossy) = (
            self._ends(name) for name in ("stiffness", "motor_inertia", "link_inertia", "damping")
        )
        plant = 1 / (omega**2 * (light + (0.0 if self.locked else least)))
        if not self.rigid:
            swing = (omega / self.resonances[1]) ** 2
            spring = math.hypot(1.0, omega * lossy / soft) / swing
            motor, link = self.viscous
            held = spring if self.locked else spring * math.hypot(1.0, (motor + link) / (omega * (light + least)))
            if held >= 0.9:
                return math.inf
            above = 1.0 if self.locked else spring
            if self.feedback == "motor" and not self.locked:
                above += (1 + most / light) * math.hypot(1.0, link / (omega * least))
            plant *= above / (1 - held)
        return plant * _beyond(self.currents, omega)

    def silent_above(self, size: float) -> float:
        """A frequency [rad/s] beyond which |L| < `size` everywhere in the ranges; continuous time."""
        omega = 2 * max([1.0, *np.abs(np.concatenate([self.currents.poles, self.control.zeros, self.control.poles])).tolist()])
        for _ in range(200):
            if self.roll_off(omega) * _beyond(self.control, omega) < size:
                return omega
            omega *= 2
        return math.inf

    @property
    def boundable(self) -> bool:
        """Whether what lies beyond the frequencies looked at is bounded."""
        return self.aliases > 0 if self.sample_time is not None else math.isfinite(self.silent_above(1e-3))

    def _aliases(self) -> int:
        """Number of terms of the sum to either side that are added up; 0 where the rest cannot be bounded."""
        assert self.sample_time is not None
        rate = TURN / self.sample_time
        counts = range(FEWEST_ALIASES, MOST_ALIASES + 1)
        return next((count for count in counts if math.isfinite(self.roll_off((count + 0.5) * rate))), 0)

    def at(self, low: Floats, high: Floats, scaled: bool) -> Sectors:
        """Sectors of boxes `low` to `high` (n, p); column 0: ω [rad/s], or ν where `scaled`."""
        with np.errstate(all="ignore"):  # what is not finite stays undecided
            boxes = [Ball.parameter(i, low[:, i], high[:, i]) for i in range(low.shape[1])]
            return self._sectors(self._parts(boxes, scaled), self._parts([Ball((box.disc[0], 0.0)) for box in boxes], scaled))

    def _parts(self, boxes: list[Ball], scaled: bool) -> "_Parts":
        """Of the frequency and the parameters in `names`: what they can be in boxes with their slopes, or numbers."""
        frequency, *ranges = boxes
        values = {name: constant(value, len(frequency.disc[0])) for name, value in self.nominal.items()}
        values |= dict(zip(self.names, ranges, strict=True))
        if self.rigid:
            omega, square = frequency, None
        else:
            compliance = values["motor_inertia"].inverse()
            if not self.locked:
                compliance = compliance + values["link_inertia"].inverse()
            square = values["stiffness"] * compliance
            omega = frequency * square.root() if scaled else frequency
        if square is None:
            swing = over = frequency
        elif scaled:
            swing, over = frequency * frequency, frequency * square.root().inverse()
        else:
            over = omega * square.inverse()
            swing = omega * over
        above, below = self._plant(omega, swing, over, values)
        return _Parts(values, omega, square, above, below)

    def _plant(self, omega: Ball, swing: Ball, over: Ball, values: dict[str, Ball]) -> tuple[list[Ball], list[Ball]]:
        """Factors above and below the line of P: `swing` is ν², `over` ν²/ω."""
        motor, (motor_friction, link_friction) = values["motor_inertia"], self.viscous
        total = motor if self.locked else motor + values["link_inertia"]
        if self.rigid:
            if not motor_friction + link_friction:
                return [], [omega, omega, -1.0 * total]
            return [], [omega, -1.0 * (omega * total) + 1j * (motor_friction + link_friction)]
        spring = 1j * (omega * values["damping"] * values["stiffness"].inverse()) + 1.0
        resisted = spring - swing
        if self.locked:
            if motor_friction:
                resisted = resisted + 1j * motor_friction * (over * motor.inverse())
            return [], [values["stiffness"], resisted]
        if not motor_friction + link_friction:
            below = [omega, omega, -1.0 * total, resisted]
        else:
            on_motor, on_link = motor_friction * motor.inverse(), link_friction * values["link_inertia"].inverse()
            drag = 1j * (swing * (on_motor + on_link) - (motor_friction + link_friction) * (spring * total.inverse()))
            below = [omega, -1.0 * total, omega * resisted + drag + over * on_motor * on_link]
        if self.feedback == "link":
            return [spring], below
        share = total * motor.inverse()
        held = spring - swing * share
        if link_friction:
            held = held + 1j * link_friction * (over * share * values["link_inertia"].inverse())
        return [held], below

    def _others(self, parts: "_Parts", add_rest: bool = True) -> Disc:
        """Disc of Σ_{k≠0} P C(jω_k) (ω/ω_k) e^{−j(ω_k − ω)T}."""
        assert self.sample_time is not None
        rate = TURN / self.sample_time
        values = {name: value.plain() for name, value in parts.values.items()}
        base, square = parts.omega.plain(), None if parts.square is None else parts.square.plain().inverse()
        k = np.array([[sign * step] for step in range(1, self.aliases + 1) for sign in (-1, 1)])  # one row each, beside the boxes
        omega = base + k * rate
        over = omega if square is None else omega * square
        value = _quotient(*self._plant(omega, omega * over, over, values))
        for pole in self.currents.poles:
            value = times(value, inverse((1j * omega.disc[0] - pole, omega.disc[1])))
        value = times(times(value, (self.currents.gain, 0.0)), times(base.disc, inverse(omega.disc)))
        lag = values["delay"].disc
        middle, reach = times(value, turned((-k * rate * lag[0], 0.0 if is_number(lag[1]) else np.abs(k) * rate * lag[1])))
        if not add_rest:
            return middle.sum(axis=0), 0.0
        total = middle.sum(axis=0), reach.sum(axis=0)
        first = (self.aliases + 0.5) * rate  # beyond, |P C|/ω falls at least as 1/ω³
        rest = 2 * self.roll_off(first) / first * (1 + (self.aliases + 0.5) / 2)
        return total[0], total[1] + rest * parts.omega.sizes()[1]

    def _sectors(self, parts: "_Parts", middle: "_Parts") -> Sectors:
        omega, delay = parts.omega, parts.values["delay"]
        slopes = {i: times(slope, (-1j, 0.0)) for i, slope in (omega * delay).slopes.items()}
        for sign, factors in ((1.0, parts.above), (-1.0, parts.below)):
            for factor in factors:
                slopes = gathered(slopes, {i: times((sign, 0.0), slope) for i, slope in factor.log_slopes().items()})
        moved = self._moved(omega)
        slopes = gathered(slopes, {i: times(slope, moved.steep) for i, slope in omega.slopes.items()})
        body = _product(parts.above, parts.below, moved.currents)
        at = middle.omega.disc[0]
        center = _quotient(middle.above, middle.below)[0] * self.currents.response(at)
        hidden = np.zeros(len(at))
        if self.sample_time is not None:
            others, own = self._others(parts), self._others(middle, add_rest=False)[0]
            share = times(others, times(_quotient(parts.below, parts.above), self._inverse_currents(omega)))
            reach = (np.abs(share[0] - own / center) + share[1]) / np.abs(1 + own / center)
            hidden = np.where(reach < 1, -np.log1p(-np.minimum(reach, 1.0)), np.nan)
            most = np.abs(others[0]) + others[1]
            body = np.maximum(body[0] - most, 0.0), body[1] + most
            turns = at * self.sample_time
            center = (center + own) * np.sinc(turns / TURN) * np.exp(-0.5j * turns)
        center = center * np.exp(-1j * at * middle.values["delay"].disc[0]) * self.control.response(at)
        table = np.zeros((3, len(at), 1 + len(self.names)))
        for i, (mid, rad) in slopes.items():
            table[:, :, i] = np.abs(mid.real) + rad, np.abs(mid.imag) + rad, np.abs(mid) + rad
        log_reach, phase_reach = (table[k].sum(axis=1) + hidden + SECTOR_ROUNDING for k in (0, 1))
        log_center, phase = np.log(np.abs(center)), np.angle(center)
        known = np.isfinite(log_center + log_reach + phase_reach)
        log_low, log_high = (np.log(size * other) for size, other in zip(body, moved.control, strict=True))
        log_low, log_high = np.where(np.isnan(log_low), -np.inf, log_low), np.where(np.isnan(log_high), np.inf, log_high)
        score = np.where(known[:, None], table[2], self._rough(parts))
        if self.sample_time is not None and "delay" in self.names:
            reach = TURN / self.sample_time * delay.disc[1]
            score[:, 1 + self.names.index("delay")] += np.minimum(np.where(np.isfinite(hidden), hidden, 1.0), reach)
        return Sectors(
            np.maximum(log_low, np.where(known, log_center - log_reach, -np.inf)),
            np.minimum(log_high, np.where(known, log_center + log_reach, np.inf)),
            np.where(known, phase - phase_reach, 0.0),
            np.where(known, phase + phase_reach, TURN),
            center,
            score,
        )

    def _rough(self, parts: "_Parts") -> Floats:
        """How much each parameter moves the plant's factors, where one of them may be 0."""
        rough = np.zeros((len(parts.omega.disc[0]), 1 + len(self.names)))
        for factor in parts.above + parts.below:
            for i, (mid, rad) in factor.slopes.items():
                rough[:, i] += (np.abs(mid) + rad) / np.maximum(np.abs(factor.disc[0]), 0.1 * factor.disc[1])
        return rough

    def _inverse_currents(self, omega: Ball) -> Disc:
        """Disc of 1/C."""
        value: Disc = (np.full(len(omega.disc[0]), 1 / self.currents.gain, dtype=complex), 0.0)
        for pole in self.currents.poles:
            value = times(value, (1j * omega.disc[0] - pole, omega.disc[1]))
        return value

    def _moved(self, omega: Ball) -> "_Moved":
        """What the parameters do not touch: current loop, controller and hold."""
        mid, rad = omega.disc
        flat = np.ones(len(mid))
        steep: Disc = (0j * flat, 0.0)
        point, moving = (1j * mid, rad), (1j * flat, 0.0)
        along = point, moving
        hold = flat, flat
        if self.sample_time is not None:
            turn = turned((mid * self.sample_time, rad * self.sample_time))
            along = ((turn[0] - 1) / self.sample_time, turn[1] / self.sample_time), times((1j, 0.0), turn)
            ends = [0.5 * self.sample_time * (mid + sign * rad) for sign in (-1, 1)]
            first, last = (0.5 * self.sample_time * _sinc_slope(end) for end in ends)
            steep = (0.5 * (first + last) - 0.5j * self.sample_time, 0.5 * np.abs(first - last))
            hold = np.maximum(np.sinc(ends[1] / math.pi), 0.0), np.sinc(ends[0] / math.pi)
        sizes = []
        for system, (where, change) in ((self.currents, (point, moving)), (self.control, along)):
            low = high = abs(system.gain) * flat
            for sign, roots in ((1.0, system.zeros), (-1.0, system.poles)):
                for root in roots:
                    distance = Ball((where[0] - root, where[1]))
                    steep = plus(steep, times((sign, 0.0), times(change, inverse(distance.disc))))
                    least, most = distance.sizes()
                    low, high = (low * least, high * most) if sign > 0 else (low / most, high / least)
            sizes.append((low, high))
        currents, (low, high) = sizes
        return _Moved(currents, (low * hold[0], high * hold[1]), steep)


@dataclass(frozen=True)
class _Parts:
    """The quantities of n boxes, ω, the resonance squared (None: rigid), and the plant's factors."""

    values: dict[str, Ball]
    omega: Ball
    square: Ball | None
    above: list[Ball]
    below: list[Ball]


@dataclass(frozen=True)
class _Moved:
    """Least and largest |C|, least and largest |D| with the hold, and the slope of the log of all by ω."""

    currents: tuple[Floats, Floats]
    control: tuple[Floats, Floats]
    steep: Disc


def _quotient(above: list[Ball], below: list[Ball]) -> Disc:
    """Disc of a ratio of products."""
    shape = np.broadcast_shapes(*(np.shape(factor.disc[0]) for factor in above + below))
    value: Disc = (np.ones(shape, complex), 0.0)
    for factor in above:
        value = times(value, factor.disc)
    for factor in below:
        value = times(value, inverse(factor.disc))
    return value


def _product(above: list[Ball], below: list[Ball], sizes: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Least and largest |ratio| times `sizes`, also where the disc of a factor holds 0."""
    low, high = sizes
    for factor in above:
        least, most = factor.sizes()
        low, high = low * least, high * most
    for factor in below:
        least, most = factor.sizes()
        low, high = low / most, high / least
    return low, high


def _beyond(system: Factored, omega: float) -> float:
    """A bound of |system(jω)| at `omega` that beyond it falls or grows no quicker than the power of ω of its roots."""
    size = abs(system.gain) * omega ** (len(system.zeros) - len(system.poles))
    for sign, roots in ((1, system.zeros), (-1, system.poles)):
        for root in np.abs(roots).tolist():
            if root >= omega:
                return math.inf
            size *= 1 + root / omega if sign > 0 else 1 / (1 - root / omega)
    return size


def _sinc_slope(half: Floats) -> Floats:
    """d log(sin x/x)/dx in [0, π), which falls; NaN beyond."""
    inside = np.where((half > 1e-4) & (half < math.pi), half, np.nan)
    return np.where(half <= 1e-4, -half / 3, 1 / np.tan(inside) - 1 / inside)
