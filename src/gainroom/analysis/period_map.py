"""Two loops around one plant, each with its own rate and delay: what their common period makes of the state, as one matrix.

The gains on velocity close on a path of their own (system/gain_path.py). The whole is periodic, not time-invariant: it has no frequency
response, but over one common period it is x ↦ Φ x, and it is stable where every eigenvalue of Φ lies inside the unit circle (Floquet;
Bittanti and Colaneri, Periodic Systems, 2009). Between two events, a sample or a torque that arrives, the torques are held and the
physics is a matrix exponential, so any delay of either path is exact. Both paths sample together at the start of every period.
"""

from copy import copy
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.assembly import controller_state
from ..system.gain_path import samples_in_common
from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.linear.state_space import StateSpace, split_delay
from ..system.loop import Loop
from ..system.measured_response import measured_state

ROUNDING = 1e-12  # of a common period: events closer than that are at the same time
MOST_STATES = 1500  # of Φ, whose eigenvalues are asked for many times


@dataclass(frozen=True)
class _Path:
    """One of the two: its law in z of the measured position, samples per period, and delays (n,).

    late   whole samples, `rest` [s] what is beyond
    """

    law: StateSpace
    step: float
    samples: int
    late: Integers
    rest: Floats

    @property
    def kept(self) -> int:
        """Torques of the past that are not yet at work: rows of n."""
        return int(self.late.max()) + 1

    def delayed(self, delays: Floats) -> "_Path":
        """The same with these delays [s]."""
        whole, fraction = split_delay(delays, self.step)
        return replace(self, late=whole, rest=fraction * self.step)


@dataclass(frozen=True)
class _Event:
    """A path samples, or torques that it asked for earlier arrive at these joints; then the physics for `ticks` of ROUNDING."""

    path: int
    samples: bool
    joints: tuple[int, ...]
    ticks: int


class PeriodMap:
    """Φ of a loop whose kd has a path of its own, for any factors on its gains. The paths are (others, kd).

    Raises GainroomError where that takes too many states.
    """

    def __init__(self, loop: Loop) -> None:
        parts, path = loop.parts, loop.kd_path
        assert parts is not None
        assert path is not None
        assert parts.sample_time is not None
        self.size, self._gain = loop.size, loop.gain
        self._plant = measured_state(parts, "position")
        steps = parts.sample_time, path.sample_time
        counts = samples_in_common(*steps)
        self.period, self._faster = parts.sample_time * counts[0], int(np.argmin(steps))
        self._flows: dict[int, tuple[Floats, Floats]] = {}
        self._delays = parts.delays, np.full(self.size, path.delay)
        laws = parts.controller.without_kd(), parts.controller.kd_alone()
        nothing = np.zeros(self.size, dtype=int), np.zeros(self.size)
        self._lay_out([
            _Path(_of_position(controller_state(law, self.size, step), self.size, step), step, count, *nothing).delayed(delays)
            for law, step, count, delays in zip(laws, steps, counts, self._delays, strict=True)
        ])  # fmt: skip

    def later(self, others: float, kd: float) -> "PeriodMap":
        """The same with more delay [s] on either path."""
        found = copy(self)
        found._lay_out([path.delayed(own + more) for path, own, more in zip(self._paths, self._delays, (others, kd), strict=True)])
        return found

    def _lay_out(self, paths: list[_Path]) -> None:
        """Where the parts of the state are, and what happens from one sample of the faster path to the next.

        First what the faster path alone changes: the plant's state, torques at work, its memory, torques on their way; then the slower
        path's memory and torques on their way.
        """
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
        """In the order of time, cut where the faster path samples."""
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
        """What that time makes of the plant's state and of held torques; computed once for times that are the same."""
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
            path, lines, acting = self._paths[event.path], y[self._lines[event.path]], y[self._acting[event.path]]
            if event.samples:
                memory, measured = y[self._memory[event.path]], factors[event.path][:, None] * (self._plant.c @ y[self._x])
                lines[self.size :] = lines[: -self.size].copy()
                lines[: self.size] = -(path.law.c @ memory + path.law.d @ measured)  # newest first
                memory[:] = path.law.a @ memory + path.law.b @ measured
            joints = np.array(event.joints, dtype=int)
            acting[joints] = lines[path.late[joints] * self.size + joints]
            if event.ticks:
                move, push = self._over(event.ticks)
                y[self._x] = move @ y[self._x] + push @ (y[self._acting[0]] + y[self._acting[1]])

    def _factors(self, others: Any, kd: Any) -> tuple[list[Any], type]:
        factors = [self._gain * np.broadcast_to(np.asarray(one), (self.size,)) for one in (others, kd)]
        return factors, complex if any(np.iscomplexobj(one) for one in factors) else float

    def matrix(self, others: Any = 1.0, kd: Any = 1.0) -> Complexes:
        """Φ with what each joint measures multiplied by a factor, real or complex, on either path: numbers or (n,)."""
        factors, kind = self._factors(others, kd)
        y: Any = np.eye(self.states, dtype=kind)
        for stride, same in groupby(self._strides):
            count, few = len(list(same)), self._of_faster
            if count > 2 and all(event.path == self._faster for event in stride):  # most of the period: a power of what changes there
                once: Any = np.eye(few, dtype=kind)
                self._pass(stride, once, factors)
                y[:few] = np.linalg.matrix_power(once, count) @ y[:few]
            else:
                for _ in range(count):
                    self._pass(stride, y, factors)
        return y

    def vibration(self, others: Any = 1.0, kd: Any = 1.0) -> tuple[float, Complexes]:
        """Of the eigenvalue furthest out: the frequency [rad/s] at which its mode moves most, with its sign, and that part of it (n,).

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
    """x ↦ a x + b u instead of δ x = a x + b u, and u the position, from which the velocity is made, too."""
    b, d = (one[:, :size] + one[:, size:] for one in (law.b, law.d))
    return StateSpace(np.eye(len(law.a)) + step * law.a, step * b, law.c, d)
