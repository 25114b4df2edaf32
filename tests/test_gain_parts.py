"""Arrays of gains for parts of one robot, beside each other in a file: all that name their joints count, and none is passed over."""

import textwrap
from pathlib import Path

import pytest

from gainroom.errors import GainroomError
from gainroom.files.gain_files import JointGains, gains_of, read_gains

LEGS = ("l_hip", "l_knee", "r_hip", "r_knee")
JOINTS = (*LEGS, "waist", "l_arm", "r_arm")
DEPLOY = """\
leg_joint2motor_idx: [0, 1, 2, 3]
kps: [100, 150, 101, 151]
kds: [2, 3, 2, 3]
arm_waist_joint2motor_idx: [4, 6, 5]
arm_waist_kps: [300, 50, 60]
arm_waist_kds: [6, 1, 2]
arm_waist_target: [0, 0, 0]
stiffness_range: [0.9, 1.1]
damping_range: [0.9, 1.1]
rand_kp: [0.8, 1.2]
rand_kd: [0.8, 1.2]
"""


def read(folder: Path, text: str, joints: tuple[str, ...] = JOINTS, name: str = "g.yaml") -> JointGains:
    path = folder / name
    path.write_text(text, "utf-8")
    return gains_of(read_gains(path), joints)


def test_every_part_counts(tmp_path: Path):
    found = read(tmp_path, DEPLOY)
    assert found.kp.tolist() == [100, 150, 101, 151, 300, 60, 50]
    assert found.kd.tolist() == [2, 3, 2, 3, 6, 2, 1]


def test_a_part_that_the_model_does_not_have_is_told(tmp_path: Path):
    """As where a policy moves the legs alone, on a model of the legs."""
    found = read(tmp_path, DEPLOY, LEGS)
    assert found.kp.tolist() == [100, 150, 101, 151]
    assert "arm_waist_kps and arm_waist_kds are of joints that the model does not have, and do not count" in found.notes[-1]


NAMED = {
    "g.yaml": """
        kp: [1, 2]
        kd: [1, 1]
        joint_names: [l_hip, l_knee]
        kp_arms: [5, 6]
        kd_arms: [1, 1]
        joint_names_arms: [r_arm, l_arm]""",
    "g.json": """
        {"KP": [1, 2], "KD": [1, 1], "joints": ["l_hip", "l_knee"],
         "arm_KP": [6, 5], "arm_KD": [1, 1], "arm_joints": ["l_arm", "r_arm"]}""",
    "g.py": """
        KP = [1, 2]
        KD = [1, 1]
        JOINTS = ["l_hip", "l_knee"]
        ARM_KP = KP[:0] + [6, 5]
        ARM_KD = [1] * 2
        ARM_JOINTS = ["l_arm", "r_arm"]""",
    "g.hpp": """
        float kp[2] = {1, 2.f};
        float kd[] = {1, 1};
        std::vector<std::string> joint_names{"l_hip", "l_knee"};
        float arm_kp[2] = {6, 5}; float arm_kd[2] = {1, 1};
        std::vector<std::string> arm_joint_names = {"l_arm", "r_arm"};""",
}


@pytest.mark.parametrize("name", NAMED)
def test_parts_with_names_in_every_language(tmp_path: Path, name: str):
    found = read(tmp_path, textwrap.dedent(NAMED[name]), name=name)
    assert found.kp.tolist() == [1, 2, 0, 0, 0, 6, 5]


C = "float kp[1] = {1}; float kd[1] = {1}; float arm_kp[1] = {2}; float arm_kd[1] = {2};"


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("g.yaml", DEPLOY.replace("arm_waist_joint2motor_idx", "x"), "arm_waist_kps and arm_waist_kds are gains of further joints"),
        ("g.yaml", DEPLOY.replace("leg_joint2motor_idx", "legs"), "are of different joints, and nothing names those of the first"),
        ("g.yaml", DEPLOY.replace("[4, 6, 5]", "[4, 3, 5]"), "arm_waist_joint2motor_idx: entry 1 is joint 'r_knee' once more"),
        ("g.yaml", DEPLOY.replace("[4, 6, 5]", "[4, 7, 5]"), "arm_waist_joint2motor_idx: 7 must be below 7, the number of"),
        ("g.yaml", DEPLOY.replace("[300, 50, 60]", "[300, x, 60]"), "arm_waist_kps[1]: 'x' is text and must be a number"),
        ("g.yaml", DEPLOY.replace("[6, 1, 2]", "[6, 1]"), "arm_waist_kps has 3 numbers and arm_waist_kds 2"),
        ("g.cpp", C, "arm_kp and arm_kd are gains of further"),
        ("g.cpp", C.replace("{2}", "{K}", 1), "line 1: arm_kp: 'K' must be a number"),
        ("g.py", "from other import tune\nclass C:\n    kps = [1]\n    kds = [1]\ntune(C)", "line 5: kps: 'tune(C)' is not run"),
        ("g.py", "class C:\n    kps = [1]\n    kds = [1]\nsetattr(C, NAME, 3)", "line 4: kps: 'setattr(C, NAME, 3)' is not"),
        ("g.txt", "kp: 1 2\nkd: 1 1\narm_kp: 3\narm_kd: 3", "arm_kp and arm_kd are gains of further joints, and nothing names these"),
    ],
)
def test_a_part_whose_joints_are_not_known_is_refused(tmp_path: Path, name: str, text: str, says: str):
    with pytest.raises(GainroomError) as caught:
        read(tmp_path, text, name=name)
    assert says in str(caught.value)
