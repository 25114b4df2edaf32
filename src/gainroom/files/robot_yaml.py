"""robot.yaml: a robot, how it stands, its actuators and control, and what is asked of them, turned into a RobotSpec.

SI and radians except where a key's name carries another unit. Keys that name joints are patterns: see name_patterns.py.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import GainroomError, first_of_many, named, nearest
from ..io.validation import dotted, validate
from ..io.yaml_text import read_text, shown
from ..linear.arrays import Floats
from ..robot.actuators import Actuators, actuators_of, drives_of, merge_entries
from ..robot.body import Base, RigidBody
from ..robot.contact import Contact
from ..robot.formats.model_files import is_name, load_model, locate
from ..robot.name_patterns import assign
from ..robot.plausibility import unusual_robot
from ..robot.spec import Posture, Range, Ranges, Robot, RobotControl, RobotSpec
from ..robot.tasks import Task
from ..system.controller import PD, PID, PPI
from ..system.drive import Drive
from ..system.requirements import Requirements
from .common_sections import delay_of, refuse_long_delay, refuse_quick_filters, spread, tick_of
from .file_types import parse_as
from .robot_sections import CONTROLLERS, ContactSection, ModelSection, RobotControlSection, RobotFile

LOCKED = "joints.locked"
MOST_STATES = 500
USUAL = f"the usual limits are asked for, as the file names none: {Requirements.usual()}"
MOST_LAG = 1e4
"""[rad] of phase that a joint's crossover has in its delay: a stable one has about 1."""
MOST_TICKS = 600
"""Of delay, all joints together: half a minute on two joints; 50 joints may have 12 each."""


def load_robot(path: Path | str) -> Robot:
    """The robot that a robot.yaml describes; its `spec` has control, limits and warnings.

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    spec = load_robot_spec(Path(path))
    return replace(spec.robot, spec=spec)


def load_robot_spec(path: Path) -> RobotSpec:
    """As load_robot: everything in the file."""
    return parse_robot(read_text(path), str(path), path.parent)


def parse_robot(text: str, source: str, folder: Path = Path()) -> RobotSpec:
    """As load_robot_spec, for the text of a file that messages call `source`; a model's path is relative to `folder`."""
    file = validate(RobotFile, parse_as("robot", text, source, "biped"), source)
    with named(source):
        return _spec(file, source, folder)


def _spec(file: RobotFile, source: str, folder: Path) -> RobotSpec:
    tick = tick_of(file.control, file.drive)
    sampled = tick if file.control.sample_rate_hz is not None else None
    refuse_quick_filters(file.control, sampled)
    common = Drive(bandwidth=file.drive.bandwidth, damping_ratio=file.drive.damping_ratio, delay=delay_of(file.drive, tick))
    robot, drives, assumptions, warnings = _robot(file, source, folder, common)
    refuse_long_delays(robot.joint_names, [drive.delay for drive in drives], sampled)
    ranges = _ranges(file, robot.actuators, drives, tick)
    if ranges.delay is not None:
        refuse_long_delays(robot.joint_names, ranges.delay[1].tolist(), sampled)
    control = _control(file.control, robot.body, sampled)
    if control.joints is not None:
        refuse_absurd_gains(robot.body, robot.actuators, drives, control.joints)
    refuse_absurd_tasks(robot.stack, drives)
    limits = Requirements.usual() if file.limits is None else file.limits.requirements()
    return RobotSpec(
        robot=robot,
        drives=drives,
        control=control,
        requirements=limits,
        uncertainty=ranges,
        scenario=file.scenario.scenario(robot, file.control.space),
        assumptions=(*assumptions, *([USUAL] if file.limits is None else [])),
        warnings=(
            *warnings,
            *unusual_robot(robot.actuators, robot.joint_names, drives, control.joints, sampled, limits, robot.body.slides),
        ),
    )


def refuse_long_delays(names: Sequence[str], delays: Sequence[float], tick: float | None) -> None:
    """Raise GainroomError where a sampled robot would carry too many ticks of delay, which are states; `tick` None: continuous."""
    for name, delay in zip(names, delays, strict=True):
        refuse_long_delay(delay, tick, f"joint {name!r}")
    if tick is not None and sum(delays) > MOST_TICKS * tick:
        raise GainroomError(
            f"the delays of all {len(names)} joints together, {sum(delays) / tick:g} ticks, must be <= {MOST_TICKS} ticks: take a lower "
            "sample rate, or none for continuous time"
        )


