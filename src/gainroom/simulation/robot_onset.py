"""Onset of vibration in MuJoCo: the factor on all gains above which a small initial motion of the robot no longer decays.

An independent check of gain_limit, without loci, linear models or delays in z: bodies, springs, drives, the running controller, and the
growth rate of the motors' motion. Gravity, friction and lifting feet are left out, since limits are those of small motions.
"""

import math
from dataclasses import replace

import numpy as np

from .onset import Onset, search_onset
from .oscillation import Vibration, vibration
from .robot_run import run_robot
from .robot_setup import RobotSetup, hold, substeps_for

INITIAL_SPEED = 1e-6
"""Initial motor speed [rad/s]. Of a vibration of amplitude a the second harmonic, which grows at twice its rate, has about a² [rad], and
positions are rounded by 1e-16 rad: a is here about 1e-8, and both are a hundred-millionth of it."""
TRANSIENT = 0.1
"""Share of a run discarded at its start, until fast transients have decayed."""
FINE_STEPS, FINE = 4, 1.25e-4
"""Least substeps per tick, and longest substep [s]: vibrations at 500 rad/s are then 2e-4 too fast, and held contacts, which MuJoCo lets
give way for two steps, are hard at 1000 rad/s: with steps twice as long a quadruped's limit is 2 % too low."""
RUN_DURATION, PERIODS = 0.5, 10.0
"""Least duration of a run [s], which separates the vibrations of nearly equal legs, and in periods of the expected vibration."""
SEARCH_STEP = 1.5
"""Factor between the gains tried until one vibrates and one does not."""
ACCURACY = 1e-3
"""Relative accuracy of the factor."""


def robot_onset(setup: RobotSetup, near: float = 1.0, frequency: float = math.inf) -> Onset:
    """Factor on all gains at which the simulated robot starts to vibrate; the search starts at `near`.

    frequency   about that of the vibration [rad/s]; it influences nothing but how long a run is

    Raises GainroomError if there is none between near/1000 and 1000 near.
    """
    bare = motionless(setup)
    duration = max(RUN_DURATION, PERIODS * 2 * math.pi / frequency)
    return search_onset(lambda gain: robot_vibration(bare, gain, duration), ACCURACY, near, SEARCH_STEP)


def motionless(setup: RobotSetup) -> RobotSetup:
    """Setup without gravity, friction, torque limit, encoder steps and ground, and with fine steps."""
    fine = max(FINE_STEPS, math.ceil(setup.sample_time / FINE - 1e-9), setup.substeps or substeps_for(setup))
    return replace(setup, gravity=False, coulomb=0.0, torque_limit=math.inf, encoder_step=0.0, ground=None, substeps=fine)


def robot_vibration(setup: RobotSetup, gain: float, duration: float = RUN_DURATION) -> Vibration | None:
    """Fastest-growing vibration in `duration` [s] after an initial speed of all motors, with all gains times `gain`; None: decayed."""
    speed = INITIAL_SPEED * np.random.default_rng(0).standard_normal(setup.body.size)
    run = run_robot(setup, hold(setup, duration), gain=gain, initial_speed=speed)
    swing = np.diff(run.motor_position, n=2, axis=0)[int(TRANSIENT * len(run.time)) :]  # without what drifts at constant speed
    found = vibration(swing, setup.sample_time, growing=True) if len(swing) else None
    if run.ending != "completed" and (found is None or found.growth_rate <= 0):
        return Vibration(0.0, math.inf, 0.0)  # it diverged without oscillation
    return found
