"""A peak of the link's compliance below which no linear controller on one sensor comes: weights that ascend, and their certificate."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...system.linear.arrays import Floats
from ..parallel import in_parallel
from .ceilings import Ceilings
from .certificate import AGREEMENT, Certificate
from .closed_maps import stabilised
from .dual_grid import DualGrid, least_squares
from .exact_joint import ExactJoint

STEP = 2 * math.pi * 0.1  # rad/s, at most: joints stiffen and resonate from some hertz on
DOUBLINGS = 4  # of the grid, for joints whose damping is less than a step wide
PER_DECADE = 60  # knots
RATE = 1.0  # of the ascent; from 2 on it swings
REFINED = (5, 10, 15, 20)  # steps after which knots are added
UNEVEN = 1.3  # ratio, within an interval, of a response to its ceiling, squared, from which on a knot is added
FLOOR = 3e-3  # share of the compliance's weight that stays spread over low frequencies


@dataclass(frozen=True)
class Bound:
    """Lower bound `value` [rad/(N m)] of the peak |q/d| of every linear controller on `certificate.sensor` that meets the ceilings.

    points: of half a circle on both grids; agreement: relative difference of their values.
    """

    value: float
    certificate: Certificate
    points: tuple[int, int]
    agreement: float


def lower_bound(joint: ExactJoint, ceilings: Ceilings, sensor: str = "motor", steps: int = 40) -> Bound:
    """Lower bound of the peak compliance over all linear controllers on one sensor, by `steps` of ascent of its weights.

    Raises GainroomError where the sensor sees too little to stabilise the joint, and where the weights' values do not agree.
    """
    half_rate = math.pi / joint.sample_time
    held = stabilised(joint, (sensor,))
    points = 2 ** max(13, math.ceil(math.log2(half_rate / STEP)), math.ceil(math.log2(held.ticks)))
    narrowest = 4 * half_rate / points
    most = points << DOUBLINGS
    while True:
        grid = DualGrid.of(held, joint, ceilings, sensor, _knots(half_rate, narrowest), points)
        frequency, table, noise_weight = _ascended(grid, narrowest, steps)
        unclaimed = Certificate(joint, ceilings, sensor, frequency, _short(table), float(_short(np.array(noise_weight))), points, 0.0)
        if unclaimed.agreement <= AGREEMENT or points == most:
            break
        points *= 2
    value = unclaimed.check()
    return Bound(value, replace(unclaimed, value=value), (points, 2 * points), unclaimed.agreement)


def box_bound(
    joints: Sequence[ExactJoint], ceilings: Ceilings, sensor: str = "motor", checkpoint: Callable[[], None] = lambda: None
) -> Bound:
    """Largest of the joints' bounds: one controller for all of them is a controller for each, and its worst peak is no lower."""
    jobs = [lambda checkpoint, joint=joint: lower_bound(joint, ceilings, sensor) for joint in joints]
    return max(in_parallel(jobs, checkpoint), key=lambda bound: bound.value)


def _short(values: Floats) -> Floats:
    """Values with 7 digits: what is written is what was checked, and files stay small."""
    return np.array([float(f"{value:.7g}") for value in values.ravel()]).reshape(values.shape)


def _knots(half_rate: float, narrowest: float) -> Floats:
    """Frequencies [rad/s] of the weights' table: `narrowest` apart at first, then in geometric progression."""
    ratio = 10 ** (1 / PER_DECADE)
    found = [0.0]
    while found[-1] * ratio < half_rate - 2 * narrowest:
        found.append(max(found[-1] + narrowest, found[-1] * ratio))
    return np.array([*found, half_rate])


def _ascended(grid: DualGrid, narrowest: float, steps: int) -> tuple[Floats, Floats, float]:
    """Best weights of some steps of mirror ascent: knots, table and ν. A weight grows by as much as its ceiling is exceeded."""

    def low(corner: float, mean: float) -> Floats:
        """Weights of low frequencies, up to some corner [rad/s]: where to begin."""
        return _of_mean(grid, 1 / (1 + (grid.frequency / corner) ** 2), mean)

    base = low(30, 1.0)
    table = np.array([low(20, 1.0), low(200, 0.05), np.full_like(base, 1e-4)])
    noise_weight = 0.05 if len(grid.fixed) > len(table) else 0.0
    unit = float(np.abs(grid.fixed[0]).max())  # of compliance [rad/(N m)]; other weights are in units of its square
    best, found = -math.inf, (grid.frequency, table, noise_weight)
    for step in range(steps):
        table = np.array([(1 - FLOOR) * _of_mean(grid, table[0], 1.0) + FLOOR * base, table[1] + 1e-5 * base, table[2] + 1e-6])
        weights = grid.all_weights(table, noise_weight)
        weights[0] /= unit**2
        least, q = least_squares(weights, grid.fixed, grid.free)
        value = (least - weights[1:].mean(axis=1).sum()) * unit**2
        if value > best:
            best, found = value, (grid.frequency, table * np.array([[1.0], [unit**2], [unit**2]]), noise_weight * unit**2)
        reached = grid.fixed + grid.free * q
        shares = reached.real**2 + reached.imag**2  # of each ceiling, squared
        cost = float((shares[0] * weights[0]).mean())
        shares[0] /= unit**2 * max(cost, 1e-12)
        growth = [np.clip(grid.means(share) - 1, -most, most) for share, most in zip(shares[:3], (3.0, 1.5, 1.5), strict=True)]
        table = table * np.exp(RATE * np.array(growth))
        if noise_weight:
            noise_weight *= math.exp(RATE * min(float(shares[3].mean()) - 1, 1.5))
        if step < 3:  # begin where penalties and cost are of one size
            unit *= math.sqrt(cost)
        if step in REFINED:
            finer = _finer(grid, shares[:3], narrowest)
            table = np.array([np.interp(finer, grid.frequency, one) for one in table])
            grid = replace(grid, frequency=finer)
            base = low(30, 1.0)
    return found


def _of_mean(grid: DualGrid, values: Floats, mean: float) -> Floats:
    """Values at knots, scaled to a mean over the circle."""
    return values * mean / (values @ grid.masses)


def _finer(grid: DualGrid, shares: Floats, narrowest: float) -> Floats:
    """Knots, and more between two where a response to its ceiling, squared, is uneven: as at a resonance with little damping."""
    first = np.searchsorted(grid.below, np.arange(len(grid.frequency) - 1))
    top, bottom = np.maximum.reduceat(shares, first, axis=1), np.minimum.reduceat(shares, first, axis=1)
    uneven = (top > UNEVEN * np.maximum(bottom, 0.3)).any(axis=0)  # far below its ceiling a response has no weight
    wide = np.diff(grid.frequency) >= 2 * narrowest
    middles = (grid.frequency[:-1] + grid.frequency[1:]) / 2
    return np.union1d(grid.frequency, middles[uneven & wide])