def refuse_absurd_gains(body: RigidBody, actuators: Actuators, drives: Sequence[Drive], controller: PD | PID | PPI) -> None:
    """Raise GainroomError for gains that would move a joint many times within its delay: that is no loop, but a slip of units.

    Nothing settles where the product of a loop's crossover and its delay is far above 1, and its curves would be followed turn by turn.
    """
    links = np.diag(body.mass_matrix(body.neutral()))[body.nv - body.size :]
    inertia = actuators.motor_inertia + np.where(np.isinf(actuators.stiffness), links, 0.0)
    stiff, damped = (np.broadcast_to(np.asarray(gain, dtype=float), (body.size,)) for gain in controller.plane_gains())
    for k, name in enumerate(body.joint_names):
        gains = f"kp {stiff[k]:g} N·m/rad, kd {damped[k]:g} N·m·s/rad and an inertia of {inertia[k]:g} kg·m²"
        _refuse_lag(f"joint {name!r}: with {gains}", stiff[k] / inertia[k], damped[k] / inertia[k], drives[k].delay)


def refuse_absurd_tasks(tasks: Sequence[Task], drives: Sequence[Drive]) -> None:
    """The same for tasks, whose gains are accelerations."""
    delay = max(drive.delay for drive in drives)
    for index, task in enumerate(tasks):
        stiff, damped = (float(np.max(np.asarray(gain, dtype=float))) for gain in (task.kp, task.kd))
        _refuse_lag(f"tasks[{index}]: with gains of {stiff:g} 1/s² and {damped:g} 1/s", stiff, damped, delay)


def _refuse_lag(owner: str, stiff: float, damped: float, delay: float) -> None:
    """`stiff` [1/s²], `damped` [1/s]."""
    lag = delay * max(math.sqrt(stiff), damped)
    if lag > MOST_LAG:
        raise GainroomError(
            f"{owner} its loop is too quick for a delay of {1e3 * delay:g} ms: {lag:.3g} rad of phase must be <= {MOST_LAG:g} rad; "
            "look for a wrong unit"
        )


def _robot(file: RobotFile, source: str, folder: Path, common: Drive) -> tuple[Robot, tuple[Drive, ...], tuple[str, ...], tuple[str, ...]]:
    """The machine, its drives, assumptions and warnings."""
    path = _model_path(file.model, folder)
    base, assumed = base_of(file.model.base, path, any((file.contacts or {}).values()))
    body = load_model(path, base, file.joints.locked, locked_key=LOCKED)
    names = (*body.joint_names, *body.locked)
    postures = {name: _posture(name, patterns, path, base, file, body) for name, patterns in (file.postures or {"zero": {}}).items()}
    contacts = {name: _contacts(name, sections, body) for name, sections in (file.contacts or {"free": []}).items()}
    if len(postures) * len(contacts) > MOST_STATES:
        raise GainroomError(f"postures and contacts: {len(postures) * len(contacts)} combinations must be at most {MOST_STATES}")
    # Patterns may name joints that are locked: to lock a joint, one line is enough.
    entries = merge_entries({key: section.entry() for key, section in file.joints.entries.items()}, names)[: body.size]
    actuators, guessed = actuators_of(entries, body.joint_names, body.armature)
    robot = Robot(
        name=source,
        actuators=actuators,
        postures=postures,
        contacts=contacts,
        stack=_tasks(file, body),
        gravity=file.model.gravity_stiffness,
    )
    return robot, drives_of(entries, common), (*assumed, *guessed), (*body.notes, *_outside(postures))


def _model_path(section: ModelSection, folder: Path) -> Path:
    """Where the model is: beside the file that names it, in a package, or in the catalogue of robots."""
    if section.package is not None:
        return locate({"package": section.package, "file": section.file})
    path = folder / section.file
    return locate(section.file) if is_name(section.file) and not path.exists() else path


def base_of(given: Base | None, path: Path, stands: bool) -> tuple[Base | None, tuple[str, ...]]:
    """The base as given; where a URDF's is not, floating if it `stands` on something. An MJCF says it itself. And a note of the guess."""
    if given is not None or path.suffix == ".xml":
        return given, ()
    base: Base = "floating" if stands else "fixed"
    return base, (f"the base is {base}, as none is given and {'there are contacts' if stands else 'nothing touches the ground'}",)


