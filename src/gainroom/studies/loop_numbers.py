"""Margins and limits of one loop for studies; where numbers cannot be found, stability alone."""

import math
from dataclasses import replace

import numpy as np

from ..analysis.boundary import coupled_delay_margin
from ..analysis.gain_limit import gain_limit
from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import joint_margins, margins
from ..analysis.proved_limit import proved_limit
from ..analysis.stability import has_growing_root, unstable_roots
from ..analysis.uncoupled_groups import uncoupled_groups
from ..design.gain_cases import bounded_margins
from ..errors import GainroomError
from ..system.loop import Loop
from ..system.system import StateCase

FAR_BELOW = 0.01
"""Factor on unstable gains at which the proof of their limit begins, if it can."""
LATE = 1.5
"""Multiple of the required delay margin below which a delay margin is certified."""


def margins_of(loop: Loop, largest: bool = False) -> Margins:
    """Margins of a loop, several joints' phase margin unsigned and, if `largest`, with largest gains; stability alone if loci are lost."""
    try:
        if loop.size > 1:
            found = joint_margins(loop) if largest else margins(loop)
            return replace(found, phase_margin=abs(found.phase_margin))
        return margins(loop) if loop.kd_path is not None else replace(margins(loop), limit=gain_limit(loop))
    except GainroomError as error:
        return Margins.unknown(_verdict(loop, error))


def extra_delay(loop: Loop, factor: float = 1.0) -> float:
    """Delay margin [s]; inf if no extra delay makes the loops vibrate; NaN for unstable ones, and if it is not known.

    factor   common factor on all gains
    """
    try:
        return coupled_delay_margin(loop.scaled(factor)) if loop.size > 1 else margins_of(loop.scaled(factor)).delay_margin
    except GainroomError:
        return math.nan


def with_certified_delay(case: StateCase) -> Margins:
    """Sampled margins (bounded_margins) with the delay margin certified if it is near the requirement.

    Samples may miss the earlier of two close crossings, which equal limbs have; and a fraction of a tick is not exactly a phase.
    """
    found, needed = bounded_margins(case), case.system.requirements.delay_margin
    if needed is None or not found.delay_margin < LATE * needed:
        return found
    return replace(found, delay_margin=extra_delay(case.system.loop(case.model)))


def limit_of(loop: Loop) -> GainLimit:
    """Gain limit of a loop; stability alone if the limit cannot be found."""
    try:
        return gain_limit(loop)
    except GainroomError as error:
        return _verdict(loop, error)


def first_factor(loop: Loop) -> float:
    """Smallest factor on all gains at which a loop vibrates; NaN: not known.

    The proof begins at zero gain and ends at the first crossing, so the limit of an unstable loop's smaller gains is its own. Uncoupled
    limbs are examined one by one.
    """
    return float(np.min([_first_factor(limb) for _, limb in uncoupled_groups(loop)] or [_first_factor(loop)]))


def _first_factor(limb: Loop) -> float:
    """Smallest factor on all gains at which a loop of one coupled group vibrates; NaN: not known."""
    proved = proved_limit(limb)
    if proved is not None:
        return proved.gain
    proved = proved_limit(limb.scaled(FAR_BELOW))
    if proved is not None and proved.gain < math.inf:  # a proof from far below ends not far above
        return FAR_BELOW * proved.gain
    limit = limit_of(limb)
    return limit.gain if limit.stable or math.isnan(limit.gain) else min(limit.gain, 1.0)


def _verdict(loop: Loop, error: GainroomError) -> GainLimit:
    """Stability alone of a loop whose limit cannot be found; as in gain_limit, roots that no gain moves are not counted.

    Raises `error` if the roots cannot be found, either.
    """
    try:
        stable = not has_growing_root(loop) and unstable_roots(loop) == 0
    except (np.linalg.LinAlgError, ValueError):  # gains so absurd that the state matrix is not finite
        raise error from None
    return GainLimit.unknown(loop.size, stable)
