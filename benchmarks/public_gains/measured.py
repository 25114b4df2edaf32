"""Numbers of a row: where each reading of it vibrates. They are those of the row's command, without its search for gains to use instead."""

import math
from dataclasses import dataclass, field, replace

from gainroom.errors import GainroomError
from gainroom.files.audit_options import audited
from gainroom.studies.loop_numbers import limit_of
from gainroom.studies.state import state_of
from gainroom.studies.worst_place import try_places
from gainroom.system.requirements import Requirements

from .rows import DELAYS, GEARS, HOST, Row

ENOUGH = 10 ** (6 / 20)
"""Factor that `audit` asks for: 6 dB."""


@dataclass(frozen=True)
class Numbers:
    """Numbers of one reading.

    factor      on all gains at which the robot vibrates at DELAY; below 1: under which it stops
    frequency   of that vibration [Hz]
    joints      that move most in it, the first first
    delay       from measurement to torque from which these gains vibrate [ms]; 0: without delay, too; inf: at none
    factors     on all gains at each of DELAYS, of the reading on the host
    """

    factor: float
    frequency: float
    joints: tuple[str, ...]
    delay: float
    factors: dict[float, float] = field(default_factory=dict)


def numbers(row: Row, model: str, reading: str) -> Numbers:
    """Numbers of a row in one of its readings. Raises GainroomError, one line."""
    system = audited(model, row.gains, row.options(reading)).system
    ((posture, contact),) = system.source.states
    if reading == GEARS:
        system = replace(system, requirements=Requirements(gain_margin=ENOUGH))
        worst = try_places(system, [state_of(system, posture, contact)]).worst
        system = system.at(worst.place)
    state = state_of(system, posture, contact, ("margins",))
    if not all(state.model.motor_inertia > 0):
        raise GainroomError(f"{row.name}: a joint has no motor inertia: name its actuator, or leave its gains out")
    delays = DELAYS if reading == HOST else ()
    at = {delay: limit_of(system.with_values(delay=1e-3 * delay).loop(state.model, state.controller)).gain for delay in delays}
    frequency = state.limit.frequency / (2 * math.pi)
    return Numbers(state.limit.gain, frequency, state.limiting_joints, 1e3 * state.delay_limit, at)
