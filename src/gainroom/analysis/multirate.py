"""A loop whose kd closes on a path of its own: one lifted sampled system of the common period, and its margins.

The loop is stable where every eigenvalue of Φ, the transition of the lifted system over a period (lifted.py), lies inside the unit circle.

Gain, phase and delay margins are those of a common factor, real or complex, or delay on what is measured; each is confirmed by counting
the eigenvalues outside the circle on both sides.

Sensitivities are opened at each motor's torque, the sum of both paths as it arrives, which is held from one arrival to the next: d (m,) is
a disturbance torque held likewise, one number per hold in a period, and T maps d to what the loop takes of it, S = I − T. Each hold counts
by the root of its length, so that σ_max is the gain in ∫ torque² dt. Peak sensitivity Ms is the largest σ_max of S_ii over the circle,
Mt that of T_ii; the disk margin is 2 over that of S − T.

Lemma. Where both paths have one rate and one delay, each joint has one hold in a period; the root of its length cancels, S_ii is the
scalar 1 − T_ii(z) of the sampled loop opened at the torque, and Ms, Mt and disk margin are those of the loop with one path. With gains per
joint, K diagonal, the loop opened at the measured positions, G K = K⁻¹ (K G) K, has the same S_ii. At any two rates a factor f on the gains
of one joint that loses the loop, det(I + f L) = 0 at some z, makes 1/(1 − 1/f) an eigenvalue of S there, and σ_max is not less: as with one
path, Ms ≥ f/(f − 1), and Ms ≥ 1/(2 sin φ/2) for a phase φ that loses it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.controller import gain_matrix
from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.linear.state_space import StateSpace
from ..system.loop import Loop
from .lifted import Lifted
from .margin_record import NUDGE, Certificate, End, GainLimit, Margins, OneLoop, PathMargins, interval
from .peak_gain import peak_gain, scaled_peak_gain, without

HIGHEST, LOWEST = 1e3, 1e-3
"""Largest and smallest factor on gains that is searched, as for other coupled loops."""
FINEST, WIDEST, FIRST = 2e-3, 0.5, 0.02
"""Steps of ln factor, of a phase [rad], or of a delay over the common period."""
COARSE_DOWN = 0.02
"""Steps of ln factor in which lower gains are tried on an unstable loop, but where an eigenvalue stays outside throughout longer ones."""
MOST_LATER = 300
"""States of Φ up to which more delay is tried: its eigenvalues, of which there are some fifty sets, take 0.05 s there, and 10 s of 2000."""
MOST_HOLDS = 1500
"""Holds of all joints' torques in a period up to which σ_max of S is worked out: a matrix of that size takes a second."""
BESIDE, CROSSING_SAMPLES = 0.03, 4000
"""Share of a delay, and samples, around a crossing's lag in which the loop is followed; and frequencies at which crossings are sought."""
BULGE = 0.25
"""Largest deviation of an eigenvalue's path from the straight line, relative to the step."""
ACCURACY = 1e-13
RESTING = 1e-5
"""Distance by which round-off moves eigenvalues that no gain acts on: the double ones of a drift off 1, single ones off the circle."""
STILL = 1e-11
"""Distance by which an eigenvalue on the circle moves with all gains if none acts on it: round-off. Others move by more."""

Spectrum = Callable[[float], Complexes]


@dataclass(frozen=True)
class Lost:
    """First value `at` of a parameter at which an eigenvalue of Φ leaves the unit circle, with root counts on both sides."""

    at: float
    certificate: Certificate


