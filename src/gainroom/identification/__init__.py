"""Identification of a joint from a log, with intervals: delay, elasticity, gains.

Everything starts from a `Record`: one joint's channels in SI units on the joint side, tick by tick.
"""

from .delay import Jitter, TorqueDelay, identify_delay
from .estimate import Estimate
from .frequency_response import FrequencyResponse, frequency_response
from .gains import GainsFit, UnitError, identify_gains
from .joint import JointFit, identify_joint
from .record import Record
from .residuals import Residuals
from .setpoint_delay import SetpointDelay, identify_setpoint_delay
from .stiffness import StiffnessFit, identify_stiffness

__all__ = [
    "Estimate",
    "FrequencyResponse",
    "GainsFit",
    "Jitter",
    "JointFit",
    "Record",
    "Residuals",
    "SetpointDelay",
    "StiffnessFit",
    "TorqueDelay",
    "UnitError",
    "frequency_response",
    "identify_delay",
    "identify_gains",
    "identify_joint",
    "identify_setpoint_delay",
    "identify_stiffness",
]
