"""Causes of a vibration, ranked by physical evidence, against the loop of a joint.yaml where there is one.

At the complex frequency s = σ + jω of a vibration a linear loop has 1 + L(s) = 0, and position over torque is the plant's P(s). So:

    gain_limit            ω is the loop's own critical frequency, its gain margin is spent, and P(s) is measured as modelled
    structural_resonance  P(s) is not as modelled there, ω is another, or it rings on where every root of the model decays sooner
    saturation            the torque is clipped and the loop is stable as it is, but not at the lower gain that clipping leaves
                          (describing function N(A) ≤ 1 of a limit: N L = −1 at the lower end of the stable gains)
    stick_slip            slower than the loop's crossover, the joint stands still in every period while the torque builds up
    quantisation          an amplitude of about an encoder's step, which is a relay: its describing function is unbounded at small ones
    external_torque       without friction, gap or limit an amplitude stays only if it is driven from outside, and then the torque of the
                          controller brakes: its mean power on the motion is negative
    torque_ripple         likewise, and the frequency goes with the speed
    backlash              P(s) is that of a gear with a part of its stiffness, the describing function of a gap
    aliasing              at a frequency that the log's rate folds to the one seen the model's loop is at its limit, and P(s) as modelled
    outer_loop            the set-point swings, and is a law of the measured position

Each piece of evidence adds nats, within ±4, to the logarithm of a cause's likelihood; the weights are round numbers.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..identification.recorded_oscillation import RecordedOscillation
from .vibration_prediction import MANY_STEPS, SAME_FREQUENCY, SAME_RESPONSE, Prediction

FEW_STEPS = 3.0  # encoder steps: amplitudes that quantisation makes
UNKNOWN = "unknown"
"""Name of "none of these causes" among the likelihoods."""
MOST_FOR, MOST_AGAINST = 2.0, -4.0  # nats of one piece of evidence
SAME_MARGIN = 0.15  # |ln| of the gain margin
OTHER_RESPONSE = 0.7  # |ln| of the plant's response: another plant
STANDING = 0.3  # share of a period in which a joint that sticks stands still, at least
CLIPPED = 0.05  # share of rows at the torque limit that counts
WHOLE_TORQUE = 0.97  # share of the controller's output: no limit takes part
FAINT = 0.1  # cosine of torque and velocity: less is nearly a quarter period between them, and a few degrees turn its sign
UNSUPPORTED = 1.0  # [nats] for none of these: a cause needs more to be named
WHOLE, MOST_ORDERS = 0.03, 200  # periods per turn of the motor: nearer to a whole number, up to so many
MOST_SOFTENED = 0.95  # share of the stiffness left by a gap
NEARLY = 0.85  # gain margin by the model of a loop that may well be stable, where parameters are a few percent off
BENT = 0.02  # third and fifth harmonics over the first, of a torque that goes to and fro through a gap
SURELY_STABLE = 1.3  # gain margin by the model beyond which what grows is not its loop
SPARED = 0.6  # relative to the limit: margin that a stable prediction leaves where parameters are a few percent off


@dataclass(frozen=True)
class Evidence:
    """One observation for or against a cause: `weight` [nats], > 0 for it. `value` as measured, `expected` if the cause were true; SI."""

    name: str
    value: float
    expected: float
    weight: float


@dataclass(frozen=True)
class Cause:
    """Cause of a vibration; `likelihood` relative to all causes and UNKNOWN, which sum to 1."""

    name: str
    likelihood: float
    evidence: tuple[Evidence, ...]


def _agrees(distance: float, deviation: float) -> float:
    """Weight [nats] of a prediction that is off by `distance`, where `deviation` is usual."""
    return max(MOST_AGAINST, MOST_FOR - 0.5 * (distance / deviation) ** 2)


def ranked_causes(seen: RecordedOscillation, predicted: Prediction | None) -> tuple[Cause, ...]:
    """Causes with their likelihoods from the sums of the evidence, most likely first."""
    judged = {name: _known(judge(seen, predicted)) for name, judge in JUDGES.items()}
    judged[UNKNOWN] = []
    sums = np.array([UNSUPPORTED if name == UNKNOWN else sum(one.weight for one in found) for name, found in judged.items()])
    shares = np.exp(sums - sums.max())
    shares /= shares.sum()
    causes = [Cause(name, float(share), tuple(found)) for (name, found), share in zip(judged.items(), shares, strict=True)]
    return tuple(sorted(causes, key=lambda cause: -cause.likelihood))


def _off(predicted: Prediction | None, seen: RecordedOscillation) -> float:
    """Log ratio, absolute, of the vibration's frequency to the predicted one; NaN: none predicted."""
    if predicted is None or not predicted.frequency > 0:
        return math.nan
    return abs(math.log(seen.vibration.frequency / predicted.frequency))


