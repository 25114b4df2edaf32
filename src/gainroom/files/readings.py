"""Ambiguities of a model and its gains: each reading is the same robot with an option that nobody gave.

- Actuators without velocity feedback (MJCF: kv = 0) on joints with damping of their own: that damping is the controller's kd in some
  training models, friction of the joint in others.
- Where kp and kd run, for robots and actuators whose motor drives take kp and kd with every command: on the host, with all of the delay in
  the loop, or in the drives.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import listed
from ..robot.formats.model_names import locate
from ..robot.formats.xml_text import read_xml
from .actuator_facts import actuators
from .audit_options import Audited, audited, named_actuators
from .gain_files import read_gains


@dataclass(frozen=True)
class Reading:
    """Reading: one way to interpret what was not given.

    option    that says so, as it is typed
    meaning   in a few words
    asked     the robot so read
    """

    option: str
    meaning: str
    asked: Audited


@dataclass(frozen=True)
class DriveFamily:
    """Family of robots whose drives take kp, kd and set-points with every command, so that PD may run there.

    names    a pattern of words of the model's name, its file's or its folder's
    joints   a pattern that some joint's name must match where the word alone says little
    source   of that
    """

    title: str
    names: str
    joints: str
    source: str


SDK2 = "unitree_sdk2: LowCmd.motor_cmd has q, dq, tau, kp and kd of each motor"
LEGGED_SDK = "unitree_legged_sdk: LowCmd.motorCmd has q, dq, tau, Kp and Kd of each motor"
BOOSTER_SDK = "booster_robotics_sdk: LowCmd.motor_cmd has q, dq, tau, kp and kd of each motor"
CHEETAH = "Katz 2018, A low cost modular actuator for dynamic robots: position, velocity, kp, kd and torque by CAN, PD in the drive"
MOTEUS = "moteus"
"""Name of the family, and of the format of gains of such a drive."""
FAMILIES = (
    DriveFamily("Unitree", "unitree", ".*", f"{SDK2}; {LEGGED_SDK}"),
    DriveFamily("Unitree", "a1|aliengo|b1|b2|go1|go2|laikago", "(F|R)(L|R)_(hip|thigh|calf)(_joint)?", LEGGED_SDK),
    DriveFamily("Unitree", "g1|h1|r1", "left_hip_(pitch|roll|yaw)_joint", SDK2),
    DriveFamily("Booster", "booster", ".*", BOOSTER_SDK),
    DriveFamily("Booster", "t1|k1", "Left_Hip_(Pitch|Roll|Yaw)", BOOSTER_SDK),
    DriveFamily(MOTEUS, MOTEUS, ".*", "moteus' reference: position mode computes kp, ki and kd in the drive, at 30 kHz by default"),
    DriveFamily("MIT Mini Cheetah", "mini ?cheetah", ".*", CHEETAH),
)
"""Families known by their makers' interfaces. A program may still compute torques on the host and send those."""
HOST = ("--gains-run host", "the program computes the torques and sends them")
"""Reading of the audit itself, if the location of kp and kd is not given."""
DRIVE_RATE_HZ, DRIVE_DELAY_MS = 1000.0, 1.0
"""Rate [Hz] and delay [ms] assumed for a drive's own loop: slower than any published (30 kHz of moteus, 40 kHz of the Mini Cheetah)."""


def damping_readings(model: str, gains: Path | None, found: Audited) -> tuple[Reading, ...]:
    """Readings of the joints' own damping, two of them; () if it was given, or if every actuator has kd of its own."""
    options = found.options
    if options.joint_damping is not None:
        return ()
    bare = undamped(found)
    if not bare:
        return ()
    whose = f"the damping of {listed(bare, most=2)} in the model"
    meanings = {"controller": f"{whose} is the controller's kd", "friction": f"{whose} is friction"}
    return tuple(
        Reading(f"--joint-damping {what}", meaning, audited(model, gains, replace(options, joint_damping=what)))
        for what, meaning in meanings.items()
    )


def undamped(found: Audited) -> list[str]:
    """Joints with kp, without kd, and with damping of their own."""
    source, controller = found.system.source, found.system.control.controller
    kp, kd = (np.broadcast_to(getattr(controller, name), len(source.joint_names)) for name in ("kp", "kd"))
    bare = (kp > 0) & (kd == 0) & (source.body.damping > 0)
    return [name for name, one in zip(source.joint_names, bare.tolist(), strict=True) if one]


def drive_reading(model: str, gains: Path | None, found: Audited) -> Reading | None:
    """Reading with kp and kd in the drives, at the rate DRIVE_RATE_HZ; None if the location was given, or no drive is known."""
    options = found.options
    if options.gains_run is not None or not (family_of(model, gains) or in_actuators(found)):
        return None
    there = replace(options, gains_run="drive", rate_hz=None, drive_rate_hz=DRIVE_RATE_HZ, drive_delay_ms=DRIVE_DELAY_MS)
    option = f"--gains-run drive --drive-rate-hz {DRIVE_RATE_HZ:g} --drive-delay-ms {DRIVE_DELAY_MS:g}"
    meaning = "the motor drives compute the torques, from target positions, kp and kd that the program sends"
    return Reading(option, meaning, audited(model, gains, there))


def in_actuators(found: Audited) -> bool:
    """True if joints have named actuators, and each of these takes kp and kd by what is published of it."""
    return {actuators()[name].word("gains_run") for name in named_actuators(found.sections).values()} == {"drive"}


def family_of(model: str, gains: Path | None = None) -> DriveFamily | None:
    """Family of drives of a model, in a file or under a name of robot_descriptions, or of a file of gains that is a drive's own."""
    if gains is not None and read_gains(gains).form == MOTEUS:
        return next(one for one in FAMILIES if one.title == MOTEUS)
    path = locate(model)
    root = read_xml(path)
    named = " ".join([root.get("name", ""), root.get("model", ""), path.stem, path.parent.name]).lower()
    words = f" {re.sub('[^a-z0-9]+', ' ', named)} "
    joints = [joint.get("name", "") for joint in root.iter("joint")]
    known = (one for one in FAMILIES if re.search(f" ({one.names}) ", words))
    return next((one for one in known if any(re.fullmatch(one.joints, joint) for joint in joints)), None)
