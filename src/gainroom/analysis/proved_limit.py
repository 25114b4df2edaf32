"""The interval of a common factor on all gains of coupled loops, proved from ω = 0 to infinity without following loci (modal_loop.py).

From rest: at factors near 0 the roots are those of plant and controller. Resonances decay, the controller's own poles too, and a free
motion, s² = −γ μ (kp + …), where every joint's lead outweighs all lag as ω → 0. From there no root can cross below the lowest crossing, to
NUDGE of it; and the one that crosses there goes the wrong way.

    ω below `low`    x P → −M₀ (1 − jω T'), d_i → (x/kp_i) (1 − jω τ_i): with τ_i > T' for all i the angle θ = 90° + ω (T' + ε) serves
    ω above `high`   |L| only falls, and is small

Counted: else, as with integrators, gravity and gains that are not symmetric, the proof begins at the factor 1. What excludes crossings from
there on also tells by what det F turns at the factor 1 from one frequency to the next, and with that how many roots are unstable (Nyquist);
none is to be. The limits are the first crossings on both ways from 1.
"""

import math

import numpy as np

from ..native import _core
from ..system.loop import Loop
from .followed_root import stays_unstable
from .margin_record import NUDGE, Certificate, End, GainLimit, interval
from .modal_loop import Crossings, ModalLoop
from .proof_at_rest import AtRest, at_rest

UPWARDS, DOWNWARDS = (10.0, 1e3), (0.1, 0.01, 1e-4)  # factors that are searched, first the nearer ones: most limits lie there
LOW = 0.01  # of the lowest corner frequency, resonance or inverse of a lag: below, lead and lag are as their slopes say
LEAST_LEAD = 0.02  # of all that leads and lags together: by so much lead has to exceed lag
HIGH = 10.0  # times the highest corner frequency or resonance: above, L only falls
SMALL = 0.1  # of what puts a root on the boundary
DOUBLINGS = 40  # of a frequency until that is so
WHOLE = 1e-3  # how near to a whole number a count of roots has to be
UNDAMPED = 1e-9  # damping ratio of a pole that may as well lie on the boundary
BESIDE = 1e-6  # likewise, of one that is mostly in vain searched beside: where the motors may give out energy, or an integrator lags


def proved_limit(loop: Loop) -> GainLimit | None:
    """None where no proof is known, see ModalLoop.of, or it failed; of unstable loops but those that the proof from rest begins below."""
    modal = ModalLoop.of(loop)
    if modal is None:
        return None
    poles = np.concatenate([modal.plant.poles, modal.plant.partners])
    undamped = UNDAMPED if modal.passive and modal.laws.poles.all() else BESIDE
    if np.any(np.abs(np.real(poles)) <= undamped * np.abs(poles)) or np.count_nonzero(np.real(poles) > 0) != loop.unstable_poles:
        return None
    low = _leads_from(modal) if _begins_at_rest(loop, modal) else None
    try:
        return _from_rest(modal, loop, low) if low is not None else _counted(modal, loop)
    except np.linalg.LinAlgError:  # channels, or eigenvectors, that are as good as dependent
        return None


def _begins_at_rest(loop: Loop, modal: ModalLoop) -> bool:
    return modal.folds == 1 and loop.parts is not None and loop.parts.plant.gravity_stiffness is None


def posture_limits(modal: ModalLoop) -> "_core.PostureLimits | None":
    """The proof from rest for the laws of `modal` behind other modes, posture by posture; None where lead does not outweigh lag."""
    corners, most = modal.bends[modal.bends > 0], float(modal.turns.max())
    if modal.torque is not None or not len(corners) or not math.isfinite(most) or not np.all(modal.leads > LEAST_LEAD * modal.turns):
        return None
    slow, fast = min(float(corners.min()), 1 / most), float(corners.max())
    return _core.PostureLimits(modal.core, slow, fast, list(UPWARDS), modal.passive)


