"""What is commanded and what is measured, told apart by the topic or the group that a column is in; and groups with their own clocks."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.files.logs import LogOptions, read_joint, read_log
from log_files import BEGAN, JOINTS, Truth
from refusals import assert_refused

TRUTH = Truth()


def write_states(folder: Path, topics: dict[str, dict[str, np.ndarray]], joints: Sequence[str] = JOINTS) -> Path:
    """A bag with a sensor_msgs/JointState per topic, each with the columns (k, n) that it has."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    state = kinds["sensor_msgs/msg/JointState"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {name: writer.add_connection(f"/{name}", state.__msgtype__, typestore=store) for name in topics}
        for k in range(len(TRUTH.time)):
            stamp = BEGAN * 10**9 + k * 10**6
            header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "")
            for name, columns in topics.items():
                fields = [columns[field][k] if field in columns else np.zeros(0) for field in ("position", "velocity", "effort")]
                message = state(header, list(joints), *fields)
                writer.write(connections[name], stamp, bytes(store.serialize_cdr(message, state.__msgtype__)))
    return folder


MEASURED = {"position": TRUTH.motor_position, "velocity": TRUTH.motor_velocity, "effort": TRUTH.motor_velocity + 1}
COMMANDED = {"position": TRUTH.reference, "effort": TRUTH.target_torque}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("measured", "commanded"),
    [
        ("joint_states", "joint_commands"),
        ("joint_states", "command"),
        ("leg/state", "leg/target"),
        ("robot/joint_states", "robot/joint_states_desired"),
        ("z_states", "a_setpoints"),
        ("target_machine/joint_states", "joint_cmd"),
    ],
)
def test_a_topic_that_is_named_for_commands_holds_them(measured: str, commanded: str, tmp_path: Path):
    """Of the same message type as the states, in either order in the file: its effort is no measured torque."""
    for first in (measured, commanded):
        topics = {name: MEASURED if name == measured else COMMANDED for name in sorted({measured, commanded}, key=lambda n: n != first)}
        log = read_log(write_states(tmp_path / first.replace("/", "_"), topics))
        assert log.joint_names == JOINTS
        assert np.array_equal(log.signals["motor_position"], TRUTH.motor_position)
        assert np.array_equal(log.signals["motor_velocity"], TRUTH.motor_velocity)
        assert np.array_equal(log.signals["actual_torque"], TRUTH.motor_velocity + 1)
        assert np.array_equal(log.signals["reference"], TRUTH.reference)
        assert np.array_equal(log.signals["target_torque"], TRUTH.target_torque)
        assert {origin.column_from for origin in log.origins} == {"name"}
        assert not log.notes


