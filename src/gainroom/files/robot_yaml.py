"""Reader of robot.yaml: a robot, its postures and contacts, actuators, control and requirements, turned into a System.

SI and radians except where a key's name carries another unit. Keys that name joints are patterns: see name_patterns.py.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError, Together, first_of_many, named, nearest
from ..io.validation import dotted, known, partly
from ..io.yaml_text import read_text, shown
from ..robot.actuators import actuators_of, drives_of, merge_entries, published_peaks
from ..robot.assemble import require_movable
from ..robot.body import Base, RigidBody
from ..robot.contact import Contact
from ..robot.formats.in_memory import as_file
from ..robot.formats.model_files import has_base, load_model
from ..robot.formats.model_names import is_name, locate
from ..robot.gearbox_types import TYPES, ranges_of, sources
from ..robot.mirror_names import images
from ..robot.name_patterns import DEFAULT, assign, select_all, strongest
from ..robot.robot import Posture, Robot, moved_inertia
from ..robot.tasks import Task
from ..system.actuator_entry import ActuatorEntry
from ..system.gain_bounds import GainBounds
from ..system.linear.arrays import Floats
from ..system.plausibility import DEGREES, TURN
from ..system.requirements import Requirements
from ..system.system import Control, System
from .actuator_facts import published_notes
from .file_types import parse_as
from .joint_references import IN_ACTUATORS, with_ranges
from .plausibility import plausible
from .robot_sections import ContactSection, ModelSection, RobotFile, TaskSection
from .system_sections import refuse_two_paths

LOCKED = "joints.locked"
MOST_STATES = 500


def load_robot(source: Any, **sections: Any) -> Robot:
    """Robot that a robot.yaml describes; its `system` has control, limits and warnings.

    source     path of a robot.yaml; or its content as a mapping; or a URDF, an MJCF, an MjModel, MjSpec or pinocchio.Model, of which
               `sections` says the rest as a robot.yaml does: drive, control, joints, postures, contacts, limits …

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    if isinstance(source, str | Path) and not sections:
        system = load_robot_system(Path(source))
    elif isinstance(source, Mapping):
        system = _system(lambda _: {**source, **sections}, "robot")
    else:
        given = sections.pop("model", {})
        with as_file(source) as file:
            name = str(source) if isinstance(source, str | Path) else Path(file).stem
            system = _system(lambda _: {"model": {**given, "file": file}, **sections}, name)
    return replace(system.source, system=system)


def load_robot_system(path: Path, two_paths: bool = False) -> System:
    """System of a robot.yaml with all sections; `two_paths`: kd may have a path of its own. Otherwise as load_robot."""
    return parse_robot(read_text(path), str(path), path.parent, two_paths)


def robot_sections(path: Path) -> dict[str, Any]:
    """Sections as they are written. Raises GainroomError if there are none."""
    with Together() as together:
        return parse_as("robot", read_text(path), str(path), "biped", together)


def parse_robot(text: str, source: str, folder: Path = Path(), two_paths: bool = False) -> System:
    """System in the text of a robot.yaml, which messages call `source`; a model's path is relative to `folder`."""
    return _system(lambda together: parse_as("robot", text, source, "biped", together), source, folder, two_paths)


def _system(read: Callable[[Together], Any], source: str, folder: Path = Path(), two_paths: bool = False) -> System:
    """System of the content of a robot.yaml as `read` returns it; else as parse_robot."""
    with named(source), Together() as together:
        file = partly(RobotFile, read(together), source, together)
        together.step(lambda: refuse_two_paths(file.control, two_paths))
        system = robot_spec(file, source, lambda: _model_path(file.model, folder), folder)
    with named(source):
        system = plausible(system)
        if system.control.controller is not None and not np.any(getattr(system.control.controller, "kp", 1.0)):
            raise GainroomError("control.kp: must be > 0 on some joint")
    if file.limits is not None:
        return system
    usual = f"the usual limits are asked for, as the file names none: {system.requirements.only(*Requirements.usual().asked)}"
    return replace(system, assumptions=(*system.assumptions, usual))


