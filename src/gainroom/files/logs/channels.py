"""Channels of a log with their units: `time` and the signals of identification."""

from collections.abc import Mapping
from dataclasses import dataclass

from ...simulation.run_record import REFERENCE_SIGNAL

ONE_JOINT = "joint"
"""Joint name in a log that names none."""


@dataclass(frozen=True)
class Channel:
    """Quantity of a joint, on the joint side, in SI.

    dimension    of its unit: a key of UNITS in units.py
    largest      where half of the rows are beyond, they are in another unit, or damaged [SI]
    commanded    True: holds from one command to the next; False: measured, and goes on in between
    """

    name: str
    dimension: str
    largest: float
    commanded: bool = False


_ANGLE, _SPEED, _TORQUE, _CURRENT = 1e5, 1e6, 1e9, 1e6
"""Largest values of channels [rad, rad/s, N m, A].

A wheel that turns at 20 rad/s for an hour is at 0.7e5 rad; a simulation that diverges asks for 1e7 N m.
"""

_ALL = (
    Channel("time", "time", 1e12),
    Channel("target_torque", "torque", _TORQUE, commanded=True),
    Channel("demand_torque", "torque", _TORQUE, commanded=True),
    Channel("actual_torque", "torque", _TORQUE),
    Channel("joint_torque", "torque", _TORQUE),
    Channel("motor_position", "angle", _ANGLE),
    Channel("link_position", "angle", _ANGLE),
    Channel(REFERENCE_SIGNAL, "angle", _ANGLE, commanded=True),
    Channel("motor_velocity", "speed", _SPEED),
    Channel("link_velocity", "speed", _SPEED),
    Channel("reference_velocity", "speed", _SPEED, commanded=True),
    Channel("current", "current", _CURRENT),
)
CHANNELS: Mapping[str, Channel] = {channel.name: channel for channel in _ALL}
"""Channels by name, in the order of a log's columns."""
