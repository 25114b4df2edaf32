"""Causes of a vibration, ranked by physical evidence, against the loop of a joint.yaml where there is one.

At the complex frequency s = σ + jω of a vibration a linear loop has 1 + L(s) = 0, and position over torque is the plant's P(s). So:

    gain_limit            ω is the loop's own critical frequency, its gain margin is spent, and P(s) is measured as modelled
    structural_resonance  P(s) is not as modelled there, ω is another, or it rings on where every root of the model decays sooner
    saturation            the torque is clipped and the loop is stable as it is, but not at the lower gain that clipping leaves
                          (describing function N(A) ≤ 1 of a limit: N L = −1 at the lower end of the stable gains)
    stick_slip            slower than the loop's crossover, the joint stands still in every period while the torque builds up
    quantisation          an amplitude of about an encoder's step, which is a relay: its describing function is unbounded at small ones

Each piece of evidence adds nats, within ±4, to the logarithm of a cause's likelihood; the weights are round numbers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import margins
from ..analysis.stability import rightmost_roots
from ..identification.clipping import Limited, limited_rows
from ..identification.record import Record
from ..identification.recorded_oscillation import TORQUES, RecordedOscillation
from ..simulation.oscillation import FEWEST_SAMPLES
from ..system.linear.arrays import Complexes
from ..system.loop import Loop
from ..system.system import System

APPLIED = TORQUES[::-1]
"""Which torque is compared with the motion: the nearest to the joint, behind any limit."""
FEW_STEPS, MANY_STEPS = 3.0, 8.0  # of the encoder: amplitudes that quantisation makes, and none that it does
SAME_PHASE = 0.15  # [rad] between the torque in the log and the file's controller where they differ by a factor only
LAW_LEFT = 0.1  # of the torque's power, that a factor on the file's controller may leave
ENDS = 0.05  # of the rows of a vibration at either end, where a filter's ends are felt
FACTORS, SAME_GAINS = (0.05, 20.0), 0.03  # factors on the file's gains that are believed; nearer to 1 they are the file's


@dataclass(frozen=True)
class Prediction:
    """What the loop of a joint.yaml says.

    limit       of all gains together, as a factor
    margins     None where the loop is unstable
    frequency   [rad/s] at which it vibrates if it does: of its growing root, else at its gain limit; NaN: nowhere
    growth      [1/s] of that root; NaN where it is stable
    crossover   [rad/s] first frequency at which |L| = 1; NaN: none
    damping     least damping ratio of its roots
    response    measured position over torque at the vibration, over the model's; NaN where a channel is missing
    control     measured torque over position error there, over the controller's; likewise
    applied     gains of the log over those of the file, which the loop here has
    moved       [rad] amplitude of the position that the torque makes by the model; NaN likewise
    limited     rows in which the target torque was limited, which tell nothing of the gains; None without a target torque
    """

    loop: Loop
    limit: GainLimit
    margins: Margins
    frequency: float
    growth: float
    crossover: float
    damping: float
    response: complex = complex(math.nan)
    control: complex = complex(math.nan)
    moved: float = math.nan
    applied: float = 1.0
    limited: Limited | None = None


def predicted_vibration(system: System, record: Record, seen: RecordedOscillation | None) -> Prediction:
    """The loop, and what it makes of the measured vibration; with the gains of the log where those are the file's times one factor."""
    if system.control.sample_time is None:
        system = replace(system, control=replace(system.control, sample_time=record.sample_time))
    loop = system.loop(system.source.linearize())
    if seen is None:
        return _predicted(loop)
    limited = limited_rows(record, "target_torque") if record.has("target_torque") else None
    control, applied = _control(loop, seen) if limited is None or not limited.kinds else _control_of(loop, record, seen, limited), 1.0
    if seen.steps > MANY_STEPS and not seen.irregular and abs(np.angle(control)) < SAME_PHASE and FACTORS[0] < abs(control) < FACTORS[1]:
        applied = abs(control) if abs(abs(control) - 1) > SAME_GAINS else 1.0
    found = replace(_predicted(loop.scaled(applied)), applied=applied, control=control / applied, limited=limited)
    return _compared(found, record, seen)