class Multirate:
    """Margins of one loop with two paths of gains."""

    def __init__(self, loop: Loop) -> None:
        self.loop, self.lifted = loop, Lifted(loop)
        self._drifting, self._still = _drifts(loop), np.zeros(0)
        there, elsewhere = self.values(), self.values(0.7, 0.7)
        near = there[np.abs(np.abs(there) - 1) < RESTING]
        self._still = near[[bool(np.abs(elsewhere - one).min() < STILL) for one in near]] if len(near) else near

    def values(self, others: object = 1.0, kd: object = 1.0, lifted: Lifted | None = None) -> Complexes:
        """Eigenvalues of Φ; those that rest on the circle whatever the gains, such as those of a joint without kp, are replaced by 0."""
        matrix = (lifted or self.lifted).matrix(others, kd)
        if not np.all(np.isfinite(matrix)):
            raise GainroomError("loop: its numbers are too large to compute with")
        found = np.linalg.eigvals(_that_act(matrix)).astype(complex)
        for one, off in self._resting:
            at = int(np.argmin(np.abs(found - one)))
            if abs(found[at] - one) < off:
                found[at] = 0.0
        return found

    @property
    def _resting(self) -> list[tuple[complex, float]]:
        """Eigenvalues that no gain moves off the unit circle, each with the distance by which round-off moves it."""
        return [(complex(1.0), RESTING)] * self._drifting + [(one, 10 * STILL) for one in self._still]

    def rests(self, value: complex) -> bool:
        """True if `value` is an eigenvalue that no gain moves off the unit circle."""
        return any(abs(value - one) < off for one, off in self._resting)

    def unstable(self, others: object = 1.0, kd: object = 1.0) -> int:
        """Number of eigenvalues outside the unit circle, with factors on the gains of each path."""
        return _outside(self.values(others, kd))

    def limit(self) -> GainLimit:
        """Gain limit of the common factor on all gains. Raises GainroomError where it cannot be certified."""

        def spectrum(factor: float) -> Complexes:
            return self.values(factor, factor)

        assert self.loop.parts is not None
        if not self.loop.parts.controller.terms():
            raise GainroomError("gain_limit: all gains are zero")
        stable, inside = self.unstable() == 0, 0.0
        if not stable:
            found = first_stable(spectrum, math.log(LOWEST))
            if found is None:
                return replace(GainLimit.unknown(self.loop.size, stable=False), gain=0.0)
            inside = found
        upper = first_lost(spectrum, inside, math.log(HIGHEST), exp=True)
        lower = first_lost(spectrum, inside, math.log(LOWEST), exp=True)
        for end in (upper, lower):
            if end is not None and not end.certificate.holds:
                raise GainroomError("gain_limit: the eigenvalues of two paths could not be followed to a certified limit")
        return interval(self.loop, *map(self._end, (upper, lower)), stable=stable)

    def _end(self, lost: "Lost | None") -> End | None:
        """End, with its mode, of the stable interval of a factor on all gains; None if `lost` is None."""
        if lost is None:
            return None
        omega, mode = self.lifted.vibration(lost.at, lost.at)
        return End(lost.at, abs(omega), mode, lost.certificate)

    def margins(self, largest: bool = False) -> Margins:
        """All margins of the loop; `largest`: also the largest gains of each of several joints."""
        limit, size = self.limit(), self.loop.size
        if not limit.stable:
            return replace(Margins.unknown(limit), unstable_roots=self.unstable())
        phase = first_lost(lambda t: self.values(_turned(t), _turned(t)), 0.0, math.pi)
        more, searched = self._more_delay(1.0)
        paths = self.paths()
        one_loop = self._one_loop(limit, phase, paths, largest)
        peaks = Peaks.of(self)
        sign, at = 1.0, math.nan
        if phase is not None:
            omega, _ = self.lifted.vibration(_turned(phase.at), _turned(phase.at))
            sign, at = math.copysign(1.0, omega), abs(omega)
        delayed = math.nan if more is None else abs(self.lifted.later(more.at, more.at).vibration()[0])
        held = [
            limit.certified,
            paths.certified,
            *(one.certificate.holds for one in (phase, more) if one is not None),
            bool(one_loop.certified.all()),
            *(one.certified for one in (*peaks.sensitivity, *peaks.complementary)),
        ]
        sensitivity, complementary, disk = max(peaks.sensitivity), max(peaks.complementary), peaks.disk
        return Margins(
            limit,
            replace(one_loop, peak_sensitivity=np.array([one.height for one in peaks.sensitivity])),
            peak_sensitivity=sensitivity.height,
            peak_sensitivity_frequency=sensitivity.omega,
            peak_complementary=complementary.height,
            peak_complementary_frequency=complementary.omega,
            disk_margin=min(2 / disk.height, 2.0),
            disk_margin_frequency=disk.omega,
            disk_certified=disk.certified,
            phase_margin=math.inf if phase is None else sign * phase.at,
            gain_crossover=at,
            delay_margin=more.at if more is not None else math.inf if searched else math.nan,
            delay_crossover=delayed,
            certified=all(held) and (size == 1 or searched or more is not None),
            phase_certificate=None if phase is None else phase.certificate,
            delay_certificate=None if more is None else more.certificate,
            loops=(self.loop,),
            paths=paths,
        )

    def _more_delay(self, kd: float) -> tuple[Lost | None, bool]:
        """Smallest extra delay [s] on the path of the other gains, with `kd` times as much on kd's, that loses the loop; None: none found.

        Also True if all delays up to 1 s were tried.
        """
        period, path = self.lifted.period, self.loop.kd_path
        assert path is not None
        parts = self.loop.parts
        assert parts is not None
        assert parts.sample_time is not None
        per_second = self.loop.size * (1 / parts.sample_time + kd / path.sample_time)
        farthest = min(1.0, max(0.0, MOST_LATER - self.lifted.states) / per_second)

        def later(t: float) -> Complexes:
            return self.values(lifted=self.lifted.later(t * period, kd * t * period))

        start, stop = 0.0, farthest / period
        if kd == 0 and self.loop.size == 1 and math.isclose(period, parts.sample_time):
            near = self._lag_at_crossing()
            low, high = (1 - BESIDE) * near - BESIDE, (1 + BESIDE) * near + BESIDE
            if low > stop and farthest < 1.0:  # too late to be followed
                return None, False
            if 0 < low < stop and _outside(later(low)) == 0 < _outside(later(high)):
                start, stop = low, high
        found = first_lost(later, start, stop)
        return None if found is None else replace(found, at=found.at * period), farthest == 1.0

    def _lag_at_crossing(self) -> float:
        """Least lag, in samples, that brings the return ratio L of one joint's kp and ki, kd closed, to −1 where |L| = 1; inf: none.

        With a factor g on these gains det(z − Φ) is 1 + g L times what has no g, so that two factors give L. Each further sample of delay
        is 1/z in L; part of one counts here as the phase that it costs, and is exact in the eigenvalues that are followed from nearby.
        """
        whole, half = self.values(), self.values(0.5)
        if len(whole) != len(half):
            return math.nan
        roots = np.concatenate([whole, half])
        beside = np.abs(np.angle(roots[roots != 0]))
        angles = np.unique(np.concatenate([np.geomspace(1e-6, math.pi, CROSSING_SAMPLES), beside[beside > 1e-6]]))
        z = np.exp(1j * angles)[:, None]
        ratio = np.exp(np.log((z - whole) / (z - half)).sum(axis=1))
        returned = (ratio - 1) / (1 - ratio / 2)
        size = np.log(np.abs(returned))
        lag = np.mod(np.angle(returned) + math.pi, 2 * math.pi) / angles
        there = np.flatnonzero(size[:-1] * size[1:] <= 0)
        share = size[there] / (size[there] - size[there + 1])
        return float((lag[there] + share * (lag[there + 1] - lag[there])).min(initial=math.inf))

    def delay_of_others(self) -> float:
        """Delay [s] of the path of kp and ki at which the loop becomes unstable, as the function delay_of_others below."""
        assert self.loop.parts is not None
        own = max(drive.delay for drive in self.loop.parts.drives)
        found, searched = self._more_delay(0.0)
        return own + found.at if found is not None else math.inf if searched else math.nan

    def paths(self) -> PathMargins:
        """Factors on the gains of one path alone at which the loop becomes unstable."""
        ways: tuple[Spectrum, Spectrum] = self.values, lambda t: self.values(1.0, t)
        ends = [first_lost(way, 0.0, math.log(bound), exp=True) for way in ways for bound in (HIGHEST, LOWEST)]
        others, lower_others, kd, lower_kd = (
            none if end is None else end.at for end, none in zip(ends, (math.inf, 0.0, math.inf, 0.0), strict=True)
        )
        return PathMargins(others, lower_others, kd, lower_kd, all(end is None or end.certificate.holds for end in ends))

    def _one_loop(self, limit: GainLimit, phase: Lost | None, paths: PathMargins, largest: bool) -> OneLoop:
        """Margins of one joint's measured position at a time, the other joints' as they are."""
        size = self.loop.size
        if size == 1:
            alone = limit.gain, limit.lower_gain, math.inf if phase is None else abs(phase.at), limit.certified
            found = OneLoop(*(np.array([one]) for one in alone))
        else:
            rows = [self._of_joint(k) for k in range(size)]
            found = OneLoop(*(np.array(column) for column in zip(*rows, strict=True)))
        if size > 1 and not largest:
            return found
        kp, kd = ([self._largest(name, k, paths) for k in range(size)] for name in ("kp", "kd"))
        certified = found.certified & [a and b for (_, a), (_, b) in zip(kp, kd, strict=True)]
        return replace(found, certified=certified, largest_kp=np.array([one for one, _ in kp]), largest_kd=np.array([one for one, _ in kd]))

    def _largest(self, name: str, joint: int, paths: PathMargins) -> tuple[float, bool]:
        """The largest diagonal kp or kd of a joint, all other gains as they are, and whether it is certified."""
        parts = self.loop.parts
        assert parts is not None
        controller, size = parts.controller, self.loop.size
        matrix = gain_matrix(name, getattr(controller, name), size)
        own, unit = float(matrix[joint, joint]), np.diag(np.eye(size)[joint])
        if size == 1 and (name == "kd" or not getattr(controller, "ki", 0.0)):  # ki goes with kp on its path
            factor = paths.kd if name == "kd" else paths.others
            if own:
                return self.loop.gain * own * factor, paths.certified
        step = own or self._small(name, joint)

        def gains(factor: float) -> Floats:
            return matrix + (factor - 1) * step * unit

        def spectrum(factor: float) -> Complexes:
            changed = gains(factor) if size > 1 else float(gains(factor)[0, 0])
            return self.values(lifted=self.lifted.regained(replace(controller, **{name: changed})))

        end = first_lost(spectrum, 0.0, math.log(HIGHEST if own else HIGHEST**2), exp=True)
        if end is None:
            return math.inf, True
        return self.loop.gain * float(gains(end.at)[joint, joint]), end.certificate.holds

    def _small(self, name: str, joint: int) -> float:
        """A kp or kd small beside what a joint's delay and motor allow, from which on larger ones are tried where it has none."""
        parts, path = self.loop.parts, self.loop.kd_path
        assert parts is not None
        assert parts.sample_time is not None
        assert path is not None
        inertia = parts.plant.motor_inertia[joint] or parts.plant.units[joint] ** 2
        if name == "kd":
            return 0.02 * float(inertia) / (path.delay + path.sample_time)
        return 1e-3 * float(inertia) / (parts.delays[joint] + parts.sample_time) ** 2

    def _of_joint(self, joint: int) -> tuple[float, float, float, bool]:
        """Largest and smallest factor, smallest phase, and whether they are certified."""
        unit = np.eye(self.loop.size)[joint]

        def scaled(factor: complex) -> Complexes:
            own = 1 + (factor - 1) * unit
            return self.values(own, own)

        ends = (
            first_lost(scaled, 0.0, math.log(HIGHEST), exp=True),
            first_lost(scaled, 0.0, math.log(LOWEST), exp=True),
            first_lost(lambda t: scaled(_turned(t)), 0.0, math.pi),
        )
        upper, lower, turn = (none if end is None else end.at for end, none in zip(ends, (math.inf, 0.0, math.inf), strict=True))
        return upper, lower, turn, all(end is None or end.certificate.holds for end in ends)


