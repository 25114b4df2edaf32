"""Modal response of a loop's motors in the core (native/include/gainroom/modal_loop.hpp)."""

import numpy as np

from ..native import _core
from .assembly import Parts, current_loop
from .linear.state_space import split_delay
from .modes import Modes

APART = 1e-3  # relative distance at which poles of current loop and plant count as equal: a double pole has another response
INEXACT = 4.0  # times what a sum over modes was seen to be off by


def mode_functions(parts: Parts, seen: Modes | None = None, twofold: bool = False) -> "_core.ModalLoop | None":
    """Modal frequency functions of a plant, without controller; sampled: behind hold, current loop and fractional delay.

     seen      modes of the plant in directions other than joints; None: of the joints
     twofold   form of native/include/gainroom/exclusion.hpp

    None where the modes or functions do not exist: encoders on the links, friction to ground, unequal drives of a sampled loop, equal
    poles.
    """
    modes, drives, step = parts.plant.modes, parts.drives, parts.sample_time
    if modes is None or not parts.feedback.motor:
        return None
    current, fraction, first = (0.0, 0.0), 0.0, drives[0]
    if step is not None:
        if any(drive != first for drive in drives) or (not first.is_ideal and abs(first.damping_ratio**2 - 1) < APART):
            return None
        fraction = float(split_delay(np.array([first.delay]), step)[1][0])
        if not first.is_ideal:
            current, fast = (first.bandwidth, first.damping_ratio), current_loop(first).poles
            if np.any(np.abs(np.concatenate([modes.poles, modes.partners])[:, None] - fast) < APART * np.abs(fast)):
                return None
    seen = seen or modes
    return _core.ModalLoop(
        seen.rigid.astype(complex),
        twofold,
        seen.shapes,
        seen.poles,
        seen.partners,
        *current,
        fraction,
        step or 0.0,
        INEXACT * modes.inexact,
    )
