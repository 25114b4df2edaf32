"""A loop whose kd closes on a path of its own: one lifted sampled system of the common period, and its margins.

The loop is periodic, not time-invariant. Lifted over one common period of both rates it is a sampled system of that period (Khargonekar,
Poolla and Tannenbaum 1985; Bittanti and Colaneri, Periodic Systems, 2009): x ↦ Φ x + B d, u = C x + D d. Between two events, a sample or a
torque that arrives, the torques are held and the physics is a matrix exponential, so any delay of either path is exact. Both paths
sample together at the start of every period. The loop is stable where every eigenvalue of Φ lies inside the unit circle.

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
from copy import copy
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.assembly import controller_state
from ..system.controller import Controller, gain_matrix
from ..system.gain_path import samples_in_common
from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.linear.state_space import StateSpace, split_delay
from ..system.loop import Loop
from ..system.measured_response import measured_state
from .margin_record import NUDGE, Certificate, End, GainLimit, Margins, OneLoop, PathMargins, interval
from .peak_gain import peak_gain, scaled_peak_gain, without

ROUNDING = 1e-12  # part of the common period within which two events are at the same time
MOST_STATES = 1500  # largest size of Φ, whose eigenvalues are computed many times
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
BULGE = 0.25
"""Largest deviation of an eigenvalue's path from the straight line, relative to the step."""
ACCURACY = 1e-13
RESTING = 1e-5
"""Distance by which round-off moves eigenvalues that no gain acts on: the double ones of a drift off 1, single ones off the circle."""
STILL = 1e-11
"""Distance by which an eigenvalue on the circle moves with all gains if none acts on it: round-off. Others move by more."""

Spectrum = Callable[[float], Complexes]


@dataclass(frozen=True)
class _Path:
    """One of the two paths of gains: its law in z of the measured position, samples per common period, and delays (n,).

    step   [s] between samples; late (n,): whole samples of delay; rest (n,) [s]: the remainder
    """

    law: StateSpace
    step: float
    samples: int
    late: Integers
    rest: Floats

    @property
    def kept(self) -> int:
        """Number of samples whose torques are still on their way, each a row block of n."""
        return int(self.late.max()) + 1

    def delayed(self, delays: Floats) -> "_Path":
        """Path with delays (n,) [s] in place of its own."""
        whole, fraction = split_delay(delays, self.step)
        return replace(self, late=whole, rest=fraction * self.step)


@dataclass(frozen=True)
class _Event:
    """Event within the common period: a path samples, or its earlier torques arrive at `joints`; then `ticks` of ROUNDING of physics."""

    path: int
    samples: bool
    joints: tuple[int, ...]
    ticks: int


@dataclass(frozen=True)
class _Hold:
    """Hold of one joint's torque: from the arrival at event number `event`, at tick `start`, for `ticks` of ROUNDING."""

    joint: int
    event: int
    start: int
    ticks: int