def robot_spec(
    file: RobotFile,
    name: str,
    path: Callable[[], Path],
    folder: Path = Path(),
    known_body: RigidBody | None = None,
) -> System:
    """System in SI: the robot `name` with the model at `path`; files of its joints are in `folder`.

    known_body   that model without locked joints, if it is read

    Raises GainroomError where sections contradict each other or the model.
    """
    with Together() as together:
        step, nominal = together.step, {}
        tick, sample_time = step(file.tick), step(file.sample_time)
        drive = step(lambda: file.drive.drive(tick()))
        base = step(lambda: base_of(file.model.base, path(), any((file.contacts or {}).values())))
        links = step(lambda: _links(file, path(), base()[0], known_body))
        body = step(lambda: _carrying(file, links())).otherwise(links)
        # Patterns may name joints that are locked or passive: to lock a joint, one line is enough.
        step(lambda: assign({key: 0 for key, each in file.joints.entries.items() if each.is_section}, body().every_joint, "joints"))
        entries = step(lambda: _entries(file, folder, body()))
        drives = step(lambda: drives_of(entries(), drive()))
        postures = step(lambda: _postures(file, path(), base()[0], body()))
        contacts = step(lambda: _contact_states(file, body()))
        described = step(
            lambda: actuators_of(entries(), body().joint_names, body().armature, lambda: moved_inertia(postures(), contacts()))
        )
        step(lambda: _refuse_many(file.postures or {}, file.contacts or {}))
        tasks = step(lambda: _tasks(file, body()))
        control = step(lambda: _control(file, body(), sample_time))
        groups = step(lambda: _groups(file, body()))
        bounds = step(lambda: _bounds(file, body(), groups()))
        scenario = step(lambda: file.scenario.scenario(body().joint_names, contacts))
        step(lambda: nominal.update(delay=[drive.delay for drive in drives()]))
        step(lambda: nominal.update(described()[0].quantities))
        given = step(lambda: file.uncertainty.uncertainty(nominal, tick))
        file.require_right()
        uncertainty, from_files = with_ranges(given(), entries(), nominal, body().joint_names)
        actuators, guessed = described()
        types = actuators.gearbox
        gearboxes = ranges_of(types, actuators.motor_inertia.tolist(), published_peaks(entries()))
        uncertainty = replace(uncertainty, **gearboxes)
        kept = zip(body().joint_names, types, gearboxes["resonance"][0].tolist() if gearboxes else (), strict=False)
        stiff_enough = [name for name, kind, low in kept if kind and low > TYPES[kind].resonance[0]]
        return System(
            source=Robot(name, actuators, postures(), contacts(), tasks(), file.model.gravity_stiffness),
            drives=drives(),
            control=control(),
            requirements=file.requirements(),
            uncertainty=uncertainty,
            balance=file.balance or "",
            objective=file.objective,
            bounds=bounds(),
            groups=groups(),
            scenario=scenario(),
            assumptions=(
                *base()[1],
                *_joints_alone(file),
                *guessed,
                *published_notes(entries(), body().joint_names),
                *from_files,
                *sources(dict.fromkeys(filter(None, types)), stiff_enough),
            ),
            warnings=(*body().doubts, *body().notes, *_without_motor(file, body()), *_outside(postures())),
        )


def _joints_alone(file: RobotFile) -> tuple[str, ...]:
    """Note that what the file says of the joints' gains does not hold for those of tasks."""
    given = [key for key in ("gain_bounds", "groups") if getattr(file, key) is not None]
    text = f"{' and '.join(given)}: of the joints alone, and gains recommended for tasks do not keep them"
    return (text,) if given and file.tasks else ()


def _links(file: RobotFile, path: Path, base: Base | None, known_body: RigidBody | None) -> RigidBody:
    """Links without a payload."""
    joints = file.joints
    if known_body is not None and not joints.locked and not joints.passive:
        require_movable(known_body)
        return known_body
    return load_model(path, base, joints.locked, locked_key=LOCKED, passive=joints.passive, driven=joints.driven)


def _entries(file: RobotFile, folder: Path, body: RigidBody) -> tuple[ActuatorEntry, ...]:
    """Actuator entry of each joint."""
    with Together() as together:
        given = {
            key: together.step(lambda key=key, section=section: section.entry(folder, f"joints.{dotted(key)}"))
            for key, section in file.joints.entries.items()
        }
        merged = merge_entries({key: entry() for key, entry in given.items()}, body.every_joint)[: body.size]
        said = [name for name in IN_ACTUATORS if file.uncertainty.is_given(name)]
        return tuple(entry.without_published_ranges(said) for entry in merged)


def _postures(file: RobotFile, path: Path, base: Base | None, body: RigidBody) -> dict[str, Posture]:
    """Postures by name."""
    with Together() as together:
        found = {
            name: together.step(lambda name=name, patterns=patterns: _posture(name, known(patterns), path, base, file, body))
            for name, patterns in (file.postures or {"zero": {}}).items()
        }
        return {name: posture() for name, posture in found.items()}