@dataclass(frozen=True, order=True)
class Peak:
    """The largest σ_max of S_ii, T_ii or S − T, where [rad/s], and whether it is certified that none is above."""

    height: float
    omega: float
    certified: bool


@dataclass(frozen=True)
class Peaks:
    """The peaks of S_ii and T_ii of a stable loop, joint by joint, and that of D (S − T) D⁻¹, D the best."""

    sensitivity: list[Peak]
    complementary: list[Peak]
    disk: Peak

    @classmethod
    def of(cls, loop: Multirate) -> "Peaks":
        """Peaks of `loop`; NaN where its holds in a period are more than MOST_HOLDS."""
        lifted, size = loop.lifted, loop.lifted.size
        if len(lifted.holds) > MOST_HOLDS:
            unknown = Peak(math.nan, math.nan, False)
            return cls([unknown] * size, [unknown] * size, unknown)
        system = without(_pruned(lifted.torques()), loop.rests)
        rows = [np.flatnonzero([hold.joint == joint for hold in lifted.holds]) for joint in range(size)]

        def peak(slope: float, offset: float, own: Integers) -> Peak:
            if not len(own):  # no gain acts there
                return Peak(offset, math.nan, True)
            part = _pruned(_affine(system.between(own, own), slope, offset))
            found = peak_gain(part)
            return Peak(found.height, lifted.frequency(found.angle, found.input, own), found.certified)

        own = [peak(-1.0, 1.0, one) for one in rows], [peak(1.0, 0.0, one) for one in rows]
        if size == 1:
            return cls(*own, peak(-2.0, 1.0, rows[0]))
        found = scaled_peak_gain(_affine(system, -2.0, 1.0), np.array([hold.joint for hold in lifted.holds]))
        return cls(*own, Peak(found.height, lifted.frequency(found.angle, found.input, np.arange(len(lifted.holds))), found.certified))


