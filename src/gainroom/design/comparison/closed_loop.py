"""Closed loop of a structure on the joint at several corners at once: curves of one corner, and merits of many parameter vectors.

With the laws K of paths p on sensors y, G_p from a path's command, D from the load torque, broken at the motor torque:

    L_p = Σ K_pi G_pi,   S = 1/(1 + Σ L_p),   q/d = D_q − S Σ_p G_pq Σ_i K_pi D_i

Ceilings are |S| ≤ Ms, Σ_p |L_p S| |1 − e^(−jωτ_p)| ≤ 1, and the noise of the torque command. A law is stable on a joint where 1 + L turns
about 0, from the lowest frequency to half the rate, by as much as the open loop's poles ask for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...system.delay_reserve import turned
from ...system.linear.arrays import Booleans, Complexes, Floats
from .ceilings import Ceilings
from .exact_joint import SENSORS
from .joint_responses import Joint, Responses, Turns, quadrature, responses
from .objective import Objective
from .structures import Structure

LINK = SENSORS.index("link")
UNSTABLE = 1e3
"""Merit of parameters that are unstable."""
SURE = 0.75 * math.pi
"""Angle [rad] by which turns may differ from those of a stable loop: π/2 of a slow integral, whose root is below the lowest frequency.

A root outside the unit circle takes π if it is real and fast, near z = −1; the position gain holds the joint at rest, so that slow ones
come in pairs, which take 2π.
"""
PRICE = 100.0
"""Cost of a ceiling exceeded by a factor e, against ln of the objective."""


@dataclass(frozen=True)
class Curves:
    """Curves (batch, m) of closed loops.

    compliance   q/d [rad/(N m)]
    sensitivity  |S| over its ceiling
    delay        Σ_p |L_p S| |1 − e^(−jωτ_p)|
    returned     return ratio L
    noise        density of the torque command's variance, as a share of its ceiling, per rad/s (batch, m); None: no ceiling
    """

    compliance: Complexes
    sensitivity: Floats
    delay: Floats
    returned: Complexes
    noise: Floats | None

    def at(self, row: int) -> "Curves":
        """Curves (1, m) of one row of the batch."""
        one = slice(row, row + 1)
        noise = None if self.noise is None else self.noise[one]
        return Curves(self.compliance[one], self.sensitivity[one], self.delay[one], self.returned[one], noise)


def curves(structure: Structure, x: Floats, joint: Joint, at: Responses, ceilings: Ceilings) -> Curves:
    """Curves of the coordinates x (batch, n) at the responses `at` of `joint`, or of joints with the same paths and reserves."""
    omega, steps = at.omega, joint.sample_times
    laws = structure.laws(x, omega, steps)
    parts: dict[str, Complexes] = {}
    pushed: Complexes = 0.0
    for law in laws:
        k, commands = SENSORS.index(law.sensor), at.commands[law.path]
        parts[law.path] = parts.get(law.path, 0.0) + law.response * commands[:, k]
        pushed = pushed + law.response * (at.load[:, k] * commands[:, LINK])
    returned = sum(parts.values())
    sensitivity: Complexes = 1 / (1 + returned)
    size = np.abs(sensitivity)
    delay = sum(np.abs(part) * turned(omega * joint.reserves[path]) for path, part in parts.items()) * size
    density = None
    if ceilings.torque_noise is not None:
        density = 0.0
        for law in laws:
            share = ceilings.noise_of(law.sensor)
            assert share is not None
            step = steps[law.path]
            heard = at.heard[law.path] * (omega < math.pi / step) * (step / math.pi * share**2)
            density = density + (law.response.real**2 + law.response.imag**2) * heard
        density = density * size**2
    return Curves(at.load[:, LINK] - sensitivity * pushed, size / ceilings.peak_sensitivity, delay, returned, density)


def is_stable(structure: Structure, x: Floats, turns: Turns, returned: Complexes) -> Booleans:
    """True (batch,) where a loop is stable, by a count of turns of its return ratio `returned` (batch, m) at the frequencies of `turns`."""
    around = (1 + returned) * turns.flat
    turned = np.angle(around[:, 1:] * around[:, :-1].conj()).sum(axis=1)
    asked = turns.asked + _turns_of_law(structure, x)
    return np.isfinite(turned) & (np.abs(turned - asked) < SURE)


def _turns_of_law(structure: Structure, x: Floats) -> Floats:
    """Angle (batch,) [rad] by which 1 + L must turn further for the poles of the laws that are not inside the unit circle."""
    return math.pi * (structure.integrators / 2 + structure.unstable_poles(x))


@dataclass(frozen=True)
class Merits:
    """Merits (batch,) over the corners that were looked at.

    objective   ln of the worst objective
    excess      ln of the worst ceiling's value over the ceiling; <= 0 where all are kept
    stable      True where stable in all of them
    """

    objective: Floats
    excess: Floats
    stable: Booleans

    def cost(self, reserve: float = 0.0) -> Floats:
        """Cost (batch,) that the global search makes small; `reserve`: ln by which ceilings are to be kept."""
        return np.where(self.stable, self.objective + PRICE * np.maximum(self.excess + reserve, 0.0), UNSTABLE)


def as_many(grids: list[Floats]) -> list[Floats]:
    """Grids (m,) with as many frequencies each: shorter ones, of joints with other delays, get more in the middle of their widest steps."""
    most, found = max(map(len, grids)), []
    for grid in grids:
        while len(grid) < most:
            widest = np.argsort(-np.diff(np.log(grid)))[: most - len(grid)]
            grid = np.sort(np.concatenate([grid, np.sqrt(grid[widest] * grid[widest + 1])]))
        found.append(grid)
    return found


class Corners:
    """Sampled joints at all corners at which a structure's parameters are judged.

    sampled   responses of each corner, at as many frequencies
    every     the same, one after the other
    weights   of the quadrature over frequency, likewise
    """

    def __init__(self, structure: Structure, joints: Sequence[Joint], ceilings: Ceilings, objective: Objective, density: float) -> None:
        self.structure, self.joints, self.ceilings, self.objective, self.density = structure, list(joints), ceilings, objective, density
        self.omega = np.stack(as_many([joint.grid(density) for joint in joints]))
        self.rows = np.repeat(np.arange(len(joints)), self.omega.shape[1])
        self.every = responses(joints, self.omega.ravel(), self.rows)
        size = self.omega.shape[1]
        self.sampled = [self.every.part(slice(k * size, (k + 1) * size)) for k in range(len(joints))]
        self.weights = [quadrature(omega) for omega in self.omega]
        self.turns = [joint.turns(omega) for joint, omega in zip(joints, self.omega, strict=True)]
        self.evaluated = 0
        self._missed = [0] * len(joints)

    def one(self, x: Floats, corner: int) -> Merits:
        """Merits of the coordinates x (batch, n) at one corner."""
        joint, here, weights = self.joints[corner], self.sampled[corner], self.weights[corner]
        self.evaluated += len(x)
        with np.errstate(all="ignore"):
            found = curves(self.structure, x, joint, here, self.ceilings)
            stable = is_stable(self.structure, x, self.turns[corner], found.returned)
            objective = np.log(self.objective.value(np.abs(found.compliance), here.omega, weights))
            excess = np.log(np.maximum(found.sensitivity.max(axis=1), found.delay.max(axis=1)))
            if found.noise is not None:
                excess = np.maximum(excess, 0.5 * np.log(found.noise @ weights))
        stable &= np.isfinite(objective) & np.isfinite(excess)
        return Merits(objective, excess, stable)

    def are_stable(self, x: Floats, returned: Complexes) -> bool:
        """True if the coordinates x (n,), with return ratio `returned` at all frequencies, are stable at every corner."""
        parts = returned.reshape(len(self.joints), 1, -1)
        return all(is_stable(self.structure, x[None], turns, part)[0] for turns, part in zip(self.turns, parts, strict=True))

    def all(self, x: Floats) -> Merits:
        """Merits over all corners."""
        every = [self.one(x, k) for k in range(len(self.joints))]
        with np.errstate(all="ignore"):
            return Merits(
                np.max([one.objective for one in every], axis=0),
                np.max([one.excess for one in every], axis=0),
                np.all([one.stable for one in every], axis=0),
            )

    def cost(self, x: Floats, bar: Floats, reserve: float = 0.0) -> Floats:
        """Costs (batch,) over all corners; those above `bar` (batch,) at some corner are not looked at in the others."""
        cost = np.full(len(x), -np.inf)
        left = np.arange(len(x))
        for corner in self._order:
            here = self.one(x[left], corner).cost(reserve)
            cost[left] = np.maximum(cost[left], here)
            kept = cost[left] <= bar[left]
            self._missed[corner] += int(np.count_nonzero(~kept))
            left = left[kept]
            if not len(left):
                break
        return cost

    @property
    def _order(self) -> list[int]:
        """Corners, those first at which most parameters have failed so far."""
        return sorted(range(len(self.joints)), key=lambda k: -self._missed[k])
