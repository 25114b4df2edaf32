"""Gains as arrays, in moteus' unit and in a policy's metadata: they arrive as they were meant, everything else is refused in one line."""

import json
import math
import os
from pathlib import Path
from random import Random

import pytest
import yaml
from hypothesis import HealthCheck, given, settings

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.gain_files import gains_of, read_gains
from mutations import RANDOMS, mutated_bytes
from robot_truths import hinge, link, write_robot

JOINTS = ("left_hip_pitch_joint", "left_knee_joint", "right_hip_pitch_joint", "right_knee_joint")
DEPLOY = """\
control_dt: 0.02
leg_joint2motor_idx: [0, 1, 2, 3]
joint2motor_idx: [0, 1, 2, 3, 4]
kps: [100, 150.5,
      200, 250]
kds: [2, 3, 4, 5]
default_angles: [0.1, 0.2, 0.1, 0.2]
"""
CPP = """\
#include <array>
constexpr int N = 4; // motors
struct MotorCommand { std::array<float, N> kp = {}; std::array<float, N> kd = {}; };
/* Stiffness: Kp{1, 2} was too soft */
const std::array<float, N> Kp{
    100, 150.5f,  // left
    2e2, 250.F    // right
};
float Kd[N] = {2, 3., 4, 5};
enum JointIndex { LeftHipPitch = 0, LeftKnee = 1, LeftKneeA = 1, RightHipPitch, RightKnee = 3 };
void send(Command& out) { for (int i = 0; i < N; ++i) { out.motor[i].kp = Kp[i]; out.motor[i].kd = Kd[i]; } }
"""
WANTED = ([100, 150.5, 200, 250], [2, 3, 4, 5])


def read(
    folder: Path, name: str, content: str | bytes, joints: tuple[str, ...] = JOINTS
) -> tuple[list[float], list[float], tuple[str, ...]]:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    found = gains_of(read_gains(path), joints)
    return found.kp.tolist(), found.kd.tolist(), found.notes


def refusal(folder: Path, name: str, content: str | bytes, joints: tuple[str, ...] = JOINTS) -> str:
    with pytest.raises(GainroomError) as caught:
        read(folder, name, content, joints)
    assert all(message.startswith(str(folder / name)) and "\n" not in message for message in caught.value.problems)
    return caught.value.problems[0].removeprefix(f"{folder / name}: ")


def varint(value: int) -> bytes:
    """Protobuf's encoding: seven bits per byte, the lowest first, the eighth says that more follow."""
    return bytes([value & 0x7F | 0x80]) + varint(value >> 7) if value > 0x7F else bytes([value])


def text_field(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def onnx(metadata: dict[str, str], graph: int = 5000) -> bytes:
    """A model: ir_version (1), a graph (7) of so many bytes, metadata_props (14), and domain (4)."""
    entries = [text_field(14, text_field(1, key.encode()) + text_field(2, value.encode())) for key, value in metadata.items()]
    return varint(1 << 3) + varint(300) + text_field(7, b"\xff" * graph) + b"".join(entries) + text_field(4, b"ai.onnx")


POLICY = {
    "run_path": "team/run",
    "joint_names": ",".join(JOINTS[::-1]),
    "joint_stiffness": "250.000,200.000,150.500,100.000",
    "joint_damping": "5.000,4.000,3.000,2.000",
    "default_joint_pos": "0.1,0.2,0.3,0.4",
}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("deploy.yaml", DEPLOY),
        ("deploy.yaml", "control:\n  " + DEPLOY.replace("\n", "\n  ")),
        ("gains.json", '{"KP": [100, 150.5, 200, 250], "KD": [2, 3, 4, 5]}'),
        ("gains.txt", "kp: 100 150.5 200 250\nkd: 2, 3, 4, 5\n"),
        ("gains.txt", "# by hand\nKp = [100, 150.5, 200, 250]\nKd = [2, 3, 4, 5]"),
        ("gains.py", "Kp = [100, 150.5] + [200, 250]\nKd = [2, 3, 4, 5]"),
    ],
)
def test_arrays_in_the_models_order(tmp_path: Path, name: str, content: str):
    kp, kd, notes = read(tmp_path, name, content)
    assert (kp, kd) == WANTED
    assert "the order is taken to be the model's (left_hip_pitch_joint, left_knee_joint" in notes[0]