def _affine(system: StateSpace, slope: float, offset: float) -> StateSpace:
    """State space of slope T + offset I, T that of `system`."""
    return replace(system, c=slope * system.c, d=slope * system.d + offset * np.eye(len(system.d)))


def _drifts(loop: Loop) -> int:
    """Eigenvalues at 1 whatever the gains: positions that no kp or ki brings back, and the speeds of those without kd, too."""
    assert loop.parts is not None
    if loop.parts.plant.gravity_stiffness is not None:
        return 0
    controller, unit = loop.parts.controller, np.eye(loop.size)
    terms = [np.zeros((loop.size, loop.size))] + [
        unit * gain if np.ndim(gain) < 2 else np.asarray(gain) for gain in controller.without_kd().terms().values()
    ]
    kd = [unit * gain if np.ndim(gain) < 2 else np.asarray(gain) for gain in controller.kd_alone().terms().values()]
    return 2 * loop.size - int(np.linalg.matrix_rank(np.vstack(terms))) - int(np.linalg.matrix_rank(np.vstack(terms + kd)))


def path_margins(loop: Loop) -> PathMargins:
    """Factors on the gains of one path alone, of a stable loop whose kd closes on a path of its own."""
    return Multirate(loop).paths()


def delay_of_others(loop: Loop) -> float:
    """Delay [s] of the other gains' path at which a stable loop is lost, with the delay of kd as it is.

    inf: none up to 1 s more; NaN: none within the delays tried, fewer for many joints.
    """
    return Multirate(loop).delay_of_others()


