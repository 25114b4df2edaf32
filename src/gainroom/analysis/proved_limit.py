"""The limit of a common factor on all gains of coupled loops, proved from rest to infinity without following loci (modal_loop.py).

At factors near 0 the roots are those of plant and controller: resonances decay, the controller's own poles too, and a free motion,
s² = −γ μ (kp + …), where every joint's lead outweighs all lag as ω → 0. From there no root can cross below the lowest crossing, to NUDGE of
it; and the one that crosses there goes the wrong way.

    ω below `low`    x P → −M₀ (1 − jω T'), d_i → (x/kp_i) (1 − jω τ_i): with τ_i > T' for all i the angle θ = 90° + ω (T' + ε) serves
    ω above `high`   |L| only falls, and is small
"""

import math

import numpy as np

from ..native import _core
from ..system.loop import Loop
from .first_crossing import SEARCH, Certificate
from .margin_record import GainLimit
from .modal_loop import NUDGE, ModalLoop

NEAREST, FURTHEST = 10.0, 1e3  # factors that are searched, first the nearer ones: most limits lie below
LOW = 0.01  # of the lowest corner frequency, resonance or inverse of a lag: below, lead and lag are as their slopes say
LEAST_LEAD = 0.02  # of all that leads and lags together: by so much lead has to exceed lag
HIGH = 10.0  # times the highest corner frequency or resonance: above, L only falls
SMALL = 0.1  # of what puts a root on the boundary
DOUBLINGS = 40  # of a frequency until that is so


def proved_limit(loop: Loop) -> GainLimit | None:
    """None where no proof is known: see ModalLoop.of; with gravity, of unstable loops, or where lower gains are unstable; or it failed."""
    modal = ModalLoop.of(loop) if loop.parts is not None and loop.parts.plant.gravity_stiffness is None else None
    if modal is None or np.any(modal.modes.poles.real >= 0) or np.any(modal.modes.partners.real >= 0):
        return None
    ends = _ends(modal)
    if ends is None:
        return None
    low, high = ends
    for highest in (NEAREST, FURTHEST):
        quiet = _quiet(modal, high, highest)
        found = None if quiet is None else modal.lowest_crossings(highest, low, quiet)
        if found is None or (found and (found[0].gain <= 1 + NUDGE or found[0].growth <= 0)):
            return None
        if found:
            first = found[0]
            level = sum(one.gain <= first.gain * (1 + SEARCH.nudge) and one.growth > 0 for one in found)
            mode = first.mode / first.mode[np.argmax(np.abs(first.mode))]
            return GainLimit(True, first.gain, 0.0, first.omega, mode, Certificate(0, 2 * level), None, math.nan)
    return GainLimit(True, math.inf, 0.0, math.nan, np.ones(loop.size, dtype=complex), None)


def posture_limits(modal: ModalLoop) -> "_core.PostureLimits | None":
    """The same proof for the laws of `modal` behind other modes, one posture after the other; None where lead does not outweigh lag."""
    corners, most = modal.bends[modal.bends > 0], float(modal.turns.max())
    if not len(corners) or not math.isfinite(most) or not np.all(modal.leads > LEAST_LEAD * modal.turns):
        return None
    slow, fast = min(float(corners.min()), 1 / most), float(corners.max())
    return _core.PostureLimits(modal.core, slow, fast, [NEAREST, FURTHEST], modal.passive)


def _ends(modal: ModalLoop) -> tuple[float, float] | None:
    """`low` and `high` [rad/s]; None where lead does not clearly outweigh lag at ω = 0; up to `low` no phase bends by 1e-4 of itself."""
    corners = np.concatenate([modal.bends, np.abs(modal.modes.poles)])
    corners = corners[corners > 0]
    most = float(modal.turns.max())
    if not len(corners) or not math.isfinite(most) or not np.all(modal.leads > LEAST_LEAD * modal.turns):
        return None
    low = LOW * min(float(corners.min()), 1 / most)
    if not np.all(modal.response(np.array([low]))[1].real > 0):
        return None
    return low, modal.last or HIGH * float(corners.max())


def _quiet(modal: ModalLoop, high: float, highest: float) -> float | None:
    """`high`, or further up in continuous time, where `highest` times L is small; None where it does not become so."""
    for _ in range(DOUBLINGS if modal.last is None else 0):
        mobility, laws = modal.response(np.array([high]))
        scaled = np.abs(mobility[0]) / np.sqrt(np.abs(laws[0])[:, None] * np.abs(laws[0]))
        if highest * float(scaled.sum(axis=1).max()) < SMALL:
            return high
        high *= 2
    return modal.last
