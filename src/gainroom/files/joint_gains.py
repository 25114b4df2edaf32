"""Gains of a joint.yaml for export: one joint, called as its file is, with the filters, the rate, the delay and the drive of its loop."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import GainroomError
from ..system.controller import PD, PID, type_of
from ..system.filters import FILTERS
from .gain_context import LOOP_KEYS
from .gain_formats.gain_record import Gain, GainFile, Origin
from .joint_yaml import parse_joint
from .typed_requirements import unusual_limits


def joint_gains(text: str, data: Mapping[str, Any], source: str) -> GainFile:
    """Gains in the `text` of a joint.yaml, whose sections are `data`. Raises GainroomError for other gains than those of a PD or PID."""
    system = parse_joint(text, source, two_paths=True)
    control, joint, given = system.control, system.source, data["control"]
    law = control.controller
    if type(law) not in (PD, PID):
        raise GainroomError(f"{source}: control.type: {type_of(law)} has other gains than this form holds; c and markdown hold any type")
    if control.feedback.mixed:
        raise GainroomError(f"{source}: control.feedback: this form holds gains on one encoder; c and markdown hold both")
    gains: dict[str, Any] = {name: float(getattr(law, name)) for name in law.gain_names()}
    parts = {name: float(getattr(joint, name)) for name in ("motor_inertia", "stiffness", "damping", "link_viscous", "motor_viscous")}
    known: dict[str, Any] = {name: value for name, value in parts.items() if value}
    place = {} if control.kd_path is None else {
        "gains_run": "split",
        "drive_rate_hz": 1 / control.kd_path.sample_time,
        "drive_delay_ms": 1e3 * control.kd_path.delay,
    }  # fmt: skip
    kept = {name: given[name] for name in FILTERS if given.get(name)} | ({} if control.feedback.motor else {"feedback": "link"})
    (drive,) = system.drives
    loop = {key: getattr(drive, key) for key in LOOP_KEYS if math.isfinite(drive.bandwidth)}
    origin = Origin(
        delay_ms=1e3 * system.delay,
        sample_rate_hz=None if control.sample_time is None else 1 / control.sample_time,
        margins="gainroom joint computes them",
        required=unusual_limits(system.requirements),
        system={name: section for name, section in {"control": kept, "drive": loop}.items() if section},
        **place,
    )
    return GainFile(source, "joint.yaml", {Path(source).stem: Gain(**gains, **known)}, origin=origin)
