"""The gain limit of coupled loops, proved from ω = 0 to infinity without following characteristic loci (modal_loop.py).

From rest: at factors near 0 the roots are those of plant and controller. Resonances decay, the controller's own poles too, and a free
motion, s² = −γ μ (kp + …), where every joint's lead outweighs all lag as ω → 0. From there no root can cross below the lowest crossing, to
NUDGE of it, and the root that crosses there becomes unstable.

    ω below `low`    x P → −M₀ (1 − jω T'), d_i → (x/kp_i) (1 − jω τ_i): with τ_i > T' for all i the angle θ = 90° + ω (T' + ε) serves
    ω above `high`   |L| only falls, and is small

Counted: else, as with integrators, gravity and gains that are not symmetric, the proof begins at the factor 1. The samples that exclude
crossings also give the turn of det F at the factor 1 from one frequency to the next, and with it the number of unstable roots (Nyquist);
it has to be 0. The limits are the first crossings above and below 1.
"""

import math

import numpy as np

from ..native import _core
from ..system.loop import Loop
from .followed_root import stays_unstable
from .low_frequency_proof import LowFrequencyProof, low_frequency_proof
from .margin_record import NUDGE, Certificate, End, GainLimit, interval
from .modal_loop import ModalLoop, ProvedCrossings

UPWARDS, DOWNWARDS = (10.0, 1e3), (0.1, 0.01, 1e-4)  # farthest factors searched, first the nearer ones: most limits lie there
LOW = 0.01  # share of the lowest corner, resonance or inverse lag [rad/s] below which lead and lag are linear in ω
LEAST_LEAD = 0.02  # least excess of lead over lag at ω = 0, relative to the sum of all leads and lags
HIGH = 10.0  # multiple of the highest corner frequency or resonance above which L only falls
SMALL = 0.1  # size of the scaled return ratio, 1 of which may put a root on the boundary, at the upper end of the proof
DOUBLINGS = 40  # most doublings of the upper end until the return ratio is SMALL there
WHOLE = 1e-3  # largest distance of a root count from a whole number
UNDAMPED = 1e-9  # damping ratio below which a pole counts as on the boundary
BESIDE = 1e-6  # likewise where motors may give out energy or an integrator lags: beside such poles the proof mostly fails


def proved_limit(loop: Loop) -> GainLimit | None:
    """Gain limit of coupled loops by proof; None where no proof is known (ModalLoop.of) or where it failed.

    Of unstable loops those alone have one whose proof begins at rest.
    """
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
    """Solver of the proof from rest for the laws of `modal` and any posture's modes; None where lead does not outweigh lag."""
    corners, most = modal.law_corners[modal.law_corners > 0], float(modal.turns.max())
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
    """End of stability between the factor 1 and `stops`, the nearest first: (None,) where there is none, None where it is not known.

    counting   True: the proof also has to show that no root is unstable at the factor 1
    """
    for stop in stops:
        rest = low_frequency_proof(modal, stop)
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


def _unstable_roots(modal: ModalLoop, found: ProvedCrossings, rest: LowFrequencyProof, unstable_poles: int) -> int | None:
    """Number of unstable closed-loop roots at the factor 1, from the turn of arg det(I + L) = arg det F + Σ arg c_i; None: not whole."""
    step = None if modal.last is None else math.pi / modal.last
    turned = (
        rest.turned + found.turned - found.tail + float((modal.laws.turned(found.end, step) - found.end * modal.late).sum()) / modal.folds
    )
    count = unstable_poles + rest.poles / 2 - turned / math.pi
    return round(count) if abs(count - round(count)) < WHOLE else None


def _end(modal: ModalLoop, loop: Loop, found: ProvedCrossings, way: int) -> End | None:
    """End of stability at the first of the crossings; None where the root there does not become unstable.

    way   1: factors rise, −1: they fall
    """
    first = found.crossings[0]
    level = sum(way * (one.gain - first.gain) <= first.gain * NUDGE and way * one.growth > 0 for one in found.crossings)
    if way * first.growth <= 0:
        return None
    return End(first.gain, first.omega, modal.mode(first, loop), Certificate(0, 2 * level))


def _leads_from(modal: ModalLoop) -> float | None:
    """Lower end [rad/s] of the proof from rest, up to which no phase is curved by 1e-4 of itself; None where lead does not outweigh lag."""
    corners = np.concatenate([modal.law_corners, np.abs(modal.modes.poles)])
    corners = corners[corners > 0]
    most = float(modal.turns.max())
    if not len(corners) or not math.isfinite(most) or not np.all(modal.leads > LEAST_LEAD * modal.turns):
        return None
    low = LOW * min(float(corners.min()), 1 / most)
    return low if np.all(modal.core.responses(np.array([low]))[1].real > 0) else None


def _quiet(modal: ModalLoop, highest: float) -> float | None:
    """Upper end [rad/s] of the proof, above which `highest` times L is small; half the sample rate if sampled; None where there is none."""
    if modal.last is not None:
        return modal.last
    high = HIGH * float(max(modal.law_corners.max(initial=0.0), np.abs(modal.modes.poles).max(initial=0.0)))
    for _ in range(DOUBLINGS):
        mobility, laws = modal.response(np.array([high]))
        scaled = np.abs(mobility[0]) / np.sqrt(np.abs(laws[0])[:, None] * np.abs(laws[0]))
        if high > 0 and highest * float(scaled.sum(axis=1).max()) < SMALL:
            return high
        high *= 2
    return None