def test_a_file_with_an_order_decides(tmp_path: Path):
    names = ", ".join(JOINTS[::-1])
    kp, kd, notes = read(tmp_path, "g.yaml", f"kps: [250, 200, 150.5, 100]\nkds: [5, 4, 3, 2]\njoint_names: [{names}]\n")
    assert ((kp, kd), notes) == (WANTED, ())
    assert read(tmp_path, "g.yaml", "kps: [7, 8]\nkds: [1, 2]\njoint_names: [right_knee, LeftKnee]")[0] == [0, 8, 0, 7]
    assert read(tmp_path, "g.yaml", "kps: [7, 8]\nkds: [1, 2]\njoint2motor_idx: [3, 1]")[0] == [0, 8, 0, 7]


def test_gains_by_place_go_by_the_order_of_the_models_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Pinocchio sorts the joints of one link by name: the right leg's gains went to the arm. `audit`, `export`, and places of motors."""
    parts = "".join(link(name, 1.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01)) for name in ("r", "l", "a"))
    write_robot(tmp_path, link("base") + parts, "".join(hinge(joint, "base", joint[0]) for joint in ("right", "left", "arm")))
    model, gains = str(tmp_path / "robot.urdf"), tmp_path / "gains.yaml"
    for text, wanted in (
        ("kps: [1, 2, 3]\nkds: [4, 5, 6]\n", {"right": 1, "left": 2, "arm": 3}),
        ("kps: [1, 2, 3]\nkds: [4, 5, 6]\njoint2motor_idx: [2, 0, 1]\n", {"arm": 1, "right": 2, "left": 3}),
        ("kps: [1, 2, 3]\nkds: [4, 5, 6]\njoint_names: [left, arm, right]\n", {"left": 1, "arm": 2, "right": 3}),
    ):
        gains.write_text(text, "utf-8")
        main(["audit", model, "--gains", str(gains), "--delay-ms", "1", "--rate-hz", "1000", "--motor-inertia", "0.1", "--json"])
        told = json.loads(capsys.readouterr().out)
        assert {joint["name"]: joint["kp"] for joint in told["joints"]} == wanted
        assert main(["export", str(gains), "--to", "yaml", "--model", model]) == 0
        exported = yaml.safe_load(capsys.readouterr().out.partition("gains:")[2])
        assert {name: each["kp"] for name, each in exported.items()} == wanted


def test_an_enumeration_in_c_names_the_joints(tmp_path: Path):
    kp, kd, notes = read(tmp_path, "control.cpp", CPP)
    assert ((kp, kd), notes) == (WANTED, ())
    swapped = CPP.replace("LeftHipPitch = 0", "LeftHipPitch = 2").replace(", RightHipPitch,", ", RightHipPitch = 0,")
    assert read(tmp_path, "control.cpp", swapped)[0] == [200, 150.5, 100, 250]