def _predicted(loop: Loop) -> Prediction:
    limit, found = gain_limit(loop), margins(loop)
    roots = [root for root in rightmost_roots(loop, count=8).roots if root.imag > 1e-6]
    growing = max(roots, key=lambda root: root.real, default=complex(math.nan, math.nan))
    unstable = not limit.stable and growing.real > 0
    return Prediction(
        loop,
        limit,
        found,
        growing.imag if unstable else limit.frequency,
        growing.real if unstable else math.nan,
        min((one.omega for one in found.gain_crossings), default=math.nan),
        min((-root.real / abs(root) for root in roots), default=math.nan),
    )


def _control(loop: Loop, seen: RecordedOscillation) -> complex:
    """Target torque over position error at the vibration, over that of the file's controller; NaN: not measured."""
    assert loop.parts is not None
    parts, side = seen.parts, f"{loop.parts.feedback}_position"
    if side not in parts or "target_torque" not in parts or loop.control is None:
        return complex(math.nan)
    error = parts.get("reference", 0j) - parts[side]
    own = loop.gain * complex(loop.control.at(_point(seen))[0])
    return parts["target_torque"] / error / own if error and own else complex(math.nan)


def _control_of(loop: Loop, record: Record, seen: RecordedOscillation, limited: Limited) -> complex:
    """The same ratio from the rows of the vibration whose torque was not limited, by least squares against the file's controller."""
    assert loop.parts is not None
    side = f"{loop.parts.feedback}_position"
    if not record.has(side) or loop.control is None:
        return complex(math.nan)
    torque, position = record.channels["target_torque"][seen.rows], record.channels[side][seen.rows]
    error = record.channels["reference"][seen.rows] - position if record.has("reference") else -position
    count = len(error)
    omega = 2 * np.pi * np.fft.rfftfreq(2 * count, record.sample_time)
    response = np.zeros(len(omega), dtype=complex)
    response[1:] = loop.gain * loop.control.at(1j * omega[1:])
    padded = np.concatenate([error, np.linspace(error[-1], error[0], count)])
    law = np.fft.irfft(np.fft.rfft(padded) * response, 2 * count)[:count]
    free = ~limited.rows[seen.rows]
    ends = round(ENDS * count)
    free[:ends], free[count - ends :] = False, False
    if np.count_nonzero(free) < FEWEST_SAMPLES:
        return complex(math.nan)
    turned = np.fft.irfft(-1j * np.sign(omega) * np.fft.rfft(padded) * response, 2 * count)[:count]  # a quarter period late
    columns, wanted = np.column_stack([law, -turned, np.ones(count)])[free], torque[free]
    factors = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    if np.var(wanted - columns @ factors) > LAW_LEFT * np.var(wanted):  # an integrator that the limit holds, or another law
        return complex(math.nan)
    return complex(factors[0], factors[1])


def _point(seen: RecordedOscillation) -> Complexes:
    """s = σ + jω of a vibration, (1,)."""
    return np.array([complex(seen.vibration.growth_rate, seen.vibration.frequency)])


def _compared(found: Prediction, record: Record, seen: RecordedOscillation) -> Prediction:
    """With the ratio of position and torque at the vibration, and the motion that the torque makes."""
    loop, parts = found.loop, seen.parts
    assert loop.parts is not None
    side = f"{loop.parts.feedback}_position"
    torque = next((name for name in APPLIED if name in parts), None)
    if torque is None or side not in parts or not parts[torque]:
        return found
    response = parts[side] / parts[torque] / complex(_behind(loop, torque, _point(seen))[0])
    return replace(found, response=response, moved=_moved(found, record, seen, torque))


def _behind(loop: Loop, torque: str, s: Complexes) -> Complexes:
    """Measured position over a logged torque by the model, at complex s (k,)."""
    assert loop.parts is not None
    if torque == "actual_torque":
        return loop.parts.plant.response(s, loop.parts.feedback)[:, 0, 0]
    whole = loop.actuated_at(s)[:, 0, 0]
    return whole if torque == "target_torque" else whole * np.exp(s * loop.parts.drives[0].delay)


