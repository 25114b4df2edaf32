"""Maps of the lowest limit over pairs of joints: over all postures in a cell of their ranges, in any contact state and draw."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ...system.linear.arrays import Floats
from .limits import Limits
from .plan import SweepPlan, SweepTask

CELLS = 12
"""Number of cells of each joint's range: with 10 000 postures some 70 lie in a cell of a pair."""
MOST_JOINTS = 16
"""Most joints mapped: of larger robots those that limit most often."""


@dataclass(frozen=True)
class PairMaps:
    """Lowest limits over pairs of the moving `joints` (indices); `edges` (CELLS + 1,) of each [rad; m if prismatic].

    lowest   by (x, y), places in `joints` with x < y, the lowest limit (CELLS, CELLS) by cells of x and y; NaN in an empty cell
    """

    joints: tuple[int, ...]
    edges: tuple[Floats, ...]
    lowest: dict[tuple[int, int], Floats]

    @property
    def telling(self) -> tuple[int, int] | None:
        """Pair whose cells differ most; None if there is none."""
        return max(self.lowest, key=lambda pair: _spread(self.lowest[pair]), default=None)


def pair_maps(plan: SweepPlan, finished: Iterable[tuple[SweepTask, Limits]], often: Floats) -> PairMaps:
    """Maps of a sweep; `often` (n,): number of times each joint limits, by which joints are chosen if there are too many."""
    low, high = plan.postures.low, plan.postures.high
    moving = np.flatnonzero(high > low)
    moving = np.sort(moving[np.argsort(-often[moving], kind="stable")[:MOST_JOINTS]])
    pairs = list(combinations(range(len(moving)), 2))
    found = np.full((len(pairs), CELLS * CELLS), np.inf)
    for task, limits in finished:
        angles = plan.postures.at(task.first, task.stop)[:, moving]
        cells = np.clip((CELLS * (angles - low[moving]) / (high - low)[moving]).astype(np.int64), 0, CELLS - 1)
        gain = np.where(np.isnan(limits.gain), np.inf, limits.gain)
        for row, (x, y) in enumerate(pairs):
            np.minimum.at(found[row], CELLS * cells[:, x] + cells[:, y], gain)
    shaped = np.where(np.isinf(found), np.nan, found).reshape(-1, CELLS, CELLS)
    edges = tuple(np.linspace(low[joint], high[joint], CELLS + 1) for joint in moving)
    return PairMaps(tuple(moving.tolist()), edges, dict(zip(pairs, shaped, strict=True)))


def _spread(lowest: Floats) -> float:
    known = lowest[np.isfinite(lowest)]
    return float(np.ptp(known)) if len(known) else 0.0
