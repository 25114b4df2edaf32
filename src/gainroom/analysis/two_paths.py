"""Margins of a loop whose kd closes on a path of its own, from the eigenvalues of its common period (period_map.py).

Such a loop is periodic: gain, phase and delay margins are those of a common factor, real or complex, or delay on what is measured, and
each is confirmed by counting the eigenvalues outside the unit circle on both sides. Peak sensitivities and the disk margin are of loops
with a frequency response; they stay unknown (NaN).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Complexes, Floats
from ..system.loop import Loop
from .first_crossing import SEARCH, Certificate
from .margin_record import GainLimit, Margins, OneLoop, PathMargins
from .period_map import PeriodMap

HIGHEST, LOWEST = 1e3, 1e-3
"""Factors on gains that are searched, as for other coupled loops."""
FINEST, WIDEST, FIRST = 2e-3, 0.5, 0.02
"""Steps of ln factor, of a phase [rad], or of a delay over the common period."""
COARSE_DOWN = 0.02
"""Steps of ln factor in which lower gains are tried on an unstable loop, but where an eigenvalue stays outside throughout longer ones."""
MOST_LATER = 300
"""States of Φ up to which more delay is tried: its eigenvalues, of which there are some fifty sets, take 0.05 s there, and 10 s of 2000."""
BULGE = 0.25
"""Of a step of an eigenvalue: how far its path may lie beside the straight line."""
ACCURACY = 1e-13
RESTING = 1e-5
"""How near to 1 round-off leaves the eigenvalue of a drift, twice of what no gain acts on, and to the circle one that no gain moves."""
STILL = 1e-11
"""How little an eigenvalue on the circle moves with all gains where none acts on it: round-off. One that grows moves by more."""

Spectrum = Callable[[float], Complexes]


@dataclass(frozen=True)
class Lost:
    """Where the first eigenvalue leaves the unit circle: at t; with counts on both sides."""

    at: float
    certificate: Certificate


class TwoPaths:
    """The eigenvalues of one loop under changes of its gains, phases and delays."""

    def __init__(self, loop: Loop) -> None:
        self.loop, self.map = loop, PeriodMap(loop)
        self._drifting, self._still = _drifts(loop), np.zeros(0)
        there, elsewhere = self.values(), self.values(0.7, 0.7)
        near = there[np.abs(np.abs(there) - 1) < RESTING]
        self._still = near[[bool(np.abs(elsewhere - one).min() < STILL) for one in near]] if len(near) else near

    def values(self, others: object = 1.0, kd: object = 1.0, later: tuple[float, float] = (0.0, 0.0)) -> Complexes:
        """Eigenvalues of Φ, 0 in the place of those that rest on the circle whatever the gains: a joint without kp drifts."""
        matrix = (self.map.later(*later) if any(later) else self.map).matrix(others, kd)
        if not np.all(np.isfinite(matrix)):
            raise GainroomError("loop: its numbers are too large to compute with")
        found = np.linalg.eigvals(_that_act(matrix)).astype(complex)
        for one, off in [(1.0, RESTING)] * self._drifting + [(one, 10 * STILL) for one in self._still]:
            at = int(np.argmin(np.abs(found - one)))
            if abs(found[at] - one) < off:
                found[at] = 0.0
        return found

    def unstable(self) -> int:
        """Eigenvalues outside the unit circle."""
        return _outside(self.values())

    def limit(self) -> GainLimit:
        """Of the common factor on all gains, as gain_limit has it. Raises GainroomError where it cannot be certified."""

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
        below = (0.0, None, math.nan) if lower is None else (lower.at, lower.certificate, self._seen(lower.at, lower.at)[0])
        if upper is None:
            return GainLimit(stable, math.inf, below[0], math.nan, np.ones(self.loop.size, dtype=complex), None, below[1], below[2])
        omega, mode = self._seen(upper.at, upper.at)
        return GainLimit(stable, upper.at, below[0], omega, mode, upper.certificate, below[1], below[2])

    def _seen(self, others: object, kd: object) -> tuple[float, Complexes]:
        omega, mode = self.map.vibration(others, kd)
        return abs(omega), mode

    def margins(self) -> Margins:
        """All that is known."""
        limit, size = self.limit(), self.loop.size
        if not limit.stable:
            return replace(Margins.unknown(limit), unstable_roots=self.unstable())
        phase = first_lost(lambda t: self.values(_turned(t), _turned(t)), 0.0, math.pi)
        more, searched = self._more_delay(1.0)
        paths = self.paths()
        one_loop = self._one_loop(limit, phase, paths)
        sign, at = 1.0, math.nan
        if phase is not None:
            omega, _ = self.map.vibration(_turned(phase.at), _turned(phase.at))
            sign, at = math.copysign(1.0, omega), abs(omega)
        delayed = math.nan if more is None else abs(self.map.later(more.at, more.at).vibration()[0])
        held = [
            limit.certified,
            paths.certified,
            *(one.certificate.holds for one in (phase, more) if one is not None),
            bool(one_loop.certified.all()),
        ]
        return Margins(
            limit,
            one_loop,
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
        """The smallest delay more [s] on the other gains' path and `kd` times as much on kd's; and whether all up to 1 s were tried."""
        period, path = self.map.period, self.loop.kd_path
        assert path is not None
        parts = self.loop.parts
        assert parts is not None
        assert parts.sample_time is not None
        per_second = self.loop.size * (1 / parts.sample_time + kd / path.sample_time)
        farthest = min(1.0, max(0.0, MOST_LATER - self.map.states) / per_second)
        found = first_lost(lambda t: self.values(later=(t * period, kd * t * period)), 0.0, farthest / period)
        return None if found is None else replace(found, at=found.at * period), farthest == 1.0

    def delay_of_others(self) -> float:
        """See delay_of_others."""
        assert self.loop.parts is not None
        own = max(drive.delay for drive in self.loop.parts.drives)
        found, searched = self._more_delay(0.0)
        return own + found.at if found is not None else math.inf if searched else math.nan

    def paths(self) -> PathMargins:
        """Factors on the gains of one path alone."""
        ways: tuple[Spectrum, Spectrum] = self.values, lambda t: self.values(1.0, t)
        ends = [first_lost(way, 0.0, math.log(bound), exp=True) for way in ways for bound in (HIGHEST, LOWEST)]
        others, lower_others, kd, lower_kd = (
            none if end is None else end.at for end, none in zip(ends, (math.inf, 0.0, math.inf, 0.0), strict=True)
        )
        return PathMargins(others, lower_others, kd, lower_kd, all(end is None or end.certificate.holds for end in ends))

    def _one_loop(self, limit: GainLimit, phase: Lost | None, paths: PathMargins) -> OneLoop:
        """What each joint measures, the others' as they are."""
        size = self.loop.size
        if size == 1:
            alone = limit.gain, limit.lower_gain, math.inf if phase is None else phase.at
            columns = [np.array([one]) for one in (*alone, limit.certified)]
            assert self.loop.parts is not None
            controller, gain = self.loop.parts.controller, self.loop.gain
            kd = np.atleast_1d(gain * controller.kd * paths.kd)  # type: ignore[attr-defined] - it has one
            if getattr(controller, "ki", 0.0):  # which goes with kp on its path
                return OneLoop(*columns, largest_kd=kd)
            return OneLoop(*columns, largest_kp=np.atleast_1d(gain * controller.kp * paths.others), largest_kd=kd)  # type: ignore[attr-defined]
        found = [self._of_joint(k) for k in range(size)]
        return OneLoop(*(np.array(column) for column in zip(*found, strict=True)))

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
    """Of a stable loop whose kd closes on a path of its own: factors on the gains of one path alone."""
    return TwoPaths(loop).paths()


