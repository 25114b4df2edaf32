"""Context of gains: the properties of a robot on which the verdict about gains depends, other than its joints' own numbers.

It has the form of a robot.yaml's sections and is stored with the gains, so that the next command judges the same robot: base, payload and
weight; encoders and filters; current loops; postures and contact states; joints without a motor.
"""

import math
from collections.abc import Collection, Mapping
from typing import Any

from ..errors import GainroomError
from ..io.validation import dotted, validate
from ..system.filters import FILTERS
from ..system.linear.arrays import Floats
from ..system.system import System
from .robot_sections import RobotFile

KEYS = {
    "model": ("base", "gravity_stiffness", "payload"),
    "joints": ("passive",),
    "drive": ("delay_includes_sampling", "bandwidth", "damping_ratio"),
    "control": ("feedback", *FILTERS),
}
"""Keys of a robot.yaml's sections that belong to the context; postures, contacts, uncertainty and bounds belong to it as a whole."""
WHOLE_SECTIONS = ("postures", "contacts", "uncertainty", "gain_bounds")
GROUPS = "groups"
"""Key for the joints with equal recommended gains: lists, and none of them is something else than no key."""
BALANCE = "balance"
"""Key for the controller of sway, "joints" or "controller"; its value is a word, not a section."""
LOOP_KEYS = ("bandwidth", "damping_ratio")
"""Keys of a current loop."""
DEFAULTS: dict[str, Any] = {"feedback": "motor", "delay_includes_sampling": False}
"""Values that an audit assumes if nothing is given; they are not stored."""
REQUIRED = {
    "model": {"file": "model"},
    "drive": {"bandwidth": 1.0, "delay_ms": 1.0},
    "control": {"type": "pd", "feedback": "motor", "kp": 1, "kd": 1},
}
"""Values for the required keys of a robot.yaml, with which a context is validated."""


def gain_context(sections: Mapping[str, Any], system: System) -> dict[str, Any]:
    """Context of gains in the `sections` of a robot.yaml, from which `system` was made; default values are left out."""
    found: dict[str, Any] = {}
    for name, keys in KEYS.items():
        own = sections.get(name) or {}
        found[name] = {key: own[key] for key in keys if own.get(key) not in (None, [], DEFAULTS.get(key))}
    loops = {(drive.bandwidth, drive.damping_ratio) for drive in system.drives}
    found["drive"] = {key: value for key, value in found["drive"].items() if key not in LOOP_KEYS}
    if len(loops) == 1 and math.isfinite(system.drives[0].bandwidth):
        found["drive"] |= dict(zip(LOOP_KEYS, loops.pop(), strict=True))
    for name, own in _joint_context(system).items():
        found["joints"].setdefault(name, own)
    found |= {name: sections[name] for name in WHOLE_SECTIONS if sections.get(name)}
    for name in ("postures", "contacts"):  # one at 0, and none on the ground, are usual
        if len(found.get(name, {})) < 2 and not any(found.get(name, {}).values()):
            found.pop(name, None)
    found[BALANCE] = system.balance
    groups = {} if sections.get(GROUPS) is None else {GROUPS: sections[GROUPS]}
    return {name: section for name, section in found.items() if section} | groups


def _joint_context(system: System) -> dict[str, dict[str, float]]:
    """Current loop, motor friction and delay of each joint, as far as joints differ, in a robot.yaml's units."""
    source, drives = system.source, system.drives
    columns: dict[str, Floats | list[float]] = {"motor_viscous": source.actuators.motor_viscous}
    if len({(drive.bandwidth, drive.damping_ratio) for drive in drives}) > 1:
        columns |= {key: [getattr(drive, key) for drive in drives] for key in LOOP_KEYS}
    if len({drive.delay for drive in drives}) > 1:
        columns["delay_ms"] = [1e3 * drive.delay for drive in drives]
    found = {}
    for k, name in enumerate(source.joint_names):
        own = {key: float(column[k]) for key, column in columns.items()}
        found[name] = {key: value for key, value in own.items() if math.isfinite(value) and (value or key == "delay_ms")}
    return {name: own for name, own in found.items() if own}


DEFAULT_DAMPING_RATIO = 0.9
"""Default damping ratio of a current loop."""
BASE_NAME, LOOPS_NAME, CONTACTS_NAME = "the base", "the current loops", "the contact states"
JOINT_KEYS = ("bandwidth", "damping_ratio", "motor_viscous", "delay_ms")
"""Keys of a joint that belong to the context."""


