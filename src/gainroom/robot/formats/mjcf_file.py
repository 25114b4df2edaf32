"""MJCF through MuJoCo's compiler, which knows defaults, inertia from shapes and its own conventions best.

What does not bear on bodies and joints is left out before it compiles: pictures, sensors, contacts, and every shape that does not enter a
body's inertia. So mesh files may be missing where inertias are explicit. Files named inside are read only from the model's own folder.
"""

import contextlib
import os
import re
import threading
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, tostring

import numpy as np

from ...errors import GainroomError, first_of_many, one_line, typo_of
from ...io.run_files import note_read
from ..assemble import MAX_JOINTS, require_at_most
from ..body import library
from .mjcf_constraints import Constraints, take_constraints
from .mujoco_messages import mujoco_warnings
from .xml_text import MAX_BYTES, MAX_DEPTH, MAX_ELEMENTS, read_xml

SECTIONS = ("compiler", "option", "default", "asset", "worldbody", "equality", "actuator")
KEYFRAMES = ("keyframe",)
IDLE = ("size", "visual", "statistic", "custom", "contact", "deformable", "tendon", "sensor", "extension", *KEYFRAMES)
"""Sections that MJCF has and that do not bear on bodies, joints and their actuators."""
MULTIPLIERS = ("replicate", "composite", "flexcomp", "attach")
"""These make many bodies of few lines, or read further models."""
MOST = {"body": 2000, "joint": MAX_JOINTS, "geom": 2000, "site": 2000, "asset": 1000, "actuator": 2000, "equality": 2000, "keyframe": 1000}
"""Elements by tag, assets and the like by section: MuJoCo and Pinocchio take time that grows with the square of some of them."""

ARENA = 33 * 2**20
"""Work space of an MjData [bytes], more than MuJoCo's own 15 MiB: the C library gives what is above 32 MiB back to the system when it is
freed. Of aligned blocks below that glibc before 2.38 finds none again, and every new MjData takes address space that nobody had before."""


FINITE = {
    "body": ("body_mass", "body_inertia", "body_pos", "body_ipos", "body_quat", "body_iquat"),
    "joint": ("jnt_pos", "jnt_axis", "jnt_stiffness"),
    "site": ("site_pos", "site_quat"),
}
_COMPILING = threading.Lock()
"""MuJoCo's and Python's handlers of warnings are the whole process's."""


@dataclass(frozen=True)
class ActuatorElement:
    """An actuator of a file with its defaults: its joint ("" for another target), its gear, and on its own side of that what it does.

    stiffness, offset   of an affine bias: −b1 and b0; gain: the factor on its input
    control_range       as an attribute's text, "" where the input is not limited
    """

    joint: str
    gear: float
    is_affine: bool
    gain: float
    stiffness: float
    offset: float
    control_range: str
    force_limited: bool


@dataclass(frozen=True)
class Compiled:
    """MuJoCo's model of a file, without its constraints.

    elements   actuators in the file's order
    left_out   actuators that are no torque on a joint, by name
    pid        MuJoCo's number for the gain of a <pid>, where it knows them
    """

    model: Any
    constraints: Constraints
    notes: tuple[str, ...]
    elements: tuple[ActuatorElement, ...] = ()
    left_out: tuple[str, ...] = ()
    pid: int = -1


def compile_mjcf(root: Element, path: Path, keyframes: bool = False) -> Compiled:
    """The MJCF with root element `root`, read from `path`; `keyframes`: with their postures. Raises GainroomError, one line."""
    mujoco = library("mujoco", "Pinocchio and MuJoCo")
    source = str(path)
    _Includes(path).splice(root, path.parent)
    tendons = [f"<{each.tag}>" for section in root.findall("tendon") for each in section]
    _trim(root, source, (*SECTIONS, *KEYFRAMES) if keyframes else SECTIONS)
    with _COMPILING, _warnings(mujoco) as said:
        try:
            spec = mujoco.MjSpec.from_string(tostring(root, "unicode"))
            spec.modelfiledir, spec.memory = str(path.parent), ARENA
            _drop_shapes(spec, path)
            elements = tuple(_element(mujoco, actuator) for actuator in spec.actuators)
            rotors = _rotors_elsewhere(mujoco, spec)
            left_out = _drop_actuators(mujoco, spec)
            constraints = take_constraints(mujoco, spec)
            model = spec.compile()
        except GainroomError:
            raise
        except (ValueError, RuntimeError, LookupError, TypeError, mujoco.FatalError) as error:
            # Lines are those of the text that MuJoCo was given, not the file's.
            raise GainroomError(f"{source}: not a valid MJCF: {re.sub(r',? *line [0-9]+', '', one_line(error))}") from error
    notes = [f"{constraints.ignored} constraints of tendons or flexible bodies ignored"] * (constraints.ignored > 0)
    if tendons:
        notes.append(f"{len(tendons)} tendon{'s' * (len(tendons) > 1)} ignored: their springs, dampers, armature and limits do not count")
    _require_finite(model, source)
    said_too = (f"MuJoCo: {one_line(text)}" for text in said)
    return Compiled(model, constraints, (*notes, *rotors, *said_too), elements, left_out, int(getattr(mujoco.mjtGain, "mjGAIN_PID", -1)))


