"""Logs in every format, written by the format's own library, are read as they are; names, units and joints are found out and reported."""

from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import CHANNELS, LogOptions, log_reader, read_log
from gainroom.simulation.run_record import LOGGED
from log_files import BEGAN, JOINTS, WRITERS, Truth, read_in_this_process, write_bag
from refusals import assert_refused

POSITIONS = {"log.json": ("motor_position", "motor_velocity", "reference"), "log.pt": ("motor_position", "reference")}
"""Channels of formats that have no torque."""
TRUTH = Truth()
EXACT = 1e-12  # a conversion between degrees and radians rounds twice


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_every_format_comes_back(name: str, tmp_path: Path):
    WRITERS[name](tmp_path / name, TRUTH)
    log = read_log(tmp_path / name)
    joints = ("joint",) if name == "log.json" else JOINTS
    assert log.joint_names == joints
    assert log.complete
    assert log.began == pytest.approx(BEGAN if name in ("log.parquet", "log.mcap", "bag", "bag_mcap", "log.bag") else 0.0, abs=1.1)
    assert np.abs(log.time - log.time[0] - TRUTH.time).max() < 1e-9
    assert log.sample_time == pytest.approx(1e-3, rel=1e-9)
    assert (log.quality.rows, log.quality.cut, log.quality.gaps) == (len(TRUTH.time), 0, 0)
    channels = POSITIONS.get(name, ("target_torque", "motor_position", "motor_velocity"))
    for joint in joints:
        assert set(log.joints[joint]) == set(channels)
        for channel in channels:
            wanted = TRUTH.channel(channel, JOINTS[0] if joint == "joint" else joint)
            assert np.abs(log.joints[joint][channel] - wanted).max() < EXACT, (joint, channel)
    origins = {(origin.joint, origin.channel) for origin in log.origins}
    assert origins == {("", "time")} | {(joint, channel) for joint in joints for channel in channels}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_window_and_a_joint(name: str, tmp_path: Path):
    """Seconds after the first row, both ends included."""
    WRITERS[name](tmp_path / name, TRUTH)
    whole = read_log(tmp_path / name)
    log = read_log(tmp_path / name, options=LogOptions(start=0.1, end=0.2, joints=(whole.joint_names[-1],)))
    assert log.joint_names == whole.joint_names[-1:]
    assert log.time[[0, -1]] - whole.time[0] == pytest.approx([0.1, 0.2], abs=1.1e-3)  # stamps are rounded: a row may lie at either side
    first = int(np.searchsorted(whole.time, log.time[0]))
    assert np.array_equal(log.joint().channels["motor_position"], whole.signals["motor_position"][first : first + len(log.time), -1])


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_in_blocks_and_as_a_whole(name: str, tmp_path: Path, monkeypatch):
    read_in_this_process(monkeypatch)
    for place in ("csv_text.BLOCK_ROWS", "parquet.BLOCK_ROWS", "arrays.BLOCK_ROWS", "messages.BATCH"):
        monkeypatch.setattr(f"gainroom.files.logs.formats.{place}", 64)
    WRITERS[name](tmp_path / name, TRUTH)
    with log_reader(tmp_path / name) as reader:
        blocks = list(reader.blocks())
    whole = read_log(tmp_path / name)
    assert len(blocks) > 4
    assert len(blocks[-1].time) == 0
    assert blocks[-1].quality == whole.quality
    for channel, values in whole.signals.items():
        assert np.array_equal(np.concatenate([block.signals[channel] for block in blocks]), values)


def test_channels_have_what_simulation_writes():
    assert {*LOGGED, "time"} < set(CHANNELS)