def first_lost(values: Spectrum, start: float, stop: float, exp: bool = False) -> Lost | None:
    """The first t from `start`, where all is stable, to `stop` at which an eigenvalue leaves the unit circle; None where none does.

    values   (m,) eigenvalues at t, or at e^t where `exp`

    Steps are so short, down to FINEST, that the path of an eigenvalue from inside the circle to inside cannot bulge beyond it; where
    one is not, it is halved, and what is known of its end serves the second half.
    """
    way, size = math.copysign(1.0, stop - start), math.exp if exp else float
    known = {start: values(size(start))}

    def at(t: float) -> Complexes:
        if t not in known:
            known[t] = values(size(t))
        return known[t]

    here, step, ahead = start, FIRST, list[float]()  # nearest last
    while way * here < way * stop:
        if not ahead:
            ahead.append(here + way * min(step, way * (stop - here)))
        there, gone = ahead[-1], _outside(at(ahead[-1])) > 0
        step = abs(there - here)
        if step > FINEST and (gone or _may_pass(at(here), at(there))):
            ahead.append((here + there) / 2)
        elif gone:
            return _between(at, here, there, way, size, values)
        else:
            here, step = ahead.pop(), min(WIDEST, 2 * step)
    return None


def first_stable(values: Spectrum, stop: float) -> float | None:
    """The first t from 0, where some eigenvalue is outside the unit circle, down to `stop` at which none is; None where there is none.

    values   (m,) eigenvalues at the factor e^t
    """
    known: dict[float, Complexes] = {}

    def at(t: float) -> Complexes:
        if t not in known:
            known[t] = values(math.exp(t))
        return known[t]

    def between(high: float, low: float) -> float | None:
        settled = _outside(at(low)) == 0
        if high - low <= COARSE_DOWN:
            return low if settled else None
        middle = (high + low) / 2
        if not settled and _stays_outside(at(high), at(middle), at(low)):
            return None
        return between(middle, low) if (first := between(high, middle)) is None else first

    edges = np.linspace(0.0, stop, math.ceil(-stop / WIDEST) + 1).tolist()
    return next((found for high, low in pairwise(edges) if (found := between(high, low)) is not None), None)