class Lifted:
    """Lifted sampled system of one common period, for any factors on its gains. Its paths are (other gains, kd).

    Raises GainroomError where it has more than MOST_STATES states.
    """

    def __init__(self, loop: Loop) -> None:
        parts, path = loop.parts, loop.kd_path
        assert parts is not None
        assert path is not None
        assert parts.sample_time is not None
        self.size, self._gain = loop.size, loop.gain
        self._plant = measured_state(parts, "position")
        self._steps = steps = parts.sample_time, path.sample_time
        counts = samples_in_common(*steps)
        self.period, self._faster = parts.sample_time * counts[0], int(np.argmin(steps))
        self._flows: dict[int, tuple[Floats, Floats]] = {}
        self._delays = parts.delays, np.full(self.size, path.delay)
        nothing = np.zeros(self.size, dtype=int), np.zeros(self.size)
        self._lay_out([
            _Path(law, step, count, *nothing).delayed(delays)
            for law, step, count, delays in zip(self._laws(parts.controller), steps, counts, self._delays, strict=True)
        ])  # fmt: skip

    def _laws(self, controller: Controller) -> list[StateSpace]:
        laws = controller.without_kd(), controller.kd_alone()
        return [_of_position(controller_state(law, self.size, step), self.size, step) for law, step in zip(laws, self._steps, strict=True)]

    def regained(self, controller: Controller) -> "Lifted":
        """The lifted system with other gains, none of which was 0 or is."""
        found = copy(self)
        found._paths = [replace(path, law=law) for path, law in zip(self._paths, self._laws(controller), strict=True)]
        return found

    def later(self, others: float, kd: float) -> "Lifted":
        """The lifted system with more delay [s] on either path."""
        found = copy(self)
        found._lay_out([path.delayed(own + more) for path, own, more in zip(self._paths, self._delays, (others, kd), strict=True)])
        return found

    def _lay_out(self, paths: list[_Path]) -> None:
        """Places of the parts of the state, and events from one sample of the faster path to the next.

        First what the faster path alone changes: the plant's state, torques at work, its memory, torques on their way; then the slower
        path's memory and torques on their way.
        """
        vars(self).pop("holds", None)
        self._paths, order = paths, (self._faster, 1 - self._faster)
        sizes = [len(self._plant.a), self.size, self.size]
        for which in order:
            sizes += [len(paths[which].law.a), paths[which].kept * self.size]
        edges = np.cumsum([0, *sizes]).tolist()
        self._x, *rest = (slice(low, high) for low, high in pairwise(edges))
        self._acting, self._memory, self._lines = rest[:2], [rest[2 + 2 * k] for k in order], [rest[3 + 2 * k] for k in order]
        self.states, self._of_faster = edges[-1], edges[5]
        if self.states > MOST_STATES:
            raise GainroomError(f"kd_path: {self.states} states over a common period are too many: shorten the delays, or lower the rates")
        self._strides = self._what_happens(order)

    def _what_happens(self, order: tuple[int, int]) -> list[tuple[_Event, ...]]:
        """Events of a period in the order of time, cut where the faster path samples."""
        found: list[tuple[float, int, bool, Integers]] = []
        for which in order:
            path = self._paths[which]
            for at in (float(Fraction(k, path.samples)) * self.period for k in range(path.samples)):
                found.append((at, which, True, np.flatnonzero(path.rest == 0)))
                found += [(at + rest, which, False, np.flatnonzero(path.rest == rest)) for rest in sorted({*path.rest.tolist()} - {0.0})]
        found.sort(key=lambda event: event[0])
        times = [round(min(1.0, at / self.period) / ROUNDING) for at, *_ in found] + [round(1 / ROUNDING)]
        strides: list[list[_Event]] = []
        for (_, which, samples, joints), (now, then) in zip(found, pairwise(times), strict=True):
            if samples and which == self._faster:
                strides.append([])
            strides[-1].append(_Event(which, samples, tuple(joints.tolist()), then - now))
        return [tuple(stride) for stride in strides]

    def _over(self, ticks: int) -> tuple[Floats, Floats]:
        """Transition matrix of the plant over `ticks`, and how torques held meanwhile act; computed once per number of ticks."""
        from scipy.linalg import expm

        if ticks not in self._flows:
            states, inputs = self._plant.b.shape
            rates = np.block([[self._plant.a, self._plant.b], [np.zeros((inputs, states + inputs))]])
            flow = expm(rates * (ticks * ROUNDING * self.period))
            self._flows[ticks] = flow[:states, :states], flow[:states, states:]
        return self._flows[ticks]

    def _pass(self, stride: tuple[_Event, ...], y: Any, factors: list[Any]) -> None:
        """Brings states, the columns of y, from one sample of the faster path to the next."""
        for event in stride:
            self._torques(event, y, factors)
            self._move(event, y, 0.0)

    def _torques(self, event: _Event, y: Any, factors: list[Any]) -> None:
        """Update of `y` at an event: the path's law computes its torques, and torques that arrive begin to act."""
        path, lines, acting = self._paths[event.path], y[self._lines[event.path]], y[self._acting[event.path]]
        if event.samples:
            memory, measured = y[self._memory[event.path]], factors[event.path][:, None] * (self._plant.c @ y[self._x])
            lines[self.size :] = lines[: -self.size].copy()
            lines[: self.size] = -(path.law.c @ memory + path.law.d @ measured)  # newest first
            memory[:] = path.law.a @ memory + path.law.b @ measured
        joints = np.array(event.joints, dtype=int)
        acting[joints] = lines[path.late[joints] * self.size + joints]

    def _move(self, event: _Event, y: Any, beside: Any) -> None:
        """Update of `y` by the physics until the next event, with torques `beside` those of the paths."""
        if event.ticks:
            move, push = self._over(event.ticks)
            y[self._x] = move @ y[self._x] + push @ (y[self._acting[0]] + y[self._acting[1]] + beside)

    def _factors(self, others: Any, kd: Any) -> tuple[list[Any], type]:
        factors = [self._gain * np.broadcast_to(np.asarray(one), (self.size,)) for one in (others, kd)]
        return factors, complex if any(np.iscomplexobj(one) for one in factors) else float

    def matrix(self, others: Any = 1.0, kd: Any = 1.0) -> Complexes:
        """State transition Φ over a common period, with factors, real or complex, on the measured positions of either path."""
        factors, kind = self._factors(others, kd)
        y: Any = np.eye(self.states, dtype=kind)
        for stride, same in groupby(self._strides):
            count, few = len(list(same)), self._of_faster
            if count > 2 and all(event.path == self._faster for event in stride):  # most of the period: a power of one matrix
                once: Any = np.eye(few, dtype=kind)
                self._pass(stride, once, factors)
                y[:few] = np.linalg.matrix_power(once, count) @ y[:few]
            else:
                for _ in range(count):
                    self._pass(stride, y, factors)
        return y

    @cached_property
    def holds(self) -> list[_Hold]:
        """Holds of every joint's torque within a period, joint by joint in the order of time: from one arrival on a path to the next.

        A path without gains on the joint has no arrivals: where kp or kd is 0, the sampled loop of the other path is left.
        """
        events = [event for stride in self._strides for event in stride]
        start, whole, found = np.cumsum([0, *(event.ticks for event in events)]), round(1 / ROUNDING), list[_Hold]()
        acts = [np.any(path.law.c, axis=1) | np.any(path.law.d, axis=1) for path in self._paths]
        for joint in range(self.size):
            own = [k for k, event in enumerate(events) if joint in event.joints and acts[event.path][joint]]
            ends = [*start[own[1:]].tolist(), *(start[k] + whole for k in own[:1])]
            found += [_Hold(joint, k, int(start[k]), int(end - start[k])) for k, end in zip(own, ends, strict=True) if end > start[k]]
        return found

    def torques(self) -> StateSpace:
        """Complementary sensitivity T: from disturbance torques (m,), one per hold of `holds`, to the torques (m,) that answer them.

        Its `a` is Φ. Inputs and outputs are in units in which the sum of squares is ∫ torque² dt of a period over its length. The
        disturbances held when a period ends are states, too.
        """
        count, size, factors = len(self.holds), self.size, self._factors(1.0, 1.0)[0]
        y = np.eye(self.states, self.states + size + count)
        held, taken = np.eye(size, y.shape[1], self.states), np.zeros((count, y.shape[1]))
        starting: dict[int, list[int]] = {}
        for row, hold in enumerate(self.holds):
            starting.setdefault(hold.event, []).append(row)
        for k, event in enumerate(event for stride in self._strides for event in stride):
            self._torques(event, y, factors)
            for row in starting.get(k, ()):
                joint, unit = self.holds[row].joint, math.sqrt(self.holds[row].ticks * ROUNDING)
                held[joint] = 0.0
                held[joint, self.states + size + row] = 1 / unit
                taken[row] = -unit * (y[self._acting[0]][joint] + y[self._acting[1]][joint])
            self._move(event, y, held)
        edge, after = self.states + size, np.vstack([y, held])
        return StateSpace(after[:, :edge], after[:, edge:], taken[:, :edge], taken[:, edge:])

    def frequency(self, angle: float, disturbance: Complexes, rows: Integers) -> float:
        """Strongest frequency [rad/s] of torques held in `rows` of `holds`, of all aliases of e^{j angle}."""
        starts, lengths = (np.array([getattr(self.holds[row], name) for row in rows]) * ROUNDING for name in ("start", "ticks"))
        turns = np.arange(-len(rows), len(rows) + 1)
        phase = 1j * (angle + 2 * np.pi * turns)[:, None]
        parts = np.exp(-phase * (starts + lengths / 2)) * np.sinc(phase.imag * lengths / (2 * np.pi)) * np.sqrt(lengths)
        strongest = int(np.argmax(np.abs(parts @ disturbance)))
        return abs(angle + 2 * np.pi * float(turns[strongest])) / self.period

    def vibration(self, others: Any = 1.0, kd: Any = 1.0) -> tuple[float, Complexes]:
        """The frequency [rad/s], with its sign, at which the mode of the eigenvalue furthest out moves most, and that part of it (n,).

        A mode of a periodic system holds a frequency and its aliases; seen at the faster path's samples the largest one is told from them.
        """
        values, vectors = np.linalg.eig(self.matrix(others, kd))
        first = int(np.argmax(np.abs(values)))
        alias = float(np.angle(values[first])) / self.period
        y: Any = vectors[:, [first]].astype(complex)
        factors, _ = self._factors(others, kd)
        moved, step = np.zeros((len(self._strides), self.size), dtype=complex), self.period / len(self._strides)
        for k, stride in enumerate(self._strides):
            moved[k] = (self._plant.c @ y[self._x])[:, 0] * np.exp(-1j * alias * k * step)
            self._pass(stride, y, factors)
        parts = np.fft.fft(moved, axis=0)
        row = int(np.argmax(np.linalg.norm(parts, axis=1)))
        turns = float(np.fft.fftfreq(len(moved), 1 / len(moved))[row])
        mode = parts[row] / parts[row][np.argmax(np.abs(parts[row]))]
        return alias + 2 * np.pi * turns / self.period, mode


def _of_position(law: StateSpace, size: int, step: float) -> StateSpace:
    """Law as x ↦ a x + b u, where it was δ x = a x + b u, with the position as its only input, from which the velocity is made."""
    b, d = (one[:, :size] + one[:, size:] for one in (law.b, law.d))
    return StateSpace(np.eye(len(law.a)) + step * law.a, step * b, law.c, d)


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

    def unstable(self) -> int:
        """Number of eigenvalues outside the unit circle."""
        return _outside(self.values())

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
        """The end of a stable interval of a factor on all gains."""
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
        found = first_lost(lambda t: self.values(lifted=self.lifted.later(t * period, kd * t * period)), 0.0, farthest / period)
        return None if found is None else replace(found, at=found.at * period), farthest == 1.0

    def delay_of_others(self) -> float:
        """Delay [s] of the other gains' path at which the loop is lost, as the function delay_of_others below."""
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
    """slope T + offset I."""
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