def test_the_map_of_unitree_rl_lab_is_no_order_of_its_gains(tmp_path: Path):
    """Its exporter writes stiffness and damping in the motors' order; joint_ids_map is for the policy's joints."""
    text = "joint_ids_map: [3, 1, 0, 2]\nstiffness: [100, 150.5, 200, 250]\ndamping: [2, 3, 4, 5]\n"
    assert read(tmp_path, "deploy.yaml", text)[:2] == WANTED


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("g.yaml", "kps: [1, 2, 3]\nkds: [1, 2, 3]", "kps and kds have 3 numbers, and the model has 4 joints: name theirs in joint_names"),
        ("g.yaml", "kps: [1, 2, 3, 4]\nkds: [1, 2, 3]", "kps has 4 numbers and kds 3; they must have one per joint"),
        ("g.yaml", "kps: [1, 2, 3, 4]", "an array of kd is missing: kd, kds, d_gains"),
        ("g.yaml", "kps: [1]\nKp: [1]\nkds: [1]", "holds more than one array of kp: kps, Kp"),
        ("g.yaml", "kps: [1, -2, 3, 4]\nkds: [1, 2, 3, 4]", "kps[1]: -2 must be >= 0"),
        ("g.yaml", "kps: [1, 2, a, 4]\nkds: [1, 2, 3, 4]", "kps[2]: 'a' is text and must be a number"),
        ("g.yaml", "kps: [1, 2, [3], 4]\nkds: [1, 2, 3, 4]", "kps[2]: [3] is not a number"),
        ("g.yaml", "a: {kps: [1], kds: [1]}\nb: {kps: [2], kds: [2]}", "holds gains in 2 places; name one, "),
        ("g.yaml", "kps: []\nkds: []", "kps: [] must be a list of one number per joint"),
        ("g.yaml", "kps: [1]\nkds: [1]\njoint_names: [elbow]", "joint_names: 'elbow' is no joint of the model"),
        ("g.yaml", "kps: [1, 2]\nkds: [1, 2]\njoint_names: [left_knee]", "joint_names has 1 entries and kps 2 numbers"),
        ("g.yaml", "kps: [1, 2]\nkds: [1, 2]\njoint_names: [LeftKnee, left_knee]", "entry 1 is joint 'left_knee_joint' once more"),
        ("g.yaml", "kps: [1, 2]\nkds: [1, 2]\njoint2motor_idx: [0, 9]", "joint2motor_idx: 9 must be below 4, the number of"),
        ("g.cpp", "int main() {}", "holds no array of kp"),
        ("g.cpp", "float Kp[] = {1, 2, x, 4};\nfloat Kd[] = {1, 2, 3, 4};", "line 1: Kp: 'x' must be a number, or a name in quotes"),
        ("g.cpp", "float Kp[] = {1};\n\nfloat Kp[] = {2};", "line 3: Kp is given twice, first in line 1"),
        ("g.cpp", "float Kp[] = {1, 2, 3, -4};\nfloat Kd[] = {1, 2, 3, 4};", "line 1: Kp[3]: -4.0 must be >= 0"),
        ("g.txt", "hello", "holds no array of kp"),
        ("g.cpp", "/*" * 200_000, "holds no array of kp"),
        ("g.cpp", "kp" + " " * 500_000, "holds no array of kp"),
        ("g.cpp", "kp{" * 200_000, "holds no array of kp"),
        ("g.cpp", "enum {" * 100_000, "holds no array of kp"),
        ("g.yaml", "moteus: {x: {kp: 1}}", "gains.'x' matches no joint"),
        ("g.yaml", "moteus: {left_knee_joint: {kp: -1}}", "moteus.left_knee_joint.kp: -1 must be >= 0"),
        ("g.yaml", "moteus: 3", "moteus: 3 must be a section"),
        ("dump.cfg", "servo.pid_position.kp x", "line 1: servo.pid_position.kp: 'x' must be a number"),
        ("dump.cfg", "servo.pid_position.kp 1\nservo.pid_position.kp 2", "line 2: servo.pid_position.kp: is given twice"),
        ("dump.cfg", "servo.pid_position.kd 1", "servo.pid_position.kp is missing: the gain on position [N·m/rev]"),
        ("dump.cfg", "servo.pid_position.kp nan", "line 1: servo.pid_position.kp: nan is not a number"),
        ("p.onnx", b"", "joint_names is missing in the metadata; it has none"),
        ("p.onnx", b"\x07\x00", "is no ONNX model, or not a whole one"),
        ("p.onnx", b"\xff" * 30, "is no ONNX model, or not a whole one"),
        ("p.onnx", onnx(POLICY)[:-3], "is no ONNX model, or not a whole one"),
        ("p.onnx", text_field(14, b"\x0a\x05ab"), "is no ONNX model, or not a whole one"),
        ("p.onnx", text_field(14, text_field(1, b"\xff")), "a text in the metadata is not UTF-8"),
        ("p.onnx", onnx({"a": "b"} ) + onnx({"a": "c"}), "'a' stands in the metadata twice"),
        ("p.onnx", varint(1 << 3) + varint(1) + text_field(14, b"x" * (2 << 20)), "holds more than 1048576 bytes of metadata"),
        ("p.onnx", b"\x08\x01" * 20_000, "has more than 10000 fields"),
        ("p.onnx", onnx({**POLICY, "joint_damping": "1,2"}), "joint_stiffness has 4 numbers and joint_damping 2"),
        ("p.onnx", onnx({**POLICY, "joint_damping": "1,2,3,x"}), "joint_damping: 'x' must be a number"),
        ("p.onnx", onnx({**POLICY, "joint_damping": "1,2,3,-4"}), "joint_damping[3]: -4.0 must be >= 0"),
        ("p.onnx", onnx({**POLICY, "joint_damping": "1,2,3,inf"}), "joint_damping[3]: inf must be <= 1e+12"),
        ("p.onnx", onnx({**POLICY, "joint_names": "a,b,c,d"}), "joint_names: 'a' is no joint of the model"),
    ],
    ids=lambda value: str(value)[:40],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, name: str, content: str | bytes, says: str):
    assert says in refusal(tmp_path, name, content)


