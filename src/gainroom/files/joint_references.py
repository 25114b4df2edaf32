"""Joints of a robot.yaml that refer to a joint.yaml beside it: `knee: {file: knee.yaml}`, with its intervals.

Motor inertia, gearbox and drive come from there; the link's inertia is the model's, in every posture. A file of the user's own folder is
read and no other: no absolute path, no way up, no link that leads out.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, first_of_many, listed
from ..io.yaml_text import shown
from ..system.actuator_entry import ActuatorEntry
from ..system.elastic_joint import ElasticJoint
from ..system.system import System
from ..system.uncertainty import Uncertainty

IN_ACTUATORS = ("delay", "stiffness", "motor_inertia", "damping")
"""Quantities of a joint's uncertainty that a robot's actuators may have."""


def entry_of_file(name: str, folder: Path, owner: str) -> ActuatorEntry:
    """Actuator entry with intervals from the joint.yaml `name` in `folder`. Raises GainroomError that names `owner`, or the file."""
    from .joint_yaml import load_joint  # few robots refer to one

    path = folder / name
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a loop of links, a name that cannot be one
        inside = False
    if Path(name).is_absolute() or ".." in Path(name).parts or not inside:
        raise GainroomError(f"{owner}: {shown(name)} must be in the folder of the robot.yaml, or below")
    system: System[ElasticJoint] = load_joint(path)  # type: ignore[assignment] - a joint.yaml describes a joint
    joint, drive = system.source, system.drives[0]
    if not math.isfinite(joint.stiffness):
        raise GainroomError(f"{owner}: {shown(name)} is a rigid joint, of which the motor's inertia is not known; give motor_inertia here")
    ranges = {key: getattr(system.uncertainty, key) for key in IN_ACTUATORS}
    return ActuatorEntry(
        motor_inertia=joint.motor_inertia,
        stiffness=joint.stiffness,
        damping=joint.damping,
        motor_viscous=joint.motor_viscous,
        link_viscous=joint.link_viscous,
        bandwidth=drive.bandwidth,
        damping_ratio=drive.damping_ratio,
        delay=drive.delay,
        ranges={key: (float(pair[0]), float(pair[1])) for key, pair in ranges.items() if pair is not None},
    )


def with_ranges(
    given: Uncertainty, entries: Sequence[ActuatorEntry], nominal: Mapping[str, ArrayLike], names: Sequence[str]
) -> tuple[Uncertainty, tuple[str, ...]]:
    """Ranges of the robot: `given`, replaced by their own intervals for joints with a file; and notes about the assumptions.

    nominal   by name, (n,): of joints of which nothing is given
    """
    found = {name: getattr(given, name) for name in Uncertainty.__dataclass_fields__}
    for name in IN_ACTUATORS:
        if not any(name in entry.ranges for entry in entries):
            continue
        low, high = (np.array(end, dtype=float) for end in (found[name] or (nominal[name], nominal[name])))
        for index, entry in enumerate(entries):
            if name in entry.ranges:
                low[index], high[index] = entry.ranges[name]
        found[name] = low, high
    own = [name for name, entry in zip(names, entries, strict=True) if entry.ranges]
    if not own:
        return given, ()
    together = "; joints vary together, and each by itself in a few draws" if len(own) > 1 else ""
    whose = {
        "the figures of their actuators" if entry.ranges.keys() <= entry.published else "their own files"
        for entry in entries
        if entry.ranges
    }
    return Uncertainty(**found), (f"the intervals of {first_of_many(own)} are those of {listed(sorted(whose))}{together}",)
