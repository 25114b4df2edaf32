"""gainroom identify: from a log in any format to numbers with intervals; what is wrong in one line."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.files.logs import JointLog, open_log

TICK = 1e-3
RNG = np.random.default_rng(20171117)


def run(*call: str | Path) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(["identify", *map(str, call)])
    return status, out.getvalue(), err.getvalue()


def steps(rows: int, held: int = 20) -> np.ndarray:
    """[N m]"""
    return RNG.uniform(-10, 10, rows // held + 1).repeat(held)[:rows]


def delayed(path: Path, ticks: int, rows: int = 3000) -> None:
    """A log of torques whose demand is the target some whole ticks later."""
    target = steps(rows)
    demand = np.concatenate([np.zeros(ticks), target])[:rows]
    columns = np.column_stack([TICK * np.arange(rows), target, demand])
    np.savetxt(path, columns, delimiter=",", header="time,target_torque,demand_torque", comments="")


def test_the_delay_of_a_demand_torque(tmp_path: Path):
    """Seen at tick 4, it arrived after tick 3: the truth is between, and nothing says where."""
    delayed(tmp_path / "log.csv", 4)
    status, out, err = run("delay", tmp_path / "log.csv", "--json")
    facts = json.loads(out)
    assert (status, err) == (0, "")
    assert {"delay_ms", "delay_ticks", "jitter_ms", "bandwidth", "damping_ratio", "warnings"} <= set(facts)
    assert (facts["delay_ms"]["low"], facts["delay_ms"]["high"]) == pytest.approx((3.0, 4.0), abs=1e-6)
    assert facts["bandwidth"] is None
    assert any("demand_torque alone" in text for text in facts["warnings"])
    status, out, err = run("delay", tmp_path / "log.csv")
    assert (status, err) == (0, "")
    assert "3 to 4" in out


def test_a_gap_is_a_gap():
    """100 rows, a gap of 10.4 ticks, 60 rows: on whole ticks, each part evenly."""
    time = TICK * np.concatenate([np.arange(100), 109.4 + np.arange(60)])
    channels = {"reference": np.arange(160.0)}
    record = JointLog(time, channels, TICK).record()
    assert np.flatnonzero(record.fresh).tolist() == [0, 100]
    assert record.ticks[[99, 100, 159]].tolist() == [99, 109, 168]
    assert np.array_equal(record.channels["reference"], np.arange(160.0))


def test_a_part_that_begins_half_a_tick_late_keeps_its_rows():
    time = TICK * np.concatenate([np.arange(100), 109.5 + np.arange(60)])
    record = JointLog(time, {"reference": time}, TICK).record()
    assert np.all(np.diff(record.ticks)[100:] == 1)


def test_several_joints_need_a_choice(tmp_path: Path):
    target = np.stack([steps(2000), steps(2000)], axis=1)
    demand = np.vstack([np.zeros((3, 2)), target])[:2000]
    with open_log(tmp_path / "log.parquet", ("hip", "knee"), ("target_torque", "demand_torque")) as log:
        log.write({"time": TICK * np.arange(2000), "target_torque": target, "demand_torque": demand})
    status, out, err = run("delay", tmp_path / "log.parquet")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "--joint NAME: hip, knee" in err
    status, out, _ = run("delay", tmp_path / "log.parquet", "--joint", "knee", "--json")
    assert (status, json.loads(out)["log"]["joint"]) == (0, "knee")


def test_front():
    status, out, _ = run()
    assert status == 2
    assert "Usage: gainroom identify" in out