def read_gain_context(data: object, source: str, within: str) -> dict[str, Any]:
    """Context of gains that a file holds under the key `within`. Raises GainroomError where a robot.yaml could not have it."""
    sections = data if isinstance(data, dict) else {}
    known, kinds = (*KEYS, *WHOLE_SECTIONS, BALANCE, GROUPS), {BALANCE: str, GROUPS: list}
    for name in sections:
        if name not in known:
            raise GainroomError(f"{source}: {dotted(within, name)}: must be one of {', '.join(known)}")
    if (data is not None and not isinstance(data, dict)) or any(
        not isinstance(each, kinds.get(name, dict)) for name, each in sections.items()
    ):
        raise GainroomError(f"{source}: {within}: must be sections of a robot.yaml: {', '.join(known)}")
    for name, keys in KEYS.items():
        for key in sections.get(name, {}):
            if name != "joints" and key not in keys:
                raise GainroomError(f"{source}: {dotted(within, name, key)}: must be one of {', '.join(keys)}")
    found = {**sections, **({"contacts": _with_infinite(sections["contacts"])} if "contacts" in sections else {})}
    whole = {**found, **{name: {**needed, **found.get(name, {})} for name, needed in REQUIRED.items()}}
    validate(RobotFile, {name: each for name, each in whole.items() if name != "uncertainty"}, source, within)
    return found


def context_flags(lost: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Flags of `gainroom audit` that replace a context `lost` in an export, and the names of the properties that they restore."""
    flags, names = [], []
    if base := (lost.get("model") or {}).get("base"):
        flags, names = [*flags, "--base", str(base)], [*names, BASE_NAME]
    loops = lost.get("drive") or {}
    if loops.get("damping_ratio", DEFAULT_DAMPING_RATIO) == DEFAULT_DAMPING_RATIO and "bandwidth" in loops:
        flags, names = [*flags, "--bandwidth", repr(loops["bandwidth"])], [*names, LOOPS_NAME]
    if BALANCE in lost:
        flags, names = [*flags, "--balance", lost[BALANCE]], [*names, "who damps sway"]
    contacts = lost.get("contacts") or {}
    standing = [frames for frames in contacts.values() if frames]
    typed = [_contact_text(frame) for frame in standing[0]] if len(standing) == 1 < len(contacts) == 2 else []
    if typed and None not in typed:
        flags, names = [*flags, *(text for each in typed for text in ("--contact", str(each)))], [*names, CONTACTS_NAME]
    return flags, names


def without_flag(lost: Mapping[str, Any], given_back: Collection[str]) -> list[str]:
    """Names of the properties in a context `lost` in an export that no flag of `gainroom audit` restores."""
    model, joints, control, drive = (lost.get(key) or {} for key in ("model", "joints", "control", "drive"))
    own = [key for each in joints.values() if isinstance(each, dict) for key in each]
    found = {
        CONTACTS_NAME: "contacts" in lost,
        "several postures": "postures" in lost,
        LOOPS_NAME: "bandwidth" in own or "bandwidth" in drive,
        "delays joint by joint": "delay_ms" in own,
        "the motors' friction": "motor_viscous" in own,
        "joints without a motor": "passive" in joints,
        "the payload": "payload" in model,
        "whether the weight counts": "gravity_stiffness" in model,
        "the encoders' side": "feedback" in control,
        "filters": bool({*FILTERS} & control.keys()),
        "that the delay has hold and difference in it": "delay_includes_sampling" in drive,
        "ranges of uncertainty": "uncertainty" in lost,
        "bounds of recommended gains": "gain_bounds" in lost,
        "which joints have equal gains": GROUPS in lost,
    }
    return [text for text, there in found.items() if there and text not in given_back]


def _contact_text(frame: Any) -> str | None:
    """Contact frame as --contact takes it; None for a frame with springs, which no option describes."""
    if isinstance(frame, str):
        return frame
    kind = frame.get("type", "flat")
    return None if frame.keys() - {"frame", "type"} else frame["frame"] if kind == "flat" else f"{frame['frame']}:{kind}"


def _with_infinite(value: Any) -> Any:
    """JSON value with null replaced by infinity: null stands for infinite stiffness there."""
    if isinstance(value, dict):
        return {key: _with_infinite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_with_infinite(each) for each in value]
    return math.inf if value is None else value
