"""Onset of vibration in MuJoCo: the factor on all gains from which a small initial motion of the robot no longer decays.

An independent check of gain_limit, without loci, linear models or delays in z: bodies, springs, drives, the running controller, and the
growth rate of the motors' motion. Without gravity, friction or feet that lift, as the limits are those of small motions.
"""

import math
from dataclasses import replace

import numpy as np

from .onset import Onset, search_onset
from .oscillation import Vibration, vibration
from .robot_run import run_robot
from .robot_setup import RobotSetup, hold, substeps_for

INITIAL_SPEED = 1e-4
"""Speed of the motors at the start [rad/s]: nonlinear effects are then a millionth, and rounding is far smaller."""
TRANSIENT = 0.1
"""Part of a run that is left out at its start, until fast transients have decayed."""
FINE_STEPS, FINE = 4, 1.25e-4
"""Substeps per tick at least, and how long each may be [s]: vibrations at 500 rad/s are then 2e-4 too fast, and held contacts, which
MuJoCo lets give way for two steps, are hard beside 1000 rad/s: on steps twice as long a quadruped's limit is 2 % too low."""
RUN_DURATION = 0.5
"""Of a run [s]: long enough to separate the vibrations of nearly equal legs."""
SEARCH_STEP = 1.5
"""Factor between the gains tried until one vibrates and one does not."""
ACCURACY = 1e-3
"""Of the factor."""


def robot_onset(setup: RobotSetup, near: float = 1.0) -> Onset:
    """The factor on all gains at which vibration starts, the first that is tried `near`.

    Raises GainroomError where no factor between near/1000 and 1000 near does.
    """
    bare = motionless(setup)
    return search_onset(lambda gain: robot_vibration(bare, gain), ACCURACY, near, SEARCH_STEP)


def motionless(setup: RobotSetup) -> RobotSetup:
    """The same robot without gravity, friction, torque limit, encoder steps and ground, in fine steps."""
    fine = max(FINE_STEPS, math.ceil(setup.sample_time / FINE - 1e-9), setup.substeps or substeps_for(setup))
    return replace(setup, gravity=False, coulomb=0.0, torque_limit=math.inf, encoder_step=0.0, ground=None, substeps=fine)


def robot_vibration(setup: RobotSetup, gain: float) -> Vibration | None:
    """The fastest-growing vibration after an initial speed of all motors, with all gains times `gain`; None where none is found."""
    speed = INITIAL_SPEED * np.random.default_rng(0).standard_normal(setup.body.size)
    run = run_robot(setup, hold(setup, RUN_DURATION), gain=gain, initial_speed=speed)
    swing = np.diff(run.motor_position, n=2, axis=0)[int(TRANSIENT * len(run.time)) :]  # without what drifts at constant speed
    found = vibration(swing, setup.sample_time, growing=True) if len(swing) else None
    if run.ending != "completed" and (found is None or found.growth_rate <= 0):
        return Vibration(0.0, math.inf, 0.0)  # it diverged without oscillation
    return found
