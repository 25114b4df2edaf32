"""robot.yaml: a robot, its postures and contacts, actuators, control and requirements, turned into a System.

SI and radians except where a key's name carries another unit. Keys that name joints are patterns: see name_patterns.py.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import GainroomError, first_of_many, named, nearest
from ..io.validation import dotted, validate
from ..io.yaml_text import read_text, shown
from ..robot.actuators import actuators_of, drives_of, merge_entries
from ..robot.assemble import require_movable
from ..robot.body import Base, RigidBody
from ..robot.contact import Contact
from ..robot.formats.model_files import has_base, load_model
from ..robot.formats.model_names import is_name, locate
from ..robot.name_patterns import DEFAULT, strongest
from ..robot.robot import Posture, Robot
from ..robot.tasks import Task
from ..system.linear.arrays import Floats
from ..system.plausibility import DEGREES, TURN
from ..system.requirements import Requirements
from ..system.system import Control, System
from .absurd_values import examined
from .file_types import parse_as
from .joint_references import with_ranges
from .robot_sections import ContactSection, ModelSection, RobotFile
from .system_sections import refuse_two_paths

LOCKED = "joints.locked"
MOST_STATES = 500
USUAL = f"the usual limits are asked for, as the file names none: {Requirements.usual()}"


def load_robot(path: Path | str) -> Robot:
    """The robot that a robot.yaml describes; its `system` has control, limits and warnings.

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    system = load_robot_system(Path(path))
    return replace(system.source, system=system)


def load_robot_system(path: Path, two_paths: bool = False) -> System:
    """As load_robot: everything in the file; `two_paths`: kd may have a path of its own."""
    return parse_robot(read_text(path), str(path), path.parent, two_paths)


def parse_robot(text: str, source: str, folder: Path = Path(), two_paths: bool = False) -> System:
    """As load_robot_system, for the text of a file that messages call `source`; a model's path is relative to `folder`."""
    file = validate(RobotFile, parse_as("robot", text, source, "biped"), source)
    with named(source):
        refuse_two_paths(file.control, two_paths)
        system = examined(robot_spec(file, source, _model_path(file.model, folder), folder))
        if system.control.controller is not None and not np.any(getattr(system.control.controller, "kp", 1.0)):
            raise GainroomError("control.kp: must be > 0 on some joint")
    return system if file.limits is not None else replace(system, assumptions=(*system.assumptions, USUAL))


def robot_spec(file: RobotFile, name: str, path: Path, folder: Path = Path(), known: RigidBody | None = None) -> System:
    """In SI: the robot `name` with the model at `path`, its joints' files in `folder`; `known`: that model without locked joints, if read.

    Raises GainroomError where sections contradict each other or the model.
    """
    tick, sample_time = file.tick(), file.sample_time()
    base, assumed = base_of(file.model.base, path, any((file.contacts or {}).values()))
    joints = file.joints
    if known is not None and not joints.locked and not joints.passive:
        require_movable(body := known)
    else:
        body = load_model(path, base, joints.locked, locked_key=LOCKED, passive=joints.passive, driven=joints.driven)
    body = _carrying(file, body)
    # Patterns may name joints that are locked or passive: to lock a joint, one line is enough.
    names = body.every_joint
    postures = {name: _posture(name, patterns, path, base, file, body) for name, patterns in (file.postures or {"zero": {}}).items()}
    contacts = {name: _contacts(name, sections, body) for name, sections in (file.contacts or {"free": []}).items()}
    if len(postures) * len(contacts) > MOST_STATES:
        raise GainroomError(f"postures and contacts: {len(postures) * len(contacts)} combinations must be at most {MOST_STATES}")
    given = {key: section.entry(folder, f"joints.{dotted(key)}") for key, section in joints.entries.items()}
    entries = merge_entries(given, names)[: body.size]
    actuators, guessed = actuators_of(entries, body.joint_names, body.armature)
    drives = drives_of(entries, file.drive.drive(tick))
    robot = Robot(name, actuators, postures, contacts, _tasks(file, body), file.model.gravity_stiffness)
    nominal = {"delay": [drive.delay for drive in drives], **robot.quantities}
    uncertainty, from_files = with_ranges(file.uncertainty.uncertainty(nominal, tick), entries, nominal, body.joint_names)
    return System(
        source=robot,
        drives=drives,
        control=_control(file, body, sample_time),
        requirements=file.requirements(),
        uncertainty=uncertainty,
        scenario=file.scenario.scenario(robot, file.control.space),
        assumptions=(*assumed, *guessed, *from_files),
        warnings=(*body.doubts, *body.notes, *_without_motor(file, body), *_outside(postures)),
    )


def _model_path(section: ModelSection, folder: Path) -> Path:
    """Where the model is: beside the file that names it, in a package, or in the catalogue of robots."""
    if section.package is not None:
        return locate({"package": section.package, "file": section.file})
    path = folder / section.file
    return locate(section.file) if is_name(section.file) and not path.exists() else path


def base_of(given: Base | None, path: Path, stands: bool) -> tuple[Base | None, tuple[str, ...]]:
    """The base as given or as the file says; else floating if it `stands` on something, and a note of the guess."""
    if given is not None or has_base(path):
        return given, ()
    base: Base = "floating" if stands else "fixed"
    return base, (f"the base is {base}, because none is given and there are {'' if stands else 'no '}contacts",)