def _contact_states(file: RobotFile, body: RigidBody) -> dict[str, tuple[Contact, ...]]:
    """Contact states by name."""
    with Together() as together:
        found = {
            name: together.step(lambda name=name, sections=sections: _contacts(name, known(sections), body))
            for name, sections in (file.contacts or {"free": []}).items()
        }
        return {name: contacts() for name, contacts in found.items()}


def _refuse_many(postures: Sized, contacts: Sized) -> None:
    count = max(len(postures), 1) * max(len(contacts), 1)
    if count > MOST_STATES:
        raise GainroomError(f"postures and contacts: {count} combinations must be at most {MOST_STATES}")


def _model_path(section: ModelSection, folder: Path) -> Path:
    """Path of the model: beside the file that names it, in a package, or in the catalogue of robots."""
    if section.package is not None:
        return locate({"package": section.package, "file": section.file})
    path = folder / section.file
    return locate(section.file) if is_name(section.file) and not path.exists() else path


def base_of(given: Base | None, path: Path, stands: bool) -> tuple[Base | None, tuple[str, ...]]:
    """Base as given, or as in the file; else floating if the robot `stands` on something, with a note about the guess."""
    if given is not None or has_base(path):
        return given, ()
    base: Base = "floating" if stands else "fixed"
    return base, (f"the base is {base}, because none is given and there are {'' if stands else 'no '}contacts",)


def _posture(name: str, patterns: Mapping[str, float], path: Path, base: Base | None, file: RobotFile, body: RigidBody) -> Posture:
    """Posture, with links whose locked joints are at its angles."""
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
    """Links with the file's payload."""
    load = file.model.payload
    if load is None:
        return body
    _require_frame(load.frame, body, "model.payload")
    with named("model.payload"):
        return body.with_payload(load.frame, load.mass)


def _angles(name: str, patterns: Mapping[str, float], joint_names: Sequence[str]) -> dict[str, float]:
    """Angles of one posture by joint name."""
    found = strongest(patterns, joint_names, f"postures.{dotted(name)}")
    return {joint: angle for joint, angle in zip(joint_names, found, strict=True) if angle is not None}


def _without_motor(file: RobotFile, body: RigidBody) -> tuple[str, ...]:
    """Warning about gains of joints without a motor."""
    given = (getattr(file.control, name) for name in file.control.gain_names)
    named = {key for gains in given if isinstance(gains, dict) for key in gains}
    names = [name for name in body.passive if name in named or re.escape(name) in named]
    what = "gains of joints without a motor do not count; if they have one, name them in joints.driven"
    return (f"{what}: {first_of_many(names)}",) if names else ()


def _outside(postures: Mapping[str, Posture]) -> tuple[str, ...]:
    """Warnings about postures beyond the joints' limits."""
    warnings = []
    for name, posture in postures.items():
        beyond = posture.body.beyond_limits(posture.body.configuration(posture.angles))
        if beyond:
            turned = any(abs(angle) > TURN for angle in posture.angles.values())
            meant = f"move it inside; angles are in rad: {DEGREES}" if turned else "move it inside, or check the model"
            warnings.append(f"posture {shown(name)}: {first_of_many(beyond)}; {meant}")
    return tuple(warnings)


def _contacts(name: str, sections: Sequence[ContactSection], body: RigidBody) -> tuple[Contact, ...]:
    """Contact state whose frames exist and are used once each."""
    owner = f"contacts.{dotted(name)}"

    def contact(index: int, section: ContactSection) -> Contact:
        _require_frame(section.frame, body, f"{owner}[{index}]")
        with named(f"{owner}[{index}]"):
            return section.contact()

    with Together() as together:
        together.step(lambda: _refuse_twice(owner, sections))
        contacts = [together.step(lambda index=index, section=section: contact(index, section)) for index, section in enumerate(sections)]
        return tuple(each() for each in contacts)


def _refuse_twice(owner: str, sections: Sequence[ContactSection]) -> None:
    for frame, count in Counter(section.frame for section in sections if section.is_right("frame")).items():
        if count > 1:
            raise GainroomError(f"{owner}: frame {shown(frame)} is used {count} times; give each contact frame once")


def _require_frame(frame: str, body: RigidBody, owner: str) -> None:
    if frame not in body.frames:
        raise GainroomError(f"{owner}: the robot has no frame {shown(frame)}{nearest(frame, body.frames, 'frame')}")


def _tasks(file: RobotFile, body: RigidBody) -> tuple[Task, ...]:
    """Task stack, with existing frames and as many gains as directions."""
    with Together() as together:
        found = [
            together.step(lambda index=index, section=section: _task(f"tasks[{index}]", section, body))
            for index, section in enumerate(file.tasks)
        ]
        return tuple(task() for task in found)