@pytest.mark.parametrize("first", ["own", "path"])
def test_a_name_that_says_it_itself_goes_before_one_whose_topic_does(first: str, tmp_path: Path):
    """Though it was filtered: `effort` is a command by the topic alone. Likewise the time of all goes before that of one group."""
    own, path = ("tau_cmd_filtered", TRUTH.target_torque), ("joint_commands/effort", TRUTH.target_torque + 1)
    both = [own, path] if first == "own" else [path, own]
    clocks = [("time", TRUTH.time), ("hip/time", TRUTH.time + 5)]
    columns = dict([*(clocks if first == "own" else clocks[::-1]), ("joint_states/position", TRUTH.motor_position[:, 0])])
    columns |= {name: values[:, 0] for name, values in both}
    np.savetxt(tmp_path / "log.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    log = read_log(tmp_path / "log.csv")
    took = {origin.channel: origin.column for origin in log.origins}
    assert (took["target_torque"], took["time"]) == ("tau_cmd_filtered", "time")
    assert log.signals["target_torque"][:, 0] == pytest.approx(TRUTH.target_torque[:, 0])


def test_topics_that_nothing_tells_apart_name_the_flag(tmp_path: Path):
    """What is to be typed is there, once per channel, and it does what it says when it is typed."""
    import shlex

    from gainroom.files.logs.options import assignments

    path = write_states(tmp_path / "bag", {"a/joint_states": MEASURED, "b/joint_states": COMMANDED})
    notes = [note for note in read_log(path).notes if "actual_torque" in note]
    assert len(notes) == 1
    assert "'b/joint_states/effort[hip]' and 1 more" in notes[0]
    typed = shlex.split(notes[0].partition("if it is the command: ")[2].removesuffix(")"))
    assert typed[0] == "--columns"
    log = read_log(path, assignments([typed[1]], "columns"))
    assert np.array_equal(log.signals["target_torque"], TRUTH.target_torque)
    assert np.array_equal(log.signals["actual_torque"], TRUTH.motor_velocity + 1)


@pytest.mark.slow
@pytest.mark.parametrize("topic", ["effort_controller/commands", "forward_effort_controller/commands"])
@pytest.mark.parametrize("count", [1, 2])
def test_commands_without_names_of_joints(topic: str, count: int, tmp_path: Path):
    """One number is that of the only joint; of several the flag is named that gives one to a joint."""
    from mcap.writer import Writer

    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        states, commands = (writer.register_channel(f"/{name}", "json", 0) for name in ("joint_states", topic))
        for k in range(200):
            state = {"name": JOINTS[:count], "position": TRUTH.motor_position[k, :count].tolist()}
            for channel, content in ((states, state), (commands, {"data": TRUTH.target_torque[k, :count].tolist()})):
                writer.add_message(channel, log_time=10**6 * k, publish_time=0, data=json.dumps(content).encode())
        writer.finish()
    log = read_log(path)
    if count == 1:
        assert np.array_equal(log.joint("hip").channels["target_torque"], TRUTH.target_torque[:200, 0])
    else:
        (note,) = (note for note in log.notes if "nothing is measured" in note)
        assert f"--columns 'target_torque.hip={topic}/data[0]'" in note
        log = read_log(path, {"target_torque.knee": f"{topic}/data[1]"})
        assert np.array_equal(log.joint("knee").channels["target_torque"], TRUTH.target_torque[:200, 1])


def test_topics_of_joints_with_their_states_and_commands(tmp_path: Path):
    """Flat messages: the joint is what is left of a topic's name, and its commands are no second joint."""
    from mcap.writer import Writer

    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for k, joint in enumerate(JOINTS):
            state, command = (writer.register_channel(f"/{joint}/{name}", "json", 0) for name in ("state", "command"))
            for row in range(200):
                measured = {"position": TRUTH.motor_position[row, k], "effort": TRUTH.motor_velocity[row, k]}
                for channel, content in ((state, measured), (command, {"effort": TRUTH.target_torque[row, k]})):
                    writer.add_message(channel, log_time=10**6 * row, publish_time=0, data=json.dumps(content).encode())
        writer.finish()
    log = read_log(path)
    assert log.joint_names == JOINTS
    assert np.array_equal(log.signals["target_torque"], TRUTH.target_torque[:200])
    assert np.array_equal(log.signals["actual_torque"], TRUTH.motor_velocity[:200])


def test_an_effort_that_is_never_commanded_is_no_torque(tmp_path: Path):
    """Commands of positions hold an effort of 0: identification takes the measured torque, and says so."""
    commands = {"position": TRUTH.reference[:, :1], "effort": 0 * TRUTH.target_torque[:, :1]}
    states = {name: values[:, :1] for name, values in MEASURED.items()}
    logged = read_joint(write_states(tmp_path / "bag", {"joint_states": states, "joint_commands": commands}, JOINTS[:1]))
    assert not logged.record.has("target_torque")
    assert logged.record.has("actual_torque", "reference")
    assert "target_torque is 0 N·m throughout and was left out" in logged.log.notes


def test_a_log_in_which_every_third_row_lacks_a_number_is_not_identified(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """What is commanded between the rows is not known: a delay of 4.3 ticks was found as 2.1, and sure of it."""
    noise = np.random.default_rng(2).normal(size=(3000, 3)).cumsum(axis=0)
    noise[::3, 2] = np.nan
    names = "time,target_torque,actual_torque,motor_position"
    np.savetxt(tmp_path / "log.csv", np.column_stack([1e-3 * np.arange(3000), noise]), delimiter=",", header=names, comments="")
    for question in ("delay", "joint"):
        assert main(["identify", question, str(tmp_path / "log.csv")]) == 2
        said = capsys.readouterr().err
        assert "ticks are missing" in said
        assert "12%" in said


def groups(path: Path, clocks: dict[str, np.ndarray]) -> Path:
    """HDF5: a group per joint with its own time stamps, and as many rows of its position."""
    import h5py

    with h5py.File(path, "w") as file:
        for joint, time in clocks.items():
            file[f"{joint}/time"], file[f"{joint}/position"] = time, TRUTH.channel("motor_position", joint)[: len(time)]
    return path


@pytest.mark.slow
def test_a_group_s_time_is_that_of_what_stands_beside_it(tmp_path: Path):
    log = read_log(groups(tmp_path / "one.h5", {"knee": TRUTH.time}))
    assert log.joint_names == ("knee",)
    assert np.array_equal(log.time, TRUTH.time)
    both = read_log(groups(tmp_path / "same.h5", dict.fromkeys(JOINTS, TRUTH.time)))
    assert np.array_equal(both.signals["motor_position"], TRUTH.motor_position)
    assert not both.notes


@pytest.mark.slow
@pytest.mark.parametrize("time", [TRUTH.time + 0.3, TRUTH.time[:400]], ids=["another clock", "fewer rows"])
def test_groups_with_clocks_of_their_own_are_not_read_as_one(time: np.ndarray, tmp_path: Path):
    """The second is left out, with what to type for it; a position on another's clock would be late."""
    path = groups(tmp_path / "log.h5", {"hip": TRUTH.time, "knee": time})
    log = read_log(path)
    assert log.joint_names == ("hip",)
    assert any("knee/position" in note and "--columns time=knee/time" in note for note in log.notes)
    assert_refused(lambda: read_log(path, options=LogOptions(joints=("knee",))), ["none of its joints", "--columns time=knee/time"])
    knee = read_log(path, {"time": "knee/time"}).joint("knee")
    assert np.allclose(knee.time, time, rtol=0, atol=1e-12)
    assert np.array_equal(knee.channels["motor_position"], TRUTH.motor_position[: len(time), 1])