def _posture(name: str, patterns: Mapping[str, float], path: Path, base: Base | None, file: RobotFile, body: RigidBody) -> Posture:
    """One posture, with links whose locked joints stand as it says."""
    angles = _angles(name, patterns, body.every_joint)
    held = {joint: angles.pop(joint) for joint in body.locked if joint in angles}
    if any(held[joint] != body.locked[joint] for joint in held) or (body.led and angles):
        joints, place = file.joints, {**angles, **held}
        body = load_model(
            path, base, joints.locked, posture_for_locked=place, locked_key=LOCKED, passive=joints.passive, driven=joints.driven
        )
        body = _carrying(file, body)
    return Posture(body, angles)


def _carrying(file: RobotFile, body: RigidBody) -> RigidBody:
    """With the file's payload."""
    load = file.model.payload
    if load is None:
        return body
    _require_frame(load.frame, body, "model.payload")
    with named("model.payload"):
        return body.with_payload(load.frame, load.mass)


def _angles(name: str, patterns: Mapping[str, float], joint_names: Sequence[str]) -> dict[str, float]:
    """One posture's angles by joint name."""
    found = strongest(patterns, joint_names, f"postures.{dotted(name)}")
    return {joint: angle for joint, angle in zip(joint_names, found, strict=True) if angle is not None}


def _without_motor(file: RobotFile, body: RigidBody) -> tuple[str, ...]:
    """A warning about gains that are named for joints without a motor."""
    named = {key for gains in (file.control.kp, file.control.kd) if isinstance(gains, dict) for key in gains}
    names = [name for name in body.passive if name in named or re.escape(name) in named]
    what = "gains of joints without a motor do not count; if they have one, name them in joints.driven"
    return (f"{what}: {first_of_many(names)}",) if names else ()


def _outside(postures: Mapping[str, Posture]) -> tuple[str, ...]:
    """Warnings for postures beyond the joints' limits."""
    warnings = []
    for name, posture in postures.items():
        beyond = posture.body.beyond_limits(posture.body.configuration(posture.angles))
        if beyond:
            turned = any(abs(angle) > TURN for angle in posture.angles.values())
            meant = f"move it inside; angles are in rad: {DEGREES}" if turned else "move it inside, or check the model"
            warnings.append(f"posture {shown(name)}: {first_of_many(beyond)}; {meant}")
    return tuple(warnings)


def _contacts(name: str, sections: Sequence[ContactSection], body: RigidBody) -> tuple[Contact, ...]:
    """One contact state, its frames there and each used once."""
    owner = f"contacts.{dotted(name)}"
    for frame, count in Counter(section.frame for section in sections).items():
        if count > 1:
            raise GainroomError(f"{owner}: frame {shown(frame)} is used {count} times; give each contact frame once")
    contacts = []
    for index, section in enumerate(sections):
        place = f"{owner}[{index}]"
        _require_frame(section.frame, body, place)
        try:
            contact = section.contact()
        except GainroomError as error:
            raise GainroomError(f"{place}: {error}") from error
        contacts.append(contact)
    return tuple(contacts)


def _require_frame(frame: str, body: RigidBody, owner: str) -> None:
    if frame not in body.frames:
        raise GainroomError(f"{owner}: the robot has no frame {shown(frame)}{nearest(frame, body.frames, 'frame')}")


def _tasks(file: RobotFile, body: RigidBody) -> tuple[Task, ...]:
    """The stack, with frames that are there and as many gains as directions."""
    tasks = tuple(section.task() for section in file.tasks)
    for index, (section, task) in enumerate(zip(file.tasks, tasks, strict=True)):
        place = f"tasks[{index}]"
        if task.frame is not None:
            _require_frame(task.frame, body, f"{place}.frame")
        size = len(task.directions(body.joint_names))
        for key in ("kp", "kd", "kv", "ki"):
            given = getattr(section, key)
            if isinstance(given, list) and len(given) != size:
                raise GainroomError(f"{place}.{key}: {shown(given)} must be a number, or {size} numbers, one per direction")
    return tasks


def _control(file: RobotFile, body: RigidBody, sample_time: float | None) -> Control:
    """Gains per joint, or nothing but filters in task space."""
    section = file.control
    gains = {name: _per_joint(f"control.{name}", getattr(section, name), body) for name in section.gain_names}
    in_joints = section.space == "joint"
    return Control(
        space=section.space,
        controller=section.controller(gains) if in_joints else None,
        feedback=section.feedback,
        sample_time=sample_time,
        **section.filters(),
        rotors=section.rotors,
        weight=_per_joint("control.weight", {DEFAULT: 1.0, **(section.weight or {})}, body) if in_joints else None,
        kd_path=section.gain_path(),
        command_delay=1e-3 * file.drive.command_delay_ms,
        sampling_in_delay=file.drive.delay_includes_sampling,
        continuous=file.drive.clock == "continuous",
    )


def _per_joint(owner: str, patterns: Mapping[str, float], body: RigidBody) -> Floats:
    """One gain per joint (n,). Raises GainroomError where a joint has none, or all are 0."""
    found = strongest(patterns, body.every_joint, owner)[: body.size]
    without = [name for name, value in zip(body.joint_names, found, strict=True) if value is None]
    if without:
        raise GainroomError(f"{owner}: no value for joint {first_of_many(without)}; give default, or patterns that match every joint")
    return np.array(found)
