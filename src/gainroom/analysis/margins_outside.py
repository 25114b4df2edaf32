"""Margins of a stable loop outside some bands of frequencies: what is left when what happens there is somebody else's to damp.

They are read from samples that are polished; no root is counted, as roots of all frequencies are counted together.
"""

import math
from dataclasses import replace

import numpy as np

from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from .first_crossing import phases
from .loci import Sweep
from .margin_record import Margins
from .return_ratios import Sampled, own_phases


def margins_outside(loop: Loop, found: Margins, bands: Floats) -> Margins:
    """`found`, with phase margins and peak sensitivities as they are outside `bands` (k, 2) [rad/s]; others as they are, none certified.

    Raises LinAlgError where a root lies on the stability boundary, to the last digit.
    """

    def outside(omega: Floats) -> Booleans:
        inside = (np.asarray(omega)[..., None] > bands[:, 0]) & (np.asarray(omega)[..., None] < bands[:, 1])
        return ~np.any(inside, axis=-1)

    sweep = Sweep(loop)
    sampled = Sampled.of(sweep)
    peaks, own = sampled.own_peaks(within=outside), own_phases(sampled.single, outside)
    at, omega = min(
        ((abs(at), (at, omega)) for at, omega in _common_phases(sweep) if outside(np.array(omega))), default=(0.0, (math.inf, math.nan))
    )[1]
    peak = max(peaks)
    return replace(
        found,
        one_loop=replace(found.one_loop, phase_margin=own, peak_sensitivity=np.array([one.height for one in peaks])),
        phase_margin=abs(at),
        gain_crossover=omega,
        peak_sensitivity=peak.height,
        peak_sensitivity_frequency=peak.omega,
        certified=False,
        phase_certificate=None,
        phase_crossings=(),
        gain_crossings=(),
    )


def _common_phases(sweep: Sweep) -> list[tuple[float, float]]:
    """Every phase [rad] in all loops, lag or lead, that puts a root on the boundary, and its frequency [rad/s]."""
    found = []
    for way in (1, -1):
        family = phases(sweep, way)
        found += [(way * one.at, one.omega) for one in family.polish(family.crossings())]
    return found
