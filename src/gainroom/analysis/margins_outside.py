"""Margins of a stable loop outside some bands of frequencies, for vibrations in the bands that something else damps.

The margins are read from polished samples. They are not certified: a root count covers all frequencies together.
"""

import math
from dataclasses import replace

import numpy as np

from ..system.linear.arrays import Floats
from ..system.loop import Loop
from .core_loop import EVERY_PHASE, CoreLoop
from .loop_samples import LoopSamples
from .margin_record import Margins


def margins_outside(loop: Loop, found: Margins, bands: Floats) -> Margins:
    """`found` with phase margins and peak sensitivities of the frequencies outside `bands` (k, 2) [rad/s]; not certified.

    All other margins stay as they are. A peak in a band does not count, nor do its flanks outside. The replaced margins are NaN where loci
    cannot be followed, and where a root lies on the stability boundary to the last digit.
    """
    core = CoreLoop.of(loop)
    samples = None if core is None else core.samples(EVERY_PHASE)
    if samples is not None and samples.followed and samples.unstable == 0:
        samples.tell_apart(EVERY_PHASE.factor, math.pi)
    return outside(samples, found, bands)


def outside(samples: LoopSamples | None, found: Margins, bands: Floats) -> Margins:
    """Margins of `margins_outside` from samples of the loop; a phase margin beyond their reach is inf, a sensitivity 0."""
    size = len(found.one_loop.gain_margin)
    phase, crossover = math.nan, math.nan
    own, peaks, peak_at = np.full(size, math.nan), np.full(size, math.nan), math.nan
    if samples is not None and samples.followed and samples.unstable == 0:
        common = _outside(samples.phases(locus=True), bands)
        first = int(np.argmin(np.abs(common[:, 1]))) if len(common) else None
        phase, crossover = (math.inf, math.nan) if first is None else common[first, 1:].tolist()
        own[:] = math.inf
        for joint, lag, _ in _outside(samples.phases(locus=False), bands).tolist():
            own[int(joint)] = min(own[int(joint)], abs(lag))
        heights = _summits(samples.sensitivities(), bands)
        peaks[:] = 0.0
        np.maximum.at(peaks, heights[:, 0].astype(int), heights[:, 1])
        peak_at = float(heights[np.argmax(heights[:, 1]), 2]) if len(heights) else math.nan
    return replace(
        found,
        one_loop=replace(found.one_loop, phase_margin=own, peak_sensitivity=peaks),
        phase_margin=phase,
        gain_crossover=crossover,
        peak_sensitivity=float(peaks.max()),
        peak_sensitivity_frequency=peak_at,
        certified=False,
        phase_certificate=None,
        phase_crossings=(),
        gain_crossings=(),
    )


def _outside(rows: Floats, bands: Floats) -> Floats:
    """The rows (c, 3) whose last number, ω [rad/s], lies in none of the bands."""
    omega = rows[:, 2:]
    return rows[~np.any((omega > bands[:, 0]) & (omega < bands[:, 1]), axis=1)]


def _summits(rows: Floats, bands: Floats) -> Floats:
    """The rows (c, 3), joint, height and ω, that lie in no band and on no flank of a peak in one: a flank ends where heights rise again."""
    kept = []
    for joint in np.unique(rows[:, 0]):
        own = rows[rows[:, 0] == joint]
        own = own[np.argsort(own[:, 2], kind="stable")]
        rises = np.diff(own[:, 1])
        left = np.ones(len(own), dtype=bool)
        for low, high in bands.tolist():
            first, last = np.searchsorted(own[:, 2], (low, high))  # rows first to last − 1 are inside
            lowest = np.flatnonzero(rises[: max(first - 1, 0)] < 0)
            highest = np.flatnonzero(rises[last:] > 0)
            begin = int(lowest[-1]) + 1 if len(lowest) else 0
            end = last + int(highest[0]) + 1 if len(highest) else len(own)
            left[begin:end] = False
        kept.append(own[left])
    return np.vstack(kept)
