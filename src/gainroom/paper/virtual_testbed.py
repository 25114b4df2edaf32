"""The one-joint testbed of Sec. IV-A as a simulation, and its runs as logs. What the paper prints stands beside the value, as in joints.py.

"Assumed": neither printed nor to be recovered from its numbers; ordinary for such a joint.
"""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..files.logs.reading import read_log
from ..files.logs.writing import open_log
from ..identification import Estimate, Record
from ..simulation import Friction, Run, Testbed
from ..system.controller import PD
from ..system.elastic_joint import ElasticJoint
from ..system.loop import Loop, build_loop
from .joints import SAMPLE_TIME, TESTBED, TESTBED_DRIVE
from .row import Row

GRAVITY = 3.9 * 9.81 * 0.3  # [N m] printed: a link of 0.6 m and 3.9 kg; assumed: its mass centre in the middle
MOTOR_FRICTION = Friction(coulomb=1.0, static=1.5, stribeck_velocity=0.05)  # assumed
LINK_FRICTION = Friction(coulomb=0.2, static=0.3, stribeck_velocity=0.05)  # assumed
MOTOR_RESOLUTION = 2 * math.pi / (4 * 2048 * 100)  # [rad] assumed: 2048 lines on the motor, seen through the printed 100:1
LINK_RESOLUTION = 2 * math.pi / 2**19  # [rad] assumed
TORQUE_LIMIT = 150.0  # [N m] assumed
BUS_DELAY = TESTBED_DRIVE.delay - SAMPLE_TIME  # [s] inferred: hold and velocity difference are one tick of the continuous loop's delay


def loop_of_testbed(kp: float, kv: float, delay: float = BUS_DELAY, joint: ElasticJoint = TESTBED) -> Loop:
    """The testbed's loop at 2 kHz; `delay` [s] from target to demand."""
    return build_loop(joint, replace(TESTBED_DRIVE, delay=delay), PD(kp, kv), sample_time=SAMPLE_TIME)


def virtual_testbed(loop: Loop, jitter: float = 0.0, whole_ticks: bool = False) -> Testbed:
    """Testbed with the hardware's friction, gravity, encoders and torque limit; `jitter` [s] of the bus."""
    return Testbed(
        loop,
        motor_friction=MOTOR_FRICTION,
        link_friction=LINK_FRICTION,
        gravity=GRAVITY,
        torque_limit=TORQUE_LIMIT,
        motor_resolution=MOTOR_RESOLUTION,
        link_resolution=LINK_RESOLUTION,
        jitter=jitter,
        whole_ticks=whole_ticks,
    )


TORQUE_NOISE = 0.05  # [N m] assumed: of the measured torque, a two-hundredth of Fig. 6's steps
TORQUES = ("target_torque", "demand_torque", "actual_torque")


def logged(run: Run, *signals: str) -> Record:
    """`signals` of a run with noise on its actual torque, as they come back from a CSV file."""
    noise = TORQUE_NOISE * np.random.default_rng(6).standard_normal(run.actual_torque.shape)
    columns = replace(run, actual_torque=run.actual_torque + noise).columns()
    with tempfile.TemporaryDirectory(prefix="gainroom-") as folder:
        path = Path(folder) / "log.csv"
        with open_log(path, run.joint_names, signals) as log:
            log.write(columns)
        read = read_log(path).joint()
    return Record(read.time, read.channels, read.sample_time)


def with_interval(row: Row, found: Estimate) -> Row:
    """`row` with the 95 % interval of its number, in its unit."""
    return replace(row, low=found.low, high=found.high)
