"""Margins of a stable loop outside some bands of frequencies, for vibrations in the bands that something else damps.

The margins are read from polished samples. They are not certified: a root count covers all frequencies together.
"""

import math
from dataclasses import replace

import numpy as np

from ..system.linear.arrays import Floats
from ..system.loop import Loop
from .core_loop import EVERY_PHASE, CoreLoop
from .margin_record import Margins


def margins_outside(loop: Loop, found: Margins, bands: Floats) -> Margins:
    """`found` with phase margins and peak sensitivities of the frequencies outside `bands` (k, 2) [rad/s]; not certified.

    All other margins stay as they are. The replaced ones are NaN where loci cannot be followed, and where a root lies on the stability
    boundary to the last digit.
    """
    phase, crossover = math.nan, math.nan
    own, peaks, peak_at = np.full(loop.size, math.nan), np.full(loop.size, math.nan), math.nan
    core = CoreLoop.of(loop)
    samples = None if core is None else core.samples(EVERY_PHASE)
    if samples is not None and samples.followed and samples.unstable == 0:
        samples.tell_apart(EVERY_PHASE.factor, math.pi)
    if samples is not None and samples.followed and samples.unstable == 0:
        common = _outside(samples.phases(locus=True), bands)
        first = int(np.argmin(np.abs(common[:, 1]))) if len(common) else None
        phase, crossover = (math.inf, math.nan) if first is None else common[first, 1:].tolist()
        own[:] = math.inf
        for joint, lag, _ in _outside(samples.phases(locus=False), bands).tolist():
            own[int(joint)] = min(own[int(joint)], abs(lag))
        heights = np.vstack([_outside(samples.sensitivities(), bands), _at_edges(loop, bands)])
        peaks[:] = 0.0
        np.maximum.at(peaks, heights[:, 0].astype(int), heights[:, 1])
        peak_at = float(heights[np.argmax(heights[:, 1]), 2])
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


def _at_edges(loop: Loop, bands: Floats) -> Floats:
    """(c, 3) joint, |S_ii| and ω at the edges of the bands that lie on the stability boundary: it is highest where a band cuts a peak."""
    last = math.inf if loop.sample_time is None else math.pi / loop.sample_time
    omega = bands[(bands > 0) & (bands < last)]
    response = loop.response(omega).reshape(len(omega), loop.size, loop.size)
    sensitivity = np.diagonal(np.linalg.inv(np.eye(loop.size) + response), axis1=1, axis2=2)
    joints = np.arange(loop.size)
    return np.array([[joint, abs(one[joint]), at] for at, one in zip(omega, sensitivity, strict=True) for joint in joints]).reshape(-1, 3)