def test_topics_with_clocks_of_their_own(tmp_path: Path):
    """Commands at half the rate and a little later: each holds until the next, and before the first there is none."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    number = store.types["std_msgs/msg/Float64"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            name: writer.add_connection(f"/{name}", number.__msgtype__, typestore=store) for name in ("motor_position", "effort_cmd", "vel")
        }
        for k in range(1000):
            stamps = {
                "motor_position": 1000 * k,
                "vel": 1000 * k + 500 if k % 3 == 0 else None,
                "effort_cmd": 1000 * k + 300 if k % 2 else None,
            }
            for name, stamp in stamps.items():
                if stamp is not None:
                    content = number(1e-6 * stamp if name == "vel" else float(k))
                    writer.write(topics[name], 1000 * stamp, bytes(store.serialize_cdr(content, number.__msgtype__)))
    log = read_log(tmp_path / "bag").joint()
    at = np.rint(1e3 * log.time).astype(int)
    assert np.array_equal(log.channels["motor_position"], at)
    assert np.array_equal(log.channels["target_torque"], (at - 2) // 2 * 2 + 1)  # of odd k, 0.3 ms after its row
    assert np.abs(log.channels["motor_velocity"] - log.time).max() < 1e-12  # linear in time: what is measured is interpolated
    assert at[0] == 2
    assert at[-1] == 999  # the last velocity came at 999.5 ms


@pytest.mark.parametrize("order", ["one after the other", "in turn", "one ends early"])
def test_topics_wherever_they_stand_in_the_file(order: str, tmp_path: Path, monkeypatch):
    """Each joint has a topic: in blocks of a hundred messages, in whatever order, the rows are the same."""
    from mcap.writer import Writer

    read_in_this_process(monkeypatch)
    monkeypatch.setattr("gainroom.files.logs.formats.messages.BATCH", 100)
    rows = [(joint, k) for joint in JOINTS for k in range(1000)]
    if order != "one after the other":
        rows.sort(key=lambda row: row[1])
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {joint: writer.register_channel(f"/{joint}", "json", 0) for joint in JOINTS}
        for joint, k in rows:
            if joint == JOINTS[0] or k < 600 or order != "one ends early":
                data = f'{{"motor_position": {float(k)}, "target_torque": {float(k // 2)}, "n": {10 * k}}}'.encode()
                writer.add_message(channels[joint], log_time=10**6 * k, publish_time=0, data=data)
        writer.finish()
    log = read_log(tmp_path / "log.mcap")
    count = 600 if order == "one ends early" else 1000
    assert log.quality.not_finite == 1000 - count
    assert np.array_equal(log.signals["motor_position"], np.repeat(np.arange(count)[:, None], 2, axis=1))
    assert np.array_equal(log.signals["target_torque"], np.repeat(np.arange(count)[:, None] // 2, 2, axis=1))


def test_two_publishers_on_one_topic(tmp_path: Path):
    """Each knows one joint; their messages are two streams."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    state = kinds["sensor_msgs/msg/JointState"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for k in range(400):
            for joint, name in enumerate(JOINTS):
                stamp = 10**6 * k
                header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](BEGAN + stamp // 10**9, stamp % 10**9), name)
                message = state(header, [name], np.array([k + 0.5 * joint]), np.zeros(0), np.zeros(0))
                writer.write(topic, BEGAN * 10**9 + stamp, bytes(store.serialize_cdr(message, state.__msgtype__)))
    log = read_log(tmp_path / "bag")
    assert log.joint_names == JOINTS
    assert np.array_equal(log.signals["motor_position"], np.arange(400)[:, None] + [0.0, 0.5])


def test_a_controller_state_of_ros2_control(tmp_path: Path):
    """From a bag without definitions in it, as those before Iron are: set-point, feedback and output by joint."""
    import sqlite3

    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from gainroom.files.logs.formats.ros_types import CONTROL_MSGS

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    store.register(get_types_from_msg(CONTROL_MSGS[kind], kind))
    kinds = store.types
    point, duration = kinds["trajectory_msgs/msg/JointTrajectoryPoint"], kinds["builtin_interfaces/msg/Duration"](0, 0)
    none = np.zeros(0)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/arm/controller_state", kind, typestore=store)
        for k in range(300):
            header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](BEGAN, k * 10**6), "")
            points = [
                point(TRUTH.reference[k], none, none, none, duration),
                point(TRUTH.motor_position[k], TRUTH.motor_velocity[k], none, none, duration),
                point(TRUTH.reference[k] - TRUTH.motor_position[k], none, none, none, duration),
                point(none, none, none, TRUTH.target_torque[k], duration),
            ]
            writer.write(topic, BEGAN * 10**9, bytes(store.serialize_cdr(kinds[kind](header, list(JOINTS), *points), kind)))
    (file,) = (tmp_path / "bag").glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DROP TABLE message_definitions")
    log = read_log(tmp_path / "bag")
    assert log.joint_names == JOINTS
    for channel in ("reference", "motor_position", "motor_velocity", "target_torque"):
        assert np.array_equal(log.signals[channel], getattr(TRUTH, channel)[:300]), channel