def _posture(name: str, patterns: Mapping[str, float], path: Path, base: Base | None, file: RobotFile, body: RigidBody) -> Posture:
    """One posture, with links whose locked joints stand as it says."""
    angles = _angles(name, patterns, (*body.joint_names, *body.locked))
    held = {joint: angles.pop(joint) for joint in body.locked if joint in angles}
    if any(held[joint] != body.locked[joint] for joint in held):
        body = load_model(path, base, file.joints.locked, posture_for_locked=held, locked_key=LOCKED)
    return Posture(body, angles)


def _angles(name: str, patterns: Mapping[str, float], joint_names: Sequence[str]) -> dict[str, float]:
    """One posture's angles by joint name."""
    matches = assign(patterns, joint_names, f"postures.{dotted(name)}")
    return {joint: found[-1] for joint, found in zip(joint_names, matches, strict=True) if found}


def _outside(postures: Mapping[str, Posture]) -> tuple[str, ...]:
    """Warnings for postures beyond the joints' limits."""
    warnings = []
    for name, posture in postures.items():
        beyond = posture.body.beyond_limits(posture.body.configuration(posture.angles))
        if beyond:
            warnings.append(f"posture {shown(name)}: {first_of_many(beyond)}; move it inside, or check the model")
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
    for index, section in enumerate(file.tasks):
        place = f"tasks[{index}]"
        if section.frame is not None:
            _require_frame(section.frame, body, f"{place}.frame")
        size = len(body.joint_names) if section.type == "posture" else 3
        for key in ("kp", "kd", "kv", "ki"):
            given = getattr(section, key)
            if isinstance(given, list) and len(given) != size:
                raise GainroomError(f"{place}.{key}: {shown(given)} must be a number, or {size} numbers, one per direction")
    return tuple(section.task() for section in file.tasks)


def _control(section: RobotControlSection, body: RigidBody, sample_time: float | None) -> RobotControl:
    """Gains per joint, or nothing but filters in task space."""
    filters, joints, weight = section.filters(), None, None
    if section.space == "joint":
        kind = CONTROLLERS[section.type]
        gains = {name: _per_joint(f"control.{name}", getattr(section, name), body) for name in kind.gain_names()}
        joints = kind(**gains, **filters)
        weight = _per_joint("control.weight", {"default": 1.0, **(section.weight or {})}, body)
    return RobotControl(section.space, joints, section.feedback, sample_time, **filters, rotors=section.rotors, weight=weight)


def _per_joint(owner: str, patterns: Mapping[str, float], body: RigidBody) -> Floats:
    """One gain per joint (n,). Raises GainroomError where a joint has none, or all are 0."""
    matches = assign(patterns, (*body.joint_names, *body.locked), owner)[: body.size]
    without = [name for name, found in zip(body.joint_names, matches, strict=True) if not found]
    if without:
        raise GainroomError(f"{owner}: no value for joint {first_of_many(without)}; give default, or patterns that match every joint")
    gains = np.array([found[-1] for found in matches])
    if owner == "control.kp" and not np.any(gains):
        raise GainroomError(f"{owner}: must be > 0 on some joint")
    return gains


def _ranges(file: RobotFile, actuators: Actuators, drives: Sequence[Drive], tick: float | None) -> Ranges:
    """Each joint's own range around its own value."""
    section = file.uncertainty
    key, delay, unit = section.delay_range(tick)
    given = {"stiffness": section.stiffness, "motor_inertia": section.motor_inertia, "damping": section.damping}
    ranges = {name: _range(name, value, getattr(actuators, name), 1.0) for name, value in given.items()}
    return Ranges(delay=_range(key, delay, np.array([drive.delay for drive in drives]), unit), **ranges)


def _range(key: str, given: str | list[float] | None, nominal: Floats, unit: float) -> Range | None:
    """(low, high), each (n,); rigid joints stay rigid."""
    if given is None:
        return None
    if np.all(np.isinf(nominal)):
        spread(key, given, np.inf, unit)
    ends = [(value, value) if np.isinf(value) else spread(key, given, float(value), unit) for value in nominal]
    low, high = np.array(ends, dtype=float).T
    return low, high
