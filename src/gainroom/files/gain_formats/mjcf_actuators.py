"""An MJCF's own actuators, as MuJoCo compiles them (read by robot/formats)."""

from pathlib import Path

from ...errors import GainroomError, first_of_many
from ...io.validation import checked
from ...io.yaml_text import shown
from ...robot.formats.model_files import position_gains
from .gain_record import NOT_NEGATIVE, Gain, GainFile


def read_mjcf(path: Path, text: str = "") -> GainFile:
    """Position and velocity feedback of an MJCF's actuators; the joints' own damping is passive and only noted."""
    found = position_gains(path, text)
    if not found.joints:
        raise GainroomError(
            f"{path}: holds no gains: no actuator feeds position back (a URDF has none; of an MJCF <position>, or <general> with affine "
            "bias, does); give --gains FILE, such as a gains.yaml with a line for each joint, JOINT: {kp: 100, kd: 5}"
        )
    gains = {}
    for joint, gain in found.joints.items():
        owner = f"{path}: actuator of joint {shown(joint)}"
        kp, kd, ki = (checked(f"{owner}: {name}", getattr(gain, name), NOT_NEGATIVE) for name in ("kp", "kd", "ki"))
        gains[joint] = Gain(kp, kd, ki, effort_limit=gain.effort_limit)
    notes = list(found.notes)
    undamped = [joint for joint, gain in gains.items() if gain.kd == 0]
    if undamped:
        notes.append(
            f"actuators without velocity feedback: {first_of_many(undamped)}; damping of the joint itself, where the model has any, is the "
            "controller's with --joint-damping controller alone; or give kv"
        )
    return GainFile(str(path), "MJCF", gains, notes=tuple(notes))