def test_fields_by_path(tmp_path: Path):
    """A custom message: named by topic and field."""
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/drive", "json", 0)
        for k in range(100):
            data = f'{{"axis": [{{"a": {k}, "b": {{"c": {2 * k}}}}}, {{"a": {3 * k}}}], "text": "x"}}'.encode()
            writer.add_message(channel, log_time=10**6 * k, publish_time=0, data=data)
        writer.finish()
    log = read_log(tmp_path / "log.mcap", {"actual_torque": "drive/axis[0].b.c", "motor_position": "axis[1].a"}).joint()
    assert np.array_equal(log.channels["actual_torque"], 2 * np.arange(100))
    assert np.array_equal(log.channels["motor_position"], 3 * np.arange(100))
    wrong = ["log.mcap", "'drive/axis[7].a'", "drive/axis[0].a"]
    assert_refused(lambda: read_log(tmp_path / "log.mcap", {"actual_torque": "drive/axis[7].a"}), wrong)


@pytest.mark.slow
def test_a_bag_that_reaches_out_of_its_folder(tmp_path: Path):
    write_bag(tmp_path / "bag", TRUTH)
    (tmp_path / "other").mkdir()
    (file,) = (tmp_path / "bag").glob("*.db3")
    file.rename(tmp_path / "other" / "elsewhere.db3")
    where = tmp_path / "bag" / "metadata.yaml"
    text = where.read_text("utf-8")
    for name in ("../other/elsewhere.db3", str(tmp_path / "other" / "elsewhere.db3"), "link.db3", "metadata.yaml"):
        if name == "link.db3":
            (tmp_path / "bag" / name).symlink_to(tmp_path / "other" / "elsewhere.db3")
        where.write_text(text.replace(file.name, name), "utf-8")
        assert_refused(lambda: read_log(tmp_path / "bag"), ["metadata.yaml", "relative_file_paths", "must"])
    where.write_text(text, "utf-8")
    assert_refused(lambda: read_log(tmp_path / "bag"), [file.name, "no such file"])


@pytest.mark.slow
@pytest.mark.parametrize("packing", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize("chunk", [1 << 30, 20_000], ids=["one chunk", "several"])
def test_an_mcap_that_is_cut_is_read_up_to_there(packing: str, chunk: int, tmp_path: Path):
    """Every message before the cut of a file that is not packed, the first ones of one that is; never one that was not written."""
    from mcap.writer import CompressionType, Writer

    path, rows = tmp_path / "log.mcap", 30_000 if chunk > 1e6 else 2000
    values, places = np.random.default_rng(5).normal(size=rows), []
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk, compression=CompressionType[packing])
        writer.start()
        channel = writer.register_channel("/hip", "json", 0)
        for k, value in enumerate(values.tolist()):
            writer.add_message(channel, log_time=10**6 * k, publish_time=0, data=f'{{"motor_position": {value!r}}}'.encode())
        writer.finish()
    whole = path.read_bytes()
    if packing == "NONE":
        for value in values.tolist():
            places.append(whole.index(repr(value).encode(), *places[-1:]))  # they stand in order
    for share in (0.3, 0.6, 0.8):
        cut = int(share * len(whole))
        path.write_bytes(whole[:cut])
        log = read_log(path)
        found = log.joint().channels["motor_position"]
        assert not log.complete
        assert np.array_equal(found, values[: len(found)])
        if packing == "NONE":
            before = sum(place + len(repr(value)) + 1 <= cut for place, value in zip(places, values.tolist(), strict=True))
            assert len(found) == before
        else:
            assert len(found) > 0.1 * rows
    path.write_bytes(whole[:150])
    assert_refused(lambda: read_log(path), ["log.mcap", "ends within its first chunk"])
    path.write_bytes(whole[:60])
    assert_refused(lambda: read_log(path), ["log.mcap", "cut off"])
