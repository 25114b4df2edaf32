"""By how much coupled loops miss each requirement, wherever they may, and how that changes with every gain.

Gains act along directions: joints, or those of tasks. L = P X Δ E with P from torque to position, X (n, m) from direction to torque,
E (m, n) from position to direction, Δ = diag(d_j(s)) what the gains make of each. Then, at one ω,

    dS_ii = −Σ_j (S P X)_ij (E S)_ji dd_j,  S = (I + L)⁻¹,      dλ = Σ_j (y E P X)_j x_j dd_j,  y, x eigenvectors of E P X Δ with y x = 1

and a margin, which is read where −λ or −ℓ_i = 1 − 1/S_ii is real or of size 1, moves along its own curve: with z = ln(−λ) = a + j b, on
b = 0 by da = Re z_p − Re z_ω Im z_p / Im z_ω, on a = 0 by db = Im z_p − Im z_ω Re z_p / Re z_ω.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..analysis.margin_record import Margins
from ..analysis.margins import required_margins
from ..analysis.quick_margins import QUICK, Sampled
from ..analysis.sampled_curves import meets_axis, meets_circle, peaks, polished_peaks
from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ..system.filters import integrator, value_of
from ..system.loop import Loop
from ..system.requirements import Requirement, Requirements

Gains = Floats
"""(3, m): kp, kd and ki of every direction; of a P/PI one kp, kv and ki."""
NEAR = 0.4  # in ln of a gain or a sensitivity, or as part of a phase: what is further from being missed is left out
FOLLOWED = 0.1  # the same, where gains are only a little further
SECANTS = 6  # to each crossing
SAME = 1e-7  # relative: of two ω that are too near to tell a slope
NEARLY = 1e-4  # of z: a crossing as near as this is found, as what is left of it is taken off along the slope
ASIDE = 1e-5  # relative: how far to go to tell one
OFF_COURSE = 1e-3  # of z: what ends further from a crossing has led nowhere
BROKEN = 1e-5  # what is missed by less may be round-off
DIFFERENCE = 1e-3  # in ln of a gain, of a margin whose slope is not known in closed form
BELIEVED = 100.0  # two crossings that are about to vanish move ever faster: no further than this is believed


@dataclass(frozen=True, eq=False)
class Case:
    """One state of a machine, in which gains have to keep something.

    title      for messages
    loop       gains (3, m) → the loop
    torque, jacobian   X (n, m), E (m, n)
    cascade    (m,) True for directions that are P/PI
    required   the requirements; none: stability alone
    """

    title: str
    loop: Callable[[Gains], Loop]
    torque: Floats
    jacobian: Floats
    cascade: Booleans
    required: Requirements
    _known: dict[bytes, Margins] = field(default_factory=dict, repr=False, compare=False)
    _last: list[tuple[bytes, Sampled]] = field(default_factory=list, repr=False, compare=False)

    def margins(self, gains: Gains) -> Margins:
        """Those of the loop with these gains that requirements bound; looked at once."""
        key = gains.tobytes()
        if key not in self._known:
            self._known[key], seen = required_margins(self.loop(gains), self.required)
            if seen is not None:
                self._last[:] = [(key, seen)]
        return self._known[key]

    def known(self, gains: Gains) -> bool:
        """Whether the loop with these gains is stable, and could be followed."""
        return self.required.shortfall(self.margins(gains)) < math.inf

    def seen(self, gains: Gains) -> Sampled:
        """What is seen of a loop that is `known`."""
        key = gains.tobytes()
        if not self._last or self._last[0][0] != key:
            self._known.pop(key, None)
            self.margins(gains)
        return self._last[0][1]

    def slopes(self, gains: Gains) -> "Slopes":
        """Everything near being missed by a loop that is stable, and how it moves."""
        return _Curves(_Machine(self, gains, self.seen(gains)), NEAR).slopes()

    def breaks(self, gains: Gains) -> str:
        """The requirement that a loop of gains near those looked at last is seen to break; "" where that is not to be seen so quickly.

        What was near being missed there is followed: wherever that comes to, it is a margin of the new loop.
        """
        if not self._last:
            return ""
        found = _Curves(_Machine(self, gains, self._last[0][1]), FOLLOWED, followed=True).slopes()
        worst = int(np.argmax(found.missed)) if len(found.missed) else -1
        return found.name[worst] if worst >= 0 and found.missed[worst] > BROKEN else ""


@dataclass(frozen=True)
class Slopes:
    """What is missed, in ln of a gain or a sensitivity or as part of a phase, negative where it is met; and how it changes.

    missed (c,)     slope (c, 2, m): by ln of each direction's stiffness, and of its damping     name (c) of what is required
    """

    missed: Floats
    slope: Floats
    name: tuple[str, ...]

    @classmethod
    def of(cls, parts: "Sequence[Slopes]") -> "Slopes":
        """All of them."""
        missed, slope = (np.concatenate([getattr(part, field) for part in parts]) for field in ("missed", "slope"))
        return cls(missed, slope, tuple(name for part in parts for name in part.name))


def moved(gains: Gains, step: Floats, cascade: Booleans) -> Gains:
    """`gains` (3, m) with ln of stiffness and of damping changed by `step` (2, m).

    The stiffness of a P/PI direction is kp·kv, its damping kv, and ki goes with the stiffness.
    """
    stiffer, damped = np.exp(step)
    return gains * np.array([np.where(cascade, stiffer / damped, stiffer), damped, stiffer])


@dataclass(frozen=True)
class _Values:
    """Values (k,) of one curve each, and their changes (k, 2, m) by ln of stiffness and damping."""

    value: Complexes
    change: Complexes

    @property
    def log(self) -> Complexes:
        """z = ln(−value): on the negative real axis its imaginary part is 0, on the unit circle its real part."""
        return _log_of_minus(self.value)

    @property
    def growth(self) -> Complexes:
        """Changes of z."""
        return self.change / self.value[:, None, None]


def _log_of_minus(value: Complexes) -> Complexes:
    return np.log(np.abs(value)) + 1j * np.angle(-value)


class _Machine:
    """A case at some gains: values of its loci, return ratios and sensitivities at any ω, and how they change."""

    def __init__(self, case: Case, gains: Gains, seen: Sampled) -> None:
        self.case, self.seen = case, seen
        self.gains, self._points, self._loop = gains, seen.sweep.boundary.points, case.loop(gains)
        assert self._loop.parts is not None
        self._controller = self._loop.parts.controller

    def _law(self, s: Complexes) -> tuple[Complexes, Complexes]:
        """d (k, m), and its changes (k, 2, m)."""
        loop, (kp, kd, ki) = self._loop, self.gains
        v, time = loop.variable(s)[:, None], loop.sample_time
        velocity, integral = (value_of(ratio, v) for ratio in (self._controller.velocity(time), integrator(time)))
        shaping, cascade = self._controller.shaping(time).at(s)[:, None], self.case.cascade
        inner, outer = kd + ki * integral, kp + velocity
        law = shaping * np.where(cascade, inner * outer, kp + kd * velocity)
        stiffness = np.where(cascade, inner * kp + ki * integral * outer, kp)
        damping = np.where(cascade, kd * outer - inner * kp, kd * velocity)
        return law, np.stack([shaping * stiffness, shaping * damping], axis=1)

    def _seen(self, s: Complexes) -> tuple[Complexes, Complexes]:
        """P X (k, n, m) and E P X (k, m, m)."""
        reached = self._loop.actuated_at(s) @ self.case.torque
        return reached, self.case.jacobian @ reached

    def sensitivity(self, omega: Floats, which: Integers) -> _Values:
        """S_ii of joints `which` (k,)."""
        s, rows = self._points(omega), np.arange(len(omega))
        law, change = self._law(s)
        reached, _ = self._seen(s)
        jacobian = self.case.jacobian
        all_of_it = np.linalg.inv(np.eye(len(jacobian.T)) + reached @ (law[:, :, None] * jacobian))
        own = all_of_it[rows, which]
        column = (jacobian @ all_of_it)[rows, :, which]  # (E S)_ji
        row = np.einsum("kn,knm->km", own, reached)  # (S P X)_ij
        return _Values(own[rows, which], -(row * column)[:, None, :] * change)

    def ratio(self, omega: Floats, which: Integers, _: Complexes) -> _Values:
        """ℓ_i of loops `which` (k,), the other loops closed."""
        own = self.sensitivity(omega, which)
        return _Values(1 / own.value - 1, -own.change / own.value[:, None, None] ** 2)

    def locus(self, omega: Floats, _: Integers, near: Complexes) -> _Values:
        """The loci nearest to `near` (k,)."""
        s, rows = self._points(omega), np.arange(len(omega))
        law, change = self._law(s)
        _, seen = self._seen(s)
        values, right = np.linalg.eig(seen * law[:, None, :])
        which = np.argmin(np.abs(values - near[:, None]), axis=1)
        left = np.linalg.inv(right)[rows, which]
        return _Values(values[rows, which], (np.einsum("km,kmj->kj", left, seen) * right[rows, :, which])[:, None, :] * change)


Part = tuple[int, Slopes]
PEAKS, ENDS = 0, 3  # places; loci and return ratios are between
_Curve = Callable[[Floats, Integers, Complexes], _Values]
"""ω (k,), which (k,), about where (k,) → values of one kind of curve."""


@dataclass(frozen=True)
class _Curves:
    """What requirements ask of the loops of a machine: what is missed or met by less than `near`, about where they were seen.

    followed   True: where gains are only a little further than where loops were seen; what is not followed is left out

    Parts come with their place, peaks first, then loci, return ratios and ends: where a search is flat, their order decides by round-off.
    """

    machine: _Machine
    near: float
    followed: bool = False

    def slopes(self) -> Slopes:
        """Everything that is required."""
        found = [part for one, needed in self.machine.case.required.asked_for for part in one.slopes(self, needed)]
        return Slopes.of([self._nothing, *(part for _, part in sorted(found, key=lambda pair: pair[0]))])

    @property
    def _nothing(self) -> Slopes:
        return Slopes(np.zeros(0), np.zeros((0, 2, self.machine.case.torque.shape[1])), ())

    @property
    def _curves(self) -> "list[tuple[_Curve, Floats, Complexes, Complexes]]":
        """The loci, and the return ratios: their values at any ω, and as seen, ω and the two ends of each step."""
        machine, seen = self.machine, self.machine.seen
        steps, single = seen.sweep.steps(), seen.single
        loci = machine.locus, seen.sweep.omega, steps.start, steps.end
        return [loci, (machine.ratio, single.omega, single.values[:-1], single.values[1:])]

    def at_axis(self, name: str, factor: float) -> list[Part]:
        """Gain margins: where loci and return ratios are real and negative."""
        found, needed = [], math.log(factor)
        for place, (curve, omega, start, end) in enumerate(self._curves, PEAKS + 1):
            rows, which, share, value = meets_axis(start, end)
            close = np.abs(np.log(-value)) < needed + self.near
            rows, which, share, value = rows[close], which[close], share[close], value[close]
            near = omega[rows] + share * (omega[rows + 1] - omega[rows])
            crossings = _crossings(curve, (omega[rows], near), which, (start[rows, which], value.astype(complex)), 1.0)
            found.append((place, _limited(needed, *crossings, 1.0, name)))
        for omega, *both in self.machine.seen.ends():
            for (curve, *_), values in zip(self._curves, both, strict=True):
                found.append((ENDS, _at_end(curve, omega, values, needed, self.near, name)))
        return found

    def at_circle(self, name: str, angle: float) -> list[Part]:
        """Phase margins: where loci and return ratios are of size 1."""
        found = []
        for place, (curve, omega, start, end) in enumerate(self._curves, PEAKS + 1):
            rows, which, share, lag = meets_circle(start, end)
            close = np.abs(lag) < angle * (1 + self.near)
            rows, which, share, lag = rows[close], which[close], share[close], lag[close]
            near = omega[rows] * (omega[rows + 1] / omega[rows]) ** share
            crossings = _crossings(curve, (omega[rows], near), which, (start[rows, which], -np.exp(1j * lag)), 1j)
            found.append((place, _limited(angle, *crossings, angle, name)))
        return found

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> list[Part]:
        """Where |slope S_ii + offset| is largest: a change of place changes nothing there."""
        machine, single = self.machine, self.machine.seen.single

        def values(omega: Floats, which: Integers) -> _Values:
            own = machine.sensitivity(omega, which)
            return _Values(slope * own.value + offset, slope * own.change)

        sizes = np.abs(slope * machine.seen.sensitivity + offset)
        rows, which = peaks(sizes, ceiling * math.exp(-self.near))
        place, _ = polished_peaks(single.omega, sizes, rows, which, lambda omega: np.abs(values(omega, which).value))
        found = values(place, which)
        return [(PEAKS, Slopes(found.log.real - math.log(ceiling), found.growth.real, (name,) * len(place)))]

    def by_differences(self, requirement: Requirement, needed: float) -> list[Part]:
        """The worst of a margin that has no curve here: its differences from that at gains a little larger, one after the other."""
        case, gains = self.machine.case, self.machine.gains
        size = case.torque.shape[1]
        if self.followed:
            return []

        def missed(gains: Gains) -> float:
            found = case.margins(gains)
            return requirement.shortfall(needed, requirement.value(found)) if found.stable else math.inf

        here, slope = missed(gains), np.zeros((1, 2, size))
        if here < -self.near:
            return []
        for place in np.ndindex(2, size):
            step = np.zeros((2, size))
            step[place] = DIFFERENCE
            there = missed(moved(gains, step, case.cascade))
            slope[0][place] = (there - here) / DIFFERENCE if math.isfinite(there) else BELIEVED
        return [(PEAKS, _believed(np.array([here]), slope, requirement.name))]


def _crossings(
    curve: _Curve, omega: tuple[Floats, Floats], which: Integers, values: tuple[Complexes, Complexes], turn: complex
) -> tuple[Floats, Floats]:
    """Margins (c,) at the crossings near the second of two ω, with values as interpolated, and how they move (c, 2, m).

    turn   1: of the negative real axis, 1j: of the unit circle; the real part of z / turn is the margin, its imaginary part is 0 there
    """
    before, place = (part.copy() for part in omega)
    back, here = (_log_of_minus(value) / turn for value in values)
    growth: Complexes = np.zeros((len(place), 2, 0), dtype=complex)
    slope: Complexes = np.zeros(len(place), dtype=complex)
    left = np.arange(len(place))
    for _ in range(SECANTS):
        found = curve(place[left], which[left], -np.exp(here[left] * turn))
        if not growth.size:
            growth = np.zeros((len(place), *found.change.shape[1:]), dtype=complex)
        here[left], growth[left] = found.log / turn, found.growth / turn
        run = place[left] - before[left]
        far = np.abs(run) > SAME * place[left]
        slope[left] = np.where(far, (here[left] - back[left]) / np.where(far, run, 1.0), slope[left])
        left = left[(np.abs(here[left].imag) > NEARLY) | (slope[left].imag == 0)]
        if not len(left):
            break
        aside = slope[left].imag == 0  # beside a sample that tells no slope
        step = np.where(aside, ASIDE * place[left], -here[left].imag / np.where(aside, 1.0, slope[left].imag))
        step = np.clip(step, -0.1 * place[left], 0.1 * place[left])
        before[left], back[left] = place[left], here[left]
        place[left] += step
        here[left] += slope[left] * step  # where it should be
    along = np.divide(slope.real, slope.imag, out=np.zeros(len(place)), where=slope.imag != 0)
    margin = here.real - along * here.imag
    moves = growth.real - along[:, None, None] * growth.imag
    true = np.abs(here.imag) < OFF_COURSE
    return margin[true], moves[true]


def _at_end(curve: _Curve, omega: float, values: Complexes | Floats, needed: float, near: float, name: str) -> Slopes:
    """Values that are real and negative where the boundary ends, which a gain moves along the axis."""
    real = (np.real(values) < 0) & (np.abs(np.imag(values)) < QUICK.real * np.abs(values))
    which = np.flatnonzero(real & (np.abs(np.log(np.maximum(np.abs(values), 1e-300))) < needed + near))
    found = curve(np.full(len(which), omega), which, np.asarray(values, dtype=complex)[which])
    return _limited(needed, found.log.real, found.growth.real, 1.0, name)


def _limited(needed: float, margin: Floats, moves: Floats, unit: float, name: str) -> Slopes:
    """By how much margins, of either sign, miss what is needed, in shares of `unit`."""
    return _believed((needed - np.abs(margin)) / unit, -np.sign(margin)[:, None, None] * moves / unit, name)


def _believed(missed: Floats, slope: Floats, name: str) -> Slopes:
    steepest = np.abs(slope).max(axis=(1, 2), initial=0.0)
    return Slopes(missed, slope * np.minimum(1.0, BELIEVED / np.maximum(steepest, BELIEVED))[:, None, None], (name,) * len(missed))
