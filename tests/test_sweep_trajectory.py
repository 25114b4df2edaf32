"""Sweeps of the postures in a log: each row is one, and what is not in the log is said."""

import json

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.studies.sweep.store import open_sweep
from robot_files import ROBOT, write_arm


@pytest.mark.slow
def test_a_trajectory_is_swept_posture_by_posture(tmp_path, capsys):
    arm, log = write_arm(tmp_path, ROBOT), tmp_path / "walk.csv"
    elbow = 0.1 + 0.5 * np.sin(0.1 * np.arange(60))
    rows = "\n".join(f"{0.001 * k},{angle!r}" for k, angle in enumerate(elbow.tolist()))
    log.write_text(f"time,motor_position_elbow\n{rows}\n")
    store = tmp_path / "sweep.zarr"
    assert main(["sweep", str(arm), "--trajectory", str(log), "--output", str(store), "--json"]) == 0
    angles = open_sweep(store).angles.values
    assert np.allclose(angles[:, 1], elbow, atol=1e-12)
    assert np.all(angles[:, 0] == 0.4)  # shoulder, in the file's posture
    found = json.loads(capsys.readouterr().out)
    assert found["postures"] == "trajectory"
    assert found["warnings"] == [f"{log}: no positions of shoulder; there as in posture bent"]


def test_rows_of_a_log_without_a_posture_are_said_to_be_left_out(tmp_path, capsys):
    arm, log = write_arm(tmp_path, ROBOT), tmp_path / "walk.csv"
    log.write_text("time,motor_position_shoulder,motor_position_elbow\n0,0.1,0.2\n0.1,nan,0.3\n0.2,0.1,0.4\n0.3,0.1,inf\n")
    assert main(["sweep", str(arm), "--trajectory", str(log), "--workers", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["count"] == 2
    assert "2 of 4 rows are left out" in found["warnings"][0]
