"""The limit of a common factor on all gains of coupled loops, proved from rest to infinity without following loci (modal_loop.py).

At factors near 0 the roots are those of plant and controller: resonances decay, as the controller's own poles do, and a free motion,
s² = −γ μ (kp + …), does where every joint's lead outweighs all lag as ω → 0. From there no root can cross below the lowest crossing; and the
one that crosses there goes the wrong way.

    ω below `low`    x P → −M₀ (1 − jω T'), d_i → (x/kp_i) (1 − jω τ_i): with τ_i > T' for all i the angle θ = 90° + ω (T' + ε) serves
    ω above `high`   |L| only falls, and is small
"""

import math

import numpy as np

from ..system.loop import Loop
from .first_crossing import SEARCH, Certificate
from .margin_record import GainLimit
from .modal_loop import ModalLoop

NEAREST, FURTHEST = 10.0, 1e3  # factors that are searched, first the nearer ones: most limits lie below
LOW = 0.01  # of the lowest corner frequency, resonance or inverse of a lag: below, lead and lag are as their slopes say
LEAST_LEAD = 0.02  # of the larger of lead and lag: by so much the one has to exceed the other
HIGH = 10.0  # times the highest corner frequency or resonance: above, L only falls
SMALL = 0.1  # of what puts a root on the boundary


def proved_limit(loop: Loop) -> GainLimit | None:
    """None where no proof is known: see ModalLoop.of; with gravity, of unstable loops, or where lower gains are unstable; or it failed."""
    modal = ModalLoop.of(loop) if loop.parts is not None and loop.parts.plant.gravity_stiffness is None else None
    if modal is None or np.any(modal.modes.poles.real >= 0) or np.any(modal.modes.partners.real >= 0):
        return None
    low, high = _ends(modal)
    if not low:
        return None
    for highest in (NEAREST, FURTHEST):
        found = modal.lowest_crossings(highest, low, _quiet(modal, high, highest))
        if found is None or (found and (found[0].gain <= 1 or found[0].growth <= 0)):
            return None
        if found:
            first = found[0]
            level = sum(one.gain <= first.gain * (1 + SEARCH.nudge) for one in found)
            mode = first.mode / first.mode[np.argmax(np.abs(first.mode))]
            return GainLimit(True, first.gain, 0.0, first.omega, mode, Certificate(0, 2 * level), None, math.nan)
    return GainLimit(True, math.inf, 0.0, math.nan, np.ones(loop.size, dtype=complex), None)


def _ends(modal: ModalLoop) -> tuple[float, float]:
    """`low` and `high` [rad/s]; 0 where lead does not outweigh lag as ω → 0."""
    corners = np.concatenate([modal.bends, np.abs(modal.modes.poles)])
    low = LOW * float(corners[corners > 0].min())
    for _ in range(2):  # the second time low enough for the lags that the first has shown
        _, rigid, laws = modal.response(np.array([low]))
        with np.errstate(all="ignore"):
            lag, lead = rigid.imag[0] / low, -laws[0].imag / laws[0].real / low
        most = max(float(np.abs(lead).max()), lag)
        if not (np.all(laws[0].real > 0) and lead.min() > lag + LEAST_LEAD * most):
            return 0.0, 0.0
        low = min(low, LOW / most)
    return low, modal.last or HIGH * float(corners.max())


def _quiet(modal: ModalLoop, high: float, highest: float) -> float:
    """`high`, or further up in continuous time, where `highest` times L is small."""
    while modal.last is None:
        mobility, _, laws = modal.response(np.array([high]))
        scaled = np.abs(mobility[0]) / np.sqrt(np.abs(laws[0])[:, None] * np.abs(laws[0]))
        if highest * float(scaled.sum(axis=1).max()) < SMALL:
            break
        high *= 2
    return high