def _response_off(predicted: Prediction | None) -> float:
    """Log ratio, absolute, of the measured response to the model's, amplitude and phase; NaN: not measured."""
    return abs(np.log(predicted.response)) if predicted is not None and predicted.response == predicted.response else math.nan


def _gain_limit(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    found = [_steps_against(seen), _standing_against(seen), _answered_against(seen), _braked(seen, predicted, -3.0)]
    if predicted is None and _clipped(seen, predicted):  # a torque limit ends the growth of any vibration
        found.append(Evidence("clipped", seen.clipped, 1.0, 2.0))
    if predicted is None:
        return found
    off, margin, response = _off(predicted, seen), predicted.limit.gain, _response_off(predicted)
    # A limit on the torque lowers the gain that is left, and with it the frequency, toward that at the limit.
    at_limit = abs(math.log(seen.vibration.frequency / predicted.limit.frequency)) if predicted.limit.frequency > 0 else math.inf
    if not math.isnan(off):
        found.append(Evidence("frequency", seen.vibration.frequency, predicted.frequency, _agrees(min(off, at_limit), SAME_FREQUENCY)))
    found.append(Evidence("gain_margin", margin, 1.0, _agrees(max(0.0, math.log(max(margin, 1e-9))), SAME_MARGIN)))
    if not math.isnan(response) and not seen.irregular:
        found.append(Evidence("response", response, 0.0, _agrees(response, SAME_RESPONSE)))
    return found


def _stick_slip(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    share = seen.standing
    weight = MOST_AGAINST if math.isnan(share) else min(2.5, 12 * (share - STANDING + 0.1)) if share > STANDING - 0.1 else -3.0
    found = [Evidence("standing", share, 1.0, weight), _answered_against(seen)]
    if seen.turning is None:  # along a steady motion, friction that falls with speed drives it
        found.append(_braked(seen, predicted, -3.0))
    if predicted is not None and predicted.crossover > 0:
        slow = math.log(seen.vibration.frequency / predicted.crossover)
        least = MOST_AGAINST if seen.turning is None else -1.0  # along a motion it is as fast as the motion makes it
        found.append(Evidence("crossover", seen.vibration.frequency, predicted.crossover, 1.5 if slow < 0 else max(least, -4 * slow)))
    if predicted is not None and seen.turning is None and not predicted.integrates:  # at rest nothing builds up without an integral
        found.append(Evidence("integral", 0.0, 1.0, -3.0))
    if seen.steps < FEW_STEPS or seen.irregular:
        found.append(Evidence("steps", seen.steps, math.inf, -3.0))
    if _clipped(seen, predicted) and seen.clipped > share:
        found.append(Evidence("clipped", seen.clipped, 0.0, -2.0))
    return found


def _quantisation(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    steps = seen.steps
    weight = 3.0 if steps <= FEW_STEPS else 0.0 if steps <= MANY_STEPS else MOST_AGAINST
    found = [Evidence("steps", steps, 1.0, weight), _answered_against(seen)]
    if seen.irregular:
        found.append(Evidence("irregular", 1.0, 1.0, 1.5))
    if seen.state != "sustained":
        found.append(Evidence("growth", seen.vibration.growth_rate, 0.0, -0.5 if steps <= FEW_STEPS else -1.5))
    off = _off(predicted, seen)
    if predicted is not None and predicted.limit.gain > NEARLY and not math.isnan(off):  # steps excite what is damped least
        found.append(
            Evidence("frequency", seen.vibration.frequency, predicted.frequency, float(np.clip(_agrees(off, SAME_FREQUENCY), 0, 1)))
        )
    return found


def _structural(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    found = [_steps_against(seen), _standing_against(seen), _answered_against(seen), _held_against(seen, predicted), _turning_against(seen)]
    if _clipped(seen, predicted) and not seen.began_small:
        found.append(Evidence("clipped", seen.clipped, 0.0, -2.0))
    if predicted is None:
        return found
    off, response = _off(predicted, seen), _response_off(predicted)
    if not math.isnan(off):
        found.append(
            Evidence("frequency", seen.vibration.frequency, predicted.frequency, float(np.clip(-_agrees(off, SAME_FREQUENCY), -0.5, 1.5)))
        )
    if not math.isnan(response):
        found.append(Evidence("response", response, OTHER_RESPONSE, min(MOST_FOR, 4 * (response - 0.5))))
    if seen.state == "growing" and predicted.limit.stable and predicted.limit.gain > SURELY_STABLE:
        found.append(Evidence("unstable", predicted.limit.gain, 1.0, 1.5))
    if seen.state == "decaying" and predicted.limit.stable:
        sooner = predicted.damping / max(seen.vibration.damping_ratio, 1e-6)
        found.append(Evidence("rings", seen.vibration.damping_ratio, predicted.damping, 1.5 if sooner > 2 else -1.0))
    return found


def _saturation(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    share, clipped = seen.clipped, _clipped(seen, predicted)
    found = [Evidence("clipped", share, 1.0, 2.0 if clipped else MOST_AGAINST), _answered_against(seen)]
    if seen.began_small and (predicted is None or seen.vibration.damping_ratio > -0.02):
        found.append(Evidence("grew_unclipped", 1.0, 0.0, -1.0 if predicted is not None else -2.0))
    found.append(_steps_against(seen))
    if predicted is None:
        return found
    limit = predicted.limit
    if not limit.stable and limit.gain < SPARED:
        found.append(Evidence("gain_margin", limit.gain, 1.0, -3.0))
    if limit.stable and limit.lower_gain > 0 and limit.lower_frequency > 0:
        # Deeper in the limit less gain is left, and it is slower yet.
        faster = max(0.0, math.log(seen.vibration.frequency / limit.lower_frequency))
        found.append(Evidence("lower_frequency", seen.vibration.frequency, limit.lower_frequency, _agrees(faster, 2 * SAME_FREQUENCY)))
    elif not limit.lower_gain > 0:
        found.append(Evidence("lower_gain", limit.lower_gain, 1.0, -2.0))
    return found


def _external(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    return [*_forced(seen, predicted), _answered_against(seen), _turning_against(seen)]


def _ripple(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    turning = seen.turning
    if turning is None or math.isnan(turning.order):
        return [Evidence("turning", math.nan, math.nan, MOST_AGAINST)]
    found = _forced(seen, predicted)
    if turning.scales:
        return [*found, Evidence("turning", turning.order, turning.order, 3.0)]
    if turning.speeds:
        return [*found, Evidence("turning", turning.order, math.nan, MOST_AGAINST)]
    order = turning.order if predicted is None else predicted.order
    whole = abs(order - round(order)) < WHOLE and 0.5 < order < MOST_ORDERS
    return [*found, Evidence("whole_order", order, round(order), 1.5 if whole else -1.5)]


def _forced(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    """Evidence for a torque that does not come from the controller."""
    scales = seen.turning is not None and seen.turning.scales
    found = [_steps_against(seen), _braked(seen, predicted, 3.0 if scales or seen.turning is None else 1.0)]
    if seen.turning is not None and not scales and seen.standing > STANDING - 0.1:  # along a steady motion friction has it stand
        found.append(Evidence("standing", seen.standing, 0.0, -3.0))
    if seen.state == "sustained":
        found.append(Evidence("growth", seen.vibration.growth_rate, 0.0, 0.5))
    else:
        found.append(Evidence("growth", seen.vibration.growth_rate, 0.0, 0.0 if scales else -2.0))
    if _clipped(seen, predicted):
        found.append(Evidence("clipped", seen.clipped, 0.0, -2.0))
    if predicted is None:
        return found
    response = _response_off(predicted)
    if not math.isnan(response):  # torque and motion alone do not balance
        found.append(Evidence("response", response, OTHER_RESPONSE, min(1.0, 4 * (response - 0.5))))
    if not predicted.limit.stable:
        found.append(Evidence("gain_margin", predicted.limit.gain, 1.0, -2.0))
    return found


def _backlash(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    found = [_steps_against(seen), _answered_against(seen), _braked(seen, predicted, -3.0), _standing_against(seen)]
    found.append(Evidence("growth", seen.vibration.growth_rate, 0.0, 0.5 if seen.state == "sustained" else -2.0))
    if _clipped(seen, predicted):
        found.append(Evidence("clipped", seen.clipped, 0.0, -1.5))
    if seen.even == seen.even:  # alike to either side, and not straight
        bent = seen.odd > max(BENT, 4 * seen.even)
        found.append(Evidence("odd_harmonics", seen.odd, math.nan, 0.7 if bent else -1.0 if seen.odd < BENT / 4 else 0.0))
    if predicted is None or math.isnan(predicted.softened[0]):
        return found
    share, off = predicted.softened
    loose = share < MOST_SOFTENED and _response_off(predicted) > 2 * off
    found.append(Evidence("softened", share, 1.0, max(MOST_AGAINST, 3.0 - 0.5 * (off / SAME_RESPONSE) ** 2) if loose else -3.0))
    return found


def _aliasing(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    if predicted is None or predicted.alias is None:
        return [Evidence("alias", math.nan, math.nan, MOST_AGAINST)]
    alias, found = predicted.alias, [_steps_against(seen)]
    own = [one for one in (predicted.frequency, predicted.limit.frequency) if one > 0]  # a torque limit takes it toward that at the limit
    off = min((abs(math.log(alias.frequency / one)) for one in own), default=math.inf)
    found.append(Evidence("alias", alias.frequency, predicted.frequency, _agrees(off, SAME_FREQUENCY)))
    found.append(
        Evidence("gain_margin", predicted.limit.gain, 1.0, _agrees(max(0.0, math.log(max(predicted.limit.gain, 1e-9))), SAME_MARGIN))
    )
    if alias.response == alias.response:
        off = abs(np.log(alias.response))
        found.append(Evidence("alias_response", off, 0.0, _agrees(off, SAME_RESPONSE)))
    return found


def _outer_loop(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    return [Evidence("answers", 1.0 if seen.answers else 0.0, 1.0, 4.0 if seen.answers else MOST_AGAINST)]


JUDGES: dict[str, Callable[[RecordedOscillation, Prediction | None], list[Evidence]]] = {
    "gain_limit": _gain_limit,
    "stick_slip": _stick_slip,
    "quantisation": _quantisation,
    "structural_resonance": _structural,
    "saturation": _saturation,
    "external_torque": _external,
    "torque_ripple": _ripple,
    "backlash": _backlash,
    "aliasing": _aliasing,
    "outer_loop": _outer_loop,
}
"""Functions that collect the evidence for and against each cause."""


def _known(found: Sequence[Evidence]) -> list[Evidence]:
    """Evidence with a weight other than 0."""
    return [one for one in found if one.weight != 0]


def _clipped(seen: RecordedOscillation, predicted: Prediction | None) -> bool:
    """True if a torque limit takes part: rows at a limit, and less torque than the file's controller would make."""
    return seen.clipped > CLIPPED and not (predicted is not None and predicted.left > WHOLE_TORQUE)


def _steps_against(seen: RecordedOscillation) -> Evidence:
    weight = -3.0 if seen.steps < FEW_STEPS or seen.irregular else 0.0
    return Evidence("steps", seen.steps, math.inf, weight)


def _standing_against(seen: RecordedOscillation) -> Evidence:
    weight = -3.0 if seen.standing > STANDING and not seen.vibration.damping_ratio < -0.02 else 0.0
    return Evidence("standing", seen.standing, 0.0, weight)


def _turning_against(seen: RecordedOscillation) -> Evidence:
    scales = seen.turning is not None and seen.turning.scales
    order = seen.turning.order if seen.turning is not None else math.nan
    return Evidence("turning", order, order, -3.0 if scales else 0.0)


def _answered_against(seen: RecordedOscillation) -> Evidence:
    return Evidence("answers", 1.0, 0.0, -3.0 if seen.answers else 0.0)


def _braked(seen: RecordedOscillation, predicted: Prediction | None, weight: float) -> Evidence:
    """Evidence from power: a controller drives a vibration that it sustains and brakes an external one, unless its delay reverses this."""
    power = seen.power if math.isfinite(seen.power) or predicted is None else predicted.power
    sustained = seen.state == "sustained" and seen.side == "motor_position"
    if not sustained or math.isnan(power) or abs(power) < FAINT:
        return Evidence("power", power, 0.0, 0.0)
    return Evidence("power", power, math.copysign(1.0, -weight), weight if power < 0 else -0.5 * weight)


def _held_against(seen: RecordedOscillation, predicted: Prediction | None) -> Evidence:
    """Evidence from growth: without friction, gap or limit an oscillation grows or decays, as nothing holds its amplitude."""
    held = seen.state == "sustained" and not _clipped(seen, predicted)
    return Evidence("growth", seen.vibration.growth_rate, math.nan, -2.5 if held else 0.0)