def _from_rest(modal: ModalLoop, loop: Loop, low: float) -> GainLimit | None:
    for highest in UPWARDS:
        high = _quiet(modal, highest)
        found = None if high is None else modal.crossings(0.0, highest, low, high)
        if found is None:
            return None
        if found.crossings:
            upper = _end(modal, loop, found, 1)
            if upper is None or abs(upper.at - 1) <= NUDGE or (upper.at < 1 and not stays_unstable(loop, upper.omega, upper.at)):
                return None
            return interval(loop, upper, None, upper.at > 1)
    return interval(loop, None, None)


def _counted(modal: ModalLoop, loop: Loop) -> GainLimit | None:
    upper = _first_end(modal, loop, UPWARDS, True)
    downwards = DOWNWARDS if np.any(modal.laws.poles == 0) else DOWNWARDS[-1:]  # without integrators there is mostly none
    lower = None if upper is None else _first_end(modal, loop, downwards, False)
    return None if upper is None or lower is None else interval(loop, *upper, *lower)


def _first_end(modal: ModalLoop, loop: Loop, stops: tuple[float, ...], counting: bool) -> tuple[End | None] | None:
    """Where stability ends on the way from the factor 1 to one of `stops`, the nearest first: (None,) where it does not; None: not known.

    counting   it has to be shown that there is no unstable root at the factor 1
    """
    for stop in stops:
        rest = at_rest(modal, stop)
        high = _quiet(modal, max(stop, 1.0))
        if rest is None or high is None:
            return None
        to = stop if rest.static is None else rest.static.gain
        found = modal.crossings(1.0, to, rest.low, high, counting)
        if found is None or (counting and _unstable_roots(modal, found, rest, loop.unstable_poles) != 0):
            return None
        if found.crossings:
            end = _end(modal, loop, found, 1 if stop > 1 else -1)
            return None if end is None else (end,)
        if rest.static is not None:
            return (End(to, 0.0, rest.static.mode.astype(complex), Certificate(0, 1)),)
    return (None,)


def _unstable_roots(modal: ModalLoop, found: Crossings, rest: AtRest, unstable_poles: int) -> int | None:
    """Of the closed loop at the factor 1, from arg det(I + L) = arg det F + Σ arg c_i along the boundary; None: no whole number."""
    step = None if modal.last is None else math.pi / modal.last
    turned = (
        rest.turned + found.turned - found.tail + float((modal.laws.turned(found.end, step) - found.end * modal.late).sum()) / modal.folds
    )
    count = unstable_poles + rest.poles / 2 - turned / math.pi
    return round(count) if abs(count - round(count)) < WHOLE else None


def _end(modal: ModalLoop, loop: Loop, found: Crossings, way: int) -> End | None:
    """At the first of the crossings; None where the root there does not go the wrong way."""
    first = found.crossings[0]
    level = sum(way * (one.gain - first.gain) <= first.gain * NUDGE and way * one.growth > 0 for one in found.crossings)
    if way * first.growth <= 0:
        return None
    return End(first.gain, first.omega, modal.mode(first, loop), Certificate(0, 2 * level))


def _leads_from(modal: ModalLoop) -> float | None:
    """`low` [rad/s]; None where lead does not clearly outweigh lag at ω = 0; up to it no phase bends by 1e-4 of itself."""
    corners = np.concatenate([modal.bends, np.abs(modal.modes.poles)])
    corners = corners[corners > 0]
    most = float(modal.turns.max())
    if not len(corners) or not math.isfinite(most) or not np.all(modal.leads > LEAST_LEAD * modal.turns):
        return None
    low = LOW * min(float(corners.min()), 1 / most)
    return low if np.all(modal.core.responses(np.array([low]))[1].real > 0) else None


def _quiet(modal: ModalLoop, highest: float) -> float | None:
    """Half the sample rate; in continuous time where `highest` times L is small, above all corners; None where it does not become so."""
    if modal.last is not None:
        return modal.last
    high = HIGH * float(max(modal.bends.max(initial=0.0), np.abs(modal.modes.poles).max(initial=0.0)))
    for _ in range(DOUBLINGS):
        mobility, laws = modal.response(np.array([high]))
        scaled = np.abs(mobility[0]) / np.sqrt(np.abs(laws[0])[:, None] * np.abs(laws[0]))
        if high > 0 and highest * float(scaled.sum(axis=1).max()) < SMALL:
            return high
        high *= 2
    return None
