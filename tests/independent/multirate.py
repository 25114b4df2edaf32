"""Two loops with rates of their own around one machine, as one matrix over their common period. Nothing of gainroom is used.

The gains on velocity (power 1 of V) are computed every `fast` ticks and act `fast_late` ticks after; all others every `slow` ticks and
`slow_late` ticks after. A tick is short enough for all four to be whole. Every torque that was asked for is kept in a line, tick by tick;
the physics between two ticks is one matrix exponential; and the matrix is what a period makes of every unit state.
"""

from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from math import lcm

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from .machine import Machine, actuated, law


@dataclass(frozen=True)
class TwoRates:
    """A Machine (its own delay and sample time do not count) with ticks of `tick` [s]."""

    machine: Machine
    tick: float
    slow: int
    slow_late: int
    fast: int
    fast_late: int

    def scaled(self, slow: complex, fast: complex | None = None) -> "TwoRates":
        """The gains of the slow and of the fast loop multiplied; the same factor for both where one is given."""
        factors = slow, slow if fast is None else fast
        gains = {powers: factors[powers[0]] * gain for powers, gain in self.machine.gains.items()}
        return replace(self, machine=replace(self.machine, gains=gains))

    def later(self, slow: int, fast: int) -> "TwoRates":
        """More delay [ticks]."""
        return replace(self, slow_late=self.slow_late + slow, fast_late=self.fast_late + fast)

    @property
    def period(self) -> int:
        return lcm(self.slow, self.fast)

    def matrix(self) -> np.ndarray:
        """What one common period makes of [plant, memory of both laws, both held torques, both lines]."""
        return self.lifted()[0]

    def lifted(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(a, b, c, d) of a period: a torque beside those of the loops in every tick → what the loops take of it, (ticks n)."""
        n, plant = self.machine.size, actuated(self.machine)
        flow = expm(self.tick * np.block([[plant.a, plant.b], [np.zeros((n, len(plant.a) + n))]]))
        states = len(plant.a)
        move, push = flow[:states, :states], flow[:states, states:]
        loops = []
        for every, late, power in ((self.slow, self.slow_late, 0), (self.fast, self.fast_late, 1)):
            gains = {powers: gain for powers, gain in self.machine.gains.items() if powers[0] == power}
            low_pass = self.machine.low_pass if power else None  # of the velocity, and perhaps too fast for the other loop's rate
            loops.append((every, late, law(replace(self.machine, gains=gains, low_pass=low_pass, sample_time=every * self.tick))))
        sizes = [states, *(len(one.a) for _, _, one in loops), n, n, *(late * n for _, late, _ in loops)]
        total, beside = sum(sizes), n * self.period
        edges = np.cumsum([0, *sizes])
        kind = complex if any(np.iscomplexobj(gain) for gain in self.machine.gains.values()) else float
        columns = np.eye(total + beside, dtype=kind)
        x, *rest = (columns[low:high] for low, high in pairwise(edges))
        memory, held = rest[:2], rest[2:4]
        lines = [deque(line.reshape(len(line) // n, n, total + beside)) for line in rest[4:]]  # oldest first
        taken = []
        for k in range(self.period):
            arriving = np.zeros((n, total + beside), dtype=kind)
            for i, (every, _, one) in enumerate(loops):
                if k % every == 0:
                    measured = np.vstack([plant.c[:n] @ x] * 2)
                    held[i] = -(one.c @ memory[i] + one.d @ measured)
                    memory[i] = one.a @ memory[i] + one.b @ measured
                lines[i].append(held[i])
                arriving = arriving + lines[i].popleft()
            taken.append(-arriving)
            x = move @ x + push @ (arriving + columns[total + k * n : total + (k + 1) * n])
        after, out = np.vstack([x, *memory, *held, *lines[0], *lines[1]]), np.vstack(taken)
        return after[:, :total], after[:, total:], out[:, :total], out[:, total:]

    def holds(self, joint: int, z: complex) -> np.ndarray:
        """(ticks n, holds) each column of length 1: a torque of `joint` that is held from an arrival on either path to the next.

        A hold that lasts into the next period is, in its ticks there, what it was a period before: 1/z of it.
        """
        arrivals = sorted({(every * k + late) % self.period for every, late in self._paths for k in range(self.period // every)})
        found = np.zeros((self.period * self.machine.size, len(arrivals)), dtype=complex)
        for column, (first, last) in enumerate(pairwise([*arrivals, arrivals[0] + self.period])):
            for k in range(first, last):
                found[k % self.period * self.machine.size + joint, column] = (1 if k < self.period else 1 / z) / np.sqrt(last - first)
        return found

    @property
    def _paths(self) -> tuple[tuple[int, int], tuple[int, int]]:
        return (self.slow, self.slow_late), (self.fast, self.fast_late)

    def complementary(self, points: np.ndarray, joints: "list[int] | None" = None) -> list[np.ndarray]:
        """T of a period at each z of `points`, between torques of these joints (default: all), each held as the loops hold it."""
        a, b, c, d = self.lifted()
        found = []
        for z in points.tolist():
            held = np.hstack([self.holds(k, z) for k in (range(self.machine.size) if joints is None else joints)])
            found.append(held.conj().T @ (c @ np.linalg.solve(z * np.eye(len(a)) - a, b @ held) + d @ held))
        return found

    def radius(self) -> float:
        """Largest |eigenvalue|."""
        return float(np.abs(np.linalg.eigvals(self.matrix())).max())


def first_loss(radius, low: float, high: float, steps: int = 60) -> float:
    """The first t on a grid from `low` (where radius(t) < 1) to `high` at which radius(t) > 1, then where it is 1; inf where none is."""
    grid = np.linspace(low, high, steps + 1)
    assert radius(grid[0]) < 1
    for stable, lost in pairwise(grid):
        if radius(lost) > 1:
            return brentq(lambda t: radius(t) - 1, stable, lost, xtol=1e-14)
    return np.inf
