"""The peaks of scalar responses that a walk along the boundary (crossings.py) cannot have missed by more than 1 %."""

import math

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ._batch import Batch
from ._walk import Nodes, bisect, bounds, log_size, values_between


def objective(kind: int, value: Complexes) -> Floats:
    """What each peak minimises: 0: |1+L| (Ms), 1: |1+L|/|L| (Mt), 2: 2|1+L|/|1−L| (disk margin)."""
    below = (1.0, np.abs(value), np.abs(1 - value) / 2)[kind]
    return np.divide(np.abs(1 + value), below, out=np.full(len(value), np.inf), where=np.asarray(below) > 0)


def objective_bound(kind: int, log_low: Floats, log_high: Floats, phase_low: Floats, phase_high: Floats) -> Floats:
    """Lower bound of `objective` for log|L| and arg L within the given ranges."""
    nearest = math.pi * (2 * np.floor((phase_low + phase_high) / (4 * math.pi)) + 1)
    offset = np.maximum(0.0, np.maximum(phase_low - nearest, nearest - phase_high))  # of arg L from the nearest odd multiple of π
    cosine = np.cos(np.minimum(offset, math.pi))
    if kind == 1:
        log_low, log_high = -log_high, -log_low
    low, high = np.exp(np.clip(log_low, -300, 300)), np.exp(np.clip(log_high, -300, 300))
    if kind == 2:
        # left of the imaginary axis |L| nearest to unity is closest to −1; right of it, farthest
        size = np.where(cosine >= 0, np.clip(1.0, low, high), np.where(low * high < 1, low, high))
        closeness = 2 * cosine / (size + 1 / size)
        return 2 * np.sqrt(np.maximum(0.0, 1 - closeness) / np.maximum(1 + closeness, 1e-300))
    magnitude = np.clip(cosine, low, high)
    return np.sqrt(np.maximum(0.0, 1 + magnitude**2 - 2 * magnitude * cosine))


def find_peaks(batch: Batch, nodes: Nodes) -> tuple[Floats, Booleans]:
    """(m, 3, 2) ω and minimum of each objective, and per loop whether nothing 1 % lower can be hidden."""
    count = len(batch.gain)
    peaks, decided = np.zeros((count, 3, 2)), np.ones(count, dtype=bool)
    for kind in range(3):

        def undecided(batch: Batch, nodes: Nodes, left: Integers, kind: int = kind) -> Booleans:
            width = nodes.omega[left + 1] - nodes.omega[left]
            ranges = []
            for part, end_a, end_b in (
                ("real", log_size(nodes.value[left]), log_size(nodes.value[left + 1])),
                ("imag", nodes.phase[left], nodes.phase[left + 1]),
            ):
                ranges += values_between(width, end_a, end_b, *bounds(batch, nodes, left, part))
            best = np.full(count, np.inf)
            np.minimum.at(best, nodes.owner, objective(kind, nodes.value))
            return objective_bound(kind, *ranges) < 0.99 * best[nodes.owner[left]]

        nodes, sure = bisect(batch, nodes, undecided)
        decided &= sure
        lowest = objective(kind, nodes.value)
        order = np.lexsort((lowest, nodes.owner))
        best = order[np.append(True, np.diff(nodes.owner[order]) != 0)]
        peaks[:, kind, 0], peaks[:, kind, 1] = _polish_minimum(batch, kind, nodes.owner[best], nodes.omega[best], lowest[best])
    return peaks, decided


def _polish_minimum(batch: Batch, kind: int, owner: Integers, omega: Floats, lowest: Floats) -> tuple[Floats, Floats]:
    """The local minimum of an objective next to each `omega`, by steps that grow downhill and shrink at the bottom."""
    step = 0.01 * omega
    for _ in range(200):
        if np.all(np.abs(step) <= 1e-9 * omega):  # the minimum is flat: its value is then good to about 1e-16
            break
        trial = np.maximum(omega + step, 0.5 * omega)  # an infimum at ω → 0 is approached, never passed
        if batch.sample_time > 0:
            trial = np.minimum(trial, math.pi / batch.sample_time)
        value = objective(kind, batch.evaluate(owner, trial)[0])
        better = value < lowest
        omega, lowest = np.where(better, trial, omega), np.where(better, value, lowest)
        step = np.where(better, 1.3 * step, -0.5 * step)
    return omega, lowest