def delay_of_others(loop: Loop) -> float:
    """The delay [s] of the other gains' path at which a stable loop is lost, that of kd as it is.

    inf: none up to 1 s more; NaN: none as far as was tried, which of many joints is less.
    """
    return TwoPaths(loop).delay_of_others()


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
    inside, outside = (_outside(values(found * (1 + side * way * SEARCH.nudge))) for side in (-1, 1))
    return Lost(found, Certificate(inside, outside))


def _may_pass(before: Complexes, after: Complexes) -> bool:
    """Whether an eigenvalue may have left the circle, and come back, on its way from one set to the next: chords stay inside."""
    first, second = _followed(before, after)
    left: Floats = 1 - np.maximum(np.abs(first), np.abs(second))
    return bool(np.any(BULGE * np.abs(second - first) > left))


def _stays_outside(before: Complexes, halfway: Complexes, after: Complexes) -> bool:
    """Whether one eigenvalue is outside the circle all the way from one set to the next; halfway it is where the straight line has it.

    Without the set in between, one that goes in where another comes out is taken for one that stays.
    """
    first, second = _followed(before, after)
    way = second - first
    nearest = np.clip(-(first * way.conj()).real / np.maximum(np.abs(way) ** 2, np.finfo(float).tiny), 0.0, 1.0)  # on the chord, to 0
    chord = np.abs(first + nearest * way) - BULGE * np.abs(way) > 1
    beside = np.abs(halfway[:, None] - (first + second) / 2).min(axis=0)
    return bool(np.any(chord & (beside <= BULGE * np.abs(way) + STILL)))


def _followed(before: Complexes, after: Complexes) -> tuple[Complexes, Complexes]:
    """Both sets in the order in which eigenvalues go from one to the other: each by the shortest way."""
    from scipy.optimize import linear_sum_assignment

    count = max(len(before), len(after))
    first, second = (np.concatenate([one, np.zeros(count - len(one))]) for one in (before, after))
    rows, columns = linear_sum_assignment(np.abs(first[:, None] - second))
    return first[rows], second[columns]


def _that_act(matrix: Complexes) -> Complexes:
    """`matrix` without states that nothing of the next period depends on, whose eigenvalues are 0: torques that have done their work."""
    while not (act := matrix.any(axis=0)).all():
        matrix = matrix[np.ix_(act, act)]
    return matrix


def _outside(values: Complexes) -> int:
    return int(np.count_nonzero(np.abs(values) > 1))


def _turned(phase: float) -> complex:
    return complex(np.exp(-1j * phase))
