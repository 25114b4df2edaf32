"""Small robot.yamls: an arm of two links that hangs in the vertical plane, and Solo12 on point feet."""

from dataclasses import replace
from pathlib import Path

from robot_truths import hinge, link, write_robot

ROBOT = """\
model: {file: robot.urdf, base: fixed}
joints:
  default: {motor_inertia: 0.5, stiffness: 8000.0, damping: 4.0}
drive: {bandwidth: 4000.0, delay_ms: 2.0}
postures: {bent: {shoulder: 0.4, elbow: 0.9}}
control: {type: pd, feedback: motor, sample_rate_hz: 2000, kp: 400.0, kd: 30.0}
tasks:
  - {name: com, type: com, kp: 100.0, kd: 10.0}
  - {name: rest, type: posture, kp: 100.0, kd: 10.0}
"""
SOLO = """\
model: {package: example-robot-data, file: solo12.urdf, base: floating}
joints: {default: {rotor_inertia: 4.0e-6, gear_ratio: 9, stiffness: 300, damping: 0.05}}
drive: {bandwidth: 3000, damping_ratio: 0.9, delay_ms: 1.0}
postures: {stand: {"F._HFE": 0.8, "F._KFE": -1.6, "H._HFE": -0.8, "H._KFE": 1.6}}
contacts: {all: [FEET]}
control: {type: pd, space: joint, feedback: motor, sample_rate_hz: 1000, kp: 3.0, kd: 0.1}
scenario: {duration: 1.0, friction: {coulomb: 0.05, viscous: 0.01}, torque_limit: 2.7, ground: {friction: 0.3}}
""".replace("FEET", ", ".join(f"{{frame: {leg}_FOOT, type: point}}" for leg in ("FL", "FR", "HL", "HR")))


def written(folder: Path, text: str) -> Path:
    """As robot.yaml."""
    path = folder / "robot.yaml"
    path.write_text(text, "utf-8")
    return path


def changed(state, **numbers):
    """A state of a study with some of its numbers, and what they are made from, as they are given here."""
    other = replace(state)
    vars(other).update(numbers)
    return other


def write_arm(folder: Path, text: str = ROBOT) -> Path:
    """`text` beside the arm's links."""
    upper, lower = (link(name, 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01)) for name in ("upper", "lower"))
    joints = hinge("shoulder", "root", "upper") + hinge("elbow", "upper", "lower", at=(0.0, 0.0, -0.4))
    write_robot(folder, link("root") + upper + lower, joints)
    path = folder / "robot.yaml"
    path.write_text(text, "utf-8")
    return path
