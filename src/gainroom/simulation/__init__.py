"""Time-domain simulation: the sampled linear loop stepped exactly, and a virtual testbed with friction, limits and encoders.

Whole robots in MuJoCo are in robot_setup, robot_run and robot_onset, which load more.
"""

from .friction import Friction
from .oscillation import Vibration, response_vibration, vibration
from .run import simulate, stream
from .run_record import Run
from .scenario import Scenario, Start
from .testbed import Testbed
from .tracking import Tracking, track
from .trajectories import Chirp, Multisine, Spline, Step, Trajectory

__all__ = [
    "Chirp",
    "Friction",
    "Multisine",
    "Run",
    "Scenario",
    "Spline",
    "Start",
    "Step",
    "Testbed",
    "Tracking",
    "Trajectory",
    "Vibration",
    "response_vibration",
    "simulate",
    "stream",
    "track",
    "vibration",
]