def _task(place: str, section: TaskSection, body: RigidBody) -> Task:
    with Together() as together:
        if section.frame is not None:
            together.step(lambda: _require_frame(section.frame or "", body, f"{place}.frame"))
        section.require_right()
        task = section.task()
        size = len(task.directions(body.joint_names))
        for key in ("kp", "kd", "kv", "ki"):
            given = getattr(section, key)
            if isinstance(given, list) and len(given) != size:
                raise GainroomError(f"{place}.{key}: {shown(given)} must be a number, or {size} numbers, one per direction")
        return task


def _control(file: RobotFile, body: RigidBody, sample_time: Callable[[], float | None]) -> Control:
    """Control with gains per joint, or with filters only in task space."""
    section = file.control
    with Together() as together:
        step = together.step
        names = section.known_gains()
        gains = {name: step(lambda name=name: _per_joint(f"control.{name}", known(getattr(section, name)), body)) for name in names}
        weight = step(lambda: _per_joint("control.weight", {DEFAULT: 1.0, **(section.weight or {})}, body))
        path = step(section.gain_path)
        in_joints = section.space == "joint"
        return Control(
            space=section.space,
            controller=section.controller({name: gains[name]() for name in section.gain_names}) if in_joints else None,
            feedback=section.feedback,
            sample_time=sample_time(),
            **section.filters(),
            rotors=section.rotors,
            weight=weight() if in_joints else None,
            kd_path=path(),
            command_delay=1e-3 * file.drive.command_delay_ms,
            sampling_in_delay=file.drive.delay_includes_sampling,
            continuous=file.drive.clock == "continuous",
        )


def _groups(file: RobotFile, body: RigidBody) -> tuple[tuple[int, ...], ...] | None:
    """Joints with equal recommended gains, by index; None: the file does not say. Raises GainroomError for a joint in two groups."""
    if file.groups is None:
        return None
    with Together() as together:
        every = [
            together.step(lambda index=index, patterns=patterns: select_all(patterns, body.every_joint, f"groups[{index}]"))
            for index, patterns in enumerate(file.groups)
        ]
        found = [tuple(sorted({k for one in each() for k in one if k < body.size})) for each in every]
    for index, group in enumerate(found):
        for before, other in enumerate(found[:index]):
            if twice := sorted({*group} & {*other}):
                name = shown(body.joint_names[twice[0]])
                raise GainroomError(f"groups[{index}]: joint {name} is in groups[{before}], too; a joint must be in one group at most")
    return tuple(found)


def _bounds(file: RobotFile, body: RigidBody, groups: Sequence[Sequence[int]] | None) -> GainBounds:
    """Bounds of recommended gains per joint. Raises GainroomError where those of a joint, or of joints with equal gains, contradict."""
    sections = {key: each for key, each in (file.gain_bounds or {}).items() if each.is_section}
    assigned = assign(sections, body.every_joint, "gain_bounds")[: body.size]
    for section in sections.values():
        section.require_right()
    per_joint = [{name: value for section in found for name, value in section.given.items()} for found in assigned]
    names = {name for given in per_joint for name in given}
    equal = images(body.joint_names) if groups is None else groups
    for group in [*([k] for k in range(body.size)), *equal]:
        for gain in ("kp", "kd"):
            least, most = f"{gain}_min", f"{gain}_max"
            lows, highs = ([(per_joint[k][key], k) for k in group if key in per_joint[k]] for key in (least, most))
            if lows and highs and max(lows)[0] > min(highs)[0]:
                (low, j), (high, k) = max(lows), min(highs)
                one, other = (shown(body.joint_names[place]) for place in (j, k))
                whose = "" if j == k else f" of {other}, as the two have equal gains (groups may say otherwise)"
                raise GainroomError(f"gain_bounds: {least} {low:g} of joint {one} must be <= {most} {high:g}{whose}")
    free = {"kp_min": 0.0, "kp_max": math.inf, "kd_min": 0.0, "kd_max": math.inf}
    return GainBounds(**{name: np.array([given.get(name, free[name]) for given in per_joint]) for name in sorted(names)})


def _per_joint(owner: str, patterns: Mapping[str, float], body: RigidBody) -> Floats:
    """Gain of each joint (n,). Raises GainroomError if a joint has none, or all are 0."""
    found = strongest(patterns, body.every_joint, owner)[: body.size]
    without = [name for name, value in zip(body.joint_names, found, strict=True) if value is None]
    if without:
        raise GainroomError(f"{owner}: no value for joint {first_of_many(without)}; give default, or patterns that match every joint")
    return np.array(found)
