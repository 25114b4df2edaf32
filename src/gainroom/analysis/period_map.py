"""Two loops around one plant, each with its own rate and delay: what their common period makes of the state, as one matrix.

The gains on velocity close on a path of their own (system/gain_path.py). The whole is periodic, not time-invariant: it has no frequency
response, but over one common period it is x ↦ Φ x, and it is stable where every eigenvalue of Φ lies inside the unit circle (Floquet;
Bittanti and Colaneri, Periodic Systems, 2009). Between two events, a sample or a torque that arrives, the torques are held and the
physics is a matrix exponential, so any delay of either path is exact. Both paths sample together at the start of every period.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Complexes, Floats, Integers
from ..linear.state_space import StateSpace, split_delay
from ..system.assembly import controller_state
from ..system.gain_path import samples_in_common
from ..system.loop import Loop
from ..system.measured_response import measured_state

ROUNDING = 1e-12  # of a common period: events closer than that are at the same time
MOST_STATES = 1500  # of Φ, whose eigenvalues are asked for many times


@dataclass(frozen=True)
class _Path:
    """One of the two: its law in z with (position; what velocity is made from) as input, samples per period, and delays (n,).

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


class PeriodMap:
    """Φ of a loop whose kd has a path of its own, for any factors on its gains.

    later   (others, kd) more delay of either path [s]

    Raises GainroomError where that takes too many states.
    """

    def __init__(self, loop: Loop, later: tuple[float, float] = (0.0, 0.0)) -> None:
        parts, path = loop.parts, loop.kd_path
        assert parts is not None
        assert path is not None
        assert parts.sample_time is not None
        self.size, self._gain = loop.size, loop.gain
        self._plant = measured_state(parts, "position")
        counts = samples_in_common(parts.sample_time, path.sample_time)
        self.period = parts.sample_time * counts[0]
        delays = np.array([drive.delay for drive in parts.drives]) + later[0], np.full(self.size, path.delay + later[1])
        laws = parts.controller.without_kd(), parts.controller.kd_alone()
        steps = parts.sample_time, path.sample_time
        self._paths = [
            _Path(_in_z(controller_state(law, self.size, step), step), step, count, *_split(delay, step))
            for law, step, count, delay in zip(laws, steps, counts, delays, strict=True)
        ]
        sizes = [len(self._plant.a)]
        for one in self._paths:
            sizes += [len(one.law.a), self.size, one.kept * self.size]  # memory, torques at work, torques on their way
        self._edges = np.cumsum([0, *sizes]).tolist()
        if self.states > MOST_STATES:
            raise GainroomError(f"kd_path: {self.states} states over a common period are too many: shorten the delays, or lower the rates")

    @property
    def states(self) -> int:
        """Of Φ."""
        return self._edges[-1]

    @cached_property
    def _events(self) -> list[tuple[Fraction, float, int, str, Integers]]:
        """When (share of the period, and [s] beyond it), on which path, what, and for which joints; in the order of time."""
        everyone, found = np.arange(self.size), []
        for which, path in enumerate(self._paths):
            for k in range(path.samples):
                at = Fraction(k, path.samples)
                found.append((at, 0.0, which, "sample", everyone))
                for rest in sorted({float(one) for one in path.rest if one > 0}):
                    found.append((at, rest, which, "arrival", np.flatnonzero(path.rest == rest)))
        return sorted(found, key=lambda event: float(event[0]) * self.period + event[1])

    @cached_property
    def _flows(self) -> dict[int, tuple[Floats, Floats]]:
        return {}

    def _over(self, duration: float) -> tuple[Floats, Floats]:
        """What `duration` [s] makes of the plant's state and of held torques; computed once for times that are the same."""
        from scipy.linalg import expm

        ticks = round(duration / (ROUNDING * self.period))
        if ticks not in self._flows:
            states, inputs = self._plant.b.shape
            rates = np.block([[self._plant.a, self._plant.b], [np.zeros((inputs, states + inputs))]])
            flow = expm(rates * (ticks * ROUNDING * self.period))
            self._flows[ticks] = flow[:states, :states], flow[:states, states:]
        return self._flows[ticks]

    def matrix(self, others: Any = 1.0, kd: Any = 1.0) -> Complexes:
        """Φ with what each joint measures multiplied by a factor, real or complex, on either path: numbers or (n,)."""
        return self._followed(others, kd)[0]

    def _followed(self, others: Any, kd: Any) -> tuple[Complexes, list[tuple[float, Complexes]]]:
        """Φ, and the measured positions (n, states) at every sample of the faster path with their times [s]."""
        size, plant, fastest = self.size, self._plant, int(np.argmin([one.step for one in self._paths]))
        factors = [self._gain * np.broadcast_to(np.asarray(one), (size,)) for one in (others, kd)]
        kind = complex if any(np.iscomplexobj(one) for one in factors) else float
        x, *rest = (np.eye(self.states, dtype=kind)[low:high] for low, high in pairwise(self._edges))
        memory, acting, lines, seen, now = rest[0::3], rest[1::3], rest[2::3], [], 0.0
        for share, beyond, which, what, joints in [*self._events, (Fraction(1), 0.0, 0, "end", np.zeros(0, int))]:
            at = float(share) * self.period + beyond
            if at - now > ROUNDING * self.period:
                move, push = self._over(min(at, self.period) - now)
                x, now = move @ x + push @ (acting[0] + acting[1]), at
            path = self._paths[which]
            if what == "sample":
                measured = plant.c @ x
                if which == fastest:
                    seen.append((at, measured))
                signals = np.vstack([factors[which][:, None] * measured] * 2)
                torque = -(path.law.c @ memory[which] + path.law.d @ signals)
                memory[which] = path.law.a @ memory[which] + path.law.b @ signals
                lines[which] = np.vstack([torque, lines[which][: -size or None]])  # newest first
                joints = np.flatnonzero(path.rest == 0)
            if what != "end":
                acting[which] = acting[which].copy()
                acting[which][joints] = lines[which][path.late[joints] * size + joints]
        parts = [x]
        for group in zip(memory, acting, lines, strict=True):
            parts += group
        return np.vstack(parts), seen

    def vibration(self, others: Any = 1.0, kd: Any = 1.0) -> tuple[float, Complexes]:
        """Of the eigenvalue furthest out: the frequency [rad/s] at which its mode moves most, with its sign, and that part of it (n,).

        A mode of a periodic system holds a frequency and its aliases; seen at the faster path's samples the largest one is told from them.
        """
        matrix, seen = self._followed(others, kd)
        values, vectors = np.linalg.eig(matrix)
        first = int(np.argmax(np.abs(values)))
        alias = float(np.angle(values[first])) / self.period
        moved = np.array([positions @ vectors[:, first] * np.exp(-1j * alias * at) for at, positions in seen])
        parts = np.fft.fft(moved, axis=0)
        row = int(np.argmax(np.linalg.norm(parts, axis=1)))
        turns = float(np.fft.fftfreq(len(seen), 1 / len(seen))[row])
        mode = parts[row] / parts[row][np.argmax(np.abs(parts[row]))]
        return alias + 2 * np.pi * turns / self.period, mode


def _split(delays: Floats, step: float) -> tuple[Integers, Floats]:
    whole, fraction = split_delay(delays, step)
    return whole, fraction * step


def _in_z(law: StateSpace, step: float) -> StateSpace:
    """x ↦ a x + b u instead of δ x = a x + b u."""
    return StateSpace(np.eye(len(law.a)) + step * law.a, step * law.b, law.c, law.d)