def _require_finite(model: Any, source: str) -> None:
    """Raise GainroomError where a number of the file, or what the compiler made of some, is not finite."""
    for what, columns in FINITE.items():
        for column in columns:
            values = np.asarray(getattr(model, column), dtype=float)
            wrong = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1)) if len(values) else []
            if len(wrong):
                name = getattr(model, what)(int(wrong[0])).name or f"{what}#{wrong[0]}"
                raise GainroomError(f"{source}: {what} {name!r}: {column.partition('_')[2]} {values[wrong[0]].tolist()} must be finite")


def inside(path: Path, name: str, near: tuple[Path, ...], what: str) -> Path | None:
    """The file `name`, looked for in the folders `near`; None where it is missing.

    Raises GainroomError where it lies outside the folder of the model `path`, through .. or a symbolic link too.
    """
    home = path.parent.resolve()
    for folder in near:
        try:
            target = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL
            raise GainroomError(f"{path}: {what} {name[:60]!r} cannot be read") from error
        if not target.is_relative_to(home):
            raise GainroomError(f"{path}: {what} {name[:60]!r} lies outside the model's folder; put it there")
        if target.is_file():
            return target
    return None


class _Includes:
    """Puts the content of included files in place, as MuJoCo does: each file once, names relative to the model, then to the includer."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.seen = {path.resolve()}
        self.elements = 0

    def splice(self, element: Element, folder: Path, depth: int = 0) -> None:
        if depth > MAX_DEPTH:
            raise GainroomError(f"{self.path}: elements are nested more than {MAX_DEPTH} deep")
        children = []
        for child in element:
            if child.tag != "include":
                self._count()
                self.splice(child, folder, depth + 1)
                children.append(child)
                continue
            target = self._target(child, folder)
            included = read_xml(target)
            self.splice(included, target.parent, depth)
            children.extend(included)
        element[:] = children

    def _target(self, include: Element, folder: Path) -> Path:
        name = include.get("file", "")
        if not name or len(include.attrib) > 1:
            raise GainroomError(f"{self.path}: <include {' '.join(include.attrib)}> must have the attribute file and no other")
        target = inside(self.path, name, (self.path.parent, folder), "include")
        if target is None:
            raise GainroomError(f"{self.path}: include {name[:60]!r}: no such file")
        if target in self.seen:
            raise GainroomError(f"{self.path}: include {name[:60]!r} is included twice, or includes itself")
        self.seen.add(target)
        return target

    def _count(self) -> None:
        self.elements += 1
        if self.elements > MAX_ELEMENTS:
            raise GainroomError(f"{self.path}: more than {MAX_ELEMENTS} elements with all includes")


def _trim(root: Element, source: str, sections: tuple[str, ...]) -> None:
    """Leave only what bears on bodies, joints and actuators, and hold that within bounds."""
    for section in root:
        if section.tag not in (*SECTIONS, *IDLE, *MULTIPLIERS):
            meant = typo_of(section.tag, (*SECTIONS, *IDLE))
            hint = f"; did you mean <{meant}>?" if meant else f" (sections: {', '.join(sorted({*SECTIONS, *IDLE}))})"
            raise GainroomError(f"{source}: <{section.tag[:40]}> is no section of an MJCF{hint}")
    root[:] = [section for section in root if section.tag in sections]
    for element in root.iter():
        if element.tag in MULTIPLIERS:
            raise GainroomError(f"{source}: <{element.tag}> is not read here; use the file that MuJoCo saves after compiling it")
        if element.tag == "asset":
            element[:] = [asset for asset in element if asset.tag == "mesh"]
        element[:] = [child for child in element if child.tag not in ("light", "camera", "plugin")]
        element.attrib.pop("material", None)
        if element.tag == "key":  # the rest counts actuators and bodies that are left out
            element.attrib = {name: value for name, value in element.attrib.items() if name in ("name", "qpos")}
    _trim_shapes(root)
    counts = Counter(element.tag for section in root if section.tag == "worldbody" for element in section.iter())
    counts.update(f"{section.tag}" for section in root if section.tag in ("asset", "actuator", "equality", *KEYFRAMES) for _ in section)
    counts["joint"] += counts["freejoint"]
    for tag, most in MOST.items():
        require_at_most(source, counts[tag], f"of <{tag}>", most)


def _trim_shapes(root: Element) -> None:
    """Leave out geoms where explicit inertia makes them idle (XML reference: compiler/inertiafromgeom)."""
    rules = [rule for compiler in root.findall("compiler") if (rule := compiler.get("inertiafromgeom"))]
    rule = rules[-1] if rules else "auto"
    for body in root.iter():
        idle = body.tag == "worldbody" or (body.tag == "body" and (body.find("inertial") is not None or rule == "false"))
        if idle and rule != "true":
            _remove_geoms(body)


def _remove_geoms(body: Element) -> None:
    body[:] = [child for child in body if child.tag != "geom"]
    for frame in body.findall("frame"):
        _remove_geoms(frame)


def _drop_shapes(spec: Any, path: Path) -> None:
    """Delete the geoms that no inertia comes from, and the meshes that then have no use."""
    used = set()
    for body in spec.bodies:
        for geom in list(body.geoms):
            if not _gives_inertia(spec, body, geom):
                spec.delete(geom)
            elif geom.meshname:
                used.add(geom.meshname)
                _require_mesh(spec, body.name, geom.meshname, path)
    for mesh in list(spec.meshes):
        if _mesh_name(mesh) not in used:
            spec.delete(mesh)


def _gives_inertia(spec: Any, body: Any, geom: Any) -> bool:
    """Whether MuJoCo would take part of the body's inertia from this geom, where it looks at geoms at all."""
    low, high = spec.compiler.inertiagrouprange
    weightless = geom.mass == 0 or (geom.mass != geom.mass and geom.density == 0)  # a NaN says: by density
    return low <= geom.group <= high and not weightless and not (_is_static(spec, body) and spec.compiler.settotalmass <= 0)


