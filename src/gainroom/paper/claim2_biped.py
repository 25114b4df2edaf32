"""Claim 2 on the biped: the same gains on every joint by itself, with the load that it feels in double and in single support."""

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..analysis.margins import to_db
from ..system.loop import build_loop
from .biped import NAMES, SUPPORTS, standing
from .claim2 import TOLERANCE
from .joints import DRIVE, GAINS, MOTOR_INERTIA, joint_with_load
from .row import Row, compare


def rows() -> list[Row]:
    """The spread of the gain limit over the twelve joints."""
    result = []
    for contact, name in SUPPORTS.items():
        loads = 1 / np.diag(standing(contact).link_inverse_inertia)
        limits = [to_db(gain_limit(build_loop(joint_with_load(load / MOTOR_INERTIA), DRIVE, GAINS)).gain) for load in loads.tolist()]
        spread = max(limits) - min(limits)
        worst = NAMES[int(np.argmin(limits))].replace("_", " ")
        verdict = "Confirmed" if spread <= TOLERANCE else f"Corrected: least on the {worst}, in the leg that swings"
        note = (
            f"{verdict}. Fig. 9's gains on every joint alone, neighbours free, in {name}: loads of {loads.min():.2g} to "
            f"{loads.max():.3g} kg m², limits of {min(limits):.2f} to {max(limits):.2f} dB."
        )
        result.append(compare(f"claim2.biped_{contact}.gain_limit_spread_db", 0.0, spread, "dB", TOLERANCE, note))
    return result


def pictures() -> list:
    """None: claim 3's picture has these joints."""
    return []