def _moved(base: Prediction, record: Record, seen: RecordedOscillation, torque: str) -> float:
    """√2 RMS of the position that the torque makes by the model round the vibration's frequency and above [rad]."""
    from scipy.signal import welch

    values = record.channels[torque][seen.rows]
    values = values[-max(4 * FEWEST_SAMPLES, len(values) // 3) :]
    if len(values) < 4 * FEWEST_SAMPLES:
        return math.nan
    frequency, power = welch(values, 1 / record.sample_time, nperseg=max(2 * FEWEST_SAMPLES, len(values) // 8), detrend="linear")
    omega = 2 * np.pi * frequency
    high = (omega > seen.vibration.frequency / 2) & (omega < 0.9 * math.pi / record.sample_time)
    s = 1j * omega[high]
    if not len(s):
        return math.nan
    return math.sqrt(2 * float(np.sum(power[high] * np.abs(_behind(base.loop, torque, s)) ** 2)) * frequency[1])


UNKNOWN = "unknown"
"""None of the five causes; it stands for itself among the likelihoods."""
MOST_FOR, MOST_AGAINST = 2.0, -4.0  # nats of one piece of evidence
SAME_FREQUENCY = 0.06  # relative, standard deviation: what a few percent of the inertias, the stiffness and the delay shift
SAME_MARGIN = 0.15  # likewise of the gain margin
SAME_RESPONSE = 0.25  # likewise of the plant's response
OTHER_RESPONSE = 0.7  # of its logarithm: another plant
STANDING = 0.3  # share of a period in which a joint that sticks stands still, at least
CLIPPED = 0.05  # share of rows at the torque limit that counts
SPARED = 0.6  # of the limit: margin that a stable prediction leaves where parameters are a few percent off


@dataclass(frozen=True)
class Evidence:
    """One observation for or against a cause: `weight` [nats], > 0 for it. `value` as measured, `expected` if the cause were true; SI."""

    name: str
    value: float
    expected: float
    weight: float


@dataclass(frozen=True)
class Cause:
    """likelihood: beside the other causes and UNKNOWN, which together have 1."""

    name: str
    likelihood: float
    evidence: tuple[Evidence, ...]


def _agrees(distance: float, deviation: float) -> float:
    """[nats] for a cause whose prediction is `distance` off, in units of which `deviation` is usual."""
    return max(MOST_AGAINST, MOST_FOR - 0.5 * (distance / deviation) ** 2)


def ranked_causes(seen: RecordedOscillation, predicted: Prediction | None) -> tuple[Cause, ...]:
    """Likelihoods from the sums of the evidence."""
    judged = {
        "gain_limit": _gain_limit(seen, predicted),
        "stick_slip": _stick_slip(seen, predicted),
        "quantisation": _quantisation(seen),
        "structural_resonance": _structural(seen, predicted),
        "saturation": _saturation(seen, predicted),
        UNKNOWN: (),
    }
    sums = np.array([sum(one.weight for one in evidence) for evidence in judged.values()])
    shares = np.exp(sums - sums.max())
    shares /= shares.sum()
    causes = [Cause(name, float(share), tuple(evidence)) for (name, evidence), share in zip(judged.items(), shares, strict=True)]
    return tuple(sorted(causes, key=lambda cause: -cause.likelihood))


def _off(predicted: Prediction | None, seen: RecordedOscillation) -> float:
    """|ln| of the vibration's frequency over the predicted one; NaN: none predicted."""
    if predicted is None or not predicted.frequency > 0:
        return math.nan
    return abs(math.log(seen.vibration.frequency / predicted.frequency))


def _response_off(predicted: Prediction | None) -> float:
    """|ln| of the measured response over the model's, amplitude and phase; NaN: not measured."""
    return abs(np.log(predicted.response)) if predicted is not None and predicted.response == predicted.response else math.nan


def _gain_limit(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    found = [_steps_against(seen), _standing_against(seen)]
    if predicted is None and seen.clipped > CLIPPED:  # a torque limit ends the growth of any vibration
        found.append(Evidence("clipped", seen.clipped, 1.0, 2.0))
    if predicted is None:
        return _known(found)
    off, margin, response = _off(predicted, seen), predicted.limit.gain, _response_off(predicted)
    # A limit on the torque lowers the gain that is left, and with it the frequency, toward that at the limit.
    at_limit = abs(math.log(seen.vibration.frequency / predicted.limit.frequency)) if predicted.limit.frequency > 0 else math.inf
    if not math.isnan(off):
        found.append(Evidence("frequency", seen.vibration.frequency, predicted.frequency, _agrees(min(off, at_limit), SAME_FREQUENCY)))
    found.append(Evidence("gain_margin", margin, 1.0, _agrees(max(0.0, math.log(max(margin, 1e-9))), SAME_MARGIN)))
    if not math.isnan(response) and not seen.irregular:
        found.append(Evidence("response", response, 0.0, _agrees(response, SAME_RESPONSE)))
    return _known(found)


def _steps_against(seen: RecordedOscillation) -> Evidence:
    weight = -3.0 if seen.steps < FEW_STEPS or seen.irregular else 0.0
    return Evidence("steps", seen.steps, math.inf, weight)


def _standing_against(seen: RecordedOscillation) -> Evidence:
    weight = -3.0 if seen.standing > STANDING and not seen.vibration.damping_ratio < -0.02 else 0.0
    return Evidence("standing", seen.standing, 0.0, weight)


def _known(found: Sequence[Evidence]) -> list[Evidence]:
    """Those that say something."""
    return [one for one in found if one.weight != 0]


def _stick_slip(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    share = seen.standing
    weight = MOST_AGAINST if math.isnan(share) else min(2.5, 12 * (share - STANDING + 0.1)) if share > STANDING - 0.1 else -3.0
    found = [Evidence("standing", share, 1.0, weight)]
    if predicted is not None and predicted.crossover > 0:
        slow = math.log(seen.vibration.frequency / predicted.crossover)
        found.append(
            Evidence("crossover", seen.vibration.frequency, predicted.crossover, 1.5 if slow < 0 else max(MOST_AGAINST, -4 * slow))
        )
    if seen.steps < FEW_STEPS or seen.irregular:
        found.append(Evidence("steps", seen.steps, math.inf, -3.0))
    if seen.clipped > CLIPPED and seen.clipped > share:
        found.append(Evidence("clipped", seen.clipped, 0.0, -2.0))
    return _known(found)


def _quantisation(seen: RecordedOscillation) -> list[Evidence]:
    steps = seen.steps
    weight = 3.0 if steps <= FEW_STEPS else 0.0 if steps <= MANY_STEPS else MOST_AGAINST
    found = [Evidence("steps", steps, 1.0, weight)]
    if seen.irregular:
        found.append(Evidence("irregular", 1.0, 1.0, 1.5))
    if seen.state != "sustained":
        found.append(Evidence("growth", seen.vibration.growth_rate, 0.0, -1.5))
    return _known(found)


def _structural(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    found = [_steps_against(seen), _standing_against(seen)]
    if seen.clipped > CLIPPED and not seen.began_small:
        found.append(Evidence("clipped", seen.clipped, 0.0, -2.0))
    if predicted is None:
        return _known(found)
    off, response = _off(predicted, seen), _response_off(predicted)
    if not math.isnan(off):
        found.append(Evidence("frequency", seen.vibration.frequency, predicted.frequency, min(1.5, -_agrees(off, SAME_FREQUENCY))))
    if not math.isnan(response):
        found.append(Evidence("response", response, OTHER_RESPONSE, min(MOST_FOR, 4 * (response - 0.5))))
    if seen.state == "decaying" and predicted.limit.stable:
        sooner = predicted.damping / max(seen.vibration.damping_ratio, 1e-6)
        found.append(Evidence("rings", seen.vibration.damping_ratio, predicted.damping, 1.5 if sooner > 2 else -1.0))
    return _known(found)


def _saturation(seen: RecordedOscillation, predicted: Prediction | None) -> list[Evidence]:
    share = seen.clipped
    found = [Evidence("clipped", share, 1.0, 2.0 if share > CLIPPED else MOST_AGAINST)]
    if seen.began_small and (predicted is None or seen.vibration.damping_ratio > -0.02):
        found.append(Evidence("grew_unclipped", 1.0, 0.0, -1.0 if predicted is not None else -2.0))
    found.append(_steps_against(seen))
    if predicted is None:
        return _known(found)
    limit = predicted.limit
    if not limit.stable and limit.gain < SPARED:
        found.append(Evidence("gain_margin", limit.gain, 1.0, -3.0))
    if limit.stable and limit.lower_gain > 0 and limit.lower_frequency > 0:
        # Deeper in the limit less gain is left, and it is slower yet.
        faster = max(0.0, math.log(seen.vibration.frequency / limit.lower_frequency))
        found.append(Evidence("lower_frequency", seen.vibration.frequency, limit.lower_frequency, _agrees(faster, 2 * SAME_FREQUENCY)))
    elif not limit.lower_gain > 0:
        found.append(Evidence("lower_gain", limit.lower_gain, 1.0, -2.0))
    return _known(found)