def _is_static(spec: Any, body: Any) -> bool:
    """Whether no joint moves the body."""
    while body.name != spec.worldbody.name or body.id != spec.worldbody.id:
        if len(body.joints):
            return False
        body = body.parent
    return True


def _mesh_name(mesh: Any) -> str:
    return mesh.name or Path(mesh.file).stem


def _require_mesh(spec: Any, body: str, name: str, path: Path) -> None:
    """Raise GainroomError where the body's inertia comes from a mesh that is not there."""
    mesh = next((mesh for mesh in spec.meshes if _mesh_name(mesh) == name), None)
    if mesh is None or not mesh.file:
        return  # an unknown name MuJoCo reports itself; vertices may stand in the file
    owner = f"{path}: body {body!r} has no <inertial>, and its mesh {mesh.file[:60]!r}"
    file = inside(path, os.path.basename(mesh.file) if spec.strippath else mesh.file, (path.parent / spec.meshdir,), "mesh")
    if file is None:
        raise GainroomError(f"{owner} is missing")
    status = file.stat()
    if status.st_size > MAX_BYTES:
        raise GainroomError(f"{owner} is larger than {MAX_BYTES} bytes")
    note_read(status, file)


def _element(mujoco: Any, actuator: Any) -> ActuatorElement:
    bias, (low, high) = actuator.biasprm, actuator.ctrlrange
    limited = low < high and int(actuator.ctrllimited) != 0  # 1: true; 2: as the range says
    limits_force = (False, True, actuator.forcerange[0] < actuator.forcerange[1])[int(actuator.forcelimited)]
    return ActuatorElement(
        joint=actuator.target if _on_joint(mujoco, actuator) else "",
        gear=float(actuator.gear[0]),
        is_affine=actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE,
        gain=float(actuator.gainprm[0]),
        stiffness=-float(bias[1]),
        offset=float(bias[0]),
        control_range=f"{low:.10g} {high:.10g}" if limited else "",
        force_limited=bool(limits_force),
    )


def _on_joint(mujoco: Any, actuator: Any) -> bool:
    return actuator.trntype in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def _drop_actuators(mujoco: Any, spec: Any) -> tuple[str, ...]:
    """Leave out the actuators that are no torque on a joint, possibly with position and velocity feedback; their names.

    What is on a joint stays as a motor, whose rotor moves with the joint.
    """
    gain = (mujoco.mjtGain.mjGAIN_FIXED, getattr(mujoco.mjtGain, "mjGAIN_PID", None))  # since MuJoCo 3.12
    left_out = []
    bias = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
    for index, actuator in enumerate(list(spec.actuators)):
        on_joint = _on_joint(mujoco, actuator)
        if not on_joint or actuator.gaintype not in gain or actuator.biastype not in bias:
            left_out.append(actuator.name or f"actuator#{index}")
            if on_joint:
                actuator.set_to_motor()
            else:
                spec.delete(actuator)
    return tuple(left_out)


def _rotors_elsewhere(mujoco: Any, spec: Any) -> list[str]:
    """A note of actuators with armature that are on no joint."""
    names = [actuator.name or f"actuator#{index}" for index, actuator in enumerate(spec.actuators)]
    rotors = [
        name
        for name, actuator in zip(names, spec.actuators, strict=True)
        if getattr(actuator, "armature", 0.0) and not _on_joint(mujoco, actuator)  # since MuJoCo 3.5
    ]
    return [f"armature of these actuators, which are on no joint, does not count: {first_of_many(rotors)}"] * bool(rotors)


@contextlib.contextmanager
def _warnings(mujoco: Any) -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, of either kind."""
    with mujoco_warnings(mujoco) as said, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield said
    said.extend(str(each.message) for each in caught)
