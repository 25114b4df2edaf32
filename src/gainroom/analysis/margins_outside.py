"""Margins of a stable loop outside some bands of frequencies: what is left when what happens there is somebody else's to damp.

They are read from samples that are polished; no root is counted, as roots of all frequencies are counted together.
"""

import math
from dataclasses import replace

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from .first_crossing import SEARCH, phases
from .loci import Sweep
from .margin_record import Margins
from .return_ratios import Peak, Sampled, Within, own_phases


def margins_outside(loop: Loop, found: Margins, bands: Floats) -> Margins:
    """`found`, with phase margins and peak sensitivities as they are outside `bands` (k, 2) [rad/s]; others as they are, none certified.

    Those are NaN where loci cannot be followed, and where a root lies on the stability boundary, to the last digit.
    """

    def outside(omega: Floats) -> Booleans:
        inside = (np.asarray(omega)[..., None] > bands[:, 0]) & (np.asarray(omega)[..., None] < bands[:, 1])
        return ~np.any(inside, axis=-1)

    try:
        sweep = Sweep(loop)
        sampled = Sampled.of(sweep)
        peaks, own = sampled.own_peaks(within=outside), own_phases(sampled.single, outside)
        at, omega = _common_phase(sweep, outside)
    except (GainroomError, np.linalg.LinAlgError):
        peaks, own, at, omega = [Peak(math.nan, math.nan)] * loop.size, np.full(loop.size, math.nan), math.nan, math.nan
    peak = max(peaks)
    return replace(
        found,
        one_loop=replace(found.one_loop, phase_margin=own, peak_sensitivity=np.array([one.height for one in peaks])),
        phase_margin=at,
        gain_crossover=omega,
        peak_sensitivity=peak.height,
        peak_sensitivity_frequency=peak.omega,
        certified=False,
        phase_certificate=None,
        phase_crossings=(),
        gain_crossings=(),
    )


def _common_phase(sweep: Sweep, outside: Within) -> tuple[float, float]:
    """The smallest phase [rad] in all loops, lag or lead, that puts a root on the boundary `outside`, and where [rad/s]; inf: none does.

    A crossing between samples that polishing does not find counts as it is interpolated: none is left out.
    """
    every = []
    for way in (1, -1):
        family = phases(sweep, way)
        rough = family.crossings()
        exact = family.polish(rough)
        every += exact
        every += [one for one in rough if all(abs(one.omega - other.omega) > SEARCH.close * one.omega for other in exact)]
    return min(((one.at, one.omega) for one in every if outside(np.array(one.omega))), default=(math.inf, math.nan))
