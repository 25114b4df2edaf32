"""Predicted vibration of a joint.yaml's loop, compared with a recording: stability, and position and torque at the vibration."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import margins
from ..analysis.stability import rightmost_roots
from ..identification.clipping import Limited, limited_rows
from ..identification.record import Record
from ..identification.recorded_oscillation import TORQUES, RecordedOscillation, power_of
from ..simulation.oscillation import FEWEST_SAMPLES
from ..system.linear.arrays import Complexes
from ..system.loop import Loop
from ..system.system import System

APPLIED = TORQUES[::-1]
"""Torque channels compared with the motion, nearest to the joint first, behind any limit."""
MANY_STEPS = 8.0  # encoder steps: amplitudes that quantisation does not make
SAME_PHASE = 0.15  # [rad] between the torque in the log and the file's controller where they differ by a factor only
LAW_LEFT = 0.1  # share of the torque's power that a factor on the file's controller may leave unexplained
ENDS = 0.05  # share of the rows of a vibration at either end, where a filter's transients are
SAME_FREQUENCY = 0.06  # relative, standard deviation: what a few percent of the inertias, the stiffness and the delay shift
SAME_RESPONSE = 0.25  # |ln| of the plant's response
SLOW_LOG = 0.75  # relative to the log's tick: a loop with a shorter one can vibrate where the log shows another frequency
MOST_FOLDS = 200
SHARES = (0.005, 1.0)  # shares of the stiffness that a gap may leave
FACTORS, SAME_GAINS = (0.05, 20.0), 0.03  # factors on the file's gains that are believed; nearer to 1 they are the file's


@dataclass(frozen=True)
class Alias:
    """Frequency beyond half the log's rate that shows as the observed one: frequency [rad/s], response and control as in Prediction."""

    frequency: float
    response: complex
    control: complex


@dataclass(frozen=True)
class Prediction:
    """Prediction of the loop of a joint.yaml.

    limit       of all gains together, as a factor
    margins     of the loop; unknown if it is unstable
    frequency   of its vibration [rad/s]: of its growing root, otherwise at its gain limit; NaN: none
    growth      rate of that root [1/s]; NaN if it is stable
    crossover   first frequency at which |L| = 1 [rad/s]; NaN: none
    damping     least damping ratio of its roots
    response    measured position over torque at the vibration, relative to the model's; NaN if a channel is missing
    control     measured torque over position error there, relative to the controller's; NaN if a channel is missing
    applied     gains of the log relative to those of the file; the loop here has the log's
    power       cosine between torque and velocity, by the model of the drive if the actual torque is not in the log
    moved       amplitude of the position that the torque makes by the model [rad]; NaN if a channel is missing
    left        share of the gains that a torque limit leaves, its describing function: for a sustained vibration, that up to their limit;
                NaN if it is not measured
    softened    stiffness relative to the file's with which position over torque is as measured (describing function of a gap), and the
                remaining error, |ln|; NaN if it is not measured
    alias       the vibration at another frequency, which the log's rate folds to the observed one; None if the log is no slower than
                the loop
    order       periods per turn of the motor, for a vibration whose frequency follows the speed; NaN otherwise
    integrates  True: the controller has an integral of position
    limited     rows in which the target torque was limited, which carry no information on the gains; None without a target torque
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
    power: float = math.nan
    moved: float = math.nan
    applied: float = 1.0
    left: float = math.nan
    softened: tuple[float, float] = (math.nan, math.nan)
    alias: "Alias | None" = None
    order: float = math.nan
    integrates: bool = False
    limited: Limited | None = None


def predicted_vibration(system: System, record: Record, seen: RecordedOscillation | None) -> Prediction:
    """Prediction of the loop for the measured vibration, with the gains of the log if these are the file's times one factor."""
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
    found = _compared(found, record, seen)
    return replace(
        found,
        left=_left(found, seen),
        softened=_softened(found, system, seen),
        alias=_alias(found, seen, record.sample_time),
        integrates=any(integrals > 0 for _, integrals in system.control.controller.terms()),
        order=math.nan if seen.turning is None else seen.turning.order / system.entered.get("gear_ratio", 1.0),
    )


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
    """Target torque over position error at the vibration, relative to the file's controller; NaN: not measured."""
    assert loop.parts is not None
    parts, side = seen.parts, f"{loop.parts.feedback.position}_position"
    if side not in parts or "target_torque" not in parts or loop.control is None:
        return complex(math.nan)
    error = parts.get("reference", 0j) - parts[side]
    own = loop.gain * complex(loop.control.at(_point(seen))[0])
    return parts["target_torque"] / error / own if error and own else complex(math.nan)


def _control_of(loop: Loop, record: Record, seen: RecordedOscillation, limited: Limited) -> complex:
    """Ratio as in _control from the rows whose torque was not limited, by least squares against the file's controller."""
    assert loop.parts is not None
    side = f"{loop.parts.feedback.position}_position"
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


