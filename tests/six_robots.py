"""Six robots with gains: an arm of two hinges, a biped on one foot, a Panda, a leg of TALOS, a G1 on one foot, a Go1."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robot_files import write_arm

OMEGA = 20 * math.pi
BIPED_JOINTS = [
    f"{side}_{joint}" for side in ("left", "right") for joint in ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
]
G1_INERTIA = {"hip_pitch": 0.01017752, "hip_roll": 0.025101925, "hip_yaw": 0.01017752, "knee": 0.025101925}
G1_INERTIA |= {"ankle_pitch": 0.00721945, "ankle_roll": 0.00721945}
PANDA_INERTIA = (0.6057, 0.6057, 0.4625, 0.4625, 0.2055, 0.2055, 0.2055)
G1 = {
    f"{side}_{joint}_joint": {"kp": inertia * OMEGA**2, "kd": 4 * inertia * OMEGA, "motor_inertia": inertia}
    for side in ("left", "right")
    for joint, inertia in G1_INERTIA.items()
}
TALOS_GAINS = ((5000, 60), (5000, 60), (5000, 60), (5500, 70), (4000, 40), (4000, 40))
PUBLIC = "example-robot-data:"


@dataclass(frozen=True)
class Audited:
    """A model as it is typed, the options of its audit, gains by joint as a plain file has them, joints that can bend, and how stiff."""

    model: str
    options: tuple[str, ...]
    gains: dict[str, dict[str, float]]
    bends: tuple[str, float]
    stiffness: tuple[str, str]


ROBOTS = {
    "arm": Audited(
        "robot.urdf",
        ("--delay-ms", "2", "--base", "fixed"),
        {name: {"kp": 400.0, "kd": 30.0, "motor_inertia": 0.5} for name in ("shoulder", "elbow")},
        ("elbow", 0.9),
        ("8000", "4"),
    ),
    "biped": Audited(
        "gainroom:biped.urdf",
        ("--delay-ms", "2", "--contact", "left_sole"),
        {name: {"kp": 2000.0, "kd": 100.0, "motor_inertia": 0.6} for name in BIPED_JOINTS},
        (".*_knee", 0.6),
        ("20000", "20"),
    ),
    "panda": Audited(
        f"{PUBLIC}panda.urdf",
        ("--delay-ms", "2"),
        {f"panda_joint{k + 1}": {"kp": 600.0, "kd": 30.0, "motor_inertia": inertia} for k, inertia in enumerate(PANDA_INERTIA)},
        ("panda_joint4", -1.5),
        ("10000", "5"),
    ),
    "talos": Audited(
        f"{PUBLIC}talos_reduced.urdf",
        ("--delay-ms", "3", "--contact", "left_sole_link"),
        {f"leg_left_{k + 1}_joint": {"kp": kp, "kd": kd, "motor_inertia": 2.0} for k, (kp, kd) in enumerate(TALOS_GAINS)},
        ("leg_left_4_joint", 0.8),
        ("20000", "20"),
    ),
    "g1": Audited(
        f"{PUBLIC}g1_29dof_rev_1_0.urdf",
        ("--delay-ms", "3", "--base", "floating", "--contact", "left_ankle_roll_link"),
        G1,
        (".*_knee_joint", 0.5),
        ("2000", "1"),
    ),
    "go1": Audited(
        f"{PUBLIC}go1.urdf",
        ("--delay-ms", "2", "--base", "floating"),
        {
            f"{leg}_{joint}_joint": {"kp": 35.0, "kd": 0.7, "motor_inertia": 0.01}
            for leg in ("FR", "FL", "RR", "RL")
            for joint in ("hip", "thigh", "calf")
        },
        (".*_calf_joint", -1.5),
        ("1500", "0.5"),
    ),
}
Told = Callable[..., dict]


def asked(folder: Path, name: str, factor: float = 1.0) -> list[str]:
    """The call of an audit of a robot's gains times a factor, from a file of gains in the folder, in which it runs."""
    robot = ROBOTS[name]
    if name == "arm":
        write_arm(folder)
    gains = {joint: {**own, "kp": factor * own["kp"], "kd": factor * own["kd"]} for joint, own in robot.gains.items()}
    (folder / "gains.json").write_text(json.dumps({"gains": gains}), "utf-8")
    return ["audit", robot.model, *robot.options, "--gains-run", "host"]


def as_mjcf(folder: Path, name: str) -> str:
    """A robot's links as an MJCF without gains, by MuJoCo's own reader of URDF; the base is fixed."""
    import re

    import mujoco

    from gainroom.robot.formats.model_names import locate

    text = locate(ROBOTS[name].model).read_text("utf-8")
    for part in ("visual", "collision", "transmission", "gazebo", "mimic"):
        text = re.sub(rf"<{part}\b[^>]*?/>|<{part}\b.*?</{part}>", "", text, flags=re.DOTALL)
    text = re.sub(r"<mujoco>.*?</mujoco>", "", text, flags=re.DOTALL)
    compiler = '<mujoco><compiler boundmass="1e-6" boundinertia="1e-9" balanceinertia="true" fusestatic="false"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(re.sub(r"(<robot\b[^>]*>)", rf"\1{compiler}", text, count=1))
    mujoco.mj_saveLastXML(str(folder / "model.xml"), model)
    return "model.xml"
