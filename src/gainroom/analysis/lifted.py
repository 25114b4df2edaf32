"""The lifted sampled system of a loop whose kd closes on a path of its own, over the common period of both rates.

The loop is periodic, not time-invariant; lifted it is a sampled system of that period (Khargonekar, Poolla and Tannenbaum 1985; Bittanti
and Colaneri, Periodic Systems, 2009): x ↦ Φ x + B d, u = C x + D d. Between two events, a sample or a torque that arrives, the torques are
held and the physics is a matrix exponential, so any delay of either path is exact. Both paths sample together at the start of every period.
"""

import math
from copy import copy
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.assembly import controller_state
from ..system.controller import Controller
from ..system.gain_path import samples_in_common
from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.linear.state_space import StateSpace, split_delay
from ..system.loop import Loop
from ..system.measured_response import measured_state

ROUNDING = 1e-12  # part of the common period within which two events are at the same time
MOST_STATES = 1500  # largest size of Φ, whose eigenvalues are computed many times


@dataclass(frozen=True)
class _Path:
    """One of the two paths of gains: its law in z, from measured position to torque, its rate and its delays.

    step      [s] between samples
    samples   per common period
    late      (n,) whole samples of delay
    rest      (n,) [s] what is left of the delay
    """

    law: StateSpace
    step: float
    samples: int
    late: Integers
    rest: Floats

    @property
    def kept(self) -> int:
        """Number of past samples whose torques have not yet arrived and are states: n states each."""
        return int(self.late.max()) + 1

    def delayed(self, delays: Floats) -> "_Path":
        """Path with delays (n,) [s] in place of its own."""
        whole, fraction = split_delay(delays, self.step)
        return replace(self, late=whole, rest=fraction * self.step)


@dataclass(frozen=True)
class _Event:
    """Event within the common period: the path `path` samples (`samples`), or torques that it sent earlier arrive at `joints`.

    ticks   time to the next event, in units of ROUNDING
    """

    path: int
    samples: bool
    joints: tuple[int, ...]
    ticks: int


@dataclass(frozen=True)
class _Hold:
    """Interval in which one joint's torque is constant: from its arrival, event number `event` at time `start`, for `ticks`.

    Times are in units of ROUNDING.
    """

    joint: int
    event: int
    start: int
    ticks: int


class Lifted:
    """Lifted sampled system of one common period, for any factors on the gains of its two paths: first kp and ki, then kd.

    Raises GainroomError if it has more than MOST_STATES states.
    """

    def __init__(self, loop: Loop) -> None:
        parts, path = loop.parts, loop.kd_path
        assert parts is not None
        assert path is not None
        assert parts.sample_time is not None
        self.size, self._gain = loop.size, loop.gain
        self._plant = measured_state(parts)
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
        """Lifted system with the gains of `controller`; none of the gains may be 0 before or after."""
        found = copy(self)
        found._paths = [replace(path, law=law) for path, law in zip(self._paths, self._laws(controller), strict=True)]
        return found

    def later(self, others: float, kd: float) -> "Lifted":
        """Lifted system with extra delays [s]: `others` on the path of kp and ki, `kd` on that of kd."""
        found = copy(self)
        found._lay_out([path.delayed(own + more) for path, own, more in zip(self._paths, self._delays, (others, kd), strict=True)])
        return found

    def _lay_out(self, paths: list[_Path]) -> None:
        """Sets the order of the states for `paths`, and the events between the samples of the faster path.

        The states are the plant's, the torques acting now (n per path), then, for the faster path first, the controller's states and the
        torques that have not yet arrived. Those before the slower path's change alone while the slower path does nothing.
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
        """Updates y, whose columns are states, over the events `stride` from one sample of the faster path to the next."""
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
        """Intervals of a period in which each joint's torque is constant, joint by joint, rising in time.

        An interval ends where the next torque of either path arrives. A path whose gains on the joint are 0 is left out: the intervals are
        then those of the other path's sampled loop.
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
        """Complementary sensitivity T (m in, m out), from disturbance torques, one per interval of `holds`, to the controller's torques.

        Inputs and outputs are scaled so that their sum of squares is the mean of torque² over a period. States are those of Φ and the
        disturbances (n,) that act when a period ends.
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
        """Frequency [rad/s] of the strongest component of torques that repeat with e^{j angle} from period to period.

        `disturbance` holds their values in the intervals `rows` of `holds`; the candidates are all aliases of `angle`.
        """
        starts, lengths = (np.array([getattr(self.holds[row], name) for row in rows]) * ROUNDING for name in ("start", "ticks"))
        turns = np.arange(-len(rows), len(rows) + 1)
        phase = 1j * (angle + 2 * np.pi * turns)[:, None]
        parts = np.exp(-phase * (starts + lengths / 2)) * np.sinc(phase.imag * lengths / (2 * np.pi)) * np.sqrt(lengths)
        strongest = int(np.argmax(np.abs(parts @ disturbance)))
        return abs(angle + 2 * np.pi * float(turns[strongest])) / self.period

    def vibration(self, others: Any = 1.0, kd: Any = 1.0) -> tuple[float, Complexes]:
        """Frequency [rad/s], with its sign, of the mode with the largest |eigenvalue|, and its complex amplitudes (n,) at that frequency.

        A mode of a periodic system contains a frequency and its aliases; of these the one with the largest motion is returned, found from
        the positions at the samples of the faster path.
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
    """Law in z from the measured position alone to torque, from a law in δ = (z − 1)/T_s of position and velocity.

    The velocity becomes the difference of successive positions over `step` [s].
    """
    b, d = (one[:, :size] + one[:, size:] for one in (law.b, law.d))
    return StateSpace(np.eye(len(law.a)) + step * law.a, step * b, law.c, d)