def _between(at: Spectrum, stable: float, lost: float, way: float, size: Callable[[float], float], values: Spectrum) -> Lost:
    from scipy.optimize import brentq

    exact: Any = brentq(lambda t: np.abs(at(t)).max() - 1, stable, lost, xtol=ACCURACY * max(abs(lost), 1e-6))
    found = size(exact)
    inside, outside = (_outside(values(found * (1 + side * way * NUDGE))) for side in (-1, 1))
    return Lost(found, Certificate(inside, outside))


def _may_pass(before: Complexes, after: Complexes) -> bool:
    """True if an eigenvalue may have left the unit circle and come back between two sets, its chord staying inside."""
    first, second = _followed(before, after)
    left: Floats = 1 - np.maximum(np.abs(first), np.abs(second))
    return bool(np.any(BULGE * np.abs(second - first) > left))


def _stays_outside(before: Complexes, halfway: Complexes, after: Complexes) -> bool:
    """True if one eigenvalue is outside the circle all the way from one set to the next, being near its chord in the set halfway.

    Without the set halfway, one that goes in where another comes out would be taken for one that stays.
    """
    first, second = _followed(before, after)
    way = second - first
    nearest = np.clip(-(first * way.conj()).real / np.maximum(np.abs(way) ** 2, np.finfo(float).tiny), 0.0, 1.0)  # on the chord, to 0
    chord = np.abs(first + nearest * way) - BULGE * np.abs(way) > 1
    beside = np.abs(halfway[:, None] - (first + second) / 2).min(axis=0)
    return bool(np.any(chord & (beside <= BULGE * np.abs(way) + STILL)))


def _followed(before: Complexes, after: Complexes) -> tuple[Complexes, Complexes]:
    """Both sets of eigenvalues, paired in the order that makes the ways from one to the other shortest."""
    from scipy.optimize import linear_sum_assignment

    count = max(len(before), len(after))
    first, second = (np.concatenate([one, np.zeros(count - len(one))]) for one in (before, after))
    rows, columns = linear_sum_assignment(np.abs(first[:, None] - second))
    return first[rows], second[columns]


def _pruned(system: StateSpace) -> StateSpace:
    """`system` without states that nothing depends on."""
    while not (act := system.a.any(axis=0) | system.c.any(axis=0)).all():
        system = StateSpace(system.a[np.ix_(act, act)], system.b[act], system.c[:, act], system.d)
    return system


def _that_act(matrix: Complexes) -> Complexes:
    """`matrix` without states of eigenvalue 0 on which nothing of the next period depends: torques that have been applied."""
    while not (act := matrix.any(axis=0)).all():
        matrix = matrix[np.ix_(act, act)]
    return matrix


def _outside(values: Complexes) -> int:
    return int(np.count_nonzero(np.abs(values) > 1))


def _turned(phase: float) -> complex:
    return complex(np.exp(-1j * phase))
