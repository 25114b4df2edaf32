"""Logs of two joints in every format, each written by the format's own library: shared by the tests of reading."""

import io
import json
import struct
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

JOINTS = ("hip", "knee")
BEGAN = 1_700_000_000
"""[s] of clocks that count from an epoch."""


class Truth:
    """What the files hold: k rows at 1 kHz."""

    def __init__(self, rows: int = 500, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.time = 1e-3 * np.arange(rows)
        self.motor_position, self.motor_velocity, self.target_torque, self.reference = rng.normal(size=(4, rows, 2))

    def channel(self, name: str, joint: str) -> np.ndarray:
        return getattr(self, name)[:, JOINTS.index(joint)]


def write_csv(path: Path, truth: Truth) -> None:
    """With the standard library's writer; semicolons, millisecond stamps, degrees."""
    import csv

    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter=";")
        writer.writerow(["t [ms]", *(f"{joint}_{name}" for name in ("pos_deg", "vel", "tau_cmd") for joint in JOINTS), "mode"])
        columns = np.hstack([1e3 * truth.time[:, None], np.degrees(truth.motor_position), truth.motor_velocity, truth.target_torque])
        writer.writerows([[*map(repr, row), "run"] for row in columns.tolist()])


def write_parquet(path: Path, truth: Truth) -> None:
    import pyarrow
    import pyarrow.parquet

    stamps = pyarrow.array(BEGAN * 10**9 + np.arange(len(truth.time)) * 10**6, pyarrow.timestamp("ns"))
    columns: dict[str, object] = {"stamp": stamps, "mode": ["run"] * len(truth.time)}
    for k, joint in enumerate(JOINTS):
        columns |= {f"q_{joint}": truth.motor_position[:, k], f"dq_{joint}": truth.motor_velocity[:, k]}
        columns |= {f"tau_des_{joint}": truth.target_torque[:, k]}
    pyarrow.parquet.write_table(pyarrow.table(columns), path, row_group_size=200)


def write_mcap(path: Path, truth: Truth) -> None:
    """JSON, a topic with both joints; zstd."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/joints", "json", writer.register_schema("Joints", "jsonschema", b"{}"))
        for k, time in enumerate(truth.time):
            content = {
                "name": JOINTS,
                "position": truth.motor_position[k].tolist(),
                "velocity": truth.motor_velocity[k].tolist(),
                "effort_command": truth.target_torque[k].tolist(),
            }
            stamp = BEGAN * 10**9 + round(1e9 * time)
            writer.add_message(channel, log_time=stamp, publish_time=stamp, data=json.dumps(content).encode())
        writer.finish()


def write_bag(path: Path, truth: Truth, storage: str = "SQLITE3") -> None:
    """A folder, with joint states and one command topic per joint; messages are recorded a little after their stamps."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    state, number = kinds["sensor_msgs/msg/JointState"], kinds["std_msgs/msg/Float64"]
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        states = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        commands = [writer.add_connection(f"/{joint}/effort_cmd", number.__msgtype__, typestore=store) for joint in JOINTS]
        for k in range(len(truth.time)):
            stamp = BEGAN * 10**9 + k * 10**6
            header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "base")
            message = state(header, list(JOINTS), truth.motor_position[k], truth.motor_velocity[k], np.zeros(0))
            for connection, torque in zip(commands, truth.target_torque[k], strict=True):
                writer.write(connection, stamp, bytes(store.serialize_cdr(number(float(torque)), number.__msgtype__)))
            writer.write(states, stamp + 1234, bytes(store.serialize_cdr(message, state.__msgtype__)))


def write_bag_mcap(path: Path, truth: Truth) -> None:
    write_bag(path, truth, "MCAP")


def write_bag1(path: Path, truth: Truth, packing: str = "") -> None:
    """Of ROS 1: joint states with a sequence number, and one command topic per joint."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    state, number = kinds["sensor_msgs/msg/JointState"], kinds["std_msgs/msg/Float64"]
    bag = Writer(path)
    if packing:
        bag.set_compression(Writer.CompressionFormat[packing])
    with bag as writer:
        states = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        commands = [writer.add_connection(f"/{joint}/effort_cmd", number.__msgtype__, typestore=store) for joint in JOINTS]
        for k in range(len(truth.time)):
            stamp = BEGAN * 10**9 + k * 10**6
            header = kinds["std_msgs/msg/Header"](k, kinds["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "base")
            message = state(header, list(JOINTS), truth.motor_position[k], truth.motor_velocity[k], np.zeros(0))
            for connection, torque in zip(commands, truth.target_torque[k], strict=True):
                writer.write(connection, stamp, bytes(store.serialize_ros1(number(float(torque)), number.__msgtype__)))
            writer.write(states, stamp + 1234, bytes(store.serialize_ros1(message, state.__msgtype__)))


def write_hdf5(path: Path, truth: Truth) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file["time"] = truth.time
        group = file.create_group("robot")
        group.create_dataset("q", data=np.degrees(truth.motor_position), chunks=(64, 2), compression="gzip", shuffle=True)
        group["q"].attrs["units"] = "deg"
        group.create_dataset("dq", data=truth.motor_velocity, chunks=(64, 2), compression="lzf", fletcher32=True)
        group.create_dataset("tau_des", data=truth.target_torque)
        group.create_dataset("joint_names", data=list(JOINTS), dtype=h5py.string_dtype())


def write_mat(path: Path, truth: Truth) -> None:
    """Structures of vectors, one per joint, among other things."""
    import scipy.io

    joints = {
        joint: {"q": truth.motor_position[:, k], "dq": truth.motor_velocity[:, k, None], "tau_des": truth.target_torque[:, k]}
        for k, joint in enumerate(JOINTS)
    }
    other = {"note": "hello", "cell": np.array([1, "a"], dtype=object), "empty": np.zeros((0, 0)), "z": np.array([1j, 2.0])}
    scipy.io.savemat(path, {"t": truth.time, **joints, **other}, do_compression=True)


def write_mat73(path: Path, truth: Truth) -> None:
    """As MATLAB: HDF5 behind 512 bytes of its own, arrays transposed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = truth.time[None]
        for k, joint in enumerate(JOINTS):
            group = file.create_group(joint)
            group["q"], group["dq"], group["tau_des"] = (
                values[None, :, k] for values in (truth.motor_position, truth.motor_velocity, truth.target_torque)
            )
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def write_bam(path: Path, truth: Truth) -> None:
    """One joint, as BAM's record.py for Dynamixel writes it."""
    entries = [
        {
            "position": position,
            "speed": speed,
            "load": 12,
            "input_volts": 15.1,
            "temp": 31,
            "timestamp": time,
            "goal_position": goal,
            "torque_enable": True,
        }
        for time, position, speed, goal in zip(
            truth.time.tolist(),
            truth.motor_position[:, 0].tolist(),
            truth.motor_velocity[:, 0].tolist(),
            truth.reference[:, 0].tolist(),
            strict=True,
        )
    ]
    data = {"mass": 0.5, "length": 0.1, "kp": 8, "vin": 15.0, "motor": "mx64", "trajectory": "sin_time_square", "entries": entries}
    path.write_text(json.dumps(data), "utf-8")


