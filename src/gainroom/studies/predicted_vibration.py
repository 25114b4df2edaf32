"""The loop of a joint.yaml beside a vibration in a recording: where it would vibrate, and how far off the measured response is."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_limit import GainLimit, gain_limit
from ..analysis.margins import Margins, margins
from ..analysis.stability import rightmost_roots
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


def predicted_vibration(system: System, record: Record, seen: RecordedOscillation | None) -> Prediction:
    """The loop, and what it makes of the measured vibration; with the gains of the log where those are the file's times one factor."""
    if system.control.sample_time is None:
        system = replace(system, control=replace(system.control, sample_time=record.sample_time))
    loop = system.loop(system.source.linearize())
    if seen is None:
        return _predicted(loop)
    control, applied = _control(loop, seen), 1.0
    if seen.steps > MANY_STEPS and not seen.irregular and abs(np.angle(control)) < SAME_PHASE and FACTORS[0] < abs(control) < FACTORS[1]:
        applied = abs(control) if abs(abs(control) - 1) > SAME_GAINS else 1.0
    found = replace(_predicted(loop.scaled(applied)), applied=applied, control=control / applied)
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


def _point(seen: RecordedOscillation) -> Complexes:
    """s = σ + jω of a vibration, (1,)."""
    return np.array([complex(seen.found.growth_rate, seen.found.frequency)])


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
    high = (omega > seen.found.frequency / 2) & (omega < 0.9 * math.pi / record.sample_time)
    s = 1j * omega[high]
    if not len(s):
        return math.nan
    return math.sqrt(2 * float(np.sum(power[high] * np.abs(_behind(base.loop, torque, s)) ** 2)) * frequency[1])
