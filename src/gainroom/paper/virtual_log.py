"""Logs of the virtual testbed as a user has them: written to a file, read from it, and given to identification."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..files.logs.reading import read_log
from ..files.logs.writing import open_log
from ..identification import Estimate, Record
from ..simulation import Run
from .row import Row

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
