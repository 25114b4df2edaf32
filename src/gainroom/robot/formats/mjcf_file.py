"""MJCF through MuJoCo's compiler, which knows defaults, inertia from shapes and its own conventions best.

What does not bear on bodies and joints is left out before it compiles: pictures, sensors, contacts, and every shape that does not enter a
body's inertia. So mesh files may be missing where inertias are explicit. MuJoCo compiles in a guarded child, once per file and process as
long as nothing changes: in bounds, too, a file may take it for ever; a hull of 1.5 million corners, 40 MB, takes more than a minute.
"""

import contextlib
import hashlib
import os
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree.ElementTree import Element, tostring

import numpy as np

from ...errors import GainroomError, typo_of
from ...io.guarded_child import Array, guarded_child
from ...io.run_files import note_read
from ..assemble import MAX_JOINTS, require_at_most
from ..body import require_installed
from .mjcf_compiler import ActuatorElement, inside
from .mjcf_constraints import Constraints
from .xml_text import MAX_DEPTH, MAX_ELEMENTS, read_xml

SECTIONS = ("compiler", "option", "default", "asset", "worldbody", "equality", "actuator")
IDLE = ("size", "visual", "statistic", "custom", "contact", "deformable", "tendon", "sensor", "extension", "keyframe")
"""Sections that MJCF has and that do not bear on bodies, joints and their actuators."""
MULTIPLIERS = ("replicate", "composite", "flexcomp", "attach")
"""These make many bodies of few lines, or read further models."""
MOST = {"body": 2000, "joint": MAX_JOINTS, "geom": 2000, "site": 2000, "asset": 1000, "actuator": 2000, "equality": 2000}
"""Elements by tag, assets and the like by section: MuJoCo and Pinocchio take time that grows with the square of some of them."""
MOST_KEYFRAMES = 1000
"""Postures that are read; of a file with more, none."""
MOST_KEPT = 8
"""Compiled models that are kept: a command reads one, the app one per page."""


@dataclass(frozen=True)
class Compiled:
    """MuJoCo's compiled model of a file, without its constraints.

    model      numbers by MuJoCo's own names (mjcf_compiler.ARRAYS, key_qpos), nbody, njnt, nsite, nkey, and opt; names, by kind of part
    elements   actuators in the file's order
    left_out   actuators that are no torque on a joint, by name
    pid        MuJoCo's number for the gain of a <pid>, where it knows them
    unkeyed    what is wrong with the keyframes
    files      meshes that were read: name, and what changes where they do
    """

    model: Any
    constraints: Constraints
    notes: tuple[str, ...]
    elements: tuple[ActuatorElement, ...]
    left_out: tuple[str, ...]
    pid: int
    unkeyed: tuple[str, ...]
    files: tuple[tuple[str, tuple[int, int, int]], ...]


_kept: "OrderedDict[tuple[str, str], Compiled]" = OrderedDict()
_keeping = threading.Lock()


def compile_mjcf(root: Element, path: Path, meanwhile: Callable[[], object] | None = None) -> Compiled:
    """Compiled model of the MJCF with root element `root`, read from `path`. Raises GainroomError, one line.

    meanwhile   what else takes time, done here while the child starts
    """
    require_installed("mujoco", "Pinocchio and MuJoCo")
    source = str(path)
    _Includes(path).splice(root, path.parent)
    tendons = [f"<{each.tag}>" for section in root.findall("tendon") for each in section]
    frames = root.findall("keyframe")
    _trim(root, source)
    text = tostring(root, "unicode")
    keyed = _keyed(root, frames)
    key = source, hashlib.sha256(f"{text}\0{keyed}".encode("utf-8", "surrogatepass")).hexdigest()
    with _keeping:
        found = _kept.get(key)
    if found is None or not all(_stamp(name) == stamp for name, stamp in found.files):
        found = _sent(path, text, keyed, meanwhile)
        with _keeping:
            _kept[key] = found
            while len(_kept) > MOST_KEPT:
                _kept.popitem(last=False)
    ignored = found.constraints.ignored
    notes = [f"{ignored} constraints of tendons or flexible bodies ignored"] * (ignored > 0)
    if tendons:
        notes.append(f"{len(tendons)} tendon{'s' * (len(tendons) > 1)} ignored: their springs, dampers, armature and limits do not count")
    return replace(found, notes=(*notes, *found.notes))


