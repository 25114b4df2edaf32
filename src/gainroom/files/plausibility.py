"""Plausibility limits of a system: values that no robot has, or that no computation would finish with, are refused after reading."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import GainroomError
from ..system.plausibility import unusual_values
from ..system.system import System
from .system_sections import refuse_long_delay

MOST_LAG = 1e4
"""Maximum phase lag of the delay at a loop's crossover frequency [rad]: a stable loop has about 1."""
MOST_TICKS = 600
"""Maximum of the delays of all joints added up [ticks]: half a minute of computing on two joints; 50 joints may have 12 each."""


def plausible(system: System) -> System:
    """The system with warnings for values far outside the usual range added. Raises GainroomError for values that no robot has."""
    _refuse_implausible(system)
    return replace(system, warnings=(*system.warnings, *unusual_values(system)))


def _refuse_implausible(system: System) -> None:
    """Raise GainroomError for delays of too many ticks, nominal or at their highest, and for loops far too fast for their delay."""
    names, delays = system.source.joint_names, [drive.delay for drive in system.drives]
    for each in (delays, *([] if system.uncertainty.delay is None else [system.uncertainty.delay[1].tolist()])):
        _refuse_long_delays(names, each, system.control.sample_time)
    if system.control.controller is not None:
        _refuse_quick_joints(system)
    for index, task in enumerate(system.source.stack):  # gains are accelerations
        stiff, damped = (float(np.max(np.asarray(gain, dtype=float))) for gain in (task.kp, task.kd))
        _refuse_lag(f"tasks[{index}]: with gains of {stiff:g} 1/s² and {damped:g} 1/s", stiff, damped, max(delays))


def _refuse_long_delays(names: Sequence[str], delays: Sequence[float], sample_time: float | None) -> None:
    """Raise GainroomError for too many ticks of delay, each of which is a state of a sampled robot; `sample_time` None: continuous."""
    for name, delay in zip(names, delays, strict=True):
        refuse_long_delay(delay, sample_time, f"delay_ms of joint {name!r}")
    if sample_time is not None and sum(delays) > MOST_TICKS * sample_time:
        raise GainroomError(
            f"the delays of all {len(names)} joints together, {sum(delays) / sample_time:g} ticks, must be <= {MOST_TICKS} ticks: take a "
            "lower sample rate, or none for continuous time"
        )


def _refuse_quick_joints(system: System) -> None:
    """Raise GainroomError for gains that would move a joint many times within its delay: such gains are a mistake in units."""
    body, actuators = system.source.body, system.source.actuators
    controller = system.control.controller
    assert controller is not None
    terms, nothing = controller.matrices(body.size), np.zeros((body.size, body.size))
    links = np.diag(body.mass_matrix(body.neutral()))[body.nv - body.size :]
    inertia = actuators.motor_inertia + np.where(np.isinf(actuators.stiffness), links, 0.0)
    stiff, damped = (np.diagonal(terms.get(powers, nothing)) for powers in ((0, 0), (1, 0)))
    for k, name in enumerate(body.joint_names):
        gains = f"kp {stiff[k]:g} N·m/rad, kd {damped[k]:g} N·m·s/rad and an inertia of {inertia[k]:g} kg·m²"
        _refuse_lag(f"joint {name!r}: with {gains}", stiff[k] / inertia[k], damped[k] / inertia[k], system.drives[k].delay)


def _refuse_lag(owner: str, stiff: float, damped: float, delay: float) -> None:
    """Raise GainroomError where crossover frequency times delay is far above 1; `stiff` = kp/J [1/s²], `damped` = kd/J [1/s]."""
    lag = delay * max(math.sqrt(stiff), damped)
    if lag > MOST_LAG:
        raise GainroomError(
            f"{owner} its loop is too quick for a delay of {1e3 * delay:g} ms: {lag:.3g} rad of phase must be <= {MOST_LAG:g} rad; "
            "look for a wrong unit"
        )
