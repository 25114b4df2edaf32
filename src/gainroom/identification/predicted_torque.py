"""The torque that identified gains make of a record, beside the logged one."""

import numpy as np

from ..system.linear.arrays import Floats
from .gains import GainsFit
from .record import Record


def predicted_torque(fit: GainsFit, record: Record) -> tuple[Record, Floats, Floats]:
    """The rows used, the logged torque (m,) and that of the fitted law (m,) [N m], both without what lies above `fit.band`."""
    record = record.longest_run()
    tick, channels = record.sample_time, record.channels
    position = channels.get("motor_position", channels.get("link_position"))
    reference = channels["reference"]
    assert position is not None
    if fit.velocity == "motor_velocity":
        velocity = channels["motor_velocity"]
        ahead = channels.get("reference_velocity", np.gradient(reference, tick))
    elif fit.velocity == "difference":
        velocity, ahead = (np.diff(values, prepend=values[0]) / tick for values in (position, reference))
    else:
        velocity, ahead = np.gradient(position, tick), np.gradient(reference, tick)
    rate = (ahead if fit.rate_of_error else 0.0) - velocity
    law = fit.kp.value * (reference - position) + fit.kd.value * rate
    law = np.interp(record.time - fit.lag, record.time, law)
    law += float(np.mean(channels[fit.torque] - law))  # weight and other torques that the gains do not make
    logged, law = (_smoothed(values, fit.band, tick) for values in (channels[fit.torque], law))
    return record, logged, law


def _smoothed(values: Floats, band: float, tick: float) -> Floats:
    """Without phase, by a filter of fourth order; mirrored at the ends."""
    padded = np.concatenate([values, values[::-1]])
    omega = 2 * np.pi * np.fft.rfftfreq(len(padded), tick)
    return np.fft.irfft(np.fft.rfft(padded) / (1 + (omega / band) ** 4), len(padded))[: len(values)]
