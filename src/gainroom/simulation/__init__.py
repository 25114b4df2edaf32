"""Time domain: the sampled linear loop stepped exactly, the virtual testbed with friction, limits and encoders, whole robots in MuJoCo."""

from .friction import Friction
from .mujoco_model import Ground, Sole
from .onset import Onset, linear_onset
from .oscillation import Vibration, response_vibration, vibration
from .response import Response, Tracking, track
from .robot_onset import robot_onset
from .robot_result import RobotRun
from .robot_run import run_robot, stream_robot
from .robot_setup import RobotSetup, hold, joint_setup, robot_setup
from .run import simulate, stream
from .scenario import Scenario, Start
from .testbed import Testbed
from .trajectories import Chirp, Multisine, Spline, Step, Trajectory

__all__ = [
    "Chirp",
    "Friction",
    "Ground",
    "Multisine",
    "Onset",
    "Response",
    "RobotRun",
    "RobotSetup",
    "Scenario",
    "Sole",
    "Spline",
    "Start",
    "Step",
    "Testbed",
    "Tracking",
    "Trajectory",
    "Vibration",
    "hold",
    "joint_setup",
    "linear_onset",
    "response_vibration",
    "robot_onset",
    "robot_setup",
    "run_robot",
    "simulate",
    "stream",
    "stream_robot",
    "track",
    "vibration",
]
