"""A small robot.yaml: an arm of two links that hangs in the vertical plane."""

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


def write_arm(folder: Path, text: str = ROBOT) -> Path:
    """`text` beside the arm's links."""
    upper, lower = (link(name, 4.0, (0.0, 0.0, -0.2), (0.06, 0.06, 0.01)) for name in ("upper", "lower"))
    joints = hinge("shoulder", "root", "upper") + hinge("elbow", "upper", "lower", at=(0.0, 0.0, -0.4))
    write_robot(folder, link("root") + upper + lower, joints)
    path = folder / "robot.yaml"
    path.write_text(text, "utf-8")
    return path
