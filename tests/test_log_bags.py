"""Bags of ROS 1, packed, cut and hostile, and folders of the first ROS 2 releases."""

import bz2
import struct
from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import read_log
from gainroom.files.logs.table import MOST_PIECE
from log_files import JOINTS, Truth, write_bag, write_bag1
from refusals import assert_refused

TRUTH = Truth(200)


@pytest.mark.parametrize("packing", ["BZ2", "LZ4"])
def test_packed_chunks(packing: str, tmp_path: Path):
    write_bag1(tmp_path / "log.bag", TRUTH, packing)
    log = read_log(tmp_path / "log.bag")
    assert log.joint_names == JOINTS
    assert np.array_equal(log.signals["motor_position"], TRUTH.motor_position)
    assert np.array_equal(log.signals["target_torque"], TRUTH.target_torque)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_bag_that_is_cut_is_read_up_to_there(share: float, tmp_path: Path):
    """Without its index, as a bag that is still .active has none; never a number that was not written."""
    write_bag1(tmp_path / "log.bag", TRUTH)
    whole = (tmp_path / "log.bag").read_bytes()
    (tmp_path / "log.bag.active").write_bytes(whole[: int(share * len(whole))])
    log = read_log(tmp_path / "log.bag.active")
    count = len(log.time)
    assert not log.complete
    assert 10 < count < len(TRUTH.time) or share == 0.9
    assert np.array_equal(log.signals["motor_position"], TRUTH.motor_position[:count])


def record(data: bytes, **fields: bytes) -> bytes:
    header = b"".join(struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def chunk(data: bytes, size: int, compression: bytes = b"none") -> bytes:
    return record(data, op=b"\x05", compression=compression, size=struct.pack("<I", size))


CONNECTION = record(
    record(b"", type=b"std_msgs/Float64", message_definition=b"float64 data\n", topic=b"/hip/position")[4:-4],
    op=b"\x07",
    conn=struct.pack("<I", 0),
    topic=b"/hip/position",
)
ROW = record(struct.pack("<d", 1.5), op=b"\x02", conn=struct.pack("<I", 0), time=struct.pack("<II", 1, 2))
HOSTILE = {
    "no bag": b"#ROSBAG V1.2\n",
    "nothing": b"",
    "long header": struct.pack("<I", 1 << 31),
    "long record": record(b"", op=b"\x07")[:-4] + struct.pack("<I", 1 << 31),
    "field without sign": struct.pack("<I", 8) + struct.pack("<I", 4) + b"abcd" + struct.pack("<I", 0),
    "field beyond": struct.pack("<I", 8) + struct.pack("<I", 400) + b"a=cd" + struct.pack("<I", 0),
    "packed more": chunk(bz2.compress(bytes(1 << 28)), 1000, b"bz2"),
    "announces": chunk(b"", MOST_PIECE + 1),
    "packed otherwise": chunk(b"abc", 3, b"zip"),
    "record beyond its chunk": chunk(CONNECTION + ROW[:-4] + b"", len(CONNECTION + ROW[:-4])),
    "message of no size": record(b"", op=b"\x02", conn=b"", time=b""),
    "type of types": record(CONNECTION, op=b"\x07", conn=struct.pack("<I", 0), topic=b"/x"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_bags(name: str, tmp_path: Path):
    path = tmp_path / "log.bag"
    path.write_bytes((b"" if name.startswith("no") else b"#ROSBAG V2.0\n") + HOSTILE[name])
    assert_refused(lambda: read_log(path), ["log.bag"])


def test_the_bag_that_the_hostile_ones_are_made_of(tmp_path: Path):
    """Two joints' worth of nothing else: written by hand, read as it should be."""
    rows = [
        record(struct.pack("<d", k / 7), op=b"\x02", conn=struct.pack("<I", 0), time=struct.pack("<II", 5, k * 10**6)) for k in range(60)
    ]
    for body in (CONNECTION + b"".join(rows), chunk(CONNECTION + b"".join(rows), len(CONNECTION + b"".join(rows)))):
        (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n" + body)
        log = read_log(tmp_path / "log.bag")
        assert np.array_equal(log.joint().channels["motor_position"], np.arange(60) / 7)
        assert log.time - log.time[0] == pytest.approx(1e-3 * np.arange(60), abs=1e-12)


@pytest.mark.slow
def test_folders_of_the_first_releases(tmp_path: Path):
    """Versions 1 to 3: the folder's name, as it was, before the file's; "compression_mode: NONE"; types without msg."""
    import sqlite3

    write_bag(tmp_path / "bag", TRUTH)
    where = tmp_path / "bag" / "metadata.yaml"
    (file,) = (tmp_path / "bag").glob("*.db3")
    text = where.read_text("utf-8")
    for name in (f"bag/{file.name}", f"rosbag2_2020_03_01/{file.name}", file.name):
        old = text.replace(f"- {file.name}", f"- {name}").replace("version: 9", "version: 3")
        where.write_text(old.replace("compression_mode: ''", "compression_mode: NONE"), "utf-8")
        assert np.array_equal(read_log(tmp_path / "bag").signals["motor_position"], TRUTH.motor_position)
    with sqlite3.connect(file) as database:
        database.execute("UPDATE topics SET type = replace(type, '/msg/', '/')")
        database.execute("DROP TABLE IF EXISTS message_definitions")
    assert np.array_equal(read_log(file).signals["target_torque"], TRUTH.target_torque)


def test_ros_1_messages_in_mcap(tmp_path: Path):
    """As mcap's converter makes them of bags: encoding ros1, definitions ros1msg."""
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/hip/position", "ros1", writer.register_schema("std_msgs/Float64", "ros1msg", b"float64 data\n"))
        for k in range(60):
            writer.add_message(channel, log_time=10**6 * k, publish_time=0, data=struct.pack("<d", k / 7))
        writer.finish()
    assert np.array_equal(read_log(tmp_path / "log.mcap").joint().channels["motor_position"], np.arange(60) / 7)
