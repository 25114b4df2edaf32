"""Reader of an MJCF's own actuators, as MuJoCo compiles them (robot/formats)."""

from functools import partial
from pathlib import Path
from typing import Any

from ...errors import GainroomError, all_of, first_of_many
from ...io.validation import checked
from ...io.yaml_text import shown
from ...robot.formats.model_files import position_gains
from .gain_record import NOT_NEGATIVE, Gain, GainFile

XML = (".xml", ".mjcf", ".urdf")


def read_mjcf(path: Path, text: str = "") -> GainFile:
    """Position and velocity feedback of an MJCF's actuators; the joints' own damping is passive and only noted."""
    found = position_gains(path, text)
    if not found.joints:
        raise GainroomError(
            f"{path}: holds no gains: no actuator feeds position back (a URDF has none; of an MJCF <position>, or <general> with affine "
            "bias, does); give --gains FILE, such as a gains.yaml with a line for each joint, JOINT: {kp: 100, kd: 5}"
        )

    def read(joint: str, gain: Any) -> Gain:
        owner = f"{path}: actuator of joint {shown(joint)}"
        terms = all_of(partial(checked, f"{owner}: {name}", getattr(gain, name), NOT_NEGATIVE) for name in ("kp", "kd", "ki"))
        return Gain(*terms, effort_limit=gain.effort_limit)

    gains = dict(zip(found.joints, all_of(partial(read, joint, gain) for joint, gain in found.joints.items()), strict=True))
    notes = list(found.notes)
    undamped = [joint for joint, gain in gains.items() if gain.kd == 0]
    if undamped:
        notes.append(
            f"actuators without velocity feedback: {first_of_many(undamped)}; damping of the joint itself, where the model has any, is the "
            "controller's with --joint-damping controller alone; or give kv"
        )
    return GainFile(str(path), "MJCF", gains, notes=tuple(notes))