def _sent(path: Path, text: str, keyed: str, meanwhile: Callable[[], object] | None) -> Compiled:
    """Model that a guarded child compiles from the text. Raises GainroomError."""
    with guarded_child(path, "an MJCF", f"{__package__}.mjcf_compiler") as child:
        if meanwhile is not None:
            meanwhile()
        answer, numbers = child.ask({"text": text, "keyed": keyed})
    assert numbers is not None
    return Compiled(
        _model(answer, numbers),
        Constraints.from_json(answer["constraints"]),
        tuple(answer["notes"]),
        tuple(ActuatorElement(**each) for each in answer["elements"]),
        tuple(answer["left_out"]),
        answer["pid"],
        tuple(answer["unkeyed"]),
        tuple((name, _stamp(name)) for name in answer["meshes"]),
    )


def _stamp(name: str) -> tuple[int, int, int]:
    """Inode, size [bytes] and time of change [ns] of a mesh file, which is noted as read; zeros if it is gone."""
    with contextlib.suppress(OSError):
        status = os.stat(name)
        note_read(status, name)
        return status.st_ino, status.st_size, status.st_mtime_ns
    return 0, 0, 0


def _model(answer: dict[str, Any], numbers: Array) -> SimpleNamespace:
    arrays, first = {}, 0
    for name, dtype, shape in answer["arrays"]:
        size = int(np.prod(shape))
        arrays[name] = numbers[first : first + size].astype(dtype).reshape(shape)
        first += size
    names, option = answer["names"], answer["option"]
    counts = {"nbody": len(names["body"]), "njnt": len(names["joint"]), "nsite": len(names["site"]), "nkey": len(names["key"])}
    return SimpleNamespace(**arrays, **counts, names=names, opt=SimpleNamespace(**option))


class _Includes:
    """Expander of <include>, as in MuJoCo: each file once, names relative to the model, then to the including file."""

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


def _trim(root: Element, source: str) -> None:
    """Removes all but bodies, joints, actuators and what they need. Raises GainroomError for unknown sections, and if too much is left."""
    for section in root:
        if section.tag not in (*SECTIONS, *IDLE, *MULTIPLIERS):
            meant = typo_of(section.tag, (*SECTIONS, *IDLE))
            hint = f"; did you mean <{meant}>?" if meant else f" (sections: {', '.join(sorted({*SECTIONS, *IDLE}))})"
            raise GainroomError(f"{source}: <{section.tag[:40]}> is no section of an MJCF{hint}")
    root[:] = [section for section in root if section.tag in SECTIONS]
    for element in root.iter():
        if element.tag in MULTIPLIERS:
            raise GainroomError(f"{source}: <{element.tag}> is not read here; use the file that MuJoCo saves after compiling it")
        if element.tag == "asset":
            element[:] = [asset for asset in element if asset.tag == "mesh"]
        element[:] = [child for child in element if child.tag not in ("light", "camera", "plugin")]
        element.attrib.pop("material", None)
    _trim_shapes(root)
    counts = Counter(element.tag for section in root if section.tag == "worldbody" for element in section.iter())
    counts.update(f"{section.tag}" for section in root if section.tag in ("asset", "actuator", "equality") for _ in section)
    counts["joint"] += counts["freejoint"]
    for tag, most in MOST.items():
        require_at_most(source, counts[tag], f"of <{tag}>", most)


def _keyed(root: Element, frames: Sequence[Element]) -> str:
    """Text of the MJCF with its keyframes; "" if there are none, or too many."""
    for key in (key for frame in frames for key in frame):  # the rest counts actuators and bodies that are left out
        key.attrib = {name: value for name, value in key.attrib.items() if name in ("name", "qpos")}
    root.extend(frames)
    return tostring(root, "unicode") if 0 < sum(map(len, frames)) <= MOST_KEYFRAMES else ""


def _trim_shapes(root: Element) -> None:
    """Removes geoms that have no effect because inertia is explicit (XML reference: compiler/inertiafromgeom)."""
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
