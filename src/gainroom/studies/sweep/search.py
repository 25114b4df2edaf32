"""Local search from the worst postures of a sweep for a worse one that the sweep may have missed."""

import numpy as np

from ...system.linear.arrays import Floats
from .plan import SweepPlan
from .summary import SweepSummary, SweptPosture

STARTS = 3
"""Number of starting postures of each contact state."""
FIRST, LAST = 0.1, 1e-3
"""First and last step, relative to each joint's range."""
MOST, FEW = 60, 6
"""Most steps from one start; FEW if each limit is computed individually, which takes ten times as long."""


def searched(summary: SweepSummary) -> SweptPosture | None:
    """Lowest limit reached by steps along single joints, within the sweep's box; None if there is no sweep to start from.

    If no common factor on the gains is stable in some posture, nothing lower is searched. Pattern search (Kolda, Lewis and Torczon, SIAM
    Review 45, 2003): every joint up and down, the lowest is the next start, and if none is lower the step is halved. It finds a local
    minimum, from a grid as from samples.
    """
    plan = summary.plan
    low, high = plan.postures.low, plan.postures.high
    found = summary.worst_posture
    if found is None or not found.gain > 0 or not np.any(high > low):
        return found
    for contact in summary.contacts:
        for start in contact.worst[:STARTS]:
            reached = _downhill(plan, start, low, high)
            if reached.gain < found.gain:
                found = reached
    return found


def _downhill(plan: SweepPlan, start: SweptPosture, low: Floats, high: Floats) -> SweptPosture:
    limits, best = plan.at(start.draw, start.contact), start
    moving = np.flatnonzero(high > low)
    step = FIRST
    for _ in range(MOST if limits.quick else FEW):
        trials = np.repeat(best.angles[None], 2 * len(moving), axis=0)
        rows = np.arange(len(moving))
        trials[rows, moving] += step * (high - low)[moving]
        trials[rows + len(moving), moving] -= step * (high - low)[moving]
        trials = np.clip(trials, low, high)
        answers = limits.limits(trials)
        row = int(np.argmin(np.where(np.isnan(answers.gain), np.inf, answers.gain)))
        if answers.gain[row] < best.gain * (1 - 1e-9):
            best = SweptPosture.of(answers, row, (-1, start.contact, start.draw), trials[row])
        elif step > LAST:
            step /= 2
        else:
            break
    return best
