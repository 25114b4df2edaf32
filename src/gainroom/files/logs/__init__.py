"""Logs of joints: written by simulation, read from whatever others write.

Columns: `time` [s] and the channels of CHANNELS, joint side, SI; any but `time` may be missing. In CSV and Parquet a log of several joints
has them once per joint, its name behind an underscore: `motor_position_l_knee`. In MCAP every joint has its topic, `/l_knee`, with JSON
messages of the plain names. Other names and units are understood, or stated in LogOptions.
"""

from ...identification.record import SIGNALS
from .abilities import Ability, abilities
from .channels import CHANNELS
from .options import LogOptions, load_options
from .reading import LoggedJoint, LogReader, log_reader, read_joint, read_log, unknown_units
from .record import JointLog, Log, Origin, Quality
from .survey import Survey
from .writing import LogWriter, open_log

__all__ = [
    "CHANNELS",
    "SIGNALS",
    "Ability",
    "JointLog",
    "Log",
    "LogOptions",
    "LogReader",
    "LogWriter",
    "LoggedJoint",
    "Origin",
    "Quality",
    "Survey",
    "abilities",
    "load_options",
    "log_reader",
    "open_log",
    "read_joint",
    "read_log",
    "unknown_units",
]