def torch_pickle(arrays: dict[str, np.ndarray], labels: Sequence[str] = ()) -> bytes:
    """What torch.save writes of a dictionary of tensors, instruction by instruction (protocol 2)."""
    out = io.BytesIO()
    out.write(b"\x80\x02}q\x00(")
    memory = 1

    def put() -> bytes:
        nonlocal memory
        memory += 1
        return b"q" + bytes([memory - 1]) if memory <= 256 else b"r" + struct.pack("<I", memory - 1)

    def text(value: str) -> bytes:
        return b"X" + struct.pack("<I", len(value.encode())) + value.encode() + put()

    def whole(value: int) -> bytes:
        return (
            b"K" + bytes([value]) if value < 256 else b"M" + struct.pack("<H", value) if value < 65536 else b"J" + struct.pack("<i", value)
        )

    def several(values: Sequence[int]) -> bytes:
        content = b"".join(map(whole, values))
        return {1: content + b"\x85", 2: content + b"\x86"}[len(values)] + put()

    kinds = {"f8": b"Double", "f4": b"Float", "i8": b"Long"}
    for k, (name, array) in enumerate(arrays.items()):
        out.write(text(name) + b"ctorch._utils\n_rebuild_tensor_v2\n" + put() + b"((" + text("storage"))
        out.write(
            b"ctorch\n" + kinds[array.dtype.str[1:]] + b"Storage\n" + put() + text(str(k)) + text("cpu") + whole(array.size) + b"t" + put()
        )
        out.write(b"Q" + whole(0) + several(array.shape) + several([step // array.itemsize for step in array.strides]))
        out.write(b"\x89ccollections\nOrderedDict\n" + put() + b")R" + put() + b"t" + put() + b"R" + put())
    if labels:
        out.write(text("joint_names") + b"]" + put() + b"(" + b"".join(map(text, labels)) + b"e")
    out.write(b"u.")
    return out.getvalue()


def write_torch(path: Path, arrays: dict[str, np.ndarray], pickle: bytes) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", pickle)
        archive.writestr("log/byteorder", "little")
        for k, array in enumerate(arrays.values()):
            archive.writestr(f"log/data/{k}", array.tobytes())
        archive.writestr("log/version", "3\n")


def write_pace(path: Path, truth: Truth) -> None:
    arrays = {"time": truth.time, "dof_pos": truth.motor_position, "des_dof_pos": truth.reference}
    write_torch(path, arrays, torch_pickle(arrays, JOINTS))


def write_npz(path: Path, truth: Truth) -> None:
    arrays = {"q": np.asfortranarray(truth.motor_position), "dq": truth.motor_velocity, "tau_des": truth.target_torque}
    np.savez_compressed(path, time=truth.time, joint_names=JOINTS, **arrays)


WRITERS: dict[str, Callable[[Path, Truth], None]] = {
    "log.csv": write_csv,
    "log.parquet": write_parquet,
    "log.mcap": write_mcap,
    "bag": write_bag,
    "bag_mcap": write_bag_mcap,
    "log.bag": write_bag1,
    "log.h5": write_hdf5,
    "log.mat": write_mat,
    "log73.mat": write_mat73,
    "log.json": write_bam,
    "log.npz": write_npz,
    "log.pt": write_pace,
}
"""By name of the file, or folder, in the order of the documentation."""


def damaged_file(path: Path) -> Path:
    """The file of a log that is to be damaged."""
    return next(file for file in sorted(path.iterdir()) if file.suffix in (".db3", ".mcap")) if path.is_dir() else path


def read_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """No guarded child is started for a log: for tests that change what reads, or read a file a hundred times."""
    monkeypatch.setattr("gainroom.files.logs.reading.opened_table", lambda form, path, time: form.table(path, time))
