"""Global search for a structure's parameters: differential evolution, seeded (Storn and Price 1997, J. Global Optimization 11)."""

from collections.abc import Callable, Sequence

import numpy as np

from ...system.linear.arrays import Floats
from .closed_loop import UNSTABLE, Corners

PER_PARAMETER, MOST, FEW = 8, 64, 3
"""Members of the population per parameter, and their largest number. Up to FEW parameters have as many: in the states of a robot what keeps
the ceilings may be islands, of which the best is small.
"""
CROSSED = 0.85  # share of coordinates that come from the mutant
ALIKE = 2e-3  # spread of costs, in ln, at which a population ends


def evolved(
    corners: Corners,
    seed: int,
    generations: int,
    starts: Sequence[Floats] = (),
    reserve: float = 0.0,
    progress: Callable[[], None] = lambda: None,
) -> tuple[Floats, Floats]:
    """Final population (p, n) and its costs (p,), the best first.

    starts   coordinates that the population begins with, beside random ones within the structure's box
    """
    rng = np.random.default_rng(seed)
    low, high = corners.structure.box
    least, most = corners.structure.limits
    size = MOST if len(low) <= FEW else min(PER_PARAMETER * len(low), MOST)
    members = low + (high - low) * _spread(rng, size, len(low))
    for k, start in enumerate(list(starts)[:size]):
        members[k] = start
    cost = corners.cost(members, np.full(size, np.inf), reserve)
    for _ in range(generations):
        progress()
        best = members[np.argmin(cost)]
        picks = np.argsort(rng.random((size, size)), axis=1)  # three different members each
        first, second, third = (members[picks[:, k]] for k in range(3))
        factor = rng.uniform(0.4, 0.9, (size, 1))
        toward = np.where(rng.random((size, 1)) < 0.5, rng.uniform(0.2, 0.9, (size, 1)), 0.0)  # half of them drawn to the best
        mutants = np.where(toward > 0, members, third) + toward * (best - members) + factor * (first - second)
        kept = rng.random((size, len(low))) > CROSSED
        kept[np.arange(size), rng.integers(len(low), size=size)] = False
        trial = np.clip(np.where(kept, members, mutants), least, most)
        found = corners.cost(trial, cost, reserve)
        better = found <= cost
        members[better], cost[better] = trial[better], found[better]
        settled = np.sort(cost)[: size // 2]
        if settled[-1] < UNSTABLE and settled[-1] - settled[0] < ALIKE:
            break
    order = np.argsort(cost, kind="stable")
    return members[order], cost[order]


def _spread(rng: np.random.Generator, count: int, size: int) -> Floats:
    """Points (count, size) in the unit cube, each coordinate evenly spread (Latin hypercube)."""
    return np.stack([(rng.permutation(count) + rng.random(count)) / count for _ in range(size)], axis=1)