def test_moteus_gains_are_per_revolution(tmp_path: Path):
    """1 N m per revolution is 1/(2π) N m/rad; the same of kd and ki, whose times are seconds already."""
    dump = "id.id 3\nservo.pid_position.kp 4.0\nservo.pid_position.ki 0\nservo.pid_position.kd 0.5\nservo.max_velocity 10\n"
    kp, kd, notes = read(tmp_path, "dump.cfg", dump)
    assert kp == pytest.approx([4 / (2 * math.pi)] * 4)
    assert kd == pytest.approx([0.5 / (2 * math.pi)] * 4)
    assert "is of one controller, and taken for every joint" in notes[0]
    kp, kd, notes = read(tmp_path, "gains.yaml", 'moteus: {".*": [1, 0.1], left_knee_joint: {kp: 2, kd: 0.2, motor_inertia: 0.01}}')
    assert kp == pytest.approx([each / (2 * math.pi) for each in (1, 2, 1, 1)])
    assert kd == pytest.approx([each / (2 * math.pi) for each in (0.1, 0.2, 0.1, 0.1)])
    assert notes == ()
    for name, content in (("ki.cfg", dump.replace("ki 0", "ki 3")), ("ki.yaml", "moteus: {.*: {kp: 4, ki: 3, kd: 0.5}}")):
        (tmp_path / name).write_text(content)
        assert read_gains(tmp_path / name).gains[".*"].ki == pytest.approx(3 / (2 * math.pi))


def test_a_policys_metadata(tmp_path: Path):
    assert read(tmp_path, "policy.onnx", onnx(POLICY)) == (*WANTED, ())
    coarse = onnx({**POLICY, "joint_damping": "5.000,4.000,3.000,0.004"})
    assert read(tmp_path, "policy.onnx", coarse)[2] == (
        f"{tmp_path / 'policy.onnx'}: gains are written with 3 decimals, which is coarse for left_hip_pitch_joint",
    )


def test_a_policy_of_any_size_is_passed_over(tmp_path: Path):
    """Four gigabytes of graph, none of it on the disk: only the metadata behind them are read."""
    path = tmp_path / "policy.onnx"
    size = 4 << 30
    with open(path, "wb") as stream:
        stream.write(varint(7 << 3 | 2) + varint(size))
        stream.seek(size, os.SEEK_CUR)
        stream.write(onnx(POLICY))
    assert gains_of(read_gains(path), JOINTS).kp.tolist() == WANTED[0]


@pytest.mark.parametrize("name", ["gains.yaml", "gains.py", "gains.txt", "gains.cpp", "gains.onnx", "gains.xml"])
def test_what_is_no_file_is_refused(tmp_path: Path, name: str):
    with pytest.raises(GainroomError, match="no such file"):
        read_gains(tmp_path / name)
    (tmp_path / name).mkdir()
    with pytest.raises(GainroomError, match="is a directory"):
        read_gains(tmp_path / name)


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS)
def test_mutated_files_are_read_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, random: Random):
    folder = tmp_path_factory.mktemp("mutated")
    files = {"g.yaml": DEPLOY.encode(), "g.cpp": CPP.encode(), "g.onnx": onnx(POLICY, 20), "g.txt": b"kp: 1 2\nkd: 1 2"}
    name = random.choice(list(files))
    problems = ()
    try:
        read(folder, name, mutated_bytes(random, files[name], (b"{", b"[", b"\xff", b"\n", b"1e999", b"\x0a")))
    except GainroomError as error:
        problems = error.problems
    assert all(message.startswith(str(folder / name)) and "\n" not in message for message in problems)
