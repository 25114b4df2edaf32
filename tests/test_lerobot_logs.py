"""LeRobot's data sets as logs, and the units of hobby servos: encoder steps, parts of a range, registers of current."""

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.files.logs import LogOptions, log_reader, read_joint, read_log
from gainroom.files.logs.units import factor
from log_files import read_in_this_process
from refusals import assert_refused

NAMES = ("shoulder_pan.pos", "elbow_flex.pos")
RATE = 50
ROWS = 60


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Children are started where a test says so: each takes a second."""
    read_in_this_process(monkeypatch)


def episode(seed: int, rows: int = ROWS, scale: float = 90.0) -> dict[str, np.ndarray]:
    """Set-points and positions (rows, 2) of their own in every episode."""
    action, state = scale * np.random.default_rng(seed).uniform(-1, 1, (2, rows, 2))
    return {"action": action.astype("f4"), "observation.state": state.astype("f4")}


def written(path: Path, episodes: Mapping[int, Mapping[str, np.ndarray]]) -> None:
    """Data file with these episodes, one after the other, as LeRobot writes it: lists, float32, stamps that begin at 0 each time."""
    import pyarrow
    import pyarrow.parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    lengths = [len(each["action"]) for each in episodes.values()]
    columns: dict[str, Any] = {}
    for key in next(iter(episodes.values())):
        values = np.concatenate([each[key] for each in episodes.values()])
        columns[key] = pyarrow.array([*values], pyarrow.list_(pyarrow.float32()))
    columns["timestamp"] = np.concatenate([np.arange(rows) / RATE for rows in lengths]).astype("f4")
    columns["frame_index"] = np.concatenate([np.arange(rows) for rows in lengths])
    columns["episode_index"] = np.repeat([*episodes], lengths)
    columns["index"] = np.arange(sum(lengths))
    columns["next.reward"] = np.zeros(sum(lengths))
    pyarrow.parquet.write_table(pyarrow.table(columns), path)


def info(root: Path, names: Any = NAMES, version: str = "v3.0", **others: Any) -> None:
    features = {key: {"dtype": "float32", "shape": [2], "names": names} for key in ("action", "observation.state")}
    (root / "meta").mkdir(parents=True, exist_ok=True)
    data = {"codebase_version": version, "fps": RATE, "features": {**features, "timestamp": {"names": None}}} | others
    (root / "meta" / "info.json").write_text(json.dumps(data))


def of_version_2(root: Path, names: Any = NAMES) -> Path:
    info(root, names, "v2.1")
    for number in (0, 1, 12):
        written(root / "data" / "chunk-000" / f"episode_{number:06}.parquet", {number: episode(number)})
    return root


def of_version_3(root: Path) -> Path:
    info(root)
    written(root / "data" / "chunk-000" / "file-000.parquet", {0: episode(0), 1: episode(1)})
    written(root / "data" / "chunk-001" / "file-000.parquet", {12: episode(12)})
    return root


@pytest.mark.parametrize("make", [of_version_2, of_version_3])
@pytest.mark.parametrize("number", [None, 0, 1, 12])
def test_an_episode_is_read_as_it_was_written(tmp_path: Path, make: Any, number: int | None):
    root = make(tmp_path / "set")
    log = read_log(root, options=LogOptions(units={"motor_position": "deg", "reference": "deg"}, episode=number))
    truth = episode(number or 0)
    assert log.joint_names == ("shoulder_pan", "elbow_flex")
    for k, joint in enumerate(log.joint_names):
        for channel, key in (("reference", "action"), ("motor_position", "observation.state")):
            # numpy multiplies by the same π/180, rounded once
            np.testing.assert_allclose(log.joints[joint][channel], np.radians(truth[key][:, k].astype(float)), rtol=1e-15)
    np.testing.assert_allclose(log.time, np.arange(ROWS) / RATE, atol=1e-7)  # float32
    assert ("episode 0 is read, of several: --episode says another" in log.notes) == (number is None)


def test_a_file_of_a_data_set_is_read_with_its_names(tmp_path: Path):
    two, three = of_version_2(tmp_path / "two"), of_version_3(tmp_path / "three")
    units = {"motor_position": "deg", "reference": "deg"}
    for path, number in ((two / "data/chunk-000/episode_000012.parquet", 12), (three / "data/chunk-000/file-000.parquet", 1)):
        log = read_log(path, options=LogOptions(units=units, episode=number))
        np.testing.assert_allclose(
            log.joints["elbow_flex"]["reference"], np.radians(episode(number)["action"][:, 1].astype(float)), rtol=1e-15
        )
    assert_refused(lambda: read_log(two / "data/chunk-000/episode_000012.parquet", options=LogOptions(episode=1)), ["episodes are 12"])


@pytest.mark.parametrize(
    ("names", "joints"),
    [
        (["main_shoulder_pan", "main_gripper"], ("main_shoulder_pan", "main_gripper")),
        ({"motors": ["left_waist", "left_elbow"]}, ("left_waist", "left_elbow")),
        ([["hip", "knee"]], ("hip", "knee")),
        (None, ("0", "1")),
        (["hip.pos", "x.vel"], ("hip",)),
        (["hip", "left_eef_pos_x"], ("hip",)),
    ],
)
def test_names_stand_in_several_forms(tmp_path: Path, names: Any, joints: tuple[str, ...]):
    root = of_version_2(tmp_path / "set", names)
    with log_reader(root, LogOptions(units={"motor_position": "deg", "reference": "deg"})) as reader:
        assert reader.joint_names == joints


def test_quantities_and_units_that_names_say(tmp_path: Path):
    root = tmp_path / "set"
    info(root, ["hip_deg", "hip.vel"])
    written(root / "data" / "chunk-000" / "file-000.parquet", {0: episode(0)})
    log = read_log(root, options=LogOptions(units={"motor_velocity": "deg/s", "reference_velocity": "deg/s"}))
    assert {origin.channel: origin.unit for origin in log.origins if origin.channel != "time"} == {
        "motor_position": "deg", "motor_velocity": "deg/s", "reference": "deg", "reference_velocity": "deg/s",
    }  # fmt: skip


def test_positions_need_a_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """1.5 may be an angle in rad, or a small motion in degrees or parts of a range: nobody says."""
    info(tmp_path)
    file = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    options = LogOptions(joints=("elbow_flex",))
    words = ["unit of motor_position and reference", "--units motor_position=UNIT,reference=UNIT", "deg", "norm/DEGREES", "counts/4096"]
    for scale in (1.5, 90.0):
        written(file, {0: episode(0, scale=scale)})
        assert_refused(lambda: read_joint(tmp_path, options), words)
        assert_refused(lambda: read_log(tmp_path, options=options), words)
    written(file, {0: episode(0, scale=1.5)})
    radians = LogOptions(joints=("elbow_flex",), units={"motor_position": "rad", "reference": "rad"})
    np.testing.assert_allclose(read_joint(tmp_path, radians).joint.channels["reference"], episode(0, scale=1.5)["action"][:, 1])
    written(file, {0: episode(0)})
    assert main(["log", str(tmp_path)]) == 0  # which lists the joints
    said = " ".join(capsys.readouterr().out.split())
    for word in ("of 2 joints", "shoulder_pan", "elbow_flex", "The unit of motor_position and reference is not said", "norm/DEGREES"):
        assert word in said
    named = LogOptions(joints=("elbow_flex",), units={"motor_position": "norm/200", "reference": "norm/200"})
    # −100 … 100 over 200 degrees: one is a degree
    np.testing.assert_allclose(read_joint(tmp_path, named).joint.channels["reference"], np.radians(episode(0)["action"][:, 1]), rtol=1e-7)


@pytest.mark.parametrize(
    ("text", "dimension", "count", "value"),
    [
        ("counts/4096", "angle", 1024, math.pi / 2),
        ("ticks/1228.8", "angle", 1024, math.radians(300)),  # XL-320: 1024 steps over 300 degrees
        ("-counts/4096/s", "speed", 2048, -math.pi),
        ("norm/220", "angle", 100, math.radians(110)),
        ("6.5mA", "current", 100, 0.65),
        ("2.69mA", "current", 1000, 2.69),
        ("mA*1.2", "torque", 500, 0.6),
        ("A*1.2", "torque", 2, 2.4),
        ("-6.5mA*1.2", "torque", 100, -0.78),
        ("6.5mA*feetech-sts3215-7v4", "torque", 100, 0.65 * 1.21164135295077),  # kt in bam/params/feetech_sts3215_7_4V/m1.json
    ],
)
def test_units_of_servos(text: str, dimension: str, count: float, value: float):
    assert count * factor(text, dimension, "x") == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mA*feetech-sts3215", ["torque constant of feetech-sts3215 is published as 1.21 to", "give a number"]),
        ("mA*dynamixel-xm430", ["torque constant of dynamixel-xm430 is not published"]),
        ("mA*gizmo", ["gizmo", "is no actuator"]),
        ("mA*0", ["is no actuator"]),
        ("mA*", ["must be one of", "mA*1.2"]),
        ("norm/220", ["must be one of"]),
    ],
)
def test_torque_units_that_are_none(text: str, words: Sequence[str]):
    assert_refused(lambda: factor(text, "torque", "here"), ["here", *words])


def test_currents_become_torques_by_name(tmp_path: Path):
    info(tmp_path, ["hip.pos", "hip.current"])
    written(tmp_path / "data" / "chunk-000" / "file-000.parquet", {0: episode(0, scale=1.5)})
    columns = {"actual_torque": "observation.state[{joint}.current]"}
    radians = {"motor_position": "rad", "reference": "rad"}
    joint = read_joint(tmp_path, LogOptions(columns=columns, units={"actual_torque": "6.5mA*2", **radians})).joint
    np.testing.assert_allclose(joint.channels["actual_torque"], 0.013 * episode(0, scale=1.5)["observation.state"][:, 1], rtol=1e-7)
    assert "current" not in read_joint(tmp_path, LogOptions(units=radians)).joint.channels  # registers without a unit
    assert_refused(lambda: read_joint(tmp_path, LogOptions(columns=columns, units=radians)), ["actual_torque", "Nm", "mA*1.2"])


@pytest.mark.slow
def test_the_delay_of_a_joint_in_a_data_set(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """A joint behind 60 ms of delay: ẍ = 400 (r(t − 60 ms) − x) − 28 ẋ, integrated here in small steps."""
    monkeypatch.undo()  # read in a guarded child, as users do
    rng, fine = np.random.default_rng(3), 100
    ticks = 1500
    held = np.repeat(30 * np.interp(np.arange(ticks), np.arange(0, ticks, 5), rng.uniform(-1, 1, ticks // 5)), fine)
    late = np.concatenate([np.full(round(0.06 * RATE * fine), held[0]), held])[: len(held)]
    position, speed, step, positions = held[0], 0.0, 1 / (RATE * fine), []
    for k, target in enumerate(late):
        if k % fine == 0:
            positions.append(position)
        speed += step * (400 * (target - position) - 28 * speed)
        position += step * speed
    columns = {"action": held[::fine], "observation.state": np.array(positions)}
    info(tmp_path)
    written(
        tmp_path / "data" / "chunk-000" / "file-000.parquet", {4: {key: np.column_stack([each, each]) for key, each in columns.items()}}
    )
    units = ["--units", "motor_position=deg,reference=deg", "--joint", "elbow_flex"]
    assert main(["identify", "delay", str(tmp_path), "--episode", "4", *units, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["total_delay_ms"]
    assert found["low"] <= 60 <= found["high"]
    assert found["high"] - found["low"] < 5  # a quarter of a frame


def _linked(root: Path) -> None:
    outside = root.parent / "outside.parquet"
    written(outside, {0: episode(0)})
    (root / "data" / "chunk-000").mkdir(parents=True)
    os.symlink(outside, root / "data" / "chunk-000" / "file-000.parquet")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", ["info.json", "is not JSON"]),
        ("[" * 100_000, ["info.json", "is not JSON"]),
        ("[]", ["features must be a section"]),
        ('{"features": []}', ["features must be a section"]),
        ('{"features": {}, "fps": 0}', ["fps", "must be a number > 0"]),
        ('{"features": {}, "fps": "30"}', ["fps", "must be a number > 0"]),
        ('{"features": {"action": {"names": [1, 2]}}, "fps": 50}', ["features.action.names", "a list of names"]),
        ('{"features": {"action": {"names": ["a"]}}, "fps": 50}', ["action has 2 entries", "names 1"]),
        (json.dumps({"features": {"action": {"names": ["a"] * 100_000}}, "fps": 50}), ["number of names", "must be at most"]),
    ],
)
def test_descriptions_that_are_none(tmp_path: Path, text: str, words: Sequence[str]):
    root = of_version_3(tmp_path / "set")
    (root / "meta" / "info.json").write_text(text)
    assert_refused(lambda: read_log(root), [str(root), *words])


def test_data_sets_that_are_damaged(tmp_path: Path):
    info(tmp_path / "none")
    assert_refused(lambda: read_log(tmp_path / "none"), ["has no data/chunk-*"])
    info(tmp_path / "linked")
    _linked(tmp_path / "linked")
    assert_refused(lambda: read_log(tmp_path / "linked"), ["link out of the data set"])
    root = of_version_3(tmp_path / "three")
    assert_refused(lambda: read_log(root, options=LogOptions(episode=7)), ["--episode 7", "3 from 0 to 12"])
    file = root / "data" / "chunk-000" / "file-000.parquet"
    file.write_bytes(file.read_bytes()[:500])
    assert_refused(lambda: read_log(root), [str(root)])
    assert_refused(lambda: LogOptions(episode=-1), ["episode -1"])
    (tmp_path / "log.csv").write_text("time,q\n0,0\n0.1,1\n")
    assert_refused(lambda: read_log(tmp_path / "log.csv", options=LogOptions(episode=1)), ["--episode 1", "has no episodes"])


def test_a_snapshot_of_the_hub_has_its_content_in_links(tmp_path: Path):
    root = of_version_3(tmp_path / "cache" / "snapshots" / "abc")
    blobs = tmp_path / "cache" / "blobs"
    blobs.mkdir()
    for number, file in enumerate(sorted(root.rglob("*.parquet"))):
        file.rename(blobs / str(number))
        file.symlink_to(blobs / str(number))
    units = {"motor_position": "deg", "reference": "deg"}
    assert read_log(root, options=LogOptions(episode=12, units=units)).joint_names == ("shoulder_pan", "elbow_flex")
