"""Inputs about robots: robot.yamls of small robots and public ones, gains of public robots in the forms that people have, hostile ones."""

from typing import Any

import yaml

from robot_files import SOLO
from robot_truths import hinge, link

DRIVE = {"bandwidth": 4000.0, "damping_ratio": 0.9, "delay_ms": 2.0}
LIMITS = {"gain_margin_db": 6.0, "phase_margin_deg": 30.0, "peak_sensitivity": 2.0}
BIPED = {"package": "gainroom", "file": "biped.urdf", "base": "floating"}
GEARBOX = {"rotor_inertia": 1.0e-4, "gear_ratio": 100, "stiffness": 1e4, "damping": 1.0}
STAND = {"stand": {".*_hip_pitch": -0.3, ".*_knee": 0.6, ".*_ankle_pitch": -0.3}}
PD = {"type": "pd", "feedback": "motor", "sample_rate_hz": 2000}
TALOS_LEG = {
    "leg_left_1_joint": (5000.0, 60.0),
    "leg_left_2_joint": (5000.0, 60.0),
    "leg_left_3_joint": (5000.0, 60.0),
    "leg_left_4_joint": (5500.0, 70.0),
    "leg_left_5_joint": (4000.0, 40.0),
    "leg_left_6_joint": (4000.0, 40.0),
}
PANDA = dict(zip([f"panda_joint{k}" for k in range(1, 8)], [0.6057, 0.6057, 0.4625, 0.4625, 0.2055, 0.2055, 0.2055], strict=True))


def robot_file(model: dict, joints: dict, control: dict, **sections: Any) -> str:
    control = {key: value for key, value in (PD | control).items() if value is not None}
    whole = {"model": model, "joints": joints, "drive": DRIVE, **sections, "control": control}
    return yaml.safe_dump({"limits": LIMITS} | whole, sort_keys=False)


def biped_file(control: dict, **sections: Any) -> str:
    """The shipped biped on its left foot, or as `sections` say."""
    return robot_file(BIPED, {"default": GEARBOX}, control, **{"postures": STAND, "contacts": {"left": ["left_sole"]}} | sections)


def arm_file(control: dict, joints: dict | None = None, **sections: Any) -> str:
    """An arm of two links beside its URDF."""
    actuators = {"motor_inertia": 0.5, "stiffness": 8000.0, "damping": 4.0}
    postures = {"postures": {"bent": {"shoulder": 0.4, "elbow": 0.9}}}
    return robot_file({"file": "arm.urdf", "base": "fixed"}, joints or {"default": actuators}, control, **postures | sections)


def arm_urdf() -> str:
    links = "".join(link(name, 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01)) for name in ("upper", "lower"))
    joints = hinge("shoulder", "root", "upper") + hinge("elbow", "upper", "lower", at=(0.0, 0.0, -0.4))
    return f'<robot name="small">{link("root")}{links}{joints}</robot>'


def panda_file() -> str:
    joints = {name: {"motor_inertia": inertia, "stiffness": 1e4, "damping": 5.0} for name, inertia in PANDA.items()}
    model = {"package": "example-robot-data", "file": "panda.urdf", "base": "fixed"}
    control = {"sample_rate_hz": 1000, "kp": {"default": 600.0}, "kd": {"default": 30.0}}
    return robot_file(model, {**joints, "locked": ["panda_finger.*"]}, control, postures={"reach": {"panda_joint4": -1.5}})


def talos_file() -> str:
    """Its left leg on the ground, all else locked."""
    gearbox = {"motor_inertia": 2.0, "stiffness": 2e4, "damping": 20.0}
    gains = ({name: pair[k] for name, pair in TALOS_LEG.items()} for k in range(2))
    control = dict(zip(("kp", "kd"), gains, strict=True)) | {"sample_rate_hz": 1000}
    joints = {"default": gearbox, "locked": ["(?!leg_left).*"]}
    model = {"package": "example-robot-data", "file": "talos_reduced.urdf", "base": "floating"}
    return robot_file(model, joints, control, contacts={"left": ["left_sole_link"]})