def _left(found: Prediction, seen: RecordedOscillation) -> float:
    """Torque at the vibration relative to the controller's output, by the model: the describing function of a limit."""
    torque = next((name for name in APPLIED if name in seen.parts), None)
    asked = _control(found.loop, replace(seen, parts={**seen.parts, "target_torque": seen.parts[torque]})) if torque else complex(math.nan)
    if torque is None or seen.irregular:
        return math.nan
    drives = complex(_behind(found.loop, "target_torque", _point(seen))[0] / _behind(found.loop, torque, _point(seen))[0])
    return min(abs(asked / drives), 1.0)


def _softened(found: Prediction, system: System, seen: RecordedOscillation) -> tuple[float, float]:
    """Stiffness, relative to the file's, of a spring loaded for a part of each period, as a gap leaves it; and the remaining error."""
    assert found.loop.parts is not None
    source, side = system.source, found.loop.parts.feedback.position
    if found.response != found.response or not math.isfinite(source.stiffness):
        return math.nan, math.nan
    point = _point(seen)
    whole = found.loop.parts.plant.response(point, side)[0, 0, 0]

    def off(share: float) -> float:
        loose = system.with_values(stiffness=share * source.stiffness, damping=share * source.damping).source.linearize()
        return abs(np.log(found.response * whole / complex(loose.response(point, side)[0, 0, 0])))

    least, share = min((off(share), share) for share in np.geomspace(*SHARES, 80).tolist())
    return share, float(least)


def _alias(found: Prediction, seen: RecordedOscillation, tick: float) -> Alias | None:
    """Best-fitting frequency for the model's loop among those that a log with `tick` [s] folds to the observed one."""
    assert found.loop.parts is not None
    side, torque = f"{found.loop.parts.feedback.position}_position", next((name for name in APPLIED if name in seen.parts), None)
    every = found.loop.sample_time
    if every is None or every > SLOW_LOG * tick:
        return None
    best, least = None, math.inf
    for turns in range(1, MOST_FOLDS):
        for sign in (-1, 1):
            omega = 2 * math.pi * turns / tick + sign * seen.vibration.frequency
            if not omega * every < math.pi:
                continue
            there = replace(seen.vibration, frequency=omega)
            parts = {name: value if sign > 0 else value.conjugate() for name, value in seen.parts.items()}
            folded = replace(seen, vibration=there, parts=parts)
            response = complex(math.nan)
            if torque is not None and side in parts and parts[torque]:
                response = parts[side] / parts[torque] / complex(_behind(found.loop, torque, _point(folded))[0])
            off = min((abs(math.log(omega / own)) for own in (found.frequency, found.limit.frequency) if own > 0), default=math.inf)
            unlike = abs(np.log(response)) if response == response else 0.0
            if off / SAME_FREQUENCY + unlike / SAME_RESPONSE < least:
                best, least = Alias(omega, response, _control(found.loop, folded)), off / SAME_FREQUENCY + unlike / SAME_RESPONSE
    return best


def _point(seen: RecordedOscillation) -> Complexes:
    """Complex frequency s = σ + jω of a vibration (1,)."""
    return np.array([complex(seen.vibration.growth_rate, seen.vibration.frequency)])


def _compared(found: Prediction, record: Record, seen: RecordedOscillation) -> Prediction:
    """Prediction with the ratio of position and torque at the vibration, and the motion that the torque makes."""
    loop, parts = found.loop, seen.parts
    assert loop.parts is not None
    side = f"{loop.parts.feedback.position}_position"
    torque = next((name for name in APPLIED if name in parts), None)
    if torque is None or side not in parts or not parts[torque]:
        return found
    response = parts[side] / parts[torque] / complex(_behind(loop, torque, _point(seen))[0])
    point = _point(seen)
    actual = parts[torque] * complex((_behind(loop, torque, point) / _behind(loop, "actual_torque", point))[0])
    return replace(found, response=response, power=power_of(actual, point[0] * parts[side]), moved=_moved(found, record, seen, torque))


def _behind(loop: Loop, torque: str, s: Complexes) -> Complexes:
    """Modelled response from a logged torque to the measured position, at complex s (k,)."""
    assert loop.parts is not None
    if torque == "actual_torque":
        return loop.parts.plant.response(s, loop.parts.feedback.position)[:, 0, 0]
    whole = loop.actuated_at(s)[:, 0, 0]
    return whole if torque == "target_torque" else whole * np.exp(s * loop.parts.drives[0].delay)


def _moved(base: Prediction, record: Record, seen: RecordedOscillation, torque: str) -> float:
    """Amplitude [rad] of the position that the logged torque makes by the model: √2 times its RMS from the vibration's frequency up."""
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