MOVE = {"posture": "stand", "contact": "left", "duration": 0.3, "move": {"task": "com", "by": 0.01, "duration": 0.2}}
TASKS = [
    {"name": "com", "type": "com", "kp": [50, 90, 200], "kd": [1, 5, 15]},
    {"name": "pelvis", "type": "orientation", "frame": "pelvis", "kp": 100, "kd": 20},
]
GOOD = {
    "arm.urdf": arm_urdf(),
    "arm.yaml": arm_file({"kp": 400.0, "kd": 30.0}),
    "arm_unstable.yaml": arm_file({"kp": 400.0, "kd": 700.0}),
    "arm_no_rate.yaml": arm_file({"kp": 400.0, "kd": 30.0, "sample_rate_hz": None}),
    "arm_uncertain.yaml": arm_file({"kp": 1500.0, "kd": 150.0}, uncertainty={"delay_ms": [2.0, 5.0], "stiffness": "30%"}),
    "arm_pid.yaml": arm_file({"type": "pid", "kp": 400.0, "ki": 200.0, "kd": 30.0}),
    "arm_ppi.yaml": arm_file({"type": "ppi", "kp": 15.0, "kv": 30.0, "ki": 20.0}),
    "arm_rigid.yaml": arm_file({"kp": 400.0, "kd": 30.0}, {"default": {"motor_inertia": 0.5}}),
    "arm_two_paths.yaml": arm_file(
        {"kp": 400.0, "kd": 30.0, "sample_rate_hz": 500, "kd_path": {"delay_ms": 0.2, "sample_rate_hz": 5000}},
        limits={"gain_margin_db": 6.0},
    ),
    "biped_left.yaml": biped_file({"kp": 2000.0, "kd": 100.0}),
    "biped_task.yaml": biped_file({"space": "task"}, tasks=TASKS, scenario=MOVE),
    "biped_stands.yaml": biped_file({"kp": 6000.0, "kd": 200.0}, scenario={"duration": 0.3, "ground": True}),
    "biped_falls.yaml": biped_file({"kp": 60.0, "kd": 4.0}, scenario={"duration": 1.0, "ground": True}),
    "solo.yaml": SOLO.replace("duration: 1.0", "duration: 0.3"),
    "panda.yaml": panda_file(),
    "talos_leg.yaml": talos_file(),
}
"""Robots by file name."""

OMEGA = 20 * 3.141592653589793
G1_ARMATURE = {".*_(hip_pitch|hip_yaw)_joint": 0.010177520, ".*_(hip_roll|knee)_joint": 0.025101925, ".*_ankle_.*_joint": 0.00721945}
G1 = "".join(
    f"L{index} = BuiltinPositionActuatorCfg(target_names_expr=({pattern!r},), stiffness={inertia * OMEGA**2!r}, "
    f"damping={4 * inertia * OMEGA!r}, armature={inertia!r})\n"
    for index, (pattern, inertia) in enumerate(G1_ARMATURE.items())
)
GO2 = (
    "UNITREE_GO2_CFG = ArticulationCfg(actuators={'base_legs': DCMotorCfg(joint_names_expr=['.*_hip_joint', '.*_thigh_joint',"
    " '.*_calf_joint'], effort_limit=23.5, saturation_effort=23.5, velocity_limit=30.0, stiffness=25.0, damping=0.5, armature=0.02)})\n"
)
TALOS = {
    "controller_manager": {"ros__parameters": {"update_rate": 1000}},
    "legs": {
        "ros__parameters": {
            "joints": [*TALOS_LEG],
            "command_interfaces": ["effort"],
            "gains": {name: {"p": kp, "i": 0.0, "d": kd} for name, (kp, kd) in TALOS_LEG.items()},
        }
    },
}
GO1_ORDER = [f"{leg}_{joint}_joint" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]
GAINS = {
    "g1_constants.py": G1,
    "go2.py": GO2,
    "go1.yaml": yaml.safe_dump({"kps": [35.0] * 12, "kds": [0.7] * 12, "joint_names": GO1_ORDER}),
    "talos_controllers.yaml": yaml.safe_dump(TALOS),
    "panda_gains.yaml": yaml.safe_dump({"gains": {name: {"kp": 600.0, "kd": 30.0, "motor_inertia": j} for name, j in PANDA.items()}}),
    "leg_soft.yaml": "gains: {default: {kp: 20.0, kd: 1.5}}\n",
    "leg_hard.yaml": "gains: {default: {kp: 2000.0, kd: 60.0}}\n",
    "leg_part.yaml": "gains: {hip_.*: {kp: 20.0, kd: 1.5}}\n",
}
"""Gains that robots have, by file name."""

HOSTILE = {
    "unknown_joint.yaml": arm_file({"kp": {"wrist": 400.0}, "kd": 30.0}),
    "unknown_frame.yaml": arm_file({"kp": 400.0, "kd": 30.0}, contacts={"on": ["left_foot"]}),
    "no_model.yaml": arm_file({"kp": 400.0, "kd": 30.0}).replace("arm.urdf", "gone.urdf"),
    "robot_bad_key.yaml": arm_file({"kp": 400.0, "kd": 30.0, "gian": 1.0}),
    "robot_nan.yaml": arm_file({"kp": float("nan"), "kd": 30.0}),
    "damaged.urdf": arm_urdf()[:200],
    "nan.urdf": arm_urdf().replace('mass value="4.0"', 'mass value="nan"', 1),
    "grams.urdf": arm_urdf().replace('mass value="4.0"', 'mass value="4000.0"'),
    "gains_bad_key.yaml": "gains: {default: {kp: 20.0, kdd: 1.5}}\n",
    "gains_nan.yaml": "gains: {default: {kp: .nan, kd: 1.5}}\n",
    "gains_no_joint.yaml": "gains: {wrist: {kp: 20.0, kd: 1.5}}\n",
    "gains_damaged.py": "LEGS = SomeCfg(joint_names_expr=['.*'], stiffness=tuned(), damping=2.0)\n",
    "gains_damaged.yaml": "gains: {default: {kp: 20.0, kd\n",
}
"""What is refused, or not judged, by file name."""
